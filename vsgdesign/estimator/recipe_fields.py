"""Recipes, of which each says what the data of a network are made of: their fields, how they are read and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, TypeVar, get_type_hints

import numpy as np

from vsgdesign.artifacts.files import plain
from vsgdesign.errors import Fault, StudyError, did_you_mean
from vsgdesign.study.parameters.toml_file import read_toml
from vsgdesign.study.parameters.units import UnitError, parse_quantity

KINDS = ("one_of", "uniform", "log_uniform")
_OF_A_STUDY = {"study", "converter", "simulation", "controllers"}
"""Sections of a study, by which one is recognised."""


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


@dataclass(frozen=True)
class FieldRule:
    """What a recipe's field may be, the annotation of the field: the pages of the recipes have a row of each."""

    kind: str
    """``spread``, ``number``, ``whole number``, ``word``, ``text``, ``texts`` (a list of cases and files), or ``true or
    false``."""
    low: float = -math.inf
    high: float = math.inf
    """Limits, SI; of a spread: of each of its values."""
    unit: str = "1"
    words: tuple[str, ...] = ()
    or_zero: bool = False
    """0 is allowed too: it follows from the converter."""


@cache
def rules_of(kind: type[Recipe]) -> dict[str, FieldRule]:
    """Every field of a kind of recipe with its limits, in the order of its class."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if hasattr(hint, "__metadata__")}


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What the runs are made of that a network is trained on, and its size."""

    counted: ClassVar[str]
    """The field with the number of runs."""

    name: Annotated[str, FieldRule("text")]

    @property
    def count(self) -> int:
        """Number of runs."""
        return getattr(self, self.counted)

    def document(self) -> dict[str, Any]:
        """The recipe in JSON's types, as it comes back from a file."""
        return plain(self)

    def faults(self) -> list[Fault]:
        """A fault for every field that is not finite, reversed or outside its limits, and for fields that do not fit
        each other."""
        return [fault for name, rule in rules_of(type(self)).items() for fault in _fault(self, name, rule)]


R = TypeVar("R", bound=Recipe)


def check_recipe(recipe: R, source: str = "recipe") -> R:
    """The recipe itself. Raises StudyError with every fault: not finite, reversed, outside what makes sense."""
    faults = recipe.faults()
    if faults:
        raise StudyError(source, faults)
    return recipe


@dataclass(frozen=True)
class Library(Generic[R]):
    """The packaged recipes for one network, and how further ones are read."""

    packaged: Mapping[str, R]
    base: str
    """The packaged recipe that a file replaces fields of if it names none."""
    others: tuple[str, ...] = ()
    """Packaged recipes for another network."""
    refusal: str = ""
    """What is wrong with those here."""

    def has(self, source: str | Path) -> bool:
        """Whether a recipe, given by name or as a TOML file with a ``base``, is for this network.

        Raises StudyError if the file cannot be read.
        """
        name = read_toml(Path(source), "recipe").get("base") if Path(source).suffix == ".toml" else str(source)
        return isinstance(name, str) and name in self.packaged

    def named(self, name: str, field: str = "recipe") -> R:
        """A packaged recipe. Raises StudyError naming the known ones."""
        if name not in self.packaged:
            raise StudyError("recipe", [self._unknown(name, field)])
        return self.packaged[name]

    def load(self, source: str | Path) -> R:
        """A packaged recipe by name, or a TOML file: ``base`` names a packaged one, further fields replace its own.

        A field with a spread is a number, ``{ one_of = [...] }``, ``{ uniform = [low, high] }`` or
        ``{ log_uniform = [low, high] }``. Files that a recipe names refer to its folder. Raises StudyError with every
        fault.
        """
        path = Path(source)
        if path.suffix != ".toml":
            return self.named(str(source))
        document = read_toml(path, "recipe")
        if document.keys() & _OF_A_STUDY:
            known = ", ".join((*self.packaged, *self.others))
            advice = f"Give a packaged recipe ({known}), or a .toml file with the fields of a recipe."
            raise StudyError("recipe", [Fault("recipe", f'"{path}"', "is a study, not a recipe", advice)])
        faults: list[Fault] = []
        name = document.pop("base", self.base)
        if not isinstance(name, str) or name not in self.packaged:
            faults.append(self._unknown(str(name), "base"))
            if name in self.others:  # none of its fields is known here
                raise StudyError(str(path), faults)
        base = self.packaged.get(str(name), self.packaged[self.base])
        found, unread = read_fields(document, rules_of(type(base)), path.parent)
        recipe = replace(base, **({"name": path.stem} | found))
        # What could not be read is still the base's, so that the limits of the rest are told at the same time.
        faults += unread + recipe.faults()
        if faults:
            raise StudyError(str(path), faults)
        return recipe

    def _unknown(self, name: str, field: str) -> Fault:
        known = ", ".join(self.packaged)
        if name in self.others:
            advice = f"vsgdesign estimator train alone takes it. Known here: {known}."
            return Fault(field, f'"{name}"', self.refusal, advice)
        files = "; or a .toml file" if field == "recipe" else ""
        advice = f"{did_you_mean(name, self.packaged, '')} Known: {known}{files}.".lstrip()
        return Fault(field, f'"{name}"', "unknown", advice)


