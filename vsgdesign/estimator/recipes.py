"""What the two networks are trained on: windows of the paper's kind, and runs of the field estimator.

Each has its packaged recipes and a library that reads others from files.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

from vsgdesign.equations.field.fusion import GateLimits
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.recipe_fields import Library, Recipe
from vsgdesign.identification.feeding import EXACT, LEAST_PER_CYCLE, MOST_CYCLES, NEAR, choose_window
from vsgdesign.identification.interface import CHANNELS
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import flag, number, section, spread, texts, whole, word
from vsgdesign.study.parameters.ranges import Spread, log_uniform, one_of, uniform

_NOMINAL, _NONE = one_of(1.0), one_of(0.0)
_CONVERTER = "it follows from the converter"
_DEGREE = 0.017453292519943295

BACKGROUNDS = ("clean", "measured", "dirty")
SENSORS = ("ideal", "typical", "dirty")
"""Packaged levels of a study's [background] and [sensors]."""


@section
class WindowRecipe(Recipe):
    """One data set. A scenario is one run: at rest, then a change, with windows before and after it.

    Ratios are per unit of the converter's rating; SCR is on ``scr_basis``.
    """

    counted: ClassVar[str] = "scenarios"

    scr: Spread = spread("1", 0.05, 1e4)
    x_over_r: Spread = spread("1", 1e-3, 1e4)
    P_pu: Spread = spread("1", -2.0, 2.0)
    """Active power at the start; the references are set so that droop does not move it."""
    Q_pu: Spread = spread("1", -2.0, 2.0)
    P_step_pu: Spread = spread("1", -2.0, 2.0)
    Q_step_pu: Spread = spread("1", -2.0, 2.0)
    """What is added to the references when the change comes."""
    scenarios: int = whole(1, 10**6)
    before: int = whole(0, 1000)
    after: int = whole(0, 1000)
    """Windows kept before and after the change."""
    every: int = whole(1, 1000, default=1)
    """Of the windows after the change, one of ``every`` is kept, so that they cover the transient."""
    settle: int = whole(0, 1000, default=2)
    """Windows left out at the start, where the ripple of a switched bridge settles."""
    skip: int = whole(0, 1000, default=1)
    """Windows left out right after the change, where the inner loops still move."""
    grid_step_share: float = number("1", 0.0, 1.0, default=0.0)
    """Share of the scenarios whose change is a change of grid, drawn anew from the same ranges."""
    grid_step_ratio: float = number("1", 1.0, 1000.0, default=5.0)
    """Largest ratio of the two grids' SCR."""
    scr_basis: str = word(tuple(SCR_BASES), default="reactance")
    within_V_limits: bool = flag(default=False)
    """Draw again what leaves the study's V_min_pu to V_max_pu at rest, before or after the change."""
    V_g_pu: Spread = spread("1", 0.1, 2.0, default=_NOMINAL)
    f_g_pu: Spread = spread("1", 0.5, 1.5, default=_NOMINAL)
    phase: Spread = spread("rad", -100.0, 100.0, default=_NONE)
    """Phase of the grid at the first sample, rad, beside the published one (zero crossing of phase A)."""
    noise_v: Spread = spread("1", 0.0, 1.0, default=_NONE)
    noise_i: Spread = spread("1", 0.0, 1.0, default=_NONE)
    """Standard deviation of each sample, relative to the rated peak."""
    adc_bits: int = whole(0, 32, default=0)
    """0: not quantised."""
    adc_range_pu: float = number("1", 0.1, 100.0, default=3.0)
    """Full scale of the converters is ± this, of the rated peak; what is beyond is clipped."""
    harmonic_5: Spread = spread("1", 0.0, 0.5, default=_NONE)
    harmonic_7: Spread = spread("1", 0.0, 0.5, default=_NONE)
    """Background voltage of the grid relative to its fundamental, at a random angle."""
    bridge: str = word(("averaged", "pwm"), default="pwm")
    channels: str = word(tuple(CHANNELS), default="phase_a")
    sample_interval: float = number("s", 1e-6, 0.1, default=0.0, zero=_CONVERTER)
    samples: int = whole(4, 10**4, default=0, zero=_CONVERTER)
    cycles: int = whole(1, 1000, default=0, zero=_CONVERTER)
    """Spacing of the samples (s), their number, and the nominal cycles of a window. What is 0 follows from the
    converter (:func:`vsgdesign.estimator.recipes.with_sampling`): the published window is 100 samples every 200 µs,
    one cycle of 50 Hz."""
    hidden: int = whole(1, 64, default=8)
    components: int = whole(0, 1000, default=6)
    starts: int = whole(1, 100, default=4)
    """The network that learns these windows: tanh units, principal components of its inputs (0: all above the noise)
    and the largest number of starts. [estimator] of a study overrides the recipe."""

    @property
    def update_period(self) -> float:
        """Length of a window, s; 0 as long as its sampling is left to the converter."""
        return self.samples * self.sample_interval

    @property
    def windows(self) -> int:
        """Windows of the whole data set."""
        return self.scenarios * (self.before + self.after)

    @property
    def synchronised(self) -> bool:
        """Every window begins at the same phase of a grid of nominal frequency: the published signal."""
        return self.phase == _NONE and self.f_g_pu == _NOMINAL

    def misfits(self) -> list[Fault]:
        """One where no window is kept."""
        if self.before + self.after >= 1:
            return []
        return [Fault("before", "0", "no window is kept", "Keep at least one, before or after the change.")]


