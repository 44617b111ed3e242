"""The answer on top of the stability page: each controller against its gates."""

from __future__ import annotations

from collections.abc import Sequence

from vsgdesign.report.drawing import spark
from vsgdesign.report.page.blocks import MET, MISSED, UNKNOWN, Answer, Cell, Row, counted
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.stability.verdict import FAIL, OWN, PASS, Verdict

_MODEL, _REDUCED = " (full order)", " (reduced)"
_TITLES = {
    "stable in every cell within the limits": "Stable",
    "2 % settling of P and Q steps": "Settling time",
}
"""Short headings of gates; any other has the name of its quantity."""


def gates_of(result: StabilityResult, name: str) -> list[Verdict]:
    """The internal gates of one controller, in the order of the clause matrix."""
    return [row for row in result.verdicts if row.controller == name and row.source == OWN]


def stability_headline(result: StabilityResult) -> str:
    """Which controllers meet all of their gates."""
    names = [a.spec.name for a in result.assessments]
    good = [name for name in names if all(row.verdict == PASS for row in gates_of(result, name))]
    if len(names) == 1:
        return f"{names[0]} {'meets' if good else 'does not meet'} all of its gates."
    if not good:
        return "No controller meets all of its gates."
    return (
        "Every controller meets all of its gates." if good == names else f"All gates are met by {', '.join(good)} only."
    )


def stability_answer(result: StabilityResult) -> Answer:
    """One row a controller, one column for all gates and one for each gate of the model that counts."""
    of_controllers = {a.spec.name: gates_of(result, a.spec.name) for a in result.assessments}
    tests = [
        test for test in dict.fromkeys(row.test for own in of_controllers.values() for row in own) if _counts(test)
    ]
    rows = tuple(
        Row(name, (_all(own), *(_gate(own, test) for test in tests)), spark.key(index))
        for index, (name, own) in enumerate(of_controllers.items())
    )
    notes = (
        "Worst cells of the full-order model within the converter's limits; the settling time is that of the reduced "
        "model. A gate is a limit for a margin that this project or the study sets; no grid code asks for it. Those of "
        "the reduced model are in part 1.",
    )
    return Answer("Against the gates", ("All gates", *map(_title, tests)), rows, notes=notes)


def _counts(test: str) -> bool:
    """Whether a gate has a column: those of the full-order model, and those that the reduced one alone has."""
    return test.endswith(_MODEL) or test.startswith("2 % settling")


def _title(test: str) -> str:
    short = test.removesuffix(_MODEL).removesuffix(_REDUCED).removesuffix(", worst cell")
    title = _TITLES.get(short, short)
    return title[0].upper() + title[1:]


def _all(own: Sequence[Verdict]) -> Cell:
    judged = [row.verdict == PASS for row in own if row.verdict in (PASS, FAIL)]
    left = len(own) - len(judged)
    if not judged:
        return Cell(UNKNOWN, "not assessed")
    return counted(judged, f"{left} of {len(own)} not assessed" if left else "")


def _gate(own: Sequence[Verdict], test: str) -> Cell:
    row = next((one for one in own if one.test == test), None)
    if row is None or row.verdict not in (PASS, FAIL):
        return Cell(UNKNOWN, "not assessed")
    value, _, where = row.value.partition(" at ")
    detail = f"{value}, asked {row.limit}{f'; at {where}' if where else ''}"
    return Cell(MET, "met", detail) if row.verdict == PASS else Cell(MISSED, "missed", detail)
