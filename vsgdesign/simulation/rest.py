"""The steady state of each part of a scenario by the full-order model, whether it is stable, and how fast it
settles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.equations.frames import instantaneous_power, rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.linear.operating_point.many import Lanes
from vsgdesign.linear.operating_point.many_rests import (
    GainsOfMeasured,
    many_rests_with_measured_gains,
    rest_with_measured_gains,
)
from vsgdesign.linear.stability.loci import Mode, mode_in_words, modes
from vsgdesign.metrics import EndState
from vsgdesign.metrics.modes import taken
from vsgdesign.runtime.of_study import follows_measured, gain_law
from vsgdesign.simulation.at_pcc import pcc_vectors
from vsgdesign.simulation.feeds import knowledge_of, told_at, told_of
from vsgdesign.simulation.gains import GainChange, gain_changes
from vsgdesign.simulation.timeline import SourceSegment, Timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.network_fields import beyond_models
from vsgdesign.study.parameters.source import GridSource
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_STILL = -1e-6
"""A mode that decays more slowly than this, 1/s, counts as one that does not decay."""


@dataclass(frozen=True, kw_only=True)
class Rest:
    """The steady state that a controller approaches between two events, with the gains at the end of this time.

    ``P_pcc`` (W) and ``Q_pcc`` (var) are those of the averaged bridge and include the droops. ``mode`` is the slowest
    mode of this state, or the fastest growing one if it is unstable. ``obstacle`` says why there is no such state. Both
    powers are then NaN, and there is no mode.
    """

    t_s: float
    end_s: float
    name: str
    """What happened at t_s."""
    grid: Grid
    P_pcc: float
    Q_pcc: float
    mode: Mode | None
    obstacle: str | None
    ramp_end_s: float
    """When the source's last ramp in the stretch is over, s; t_s without one."""
    omega_g: float
    """Of the source at the end, rad/s."""
    ramping: bool = False
    """Whether the source is still on a ramp at the end."""
    modelled: bool = True
    """Whether the full-order model knows the circuit. It has no load, no fault and no open breaker."""

    @property
    def stable(self) -> bool:
        """Whether every mode decays. It is True if there is no steady state."""
        return self.mode is None or self.mode.s.real < _STILL

    def end_state(self, signal: str, ripples: bool, interval: float) -> EndState:
        """For the figures of ``P_pcc`` or ``Q_pcc``, logged every ``interval`` s."""
        if self.mode is None:
            return EndState(None, None, self.obstacle, self.ramp_end_s, modelled=self.modelled)
        final = self.P_pcc if signal == "P_pcc" else self.Q_pcc
        decay = -self.mode.s.real if self.stable else min(-self.mode.s.real, 0.0)
        cycle = max(round(2.0 * math.pi / self.omega_g / interval), 1)
        reason = None if self.stable else f"unstable: {mode_in_words(self.mode)}"
        return EndState(None if ripples else final, decay, reason, self.ramp_end_s, cycle)


@dataclass(frozen=True, kw_only=True)
class Instability:
    """A part of a scenario in which a controller has no stable state to come to, on one grid."""

    controller: str
    t_s: float
    end_s: float
    event: str
    """What happened at t_s."""
    grid: Grid
    mode: Mode
    """The fastest growing one."""
    message: str


class RestsAsked(NamedTuple):
    """A controller whose rests are asked for: the study with its current limit, and its gains over the scenario."""

    study: Study
    timeline: Timeline
    changes: Sequence[GainChange]


class _Part(NamedTuple):
    """The time between two instants with events, with what a controller comes to rest at."""

    t_s: float
    end_s: float
    name: str
    source: SourceSegment
    ramp_end_s: float
    cell: Cell


def rests(study: Study, timeline: Timeline, changes: Sequence[GainChange], since_s: float = 0.0) -> tuple[Rest, ...]:
    """The steady states in order of time: one for the start, and one for the time after every instant with an event.

    Those that begin before ``since_s`` are left out.
    """
    return rests_of([RestsAsked(study, timeline, changes)], since_s)[0]