PUBLISHED = WindowRecipe(
    name="published",
    scr=one_of(2.0, 4.5, 7.0, 9.5, 15.0),
    x_over_r=one_of(1.0),
    P_pu=uniform(0.3, 0.7),
    Q_pu=uniform(0.1, 0.4),
    P_step_pu=uniform(-0.1, 0.1),
    Q_step_pu=uniform(-0.1, 0.1),
    scenarios=500,
    before=2,
    after=8,
    every=3,
)
"""Five grids as in the paper, synchronised with the grid; operating points about those of its scenario."""

CONTINUOUS = replace(PUBLISHED, name="continuous", scr=log_uniform(1.5, 25.0), grid_step_share=0.5)
"""Every grid of a range, and the second after a change of grid, when the power is far from its reference."""

WIDE = replace(
    CONTINUOUS,
    name="wide",
    scr_basis="impedance",
    x_over_r=log_uniform(0.5, 20.0),
    P_pu=uniform(0.3, 0.9),
    Q_pu=uniform(-0.2, 0.3),
    within_V_limits=True,
    settle=12,
    skip=6,
    hidden=32,
    components=8,
    starts=3,
)
"""Grids of any X/R as well, where the converter's voltage stays within its limits: for a converter of one's own.

More windows are left out than in the published recipes: designed inner loops may ring for a tenth of a second."""


