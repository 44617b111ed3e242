"""One controller of a study as it is exported: its schedule, its constants, and the state in which it begins."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.codegen.described import described_numbers
from vsgdesign.equations.controller import V_PLAUSIBLE, ControllerState
from vsgdesign.equations.dc_link import LEAST_VOLTAGE
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.equations.field import FieldAnswer, FieldSettings, FieldTrack, LockIn
from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.equations.scheduler_data import HELD
from vsgdesign.errors import ArtifactError, Fault, InfeasibleStudyError, StudyError
from vsgdesign.export.c_content import Origin
from vsgdesign.export.field import ConverterConstants, converter_constants
from vsgdesign.identification.field import FINDS_WITHIN
from vsgdesign.identification.interface import samples_itself
from vsgdesign.runtime.guards import box_settings, searching_settings
from vsgdesign.runtime.of_study import schedule_of
from vsgdesign.runtime.scheduler import Scheduler, closed_form_scheduler, scheduler_of
from vsgdesign.study.parameters.controllers import UPDATE_PERIOD
from vsgdesign.study.parameters.grid import Grid

if TYPE_CHECKING:
    from vsgdesign.linear.operating_point.sampled import SampledState
    from vsgdesign.study.parameters.study import ControllerSpec, Study


@dataclass(frozen=True)
class Starts:
    """Start values of the parameters of a wrapper."""

    P_start: float
    Q_start: float
    V_start: float
    theta_start: float
    i_max_pk: float


@dataclass(frozen=True)
class Clamp:
    """How the controller asks for no more power than the source of the dc link can give."""

    limits: SourceLimits
    """What the source can give at rest at t = 0, W."""
    own: float
    """Most that filter and bleeder take of it, W."""
    smoothing: float
    """Of the frequency by which the P–f droop is limited."""

    @property
    def numbers(self) -> tuple[float, ...]:
        """All of it, as the template takes them."""
        return self.own, self.smoothing, *self.limits


@dataclass(frozen=True)
class LinkVoltage:
    """What the controller is told of a dc link that is not ideal."""

    rest: float
    """Voltage at rest at t = 0, V."""
    nominal: float
    """V."""
    per_volt: float
    """Largest peak voltage of the bridge over the link's."""
    clamp: Clamp | None = None
    """None: the controller asks for any power."""
    droop: float | None = None
    """Frequency over the voltage, rad/(s·V), of the droop of the link's voltage; None: the controller has none."""

    @property
    def limits(self) -> tuple[float, float]:
        """Between which a voltage may be one of the link, V."""
        return LEAST_VOLTAGE * self.nominal, V_PLAUSIBLE * self.nominal


@dataclass(frozen=True)
class OnLine:
    """How many equal units of a plant may be on line."""

    least: int
    """For which the gains are made."""
    most: int
    """All of them, as at t = 0."""


@dataclass(frozen=True, kw_only=True)
class Unit:
    """One controller of a study, ready to be exported. SI, peak αβ as α + jβ."""

    controller: str
    origin: Origin
    scheduler: Scheduler
    scheduled: bool
    """Whether the gains are those of the scheduler; otherwise they never change."""
    has_field: bool
    """Whether the controller has the field estimator. Without one it is given an estimate."""
    constants: ConverterConstants
    gains: PowerLoopGains
    """With which it begins."""
    grid: GridEstimate
    """For which these gains are made."""
    references: References
    rest: ControllerState
    """At the operating point of the study at t = 0."""
    measured: tuple[complex, complex, complex]
    """v, i_s and i_g there."""
    bridge: complex
    """Bridge voltage there."""
    S_rated: float
    V_rated_rms: float
    omega_n: float
    T_s: float
    delay_samples: int
    update_samples: int
    """Samples between two updates of the schedule."""
    limit_may_move: bool
    """Whether the current limit may be lowered in operation: no constant of the limiter follows from it."""
    notes: tuple[str, ...] = ()
    """What is different from a run of the study, one sentence each."""
    probes: tuple[FieldSettings, ...] = ()
    """Settings of the field estimator on each pair of lines; empty without one."""
    pair: int = 1
    """The pair on which it sends its probe, unless it is told otherwise."""
    link: LinkVoltage | None = None
    """The dc link; None: it is ideal."""
    on_line: OnLine | None = None
    """Of the plant that the controller belongs to; None: it stands alone."""

    @property
    def asked(self) -> Starts:
        """Start values of the parameters."""
        at, i_max = self.rest, self.constants.controller_settings.i_max_pk
        return Starts(at.P_f, at.Q_f, at.V, at.theta, i_max)

    @property
    def powers(self) -> tuple[float, float]:
        """P (W) and Q (var) at rest."""
        v, _, i_g = self.measured
        P, Q = instantaneous_power(v.real, v.imag, i_g.real, i_g.imag)
        return float(P), float(Q)

    @property
    def omega(self) -> float:
        """Frequency at rest, rad/s."""
        at = self.rest
        return float(power_loops(at.omega_i, at.V, at.P_f, at.Q_f, self.references, self.gains)[0])

    @property
    def first_status(self) -> int:
        """Bits of the scheduler before its first answer."""
        return HELD

    @property
    def field_structs(self) -> dict[str, str]:
        """The records of the field estimator by their place in the struct, and what C calls them."""
        gate = {"x.field.gate.": "vsg_field_network_gate_t"} if self.constants.network is not None else {}
        return {
            "x.field.lock.": "vsg_field_lock_in_t",
            "x.field.lost.": "vsg_field_lock_in_lost_t",
            "x.field.track.": "vsg_field_track_t",
            **gate,
            "x.estimate.": "vsg_field_answer_t",
        }

    @property
    def field_numbers(self) -> dict[str, list[Any]]:
        """What their numbers are."""
        return {
            "x.field.lock.": described_numbers(LockIn),
            "x.field.track.": described_numbers(FieldTrack),
            "x.estimate.": described_numbers(FieldAnswer),
        }

    @property
    def field_members(self) -> dict[str, str]:
        """Numbers of the field estimator that are in no record."""
        reals = {f"x.field.{name}": "vsg_real_t" for name in ("u_d", "u_q")}
        counts = ("first", "waits", "overruns", "restart", "due")
        whole = {f"x.field.{name}": "uint16_t" for name in counts} | {"x.retune": "uint16_t"}
        gains = {f"x.gains.{name}": "vsg_real_t" for name in PowerLoopGains._fields}
        return reals | whole | gains | {"x.grid.R_g": "vsg_real_t", "x.grid.L_g": "vsg_real_t"}


