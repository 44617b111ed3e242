"""Every figure of a result: overlays of groups, figures of failing tests, and survival maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from vsgdesign.compliance.evidence import MOST_FIGURES, figures_of
from vsgdesign.report.compliance.arranged import Arranged
from vsgdesign.report.compliance.figures import Drawer, TestFigure, Traces
from vsgdesign.report.compliance.heat import heat_sketches
from vsgdesign.report.drawing.sketch import Sketch, svg

MOST_INSIDE = 1_200_000
"""Bytes of these figures that are a part of the page itself. The others are files beside it."""


@dataclass(frozen=True)
class Drawn:
    """All figures of a result. ``beyond``: tests with a failing row for which there was no room."""

    groups: Mapping[tuple[str, str], TestFigure]
    tests: Mapping[str, TestFigure]
    inside: Mapping[str, Markup]
    maps: Sequence[Sketch]
    beyond: int
    missing: int


def draw(arranged: Arranged, document: Mapping[str, Any], traces: Traces) -> Drawn:
    """Every figure of the page and of the PDF."""
    drawer = Drawer(arranged, traces, document.get("converter") or {})
    groups = {(group.suite, group.name): drawer.of_group(group) for group in arranged.groups()}
    failing = {(test.suite, test.test): test for test in arranged.tests() if test.fails}
    chosen = [failing[key] for key in figures_of(document["rows"])]
    tests = {test.anchor: drawer.of_test(test) for test in chosen}
    inside, size = {}, 0
    for anchor, figure in tests.items():
        if figure is None or size > MOST_INSIDE:
            continue
        inside[anchor] = Markup("\n").join(svg(one, "plot") for one in figure.plots)
        size += len(inside[anchor])
    return Drawn(
        groups={key: figure for key, figure in groups.items() if figure is not None},
        tests={anchor: figure for anchor, figure in tests.items() if figure is not None},
        inside=inside,
        maps=heat_sketches(document.get("maps") or ()),
        beyond=max(sum(any(row.get("csv") for row in test.known) for test in failing.values()) - MOST_FIGURES, 0),
        missing=len(drawer.missing),
    )
