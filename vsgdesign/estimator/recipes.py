"""What a data set of windows is made of: ranges of grids, powers and disturbances, and how windows are taken."""

from __future__ import annotations

import difflib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import plain
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.recipe_fields import (
    FieldRule,
    Spread,
    field_faults,
    log_uniform,
    one_of,
    read_fields,
    read_recipe,
    uniform,
)
from vsgdesign.identification.interface import CHANNELS
from vsgdesign.parameters.estimator import FIELD_RECIPES

_NOMINAL, _NONE = one_of(1.0), one_of(0.0)


@dataclass(frozen=True, kw_only=True)
class WindowRecipe:
    """One data set. A scenario is one run: at rest, then a change, with windows before and after it.

    Ratios are per unit of the converter's rating; SCR is on ``scr_basis``.
    """

    name: str
    scr: Spread
    x_over_r: Spread
    P_pu: Spread
    """Active power at the start; the references are set so that droop does not move it."""
    Q_pu: Spread
    P_step_pu: Spread
    Q_step_pu: Spread
    """What is added to the references when the change comes."""
    scenarios: int
    before: int
    after: int
    """Windows kept before and after the change."""
    every: int = 1
    """Of the windows after the change, one of ``every`` is kept, so that they cover the transient."""
    settle: int = 2
    """Windows left out at the start, where the ripple of a switched bridge settles."""
    skip: int = 1
    """Windows left out right after the change, where the inner loops still move."""
    grid_step_share: float = 0.0
    """Share of the scenarios whose change is a change of grid, drawn anew from the same ranges."""
    grid_step_ratio: float = 5.0
    """Largest ratio of the two grids' SCR."""
    scr_basis: str = "reactance"
    within_V_limits: bool = False
    """Draw again what leaves the study's V_min_pu to V_max_pu at rest, before or after the change."""
    V_g_pu: Spread = _NOMINAL
    f_g_pu: Spread = _NOMINAL
    phase: Spread = _NONE
    """Phase of the grid at the first sample, rad, beside the published one (zero crossing of phase A)."""
    noise_v: Spread = _NONE
    noise_i: Spread = _NONE
    """Standard deviation of each sample, relative to the rated peak."""
    adc_bits: int = 0
    """0: not quantised."""
    adc_range_pu: float = 3.0
    """Full scale of the converters is ± this, of the rated peak; what is beyond is clipped."""
    harmonic_5: Spread = _NONE
    harmonic_7: Spread = _NONE
    """Background voltage of the grid relative to its fundamental, at a random angle."""
    bridge: str = "pwm"
    channels: str = "phase_a"
    sample_interval: float = 0.0
    samples: int = 0
    cycles: int = 0
    """Spacing of the samples (s), their number, and the nominal cycles of a window. What is 0 follows from the
    converter (:func:`vsgdesign.estimator.sampling.with_sampling`): the published window is 100 samples every 200 µs,
    one cycle of 50 Hz."""
    hidden: int = 8
    components: int = 6
    starts: int = 4
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

    def document(self) -> dict[str, Any]:
        """The recipe in JSON's types, as it comes back from a file."""
        return plain(asdict(self))


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

RECIPES = {recipe.name: recipe for recipe in (PUBLISHED, CONTINUOUS, WIDE)}


