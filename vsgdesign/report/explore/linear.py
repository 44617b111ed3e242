"""The linear answer of the explorer: modes, margins, Bode and steps of all shown controllers at one grid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.frames import rated_current_rms
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import effective_inertia, steady_droops
from vsgdesign.linear.model.coupled import CoupledModel
from vsgdesign.linear.operating_point.equilibrium import converter_current_rms
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.loci import mode_movements, modes
from vsgdesign.linear.stability.loops import FullOrderLoop
from vsgdesign.linear.stability.maps import CellSet, full_order_cells, reduced_cells
from vsgdesign.linear.stability.margins import MARGINS, eigenvalues_of, margins_named
from vsgdesign.linear.stability.modes_of_units import asked_apart, differential_modes
from vsgdesign.linear.stability.step_responses import full_order_settling, full_order_step, reduced_step
from vsgdesign.metrics.modes import least_damping, taken
from vsgdesign.report.explore.scene import Scene, Shown, scene_of
from vsgdesign.report.explore.state import State
from vsgdesign.report.explore.wire import Answer
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

STEP_PU = 0.05
"""Size of the linear steps where the event is no step, in per unit of S_rated."""
STEP_S = 2.0
"""Length of the linear steps, s."""
STEP_POINTS = 400
BODE_POINTS = 240
BODE_RAD_S = (1.0, 3000.0)
"""Frequencies of the Bode plot, below half the sampling rate."""
_LARGEST = 1e3
"""Largest value of a step that is drawn, in steps: that of an unstable loop grows without bound."""


def linear_answer(study: Study, ready: Ready, state: State, *, details: bool = False) -> Answer:
    """Modes, margins, Bode and linear steps of every shown controller, and why there are none.

    With ``details``, each mode also has what :func:`modes_answer` says of it, which takes a third of the time.
    ``study`` has the state's changes already. Modes, margins and Bode are those of the full-order model
    (:func:`vsgdesign.linear.stability.margins.full_order_margins`). The steps are those of the full-order and of the
    coupled reduced model, of the size and the signal of the state's event, or of 5 % of P where the event is no step.
    """
    scene = scene_of(study, ready, state)
    is_step = state.event.kind == "step"
    signal, size = (state.event.signal, state.event.size) if is_step else ("P", STEP_PU)
    omega = np.geomspace(BODE_RAD_S[0], min(BODE_RAD_S[1], 0.99 * np.pi / study.converter.T_s), BODE_POINTS)
    held = scene.held is not None
    rows = [row_of(one, scene.cells, k, one.status(scene.grid, held, scene.error)) for k, one in enumerate(scene.shown)]
    arrays: dict[str, NDArray[np.float32]] = {}
    for cells, places in parts_of(scene):
        model = full_order_cells(scene.shown[places[0]].study, cells)
        for row, fault in zip(places, model.faults, strict=True):
            rows[row]["why"] = fault
        places = [places[k] for k in model.index]
        if places:
            reduced = reduced_cells(scene.study, cells.take(model.index))
            for k, figures in zip(places, figures_of(model, signal, details), strict=True):
                rows[k] |= figures
            _add_apart(study, scene.shown[places[0]].study, cells.take(model.index), [rows[k] for k in places])
            start = (scene.P if signal == "P" else scene.Q) / scene.study.converter.S_rated
            for name, values in _drawn(model, reduced, omega, signal).items():
                for k, line in zip(places, values, strict=True):
                    drawn = start + size * line if name in ("step_reduced", "step_full") else line
                    arrays[f"{k}/{name}"] = np.asarray(drawn, dtype=np.float32)
    return Answer({"signal": signal, "step_pu": size, "controllers": rows}, arrays)


def _add_apart(study: Study, own: Study, cells: CellSet, rows: list[dict[str, Any]]) -> None:
    """Adds to the rows what the units against each other do, where the specification asks for it: the study is then a
    unit of a plant. One whose gains let them grow is not stable, whatever the grid says."""
    asked = asked_apart(study)
    if asked == 0.0:
        return
    found = differential_modes(own, cells.gains, cells.P, cells.Q, cells.V_rms, study.grid_source.omega_g)
    for row, s in zip(rows, found.tolist(), strict=True):
        if not math.isfinite(s.real):
            row["note"] = _joined(row["note"], "The units against each other have no steady state to be analysed at")
        elif s.real >= 0.0:
            why = f"the units against each other grow with {s.real:.2g} 1/s at {s.imag / (2.0 * math.pi):.2g} Hz"
            row |= {"stable": False, "why": why}
        else:
            said = f"Against each other the units decay with {-s.real:.2g} 1/s, and {asked:.2g} are asked"
            row["note"] = _joined(row["note"], said)


def _joined(note: str | None, said: str) -> str:
    return f"{note.rstrip('.')}. {said}" if note else said


def modes_answer(study: Study, ready: Ready, state: State) -> Answer:
    """The modes of every shown controller in the order of :func:`linear_answer`, each with the states that take part in
    it (``participation``) and the parameters that move it most (``moved_by``, change of its real part by one per cent
    more of the parameter, 1/s). A page asks for it while a mode is chosen."""
    scene = scene_of(study, ready, state)
    rows: list[dict[str, Any]] = [{"name": one.name, "modes": []} for one in scene.shown]
    for cells, places in parts_of(scene):
        model = full_order_cells(scene.shown[places[0]].study, cells)
        for cell, k in enumerate(model.index.tolist()):
            rows[places[k]]["modes"] = _modes(model, cell, details=True)
    return Answer({"controllers": rows})


def parts_of(scene: Scene) -> Iterator[tuple[CellSet, list[int]]]:
    """The cells that can be analysed, in groups with the same current limiter, each with its rows in the scene."""
    groups: dict[Any, list[int]] = {}
    for k in np.flatnonzero(scene.cells.good).tolist():
        own = scene.shown[k].study
        key = own.current_limiter, own.converter.current_limit_pu, own.limiter_given
        groups.setdefault(key, []).append(k)
    for rows in groups.values():
        yield scene.cells.take(np.array(rows, dtype=np.intp)), rows


def row_of(one: Shown, cells: CellSet, k: int, schedule: str) -> dict[str, Any]:
    """What is known of a controller in a cell without its model. ``schedule`` says what its schedule does there."""
    study, c = one.study, one.study.converter
    P, Q, V_rms = (float(values[k]) for values in (cells.P, cells.Q, cells.V_rms))
    gains = PowerLoopGains(*(float(value[k]) for value in cells.gains))
    known = all(math.isfinite(value) for value in gains)
    current = converter_current_rms(study, study.grid_source.omega_g, P, Q, V_rms)
    droop_P, droop_Q = steady_droops(gains, c.S_rated, c.omega_n, c.V_rated_rms) if known else (math.nan, math.nan)
    return {
        "name": one.name,
        "structure": one.spec.target.structure,
        "schedule": schedule,
        "stable": None,
        "why": cells.faults[k],
        "outside": cells.outside[k],
        "note": one.note,
        "gains": {name: finite(value) for name, value in gains._asdict().items()},
        "operating_point": {
            "P": P,
            "Q": Q,
            "V_pu": finite(V_rms / c.V_rated_rms),
            "delta_deg": finite(math.degrees(float(cells.delta[k]))),
            "i_pu": finite(abs(current) / rated_current_rms(c.S_rated, c.V_rated_rms)),
        },
        "droop_P": finite(droop_P) or None,
        "droop_Q": finite(droop_Q) or None,
        "H_s": finite(float(effective_inertia(gains, c.S_rated, c.omega_n)) if known else math.nan),
        "modes": [],
    } | dict.fromkeys(OF_MODEL)


_SHARES, _MOVERS = 4, 3
"""States and parameters that are listed for each mode."""

OF_MODEL = (
    "disk_margin_output",
    "disk_margin_input",
    "gain_margin_db",
    "phase_margin_deg",
    "crossover_rad_s",
    "phase_crossover_rad_s",
    "gain_margin_Q_db",
    "phase_margin_Q_deg",
    "crossover_Q_rad_s",
    "phase_crossover_Q_rad_s",
    "M_s",
    "damping_all_modes",
    "decay",
    "settling_s",
    "overshoot",
)
"""Figures that need the model of a cell."""


def figures_of(model: FullOrderModel, signal: str, details: bool) -> Iterator[dict[str, Any]]:
    """Figures of every cell of a model; those that an unstable cell does not have are None."""
    margins = margins_named(model, MARGINS)
    eigenvalues = eigenvalues_of(model)
    damping, decay = least_damping(eigenvalues), -eigenvalues.real.max(axis=1)
    settling, overshoot = full_order_settling(model, f"{signal}_ref", signal)
    P, Q = margins["loop_P"], margins["loop_Q"]
    for k in range(len(decay)):
        yield {
            "stable": bool(decay[k] > 0.0),
            **{f"disk_margin_{at}": finite(margins[f"disk_{at}"].value[k]) for at in ("output", "input")},
            "gain_margin_db": finite(P.gain_margin_db[k]),
            "phase_margin_deg": finite(P.phase_margin_deg[k]),
            "crossover_rad_s": finite(P.phase_crossing_rad_s[k]),
            "phase_crossover_rad_s": finite(P.gain_crossing_rad_s[k]),
            "gain_margin_Q_db": finite(Q.gain_margin_db[k]),
            "phase_margin_Q_deg": finite(Q.phase_margin_deg[k]),
            "crossover_Q_rad_s": finite(Q.phase_crossing_rad_s[k]),
            "phase_crossover_Q_rad_s": finite(Q.gain_crossing_rad_s[k]),
            "M_s": finite(margins["M_s"].value[k]),
            "damping_all_modes": finite(damping[k]),
            "decay": finite(decay[k]),
            "settling_s": finite(settling[k]),
            "overshoot": finite(overshoot[k]),
            "modes": _modes(model, k, details),
        }


def _modes(model: FullOrderModel, cell: int, details: bool) -> list[dict[str, Any]]:
    """Modes of a cell, the least stable first; with ``details`` also what takes part in each and what moves it most.

    Modes that decay within one sample have no place in the s-plane and are left out. Of a pair, that with Im s ≥ 0 is
    listed.
    """
    known, count = taken(model.eigen, cell), _SHARES if details else 0
    drawn = [
        mode
        for mode in modes(model.states, model.A[cell], model.T_s, count, known=known)
        if np.isfinite(mode.s) and mode.s.imag >= 0.0
    ]
    found: list[dict[str, Any]] = [
        {"re": mode.s.real, "im": mode.s.imag, "damping": mode.damping, "f_hz": mode.s.imag / (2.0 * math.pi)}
        for mode in drawn
    ]
    if details:
        moved = mode_movements(model, cell)
        for row, mode in zip(found, drawn, strict=True):
            row["participation"] = [[state, finite(share)] for state, share in mode.participation]
            strongest = moved.strongest(mode.s, _MOVERS)
            row["moved_by"] = [[name, finite(0.01 * change.real)] for name, change in strongest]
    return found


def _drawn(model: FullOrderModel, reduced: CoupledModel, omega: Array, signal: str) -> dict[str, Array]:
    """Lines to draw, each with a row for every cell. Steps are per unit of the step."""
    T_s = model.T_s
    every = max(round(STEP_S / STEP_POINTS / T_s), 1)
    t, full = full_order_step(model, f"{signal}_ref", signal, STEP_S, every)
    _, ideal = reduced_step(reduced, f"{signal}_ref", signal, float(t[-1]), every * T_s)
    count, S = len(full), FullOrderLoop(model).on(omega)
    lines = {
        "bode_w": np.tile(omega, (count, 1)),
        "step_t": np.tile(t, (count, 1)),
        "step_reduced": np.clip(ideal, -_LARGEST, _LARGEST),
        "step_full": np.clip(full, -_LARGEST, _LARGEST),
    }
    for k, prefix in enumerate(("bode", "bode_Q")):
        L = 1.0 / S[:, :, k, k] - 1.0
        phase = np.degrees(np.unwrap(np.angle(L), axis=1))
        # The same curve is drawn on the same branch everywhere: it begins between −360 and 0 degrees.
        phase -= 360.0 * np.ceil(phase[:, :1] / 360.0)
        lines |= {f"{prefix}_mag_db": 20.0 * np.log10(np.abs(L)), f"{prefix}_phase_deg": phase}
    return lines


def finite(value: float) -> float | None:
    """A number for JSON; None for what is not finite."""
    return float(value) if math.isfinite(value) else None