@section
class FieldRecipe(Recipe):
    """Runs in a disturbed grid, each with some changes, and the network that learns them.

    Ratios are per unit of the converter's rating. The shares say how often a change is of which kind; nothing happens
    in the rest of them.
    """

    counted: ClassVar[str] = "runs"

    runs: int = whole(1, 10**5)
    converters: tuple[str, ...] = texts(default=())
    """Further converters, "case:NAME" or study files, beside the study's own; runs take them in turn."""
    scr: Spread = spread("1", 0.05, 1e4)
    x_over_r: Spread = spread("1", 1e-3, 1e4)
    scr_basis: str = word(tuple(SCR_BASES), default="impedance")
    P_pu: Spread = spread("1", -2.0, 2.0)
    Q_pu: Spread = spread("1", -2.0, 2.0)
    """Powers at the start; the references are set so that droop does not move them."""
    V_g_pu: Spread = spread("1", 0.5, 1.5)
    f_g_pu: Spread = spread("1", 0.9, 1.1)
    largest_current_pu: float = number("1", 0.1, 2.0, default=0.95)
    """Largest current of the bridge at rest, before and after every change; what exceeds it is drawn again."""
    changes: int = whole(1, 20, default=2)
    first: float = number("s", 0.5, 10.0, default=1.4)
    between: float = number("s", 0.3, 10.0, default=1.0)
    """Changes of a run, the time of the first one, s, and the time from one to the next. Each comes up to a cycle
    later, at random, so that it falls anywhere within a cycle."""
    learn: float = number("s", 0.1, 5.0, default=0.4)
    """Time at the start of a run that is left out, s."""
    jump_share: float = number("1", 0.0, 1.0, default=0.35)
    jump_and_step_share: float = number("1", 0.0, 1.0, default=0.25)
    grid_step_share: float = number("1", 0.0, 1.0, default=0.25)
    power_step_share: float = number("1", 0.0, 1.0, default=0.1)
    near_share: float = number("1", 0.0, 1.0, default=0.4)
    """Share of the jumps whose new SCR is within a factor of 2 of the old one; the others are drawn from ``scr``."""
    V_step_pu: Spread = spread("1", -0.5, 0.5)
    phase_step: Spread = spread("rad", -3.2, 3.2)
    f_step_pu: Spread = spread("1", -0.05, 0.05)
    P_step_pu: Spread = spread("1", -2.0, 2.0)
    Q_step_pu: Spread = spread("1", -2.0, 2.0)
    background: str = word(BACKGROUNDS, default="dirty")
    sensors: str = word(SENSORS, default="dirty")
    bridge: str = word(("averaged", "pwm"), default="pwm")
    hidden: int = whole(1, 64, default=24)
    epochs: int = whole(1, 10**4, default=80)
    weight: float = number("1", 1.0, 100.0, default=7.0)
    weighted: float = number("s", 0.02, 10.0, default=0.35)
    """Cycles within ``weighted`` s after a change count ``weight`` times in the training."""
    first_cycle: int = whole(1, 25, default=4)
    first_cycle_refuted: int = whole(1, 25, default=2)
    last_cycle: int = whole(1, 1000, default=50)
    confident: float = number("1", 0.01, 1.0, default=0.15)
    """The gate: cycles after an event flag between which the network may speak, and the relative standard deviation
    below which it does."""

    @property
    def gate(self) -> GateLimits:
        """The limits of the gate."""
        return GateLimits(
            first=float(self.first_cycle),
            first_refuted=float(self.first_cycle_refuted),
            last=float(self.last_cycle),
            confident=self.confident,
        )

    @property
    def duration(self) -> float:
        """Length of a run, s."""
        return self.first + self.changes * self.between

    def misfits(self) -> list[Fault]:
        """A fault of the shares, of the times and of the cycles that do not fit each other."""
        faults = []
        names = ("jump_share", "jump_and_step_share", "grid_step_share", "power_step_share")
        shares = {name: getattr(self, name) for name in names}
        if sum(shares.values()) > 1.0 + 1e-9:
            total = f"{sum(shares.values()):g}"
            faults.append(Fault("jump_share", total, "is the sum of the four shares, above 1", f"They are {shares}."))
        if self.learn >= self.first:
            faults.append(Fault("learn", f"{self.learn:g} s", f"must be below first = {self.first:g} s"))
        if not self.first_cycle_refuted <= self.first_cycle <= self.last_cycle:
            faults.append(
                Fault(
                    "first_cycle",
                    str(self.first_cycle),
                    f"must be from first_cycle_refuted = {self.first_cycle_refuted} to last_cycle = {self.last_cycle}",
                )
            )
        return faults


FIELD = FieldRecipe(
    name="field",
    runs=400,
    scr=log_uniform(1.2, 20.0),
    x_over_r=log_uniform(0.3, 20.0),
    P_pu=uniform(-0.4, 0.6),
    Q_pu=uniform(-0.1, 0.2),
    V_g_pu=uniform(0.9, 1.1),
    f_g_pu=uniform(0.99, 1.01),
    V_step_pu=uniform(-0.1, 0.1),
    phase_step=uniform(-20.0 * _DEGREE, 20.0 * _DEGREE),
    f_step_pu=uniform(-0.006, 0.006),
    P_step_pu=uniform(-0.2, 0.2),
    Q_step_pu=uniform(-0.1, 0.1),
)
"""Grids of any SCR and X/R in a disturbed grid, with everything that may change."""

FIELD_RECIPES = Library({FIELD.name: FIELD}, FIELD.name)
WINDOW_RECIPES = Library(
    {recipe.name: recipe for recipe in (PUBLISHED, CONTINUOUS, WIDE)},
    base=CONTINUOUS.name,
    others=(FIELD.name,),
    refusal="trains the network of the field estimator, which has no windows",
)


def with_sampling(recipe: WindowRecipe, converter: Converter) -> WindowRecipe:
    """The recipe with ``sample_interval``, ``samples`` and ``cycles`` filled in for a converter.

    A sample interval is a whole number of control periods T_s. What the recipe leaves open is chosen by
    :func:`vsgdesign.identification.feeding.choose_window`. What the recipe gives is kept. Raises StudyError where
    it does not fit the converter.
    """
    rate = converter.f_sw * converter.samples_per_carrier
    per_cycle = rate * 2.0 * math.pi / converter.omega_n
    if per_cycle < LEAST_PER_CYCLE:
        raise StudyError(f"recipe {recipe.name}", [_too_slow(converter, per_cycle)])
    steps = _given_steps(recipe, converter, rate)
    plan = choose_window(rate, per_cycle, steps=steps, samples=recipe.samples, cycles=recipe.cycles)
    if plan is None:
        raise StudyError(f"recipe {recipe.name}", [_too_long(recipe, converter)])
    interval = plan.steps / rate
    if recipe.cycles and plan.missed >= NEAR:
        fault = _contradiction(recipe, plan.samples, interval, plan.cycles, plan.missed)
        raise StudyError(f"recipe {recipe.name}", [fault])
    return replace(recipe, sample_interval=interval, samples=plan.samples, cycles=plan.cycles)


