"""Answers for the development of the page, until those of the models are complete. Coarse, and to be removed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import VsgDesignError
from vsgdesign.explore.answer import Answer
from vsgdesign.explore.colours import colour_of
from vsgdesign.parameters.study import Place, Study


class StateError(VsgDesignError):
    def __init__(self, faults: list[dict[str, Any]]) -> None:
        self.faults = faults
        super().__init__("; ".join(fault["text"] for fault in faults))


_LIMITS = {
    "scr": (0.5, 100.0, ""),
    "x_over_r": (0.05, 100.0, ""),
    "P_pu": (-1.2, 1.2, "pu"),
    "Q_pu": (-1.2, 1.2, "pu"),
    "error_R": (-0.9, 2.0, ""),
    "error_X": (-0.9, 2.0, ""),
}


def defaults(study: Study, ready: Ready) -> dict[str, Any]:
    return {
        "scr": 5.0,
        "x_over_r": 2.0,
        "P_pu": 0.5,
        "Q_pu": 0.0,
        "V_g_pu": 1.0,
        "f_hz": study.converter.omega_n / (2.0 * np.pi),
        "error_R": 0.0,
        "error_X": 0.0,
        "hold": None,
        "figure": "damping",
        "event": {"kind": "step", "size": 0.05, "signal": "P", "length_s": 0.1, "to_scr": 2.0, "to_x_over_r": 1.0},
        "silent_s": 0.0,
        "controllers": [spec.name for spec in study.controllers],
        "changes": {},
        "own": None,
    }


def fields_of(study: Study, ready: Ready) -> list[dict[str, Any]]:
    S = study.converter.S_rated / 1e3
    rows = [
        ("scr", "SCR", "", 1.0, 25.0, 0.1, 5.0, "grid", 1.0),
        ("x_over_r", "X/R", "", 0.25, 25.0, 0.1, 2.0, "grid", 1.0),
        ("P_pu", "P", "kW", -1.2 * S, 1.2 * S, 0.05 * S, 0.5 * S, "operating point", S),
        ("Q_pu", "Q", "kvar", -1.2 * S, 1.2 * S, 0.05 * S, 0.0, "operating point", S),
        ("error_R", "error of R", "%", -50.0, 50.0, 1.0, 0.0, "estimate", 100.0),
        ("error_X", "error of X", "%", -50.0, 50.0, 1.0, 0.0, "estimate", 100.0),
    ]
    names = ("path", "label", "unit", "low", "high", "step", "value", "group", "scale")
    return [dict(zip(names, row, strict=True)) for row in rows]


def figures_of(study: Study, ready: Ready) -> list[dict[str, Any]]:
    return [
        {"name": "damping", "label": "least damping ratio", "unit": "", "promise": 0.5, "better": "high"}
        | {"low": 0.0, "high": 1.0},
        {"name": "decay", "label": "slowest decay", "unit": "1/s", "promise": 3.0, "better": "high"}
        | {"low": 0.0, "high": 10.0},
    ]


def events_of(study: Study) -> list[dict[str, Any]]:
    names = ("kind", "label", "unit", "low", "high", "step", "value")
    rows = [
        ("step", "step of a reference", "pu", 0.01, 0.5, 0.01, 0.05),
        ("grid", "jump of the grid", "", 0.0, 0.0, 1.0, 0.0),
        ("phase", "phase jump", "deg", -60.0, 60.0, 1.0, 10.0),
        ("sag", "voltage sag", "pu", 0.0, 0.9, 0.05, 0.3),
        ("ramp", "frequency ramp", "Hz", -2.0, 2.0, 0.1, -0.5),
    ]
    return [dict(zip(names, row, strict=True)) for row in rows]


def state_of(document: Any, study: Study) -> Any:
    known, faults = defaults(study, Ready()), []
    given = {**known, **document}
    for name in sorted(set(document) - set(known)):
        text = f"{name} is unknown"
        faults.append({"field": name, "value": str(document[name]), "limit": "", "unit": "", "text": text})
    for name, (low, high, unit) in _LIMITS.items():
        value = given[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            limit = f"{low:g} to {high:g}"
            text = f"{name} = {value!r}: must be {limit}"
            faults.append({"field": name, "value": str(value), "limit": limit, "unit": unit, "text": text})
    if faults:
        raise StateError(faults)
    return SimpleNamespace(**given)


def _cells(study: Study, ready: Ready, state: Any, scr: Any, ratio: Any, specs: Any) -> Any:
    from vsgdesign.equations.power_loops import PowerLoopGains
    from vsgdesign.runtime.of_study import gain_law
    from vsgdesign.stability.cells import cell_set, cells_under, grid_arrays

    R_g, L_g = grid_arrays(study, np.atleast_1d(scr), np.atleast_1d(ratio))
    S = study.converter.S_rated
    P, Q = state.P_pu * S, state.Q_pu * S
    every = []
    for spec in specs:
        R_hat, L_hat = R_g * (1.0 + state.error_R), L_g * (1.0 + state.error_X)
        if state.hold:
            held = Place(state.hold["scr"], state.hold["x_over_r"], study.scr_basis).grid(study.converter)
            R_hat, L_hat = np.full_like(R_g, held.R_g), np.full_like(L_g, held.L_g)
        every.append(cells_under(study, gain_law(study, spec, ready), R_g, L_g, P, Q, R_hat, L_hat))
    gains = PowerLoopGains(*(np.concatenate(values) for values in zip(*(c.gains for c in every), strict=True)))
    many = len(specs)
    return cell_set(study, np.tile(R_g.ravel(), many), np.tile(L_g.ravel(), many), P, Q, gains)


def _shown(study: Study, state: Any) -> list[tuple[int, Any]]:
    return [(k, spec) for k, spec in enumerate(study.controllers) if spec.name in state.controllers]


def linear_answer(study: Study, ready: Ready, state: Any) -> Answer:
    from vsgdesign.metrics.margins import disk_margin, loop_margins
    from vsgdesign.metrics.modes import to_continuous
    from vsgdesign.stability.cells import full_order_cells, reduced_cells
    from vsgdesign.stability.loops import FullOrderLoop
    from vsgdesign.stability.steps import full_order_step, reduced_step

    shown = _shown(study, state)
    cells = _cells(study, ready, state, state.scr, state.x_over_r, [spec for _, spec in shown])
    header, arrays = [], {}
    w = np.geomspace(1.0, 3e3, 240)
    S = study.converter.S_rated
    for i, (k, spec) in enumerate(shown):
        one = cells.take(np.array([i]))
        row: dict[str, Any] = {"name": spec.name, "colour": colour_of(k), "stable": False, "why": one.faults[0] or ""}
        row["gains"] = {name: float(v[0]) for name, v in zip(one.gains._fields, one.gains, strict=True)}
        header.append(row)
        if one.faults[0]:
            continue
        full = full_order_cells(study, one)
        if len(full.index) == 0:
            row["why"] = full.faults[0]
            continue
        s = to_continuous(np.linalg.eigvals(full.A), full.T_s)[0]
        row["stable"] = bool(s.real.max() < 0.0)
        row["modes"] = [
            {"re": z.real, "im": z.imag, "damping": -z.real / abs(z), "f_hz": abs(z.imag) / 6.2832, "participation": []}
            for z in s
            if abs(z) < 500.0
        ]
        row["damping"] = min((m["damping"] for m in row["modes"]), default=None)
        row["operating_point"] = {"P": state.P_pu * S, "Q": state.Q_pu * S, "delta_deg": np.degrees(one.delta[0])}
        row["operating_point"] |= {"V_pu": one.V_rms[0] / study.converter.V_rated_rms, "i_pu": None}
        loop = FullOrderLoop(full)
        Sens = loop.on(w)
        L = (1.0 / Sens[:, :, 0, 0] - 1.0)[0]
        if row["stable"]:
            row["disk_margin"] = {"P, Q": disk_margin(Sens, w, loop.at).value[0]}
            m = loop_margins(Sens, w, loop.at, 0)
            row |= {"gain_margin_db": m.gain_margin_db[0], "phase_margin_deg": m.phase_margin_deg[0]}
        arrays[f"{i}/bode_w"] = w
        arrays[f"{i}/bode_mag_db"] = 20.0 * np.log10(np.abs(L))
        arrays[f"{i}/bode_phase_deg"] = np.degrees(np.unwrap(np.angle(L)))
        every = max(round(5e-3 / full.T_s), 1)
        t, y = full_order_step(full, "P_ref", "P", 2.0, every)
        size = state.event["size"] if state.event["kind"] == "step" else 0.05
        arrays[f"{i}/step_t"] = t
        arrays[f"{i}/step_full"] = np.clip(state.P_pu + size * y[0], -3.0, 3.0)
        _, y = reduced_step(reduced_cells(study, one), "P_ref", "P", t[-1], t[1])
        arrays[f"{i}/step_reduced"] = np.clip(state.P_pu + size * y[0][: len(t)], -3.0, 3.0)
    return Answer({"controllers": header}, arrays)


def emt_answer(study: Study, ready: Ready, state: Any, stale: Any) -> Answer | None:
    from vsgdesign.equations.power_loops import PowerLoopGains
    from vsgdesign.simulation.steps import simulate_step

    shown = _shown(study, state)
    cells = _cells(study, ready, state, state.scr, state.x_over_r, [spec for _, spec in shown])
    header, arrays = [], {}
    S = study.converter.S_rated
    grid = Place(state.scr, state.x_over_r, study.scr_basis).grid(study.converter)
    for i, (k, spec) in enumerate(shown):
        if stale():
            return None
        row: dict[str, Any] = {"name": spec.name, "colour": colour_of(k), "status": "", "why": cells.faults[i] or ""}
        header.append(row)
        if cells.faults[i]:
            row["status"] = "no operating point"
            continue
        gains = PowerLoopGains(*(float(v[i]) for v in cells.gains))
        size = state.event["size"] * S if state.event["kind"] == "step" else 0.05 * S
        own = replace(study.with_limit_of(spec), controllers=study.controllers)
        try:
            t, y = simulate_step(own, grid, gains, state.P_pu * S, state.Q_pu * S, "P", size, 2.0, 50)
        except VsgDesignError as error:
            row |= {"status": "diverged", "why": str(error)[:200]}
            continue
        row["status"] = "ok"
        arrays[f"{i}/t"] = t
        arrays[f"{i}/P"] = np.clip(state.P_pu + y / S, -3.0, 3.0)
    return Answer({"controllers": header, "event_s": 0.0}, arrays)


def map_answer(study: Study, ready: Ready, state: Any) -> Answer:
    from vsgdesign.explore.info import map_axes
    from vsgdesign.stability.cells import reduced_cells

    scr, ratio = (np.geomspace(*ends, n) for ends, n in zip(map_axes(study), (30, 20), strict=True))
    shown = _shown(study, state) or [(0, study.controllers[0])]
    cells = _cells(study, ready, state, scr, ratio, [shown[-1][1]])
    good = cells.good
    values = np.full(len(good), np.nan)
    s = np.linalg.eigvals(reduced_cells(study, cells).A)
    found = (-s.real / np.abs(s)).min(1) if state.figure == "damping" else (-s.real).min(1)
    values[good] = np.where(s.real.max(1) < 0.0, found, -np.inf)
    figure = next(one for one in figures_of(study, ready) if one["name"] in (state.figure, "damping"))
    counts = {"no_point": int((~good).sum()), "unstable": int(np.isneginf(values).sum()), "kept": 0}
    arrays = {"scr": scr, "x_over_r": ratio, "values": values.reshape(30, 20).T}
    return Answer({"figure": figure["name"], **figure, "counts": counts}, arrays)