def rests_of(several: Sequence[RestsAsked], since_s: float = 0.0) -> list[tuple[Rest, ...]]:
    """:func:`rests` of several controllers. Those of the same converter and limiter are linearised together."""
    parts = [_parts(one, since_s) for one in several]
    found: list[tuple[Rest, ...]] = [()] * len(several)
    for group in _alike([one.study for one in several]):
        cells = [part.cell for k in group for part in parts[k]]
        model = linearise_full_order(several[group[0]].study, cells)
        rows = {int(cell): row for row, cell in enumerate(model.index)}
        first = 0
        for k in group:
            found[k] = tuple(
                _rest(several[k], part, model, rows.get(first + j), model.faults[first + j])
                for j, part in enumerate(parts[k])
            )
            first += len(parts[k])
    return found


def _alike(studies: Sequence[Study]) -> list[list[int]]:
    """Which studies have the same full-order model but for grid, source, references and gains."""
    groups: list[tuple[tuple[object, ...], list[int]]] = []
    for k, one in enumerate(studies):
        made_of = one.converter, one.filter, one.inner_gains, one.limiter, one.controller_settings(), one.notch
        made_of += one.tau_P, one.tau_Q
        for known, group in groups:
            if known == made_of:
                group.append(k)
                break
        else:
            groups.append((made_of, [k]))
    return [group for _, group in groups]


def _parts(asked: RestsAsked, since_s: float) -> list[_Part]:
    study, timeline, changes = asked
    names: dict[float, str] = {0.0: "the start"}
    for event in study.events:
        names[event.t_s] = (
            f"{names[event.t_s]}, {event.name}" if names.get(event.t_s, "the start") != "the start" else event.name
        )
    instants = [t_s for t_s in sorted(names) if t_s >= since_s]
    ends = [*instants[1:], study.simulation.duration]
    ramps = [later.t_s for before, later in itertools.pairwise(timeline.sources) if not before.steady]
    found = []
    for t_s, end_s in zip(instants, ends, strict=True):
        source, grid = timeline.source_at(end_s - 1e-9), timeline.grid_at(t_s)
        gains = [change.gains for change in changes if change.t_s < end_s or change.t_s == 0.0][-1]
        cell = Cell.with_references(grid, gains, timeline.references_at(t_s), GridSource(source.V_g_rms, source.omega))
        ramp_end = max([t_s, *(t for t in ramps if t_s < t <= end_s)])
        found.append(_Part(t_s, end_s, names[t_s], source, ramp_end, cell))
    return found


def _rest(asked: RestsAsked, part: _Part, model: FullOrderModel, row: int | None, fault: str | None) -> Rest:
    source = part.source
    obstacle = fault if source.steady else "the source is still on its ramp when the window ends"
    beyond = beyond_models(asked.timeline.network_at(part.t_s))
    obstacle = beyond or obstacle
    P, Q, mode = math.nan, math.nan, None
    if obstacle is None and row is not None:
        P, Q = _powers_at_pcc(asked.study, model, row, part.cell)
        known = taken(model.eigen, row)
        mode = modes(model.states, model.A[row], model.T_s, count=len(model.states), known=known, most=1)[0]
    return Rest(
        t_s=part.t_s,
        end_s=part.end_s,
        name=part.name,
        grid=part.cell.grid,
        P_pcc=P,
        Q_pcc=Q,
        mode=mode,
        obstacle=obstacle,
        ramp_end_s=part.ramp_end_s,
        omega_g=source.omega,
        ramping=not source.steady,
        modelled=beyond is None,
    )


def expected_rests(
    study: Study, timeline: Timeline, spec: ControllerSpec, ready: Ready = NOTHING, since_s: float = 0.0
) -> tuple[Rest, ...]:
    """:func:`rests` before a run: a controller that estimates the grid is given the gains of the true one, one that is
    told a wrong grid those of what it is told at the end of each part, one whose gains follow what it measures those of
    its own steady state.

    Empty where it has none on some grid of the scenario. Rests that begin before ``since_s`` are left out.
    """
    found = expected_rests_of([(study, timeline, spec)], ready, since_s)[0]
    if isinstance(found, InfeasibleStudyError):
        raise found
    return found


