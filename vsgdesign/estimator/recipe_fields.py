"""What a field of a recipe may hold: spreads that values are drawn from, limits, and how they are read and checked."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.errors import Fault, StudyError
from vsgdesign.parameters.toml_file import read_toml
from vsgdesign.parameters.units import UnitError, parse_quantity

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
    """What a recipe's field may be: docs/how-to/windows.md has a row of each."""

    kind: str
    """``spread``, ``number``, ``whole number``, ``word``, ``text``, ``texts`` (a list) or ``true or false``."""
    low: float = -math.inf
    high: float = math.inf
    """Limits, SI; of a spread: of each of its values."""
    unit: str = "1"
    words: tuple[str, ...] = ()
    or_zero: bool = False
    """0 is allowed too: it follows from the converter."""


def read_recipe(path: Path, known: Iterable[str]) -> dict[str, Any]:
    """The document of a recipe's file. Raises StudyError, also for a study that is given in its place."""
    document = read_toml(path, "recipe")
    if document.keys() & _OF_A_STUDY:
        advice = f"Give a packaged recipe ({', '.join(known)}), or a .toml file with the fields of a recipe."
        raise StudyError("recipe", [Fault("recipe", f'"{path}"', "is a study, not a recipe", advice)])
    return document


def read_fields(document: Mapping[str, Any], rules: Mapping[str, FieldRule]) -> tuple[dict[str, Any], list[Fault]]:
    """Returns the values of a recipe's document by field, and a fault for each field that is unknown or unreadable."""
    values: dict[str, Any] = {}
    faults: list[Fault] = []
    for field, raw in document.items():
        if field not in rules:
            near = difflib.get_close_matches(field, rules, n=1)
            known = "Known: " + ", ".join(rules) + "."
            faults.append(Fault(field, "", "unknown field", f"Did you mean {near[0]}?" if near else known))
            continue
        try:
            values[field] = _read(raw, rules[field])
        except UnitError as error:
            faults.append(Fault(field, f'"{raw}"' if isinstance(raw, str) else str(raw), str(error)))
    return values, faults


def _read(raw: Any, rule: FieldRule) -> Any:
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
        return tuple(raw)
    if rule.kind == "true or false":
        if not isinstance(raw, bool):
            raise UnitError("must be true or false")
        return raw
    wanted = int if rule.kind == "whole number" else str
    if isinstance(raw, bool) or not isinstance(raw, wanted):
        raise UnitError("expected a whole number" if wanted is int else "expected a text")
    return raw


def field_faults(recipe: Any, rules: Mapping[str, FieldRule]) -> list[Fault]:
    """A fault for every field of a recipe that is not finite, reversed or outside its limits."""
    faults = []
    for name, rule in rules.items():
        value = getattr(recipe, name)
        if rule.kind == "spread":
            problem, shown = _spread_problem(value, rule), f"{value.kind} {list(value.values)}"
        elif rule.kind == "word":
            problem = "" if value in rule.words else "must be one of " + ", ".join(f'"{word}"' for word in rule.words)
            shown = f'"{value}"'
        elif rule.kind in ("number", "whole number"):
            problem, shown = _number_problem(value, rule), str(value)
        else:
            continue
        if problem:
            faults.append(
                Fault(name, shown, problem, "Check the unit: a bare number is SI." if rule.unit != "1" else "")
            )
    return faults


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
