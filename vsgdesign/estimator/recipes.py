"""What a data set of windows is made of: ranges of grids, powers and disturbances, and how windows are taken."""

from __future__ import annotations

import difflib
import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts.files import plain
from vsgdesign.errors import Fault, StudyError
from vsgdesign.parameters.toml_file import read_toml
from vsgdesign.parameters.units import UnitError, parse_quantity

CHANNELS = {"phase_a": 1, "alpha_beta": 2, "dq": 2}
"""Components of voltage and of current in a window, by name. ``dq`` is the converter's own frame."""

KINDS = ("one_of", "uniform", "log_uniform")


@dataclass(frozen=True)
class Spread:
    """What a quantity is drawn from: each of some values in turn, or a range, linear or logarithmic."""

    kind: str
    values: tuple[float, ...]
    """The values of ``one_of``; low and high of the others."""

    def draw(self, rng: np.random.Generator, index: int) -> float:
        """One value; ``one_of`` goes by the scenario's index, so that every value is used equally often."""
        if self.kind == "one_of":
            return self.values[index % len(self.values)]
        low, high = self.values
        if self.kind == "uniform":
            return float(rng.uniform(low, high))
        return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def one_of(*values: float) -> Spread:
    """Each of the values in turn."""
    return Spread("one_of", values)


def uniform(low: float, high: float) -> Spread:
    """Evenly between two values."""
    return Spread("uniform", (low, high))


def log_uniform(low: float, high: float) -> Spread:
    """Evenly in the logarithm between two values."""
    return Spread("log_uniform", (low, high))


_NOMINAL, _NONE = one_of(1.0), one_of(0.0)


@dataclass(frozen=True)
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
    """Of the windows after the change every so many-th is kept, so that they tell the transient."""
    settle: int = 2
    """Windows left out at the start, where the ripple of a switched bridge settles."""
    skip: int = 1
    """Windows left out right after the change, where the inner loops still move."""
    grid_step_share: float = 0.0
    """Share of the scenarios whose change is a change of grid, drawn anew from the same ranges."""
    grid_step_ratio: float = 5.0
    """Largest ratio of the two grids' SCR."""
    scr_basis: str = "reactance"
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
    sample_interval: float = 200e-6
    samples: int = 100

    @property
    def update_period(self) -> float:
        """Length of a window, s."""
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

RECIPES = {recipe.name: recipe for recipe in (PUBLISHED, CONTINUOUS)}

_POSITIVE = ("scr", "x_over_r", "V_g_pu", "f_g_pu")
_SHARES = {"noise_v": 1.0, "noise_i": 1.0, "harmonic_5": 0.5, "harmonic_7": 0.5}
_COUNTS = {"scenarios": (1, 10**6), "before": (0, 1000), "after": (0, 1000), "every": (1, 1000), "settle": (0, 1000),
           "skip": (0, 1000), "adc_bits": (0, 32), "samples": (4, 10**4)}  # fmt: skip
_LIMITS = {"grid_step_share": (0.0, 1.0), "grid_step_ratio": (1.0, 1000.0), "adc_range_pu": (0.1, 100.0),
           "sample_interval": (1e-6, 0.1)}  # fmt: skip
_WORDS = {"bridge": ("averaged", "pwm"), "channels": tuple(CHANNELS), "scr_basis": ("impedance", "reactance")}
_DIMENSIONS = {"phase": "rad", "sample_interval": "s"}


def named_recipe(name: str) -> WindowRecipe:
    """A packaged recipe. Raises StudyError naming the known ones."""
    if name not in RECIPES:
        near = difflib.get_close_matches(name, RECIPES, n=1)
        advice = f"Did you mean {near[0]}? " if near else ""
        known = ", ".join(RECIPES)
        raise StudyError(
            "recipe", [Fault("recipe", f'"{name}"', "unknown", f"{advice}Known: {known}; or a .toml file")]
        )
    return RECIPES[name]