def expected_rests_of(
    several: Sequence[tuple[Study, Timeline, ControllerSpec]], ready: Ready = NOTHING, since_s: float = 0.0
) -> list[tuple[Rest, ...] | InfeasibleStudyError]:
    """:func:`expected_rests` of several controllers in less time than one after the other, with the error of each that
    has none."""
    found: list[tuple[Rest, ...] | InfeasibleStudyError] = [()] * len(several)
    asked: dict[int, RestsAsked] = {}
    own = [study.with_limit_of(spec) for study, _, spec in several]
    for k, changes in enumerate(_changes_of(own, several, ready, since_s)):
        if isinstance(changes, InfeasibleStudyError):
            found[k] = changes if several[k][2].estimate == "truth" else ()
        else:
            asked[k] = RestsAsked(own[k], several[k][1], changes)
    for k, rests_of_one in zip(asked, rests_of(list(asked.values()), since_s), strict=True):
        found[k] = rests_of_one
    return found


class _Measured(NamedTuple):
    """A part of a scenario in which gains follow what is measured: what is asked for its steady state."""

    study: Study
    t_s: float
    grid: Grid
    source: GridSource
    references: References
    gains_of: GainsOfMeasured


def _changes_of(
    own: Sequence[Study],
    several: Sequence[tuple[Study, Timeline, ControllerSpec]],
    ready: Ready,
    since_s: float,
) -> list[tuple[GainChange, ...] | InfeasibleStudyError]:
    """The gains of each controller in the steady states of its scenario, or the error of one that has none."""
    found: list[tuple[GainChange, ...] | InfeasibleStudyError] = [()] * len(several)
    measured: list[tuple[int, _Measured]] = []
    for k, (study, (_, timeline, spec)) in enumerate(zip(own, several, strict=True)):
        known = replace(spec, estimate="truth", update_period=ready.update_period(spec))
        try:
            if follows_measured(known) or knowledge_of(known, timeline) is not None:
                measured += [(k, part) for part in _measured_parts(study, timeline, known, ready, since_s)]
            else:
                found[k] = gain_changes(study, known, timeline)
        except InfeasibleStudyError as error:
            found[k] = error
    for (k, part), gains in zip(measured, _measured_gains([part for _, part in measured]), strict=True):
        before = found[k]
        if isinstance(before, InfeasibleStudyError):
            continue
        found[k] = gains if isinstance(gains, InfeasibleStudyError) else (*before, GainChange(part.t_s, gains))
    return found


def knows_its_rests(study: Study, spec: ControllerSpec, timeline: Timeline) -> bool:
    """Whether the gains at the end of each part of a scenario follow from what is told of the grid there. In a long
    silence they also depend on what came before."""
    knowledge = knowledge_of(spec, timeline)
    if knowledge is None:
        return True
    told = told_of(study, knowledge, timeline)
    ends = (*sorted({event.t_s for event in study.events if event.t_s > 0.0}), study.simulation.duration)
    return all(told_at(told, end_s - 1e-9)[1] for end_s in ends)


def _measured_parts(
    study: Study, timeline: Timeline, spec: ControllerSpec, ready: Ready, since_s: float
) -> list[_Measured]:
    law = gain_law(study, spec, ready)
    knowledge = knowledge_of(spec, timeline)
    told = None if knowledge is None else told_of(study, knowledge, timeline)
    instants = sorted({0.0, *(event.t_s for event in study.events)})
    instants = [t_s for t_s in instants if t_s >= since_s]
    found = []
    for t_s, end_s in zip(instants, [*instants[1:], study.simulation.duration], strict=True):
        grid, source = timeline.grid_at(t_s), timeline.source_at(end_s - 1e-9)
        known = grid if told is None else told_at(told, end_s - 1e-9)[0]

        def gains_of(P: float, Q: float, V_rms: float, known: Grid = known) -> PowerLoopGains:
            return PowerLoopGains(*(float(value) for value in law(known.R_g, known.L_g, P, Q, V_rms)))

        at_end = GridSource(source.V_g_rms, source.omega)
        found.append(_Measured(study, t_s, grid, at_end, timeline.references_at(t_s), gains_of))
    return found