def unit_of(study: Study, controller: str | None = None, ready: Ready = NOTHING, **changes: Any) -> Unit:
    """A controller of a study as it is exported; the last one if none is named.

    ``changes`` go to the settings of its scheduler as in :func:`vsgdesign.runtime.guards.settings_of`. Raises
    StudyError, and InfeasibleStudyError where its gain table is missing or the study has no rest at t = 0.
    """
    from vsgdesign.linear.operating_point.sampled import steady_state
    from vsgdesign.simulation.field_feed import probe_of, settings_of_pairs
    from vsgdesign.simulation.timeline import build_timeline
    from vsgdesign.study.parameters.grid import GridSource

    spec = study.controller_named(controller)
    own, notes = study.with_limit_of(spec), []
    has_field = spec.kind == "scheduled" and samples_itself(spec.estimate)
    if has_field:
        changes = searching_settings(FINDS_WITHIN) | changes
    scheduler, origin = _scheduler(own, spec, ready, changes)
    scheduled = spec.kind == "scheduled"
    timeline = build_timeline(own)
    grid = spec.design_grid or own.grid if not scheduled else own.grid
    if scheduled:
        gains, for_grid = _first(scheduler, None if has_field else grid)
    else:
        found = spec.gains or schedule_of(own, spec, ready).gains(grid.R_g, grid.L_g)
        gains, for_grid = PowerLoopGains(*map(float, found)), GridEstimate(grid.R_g, grid.L_g)
    source, refs = timeline.source_at(0.0), timeline.references_at(0.0)
    if not source.steady:
        raise InfeasibleStudyError("a start at rest cannot be inside a ramp: move the ramp after t = 0.")
    at = GridSource(source.V_g_rms, source.omega)
    start = steady_state(own, timeline.grid_at(0.0), at, refs, gains, source.phase)
    i_s, v_c, i_g = (complex(*start.plant[k : k + 2]) for k in (0, 2, 4))
    c, state = own.converter, start.controller
    period = spec.update_period or UPDATE_PERIOD
    every = max(round(period / c.T_s), 1)
    if scheduled and not has_field and spec.estimate != "truth":
        notes.append(
            f'The study estimates the grid with "{spec.estimate}". The export takes R_g and L_g as inputs: connect '
            "your estimator to them."
        )
    if scheduled and spec.schedule == "closed_form":
        notes.append(
            "The gains follow the measured P, Q and V, with the guards of the scheduler, where a run of a closed form "
            "takes them at its design point."
        )
    return Unit(
        controller=spec.name,
        origin=replace(origin, limiter=own.current_limiter),
        scheduler=scheduler,
        scheduled=scheduled,
        has_field=has_field,
        constants=_constants(own, spec),
        gains=gains,
        grid=for_grid,
        references=References(*map(float, refs)),
        rest=ControllerState(*(value if isinstance(value, tuple) else float(value) for value in state)),
        measured=(complex(capacitor_node_voltage(i_s, v_c, i_g, own.circuit())), i_s, i_g),
        bridge=complex(state.u_alpha, state.u_beta),
        S_rated=c.S_rated,
        V_rated_rms=c.V_rated_rms,
        omega_n=c.omega_n,
        T_s=c.T_s,
        delay_samples=c.delay_samples,
        update_samples=every,
        limit_may_move=_limit_may_move(own),
        notes=tuple(notes),
        probes=settings_of_pairs(own) if has_field else (),
        pair=probe_of(own).pair,
        link=_link(own, start),
    )


