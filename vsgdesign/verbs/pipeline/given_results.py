"""What is made of results that are there: what differs between two of them, and the papers and versions behind one."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata, resources
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.files import provenance
from vsgdesign.artifacts.guarded_file import RESULTS, is_number
from vsgdesign.equations.structures import PUBLISHED
from vsgdesign.errors import ArtifactError
from vsgdesign.study.given_files import RESULT_BYTES, read_given
from vsgdesign.study.parameters.reader import same_quantity
from vsgdesign.verbs.pipeline.opening import check_study

SAME = 1e-9
"""Numbers whose difference is at most this share of the larger one are the same: other processors round otherwise."""

_WORDS = (
    ("settled", "measured", "survived"),
    ("limited",),
    ("not known", "window too short", "no model", "no rest", "rest over limit"),
    ("not settled", "not at rest", "infeasible", "no steady state"),
    ("unstable", "latched", "slipped", "tripped", "blocked"),
    ("diverged",),
)
"""The words of a field ``status``, from the best to the worst."""
_RANK = {word: rank for rank, words in enumerate(_WORDS) for word in words}
_ANSWERS = ("kept", "met", "certified", "passed", "V_within_limits")
"""Fields that are verdicts themselves: true is better than null, and null better than false."""

_TIMES = frozenset({"timing_s", "loop_s", "real_time_factor", "files", "schema"})
_COPIES = frozenset({"kept_ideal", "cycle_mean", "one_cycle_mean"})
_LEFT_OUT = _TIMES | _COPIES
"""What no study asks for, and what stands elsewhere in the same result."""
_WHICH = ("controller", "event", "signal", "label", "t_s", "time")
_NAMES = ("controller", "name", *_WHICH[1:])
"""Fields that tell the entries of a list apart: without their names, which contain values that may change, or with."""


class Change(NamedTuple):
    """A value that is not the same in both results. It is None where there is none."""

    place: tuple[str, ...]
    """The keys that lead to it; entries of a list by their names and instants."""
    a: Any
    b: Any

    @property
    def worse(self) -> bool | None:
        """Whether a verdict got worse. None: it is no verdict, or none that is better or worse."""
        a, b = (_rank(self.place, value) for value in (self.a, self.b))
        return None if a is None or b is None or a == b else b > a


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two results of the same verb, A and B."""

    kind: str
    """The verb that wrote both."""
    a: Path
    b: Path
    inputs: tuple[Change, ...]
    """What was asked for: the study and the versions of the program."""
    verdicts: tuple[Change, ...]
    """Those that got worse first."""
    figures: tuple[Change, ...]
    """Everything else."""

    @property
    def worse(self) -> int:
        """How many verdicts got worse."""
        return sum(one.worse is True for one in self.verdicts)

    def document(self) -> dict[str, Any]:
        """All changes in JSON's types."""
        changes = {name: [one._asdict() for one in getattr(self, name)] for name in ("inputs", "figures")}
        verdicts = [one._asdict() | {"worse": one.worse} for one in self.verdicts]
        return {
            "kind": self.kind,
            "a": str(self.a),
            "b": str(self.b),
            "worse": self.worse,
            "verdicts": verdicts,
        } | changes


def compare_results(a: str | Path, b: str | Path) -> Comparison:
    """The changes from A to B, each a results.json or the folder that has one.

    Raises ArtifactError for a file that is no result, and for results of two verbs.
    """
    files = [Path(path) / RESULTS if Path(path).is_dir() else Path(path) for path in (a, b)]
    documents = [read_result(file) for file in files]
    kinds = [document["kind"] for document in documents]
    if kinds[0] != kinds[1]:
        both = " and ".join(f'"{file}" is a result of "{kind}"' for file, kind in zip(files, kinds, strict=True))
        raise ArtifactError(f"{both}. Give two results of the same verb.")
    changes = list(changes_of(documents[0], documents[1]))
    inputs = [one for one in changes if one.place[0] in ("study", "provenance")]
    verdicts = [one for one in changes if one.worse is not None and one not in inputs]
    figures = [one for one in changes if one not in inputs and one not in verdicts]
    verdicts.sort(key=lambda one: not one.worse)
    return Comparison(
        kind=kinds[0],
        a=files[0],
        b=files[1],
        inputs=tuple(inputs),
        verdicts=tuple(verdicts),
        figures=tuple(figures),
    )