def _given_steps(recipe: WindowRecipe, converter: Converter, rate: float) -> int:
    """Control periods of the sample interval that the recipe gives; 0: it gives none."""
    if not recipe.sample_interval:
        return 0
    steps = recipe.sample_interval * rate
    if round(steps) >= 1 and abs(steps - round(steps)) <= 1e-6 * steps:
        return round(steps)
    near = sorted({max(math.floor(steps), 1), math.ceil(steps)})
    fault = Fault(
        "sample_interval",
        f"{recipe.sample_interval * 1e6:g} µs",
        f"no whole number of the converter's control periods of {converter.T_s * 1e6:.6g} µs",
        "Leave it out, or give " + " or ".join(f"{k / rate * 1e6:.9g} µs" for k in near) + ".",
    )
    raise StudyError(f"recipe {recipe.name}", [fault])


def _contradiction(recipe: WindowRecipe, samples: int, interval: float, cycles: int, missed: float) -> Fault:
    length = f"{samples} samples every {interval * 1e6:.6g} µs"
    given = "samples and sample_interval" if recipe.samples and recipe.sample_interval else "sample_interval"
    return Fault(
        "cycles",
        str(cycles),
        f"{length} miss {cycles} nominal cycles by {missed:.3g} of one",
        f"Leave cycles out, or {given}.",
    )


def _too_long(recipe: WindowRecipe, converter: Converter) -> Fault:
    cycles = recipe.cycles or MOST_CYCLES
    longest = 2.0 * math.pi * cycles / converter.omega_n / 4.0
    return Fault(
        "sample_interval",
        f"{recipe.sample_interval:g} s",
        f"leaves fewer than 4 samples in {cycles} nominal cycles",
        f"Give at most {longest:.3g} s, or leave it out.",
    )


def _too_slow(converter: Converter, per_cycle: float) -> Fault:
    return Fault(
        "converter.f_sw",
        f"{converter.f_sw:g} Hz",
        f"{per_cycle:.3g} control periods in a cycle of the grid are too few for a window (least: {LEAST_PER_CYCLE})",
        "Raise f_sw or samples_per_carrier.",
    )


def missed_cycles(recipe: WindowRecipe, converter: Converter) -> float:
    """By how much a sampled window is longer than its ``cycles``, in nominal cycles; 0 exactly where it is whole."""
    missed = recipe.update_period * converter.omega_n / (2.0 * math.pi) - recipe.cycles
    return 0.0 if abs(missed) < EXACT else missed


def turn_per_window(recipe: WindowRecipe, converter: Converter) -> float:
    """Angle (rad) by which a grid of nominal frequency turns from the begin of one window to that of the next.

    Zero exactly where a window is whole cycles. Synchronised windows are turned back by it, window by window, so that
    the grid's vector begins each of them at the same angle.
    """
    return 2.0 * math.pi * missed_cycles(recipe, converter)


def describe_sampling(recipe: WindowRecipe, converter: Converter) -> str:
    """What a sampled recipe's windows are, in words."""
    missed, f_n = missed_cycles(recipe, converter), converter.omega_n / (2.0 * math.pi)
    count = "1 cycle" if recipe.cycles == 1 else f"{recipe.cycles} cycles"
    text = (
        f"{recipe.samples} samples every {recipe.sample_interval * 1e6:.6g} µs, {recipe.update_period * 1e3:.6g} ms: "
        f"{count} of {f_n:g} Hz"
    )
    return text if missed == 0.0 else f"{text} {'less' if missed < 0.0 else 'and'} {abs(missed):.2g} of one"


def sampling_document(recipe: WindowRecipe, converter: Converter) -> dict[str, float | int | str]:
    """The same in JSON's types."""
    return {
        "samples": recipe.samples,
        "sample_interval_s": recipe.sample_interval,
        "period_s": recipe.update_period,
        "cycles": recipe.cycles,
        "missed_cycles": missed_cycles(recipe, converter),
        "text": describe_sampling(recipe, converter),
    }
