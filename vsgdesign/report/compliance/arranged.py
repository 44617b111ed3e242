"""Rows of a result, side by side: suites, their groups, their tests, and what was measured with each controller."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.campaigns.compliance.evidence import slug
from vsgdesign.campaigns.compliance.measures import MEASURES
from vsgdesign.campaigns.compliance.rows import (
    FAIL,
    IMPOSSIBLE,
    INFORMATIONAL,
    LIMITS,
    NOT_APPLICABLE,
    PASS,
    VERDICTS,
    not_begun,
    passes_against,
)
from vsgdesign.campaigns.compliance.suite import OURS, SOURCE, USER
from vsgdesign.metrics.survival import HARDWARE_PU
from vsgdesign.report.drawing.quantities import number, plain

Document = Mapping[str, Any]
RowDict = Mapping[str, Any]

_LONG = 11
"""Letters of a value that stay in one line."""

_NOTHING = "not asked for"

YES_OR_NO = tuple(name for name, one in MEASURES.items() if one.yes_or_no)
"""Measures that are 1 or 0."""

_SPREAD_SHOWN = 0.01
"""A spread is printed from this share of the value on: less does not change its digits."""

EXPLAINED = (FAIL, IMPOSSIBLE, NOT_APPLICABLE)
"""Verdicts whose reason is printed below the test."""


@dataclass(frozen=True)
class Value:
    """What one controller reached: the verdict of one check and its value in words."""

    verdict: str
    words: str

    @property
    def long(self) -> bool:
        """Whether it may be broken into lines."""
        return len(self.words) > _LONG


@dataclass(frozen=True)
class Line:
    """One check of a test: what is measured, what is asked, and a value for each controller (None: not judged)."""

    label: str
    asked: str
    values: tuple[Value | None, ...]
    enveloped: bool = False
    """Whether an envelope is asked for."""


@dataclass(frozen=True)
class Reason:
    """Why controllers have a verdict: one sentence, and the names of those whom it is about."""

    verdict: str
    controllers: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class Tested:
    """One test with the row of each controller, in the order of the document's controllers. None: was not run."""

    suite: str
    test: str
    """Its id in the suite, by which it is called everywhere."""
    network: str
    group: str
    rows: tuple[RowDict | None, ...]
    lines: tuple[Line, ...]
    reasons: tuple[Reason, ...]
    reference: int
    """Number of its source in :attr:`Arranged.sources`, from 1."""

    @property
    def anchor(self) -> str:
        """Its name in links of the page."""
        return slug(self.suite, self.test)

    @property
    def besides(self) -> str:
        """What its network has besides what its id says."""
        return ", ".join(part for part in self.network.split(", ") if part not in self.test)

    @property
    def known(self) -> tuple[RowDict, ...]:
        """The rows that are there."""
        return tuple(row for row in self.rows if row is not None)

    @property
    def verdicts(self) -> tuple[str, ...]:
        """The verdicts that occur, in the order of VERDICTS."""
        found = {row["verdict"] for row in self.known}
        return tuple(verdict for verdict in VERDICTS if verdict in found)

    @property
    def fails(self) -> bool:
        """Whether a controller fails."""
        return FAIL in self.verdicts


@dataclass(frozen=True)
class Group:
    """Tests that belong together, with counts for each controller."""

    suite: str
    name: str
    tests: tuple[Tested, ...]
    counts: tuple[Counts, ...]

    @property
    def fails(self) -> bool:
        """Whether a test of it fails."""
        return any(test.fails for test in self.tests)


@dataclass(frozen=True)
class SuiteRows:
    """One suite with its groups, and counts for each controller."""

    name: str
    title: str
    about: str
    source: Mapping[str, str]
    groups: tuple[Group, ...]
    counts: tuple[Counts, ...]


@dataclass(frozen=True)
class Arranged:
    """Everything that a result's rows say, in the order in which it is shown."""

    controllers: tuple[str, ...]
    colours: tuple[str, ...]
    suites: tuple[SuiteRows, ...]
    counts: tuple[Counts, ...]
    """Of each controller over all suites."""
    sources: tuple[Mapping[str, str], ...]

    def groups(self) -> Iterator[Group]:
        """All groups in order."""
        for suite in self.suites:
            yield from suite.groups

    def tests(self) -> Iterator[Tested]:
        """All tests in order."""
        for group in self.groups():
            yield from group.tests


