"""The study as data: frozen, SI, with the conventions of docs/nomenclature.md in the names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.equations.controller import ControllerSettings
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.integration import low_pass_share
from vsgdesign.equations.limiters import CIRCULAR, Limiter, limiter_named
from vsgdesign.equations.power_flow import Lags
from vsgdesign.equations.power_loops import NO_NOTCH, NotchConstants, notch_constants, notch_delay
from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.parameters.controllers import NO_LIMITER, ControllerSpec
from vsgdesign.study.parameters.controllers import UPDATE_PERIOD as UPDATE_PERIOD
from vsgdesign.study.parameters.converter import Converter, Filter, limiter_ratings
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import PLAIN, Grid, GridSource, Network
from vsgdesign.study.parameters.scenario import SimulationSpec
from vsgdesign.study.parameters.specification import ProtectionLimits, SurvivalSpec
from vsgdesign.study.parameters.targets import NOTCH_DAMPING, ClosedFormTarget

if TYPE_CHECKING:
    from vsgdesign.study.parameters.background import BackgroundSpec
    from vsgdesign.study.parameters.dc_link import DcLink
    from vsgdesign.study.parameters.estimator import EstimatorSpec
    from vsgdesign.study.parameters.power_plant import PowerPlant
    from vsgdesign.study.parameters.replay import ReplaySpec
    from vsgdesign.study.parameters.sensors import SensorSpec
    from vsgdesign.study.parameters.specification import Specification, StabilitySpec
    from vsgdesign.study.parameters.verification import VerificationSpec


@dataclass(frozen=True, kw_only=True)
class InnerLoopRequest:
    """The data for which inner loops are designed. Equal requests get equal gains."""

    converter: Converter
    filter: Filter
    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    """Smallest and largest value of the grids to be served."""
    scr_basis: str
    """``impedance`` or ``reactance``."""
    settling_time: float
    """Settling time of the power loops, s. The inner loops have to be faster."""
    seed: int = 0
    decay_apart: float = 0.0
    """What equal units behind R_2 and L_2 of ``filter`` are to decay with against each other, 1/s; 0: nothing."""


@dataclass(frozen=True)
class StudyOrigin:
    """The document that a study was read from, so that a changed study is checked by the same reader."""

    document: Mapping[str, Any]
    """Sections and fields as they were written, after the bases were merged."""
    folder: str
    """Folder to which relative paths in it refer."""
    source: str
    """Name of the document in messages."""
    default_name: str
    changed: Callable[[Study, Mapping[str, Any]], Study] | None = field(default=None, compare=False, repr=False)
    """The reader's function that makes a study with changed sections of one."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Everything that a study file says, resolved, checked and in SI.

    What is designed or trained for it lies beside it (:class:`vsgdesign.artifacts.ready.Ready`).
    """

    name: str
    title: str
    source: str
    converter: Converter
    filter: Filter
    inner_gains: InnerLoopGains
    grid: Grid
    grid_source: GridSource
    scr_basis: str
    network: Network = PLAIN
    """Load, fault and breaker at the start."""
    plant: PowerPlant | None = None
    """Several converters on one network, whose grid is ``grid``; None: one converter on it."""
    target: ClosedFormTarget
    tau_P: float
    tau_Q: float
    power_filter: str = "low_pass"
    """``low_pass``, or ``notch``: a notch at twice the nominal frequency before the low-pass of P and of Q."""
    notch_damping: float = NOTCH_DAMPING
    """Damping ratio of the notch's poles."""
    omega_t: float
    """Corner of the transient impedance, rad/s. It acts on changes of the grid current that are faster than this."""
    controllers: tuple[ControllerSpec, ...]
    simulation: SimulationSpec
    events: tuple[Event, ...]
    stability: StabilitySpec
    hash: str
    """SHA-256 of the resolved study document."""
    specification: Specification | None = None
    """The requirements of a designed gain table; None if the study has no [specification]."""
    estimator: EstimatorSpec | None = None
    """The network that estimates the grid's impedance; None where the study has no [estimator]."""
    inner_request: InnerLoopRequest | None = None
    """The request for which the inner loops were designed; None if the study gives their gains."""
    current_limiter: str = CIRCULAR.name
    """How the controllers limit their current: a name in ``equations.limiters.LIMITERS``."""
    limiter_given: tuple[tuple[str, float], ...] = ()
    """Parameters of that limiter that the study sets, by name, in SI. The others have their defaults."""
    survival: SurvivalSpec = field(default_factory=SurvivalSpec)
    """Random disturbances of a survival measurement."""
    verification: VerificationSpec | None = None
    """Random cases with which promises are tested; None for a study that was built from its parts."""
    background: BackgroundSpec | None = None
    """What the grid's voltage does besides the events; None if the study has no [background]."""
    sensors: SensorSpec | None = None
    """What lies between the circuit and the controller; None if the study has no [sensors]: they are ideal."""
    replay: ReplaySpec | None = None
    """The recorded voltage that is the source; None if the study has no [replay]."""
    dc: DcLink | None = None
    """The dc link and what feeds it; None if the study has no [dc]: the link is ideal."""
    files: tuple[str, ...] = field(default=(), compare=False)
    """Paths of the study file and of the files that it is based on; none for a study from a text."""
    origin: StudyOrigin | None = field(default=None, compare=False, repr=False)
    """The document from which it was read; None for a study that was built from its parts."""

    @property
    def has_notch(self) -> bool:
        """Whether the measured powers go through a notch."""
        return self.power_filter == "notch"

    @property
    def notch(self) -> NotchConstants:
        """The constants of the notch; zeros without one."""
        if not self.has_notch:
            return NO_NOTCH
        found = notch_constants(2.0 * self.converter.omega_n, self.notch_damping, self.converter.T_s)
        return NotchConstants(*(float(value) for value in found))

    @property
    def power_lags(self) -> Lags:
        """Time constants of first-order lags that stand for the filters of P and Q where a model has no more, and the
        transient impedance.

        They are those of the low-passes; a notch adds the delay that it has for slow changes (:eq:`notch-delay`).
        """
        delay = notch_delay(self.notch, self.converter.T_s) if self.has_notch else 0.0
        R_t, X_t = self.inner_gains.R_t, self.inner_gains.X_t
        return Lags(self.tau_P + delay, self.tau_Q + delay, R_t, X_t, self.omega_t if R_t or X_t else 0.0)

    @property
    def has_components(self) -> bool:
        """Whether the grid source's voltage contains more at any time than the fundamental that the events say."""
        if self.replay is not None or (self.background is not None and self.background.distorts):
            return True
        return bool(self.grid_source.components) or any(event.components for event in self.events)

    @property
    def undisturbed(self) -> Study:
        """The study with the source that its events say, with ideal sensors and without a protection."""
        if self.background is None and self.sensors is None and self.replay is None and self.protection is None:
            return self
        survival = replace(self.survival, protection=None)
        return replace(self, background=None, sensors=None, replay=None, survival=survival)

    @property
    def protection(self) -> ProtectionLimits | None:
        """The limits at which a protection trips; None where there is none."""
        limits = self.survival.protection
        return limits if limits is not None and limits.given else None

    def with_changes(self, **sections: Any) -> Study:
        """A study with sections changed as a study file would say it, checked by the same reader.

        Tables are merged field by field (``simulation={"duration": "6 s"}``); lists (``controllers``, ``events``) are
        replaced. The present study stays as it is. Raises StudyError with every fault.
        """
        if self.origin is None or self.origin.changed is None:
            problem = "was built from its parts and not read from a document"
            raise StudyError(self.name, [Fault("study", "", problem, "Use vd.load.")])
        return self.origin.changed(self, sections)

    def with_controllers(self, *controllers: Mapping[str, Any]) -> Study:
        """The study with these controllers instead of its own; fields as in a study file's [[controllers]]."""
        return self.with_changes(controllers=list(controllers))

    def with_events(self, *events: Mapping[str, Any]) -> Study:
        """The study with these events instead of its own; fields as in a study file's [[events]]."""
        return self.with_changes(events=list(events))

    def unknown_controllers(self, *names: str) -> list[Fault]:
        """A fault for each name that no controller of the study has."""
        known = [spec.name for spec in self.controllers]
        advice = f"The study has: {', '.join(known)}."
        return [Fault("controller", f'"{name}"', "unknown", advice) for name in names if name not in known]

    def controller_named(self, name: str | None) -> ControllerSpec:
        """The controller of this name; None: the last one. Raises StudyError naming those that there are."""
        if name is None:
            return self.controllers[-1]
        if faults := self.unknown_controllers(name):
            raise StudyError(self.name, faults)
        return next(spec for spec in self.controllers if spec.name == name)

    def made_strict(self) -> Study:
        """The study with strict runs (``[simulation] strict``)."""
        return replace(self, simulation=replace(self.simulation, strict=True))

    def with_limit_of(self, spec: ControllerSpec) -> Study:
        """The study as one of its controllers runs in it: with this controller's current limit.

        It is the study itself where the controller has no limit of its own.
        """
        if spec.current_limiter is None and spec.current_limit_pu is None and spec.limiter_given is None:
            return self
        limiter = self.current_limiter if spec.current_limiter is None else spec.current_limiter
        limit_pu = self.converter.current_limit_pu if spec.current_limit_pu is None else spec.current_limit_pu
        given = self.limiter_given if spec.limiter_given is None else spec.limiter_given
        if limiter == NO_LIMITER:
            limiter, limit_pu, given = CIRCULAR.name, None, ()
        converter = replace(self.converter, current_limit_pu=limit_pu)
        return replace(self, converter=converter, current_limiter=limiter, limiter_given=given)

    @property
    def identity(self) -> dict[str, Any]:
        """What results say of their study: its name, its hash, and ``inputs``, its sections and fields as they were
        written, bases included (None for a study that was built from its parts)."""
        inputs = None if self.origin is None else dict(self.origin.document)
        return {"name": self.name, "title": self.title, "source": self.source, "hash": self.hash, "inputs": inputs}

    @property
    def content(self) -> Study:
        """The study without what no result depends on: its names and files, and the order of a set, which is another in
        each process."""
        given = self.verification and replace(self.verification, given=frozenset())
        return replace(self, files=(), name="", title="", source="", hash="", origin=None, verification=given)

    @property
    def input_files(self) -> tuple[str, ...]:
        """Every file that the study is read from or names: itself, its bases, tables, weights and recipe."""
        named = [controller.table_file for controller in self.controllers]
        if self.estimator is not None:
            named += [self.estimator.weights_file, self.estimator.recipe]
        if self.replay is not None:
            named += self.replay.files
        return (*self.files, *(path for path in named if path is not None))

    def circuit(self, grid: Grid | None = None) -> FilterGrid:
        """The circuit from the bridge to the grid source."""
        f, g = self.filter, grid or self.grid
        return FilterGrid(f.L_1, f.R_1, f.C, f.R_c, f.L_2, f.R_2, g.R_g, g.L_g)

    def path_to_grid(self, grid: Grid | None = None, omega: float | None = None) -> tuple[float, float]:
        """R and X in Ω between the control point (capacitor) and the grid source."""
        g = grid or self.grid
        omega = self.converter.omega_n if omega is None else omega
        return self.filter.R_2 + g.R_g, omega * (self.filter.L_2 + g.L_g)

    @property
    def limiter(self) -> Limiter:
        """The current limiter of the controllers. Raises ValueError if there is no limiter of this name."""
        return limiter_named(self.current_limiter)

    @property
    def limiter_values(self) -> dict[str, float]:
        """Every parameter of the current limiter, in SI: as the study gives it, else its default."""
        return self.limiter.values(limiter_ratings(self.converter, self.filter), dict(self.limiter_given))

    def controller_settings(self) -> ControllerSettings:
        """The sampled controller's constants, those of its limiter among them."""
        c = self.converter
        lead = c.omega_n * (c.delay_samples + 0.5) * c.T_s
        ratings = limiter_ratings(c, self.filter)._replace(
            inner=self.inner_gains, omega_t=self.omega_t, C=self.filter.C
        )
        return ControllerSettings(
            T_s=c.T_s,
            smoothing_P=low_pass_share(self.tau_P, c.T_s),
            smoothing_Q=low_pass_share(self.tau_Q, c.T_s),
            omega_C=c.omega_n * self.filter.C,
            omega_L=c.omega_n * self.filter.L_1,
            i_max_pk=ratings.i_max_pk,
            v_max_pk=c.v_max_pk,
            advance_cos=float(np.cos(lead)),
            advance_sin=float(np.sin(lead)),
            smoothing_t=float(-np.expm1(-self.omega_t * c.T_s)),
            half_cos=float(np.cos(0.5 * c.omega_n * c.T_s)),
            half_sin=float(np.sin(0.5 * c.omega_n * c.T_s)),
            T_over_L=c.T_s / self.filter.L_1,
            notch_gain=self.notch.gain,
            notch_step=self.notch.step,
            notch_back=self.notch.back,
            limiter=self.limiter.constants(ratings, dict(self.limiter_given)),
        )
