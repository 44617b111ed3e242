"""The sections of docs/grid-code-suites.md: one table row for each sweep of a suite file."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from vsgdesign.campaigns.compliance.envelopes import ENVELOPES
from vsgdesign.campaigns.compliance.measures import MEASURES
from vsgdesign.campaigns.compliance.suite import OURS, READ, SECONDARY, USER, Criterion, Source, Suite, SuiteTest
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import PHASE_TO_PHASE, THREE_PHASE

CONFIDENCE_WORDS = {
    READ: "read in the source",
    SECONDARY: "from a summary, not read in the source",
    OURS: "chosen by this project",
    USER: "chosen by the suite's author",
}

_SHORT_CIRCUITS = {THREE_PHASE: "three-phase short circuit", PHASE_TO_PHASE: "short circuit between two phases"}
_WIDTH = 120


def suite_markdown(suite: Suite, document: Mapping[str, Any]) -> str:
    """A section of a Markdown page about a suite and the document that it was read from."""
    about = f"`--suite {suite.name}`, {len(suite.tests)} tests. {_plain(suite.about)}{_longest_T(suite)}"
    lines = [f"## {suite.title}", "", textwrap.fill(about, _WIDTH), ""]
    lines += [textwrap.fill(f"Source: {source_words(suite.source)}", _WIDTH), ""]
    lines += [
        "| test | grid | P in pu | what happens | what is asked | shown beside it |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    remarks = []
    first = _first_tests(suite, document)
    for k, (table, test) in enumerate(zip(document["tests"], first, strict=True), start=1):
        asked = "; ".join(_criterion_words(c) for c in test.criteria if not c.informational) or "–"
        shown = "; ".join(_shown_words(c) for c in test.criteria if c.informational) or "–"
        cells = (
            table["name"], _grid_words(table), _values(table.get("P_pu", SuiteTest.P_pu)), _events_words(table),
            asked, shown,
        )  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
        if test.source.confidence != OURS and "ours" in table:
            remarks.append((_plain(table["ours"]), k, table["name"]))
    lines += ["", *_remark_lines(remarks)]
    return "\n".join(lines).rstrip() + "\n"


def _longest_T(suite: Suite) -> str:
    longest = {test.T_at_most for test in suite.tests} - {None}
    if not longest:
        return ""
    T = " or ".join(f"{T:g}" for T in sorted(filter(None, longest)))
    return f" Survival is judged with a settling time T of at most {T} s."


def source_words(source: Source) -> str:
    """A source with edition and confidence in one or two sentences."""
    edition = f", {source.edition}" if source.edition else ""
    note = f" {source.note}" if source.note else ""
    return f"{source.document}{edition}; {CONFIDENCE_WORDS[source.confidence]}.{note}"


def _first_tests(suite: Suite, document: Mapping[str, Any]) -> list[SuiteTest]:
    """The first test of each sweep, in the order of the document."""
    found: dict[str, SuiteTest] = {}
    names = [table["name"] for table in document["tests"]]
    for test in suite.tests:
        name = max((name for name in names if test.id == name or test.id.startswith(f"{name}, ")), key=len)
        found.setdefault(name, test)
    return [found[name] for name in names]


def _remark_lines(remarks: list[tuple[str, int, str]]) -> list[str]:
    """What is this project's in the tests, with the tests that share a remark together."""
    by_text: dict[str, list[str]] = {}
    for text, _, name in remarks:
        by_text.setdefault(text, []).append(name)
    if not by_text:
        return []
    lines = ["Not from the source, but chosen by this project:", ""]
    return [
        *lines,
        *(
            textwrap.fill(f"- {', '.join(names)}: {text}.", _WIDTH, subsequent_indent="  ")
            for text, names in by_text.items()
        ),
    ]


def _grid_words(table: Mapping[str, Any]) -> str:
    words = f"SCR {_values(table['scr'])}; X/R {_values(table['x_over_r'])}"
    if "load" in table:
        words += f"; load {_values(table['load']['P_pu'])} pu"
    if "df" in table:
        words += f"; {_values(table['df'], sign=True)} off nominal"
    return words


def _events_words(table: Mapping[str, Any]) -> str:
    parts = []
    for event in table["events"]:
        time = event.get("time")
        words = ", ".join(_event_words(event))
        parts.append(f"at {_values(time)}: {words}" if time is not None else words)
    return "; ".join(parts)


