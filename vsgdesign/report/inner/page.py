"""The page of inner loops: the answer, maps of the requirements, the gains, and what would improve them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.report.drawing.files import write_figure
from vsgdesign.report.drawing.look import Cells, gate_scale
from vsgdesign.report.drawing.panels import Frame, Panel, map_figure
from vsgdesign.report.figure_types import NamedFigure, WrittenFigure
from vsgdesign.report.inner.words import (
    AT_MOST,
    GAIN_HEAD,
    PROMISE_HEAD,
    PROMISES,
    explanation,
    gain_rows,
    headline,
    promise_rows,
    what_for,
)
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.html import write_html
from vsgdesign.report.quantities import plain

if TYPE_CHECKING:
    from vsgdesign.design.inner import InnerScore
    from vsgdesign.parameters.study import Study


def write_inner_figures(score: InnerScore, folder: Path) -> list[WrittenFigure]:
    """Draw every figure into ``folder`` (made if missing), as SVG and as PNG (200 dpi)."""
    folder.mkdir(parents=True, exist_ok=True)
    return [write_figure(figure, folder) for figure in inner_figures(score)]


def inner_figures(score: InnerScore) -> Iterator[NamedFigure]:
    """The score over SCR × X/R, then each requirement."""
    yield _map(
        score,
        "inner_score",
        "Score over the grids",
        score.t_map,
        1.0,
        False,
        "score [1]",
        "The score of a grid is the smallest share of its target that any requirement reaches there.",
        0,
    )
    for name, values, target in zip(PROMISES, score.maps, score.targets, strict=True):
        title, unit = PROMISES[name]
        yield _map(
            score,
            f"inner_{name}",
            title[0].upper() + title[1:],
            np.asarray(values),
            float(target),
            name in AT_MOST,
            f"{title} [{unit}]",
            "",
            1,
        )


def _map(
    score: InnerScore,
    name: str,
    title: str,
    values: np.ndarray,
    target: float,
    at_most: bool,
    bar: str,
    says: str,
    part: int,
) -> NamedFigure:
    unstable = ~score.stable
    missing = np.isnan(values) & ~unstable
    nowhere = np.zeros(values.T.shape, dtype=bool)
    cells = Cells(
        x=np.array(score.x_over_r),
        y=np.array(score.scr),
        values=values.T,
        unstable=unstable.T,
        missing=missing.T,
        partial=nowhere,
    )
    known = values[np.isfinite(values) & ~unstable]
    high = float(known.max()) if len(known) else 2.0 * target
    low = min(0.0, float(known.min())) if len(known) else 0.0
    digits = 10.0 ** np.floor(np.log10(target))
    ticks = [m * digits * d for d in (0.1, 1.0, 10.0) for m in (1.0, 2.0, 5.0)]
    scale = gate_scale(low, max(high, 1.2 * target), target, (0.0, *ticks), larger_is_better=not at_most)
    asked = f"asked for: {'at most' if at_most else 'at least'} {plain(target)}"
    caption = (
        f"{says} Each cell is a grid of the box; blue cells keep the requirement, and orange cells do not."
    ).strip()
    frame = Frame(
        name, title, caption, "X/R [1]", f"SCR, {score.basis} basis [1]", bar, part, aspect=0.75, gate_label=asked
    )
    return map_figure(frame, [[Panel("", cells)]], scale)


def inner_part(document: dict[str, Any]) -> dict[str, Any]:
    """The content of the page about inner loops, from results.json: the answer, sentences, requirements and gains."""
    missed = frozenset(k for k, one in enumerate(document["promises"]) if not (one["score"] or 0.0) >= 1.0)
    promises = Table(
        "What the inner loops keep, at the worst grid",
        PROMISE_HEAD,
        tuple(promise_rows(document)),
        texts=2,
        flagged=missed,
        notes=("A coloured row is not kept on every grid. The share is the worst value divided by the target.",),
    )
    gains = Table("Gains of the inner loops, SI, dq components peak", GAIN_HEAD, tuple(gain_rows(document)), texts=2)
    return {
        "headline": headline(document),
        "what_for": what_for(document),
        "explanation": explanation(document),
        "promises": promises,
        "gains": gains,
    }


def write_inner_page(study: Study, document: dict[str, Any], figures: Sequence[WrittenFigure], out_path: Path) -> Path:
    """Write the page from results.json, with the SVG text of the figures as it is in the files."""
    return write_html(out_path, "inner.html.j2", figures, study=study, **inner_part(document))
