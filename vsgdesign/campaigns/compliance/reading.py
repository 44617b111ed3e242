"""Reads a suite of tests from a TOML file, packaged or a user's own, with every fault at once."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.campaigns.compliance.applies import NEEDS
from vsgdesign.campaigns.compliance.envelopes import ENVELOPES
from vsgdesign.campaigns.compliance.measures import MEASURES, Measure, Parameter
from vsgdesign.campaigns.compliance.reading_tests import (
    LONGEST_S,
    MOST_TESTS,
    axes_of,
    combinations,
    read_events,
    size_in_words,
    size_of,
)
from vsgdesign.campaigns.compliance.suite import CONFIDENCES, ENVELOPE, USER, Criterion, Source, Suite, SuiteTest
from vsgdesign.errors import Fault, StudyError, did_you_mean, nearest
from vsgdesign.study.given_files import parse_toml, read_toml
from vsgdesign.study.parameters.event import BASIS
from vsgdesign.study.parameters.event_kinds import MOST_DF_HZ, MOST_POWER_PU
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS, Place
from vsgdesign.study.parameters.network_fields import read_load
from vsgdesign.study.parameters.reader import TableReader, UnitError, parse_quantity

_FOLDER = resources.files("vsgdesign.campaigns.compliance") / "suites"

SUITES: tuple[str, ...] = tuple(sorted(item.name[:-5] for item in _FOLDER.iterdir() if item.name.endswith(".toml")))
"""Names of the suites that come with the package."""


def suite_named(name_or_path: str | Path) -> Suite:
    """A packaged suite by its name, or a user's own by the path of its file.

    A text that ends in ``.toml``, or that names a folder and a file, is a path. Raises StudyError with every fault.
    """
    text = str(name_or_path)
    if text in SUITES:
        return _packaged(text)
    if isinstance(name_or_path, Path) or text.endswith(".toml") or "/" in text or Path(text).is_file():
        path = Path(name_or_path)
        return suite_from_document(read_toml(path, "suite file"), str(path), path.stem)
    near = nearest(text, SUITES, 0.5)
    advice = (f'Did you mean "{near}"? ' if near else "") + "Or give the path of a .toml file."
    problem = "there is no such suite; packaged are " + ", ".join(SUITES)
    raise StudyError(text, [Fault("suite", f'"{text}"', problem, advice)])


@functools.cache
def _packaged(name: str) -> Suite:
    """Read once a process: the verb looks for faults of suites before it designs anything."""
    return suite_from_document(packaged_document(name), name, name)


def packaged_document(name: str) -> dict[str, Any]:
    """The content of a packaged suite's file, lists and all. ``name`` is one of :data:`SUITES`."""
    return parse_toml((_FOLDER / f"{name}.toml").read_text(encoding="utf-8"), name)


def suite_from_text(text: str, source: str = "suite text", name: str = "suite") -> Suite:
    """The same from TOML text. ``source`` names it in errors. Raises StudyError with every fault."""
    return suite_from_document(parse_toml(text, source), source, name)


def suite_from_document(document: dict[str, Any], source: str, name: str) -> Suite:
    """The suite of a document. Raises StudyError with every fault, each told once."""
    faults: list[Fault] = []
    table = TableReader(document, "", faults)
    title = table.text("title", default=name)
    about = table.text("about", default="")
    own = _read_source(table.child("source"), Source(document=title, edition="", confidence=USER))
    sources = _read_sources(table, own)
    criteria, T_at_most = read_criteria(table.children("criteria")), _longest_T(table, None)
    tests: list[tuple[TableReader, SuiteTest]] = []
    rooms = table.children("tests")
    if not document.get("tests"):
        table.fault("tests", None, "there is no test", "Write each as [[tests]] with name, scr, x_over_r and events.")
    for room in rooms:
        found = _read_sweep(room, _Common(sources, own, criteria, T_at_most), MOST_TESTS - len(tests))
        tests += [(room, test) for test in found]
    table.finish()
    _check_ids(tests, faults)
    if faults:
        raise StudyError(source, list(dict.fromkeys(faults)))
    return Suite(name=name, title=title, source=own, tests=tuple(test for _, test in tests), about=about)


def _read_source(table: TableReader | None, default: Source) -> Source:
    if table is None:
        return default
    found = Source(
        document=table.text("document", default=default.document),
        edition=table.text("edition", default=default.edition),
        confidence=table.choice("confidence", CONFIDENCES, default=default.confidence),
        note=table.text("note", default=""),
    )
    table.finish()
    return found