def _event_words(event: Mapping[str, Any]) -> list[str]:
    words = []
    if "phase_jump" in event:
        values = event["phase_jump"]
        bare = all(isinstance(value, int | float) for value in (values if isinstance(values, list) else [values]))
        words.append(f"phase {_values(values, sign=True)}" + (" rad" if bare else ""))
    if "df" in event:
        rate = f" at {_values(event['df_per_s'])}" if "df_per_s" in event else ""
        words.append(f"frequency to {_values(event['df'], sign=True)} off nominal{rate}")
    if "V_g_pu" in event:
        within = f" within {_values(event['over'])}" if "over" in event else ""
        words.append(f"voltage {_values(event['V_g_pu'])} pu{within}")
    if "sag" in event:
        sag = event["sag"]
        turned = f", turned by {_values(sag['angle'], sign=True)}" if "angle" in sag else ""
        words.append(f"sag of type {_values(sag['type'])} to {_values(sag['V_pu'])} pu{turned}")
    if "fault" in event:
        fault = event["fault"]
        where = f"behind {100 * fault['at']:g} % of the grid's impedance" if "at" in fault else "at the PCC"
        R = f", {_values(fault['R_pu'])} pu" if "R_pu" in fault else ""
        words.append(f"{_kinds(fault['kind'])} {where}{R}")
    if "scr" in event:
        words.append(f"SCR to {_values(event['scr'])}")
    for field in (kind.of_suite for kind in EVENT_KINDS.values() if kind.of_controller):
        if field.name in event:
            words.append(field.sentence.format(_values(event[field.name], sign=field.signed)))
    if "breaker" in event:
        words.append(f"breaker {event['breaker']}{_check_words(event)}")
    if "lasts" in event:
        words.append(f"for {_values(event['lasts'])}")
    return words


def _check_words(event: Mapping[str, Any]) -> str:
    if "synchro_check" not in event:
        return ""
    return f" when its two sides are {_values(event['synchro_check'].get('around', '0 deg'))} apart"


def _kinds(kinds: Any) -> str:
    names = kinds if isinstance(kinds, list) else [kinds]
    return " or ".join(_SHORT_CIRCUITS[name] for name in names)


def _values(values: Any, *, sign: bool = False) -> str:
    """A value or a list as it is written; of pairs ± only once."""
    texts = [_text(value, sign) for value in (values if isinstance(values, list) else [values])]
    found: list[str] = []
    for text in texts:
        if text[0] in "+-" and {f"+{text[1:]}", f"-{text[1:]}"} <= set(texts):
            text = f"±{text[1:]}"
        if text not in found:
            found.append(text)
    return ", ".join(found).replace("-", "−") if sign or len(found) > 1 or texts[0][0] == "-" else found[0]


def _text(value: Any, sign: bool) -> str:
    text = f"{value:g}" if isinstance(value, int | float) else str(value)
    return text if text.startswith(("-", "+")) or not (sign or _is_number(value)) else _signed(text, sign)


def _signed(text: str, sign: bool) -> str:
    return f"+{text}" if sign else text


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float)


def _criterion_words(criterion: Criterion) -> str:
    star = "\\*" if criterion.ours else ""
    if criterion.envelope is not None:
        return f"{ENVELOPES[criterion.envelope].label}{_given_words(criterion)}{star}"
    if criterion.measure == "survived" and criterion.at_least == 1.0:
        return f"survival{star}"
    measure = MEASURES[criterion.measure]
    unit = f" {measure.unit}" if measure.unit else ""
    limits = [
        f"{word} {limit:g}{unit}"
        for word, limit in (("≥", criterion.at_least), ("≤", criterion.at_most))
        if limit is not None
    ]
    return f"{measure.label} {' and '.join(limits)}{_given_words(criterion)}{star}"


def _given_words(criterion: Criterion) -> str:
    return f" ({', '.join(f'{name} {value:g}' for name, value in criterion.given)})" if criterion.given else ""


def _shown_words(criterion: Criterion) -> str:
    if criterion.envelope is not None:
        return f"{ENVELOPES[criterion.envelope].label}{_given_words(criterion)}"
    return MEASURES[criterion.measure].label


def _plain(text: str) -> str:
    return " ".join(text.split())
