"""What the runs are made of on which the field estimator's network is trained."""

from __future__ import annotations

import difflib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import plain
from vsgdesign.equations.field_fusion import GateLimits
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.recipe_fields import (
    FieldRule,
    Spread,
    field_faults,
    log_uniform,
    read_fields,
    read_recipe,
    uniform,
)
from vsgdesign.parameters.toml_file import read_toml

BACKGROUNDS = ("clean", "measured", "dirty")
SENSORS = ("ideal", "typical", "dirty")
"""Packaged levels of a study's [background] and [sensors]."""

_DEGREE = 0.017453292519943295


@dataclass(frozen=True, kw_only=True)
class FieldRecipe:
    """Runs in a disturbed grid, each with some changes, and the network that learns them.

    Ratios are per unit of the converter's rating. The shares say how often a change is of which kind; nothing happens
    in the rest of them.
    """

    name: str
    runs: int
    converters: tuple[str, ...] = ()
    """Further converters, "case:NAME" or study files, beside the study's own; runs take them in turn."""
    scr: Spread
    x_over_r: Spread
    scr_basis: str = "impedance"
    P_pu: Spread
    Q_pu: Spread
    """Powers at the start; the references are set so that droop does not move them."""
    V_g_pu: Spread
    f_g_pu: Spread
    largest_current_pu: float = 0.95
    """Largest current of the bridge at rest, before and after every change; what exceeds it is drawn again."""
    changes: int = 2
    first: float = 1.4
    between: float = 1.0
    """Changes of a run, the time of the first one, s, and the time from one to the next. Each comes up to a cycle
    later, at random, so that it falls anywhere within a cycle."""
    learn: float = 0.4
    """Time at the start of a run that is left out, s."""
    jump_share: float = 0.35
    jump_and_step_share: float = 0.25
    grid_step_share: float = 0.25
    power_step_share: float = 0.1
    near_share: float = 0.4
    """Share of the jumps whose new SCR is within a factor of 2 of the old one; the others are drawn from ``scr``."""
    V_step_pu: Spread
    phase_step: Spread
    f_step_pu: Spread
    P_step_pu: Spread
    Q_step_pu: Spread
    background: str = "dirty"
    sensors: str = "dirty"
    bridge: str = "pwm"
    hidden: int = 24
    epochs: int = 80
    weight: float = 7.0
    weighted: float = 0.35
    """Cycles within ``weighted`` s after a change count ``weight`` times in the training."""
    first_cycle: int = 4
    first_cycle_refuted: int = 2
    last_cycle: int = 50
    confident: float = 0.15
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

    def document(self) -> dict[str, Any]:
        """The recipe in JSON's types."""
        return plain(asdict(self))


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

FIELD_RECIPES = {FIELD.name: FIELD}

FIELD_FIELDS = {
    "name": FieldRule("text"),
    "runs": FieldRule("whole number", 1, 10**5),
    "converters": FieldRule("texts"),
    "scr": FieldRule("spread", 0.05, 1e4),
    "x_over_r": FieldRule("spread", 1e-3, 1e4),
    "scr_basis": FieldRule("word", words=tuple(SCR_BASES)),
    "P_pu": FieldRule("spread", -2.0, 2.0),
    "Q_pu": FieldRule("spread", -2.0, 2.0),
    "V_g_pu": FieldRule("spread", 0.5, 1.5),
    "f_g_pu": FieldRule("spread", 0.9, 1.1),
    "largest_current_pu": FieldRule("number", 0.1, 2.0),
    "changes": FieldRule("whole number", 1, 20),
    "first": FieldRule("number", 0.5, 10.0, "s"),
    "between": FieldRule("number", 0.3, 10.0, "s"),
    "learn": FieldRule("number", 0.1, 5.0, "s"),
    "jump_share": FieldRule("number", 0.0, 1.0),
    "jump_and_step_share": FieldRule("number", 0.0, 1.0),
    "grid_step_share": FieldRule("number", 0.0, 1.0),
    "power_step_share": FieldRule("number", 0.0, 1.0),
    "near_share": FieldRule("number", 0.0, 1.0),
    "V_step_pu": FieldRule("spread", -0.5, 0.5),
    "phase_step": FieldRule("spread", -3.2, 3.2, "rad"),
    "f_step_pu": FieldRule("spread", -0.05, 0.05),
    "P_step_pu": FieldRule("spread", -2.0, 2.0),
    "Q_step_pu": FieldRule("spread", -2.0, 2.0),
    "background": FieldRule("word", words=BACKGROUNDS),
    "sensors": FieldRule("word", words=SENSORS),
    "bridge": FieldRule("word", words=("averaged", "pwm")),
    "hidden": FieldRule("whole number", 1, 64),
    "epochs": FieldRule("whole number", 1, 10**4),
    "weight": FieldRule("number", 1.0, 100.0),
    "weighted": FieldRule("number", 0.02, 10.0, "s"),
    "first_cycle": FieldRule("whole number", 1, 25),
    "first_cycle_refuted": FieldRule("whole number", 1, 25),
    "last_cycle": FieldRule("whole number", 1, 1000),
    "confident": FieldRule("number", 0.01, 1.0),
}
"""Every field with its limits, in the order of the page."""


