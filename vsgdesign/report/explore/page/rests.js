// Where a controller comes to rest on a grid of a page without a server: the package's own functions, compiled.

const GAINS = ["K_ip", "D_p", "K_iq", "D_q", "K_pq", "K_qp", "k_P", "k_Q"];

export class Rests {
  constructor(engine) {
    Object.assign(this, { engine, about: engine.info.judge });
    for (const name of ["path", "rest"]) this[name] = engine.loop(name, [], 1);
    this.newton = engine.loop("newton", [], this.about.newton);
    if (engine.info.dc) this.power = engine.loop("bridge_power", [], 1);
  }

  /** Gains for the measured powers on the grid of a place, as they are once they have come to rest. */
  gainsAt(run, place, { P, Q, V_rms }, refs) {
    const { controller, update } = run;
    const fixed = Object.fromEntries(GAINS.map((name) => [name, place.rows[run.at[`power_gains.${name}`]] ?? 0]));
    if (!update) return fixed;
    const [R_g, L_g] = place.grid;
    const given = { omega_i: 0 };
    for (const [name, value] of Object.entries(refs)) given[`refs.${name}`] = value;
    if (controller.gains === "followed") {
      for (const name of GAINS) given[`before.${name}`] = 0;
      const said = update.answer({ ...given, R_g, L_g, P, Q, V_rms });
      return Object.fromEntries(GAINS.map((name) => [name, said(`gains.${name}`)]));
    }
    const { state } = place;
    const asked = {
      said: 0,
      R_g,
      L_g,
      has_error: 0,
      var_R: 0,
      cov_RL: 0,
      var_L: 0,
      P,
      Q,
      V_rms,
      ticks: state["s.ticks"],
    };
    for (const [name, value] of Object.entries(asked)) given[`given.${name}`] = value;
    const said = update.answer({ ...given, ...state, told: 0 });
    return Object.fromEntries(GAINS.map((name) => [name, said(`following.gains.${name}`)]));
  }

  /** What the circuit of a place is at the frequency of a source. */
  circuitAt(run, place, source) {
    const { info } = this.engine;
    const given = {};
    for (const name of Object.keys(run.at)) {
      if (/^row\.p\d\d$/.test(name)) given[name.replace("row.", "transition.")] = place.rows[run.at[name]];
    }
    const circuit = { ...info.circuit };
    [circuit["circuit.R_g"], circuit["circuit.L_g"]] = place.grid;
    let parts = place.source;
    if (source.omega !== info.omega) {
      const said = this.engine.response.answer({ ...given, ...circuit, h: info.T_s, omega: source.omega });
      parts = ["re", "im"].flatMap((part) =>
        ["i_s", "v_c", "i_g"].map((state) => said(`of_constant.${state}.${part}`)),
      );
    }
    ["i_s", "v_c", "i_g"].forEach((state, k) => {
      given[`of_constant.${state}.re`] = parts[k];
      given[`of_constant.${state}.im`] = parts[3 + k];
      given[`b_${k + 1}`] = place.rows[run.at[`row.b${k + 1}`]];
    });
    given["turn.re"] = Math.cos(source.omega * info.T_s);
    given["turn.im"] = Math.sin(source.omega * info.T_s);
    return { ...given, ...circuit, R_c: circuit["circuit.R_c"], V_g_rms: source.V };
  }

  /** Where a controller rests on the grid of a place with these references, with its gains; null where it does not. */
  of(run, place, source, refs) {
    const { info } = this.engine;
    const numbers = this.circuitAt(run, place, source);
    const said = this.path.answer(numbers);
    const path = Object.fromEntries(["R", "X", "V_rms", "angle"].map((name) => [name, said(`sampled_path.${name}`)]));
    let measured = { P: refs.P_ref, Q: refs.Q_ref, V_rms: info.V_rated_rms };
    let gains = this.gainsAt(run, place, measured, refs);
    for (let round = 0; round < 100; round += 1) {
      const P = refs.P_ref + gains.D_p * (refs.omega_0 - source.omega);
      const { D_q } = gains;
      const asked = { P, Q_0: refs.Q_ref + D_q * refs.V_n, D_q, V_g_rms: path.V_rms, R: path.R, X: path.X };
      const { newton } = this;
      for (const [name, value] of Object.entries({ ...asked, V_rms: info.V_rated_rms, delta: 0 }))
        newton.set(name, value);
      newton.call(0, this.about.newton);
      const [V_rms, error] = [newton.get("V_rms"), newton.memory.floats[newton.log + this.about.newton - 1]];
      if (!(error <= this.about.converged) || !(V_rms > 0)) return null;
      const reached = { P, Q: refs.Q_ref + D_q * (refs.V_n - V_rms), V_rms };
      const following = this.gainsAt(run, place, reached, refs);
      const near = ([name, value]) =>
        Math.abs(value - gains[name]) <= 1e-13 * (Math.abs(value) + Math.abs(gains[name]));
      gains = following;
      if (!Object.entries(following).every(near) && round < 99) continue;
      const at = { ...numbers, V_rms, delta: newton.get("delta") + path.angle };
      const answer = this.rest.answer(at);
      const found = Object.fromEntries(
        ["P", "Q", "V_rms", "delta", "i_s_pk", "v_b_pk", "P_pcc", "Q_pcc"].map((name) => [
          name,
          answer(`rest.${name}`),
        ]),
      );
      if (!(found.v_b_pk <= (info.dc ? this.mostOf(run, at) : run.controller.judge.v_max_pk))) return null;
      return { ...found, i_s_pu: found.i_s_pk / info.I_rated_pk, gains };
    }
    return null;
  }

  /** The largest voltage of the bridge at a rest of the circuit, from that of the dc link there; NaN where its source cannot
   * give the power. */
  mostOf(run, at) {
    const { dc } = this.engine.info;
    const value = (name) => run.start.rows[run.at[name]];
    const p = this.power.answer({ ...at, R_1: dc.R_1 })("bridge_power_at_rest");
    const v = this.engine.linkAt(value, p, dc.charge ? value(dc.charge.row) / dc.charge.full : 0.5);
    return v === null ? NaN : value("link.limit") * v;
  }

  refsOf(run, rows) {
    const names = ["P_ref", "Q_ref", "omega_0", "V_n"];
    const now = (name) => (rows ? rows[run.at[name]] : run.loop.get(name));
    return Object.fromEntries(names.map((name) => [name, now(`refs.${name}`) ?? 0]));
  }
}
