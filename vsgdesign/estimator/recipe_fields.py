"""Recipes, of which each says what the data of a network are made of, and how their files are read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from vsgdesign.artifacts.files import plain
from vsgdesign.errors import Fault, StudyError, did_you_mean
from vsgdesign.study.given_files import read_toml
from vsgdesign.study.parameters.fields import document, fields_of, read, section, text, values
from vsgdesign.study.parameters.reader import TableReader

_OF_A_STUDY = {"study", "converter", "simulation", "controllers"}
"""Sections of a study, by which one is recognised."""


@section
class Recipe:
    """What the runs are made of that a network is trained on, and its size."""

    counted: ClassVar[str]
    """The field with the number of runs."""

    name: str = text()

    @property
    def count(self) -> int:
        """Number of runs."""
        return getattr(self, self.counted)

    def document(self) -> dict[str, Any]:
        """The recipe in JSON's types, as it comes back from a file."""
        return plain(self)

    def misfits(self) -> list[Fault]:
        """A fault for every two fields that do not fit each other, where each is within its own limits."""
        return []


R = TypeVar("R", bound=Recipe)


def check_recipe(recipe: R, source: str = "recipe") -> R:
    """The recipe itself. Raises StudyError with every fault: not finite, reversed, outside what makes sense."""
    faults: list[Fault] = []
    read(type(recipe), TableReader(document(recipe), "", faults))
    faults += recipe.misfits()
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
        given = read_toml(path, "recipe")
        if given.keys() & _OF_A_STUDY:
            known = ", ".join((*self.packaged, *self.others))
            advice = f"Give a packaged recipe ({known}), or a .toml file with the fields of a recipe."
            raise StudyError("recipe", [Fault("recipe", f'"{path}"', "is a study, not a recipe", advice)])
        faults: list[Fault] = []
        name = given.pop("base", self.base)
        if not isinstance(name, str) or name not in self.packaged:
            faults.append(self._unknown(str(name), "base"))
            if name in self.others:  # none of its fields is known here
                raise StudyError(str(path), faults)
        base = self.packaged.get(str(name), self.packaged[self.base])
        table = TableReader(given, "", faults)
        found = values(type(base), table, defaults=vars(base) | {"name": path.stem})
        table.finish()
        for files in (one.name for one in fields_of(type(base)) if one.kind == "texts" and table.has(one.name)):
            found[files] = tuple(one if one.startswith("case:") else str(path.parent / one) for one in found[files])
        # A faulty field keeps the base's value, so that what does not fit among the others is told at the same time.
        faulty = {fault.field.partition(".")[0] for fault in faults}
        recipe = replace(base, **{field: value for field, value in found.items() if field not in faulty})
        faults += recipe.misfits()
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
