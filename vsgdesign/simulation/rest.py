"""The steady state of each part of a scenario by the full-order model, whether it is stable, and how fast it
settles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.equilibrium import OperatingPoint, point_at
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.linear.operating_point.many import powers_at_pcc
from vsgdesign.linear.stability.loci import Mode, mode_in_words, modes
from vsgdesign.metrics import EndState
from vsgdesign.metrics.modes import taken
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.timeline import SourceSegment, Timeline
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.network_fields import beyond_models
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_STILL = -1e-6
"""A mode that decays more slowly than this, 1/s, counts as one that does not decay."""


@dataclass(frozen=True, kw_only=True)
class Rest:
    """The steady state that a controller approaches between two events: with both of its droops, its limits and the
    gains at the end of this time (docs/definitions.md).

    It is that of the averaged bridge. ``point`` has the values at the control point, ``P_pcc`` (W) and ``Q_pcc`` (var)
    are those at the PCC. ``mode`` is the slowest mode of this state, or the fastest growing one if it is unstable.
    ``obstacle`` says why there is no such state. There is then neither a point nor a mode, and both powers are NaN.
    """

    t_s: float
    end_s: float
    name: str
    """What happened at t_s."""
    grid: Grid
    source: GridSource
    """At the end."""
    gains: PowerLoopGains
    point: OperatingPoint | None
    P_pcc: float
    Q_pcc: float
    mode: Mode | None
    obstacle: str | None
    ramp_end_s: float
    """When the source's last ramp in the stretch is over, s; t_s without one."""
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
        cycle = max(round(2.0 * math.pi / self.source.omega_g / interval), 1)
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


class Part(NamedTuple):
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
    parts = [parts_of(one, since_s) for one in several]
    found: list[tuple[Rest, ...]] = [()] * len(several)
    for group in alike([one.study for one in several]):
        cells = [part.cell for k in group for part in parts[k]]
        model = linearise_full_order(several[group[0]].study, cells)
        rows = {int(cell): row for row, cell in enumerate(model.index)}
        first = 0
        for k in group:
            found[k] = tuple(
                _rest(several[k], part, model, first + j, rows.get(first + j)) for j, part in enumerate(parts[k])
            )
            first += len(parts[k])
    return found


def alike(studies: Sequence[Study]) -> list[list[int]]:
    """Which studies have the same full-order model but for grid, source, references and gains."""
    groups: list[tuple[tuple[object, ...], list[int]]] = []
    for k, one in enumerate(studies):
        made_of = one.converter, one.filter, one.inner_gains, one.limiter, one.controller_settings(), one.notch
        made_of += one.tau_P, one.tau_Q, one.dc
        for known, group in groups:
            if known == made_of:
                group.append(k)
                break
        else:
            groups.append((made_of, [k]))
    return [group for _, group in groups]


def parts_of(asked: RestsAsked, since_s: float = 0.0) -> list[Part]:
    """The parts of a scenario from ``since_s`` on, in order of time."""
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
        at_end = GridSource(source.V_g_rms, source.omega)
        cell = Cell.with_references(grid, gains, timeline.references_at(t_s), at_end, timeline.link_at(t_s))
        ramp_end = max([t_s, *(t for t in ramps if t_s < t <= end_s)])
        found.append(Part(t_s, end_s, names[t_s], source, ramp_end, cell))
    return found


def _rest(asked: RestsAsked, part: Part, model: FullOrderModel, cell: int, row: int | None) -> Rest:
    """The rest of a part, which is a cell of a model and, if it has a steady state, a row of its matrices."""
    study, source, grid, at = asked.study, part.source, part.cell.grid, part.cell.source or asked.study.grid_source
    beyond = beyond_models(asked.timeline.network_at(part.t_s))
    obstacle = model.faults[cell] if source.steady else "the source is still on its ramp when the window ends"
    obstacle = beyond or obstacle
    P, Q, point, mode = math.nan, math.nan, None, None
    if obstacle is None and row is not None and (states := model.steady) is not None:
        P, Q = (float(power[cell]) for power in powers_at_pcc(study, states, part.cell.lanes(study)))
        point = point_at(
            *(float(states.P[cell]), float(states.Q[cell]), float(states.V[cell]), float(states.delta[cell])),
            *study.path_to_grid(grid, at.omega_g),
            study.converter.V_limits_rms,
        )
        known = taken(model.eigen, row)
        mode = modes(model.states, model.A[row], model.T_s, count=len(model.states), known=known, most=1)[0]
    return Rest(
        t_s=part.t_s,
        end_s=part.end_s,
        name=part.name,
        grid=grid,
        source=at,
        gains=part.cell.gains,
        point=point,
        P_pcc=P,
        Q_pcc=Q,
        mode=mode,
        obstacle=obstacle,
        ramp_end_s=part.ramp_end_s,
        ramping=not source.steady,
        modelled=beyond is None,
    )


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