def load_recipe(source: str | Path) -> WindowRecipe:
    """A packaged recipe by name, or a TOML file: ``base`` names a packaged one, further fields replace its own.

    A field with a spread is a number, ``{ one_of = [...] }``, ``{ uniform = [low, high] }`` or
    ``{ log_uniform = [low, high] }``. Raises StudyError with every fault.
    """
    path = Path(source)
    if path.suffix != ".toml":
        return named_recipe(str(source))
    document = read_toml(path, "recipe")
    base = named_recipe(str(document.pop("base", "continuous")))
    faults: list[Fault] = []
    known = {field.name: getattr(base, field.name) for field in fields(base)}
    changes: dict[str, Any] = {"name": path.stem}
    for field, raw in document.items():
        if field not in known:
            near = difflib.get_close_matches(field, known, n=1)
            faults.append(Fault(field, "", "unknown field", f"Did you mean {near[0]}?" if near else ""))
            continue
        try:
            changes[field] = _read(raw, known[field], _DIMENSIONS.get(field, "1"))
        except UnitError as error:
            faults.append(Fault(field, str(raw), str(error)))
    if faults:
        raise StudyError(str(path), faults)
    return check_recipe(replace(base, **changes), str(path))


def _read(raw: Any, present: Any, dimension: str) -> Any:
    if isinstance(present, Spread):
        if not isinstance(raw, dict):
            return one_of(parse_quantity(raw, dimension))
        if len(raw) != 1 or next(iter(raw)) not in KINDS or not isinstance(next(iter(raw.values())), list):
            raise UnitError(f"expected a number or {{ {' | '.join(KINDS)} = [...] }}")
        (kind, values), *_ = raw.items()
        return Spread(kind, tuple(parse_quantity(value, dimension) for value in values))
    if isinstance(present, float):
        return parse_quantity(raw, dimension)
    if isinstance(raw, bool) or not isinstance(raw, type(present)):
        raise UnitError("expected a whole number" if isinstance(present, int) else "expected a text")
    return raw


def check_recipe(recipe: WindowRecipe, source: str = "recipe") -> WindowRecipe:
    """The recipe itself. Raises StudyError with every fault: not finite, reversed, outside what makes sense."""
    faults: list[Fault] = []
    for field in fields(recipe):
        name, value = field.name, getattr(recipe, field.name)
        if isinstance(value, Spread):
            problem = _spread_problem(name, value)
            if problem:
                faults.append(Fault(name, f"{value.kind} {list(value.values)}", problem))
        elif name in _WORDS and value not in _WORDS[name]:
            faults.append(Fault(name, f'"{value}"', "must be one of " + ", ".join(f'"{w}"' for w in _WORDS[name])))
        elif name in _COUNTS and not _COUNTS[name][0] <= value <= _COUNTS[name][1]:
            low, high = _COUNTS[name]
            faults.append(Fault(name, str(value), f"must be a whole number from {low} to {high}"))
    for name, low, high in (
        ("grid_step_share", 0.0, 1.0),
        ("adc_range_pu", 0.1, 100.0),
        ("sample_interval", 1e-6, 0.1),
    ):
        if not low <= getattr(recipe, name) <= high:
            faults.append(Fault(name, str(getattr(recipe, name)), f"must be from {low:g} to {high:g}"))
    if recipe.before + recipe.after < 1:
        faults.append(Fault("before", "0", "no window is kept", "Keep at least one, before or after the change."))
    if faults:
        raise StudyError(source, faults)
    return recipe


def _spread_problem(name: str, spread: Spread) -> str:
    values = spread.values
    if spread.kind not in KINDS:
        return "must be one of " + ", ".join(KINDS)
    if not values or not all(math.isfinite(value) for value in values):
        return "needs finite numbers"
    if spread.kind != "one_of" and (len(values) != 2 or values[0] > values[1]):
        return "needs [low, high] with low not above high"
    if spread.kind == "log_uniform" and values[0] <= 0.0:
        return "a logarithmic range must be positive"
    if name in _POSITIVE and min(values) <= 0.0:
        return "must be positive"
    if name in _SHARES and not (min(values) >= 0.0 and max(values) <= _SHARES[name]):
        return f"must be from 0 to {_SHARES[name]:g}"
    return ""
