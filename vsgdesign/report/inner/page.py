"""The page of inner loops: the answer, maps of the requirements, the gains, and what would improve them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.report.drawing.files import write_figure
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
from vsgdesign.report.page.blocks import (
    BULLETS,
    Block,
    Box,
    Heading,
    Page,
    Span,
    Table,
    Where,
    drawings,
    words,
)
from vsgdesign.report.page.html import print_html
from vsgdesign.report.quantities import number, plain

_SHOWN = 7
"""The grids of each axis on the map of the terminal."""

if TYPE_CHECKING:
    from vsgdesign.design.inner import InnerScore


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
    from vsgdesign.report.drawing.look import Cells, gate_scale
    from vsgdesign.report.drawing.panels import Frame, Panel, map_figure

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


def inner_tables(document: dict[str, Any], on: Where = Where.PAGE) -> tuple[Table, Table]:
    """Requirements and gains, from results.json."""
    missed = frozenset(k for k, one in enumerate(document["promises"]) if not (one["score"] or 0.0) >= 1.0)
    promises = Table(
        "What the inner loops keep, at the worst grid",
        PROMISE_HEAD,
        tuple(promise_rows(document)),
        texts=2,
        flagged=missed,
        notes=("A coloured row is not kept on every grid. The share is the worst value divided by the target.",),
        on=on,
    )
    title = "Gains of the inner loops, SI, dq components peak"
    return promises, Table(title, GAIN_HEAD, tuple(gain_rows(document)), texts=2, on=on)


def inner_page(document: dict[str, Any], figures: Sequence[WrittenFigure] = (), file: str | None = None) -> Page:
    """The page: the answer, what is kept and where, the gains, and each requirement over the grids.

    ``file`` is where a verb keeps gains that it designed, for the terminal.
    """
    study = document["study"]
    promises, gains = inner_tables(document, Where.BOTH)
    kept_in = f" They are kept in {file}." if file else ""
    blocks: list[Block] = [
        Box(
            (
                words((Span(headline(document), bold=True), f" {what_for(document)}")),
                words(*explanation(document), style=BULLETS),
            )
        ),
        words(
            f"{study['title']}: {headline(document)}",
            what_for(document) + kept_in,
            *explanation(document),
            on=Where.TERMINAL,
        ),
        Heading("What is kept, and where", numbered=True),
        promises,
        *drawings(figures, 0),
        Heading("Gains", numbered=True),
        gains,
        _score_table(document),
        Heading("Each promise over the grids", numbered=True),
        *drawings(figures, 1),
        Heading("Limits of validity", numbered=True),
        words(
            "The power loops are held still: their angle and voltage are constant. The check with power loops in the "
            "verdict uses the full-order model.",
            "The results are for small deviations without any limit, an averaged bridge, and a balanced grid of R and "
            "L. The EMT simulation is decisive.",
            "The targets are those of this project, not of a grid code.",
            style=BULLETS,
        ),
    ]
    origin = ("Study ", Span(study["name"], code=True), ", SHA-256 ", Span(study["hash"], code=True), ".")
    return Page(f"{study['title']}: inner loops", blocks, origin)


def _score_table(document: dict[str, Any]) -> Table:
    """The score on about seven grids of each axis, for a terminal."""
    scr, x_over_r, score = (document["map"][name] for name in ("scr", "x_over_r", "score"))
    rows, columns = _some(len(scr)), _some(len(x_over_r))
    head = ("SCR \\ X/R", *(plain(x_over_r[j], 3) for j in columns))
    texts = tuple((plain(scr[i], 3), *(number(score[i][j], 2) for j in columns)) for i in reversed(rows))
    return Table("Score over the grids (1 is asked)", head, texts, texts=0, on=Where.TERMINAL)


def _some(count: int) -> list[int]:
    """About seven indices from the first to the last."""
    step = max((count - 1) // (_SHOWN - 1), 1)
    return sorted({*range(0, count, step), count - 1})


def write_inner_page(document: dict[str, Any], figures: Sequence[WrittenFigure], out_path: Path) -> Path:
    """Write the page from results.json, with the SVG text of the figures as it is in the files."""
    return print_html(inner_page(document, figures), out_path)
