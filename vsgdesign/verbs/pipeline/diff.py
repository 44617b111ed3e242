"""What differs between two results of the same verb: inputs, verdicts and figures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.folders import RESULTS
from vsgdesign.errors import ArtifactError
from vsgdesign.study.given_files import RESULT_BYTES, read_given
from vsgdesign.study.parameters.units import same_quantity

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
    return f"{value:g} s" if field == "t_s" and _is_number(value) else str(value)


def _same(a: Any, b: Any, asked: bool) -> bool:
    if _is_number(a) and _is_number(b):
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
        return {True: 0, None: 1, False: 2}.get(value) if not _is_number(value) else -value
    if field == "status" and isinstance(value, str):
        return _RANK.get(value)
    if len(place) == 2 and place[0] == "warnings":  # of an instability: it is there, or it is not
        return float(value is not None)
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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
