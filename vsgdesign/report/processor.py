"""The page of a run with the processor in the loop: whether the bits are equal, what it did, and its instructions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure
from vsgdesign.report.page.blocks import Block, Box, Heading, Page, Span, Table, Where, drawings, words

if TYPE_CHECKING:
    from vsgdesign.export.processor import ProcessorRun

LATER = 1e-5
"""Share of rated that two C libraries may leave between two builds of one controller."""

OF_MATH = {
    "printed": "sine, cosine and angle as they are printed into the export",
    "library": "the sine, cosine and angle of each toolchain's C library",
}


def processor_sentences(document: Mapping[str, Any]) -> list[str]:
    """The answer: equal or not, by how much, and the instructions of a sample."""
    differing, samples = document["differing_samples"], document["samples"]
    worst_of = max(document["largest_difference_of_rated"].items(), key=lambda one: one[1])
    counted = document["instructions"]
    where = f"{document['processor']} in QEMU ({document['machine']})"
    if not differing:
        first = f"All {samples:,} samples of {where} are equal to those of this machine, to the bit."
    else:
        at = document["first_difference"]
        first = (
            f"In {differing:,} of {samples:,} samples of {where} a bit differs from this machine, first in "
            f"{at['output']} at {at['t_s'] * 1e3:.6g} ms. The figures differ by at most {worst_of[1]:.2g} of rated "
            f"({worst_of[0]})."
        )
    return [
        first,
        f"Both builds take {OF_MATH[document['math']]}, in single precision and without contraction.",
        f"A sample takes {counted['mean']:.1f} instructions on average and at most {counted['largest']:,} (to within "
        f"{counted['resolution']}). These are instructions that QEMU counts, and not cycles.",
        *(f"Left out: {one}." for one in document["left_out"]),
    ]


def processor_page(document: Mapping[str, Any], drawn: list[WrittenFigure] | None = None) -> Page:
    """The page, from results.json. ``drawn``: its figures."""
    one_to_one = document["differing_samples"] == 0
    expected = one_to_one or max(document["largest_difference_of_rated"].values()) <= LATER
    rows = tuple((name, f"{value:.2g}") for name, value in document["largest_difference_of_rated"].items())
    blocks: list[Block] = [
        Box((words(*processor_sentences(document), on=Where.BOTH),), warning=not expected, anchor="answer"),
        *drawings(drawn or []),
        Heading("Differences"),
        Table("Largest difference between both builds", ("figure", "of rated"), rows, on=Where.PAGE),
        words(("All samples are in ", Span("series.csv", link="series.csv"), ".")),
    ]
    origin = ("Study ", Span(document["study"]["name"], code=True), f", hash {document['study']['hash'][:12]}.")
    return Page(f"{document['controller']}: processor in the loop", blocks, origin)


def processor_figures(run: ProcessorRun) -> Iterator[NamedFigure]:
    """Powers and frequency over time, and the instructions of each sample."""
    from vsgdesign.export.processor import PER_TICK
    from vsgdesign.report.drawing.style import EVENT_LINE, PAGE_IN, add_axes, line_style, look, new_figure

    t_s = np.arange(len(run.instructions)) * run.unit.T_s
    with look():
        figure = new_figure(PAGE_IN, 3.6)
        upper = add_axes(figure, 0.6, 2.05, PAGE_IN - 0.75, 1.3)
        lower = add_axes(figure, 0.6, 0.45, PAGE_IN - 0.75, 1.3, sharex=upper)
        for k, name in enumerate(("P", "Q")):
            upper.plot(t_s, run.target.figures[:, k], label=name, **line_style(k))
        lower.plot(t_s, run.instructions, drawstyle="steps-post", **line_style(0) | {"linewidth": 0.6})
        for axes in (upper, lower):
            for event in run.study.events:
                if event.t_s <= t_s[-1]:
                    axes.axvline(event.t_s, **EVENT_LINE)
            axes.set_xlim(0.0, t_s[-1] + run.unit.T_s)
        lower.set_ylim(0.0, 1.1 * float(run.instructions.max()))
        upper.set_ylabel("P, Q [pu]")
        upper.legend(loc="lower right", bbox_to_anchor=(1.0, 1.02), ncol=2)
        upper.tick_params(labelbottom=False)
        lower.set_ylabel("instructions [1]")
        lower.set_xlabel("t [s]")
    caption = (
        "Above: the powers of the controller in QEMU. Below: the instructions of each sample, to within "
        f"{PER_TICK}. Vertical lines are the events of the study."
    )
    yield NamedFigure("processor", "Powers, and instructions of each sample", caption, figure)