def _measured_gains(parts: Sequence[_Measured]) -> list[PowerLoopGains | InfeasibleStudyError]:
    """The gains of the steady states, where they follow the measured P, Q and V; without a steady state those at the
    references, so that :func:`rests` says what is missing."""
    found: list[PowerLoopGains | InfeasibleStudyError] = [PowerLoopGains(0.0, 0.0, 0.0, 0.0)] * len(parts)
    for group in _alike([part.study for part in parts]):
        some = [parts[k] for k in group]
        at = [Lanes.at(p.grid, p.source, p.references) for p in some]

        def of_many(P: Array, Q: Array, V: Array, some: Sequence[_Measured] = some) -> PowerLoopGains:
            of_each = zip(some, P.tolist(), Q.tolist(), V.tolist(), strict=True)
            return PowerLoopGains(*np.array([part.gains_of(*measured) for part, *measured in of_each]).T)

        states, gains = many_rests_with_measured_gains(some[0].study, Lanes(*np.array(at).T), of_many)
        for k, fault, row in zip(group, states.fault.tolist(), np.array(gains).T.tolist(), strict=True):
            found[k] = _at_references(parts[k]) if fault else PowerLoopGains(*row)
    return found


def _at_references(part: _Measured) -> PowerLoopGains | InfeasibleStudyError:
    refs = part.references
    gains = part.gains_of(refs.P_ref, refs.Q_ref, part.study.converter.V_rated_rms)
    if np.isfinite(gains).all():
        return gains
    try:
        return rest_with_measured_gains(part.study, part.grid, part.source, refs, part.gains_of)[1]
    except InfeasibleStudyError as error:
        return error


def instabilities(study: Study, spec: ControllerSpec, found: Sequence[Rest]) -> tuple[Instability, ...]:
    """The unstable parts of a scenario, one for each stretch on one grid, with a sentence on each."""
    said = []
    unstable = [rest for rest in found if not rest.stable]
    while unstable:
        part = [unstable.pop(0)]
        while unstable and unstable[0].grid == part[0].grid and unstable[0].t_s == part[-1].end_s:
            part.append(unstable.pop(0))
        mode = max((rest.mode for rest in part if rest.mode is not None), key=lambda one: one.s.real)
        first = part[0]
        place = first.grid.place(study.converter, study.scr_basis)
        grid = f"SCR {place.scr:.3g}, X/R {place.x_over_r:.3g}"
        since = "from the start" if first.t_s == 0.0 else f"from {first.t_s:g} s"
        event = "" if first.t_s == 0.0 or first.name == grid else f", after {first.name}"
        message = (
            f"controller {spec.name} is unstable {since} to {part[-1].end_s:g} s, on {grid}{event}: "
            f"{mode_in_words(mode)}. The full-order model has no stable state there: this part of the run shows the "
            "mode, not a response."
        )
        said.append(
            Instability(
                controller=spec.name,
                t_s=first.t_s,
                end_s=part[-1].end_s,
                event=first.name,
                grid=first.grid,
                mode=mode,
                message=message,
            )
        )
    return tuple(said)


WHERE_TO_LOOK = (
    "Look at it with vsgdesign margins and vsgdesign report; what helps is in docs/how-to/inner-loops.md (modes of "
    "network and inner loops) and docs/how-to/margins-and-maps.md (power loops)."
)
"""Said once after all instabilities."""


def powers_at_control_point(study: Study, model: FullOrderModel, row: int) -> tuple[float, float]:
    """P (W) and Q (var) at the filter capacitor of a steady state: what the controller measures."""
    z = dict(zip(model.states, model.z[row], strict=True))
    circuit = study.circuit()
    d, q = (capacitor_node_voltage(z[f"i_s_{axis}"], z[f"v_c_{axis}"], z[f"i_g_{axis}"], circuit) for axis in "dq")
    P, Q = instantaneous_power(d, q, z["i_g_d"], z["i_g_q"])
    return float(P), float(Q)


def _powers_at_pcc(study: Study, model: FullOrderModel, row: int, cell: Cell) -> tuple[float, float]:
    """P (W) and Q (var) at the PCC of a steady state, whose source is at phase zero."""
    z = dict(zip(model.states, model.z[row], strict=True))
    source = cell.source or study.grid_source
    plant = [z[f"{name}_{axis}"] for name in ("i_s", "v_c", "i_g") for axis in "dq"]
    log = np.array([[*plant, rms_to_peak(source.V_g_rms), 0.0]])
    v_pcc, i_pcc = pcc_vectors(log, study.circuit(cell.grid))
    P, Q = instantaneous_power(*v_pcc[0], *i_pcc[0])
    return float(P), float(Q)