def is_field_recipe(source: str | Path) -> bool:
    """Whether a recipe, given by name or as a TOML file, trains the field estimator's network.

    Raises StudyError if the file cannot be read.
    """
    path = Path(source)
    if path.suffix != ".toml":
        return str(source) in FIELD_RECIPES
    return read_toml(path, "recipe").get("base") in FIELD_RECIPES


def load_field_recipe(source: str | Path) -> FieldRecipe:
    """A packaged recipe by name, or a TOML file whose ``base`` names one and whose further fields replace its own.

    Converters that are files refer to the folder of the recipe. Raises StudyError with every fault.
    """
    path = Path(source)
    if path.suffix != ".toml":
        if str(source) not in FIELD_RECIPES:
            raise StudyError("recipe", [_unknown(str(source), "recipe")])
        return FIELD_RECIPES[str(source)]
    document = read_recipe(path, FIELD_RECIPES)
    faults: list[Fault] = []
    name = document.pop("base", FIELD.name)
    if not isinstance(name, str) or name not in FIELD_RECIPES:
        faults.append(_unknown(str(name), "base"))
    found, unread = read_fields(document, FIELD_FIELDS)
    if "converters" in found:
        found["converters"] = tuple(
            one if one.startswith("case:") else str(path.parent / one) for one in found["converters"]
        )
    recipe = replace(FIELD_RECIPES.get(str(name), FIELD), **({"name": path.stem} | found))
    faults += unread + _faults(recipe)
    if faults:
        raise StudyError(str(path), faults)
    return recipe


def check_field_recipe(recipe: FieldRecipe, source: str = "recipe") -> FieldRecipe:
    """The recipe itself. Raises StudyError with every fault."""
    faults = _faults(recipe)
    if faults:
        raise StudyError(source, faults)
    return recipe


def _unknown(name: str, field: str) -> Fault:
    near = difflib.get_close_matches(name, FIELD_RECIPES, n=1)
    advice = f"Did you mean {near[0]}? " if near else ""
    return Fault(field, f'"{name}"', "unknown", f"{advice}Known: {', '.join(FIELD_RECIPES)}.")


def _faults(recipe: FieldRecipe) -> list[Fault]:
    faults = field_faults(recipe, FIELD_FIELDS)
    shares = {name: getattr(recipe, name) for name in FIELD_FIELDS if name.endswith("_share") and name != "near_share"}
    if sum(shares.values()) > 1.0 + 1e-9:
        total = f"{sum(shares.values()):g}"
        faults.append(Fault("jump_share", total, "is the sum of the four shares, above 1", f"They are {shares}."))
    if recipe.learn >= recipe.first:
        faults.append(Fault("learn", f"{recipe.learn:g} s", f"must be below first = {recipe.first:g} s"))
    if not recipe.first_cycle_refuted <= recipe.first_cycle <= recipe.last_cycle:
        faults.append(
            Fault(
                "first_cycle",
                str(recipe.first_cycle),
                f"must be from first_cycle_refuted = {recipe.first_cycle_refuted} to last_cycle = {recipe.last_cycle}",
            )
        )
    return faults
