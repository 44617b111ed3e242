"""What the loop is made for, each with a small example: circuits of any order, several units in a lane with clocks of
their own, and a part between two samples that is not linear. The answers are those of other programs: matrix
exponentials, an ODE solver and a controller in complex numbers.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from tests.oracles.emt_controller import SampledController, State
from tests.simulation.studies import GAINS, lcl_study
from vsgdesign.codegen.blocks import Part, Writer, joined, renamed, with_outputs
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.llvm import LoopSpec, compiled_loop, empty_rows
from vsgdesign.codegen.llvm_loop import loop_text
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.controller_data import ControllerSettings, ControllerState
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.simulation.axes import RISING, Axes, states_of
from vsgdesign.simulation.bodies import control, plant, products
from vsgdesign.simulation.circuit_sample import BridgeVoltage, PlantState, edges_on_slope, legs_after
from vsgdesign.simulation.loop import carrier_part, kind_of
from vsgdesign.simulation.run_kind import Kind, names_of
from vsgdesign.study.parameters import Study

OMEGA = 2.0 * math.pi * 50.0

# The order of the circuit.


def circuit_loop(kind: Kind, lanes: int) -> LoopSpec:
    """The circuit alone, with a bridge voltage that stays."""
    body = plant(kind, *kind.bridge.slopes)
    state = [(f"x.{name}", f"moved.{name}") for name in kind.states]
    state += [(f"source.{part}", f"turned.{part}") for part in ("cosine", "sine")]
    moved, own = {name for name, _ in state}, products(kind)
    matrix = [name for product in own for name in product.matrix]
    results = {name for product in own for name in product.results}
    placed = moved | results | set(matrix)
    constant = [*matrix, *(name for name in body.inputs if name not in placed)]
    return LoopSpec(
        bodies=(body,), state=tuple(state), constant=tuple(constant), products=own, lanes=lanes, strict=True
    )


@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("slopes", [(), (RISING,)], ids=["averaged", "switched"])
@pytest.mark.parametrize("states", [18, 60])
def test_a_circuit_of_any_order(states: int, slopes: tuple[str, ...], lanes: int) -> None:
    """Random coupled circuits, each lane with its own: x ← Φ x + Γ v + edges + what the source adds."""
    rng = np.random.default_rng(states)
    study, degree = lcl_study("1 ms", delay_samples="0"), 5 if slopes else 0
    kind = kind_of(study, switched=False, axes=Axes(states, degree, coupled=True))
    kind = kind._replace(bridge=kind.bridge._replace(slopes=slopes))
    spec = circuit_loop(kind, lanes)
    place = {name: row for row, name in enumerate(spec.rows)}
    rows = empty_rows(spec, 1)
    rows[:] = rng.normal(size=rows.shape)
    phi = rng.normal(size=(states, states, lanes)) / states
    for i in range(states):
        for k in range(states):
            rows[0, place[f"row.p_{i}_{k}"]] = phi[i, k]
    part = carrier_part(0.0, 0.5)
    given = {"V_dc": 400.0, **{f"part.{name}": value for name, value in part._asdict().items()}}
    for name, value in given.items():
        if name in place:
            rows[0, place[name]] = value
    before = {name: rows[0, at].copy() for name, at in place.items()}

    def column(head: str, *after: Any) -> np.ndarray:
        return np.array([before[f"{head}_{i}" + "".join(f"_{k}" for k in after)] for i in range(states)])

    v = np.array([before["said.v_b_alpha"], before["said.v_b_beta"]])
    x = np.array([before[f"x.{name}"] for name in kind.states])
    expected = np.einsum("ikl,kl->il", phi, x)
    if slopes:
        for lane in range(lanes):
            applied = BridgeVoltage(v[0, lane], v[1, lane])
            first, m_a, m_b, m_c = legs_after(
                applied, 400.0, part, zero_sequence=kind.bridge.zero_sequence, rising=True
            )
            for edge in edges_on_slope(m_a, m_b, m_c, 400.0, part, rising=True):
                for axis, size in enumerate((edge.alpha, edge.beta)):
                    coefficients = [column(f"edge.c{k}", axis)[:, lane] for k in range(degree + 1)]
                    expected[:, lane] += size * np.polynomial.polynomial.polyval(edge.place, np.array(coefficients))
            v[:, lane] = first
    for axis, part_ in enumerate(("cosine", "sine")):
        expected += column("row.b", axis) * v[axis] + column("row.s", axis) * before[f"source.{part_}"]
    # Strict: the bits are the same either way, and a loop of sixty states takes a second to optimise.
    compiled_loop(spec, quickly=states == 60)(0, 1, rows, np.empty(0))
    found = np.array([rows[0, place[f"x.{name}"]] for name in kind.states])
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max() * states


def test_the_text_of_a_loop_does_not_grow_with_the_square_of_its_states() -> None:
    """Sixty states have ten times as many numbers in Φ as twenty."""
    study = lcl_study("1 ms", delay_samples="0")
    kind = kind_of(study, switched=False)
    sizes = [len(loop_text(circuit_loop(kind._replace(axes=Axes(n)), 1))) for n in (20, 60)]
    assert sizes[1] < 4.0 * sizes[0]
    assert states_of(Axes(60))[-1] == "more_53"


# Two units on one bus, each with its own study, gains, references and clock.

L_G, R_G, V_G = 3e-3, 0.4, math.sqrt(2.0) * 110.0
PERIOD = 150e-6
"""Unit 0 samples every 50 µs, unit 1 every 75 µs, the first time after 25 µs."""
INSTANTS = (0.0, 25e-6, 50e-6, 100e-6)
SAMPLING = ((0,), (1,), (0,), (0, 1))
REFERENCES = ((2500.0, 300.0), (-1500.0, 0.0))


def unit_studies() -> tuple[Study, Study]:
    one = lcl_study("1.5 ms", delay_samples="0")
    other = lcl_study(
        "1.5 ms", log="75 us", delay_samples="0", f_sw='"6.6666666666666667 kHz"', L_1='"3 mH"', C='"12 uF"'
    )
    return one, other


def two_units(studies: tuple[Study, Study]) -> tuple[np.ndarray, np.ndarray]:
    """dx/dt = A x + B (v_0, v_1, v_g) of i_s, v_c and i_g of both units, one axis."""
    A, B, mass = np.zeros((6, 6)), np.zeros((6, 3)), np.eye(6)
    for u, study in enumerate(studies):
        f, at = study.filter, 3 * u
        i_s, v_c, i_g = at, at + 1, at + 2
        mass[i_s, i_s], mass[v_c, v_c] = f.L_1, f.C
        mass[i_g, 2], mass[i_g, 5] = L_G, L_G
        mass[i_g, i_g] += f.L_2
        A[i_s, [i_s, v_c, i_g]], B[i_s, u] = [-f.R_1 - f.R_c, -1.0, f.R_c], 1.0
        A[v_c, [i_s, i_g]] = 1.0, -1.0
        A[i_g, [2, 5]] = -R_G
        A[i_g, [i_s, v_c]] += [f.R_c, 1.0]
        A[i_g, i_g] -= f.R_2 + f.R_c
        B[i_g, 2] = -1.0
    return np.linalg.solve(mass, A), np.linalg.solve(mass, B)


UNIT_STATES = [f"{unit}.x.{name}" for unit in ("u0", "u1") for name in ("i_s", "v_c", "i_g")]


def network() -> Block:
    """Both axes of six states over an interval; its numbers depend on the place in the cycle alone."""
    line = Writer()
    source = {axis: line.input(f"source.{part}") for axis, part in (("alpha", "cosine"), ("beta", "sine"))}
    for axis, other, sign in (("alpha", "beta", "-"), ("beta", "alpha", "+")):
        for row, state in enumerate(UNIT_STATES):
            factors = [f"{one}_{axis}" for one in UNIT_STATES] + [f"u{u}.held.{axis}" for u in range(2)]
            terms = [line.does("*", line.input(f"n_{row}_{k}"), line.input(name)) for k, name in enumerate(factors)]
            terms.append(line.does("*", line.input(f"re_{row}"), source[axis]))
            turned = line.does("*", line.input(f"im_{row}"), source[other])
            line.output(f"moved.{state}_{axis}", line.does(sign, line.sum_of(*terms), turned))
    cosine, sine = (line.input(f"turn_{part}") for part in ("cos", "sin"))
    for part, one, other, sign in (("cosine", "alpha", "beta", "-"), ("sine", "beta", "alpha", "+")):
        products_ = line.does("*", source[one], cosine), line.does("*", source[other], sine)
        line.output(f"turned.{part}", line.does(sign, *products_))
    return line.block()


def body(kinds: list[Kind], sampling: tuple[int, ...], moved: list[tuple[str, str]]) -> Block:
    """One instant: the units that sample hold a new voltage, the others stay as they are; then the network."""
    parts = []
    shared = ("source.cosine", "source.sine", "V_g")
    for u, kind in enumerate(kinds):
        if u in sampling:
            parts.append(Part(renamed(control(kind), lambda name, u=u: name if name in shared else f"u{u}.{name}")))
            hold = {f"u{u}.held.{axis}": f"u{u}.said.v_b_{axis}" for axis in ("alpha", "beta")}
        else:
            hold = {f"u{u}.held.{axis}": f"u{u}.held.{axis}" for axis in ("alpha", "beta")}
        line = Writer()
        for after, before in hold.items():
            line.output(after, line.input(before))
        if u not in sampling:
            for name, output in moved:
                if name.startswith(f"u{u}.") and ".x." not in name and ".held." not in name:
                    line.output(output, line.input(name))
        parts.append(Part(line.block()))
    return with_outputs(joined(*parts, Part(network())), tuple(output for _, output in moved))


def test_two_units_with_clocks_of_their_own() -> None:
    """Each has its filter, gains, references and sampling period, and they meet on one bus. Against an ODE solver that
    is stopped at every instant at which one of two controllers in complex numbers samples."""
    studies = unit_studies()
    kinds = [kind_of(study, switched=False) for study in studies]
    moved: list[tuple[str, str]] = []
    for u, kind in enumerate(kinds):
        moved += [(f"u{u}.x.{name}", f"moved.u{u}.x.{name}") for name in kind.states]
        after = {"state.theta": "kept_angle"}
        moved += [
            (f"u{u}.{name}", f"u{u}.{after.get(name, name.replace('state.', 'following.', 1))}")
            for name in kind.names(ControllerState, "state")
        ]
        moved.append((f"u{u}.limited", f"u{u}.limited_samples"))
        moved += [(f"u{u}.held.{axis}", f"u{u}.held.{axis}") for axis in ("alpha", "beta")]
    moved += [("source.cosine", "turned.cosine"), ("source.sine", "turned.sine")]
    bodies = tuple(body(kinds, sampling, moved) for sampling in SAMPLING[1:])
    cyclic = [f"n_{row}_{k}" for row in range(6) for k in range(8)]
    cyclic += [f"{head}_{row}" for head in ("re", "im") for row in range(6)] + ["turn_cos", "turn_sin"]
    inputs = {name for one in bodies for name in one.inputs}
    uniform = [name for name in sorted(inputs) if name not in {*cyclic, *(name for name, _ in moved)}]
    spec = LoopSpec(
        bodies=bodies, state=tuple(moved), uniform=tuple(uniform), cyclic=tuple(cyclic), strict=True,
        logged=tuple(f"{name}_{axis}" for name in UNIT_STATES for axis in ("alpha", "beta")),
    )  # fmt: skip
    known = {"V_g": V_G}
    for u, (study, kind, (P, Q)) in enumerate(zip(studies, kinds, REFERENCES, strict=True)):
        known[f"u{u}.R_c"] = study.filter.R_c
        records: dict[str, tuple[Any, Any]] = {
            "inner_gains": (InnerLoopGains, study.inner_gains),
            "settings": (ControllerSettings, study.controller_settings()),
            "power_gains": (PowerLoopGains, GAINS),
            "refs": (References, study.converter.references(P, Q)),
            "grid": (GridEstimate, GridEstimate(R_G, L_G)),
        }
        for head, (record, value) in records.items():
            paths = kind.names(record, f"u{u}.{head}")
            known |= dict(zip(paths, numbers_of(value), strict=True))
    A, B = two_units(studies)
    steps = np.diff([*INSTANTS, PERIOD])
    values = [interval(A, B, h) for h in steps]
    rows = empty_rows(spec, 1)
    place = {name: row for row, name in enumerate(spec.rows)}
    rows[0, place["source.cosine"]] = 1.0
    for u, study in enumerate(studies):
        rows[0, place[f"u{u}.state.omega_i"]], rows[0, place[f"u{u}.state.V"]] = OMEGA, study.converter.V_rated_rms
    rounds = 100
    log = np.zeros((1, 4 * rounds, 12, 1))
    order = np.array([SAMPLING[1:].index(s) for s in SAMPLING])
    compiled_loop(spec)(
        0, 4 * rounds, rows, np.array([known[name] for name in uniform]),
        cyclic=np.array(values), cycle=order, log=log, every=1,
    )  # fmt: skip
    expected = by_solver(studies, A, B, rounds)
    found = log[0, :, :, 0][:, 0::2] + 1j * log[0, :, :, 0][:, 1::2]
    assert np.abs(expected).max() > 50.0  # they move
    assert np.abs(found - expected).max() < 1e-6


def interval(A: np.ndarray, B: np.ndarray, h: float) -> list[float]:
    """The network over h seconds: transition and held voltages, then what the source adds and its turn."""
    whole = np.zeros((9, 9), dtype=complex)
    whole[:6, :6], whole[:6, 6:], whole[8, 8] = A, B, 1j * OMEGA
    step = expm(whole * h)
    source = step[:6, 8] * V_G
    turn = cmath.exp(1j * OMEGA * h)
    return [*step[:6, :8].real.ravel(), *source.real, *source.imag, turn.real, turn.imag]


def slope(t: float, x: np.ndarray, A: np.ndarray, B: np.ndarray, v: np.ndarray) -> np.ndarray:
    """dx/dt with the held voltages v."""
    return A @ x + B[:, :2] @ v + B[:, 2] * V_G * cmath.exp(1j * OMEGA * t)


def by_solver(studies: tuple[Study, Study], A: np.ndarray, B: np.ndarray, rounds: int) -> np.ndarray:
    """States (i_s, v_c, i_g of both) at every instant, complex."""
    controllers = [SampledController(study) for study in studies]
    states = [State(0.0, OMEGA, study.converter.V_rated_rms, 0j, 0j, 0j) for study in studies]
    x, held, found = np.zeros(6, dtype=complex), np.zeros(2, dtype=complex), []
    ends = [*INSTANTS[1:], PERIOD]
    for k in range(4 * rounds):
        begin, end = (PERIOD * (k // 4) + instants[k % 4] for instants in (INSTANTS, ends))
        found.append(x)
        for u in SAMPLING[k % 4]:
            i_s, v_c, i_g = (complex(one) for one in x[3 * u : 3 * u + 3])
            v = v_c + studies[u].filter.R_c * (i_s - i_g)
            states[u], held[u], _ = controllers[u].step(states[u], v, i_s, i_g, REFERENCES[u], GAINS)

        given = A, B, held.copy()
        x = solve_ivp(slope, (begin, end), x, method="DOP853", rtol=1e-11, atol=1e-9, args=given).y[:, -1]
    return np.array(found)


# A part between two samples that is not linear: a capacitor that feeds the bridge.

C_DC, P_DC = 2e-3, 3000.0


def fed_link(v_dc: Any, v_b: BridgeVoltage, x: PlantState, after: PlantState, T_s: Any) -> Any:
    """The energy of the capacitor over an interval: what its source gives less what the bridge takes with the mean of
    the currents at both ends. Returns the voltage after it."""
    i_alpha = 0.5 * (x.i_s_alpha + after.i_s_alpha)
    i_beta = 0.5 * (x.i_s_beta + after.i_s_beta)
    taken = 1.5 * (v_b.alpha * i_alpha + v_b.beta * i_beta)
    return np.sqrt(np.maximum(v_dc * v_dc + 2.0 * T_s / C_DC * (P_DC - taken), 1.0))


def held_by_link(v_dc: Any, v_b_alpha: Any, v_b_beta: Any) -> Any:
    """The bridge gives no more than its link has: back from the scalar to the circuit. Returns (alpha, beta)."""
    size = np.sqrt(v_b_alpha * v_b_alpha + v_b_beta * v_b_beta)
    share = np.minimum(1.0, 0.5 * v_dc / np.maximum(size, 1e-6))
    return v_b_alpha * share, v_b_beta * share


def test_a_scalar_state_beside_the_circuit() -> None:
    """It is fed by the circuit and feeds it back: a link that runs empty takes the voltage from the bridge. The same
    numbers by a loop of Python over matrix exponentials."""
    study = lcl_study("1 ms", delay_samples="0")
    kind = kind_of(study, switched=False)
    own, T_s = plant(kind), study.converter.T_s
    link = flat_block(fed_link)
    limit = flat_block(held_by_link)
    asked = {"v_b_alpha": "asked.alpha", "v_b_beta": "asked.beta"}
    acting = {"said.v_b_alpha": "alpha", "said.v_b_beta": "beta"}
    taken = {"v_b.alpha": "alpha", "v_b.beta": "beta"}
    taken |= {f"after.{name}": f"moved.{name}" for name in kind.states}
    made = joined(Part(limit, asked), Part(own, acting), Part(link, taken))
    state = [(f"x.{name}", f"moved.{name}") for name in kind.states]
    state += [("source.cosine", "turned.cosine"), ("source.sine", "turned.sine"), ("v_dc", "fed_link")]
    moved = {name for name, _ in state}
    uniform = tuple(name for name in made.inputs if name not in moved)
    spec = LoopSpec(bodies=(made,), state=tuple(state), uniform=uniform, logged=("x.i_s_alpha", "v_dc"), strict=True)
    f, grid = study.filter, study.grid
    A = np.array([
        [-(f.R_1 + f.R_c) / f.L_1, -1.0 / f.L_1, f.R_c / f.L_1],
        [1.0 / f.C, 0.0, -1.0 / f.C],
        [f.R_c, 1.0, -(f.R_2 + f.R_c + grid.R_g)],
    ])  # fmt: skip
    A[2] /= f.L_2 + grid.L_g
    whole = np.zeros((5, 5), dtype=complex)
    whole[:3, :3], whole[0, 3], whole[2, 4], whole[4, 4] = A, 1.0 / f.L_1, -1.0 / (f.L_2 + grid.L_g), 1j * OMEGA
    step = expm(whole * T_s)
    phi, gamma, rho = step[:3, :3].real, step[:3, 3].real, step[:3, 4] * V_G
    known = {f"row.p{i + 1}{k + 1}": phi[i, k] for i in range(3) for k in range(3)}
    for i in range(3):
        known |= {f"row.b{i + 1}": gamma[i], f"row.re{i + 1}": rho[i].real, f"row.im{i + 1}": rho[i].imag}
    known |= {"row.turn_cos": math.cos(OMEGA * T_s), "row.turn_sin": math.sin(OMEGA * T_s), "T_s": T_s}
    known |= {"asked.alpha": 150.0, "asked.beta": -60.0}
    rows = empty_rows(spec, 1)
    place = {name: row for row, name in enumerate(spec.rows)}
    rows[0, place["source.cosine"]], rows[0, place["v_dc"]] = 1.0, 400.0
    samples = 4000
    log = np.zeros((1, samples, 2, 1))
    compiled_loop(spec)(0, samples, rows, np.array([known[name] for name in uniform]), log=log, every=1)

    x, v_dc, source, found = np.zeros(3, dtype=complex), 400.0, 1.0 + 0j, []
    for _ in range(samples):
        found.append((x[0].real, v_dc))
        v = complex(150.0, -60.0)
        v *= min(1.0, 0.5 * v_dc / abs(v))
        after = phi @ x + gamma * v + rho * source
        power = 1.5 * (v * (0.5 * (x[0] + after[0])).conjugate()).real
        v_dc = math.sqrt(max(v_dc * v_dc + 2.0 * T_s / C_DC * (P_DC - power), 1.0))
        x, source = after, source * cmath.exp(1j * OMEGA * T_s)
    expected = np.array(found)
    assert np.ptp(expected[:, 1]) > 50.0  # the link moves …
    assert np.min(expected[:, 1]) < 2.0 * abs(complex(150.0, -60.0))  # … and takes voltage from the bridge
    assert np.abs(log[0, :, :, 0] - expected).max() < 1e-8


def test_names_of_records() -> None:
    """The renamed block of a unit has every number of its records under the unit's name."""
    kind = kind_of(lcl_study("1 ms", delay_samples="0"), switched=False)
    block = renamed(control(kind), lambda name: f"u3.{name}")
    assert {f"u3.{name}" for name in names_of(References, "refs")} <= set(block.inputs)
    assert all(name.startswith("u3.") for name in (*block.inputs, *(name for name, _ in block.outputs)))