def _read_sources(table: TableReader, own: Source) -> dict[str, Source]:
    """Further sources, by the names under which tests speak of them."""
    named = table.child("sources")
    if named is None:
        return {}
    found = {name: _read_source(named.child(name), own) for name in list(named.table)}
    named.finish()
    return found


class _Common(NamedTuple):
    """What holds in all tests that say nothing of it, and the further sources."""

    sources: dict[str, Source]
    own: Source
    criteria: tuple[Criterion, ...]
    T_at_most: float | None


def _longest_T(table: TableReader, default: float | None) -> float | None:
    return table.quantity("T_at_most", "s", 1e-3, LONGEST_S, default=default)


def _read_sweep(table: TableReader, common: _Common, room_left: int) -> list[SuiteTest]:
    """The tests of one [[tests]] table: one for each combination of the values in its lists."""
    axes = axes_of(table)
    too_large = size_of(axes) > room_left
    if too_large:
        by = f" ({size_in_words(axes)})" if axes else ""
        table.fault(
            "",
            None,
            f"the sweep makes {size_of(axes):,} tests{by}, and a suite may have {MOST_TESTS:,}, of which "
            f"{max(room_left, 0):,} are left",
            "Give shorter lists, or make two suites of it.",
        )
        axes = [axis._replace(values=axis.values[:1]) for axis in axes]
    found = []
    for document, words in combinations(table.table, axes):
        one = TableReader(document, table.path, table.faults)
        found.append(_read_test(one, words, common))
    return [] if too_large else found


def _read_test(table: TableReader, words: str, common: _Common) -> SuiteTest:
    name = table.text("name")
    scr = table.quantity("scr", "1", *SCR_LIMITS)
    x_over_r = table.quantity("x_over_r", "1", *X_OVER_R_LIMITS)
    V_g_pu = table.quantity("V_g_pu", "1", 0.0, 2.0, default=1.0)
    df_hz = table.quantity("df", "Hz", -MOST_DF_HZ, MOST_DF_HZ, default=0.0)
    given_load = table.child("load")
    load = None if given_load is None else read_load(given_load, None)
    given = table.children("criteria")
    test = SuiteTest(
        id=f"{name}, {words}" if words else name,
        group=table.text("group", default=name),
        title=table.text("title", default=name),
        source=_source_of(table, common.sources, common.own),
        scr=scr,
        x_over_r=x_over_r,
        P_pu=table.quantity("P_pu", "1", -MOST_POWER_PU, MOST_POWER_PU, default=SuiteTest.P_pu),
        Q_pu=table.quantity("Q_pu", "1", -MOST_POWER_PU, MOST_POWER_PU, default=SuiteTest.Q_pu),
        V_g_pu=V_g_pu,
        df_hz=df_hz,
        load=load,
        events=read_events(table.children("events"), Place(scr, x_over_r, BASIS), V_g_pu, df_hz, load),
        duration_s=table.quantity("duration", "s", 1e-3, LONGEST_S, default=None),
        silent_s=table.quantity("silent", "s", 0.0, LONGEST_S, default=SuiteTest.silent_s),
        T_at_most=_longest_T(table, common.T_at_most),
        criteria=read_criteria(given) if table.has("criteria") else common.criteria,
        needs=_needs(table),
    )
    if not table.table.get("events"):
        table.fault("events", None, "nothing happens in this test", 'For example events = [{ phase_jump = "30 deg" }].')
    table.finish()
    return test


def _source_of(table: TableReader, sources: dict[str, Source], own: Source) -> Source:
    """The source of a test, with what in it is not from there."""
    found = own
    if isinstance(table.table.get("source"), dict):
        part = table.child("source")
        found = _read_source(part, own)
    elif table.has("source"):
        name = table.text("source")
        if name in sources:
            found = sources[name]
        elif name:
            known = f"Sources here: {', '.join(sources) or 'none'}. Add [sources.{name}]."
            advice = did_you_mean(name, sources, known, 0.5)
            table.fault("source", name, "there is no such source", advice)
    table.skip("source")
    ours = table.text("ours", default="")
    if ours:
        found = replace(found, note=" ".join(part for part in (found.note, f"Chosen by this project: {ours}.") if part))
    return found


def _needs(table: TableReader) -> tuple[str, ...]:
    table.skip("needs")
    raw = table.table.get("needs", [])
    if not isinstance(raw, list):
        table.fault("needs", raw, "must be a list of names", 'For example needs = ["50 Hz"].')
        return ()
    names = [name if isinstance(name, str) else repr(name) for name in raw]
    for name in names:
        if name not in NEEDS:
            advice = did_you_mean(name, NEEDS, f"Known: {', '.join(NEEDS)}.", 0.5)
            table.fault("needs", name, "there is no such need", advice)
    return tuple(name for name in names if name in NEEDS)


