"""The page of a verification: what a terminal prints of it, and one HTML file with links to the studies beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.verification_text import (
    bound_text,
    breaks,
    confidence_text,
    counted_of,
    families_of,
    family_title,
    figure_of,
    headline,
    kept,
    lost_text,
    promise_about,
    promise_sentences,
    promise_text,
    promise_title,
    promises_of,
    share_text,
    value_text,
    worst_text,
)
from vsgdesign.metrics.met import RULE
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure, write_all
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
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
from vsgdesign.report.page.live import StaticPage, linked_to_case, try_it, way_to_it
from vsgdesign.report.verification.figures import map_figures, promises_figure

SHOWN = 5
"""Worst cases that a terminal names. The page has all of them."""


def verification_figures(document: Mapping[str, Any]) -> Iterator[NamedFigure]:
    """One at a time, in the order of the page."""
    promises = promises_figure(document)
    if promises is not None:
        yield promises
    yield from map_figures(document)


def write_verification_page(document: Mapping[str, Any], folder: Path, live: StaticPage | None = None) -> list[Path]:
    """Write ``figures/`` and ``report.html`` into a folder (made if missing); returns every file that was written.

    ``document`` is results.json of the verb ``verify``. The page's links lead to the study files of the worst cases,
    which the document names relative to the folder. ``live`` becomes the part on which one tries other grids.
    """
    figures = write_all(verification_figures(document), folder / "figures")
    page = print_html(verification_page(document, figures, live), folder / "report.html")
    return [path for figure in figures for path in (figure.svg, figure.png)] + [page]


def verification_page(
    document: Mapping[str, Any], figures: Sequence[WrittenFigure] = (), live: StaticPage | None = None
) -> Page:
    """The page: the answer, the promises, the maps, the worst cases, and how all of this was found."""
    worst, draws = document["worst"], draws_table(document)
    left_out = Where.BOTH if document["judged"] < document["runs"] else Where.PAGE
    blocks: list[Block] = [
        words(
            (
                "Controller ",
                Span(document["controller"], code=True),
                ". Each case is a complete EMT simulation of converter, filter, controller and grid. Nothing in it is "
                "linearised.",
            )
        ),
        *way_to_it(live),
        Box(
            (
                words(headline(document), style=HEADLINE, on=Where.BOTH),
                words(*promise_sentences(document), style=BULLETS, on=Where.BOTH),
            ),
            warning=not kept(document),
        ),
        *try_it(live, document["title"]),
        Heading("Promises", numbered=True),
        replace(promises_table(document), on=Where.BOTH),
        *drawings(figures, 1),
        Heading("Over the grids", numbered=True),
        *drawings(figures, 2, otherwise="No case was judged, so there is no map."),
        Heading("The worst cases", numbered=True),
        *([_cases("The worst drawn cases", worst, document, live)] if worst else [words("No case was judged.")]),
        words(again_text(worst)),
        *_example(document),
        Heading("Found by searching: these do not count in the share", numbered=True),
        *_found(document, live),
        Heading("What was left out, and why", numbered=True),
        replace(left_out_table(document), on=left_out),
        words(
            "A case is left out before it is simulated if it asks for something that no controller could give: no "
            "steady state before or after the event, or a steady state beyond the limits. All shares are shares of "
            "the judged cases."
        ),
        Heading("How the cases were drawn", numbered=True),
        *([draws] if draws else []),
        words(
            f"Case k depends on the seed ({document['seed']}) and on k alone. It is the same with any number of "
            "workers, in any part of a divided run and after an interruption."
        ),
        Heading("Limits of validity", numbered=True),
        words(
            "A share is a share of the cases that were drawn as part 6 says. Another distribution of grids, powers or "
            "events has another share.",
            "The bound is exact for independent draws. It says nothing about one particular grid, and nothing about "
            "what was not drawn.",
            "The promises are kept by the simulated model. What the model leaves out, the page cannot know.",
            "Survival is the verdict of vsgdesign survive, which gives it on a fixed set of disturbances.",
            style=BULLETS,
        ),
        Heading("Cost", numbered=True),
        cost_table(document),
        words(_cost(document), on=Where.TERMINAL),
    ]
    origin = ("Study ", Span(document["study"], code=True), f", seed {document['seed']}.")
    return Page(f"{document['title']}: verification", blocks, origin)


def _cases(
    title: str, cases: Sequence[Mapping[str, Any]], document: Mapping[str, Any], live: StaticPage | None
) -> Table:
    return replace(cases_table(title, cases, document, live), on=Where.BOTH, most=SHOWN, left_out=frozenset({"Why"}))


def _example(document: Mapping[str, Any]) -> list[Block]:
    cases = document["worst"] or document["search"]["found"]
    if not cases:
        return []
    repeat = Span(f"vsgdesign simulate {cases[0]['study']}", code=True)
    said = "Each rank is a link to a study file. In the folder of this page, "
    return [words((said, repeat, " reproduces the first one."))]


def _found(document: Mapping[str, Any], live: StaticPage | None) -> list[Block]:
    """What a search for bad cases found."""
    found, evaluations = document["search"]["found"], document["search"]["evaluations"]
    if not found:
        nothing = f"A search of {evaluations} further simulations found nothing worse than the drawn cases."
        return [words(nothing if evaluations else "No search was made.")]
    said = (
        f"A search looked for bad cases on purpose, in {evaluations} further simulations. It says how bad a case can "
        f"be, and nothing about how often it occurs. {again_text(found)}"
    )
    return [_cases("Found by searching: these do not count in the share", found, document, live), words(said.strip())]


def _cost(document: Mapping[str, Any]) -> str:
    """Runs, machine and seconds in one line."""
    count = document["workers"]
    seconds = ", ".join(f"{name.replace('_', ' ')} {value:.3g} s" for name, value in document["timing_s"].items())
    said = (
        f"{counted_of(document['runs'])} runs",
        f"seed {document['seed']}",
        document["instruction_set"] or "no runs",
    )
    return f"{', '.join(said)}, {count} {'worker' if count == 1 else 'workers'}: {seconds}"


QUANTILES = ("50", "90", "99", "99.9")


def promises_table(document: Mapping[str, Any]) -> Table:
    """Every promise of every family: how often it is broken, its bound, its worst value and its quantiles."""
    rows, flagged = [], set()
    for family_name, family in families_of(document):
        for name, promise in promises_of(family):
            if promise["broken"]:
                flagged.add(len(rows))
            quantiles = [_quantile(name, promise, q) for q in QUANTILES]
            rows.append(
                (
                    family_title(family_name, family),
                    promise_text(name, promise),
                    counted_of(promise["broken"]),
                    counted_of(promise["judged"]),
                    share_text(promise),
                    bound_text(promise),
                    *quantiles,
                    worst_text(name, promise),
                )
            )
    every = [promise for _, family in families_of(document) for _, promise in promises_of(family)]
    count = len(every)
    head = ("Cases", "Promise", "broken", "judged", "share", "fewer than", "50 %", "90 %", "99 %", "99.9 %", "worst")
    groups = (("", 2), ("measured", 3), (f"with {confidence_text(document['confidence'])} confidence", 1))
    groups += (("quantiles of the judged cases", 4), ("", 1))
    notes = [] if "quantile_error" not in document else [_quantile_note(document["quantile_error"])]
    if any("∞" in row for row in rows):
        notes.append("∞: not settled or not at rest within the simulated time.")
    notes += [lost_text(name, family) for name, family in families_of(document)]
    notes = [note for note in notes if note]
    notes += [_joint_note(document["confidence"], count)] if count > 1 else []
    notes += [f"A limit counts as kept {RULE}."] if any("most" in one for one in every) else []
    return Table("Promises", head, tuple(rows), texts=2, groups=groups, notes=tuple(notes), flagged=frozenset(flagged))


def _quantile(name: str, promise: Mapping[str, Any], q: str) -> str:
    value = promise["quantiles"].get(q)
    if value is None:
        return "∞" if promise["judged"] else DASH  # the figure does not exist in so many of the cases
    return value_text(figure_of(name, promise), value)


def _quantile_note(error: float) -> str:
    return f"Quantiles are too large by at most {100.0 * error:.2g} %, never too small; the worst values are exact."


def _joint_note(confidence: float, count: int) -> str:
    joint = 1.0 - count * (1.0 - confidence)
    each = f"Each bound holds with {confidence_text(confidence)} confidence by itself"
    if joint <= 0.0:
        return f"{each}; nothing is said of all {count} at once."
    return f"{each}; all {count} together hold with at least {confidence_text(round(joint, 10))}."


def cases_table(
    title: str, cases: Sequence[Mapping[str, Any]], document: Mapping[str, Any], live: StaticPage | None = None
) -> Table:
    """Cases, the worst first: what they break or come nearest to, what happens and why, and where they begin. What
    happens leads to the case on the ``live`` page, where it is there."""
    rows, flagged = [], set()
    starts = _start_columns([case["start"] for case in cases])
    with_reason = any(case.get("why") for case in cases)
    for case in cases:
        family = document["families"].get(case["family"], {})
        name, promise = promise_about(family, case["promise"]) or (case["promise"], {"limit": None})
        if case_breaks(case, name, promise):
            flagged.add(len(rows))
        rows.append(
            (
                str(case["rank"]),
                family_title(case["family"], family),
                f"{promise_title(name, promise)} {case_value(case, name, promise)}",
                linked_to_case(str(case["what"]), live, case_label(case, document)),
                *((str(case.get("why") or DASH),) if with_reason else ()),
                *(shown(case["start"]) for _, shown in starts),
            )
        )
    texts = ("Rank", "Cases", "Figure", "What happens", *(("Why",) if with_reason else ()))
    groups = (("", len(texts)), ("the case begins at", len(starts)))
    links = tuple(str(case["study"]) for case in cases)
    head = (*texts, *(heading for heading, _ in starts))
    return Table(title, head, tuple(rows), len(texts), groups, flagged=frozenset(flagged), links=links)


def _start_columns(
    starts: Sequence[Mapping[str, Any]],
) -> list[tuple[str, Callable[[Mapping[str, Any]], str]]]:
    """Heading and text of what is told of the start of cases: the source only where it is not the same in all."""
    columns: list[tuple[str, Callable[[Mapping[str, Any]], str]]] = [
        ("SCR", lambda start: f"{start['scr']:.3g}"),
        ("X/R", lambda start: f"{start['x_over_r']:.3g}"),
        ("P [pu]", lambda start: f"{start['P_pu']:z.2f}"),
        ("Q [pu]", lambda start: f"{start['Q_pu']:z.2f}"),
    ]
    if len({start["V_g_pu"] for start in starts}) > 1:
        columns.append(("V_g [pu]", lambda start: f"{start['V_g_pu']:.3f}"))
    if len({start["f_hz"] for start in starts}) > 1:
        columns.append(("f [Hz]", lambda start: f"{start['f_hz']:.2f}"))
    if any(start["error_R"] or start["error_X"] for start in starts):
        columns.append(("error of R_g [%]", lambda start: _percent(start["error_R"])))
        columns.append(("error of L_g [%]", lambda start: _percent(start["error_X"])))
    return columns


def _percent(share: float) -> str:
    text = f"{100.0 * share:+.1f}"
    return "0.0" if float(text) == 0.0 else text


def again_text(cases: Sequence[Mapping[str, Any]]) -> str:
    """How well single simulations of the written studies agree with the batch; empty if none was made."""
    found = [case for case in cases if case.get("simulated")]
    if not found:
        return ""
    if other := [case["rank"] for case in found if not case["agrees"]]:
        ranks = ", ".join(str(rank) for rank in other)
        return f"Simulated again, one by one, from the study files: rank {ranks} does not agree with the table."
    known = [case["difference"] for case in found if case["difference"] is not None]
    largest = f" to {number(max(known), 2)} of each figure" if known else ""
    return f"All were simulated again, one by one, from the study files, and agree{largest}."


def case_label(case: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    """A case in one line: its place in its list, what it breaks or comes nearest to, and what happens."""
    family = document["families"].get(case["family"], {})
    name, promise = promise_about(family, case["promise"]) or (case["promise"], {"limit": None})
    found = "found " if case.get("case") is None else ""
    return f"{found}{case['rank']}: {promise_title(name, promise)} {case_value(case, name, promise)}. {case['what']}"


def case_value(case: Mapping[str, Any], name: str, promise: Mapping[str, Any]) -> str:
    """The figure of a case that its promise limits."""
    if promise.get("survival") and case.get("status", "judged") != "judged":
        return str(case["status"])  # how it was lost says more than when it was nearly at rest
    value = case["figures"].get(figure_of(name, promise))
    return worst_text(name, {**promise, "worst": value, "broken": case_breaks(case, name, promise)})


def case_breaks(case: Mapping[str, Any], name: str, promise: Mapping[str, Any]) -> bool:
    """Whether a case breaks its promise: the document says so, or its figure is beyond the limit or does not exist."""
    if "broken" in case:
        return bool(case["broken"])
    value = case["figures"].get(figure_of(name, promise))
    if value is None or promise["limit"] is None:
        return value is None
    return breaks(value, promise)


def left_out_table(document: Mapping[str, Any]) -> Table:
    """How many cases of each family were drawn, left out for which reason, and judged."""
    families = document["families"]
    reasons = list(dict.fromkeys(reason for family in families.values() for reason in family["left_out"]))
    rows: list[tuple[str, ...]] = [
        (
            family_title(name, family),
            counted_of(family["drawn"]),
            *(counted_of(family["left_out"].get(reason, 0)) for reason in reasons),
            counted_of(family["judged"]),
        )
        for name, family in families_of(document)
    ]
    totals = [
        sum(f["drawn"] for f in families.values()),
        *(sum(f["left_out"].get(reason, 0) for f in families.values()) for reason in reasons),
        sum(f["judged"] for f in families.values()),
    ]
    rows.append(("All", *map(counted_of, totals)))
    groups = (("", 2), ("left out", len(reasons)), ("", 1)) if reasons else ()
    return Table("Cases", ("Cases", "drawn", *reasons, "judged"), tuple(rows), groups=groups)


def draws_table(document: Mapping[str, Any]) -> Table | None:
    """How each quantity of a case is drawn; None where the document does not say."""
    drawn = document.get("distributions")
    if not drawn:
        return None
    rows = tuple((str(one["quantity"]), str(one["words"])) for one in drawn)
    return Table("How a case is drawn", ("Quantity", "Distribution"), rows, texts=2)


def cost_table(document: Mapping[str, Any]) -> Table:
    """Seconds of every stage, and on what they were spent."""
    rows = [(name.replace("_", " "), f"{plain(float(value), 3)} s") for name, value in document["timing_s"].items()]
    rows += [
        ("instruction set", "any: the loop is strict" if document["strict"] else str(document["instruction_set"])),
        ("workers", str(document["workers"])),
        ("seed", str(document["seed"])),
    ]
    return Table("Cost", ("Stage", "Value"), tuple(rows), texts=2)
