"""The tables of a verification's page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from vsgdesign.artifacts.verification_text import (
    bound_text,
    confidence_text,
    counted_of,
    families_of,
    family_title,
    figure_of,
    lost_text,
    promise_about,
    promise_text,
    promise_title,
    promises_of,
    share_text,
    value_text,
    worst_text,
)
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.quantities import DASH, number, plain

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
    count = sum(len(family["promises"]) for family in document["families"].values())
    head = ("Cases", "Promise", "broken", "judged", "share", "fewer than", "50 %", "90 %", "99 %", "99.9 %", "worst")
    groups = (("", 2), ("measured", 3), (f"with {confidence_text(document['confidence'])} confidence", 1))
    groups += (("quantiles of the judged cases", 4), ("", 1))
    notes = [] if "quantile_error" not in document else [_quantile_note(document["quantile_error"])]
    if any("∞" in row for row in rows):
        notes.append("∞: not settled or not at rest within the simulated time.")
    notes += [lost_text(name, family) for name, family in families_of(document)]
    notes = [note for note in notes if note]
    notes += [_joint_note(document["confidence"], count)] if count > 1 else []
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


def cases_table(title: str, cases: Sequence[Mapping[str, Any]], document: Mapping[str, Any]) -> Table:
    """Cases, the worst first: what they break or come nearest to, what happens and why, and where they begin."""
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
                str(case["what"]),
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
        ("P [pu]", lambda start: f"{start['P_pu']:.2f}"),
        ("Q [pu]", lambda start: f"{start['Q_pu']:.2f}"),
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
    value, limit = case["figures"].get(figure_of(name, promise)), promise["limit"]
    if value is None or limit is None:
        return value is None
    return value < limit if promise.get("at_least") else value > limit


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
