"""The steady state of each part of a scenario by the full-order model, whether it is stable, and how fast it
settles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.frames import instantaneous_power, rms_to_peak
from vsgdesign.metrics import EndState
from vsgdesign.operating_point.at_rest import rest_with_measured_gains
from vsgdesign.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.parameters.network_fields import beyond_models
from vsgdesign.parameters.study import ControllerSpec, Grid, GridSource, Study
from vsgdesign.runtime.of_study import follows_measured, gain_law
from vsgdesign.simulation.gains import GainChange, gain_changes
from vsgdesign.simulation.late import knowledge_of, told_at, told_of
from vsgdesign.simulation.online import pcc_vectors
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.stability.loci import Mode, modes
from vsgdesign.stability.words import mode_in_words

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


def rests(study: Study, timeline: Timeline, changes: Sequence[GainChange], since_s: float = 0.0) -> tuple[Rest, ...]:
    """The steady states in order of time: one for the start, and one for the time after every instant with an event.

    Those that begin before ``since_s`` are left out.
    """
    names: dict[float, str] = {0.0: "the start"}
    for event in study.events:
        names[event.t_s] = (
            f"{names[event.t_s]}, {event.name}" if names.get(event.t_s, "the start") != "the start" else event.name
        )
    instants = [t_s for t_s in sorted(names) if t_s >= since_s]
    ends = [*instants[1:], study.simulation.duration]
    cells: list[Cell] = []
    begun = []
    for t_s, end_s in zip(instants, ends, strict=True):
        source, grid = timeline.source_at(end_s - 1e-9), timeline.grid_at(t_s)
        gains = [change.gains for change in changes if change.t_s < end_s or change.t_s == 0.0][-1]
        cells.append(Cell(grid, gains, *timeline.references_at(t_s), GridSource(source.V_g_rms, source.omega)))
        ramps = [later.t_s for before, later in itertools.pairwise(timeline.sources) if not before.steady]
        ramp_end = max([t_s, *(t for t in ramps if t_s < t <= end_s)])
        begun.append((t_s, end_s, grid, ramp_end, source))
    model = linearise_full_order(study, cells)
    place = {int(cell): k for k, cell in enumerate(model.index)}
    found = []
    for k, (t_s, end_s, grid, ramp_end, source) in enumerate(begun):
        obstacle = model.faults[k]
        if not source.steady:
            obstacle = "the source is still on its ramp when the window ends"
        beyond = beyond_models(timeline.network_at(t_s))
        obstacle = beyond or obstacle
        P, Q, mode = math.nan, math.nan, None
        if obstacle is None:
            P, Q = _powers_at_pcc(study, model, place[k], cells[k])
            mode = modes(model.states, model.A[place[k]], model.T_s, count=len(model.states), most=1)[0]
        found.append(
            Rest(
                t_s=t_s,
                end_s=end_s,
                name=names[t_s],
                grid=grid,
                P_pcc=P,
                Q_pcc=Q,
                mode=mode,
                obstacle=obstacle,
                ramp_end_s=ramp_end,
                omega_g=source.omega,
                ramping=not source.steady,
                modelled=beyond is None,
            )
        )
    return tuple(found)


def expected_rests(
    study: Study, timeline: Timeline, spec: ControllerSpec, ready: Ready = NOTHING, since_s: float = 0.0
) -> tuple[Rest, ...]:
    """:func:`rests` before a run: a controller that estimates the grid is given the gains of the true one, one that is
    told a wrong grid those of what it is told at the end of each part, one whose gains follow what it measures those of
    its own steady state.

    Empty where it has none on some grid of the scenario. Rests that begin before ``since_s`` are left out.
    """
    study = study.with_limit_of(spec)
    try:
        known = replace(spec, estimate="truth", update_period=ready.update_period(spec))
        if follows_measured(known) or knowledge_of(known, timeline) is not None:
            return rests(study, timeline, _measured_changes(study, timeline, known, ready, since_s), since_s)
        return rests(study, timeline, gain_changes(study, known, timeline), since_s)
    except InfeasibleStudyError:
        if spec.estimate == "truth":
            raise
        return ()


def knows_its_rests(study: Study, spec: ControllerSpec, timeline: Timeline) -> bool:
    """Whether the gains at the end of each part of a scenario follow from what is told of the grid there. In a long
    silence they also depend on what came before."""
    knowledge = knowledge_of(spec, timeline)
    if knowledge is None:
        return True
    told = told_of(study, knowledge, timeline)
    ends = (*sorted({event.t_s for event in study.events if event.t_s > 0.0}), study.simulation.duration)
    return all(told_at(told, end_s - 1e-9)[1] for end_s in ends)


def _measured_changes(
    study: Study, timeline: Timeline, spec: ControllerSpec, ready: Ready, since_s: float
) -> tuple[GainChange, ...]:
    """The gains of the steady state after every event, where they follow the measured P, Q and V; without a steady
    state those at the references, so that :func:`rests` says what is missing."""
    law, changes = gain_law(study, spec, ready), []
    knowledge = knowledge_of(spec, timeline)
    told = None if knowledge is None else told_of(study, knowledge, timeline)
    instants = sorted({0.0, *(event.t_s for event in study.events)})
    instants = [t_s for t_s in instants if t_s >= since_s]
    for t_s, end_s in zip(instants, [*instants[1:], study.simulation.duration], strict=True):
        grid, source = timeline.grid_at(t_s), timeline.source_at(end_s - 1e-9)
        known = grid if told is None else told_at(told, end_s - 1e-9)[0]

        def gains_of(P: float, Q: float, V_rms: float, known: Grid = known) -> PowerLoopGains:
            return PowerLoopGains(*(float(value) for value in law(known.R_g, known.L_g, P, Q, V_rms)))

        references = timeline.references_at(t_s)
        try:
            at_end = GridSource(source.V_g_rms, source.omega)
            gains = rest_with_measured_gains(study, grid, at_end, *references, gains_of)[1]
        except InfeasibleStudyError:
            gains = gains_of(*references, study.converter.V_rated_rms)
            if not np.isfinite(gains).all():
                raise
        changes.append(GainChange(t_s, gains))
    return tuple(changes)


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