def arrange(document: Document) -> Arranged:
    """Put the rows of a document side by side. Suites, groups and tests keep the order of their first row."""
    names = tuple(str(one["name"]) for one in document["controllers"])
    sources: list[Mapping[str, str]] = []
    by_test: dict[str, dict[str, dict[str, dict[str, RowDict]]]] = {one["name"]: {} for one in document["suites"]}
    for row in document["rows"]:
        groups = by_test.setdefault(row["suite"], {})
        groups.setdefault(row["group"], {}).setdefault(row["test"], {})[row["controller"]] = row
    titles = {one["name"]: one for one in document["suites"]}
    suites = []
    for suite, groups in by_test.items():
        arranged = tuple(
            _group(suite, group, [_tested(rows, names, sources) for rows in tests.values()], names)
            for group, tests in groups.items()
        )
        said = titles.get(suite, {})
        counts = _counts((row for rows in groups.values() for of in rows.values() for row in of.values()), names)
        about = " ".join((said.get("about") or "").split())
        source = said.get("source") or {}
        suites.append(SuiteRows(suite, said.get("title") or suite, about, source, arranged, counts))
    colours = tuple(str(one["colour"]) for one in document["controllers"])
    return Arranged(names, colours, tuple(suites), _counts(document["rows"], names), tuple(sources))


def _group(suite: str, name: str, tests: Sequence[Tested], names: Sequence[str]) -> Group:
    return Group(suite, name, tuple(tests), _counts((row for test in tests for row in test.known), names))


def _counts(rows: Any, names: Sequence[str]) -> tuple[Counts, ...]:
    of: dict[str, list[RowDict]] = {name: [] for name in names}
    for row in rows:
        of.setdefault(row["controller"], []).append(row)
    return tuple(counted(of[name]) for name in names)


def _tested(of: Mapping[str, RowDict], names: Sequence[str], sources: list[Mapping[str, str]]) -> Tested:
    first = next(iter(of.values()))
    if first["source"] not in sources:
        sources.append(first["source"])
    rows = tuple(of.get(name) for name in names)
    return Tested(
        suite=first["suite"],
        test=first["test"],
        network=first["network"],
        group=first["group"],
        rows=rows,
        lines=tuple(_lines(rows)),
        reasons=tuple(_reasons(rows)),
        reference=sources.index(first["source"]) + 1,
    )


def _lines(rows: Sequence[RowDict | None]) -> Iterator[Line]:
    """The checks of all controllers; the same measure with the same limits is one line."""
    keys: dict[tuple[str, str], dict[int, Value]] = {}
    enveloped = set()
    for k, row in enumerate(rows):
        for check in row["checks"] if row is not None else ():
            key = check["label"], asked_words(check)
            keys.setdefault(key, {})[k] = Value(check["verdict"], value_words(check, row or {}))
            if check.get("envelope"):
                enveloped.add(key)
    for key, values in keys.items():
        yield Line(*key, tuple(values.get(k) for k in range(len(rows))), key in enveloped)


def asked_words(check: RowDict) -> str:
    """What is asked of a value: ``≤ 1.2 pu``, ``0.1 to 0.2 pu``, to stay inside an envelope, or nothing."""
    low, high, unit = check.get("at_least"), check.get("at_most"), _with_space(check["unit"])
    if check.get("envelope"):
        said = "inside its envelope"
    elif check["measure"] in YES_OR_NO and (low or high) is not None:
        said = "yes"
    elif low is not None and high is not None:
        said = f"{plain(low)} to {plain(high)}{unit}"
    elif low is not None:
        said = f"≥ {plain(low)}{unit}"
    elif high is not None:
        said = f"≤ {plain(high)}{unit}"
    else:
        return _NOTHING
    if check["verdict"] == INFORMATIONAL:
        said += ", not judged"
    return f"{said}, a limit of ours" if check.get("ours") else said


def value_words(check: RowDict, row: RowDict | None = None) -> str:
    """The value with its unit, or why it is not known. ``row``: that of the check; what it says anyway is left out, and
    beside "survived" it gives the settling time and the deadline of the judge, and a current that hardware does not
    carry."""
    value, row = check["value"], row or {}
    if value is None:
        why = check.get("why")
        return f"not known: {why}" if why and why not in row.get("why", "") else "not known"
    if check["measure"] in YES_OR_NO:
        asked = f" ({deadline_words(row)})" if row.get("deadline_s") is not None else ""
        peak = row.get("peak_pu") or 0.0
        beyond = f"; {number(peak)} pu, {MORE_THAN_HARDWARE}" if value and peak > HARDWARE_PU else ""
        return ("yes" if value else "no") + asked + beyond
    spread = check.get("plus_minus") or 0.0
    about = f" ± {number(spread, 1)}" if spread >= _SPREAD_SHOWN * abs(value) > 0.0 else ""
    words = number(value) + about + _with_space(check["unit"])
    if check.get("envelope"):
        return f"{words} outside" if value > 0.0 else "inside"
    return words