def read_fields(
    document: Mapping[str, Any], rules: Mapping[str, FieldRule], folder: Path
) -> tuple[dict[str, Any], list[Fault]]:
    """Returns the values of a recipe's document by field, and a fault for each field that is unknown or unreadable."""
    values: dict[str, Any] = {}
    faults: list[Fault] = []
    for field, raw in document.items():
        if field not in rules:
            known = "Known: " + ", ".join(rules) + "."
            faults.append(Fault(field, "", "unknown field", did_you_mean(field, rules, known)))
            continue
        try:
            values[field] = _read(raw, rules[field], folder)
        except UnitError as error:
            faults.append(Fault(field, f'"{raw}"' if isinstance(raw, str) else str(raw), str(error)))
    return values, faults


def _read(raw: Any, rule: FieldRule, folder: Path) -> Any:
    if rule.kind == "spread":
        if not isinstance(raw, dict):
            return one_of(parse_quantity(raw, rule.unit))
        if len(raw) != 1 or next(iter(raw)) not in KINDS or not isinstance(next(iter(raw.values())), list):
            raise UnitError(f"expected a number or {{ {' | '.join(KINDS)} = [...] }}")
        (kind, values), *_ = raw.items()
        return Spread(kind, tuple(parse_quantity(value, rule.unit) for value in values))
    if rule.kind == "number":
        return parse_quantity(raw, rule.unit)
    if rule.kind == "texts":
        if not isinstance(raw, list) or not all(isinstance(one, str) for one in raw):
            raise UnitError("expected a list of texts")
        return tuple(one if one.startswith("case:") else str(folder / one) for one in raw)
    if rule.kind == "true or false":
        if not isinstance(raw, bool):
            raise UnitError("must be true or false")
        return raw
    wanted = int if rule.kind == "whole number" else str
    if isinstance(raw, bool) or not isinstance(raw, wanted):
        raise UnitError("expected a whole number" if wanted is int else "expected a text")
    return raw


def _fault(recipe: Recipe, name: str, rule: FieldRule) -> list[Fault]:
    """The fault of one field, if it has one."""
    value, problem, shown = getattr(recipe, name), "", ""
    if rule.kind == "spread":
        problem, shown = _spread_problem(value, rule), f"{value.kind} {list(value.values)}"
    elif rule.kind == "word":
        problem = "" if value in rule.words else "must be one of " + ", ".join(f'"{word}"' for word in rule.words)
        shown = f'"{value}"'
    elif rule.kind in ("number", "whole number"):
        problem, shown = _number_problem(value, rule), str(value)
    advice = "Check the unit: a bare number is SI." if rule.unit != "1" else ""
    return [Fault(name, shown, problem, advice)] if problem else []


def _limits(rule: FieldRule) -> str:
    whole = "a whole number " if rule.kind == "whole number" else ""
    unit = "" if rule.unit == "1" else f" {rule.unit}"
    zero = ", or 0: it follows from the converter" if rule.or_zero else ""
    return f"must be {whole}from {rule.low:g} to {rule.high:g}{unit}{zero}"


def _number_problem(value: Any, rule: FieldRule) -> str:
    whole = rule.kind != "whole number" or (isinstance(value, int) and not isinstance(value, bool))
    if whole and (rule.low <= value <= rule.high or (rule.or_zero and value == 0)):
        return ""
    return _limits(rule)


def _spread_problem(spread: Spread, rule: FieldRule) -> str:
    values = spread.values
    if spread.kind not in KINDS:
        return "must be one of " + ", ".join(KINDS)
    if not values or not all(math.isfinite(value) for value in values):
        return "needs finite numbers"
    if spread.kind != "one_of" and (len(values) != 2 or values[0] > values[1]):
        return "needs [low, high] with low not above high"
    if spread.kind == "log_uniform" and values[0] <= 0.0:
        return "a logarithmic range must be positive"
    return "" if min(values) >= rule.low and max(values) <= rule.high else _limits(rule)
