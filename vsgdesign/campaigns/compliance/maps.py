"""Survival maps: sag depth over duration, phase jump over SCR, and the critical clearing time over SCR and X/R.

Every cell is an EMT run, and the runs of a map lie side by side in one batch (:mod:`vsgdesign.simulation.lanes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.metrics.survival import SURVIVED
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, LaneCases, LaneEvents, no_events
from vsgdesign.simulation.lanes.results import JUDGED, NO_REST, OVER_LIMIT, STATUSES, LaneResults
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.lanes.telling import learns, told_controller
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S
from vsgdesign.simulation.survival.verdicts import LENGTHS_S, ClearingTimes, Verdicts, critical_clearing_times
from vsgdesign.study.parameters.event import BASIS
from vsgdesign.study.parameters.grid import PLAIN, GridSource, Place
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

SILENT_S = 0.2
"""For how long the schedule gets no estimate after every change of the grid or its source, s."""

LOADED_PU = 0.5
"""P_ref of every map, pu."""

X_OVER_R_OF_MAPS = 3.0
SAG_SCR = 3.0
"""The grid of the map of sags, and the X/R of the map of phase jumps."""

DEPTHS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
LENGTHS_OF_SAGS_S = (0.02, 0.05, 0.1, 0.15, 0.25, 0.4, 0.6, 1.0, 1.5, 2.5)
PHASES_DEG = tuple(float(value) for value in range(-180, 181, 15) if value)
SCR = (1.2, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
X_OVER_R = (0.3, 1.0, 3.0, 10.0, 20.0)


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One axis of a map."""

    name: str
    label: str
    unit: str
    values: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class SurvivalMap:
    """One quantity over two axes, for one controller."""

    key: str
    """A name of :data:`KINDS`."""
    title: str
    controller: str
    x: Axis
    y: Axis
    values: tuple[tuple[float | None, ...], ...]
    """A row for each value of y. None: the cell has none, and ``status`` says why."""
    status: tuple[tuple[str, ...], ...]
    """``survived``, how it was lost, or why there is no verdict."""
    label: str
    """What the values are."""
    unit: str
    words: str
    """What was run, in whole sentences."""

    def document(self) -> dict[str, Any]:
        """The map in the types of JSON."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Mapped:
    """A controller whose maps are asked for."""

    study: Study
    spec: ControllerSpec
    ready: Ready


def survival_map(kind: str, mapped: Mapped) -> SurvivalMap:
    """One map of a controller, by its name in :data:`KINDS`. A controller without a current limit has maps too.

    The grid's voltage is sinusoidal and the sensors are ideal, whatever the study says. A schedule is told the true
    grid 0.2 s after every change; a field estimator runs and learns the grid by itself. Raises InfeasibleStudyError
    where the study cannot be run in a batch.
    """
    return KINDS[kind](replace(mapped, study=_plain(mapped.study), spec=told_controller(mapped.spec)))


def _plain(study: Study) -> Study:
    source = GridSource(study.converter.V_rated_rms, study.converter.omega_n)
    return replace(study.undisturbed, grid_source=source, network=PLAIN, events=())


def _sags(mapped: Mapped) -> SurvivalMap:
    length, depth = (one.ravel() for one in np.meshgrid(LENGTHS_OF_SAGS_S, DEPTHS))
    events = no_events(len(depth), 2)
    _sag(mapped, events, depth, length)
    results = _run(mapped, np.full(len(depth), SAG_SCR), X_OVER_R_OF_MAPS, events, length)
    return _of_recoveries(
        mapped,
        "sag",
        "Sags",
        Axis(name="length_s", label="Duration of the sag", unit="s", values=LENGTHS_OF_SAGS_S),
        Axis(name="V_g_pu", label="Voltage that remains", unit="pu", values=DEPTHS),
        results,
        f"The grid's voltage falls to what remains and comes back, at SCR {SAG_SCR:g} and X/R {X_OVER_R_OF_MAPS:g}.",
    )


def _phase_jumps(mapped: Mapped) -> SurvivalMap:
    scr, jump = (one.ravel() for one in np.meshgrid(SCR, PHASES_DEG))
    events = no_events(len(scr))
    events.t_s[:, 0], events.phase_jump[:, 0] = _lead_s(mapped), np.radians(jump)
    results = _run(mapped, scr, X_OVER_R_OF_MAPS, events, np.zeros(len(scr)))
    return _of_recoveries(
        mapped,
        "phase",
        "Jumps of the grid's phase",
        Axis(name="scr", label="SCR", unit="1", values=SCR),
        Axis(name="phase_deg", label="Jump of the phase", unit="°", values=PHASES_DEG),
        results,
        f"The phase of the grid jumps, at X/R {X_OVER_R_OF_MAPS:g}.",
    )


def _clearing(mapped: Mapped) -> SurvivalMap:
    scr, x_over_r = (one.ravel() for one in np.meshgrid(SCR, X_OVER_R))
    found, refused = clearing_times_of(mapped, scr, x_over_r, LOADED_PU)
    words = ["a longer fault is lost" if one else f"survived up to {LENGTHS_S[-1]:g} s" for one in found.bounded]
    return SurvivalMap(
        key="clearing",
        title="Critical clearing time",
        controller=mapped.spec.name,
        x=Axis(name="scr", label="SCR", unit="1", values=SCR),
        y=Axis(name="x_over_r", label="X/R", unit="1", values=X_OVER_R),
        values=_rows(found.longest_s, len(SCR)),
        status=_rows_of_words([why or one for one, why in zip(words, refused, strict=True)], len(SCR)),
        label="Longest fault that is survived",
        unit="s",
        words=_words(
            mapped,
            "The grid's voltage is zero for some time. The critical clearing time is the longest such fault that is "
            f"survived together with every shorter one that was tried: twelve lengths up to {LENGTHS_S[-1]:g} s, then "
            "bisection to 5 ms.",
        ),
    )


def clearing_times_of(
    mapped: Mapped, scr: Array, x_over_r: Array, P_pu: float
) -> tuple[ClearingTimes, tuple[str, ...]]:
    """Critical clearing times of a fault that takes the whole voltage of the grid, in cells with SCR and X/R (n,).

    The second result says for each cell why there is no verdict; it is empty where there is one.
    """
    refused = [""] * len(scr)

    def faults_of(index: NDArray[np.intp], length_s: Array) -> Verdicts:
        events = no_events(len(index), 2)
        _sag(mapped, events, np.zeros(len(index)), length_s)
        results = _run(mapped, scr[index], x_over_r[index], events, length_s, P_pu)
        judged = ~np.isin(results.status, (NO_REST, OVER_LIMIT))
        for cell, code in zip(index[~judged], results.status[~judged], strict=True):
            refused[cell] = STATUSES[code]
        return Verdicts(judged, results.status == JUDGED)

    return critical_clearing_times(faults_of, len(scr)), tuple(refused)


KINDS: dict[str, Callable[[Mapped], SurvivalMap]] = {"sag": _sags, "phase": _phase_jumps, "clearing": _clearing}
"""Every map by its name."""


def _lead_s(mapped: Mapped) -> float:
    return LEARNING_S if learns(mapped.spec) else LEAD_S


def _sag(mapped: Mapped, events: LaneEvents, V_pu: Array, length_s: Array) -> None:
    V_rated, lead_s = mapped.study.converter.V_rated_rms, _lead_s(mapped)
    events.t_s[:, 0], events.t_s[:, 1] = lead_s, lead_s + length_s
    events.V_g_rms[:, 0], events.V_g_rms[:, 1] = V_pu * V_rated, V_rated


def _run(
    mapped: Mapped,
    scr: Array,
    x_over_r: Array | float,
    events: LaneEvents,
    cleared_after_s: Array,
    P_pu: float = LOADED_PU,
) -> LaneResults:
    """The runs of cells with SCR and X/R (n,), whose last change is over ``cleared_after_s`` after the first."""
    c, count = mapped.study.converter, len(scr)
    places = [Place(float(a), float(b), BASIS) for a, b in zip(scr, np.broadcast_to(x_over_r, scr.shape), strict=True)]
    grids = [place.grid(c) for place in places]
    none = np.zeros(count)
    cases = LaneCases(
        R_g=np.array([grid.R_g for grid in grids]),
        L_g=np.array([grid.L_g for grid in grids]),
        V_g_rms=none + c.V_rated_rms,
        omega_g=none + c.omega_n,
        P_ref=none + P_pu * c.S_rated,
        Q_ref=none,
        events=events,
        error_R=none,
        error_X=none,
        silent_s=none + SILENT_S,
        cleared_s=_lead_s(mapped) + cleared_after_s,
        kind=np.full(count, DISTURBANCE, dtype=np.int8),
        signal=np.full(count, ACTIVE, dtype=np.int8),
    )
    return run_lanes(mapped.study, mapped.spec, mapped.ready, cases)


def _of_recoveries(
    mapped: Mapped, key: str, title: str, x: Axis, y: Axis, results: LaneResults, what: str
) -> SurvivalMap:
    survived = results.status == JUDGED
    status = [SURVIVED if good else STATUSES[code] for good, code in zip(survived, results.status, strict=True)]
    return SurvivalMap(
        key=key,
        title=title,
        controller=mapped.spec.name,
        x=x,
        y=y,
        values=_rows(np.where(survived, results.recovery_s, np.nan), len(x.values)),
        status=_rows_of_words(status, len(x.values)),
        label="Time to the new rest",
        unit="s",
        words=_words(mapped, what),
    )


def _words(mapped: Mapped, what: str) -> str:
    told = ""
    if mapped.spec.kind == "scheduled":
        told = f" The schedule gets no estimate for {SILENT_S:g} s after every change, and the true grid then."
    if learns(mapped.spec):
        told = f" The estimator runs in the loop, and it has {LEARNING_S:g} s to learn the grid first."
    return f"{what} The converter delivers {LOADED_PU:g} pu before and after.{told}"


def _rows(values: Array, columns: int) -> tuple[tuple[float | None, ...], ...]:
    """Rows of numbers to four digits; None where there is none."""
    found = [None if not math.isfinite(value) else float(f"{value:.4g}") for value in values]
    return tuple(tuple(found[k : k + columns]) for k in range(0, len(found), columns))


def _rows_of_words(words: list[str], columns: int) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(words[k : k + columns]) for k in range(0, len(words), columns))