def deadline_words(row: RowDict) -> str:
    """With which settling time T the judge of survival has judged a row, and by when it had to be at rest."""
    return f"T {number(row['settling_time_s'])} s, deadline {number(row['deadline_s'])} s"


def _with_space(unit: str) -> str:
    return "" if unit in ("", "1") else f" {unit}"


def _reasons(rows: Sequence[RowDict | None]) -> Iterator[Reason]:
    """Each sentence once, with everyone of whom it is said."""
    said: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row is None:
            continue
        text = row.get("why") or ""
        status = row.get("status") or ""
        if row["verdict"] == FAIL and status not in ("", "survived") and not text.startswith(status):
            text = f"{status}{': ' if text else ''}{text}"
        if text and (row["verdict"] in EXPLAINED or row["verdict"] == INFORMATIONAL):
            said.setdefault((row["verdict"], text), []).append(row["controller"])
    for (verdict, text), names in said.items():
        yield Reason(verdict, tuple(names), text)


@dataclass(frozen=True)
class Look:
    """Sign, class of the page's style, colour of words and of areas, and what the verdict says."""

    sign: str
    style: str
    colour: str
    fill: str
    says: str


LOOKS: Mapping[str, Look] = {
    PASS: Look("✓", "pass", "#00577F", "#8FB8D0", "everything that was asked for is kept"),
    FAIL: Look("✗", "fail", "#A33B00", "#E8A077", "something that was asked for is not kept, or not known"),
    INFORMATIONAL: Look("i", "info", "#444444", "#DDDDDD", "measured, nothing was asked for; this is not a pass"),
    NOT_APPLICABLE: Look("–", "none", "#666666", "#FFFFFF", "the test does not apply to this converter"),
    IMPOSSIBLE: Look("⊘", "never", "#333333", "#777777", "no converter with this current limit can do it"),
}
"""The look of each verdict. All colours of words keep a contrast of 4.5 to 1 on white."""


@dataclass(frozen=True)
class Counts:
    """How many rows have each verdict, whose limits those that pass keep, and how many tests could not begin."""

    of: Mapping[str, int]
    against: Mapping[str, int]
    """Of the rows that pass, by the names of :data:`vsgdesign.campaigns.compliance.rows.LIMITS`."""
    not_begun: int
    """Rows that fail or are informational without a run."""

    @property
    def judged(self) -> int:
        """Rows of which something was asked that is possible."""
        return self.of[PASS] + self.of[FAIL]

    @property
    def total(self) -> int:
        """All rows."""
        return sum(self.of.values())

    @property
    def limits(self) -> str:
        """Whose limits the rows that pass keep: ``0 against a limit of the source, 28 against a limit of ours``."""
        said = [SOURCE, OURS] if self.against[SOURCE] or self.against[OURS] else []
        said += [USER] if self.against[USER] else []
        return ", ".join(f"{self.against[whose]} against a limit of {WHOSE[whose]}" for whose in said)

    @property
    def not_run(self) -> str:
        """Why tests have no run: ``19 could not begin, 1 not applicable``; empty where all have."""
        begin = [f"{self.not_begun} could not begin"] if self.not_begun else []
        others = self.words((NOT_APPLICABLE, IMPOSSIBLE))
        return ", ".join([*begin, *([others] if others else [])])

    def words(self, verdicts: Iterable[str] = VERDICTS) -> str:
        """Counts that are not zero, in words: ``12 informational, 1 impossible``."""
        return ", ".join(f"{self.of[verdict]} {verdict}" for verdict in verdicts if self.of[verdict])


WHOSE: Mapping[str, str] = {SOURCE: "the source", OURS: "ours", USER: "the suite's author"}
"""Whose a limit is, in words."""


def counted(rows: Iterable[Mapping[str, Any]]) -> Counts:
    """Counts of rows of a document."""
    found: dict[str, int] = dict.fromkeys(VERDICTS, 0)
    against: dict[str, int] = dict.fromkeys(LIMITS, 0)
    begun = 0
    for row in rows:
        found[row["verdict"]] += 1
        begun += not_begun(row)
        if row["verdict"] == PASS:
            against[passes_against(row)] += 1
    return Counts(found, against, begun)