FIELDS = {
    "name": FieldRule("text"),
    "scr": FieldRule("spread", 0.05, 1e4),
    "x_over_r": FieldRule("spread", 1e-3, 1e4),
    "scr_basis": FieldRule("word", words=tuple(SCR_BASES)),
    "P_pu": FieldRule("spread", -2.0, 2.0),
    "Q_pu": FieldRule("spread", -2.0, 2.0),
    "P_step_pu": FieldRule("spread", -2.0, 2.0),
    "Q_step_pu": FieldRule("spread", -2.0, 2.0),
    "grid_step_share": FieldRule("number", 0.0, 1.0),
    "grid_step_ratio": FieldRule("number", 1.0, 1000.0),
    "within_V_limits": FieldRule("true or false"),
    "V_g_pu": FieldRule("spread", 0.1, 2.0),
    "f_g_pu": FieldRule("spread", 0.5, 1.5),
    "phase": FieldRule("spread", -100.0, 100.0, "rad"),
    "scenarios": FieldRule("whole number", 1, 10**6),
    "before": FieldRule("whole number", 0, 1000),
    "after": FieldRule("whole number", 0, 1000),
    "every": FieldRule("whole number", 1, 1000),
    "settle": FieldRule("whole number", 0, 1000),
    "skip": FieldRule("whole number", 0, 1000),
    "noise_v": FieldRule("spread", 0.0, 1.0),
    "noise_i": FieldRule("spread", 0.0, 1.0),
    "adc_bits": FieldRule("whole number", 0, 32),
    "adc_range_pu": FieldRule("number", 0.1, 100.0),
    "harmonic_5": FieldRule("spread", 0.0, 0.5),
    "harmonic_7": FieldRule("spread", 0.0, 0.5),
    "bridge": FieldRule("word", words=("averaged", "pwm")),
    "channels": FieldRule("word", words=tuple(CHANNELS)),
    "sample_interval": FieldRule("number", 1e-6, 0.1, "s", or_zero=True),
    "samples": FieldRule("whole number", 4, 10**4, or_zero=True),
    "cycles": FieldRule("whole number", 1, 1000, or_zero=True),
    "hidden": FieldRule("whole number", 1, 64),
    "components": FieldRule("whole number", 0, 1000),
    "starts": FieldRule("whole number", 1, 100),
}
"""Every field with its limits, in the order of the page."""


def named_recipe(name: str, field: str = "recipe") -> WindowRecipe:
    """A packaged recipe. Raises StudyError naming the known ones."""
    if name not in RECIPES:
        raise StudyError("recipe", [_unknown(name, field)])
    return RECIPES[name]


def _unknown(name: str, field: str) -> Fault:
    if name in FIELD_RECIPES:
        advice = "vsgdesign estimator train alone takes it. " + f"Known here: {', '.join(RECIPES)}."
        return Fault(field, f'"{name}"', "trains the network of the field estimator, which has no windows", advice)
    near = difflib.get_close_matches(name, RECIPES, n=1)
    advice = f"Did you mean {near[0]}? " if near else ""
    files = "; or a .toml file" if field == "recipe" else ""
    return Fault(field, f'"{name}"', "unknown", f"{advice}Known: {', '.join(RECIPES)}{files}.")


def load_recipe(source: str | Path) -> WindowRecipe:
    """A packaged recipe by name, or a TOML file: ``base`` names a packaged one, further fields replace its own.

    A field with a spread is a number, ``{ one_of = [...] }``, ``{ uniform = [low, high] }`` or
    ``{ log_uniform = [low, high] }``. Raises StudyError with every fault.
    """
    path = Path(source)
    if path.suffix != ".toml":
        return named_recipe(str(source))
    document = read_recipe(path, (*RECIPES, *FIELD_RECIPES))
    faults: list[Fault] = []
    name = document.pop("base", CONTINUOUS.name)
    if not isinstance(name, str) or name not in RECIPES:
        faults.append(_unknown(str(name), "base"))
        if name in FIELD_RECIPES:  # none of its fields is known here
            raise StudyError(str(path), faults)
    base = RECIPES.get(str(name), CONTINUOUS)
    found, unread = read_fields(document, FIELDS)
    faults += unread
    recipe = replace(base, **({"name": path.stem} | found))
    # What could not be read is still the base's, so that the limits of the rest are told at the same time.
    faults += _faults(recipe)
    if faults:
        raise StudyError(str(path), faults)
    return recipe


def check_recipe(recipe: WindowRecipe, source: str = "recipe") -> WindowRecipe:
    """The recipe itself. Raises StudyError with every fault: not finite, reversed, outside what makes sense."""
    faults = _faults(recipe)
    if faults:
        raise StudyError(source, faults)
    return recipe


def _faults(recipe: WindowRecipe) -> list[Fault]:
    faults = field_faults(recipe, FIELDS)
    if recipe.before + recipe.after < 1:
        faults.append(Fault("before", "0", "no window is kept", "Keep at least one, before or after the change."))
    return faults