def _link(study: Study, start: SampledState) -> LinkVoltage | None:
    """The dc link at rest. Raises InfeasibleStudyError where its source cannot give the power."""
    from vsgdesign.simulation.dc_start import dc_at_start

    if study.dc is None:
        return None
    if not study.dc.compensates:
        advice = "Leave it out: the controller then divides by the voltage that it measures."
        fault = Fault("dc.compensation", study.dc.compensation, "is not in an exported controller yet", advice)
        raise StudyError(study.name, [fault])
    begun, clamp = dc_at_start(study, start.plant, study.grid_source.omega_g), None
    if study.dc.clamps:
        low, high = study.dc.kind.law.can_give(begun.dc.memory, begun.clamp_of.hold, begun.link.source)
        limits = SourceLimits(float(low), float(high))
        clamp = Clamp(limits, float(begun.clamp_of.own), float(begun.clamp_of.smoothing))
    droop = float(begun.droop_of.per_volt) if study.dc.droops else None
    return LinkVoltage(float(begun.dc.v), float(begun.link.V_dc), float(begun.link.limit), clamp, droop)


def _scheduler(study: Study, spec: ControllerSpec, ready: Ready, changes: dict[str, Any]) -> tuple[Scheduler, Origin]:
    from vsgdesign.artifacts.table_text import full_order_sentence, proof_sentences
    from vsgdesign.simulation.field_feed import box_of

    table = ready.table(spec) if spec.kind == "scheduled" else None
    none = Origin(table="", table_sha256="0" * 64, study=study.name, study_hash=study.hash, certificate=NO_TABLE)
    if table is not None:
        own = {"certificate": proof_sentences(table), "full_order": full_order_sentence(table.full_order)}
        return scheduler_of(table, **changes), replace(none, table=table.name, table_sha256=table.sha256, **own)
    c, box = study.converter, box_of(study)
    x_low, x_high = box.x_over_r
    settings = box_settings(
        scr=box.scr,
        r_over_x=(1.0 / x_high, 1.0 / x_low),
        P=(-c.S_rated, c.S_rated),
        Q=(-c.S_rated, c.S_rated),
        V_rms=(0.85 * c.V_rated_rms, 1.15 * c.V_rated_rms),
        S_rated=c.S_rated,
        V_rated_rms=c.V_rated_rms,
        omega=c.omega_n,
        scr_basis=box.basis,
        **({"safe_scr": box.middle.scr} | changes),
    )
    schedule = schedule_of(study, replace(spec, kind="scheduled", schedule="closed_form"))
    scheduler = closed_form_scheduler(
        schedule,  # type: ignore[arg-type]
        settings,
        V_n_rms=c.V_rated_rms,
        S_rated=c.S_rated,
        scr_basis=box.basis,
    )
    what = "closed form" if spec.kind == "scheduled" else "fixed gains"
    return scheduler, replace(none, table=f"{spec.name} ({what})")


NO_TABLE = "The gains come from no table, and nothing is proved of them here."


def _first(scheduler: Scheduler, grid: Grid | None) -> tuple[PowerLoopGains, GridEstimate]:
    """The gains with which a scheduler begins on a known grid; at its safe place where it knows none, or where the grid
    is not in its box."""
    if grid is not None:
        with suppress(ArtifactError):
            scheduler.start(grid.R_g, grid.L_g)
    return PowerLoopGains(*map(float, scheduler.gains)), GridEstimate(*map(float, scheduler.grid))


def _constants(study: Study, spec: ControllerSpec) -> ConverterConstants:
    """The constants of the converter, with the network of the field estimator where the controller has one."""
    from vsgdesign.artifacts.field_weights import read_field_weights
    from vsgdesign.equations.field import FieldFeatures
    from vsgdesign.identification.field import field_network

    if spec.estimate != "field_network":
        return converter_constants(study)
    weights = read_field_weights(None if study.estimator is None else study.estimator.field_weights_file)
    return converter_constants(study, field_network(weights, FieldFeatures._fields), weights.hash)


def _limit_may_move(study: Study) -> bool:
    """Whether no constant of the study's limiter follows from the current limit."""
    from vsgdesign.study.parameters.converter import limiter_ratings

    if study.converter.current_limit_pu is None:
        return False
    ratings, given = limiter_ratings(study.converter, study.filter), dict(study.limiter_given)
    lower = ratings._replace(i_max_pk=0.9 * ratings.i_max_pk)
    same = study.limiter.constants(ratings, given) == study.limiter.constants(lower, given)
    return same and math.isfinite(ratings.i_max_pk)
