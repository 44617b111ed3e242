"""What the page says first: one sentence, counts for each suite and controller, and what fails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

import numpy as np
from markupsafe import Markup

from vsgdesign.campaigns.compliance.rows import FAIL, IMPOSSIBLE, INFORMATIONAL, NOT_APPLICABLE, PASS
from vsgdesign.metrics.survival import BLOCKED
from vsgdesign.metrics.survival import VERDICTS as JUDGED
from vsgdesign.report.compliance.arranged import LOOKS, WHOSE, Arranged, Counts, Tested, asked_words, deadline_words
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.panels import counts_figure
from vsgdesign.report.drawing.sketch import Area, Sketch, svg
from vsgdesign.report.page.blocks import MET, MISSED, OPEN, Answer, Cell, Row, Table
from vsgdesign.simulation.dc_beyond import SURVIVED_OTHERWISE

MOST_FAILING = 12
"""Failing tests that are named on top; the matrix has all of them."""

MOST_SHORT = 3
"""Tests that are named for which the dc side does not suffice."""

DC_SHORT = "dc: the bridge takes "
"""How the reason begins that a source has no rest at a power
(:meth:`vsgdesign.study.parameters.dc_link.DcLink.at_rest`)."""

MOST_LETTERS = 130
"""Of a reason on top; the matrix has it whole."""

ABOUT_STRIPS = (
    "Every test of the matrix in its order, with a gap between groups. A stroke over the whole height fails, a high "
    "one passes or is impossible, a low one was not judged."
)

BAR_WIDTH, BAR_HEIGHT = 120.0, 12.0
_ORDER = (PASS, FAIL, IMPOSSIBLE, INFORMATIONAL, NOT_APPLICABLE)


@dataclass(frozen=True)
class Failing:
    """A failing test on top of the page: where it is, who fails, and why."""

    anchor: str
    test: str
    network: str
    who: str
    why: str


def headline(arranged: Arranged) -> str:
    """The answer in one sentence."""
    judged = [
        (name, counts) for name, counts in zip(arranged.controllers, arranged.counts, strict=True) if counts.judged
    ]
    if not judged:
        return "No test was judged: nothing was asked for, or nothing was possible."
    name, counts = judged[0]
    if len(judged) == 1:
        limits = f": {counts.limits}" if counts.limits else ""
        if not counts.of[FAIL]:
            return f"{name} passes all {counts.judged} tests that were judged{limits}."
        return f"{name} passes {_of(counts)} tests that were judged{limits}. It fails {counts.of[FAIL]}."
    said = [f"{name} passes {_of(counts)} judged tests", *(f"{other} {_of(one)}" for other, one in judged[1:])]
    return ", ".join(said[:-1]) + f" and {said[-1]}."


def _of(counts: Counts) -> str:
    return f"{counts.of[PASS]} of {counts.judged}"


def below_headline(arranged: Arranged) -> list[str]:
    """Sentences on whose limits are kept, and on tests without a run, each of every controller."""
    named = list(zip(arranged.controllers, arranged.counts, strict=True))
    said = []
    if sum(counts.judged > 0 for _, counts in named) > 1:
        passing = [f"{name}: {counts.limits}" for name, counts in named if counts.limits]
        said += [f"Of the tests that pass, {'; '.join(passing)}."] if passing else []
    missing = [f"{name}: {counts.not_run}" for name, counts in named if counts.not_run]
    if missing:
        begin = any(counts.not_begun for _, counts in named)
        why = " What could not begin fails, because the converter has no rest before the test." if begin else ""
        said.append(f"Tests without a run: {'; '.join(missing)}.{why}")
    return said


def dc_side_suffices(document: Mapping[str, Any]) -> list[str]:
    """One sentence for each controller on whether the energy and power of the dc side suffice in the tests of
    ``document``, a results.json; none where the link is ideal."""
    if not (document.get("converter") or {}).get("dc_source"):
        return []
    said = []
    for name in dict.fromkeys(row["controller"] for row in document["rows"]):
        own = [row for row in document["rows"] if row["controller"] == name]
        short = [row["test"] for row in own if row["status"] == BLOCKED or _of_dc_side(row)]
        count = sum(row["status"] in JUDGED for row in own) + sum(
            row["status"] not in JUDGED and _of_dc_side(row) for row in own
        )
        if not short:
            said.append(f"{name}: the energy and power of the dc side suffice in all {count} tests that were run.")
            continue
        more = f" and {len(short) - MOST_SHORT} more" if len(short) > MOST_SHORT else ""
        said.append(
            f"{name}: the energy and power of the dc side do not suffice in {len(short)} of {count} tests: "
            f"{'; '.join(short[:MOST_SHORT])}{more}."
        )
    return said


def _of_dc_side(row: Mapping[str, Any]) -> bool:
    """Whether a row says that the source of the dc link could not do what the test asks for."""
    return DC_SHORT in row["why"] or SURVIVED_OTHERWISE in row["why"]


def counts_answer(arranged: Arranged) -> Answer:
    """Counts of the verdicts: one row for each suite, one column for each controller."""
    rows = [(suite.title, suite.counts) for suite in arranged.suites]
    if len(rows) > 1:
        rows.insert(0, ("All suites", arranged.counts))
    judged = {(row["controller"], deadline_words(row)): None for test in arranged.tests() for row in test.known}
    said = "; ".join(f"{name} with {words}" for name, words in judged)
    notes = ["; ".join(f"{LOOKS[verdict].sign} {verdict}: {LOOKS[verdict].says}" for verdict in _ORDER) + "."]
    return Answer(
        "Verdicts",
        arranged.controllers,
        tuple(Row(title, tuple(_cell(title, one) for one in counts)) for title, counts in rows),
        subject="Suite",
        notes=(*notes, f"Survival is judged for {said}."),
    )


def counts_of_suites(arranged: Arranged) -> NamedFigure:
    """The verdicts of the suites by controller, as a picture: passed of judged."""
    rows = {suite.title: [(one.of[PASS], one.judged) for one in suite.counts] for suite in arranged.suites}
    caption = "Tests that are passed, of those that were judged. Framed: something fails."
    return counts_figure("verdicts", "Passed of those that were judged", caption, rows, arranged.controllers)


def _cell(title: str, counts: Counts) -> Cell:
    passing = f"{counts.of[PASS]} pass" if counts.of[FAIL] and counts.of[PASS] else ""
    parts = (": ".join(one for one in (passing, counts.limits) if one), counts.words((INFORMATIONAL,)), counts.not_run)
    others = "; ".join(part for part in parts if part)
    if not counts.total:
        return Cell(OPEN, "not run")
    picture = counts_bar(counts, title)
    if not counts.judged:
        return Cell(OPEN, "nothing judged", others, picture)
    if not counts.of[FAIL]:
        return Cell(MET, f"{counts.of[PASS]} pass, none fails", others, picture)
    return Cell(MISSED, f"{counts.of[FAIL]} of {counts.judged} fail", others, picture)


def counts_bar(counts: Counts, title: str, width: float = BAR_WIDTH, height: float = BAR_HEIGHT) -> Sketch:
    """Shares of the verdicts as one bar. What fails is hatched, what is impossible is dark."""
    sketch = Sketch(width, height, f"{title}: {counts.words()}", kind="counts")
    x = 0.5
    for verdict in _ORDER:
        share = (width - 1.0) * counts.of[verdict] / max(counts.total, 1)
        if not share:
            continue
        sketch.box(x, 0.5, share, height - 1.0, LOOKS[verdict].fill, "#555")
        if verdict == FAIL:
            at = x + 2.0
            while at < x + share - 2.0:
                sketch.line((at, height - 1.0), (min(at + 4.0, x + share), 1.0), "#7A2E00", 0.9)
                at += 4.0
        x += share
    return sketch


def failing_tests(arranged: Arranged) -> list[Failing]:
    """Every test that a controller fails: first those that the controller with the fewest failures fails."""
    best = min(range(len(arranged.counts)), key=lambda k: arranged.counts[k].of[FAIL], default=0)
    failing = [test for test in arranged.tests() if test.fails]
    failing.sort(key=lambda test: _verdict(test, best) != FAIL)
    return [_failing(test, arranged.controllers[best]) for test in failing]


def _failing(test: Tested, best: str) -> Failing:
    who = [row["controller"] for row in test.known if row["verdict"] == FAIL]
    reasons = [reason for reason in test.reasons if reason.verdict == FAIL]
    reasons.sort(key=lambda reason: best not in reason.controllers)
    why = "; ".join(
        reason.text if len(reason.controllers) == len(who) else f"{', '.join(reason.controllers)}: {reason.text}"
        for reason in reasons
    )
    names = ", ".join(who) if len(test.rows) > 1 else ""
    return Failing(test.anchor, test.test, test.besides, names, shorten(why, MOST_LETTERS, placeholder=" …"))


def strip(arranged: Arranged, index: int, width: float = 960.0, height: float = 22.0) -> Sketch:
    """Every test of one controller as a stroke, in the order of the matrix, with a gap between groups.

    Failing tests reach over the whole height, the others over less of it, so that they are seen without colours.
    """
    groups = list(arranged.groups())
    total = sum(len(group.tests) for group in groups)
    gap = min(6.0, 0.25 * width / max(len(groups), 1))
    step = (width - gap * (len(groups) - 1)) / max(total, 1)
    counts = arranged.counts[index]
    sketch = Sketch(width, height, f"{arranged.controllers[index]}, every test in order: {counts.words()}")
    x = 0.0
    for group in groups:
        runs = _runs([_verdict(test, index) for test in group.tests])
        for verdict, begin, end in runs:
            if verdict is None:
                continue
            top = {FAIL: 0.0, PASS: 0.35, IMPOSSIBLE: 0.35}.get(verdict, 0.7) * height
            left, right = x + step * begin, x + step * end
            corners = [(left, top), (right, top), (right, height), (left, height)]
            sketch.parts.append(
                Area(np.array(corners), LOOKS[verdict].colour if verdict == FAIL else LOOKS[verdict].fill)
            )
        x += step * len(group.tests) + gap
    return sketch


def _verdict(test: Tested, index: int) -> str | None:
    row = test.rows[index]
    return None if row is None else row["verdict"]


def _runs(verdicts: Sequence[str | None]) -> list[tuple[str | None, int, int]]:
    found: list[tuple[str | None, int, int]] = []
    for k, verdict in enumerate(verdicts):
        if found and found[-1][0] == verdict:
            found[-1] = (verdict, found[-1][1], k + 1)
        else:
            found.append((verdict, k, k + 1))
    return found


def strips(arranged: Arranged) -> list[tuple[str, Markup]]:
    """The strip of each controller, with its name."""
    return [(name, svg(strip(arranged, k), "strip", stretched=True)) for k, name in enumerate(arranged.controllers)]


def limits_table(document: Mapping[str, Any]) -> Table:
    """Every limit that was asked, whose it is, how many runs fail it, and whether it tells lost runs from others."""
    titles = {suite["name"]: suite["title"] for suite in document["suites"]}
    rows = tuple(
        (
            titles.get(one["suite"], one["suite"]),
            one["label"],
            asked_words(one | {"verdict": PASS, "ours": False}),
            WHOSE[one["limit_of"]],
            f"{one['failed']} of {one['judged']}",
            f"{one['lost_kept']} of {one['lost']}",
            _separates(one),
        )
        for one in document["limits"]
    )
    head = ("Suite", "Measure", "Asked", "Limit of", "Runs that fail it", "Lost runs that keep it", "What it tells")
    return Table("", head, rows, texts=4)


def _separates(limit: Mapping[str, Any]) -> str:
    if limit["failed"]:
        return "It separates."
    if limit["lost"]:
        return "It does not separate: runs that do not survive keep it, too."
    return "No run fails it, and none is lost."