def changes_of(a: Any, b: Any, place: tuple[str, ...] = ()) -> Iterator[Change]:
    """Every value that is not the same in two documents of JSON's types, depth first."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in dict.fromkeys([*a, *b]):
            copied = key == "study" if place else key == "sha256"
            if key not in _LEFT_OUT and not copied:
                yield from changes_of(a.get(key), b.get(key), (*place, key))
    elif isinstance(a, list) and isinstance(b, list) and (named := _by_name(a, b)) is not None:
        yield from chain.from_iterable(changes_of(x, y, (*place, name)) for name, (x, y) in named.items())
    elif not _same(a, b, asked=place[:1] == ("study",)):
        yield Change(place, a, b)


def _by_name(a: list[Any], b: list[Any]) -> dict[str, tuple[Any, Any]] | None:
    """The entries of two lists by what tells them apart; None where they are lists of values."""
    if not all(isinstance(one, dict) for one in [*a, *b]) or not (a or b):
        return None
    for fields in (_WHICH, _NAMES):
        of_a, of_b = _names(a, fields), _names(b, fields)
        if of_a is not None and of_b is not None:
            break
    else:
        of_a, of_b = ([str(k + 1) for k in range(len(some))] for some in (a, b))
    first, second = dict(zip(of_a, a, strict=True)), dict(zip(of_b, b, strict=True))
    found = {key: (first.get(key), second.get(key)) for key in dict.fromkeys([*first, *second])}
    return {_label(key, [one for one in pair if one is not None]): pair for key, pair in found.items()}


def _names(entries: list[dict[str, Any]], fields: Sequence[str]) -> list[str] | None:
    """A name for each entry from these fields; None where two have the same."""
    found = [", ".join(_name(field, one[field]) for field in fields if field in one) for one in entries]
    return found if all(found) and len(set(found)) == len(found) else None


def _label(key: str, entries: list[dict[str, Any]]) -> str:
    """What a pair of entries is called: with their name, if they have the same."""
    names = _names(entries[:1], _NAMES)
    return names[0] if names is not None and names == _names(entries[-1:], _NAMES) else key


def _name(field: str, value: Any) -> str:
    return f"{value:g} s" if field == "t_s" and is_number(value) else str(value)


def _same(a: Any, b: Any, asked: bool) -> bool:
    if is_number(a) and is_number(b):
        return a == b or abs(a - b) <= SAME * max(abs(a), abs(b))
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_same(x, y, asked) for x, y in zip(a, b, strict=True))
    if asked and a is not None and b is not None and same_quantity(a, b):
        return True
    return bool(a == b) and isinstance(a, bool) == isinstance(b, bool)


def _rank(place: Sequence[str], value: Any) -> float | None:
    """The rank of a verdict, the smaller, the better; None where it is no verdict."""
    field = place[-1]
    if field in _ANSWERS:
        return {True: 0, None: 1, False: 2}.get(value) if not is_number(value) else -value
    if field == "status" and isinstance(value, str):
        return _RANK.get(value)
    if len(place) == 2 and place[0] == "warnings":  # of an instability: it is there, or it is not
        return float(value is not None)
    return None


def read_result(path: Path) -> dict[str, Any]:
    """The document of a results.json. Raises ArtifactError."""
    try:
        document = json.loads(read_given(path, RESULT_BYTES))
    except (OSError, ValueError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no JSON"
        raise ArtifactError(
            f'"{path}" cannot be read: {why}. Give a results.json, or a folder that has one.'
        ) from error
    if not isinstance(document, dict) or not isinstance(document.get("kind"), str):
        raise ArtifactError(f'"{path}" is no result: it does not say which verb wrote it. Give a results.json.')
    return document


_ALWAYS = {"numpy": "arrays", "scipy": "numerical methods", "llvmlite": "machine code of the simulation"}
_LETTERS = {"{\\'c}": "ć", '{\\"a}': "ä", "{\\'e}": "é", "--": "–", "{": "", "}": ""}
"""How BibTeX writes what is read here."""
PAPERS = {
    ("structure", "published"): "hoang2025",
    ("estimate", "neural"): "hoang2025",
    ("estimate", "rls"): "fortescue1981",
    ("estimate", "prbs"): "vandenbos1979",
    ("current_limiter", "hybrid"): "baeckeland2023",
    ("source", "Hoang"): "hoang2025",
    ("source", "Pogaku"): "pogaku2007",
    ("source", "D'Arco"): "darco2015",
}
"""What of a study comes from which paper. A source of data is known by the name with which it begins."""
_OF_VERBS = {
    "vsgdesign comply": {"hua1990": "modes of a run"},
    "vsgdesign verify": {"clopper1934": "bound of a share"},
    "vsgdesign run": {"control": "margins"},
    "vsgdesign report": {"control": "margins"},
}


class Citation(NamedTuple):
    """A paper or a program, and what it was used for."""

    key: str
    use: str
    version: str
    """Empty for a paper, and for a program whose version the result does not name."""
    fields: Mapping[str, str]
    """Those of an entry of BibTeX, with its ``type``."""

    def text(self) -> str:
        """Two lines: the key and its use, and the work itself."""
        authors = self.fields["author"].replace(" and others", " et al.").replace(" and ", "; ")
        version = f"version {self.version}" if self.version else ""
        rest = (self.fields.get(name, "") for name in ("journal", "booktitle", "note", "volume", "pages", "year"))
        work = ", ".join(part for part in (f'{authors}: "{self.fields["title"]}"', version, *rest) if part)
        for written, letter in _LETTERS.items():
            work = work.replace(written, letter)
        return f"{self.key}: {self.use}.\n  {work}."

    def bibtex(self) -> str:
        """The entry. The version of a program whose paper is cited stands in its note."""
        fields = {name: text for name, text in self.fields.items() if name != "type"}
        if self.version:
            named = "version" if self.fields["type"] == "software" else "note"
            text = self.version if named == "version" else f"version {self.version} was used"
            fields[named] = f"{fields[named]}; {text}" if named in fields else text
        lines = "".join(f"  {name} = {{{text}}},\n" for name, text in fields.items())
        return f"@{self.fields['type']}{{{self.key},\n{lines}}}"


def references() -> dict[str, dict[str, str]]:
    """Every entry that can be cited, by its key."""
    return tomllib.loads(
        resources.files("vsgdesign.verbs.pipeline").joinpath("references.toml").read_text(encoding="utf-8")
    )


def cite(path: str | Path) -> list[Citation]:
    """What to cite for a study file, a folder of results or its ``results.json``, this program first.

    A result names the versions that it was made with, and a study those that are installed. Raises StudyError for a
    study that is wrong, and ArtifactError for a file that is no result of a study.
    """
    path = Path(path)
    if path.is_dir() or path.suffix == ".json":
        document = read_result(path / RESULTS if path.is_dir() else path)
        study, versions, kind = document.get("study"), document.get("provenance"), document["kind"]
        if not isinstance(study, dict) or not isinstance(versions, dict):
            raise ArtifactError(
                f'"{path}" is a result of "{kind}", which names no study. Give a study, or a result of vsgdesign run.'
            )
        versions = {name: str(version) for name, version in versions.items()}
    else:
        found, _ = check_study(path)
        study, versions, kind = found.identity, _installed(), "vsgdesign run"
    entries, uses = references(), dict[str, list[str]]()
    try:
        for key, use in _used(study, kind):
            uses.setdefault(key, []).append(use)
    except (AttributeError, KeyError, TypeError) as error:
        raise ArtifactError(f'"{path}": the study in it is not as vsgdesign writes it. Give the original.') from error
    return [
        Citation(key, "; ".join(dict.fromkeys(uses[key])), versions.get(key, ""), entry)
        for key, entry in entries.items()
        if key in uses
    ]


def _installed() -> dict[str, str]:
    with suppress(metadata.PackageNotFoundError):
        return provenance() | {"torch": metadata.version("torch")}
    return provenance()


def _used(study: Mapping[str, Any], kind: str) -> Iterator[tuple[str, str]]:
    """Keys of entries, and what each was used for."""
    yield "vsgdesign", f"made the results of {kind}"
    yield from _ALWAYS.items()
    yield from _OF_VERBS.get(kind, {}).items()
    inputs = study.get("inputs") or {}
    if "verification" in inputs:
        yield "clopper1934", "bound of a share"
    if source := str(study.get("source") or ""):
        yield from (
            (key, f"data of the converter ({source})")
            for (field, name), key in PAPERS.items()
            if field == "source" and source.startswith(name)
        )
    if _part(inputs, "inner_loops").get("design") is True:
        yield "cmaes", "design of the inner loops"
    default = {
        "structure": _part(inputs, "power_loops").get("structure", PUBLISHED.name),
        "current_limiter": _part(inputs, "converter").get("current_limiter"),
    }
    controllers = [default | own for own in inputs.get("controllers", ())]
    for (field, value), key in PAPERS.items():
        if names := [own["name"] for own in controllers if own.get(field) == value]:
            yield key, f"{field.replace('_', ' ')} {value} of {', '.join(names)}"
    if "weights" not in _part(inputs, "estimator") and any(own.get("estimate") == "neural" for own in controllers):
        yield "torch", "training of the network"
    if names := ", ".join(own["name"] for own in controllers if own.get("schedule") == "table"):
        yield from ((key, f"gain table of {names}") for key in ("casadi", "ipopt"))
        yield from ((key, f"certificate of {names}") for key in ("clarabel", "cvxpy"))


def _part(inputs: Mapping[str, Any], section: str) -> Mapping[str, Any]:
    return inputs.get(section, {})
