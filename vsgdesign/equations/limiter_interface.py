"""What a current limiter sees in one sample of the controller, and what it may change.

A limiter is two functions of scalars. ``limit`` stands between the voltage loop and the current loop: it turns the
current that the voltage loop asks for into the one that the current loop gets, and it may change the powers that the
power loops see. ``move`` stands before the integrators: it may change how far θ, ω_i and V go in this sample, and it
says what the limiter remembers. Both follow the rules of every equation (CONTRIBUTING.md, "Add an equation").
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from vsgdesign.equations.controller_data import ControllerSettings, Nothing
from vsgdesign.equations.inner_loops import InnerLoopGains


class GridEstimate(NamedTuple):
    """Ẑ: the grid impedance that the controller's gains are made for, R_g in Ω and L_g in H, at the PCC."""

    R_g: Any
    L_g: Any


class LimiterView(NamedTuple):
    """One sample as a limiter sees it. The dq components are peak values in the converter's own frame."""

    v_d: Any
    v_q: Any
    """Capacitor-node voltage, V."""
    i_s_d: Any
    i_s_q: Any
    """Converter current, A."""
    i_g_d: Any
    i_g_q: Any
    """Grid current, A."""
    e_d: Any
    e_q: Any
    """Error of the voltage loop, V."""
    i_want_d: Any
    i_want_q: Any
    """Converter current that the voltage loop asks for, A."""
    V: Any
    """Voltage that the Q loop asks for, phase rms V."""
    omega_i: Any
    """Frequency integrator of the P loop, rad/s."""
    P: Any
    Q: Any
    """Measured powers before their low-pass, and behind the notch if there is one, W and var."""
    K_pv: Any
    """Proportional gain of the voltage loop, A/V."""
    full: Any
    """1 where the bridge voltage of the last sample was at its limit, else 0."""


class LimitedSample(NamedTuple):
    """What ``limit`` answers."""

    i_ref_d: Any
    i_ref_q: Any
    """Converter current that the current loop gets, A peak."""
    e_d: Any
    e_q: Any
    """Error that the integrators of the voltage loop take up, V peak; ``view.e`` to leave them alone."""
    P: Any
    Q: Any
    """Powers that go on to the power loops, W and var; ``view.P`` and ``view.Q`` to leave them alone."""
    limited: Any
    """1 where the limiter acts in this sample, else 0."""
    notes: Any = Nothing()
    """What ``move`` has to know of this sample: a NamedTuple of the limiter's own, forgotten after it."""


class IntegratorSteps(NamedTuple):
    """Changes of the power loops' integrators in this sample: θ in rad, ω_i in rad/s, V in V rms."""

    theta: Any
    omega_i: Any
    V: Any


class LimiterRatings(NamedTuple):
    """Ratings from which a limiter computes its constants, in SI units."""

    T_s: float
    V_rated_pk: float
    I_rated_pk: float
    i_max_pk: float
    """Limit of the converter current, A peak. It is very large where the converter has no limit."""
    Z_base: float
    omega_0: float
    R_2: float
    L_2: float
    """Grid side of the filter, between the capacitor and the PCC."""
    V_low_pu: float
    V_high_pu: float
    """Least and largest voltage of a sound operating point, pu of the rated voltage."""
    inner: InnerLoopGains | None = None
    """Gains of the inner loops; None where a limiter's constants do not follow from them."""
    omega_t: float = 0.0
    """Corner of the transient impedance, rad/s."""
    C: float = 0.0
    """Capacitor of the filter, F."""

    @property
    def limit_pu(self) -> float:
        """Limit of the converter current, pu of the rated peak."""
        return self.i_max_pk / self.I_rated_pk


class KnownRatings(NamedTuple):
    """What a parameter's limits and default may follow from: the ratings, and the parameters before it by name."""

    ratings: LimiterRatings
    values: Mapping[str, float]


@dataclass(frozen=True)
class Rule:
    """How a limit or a default of a parameter follows from the ratings and from other parameters."""

    of: Callable[[KnownRatings], float]
    words: str = ""
    """The rule in words, for docs/study-file.md."""
    value: float | None = None
    """The number, where it is the same for every converter."""

    def __call__(self, known: KnownRatings) -> float:
        return self.of(known)


def always(value: float) -> Rule:
    """The rule that gives the same number for every converter."""
    return Rule(lambda _: value, value=value)


@dataclass(frozen=True)
class LimiterParameter:
    """A number of a limiter that a study may set: its name there, its SI unit ("1" for a ratio), the limits between
    which it makes sense, its default, and what it is."""

    name: str
    unit: str
    low: Rule
    high: Rule
    default: Rule
    meaning: str


class LimiterLaw(NamedTuple):
    """The two functions of a limiter.

    ``limit(memory, view, grid, refs, gains, settings)`` gives a :class:`LimitedSample`. grid is a
    :class:`GridEstimate`, refs and gains are those of the power loops, settings are the controller's with the
    limiter's own constants in ``settings.limiter``.

    ``move(memory, sample, view, omega, steps, settings)`` gives the :class:`IntegratorSteps` to take, and the memory of
    the next sample. sample is the answer of ``limit``, omega the frequency of this sample in rad/s, steps what the
    power loops ask for.
    """

    limit: Callable[..., Any]
    move: Callable[..., Any]


def no_constants(ratings: LimiterRatings, values: Mapping[str, float]) -> Nothing:
    """For a limiter that needs nothing beyond the controller's own settings."""
    return Nothing()


def no_memory(view: LimiterView, omega: Any, settings: ControllerSettings) -> Nothing:
    """For a limiter that remembers nothing."""
    return Nothing()


@dataclass(frozen=True)
class Limiter:
    """A way to limit the current, by its name in a study file."""

    name: str
    law: LimiterLaw
    build: Callable[[LimiterRatings, Mapping[str, float]], Any] = no_constants
    """Its own constants, a NamedTuple of floats, from the ratings and from a value for each of its parameters."""
    at_rest: Callable[[LimiterView, Any, ControllerSettings], Any] = no_memory
    """What it remembers in a steady state: a NamedTuple of scalars, from the sample seen there, the frequency in rad/s
    and the controller's settings. A run starts from it, and the linear model has one state for each of its fields."""
    parameters: tuple[LimiterParameter, ...] = ()
    """What a study may set. The rules of a parameter may use those before it."""
    rests: bool = False
    """Whether the converter rests at its limit where the grid cannot carry what is asked, and returns from there."""

    def values(self, ratings: LimiterRatings, given: Mapping[str, float]) -> dict[str, float]:
        """Every parameter in SI: as given, else its default. Raises ValueError for a name that it does not have."""
        names = [parameter.name for parameter in self.parameters]
        if unknown := sorted(set(given) - set(names)):
            raise ValueError(f'{", ".join(unknown)}: current_limiter = "{self.name}" {self.has_parameters}.')
        found: dict[str, float] = {}
        for parameter in self.parameters:
            value = given.get(parameter.name)
            found[parameter.name] = parameter.default(KnownRatings(ratings, found)) if value is None else value
        return found

    def constants(self, ratings: LimiterRatings, given: Mapping[str, float] | None = None) -> Any:
        """Its own constants for a converter, with defaults for what is not given."""
        return self.build(ratings, self.values(ratings, given or {}))

    @property
    def has_parameters(self) -> str:
        """What it has, in words."""
        names = ", ".join(parameter.name for parameter in self.parameters)
        return f"has the parameters {names}" if names else "has no parameters"
