"""What a gain table keeps of its verification by random cases: counts and bounds, no maps and no cases."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vsgdesign.artifacts.guarded_file import is_number

_KEPT = ("study", "controller", "seed", "confidence", "runs", "judged", "instruction_set", "strict")
_OF_FAMILY = ("title", "noun", "drawn", "judged", "left_out", "lost")
_OF_PROMISE = (
    "figure",
    "survival",
    "limit",
    "unit",
    "at_least",
    "broken",
    "judged",
    "share",
    "bound",
    "one_in",
    "worst",
)


def verification_record(document: Mapping[str, Any]) -> dict[str, Any]:
    """The part of results.json of ``vsgdesign verify`` that a table keeps (``GainTable.verification``)."""
    return {name: document[name] for name in _KEPT if name in document} | {
        "families": {
            key: {name: family[name] for name in _OF_FAMILY if name in family}
            | {
                "promises": {
                    promised: {name: promise[name] for name in _OF_PROMISE if name in promise}
                    for promised, promise in family["promises"].items()
                }
            }
            for key, family in document["families"].items()
        }
    }


def verification_faults(record: Any) -> list[str]:
    """What makes a record unreadable, a sentence each; empty where nothing does."""
    if not isinstance(record, Mapping):
        return ["must be a table of names and values, or null"]
    faults = [f"{name} must be a whole number" for name in ("runs", "judged") if type(record.get(name)) is not int]
    if not is_number(record.get("confidence")) or not 0.0 < record["confidence"] < 1.0:
        faults.append("confidence must be between 0 and 1")
    families = record.get("families")
    if not isinstance(families, Mapping) or not all(_is_family(family) for family in families.values()):
        faults.append("families must have promises, each with limit, broken, judged, share, bound, one_in and worst")
    return faults


def _is_family(family: Any) -> bool:
    promises = family.get("promises") if isinstance(family, Mapping) else None
    return isinstance(promises, Mapping) and all(_is_promise(promise) for promise in promises.values())


def _is_promise(promise: Any) -> bool:
    if not isinstance(promise, Mapping):
        return False
    counts = all(type(promise.get(name)) is int for name in ("broken", "judged"))
    known = {"share", "bound", "one_in", "worst"} <= promise.keys()
    return counts and known and is_number(promise.get("limit"))