def _check_ids(tests: list[tuple[TableReader, SuiteTest]], faults: list[Fault]) -> None:
    """Every test has an id of its own: a result is found by it."""
    first: dict[str, TableReader] = {}
    for table, test in tests:
        if test.id in first:
            problem = f"has the id of a test of {first[test.id].path}"
            faults.append(Fault(f"{table.path}.name", f'"{test.id}"', problem, "Give the two different names."))
        first.setdefault(test.id, table)


_SCALED = {"": ("1", 1.0), "pu": ("1", 1.0), "%": ("1", 100.0), "ms": ("s", 1e3), "°": ("rad", 180.0 / math.pi)}
"""Units of measures that are not those of quantities: the dimension that is read, and the factor from it."""


def read_criteria(tables: list[TableReader]) -> tuple[Criterion, ...]:
    """The criteria, in the order of the file. A measure without a limit is informational."""
    return tuple(_read_criterion(table) for table in tables)


def _read_criterion(table: TableReader) -> Criterion:
    measure, envelope = _name(table, "measure", MEASURES), _name(table, "envelope", ENVELOPES)
    if table.has("measure") == table.has("envelope"):
        problem = "gives both measure and envelope" if measure else "says neither measure nor envelope"
        table.fault("", None, problem, 'For example { measure = "peak_after_5ms_pu", at_most = 1.3 }.')
    limits = _limits(table, measure)
    parameters: tuple[Parameter, ...] = ()
    if measure in MEASURES:
        parameters = MEASURES[measure].parameters
    elif envelope in ENVELOPES:
        parameters = ENVELOPES[envelope].parameters
    given = tuple((p.name, _parameter(table, p)) for p in parameters if table.has(p.name))
    ours, judged = table.flag("ours", default=False), table.flag("judged", default=True)
    if measure in MEASURES or envelope in ENVELOPES:
        table.skip(*(parameter.name for parameter in parameters))
        table.finish()  # which parameters there are is known of a known name alone
    return Criterion(
        measure=ENVELOPE if envelope else measure,
        at_least=limits[0],
        at_most=limits[1],
        envelope=envelope or None,
        given=given,
        ours=ours,
        judged=judged,
    )


def _parameter(table: TableReader, parameter: Parameter) -> float:
    value = in_unit(table, parameter.name, parameter.unit)
    problem = None if math.isnan(value) else parameter.problem(value)
    if problem is not None:
        default = f"Leave it out for {parameter.default:g}." if math.isfinite(parameter.default) else ""
        table.fault(parameter.name, table.table[parameter.name], problem, default)
    return value


def _name(table: TableReader, field: str, known: Iterable[str]) -> str:
    """The name of a measure or an envelope; empty where there is none. Of an unknown one the nearest is suggested."""
    if not table.has(field):
        table.skip(field)
        return ""
    name = table.text(field)
    if name and name not in known:
        advice = did_you_mean(name, known, f"Known: {', '.join(known)}.", 0.4)
        table.fault(field, name, f"there is no such {field}", advice)
    return name


def _limits(table: TableReader, measure: str) -> tuple[float | None, float | None]:
    found: list[float | None] = []
    for field in ("at_least", "at_most"):
        table.skip(field)
        if not table.has(field):
            found.append(None)
        elif not measure:
            table.fault(field, table.table[field], "limits a measure, and an envelope has its own", "Leave it out.")
            found.append(None)
        else:
            found.append(_limit(table, field, MEASURES[measure]) if measure in MEASURES else None)
    low, high = found
    if low is not None and high is not None and low > high:
        table.fault("at_least", f"{low:g}", f"is above at_most = {high:g}: nothing can pass", "Exchange the two.")
    return low, high


def _limit(table: TableReader, field: str, measure: Measure) -> float:
    """A limit within the range of a measure; NaN for a fault."""
    value = in_unit(table, field, measure.unit)
    problem = None if math.isnan(value) else measure.limit_problem(**{field: value})
    if problem is not None:
        advice = "Any other limit is kept by every run or by none. Leave it out to show the value without a verdict."
        table.fault(field, table.table[field], problem, advice)
        return math.nan
    return value


def in_unit(table: TableReader, field: str, unit: str) -> float:
    """A field as a number in the unit of a measure or a parameter. A bare number has this unit; NaN for a fault."""
    raw = table.table[field]
    dimension, factor = _SCALED.get(unit, (unit, 1.0))
    try:
        value = parse_quantity(raw, dimension)
    except UnitError as error:
        table.fault(field, raw, str(error), f"A bare number is in {unit}." if dimension != unit and unit else "")
        return math.nan
    return value * factor if isinstance(raw, str) else value
