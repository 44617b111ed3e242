"""All tests of some suites for all controllers of a study, cut into blocks that any process can run."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import package_hash, plain
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.guarded_file import file_hash
from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.compliance.case import Subject
from vsgdesign.campaigns.compliance.evidence import csv_path, thinned, write_evidence, write_evidence_comtrade
from vsgdesign.campaigns.compliance.maps import Mapped, survival_map
from vsgdesign.campaigns.compliance.matrix import Judged, judged_tests
from vsgdesign.campaigns.compliance.suite import Suite, SuiteTest
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.execution.executors import keep_memory
from vsgdesign.execution.jobs import Job
from vsgdesign.study.parameters.study import Study

BLOCK = 144
"""Runs of a block where nothing is said: a second of work. Those of one controller go side by side."""

RUNS = "tests"
"""What progress calls the runs."""


@dataclass(frozen=True, kw_only=True)
class SuiteJob(Job[int, dict[str, Any]]):
    """What is run: everything that the rows depend on. It can be sent to another process."""

    study: Study
    """With the controllers that are compared, in their order."""
    tables: Mapping[str, GainTable]
    suites: tuple[Suite, ...]
    folder: str
    """Where the traces are written, in a folder ``traces``; what is there is replaced."""
    block: int
    """Runs of a block."""
    maps: tuple[str, ...] = ()
    """Survival maps that are drawn of every controller: names of :data:`vsgdesign.campaigns.compliance.maps.KINDS`."""
    comtrade: str | None = None
    """Of :data:`vsgdesign.artifacts.time_series.FORMS`, if every run is written in it, too, beside its trace."""
    units: int = 1
    """Equal units of a plant, of which the converter is one."""

    what = RUNS

    @cached_property
    def items(self) -> tuple[tuple[int, int, int], ...]:
        """(suite, test, controller) of every row, in the order of the matrix."""
        return tuple(
            (s, t, k)
            for s, suite in enumerate(self.suites)
            for t in range(len(suite.tests))
            for k in range(len(self.study.controllers))
        )

    @cached_property
    def _in_blocks(self) -> list[tuple[int, int, int]]:
        """The rows in the order of the blocks, controller by controller: more tests of a block go side by side, and
        more of them begin or end at a rest that is known."""
        return sorted(self.items, key=lambda one: (one[2], one[0], one[1]))

    def rows(self, whole: dict[str, Any]) -> list[dict[str, Any]]:
        """The rows of all finished blocks in the order of the matrix."""
        found = [row for rows in in_order(whole, "rows") for row in rows]
        return [row for _, row in sorted(zip(self._in_blocks, found, strict=True), key=lambda one: one[0])]

    @property
    def blocks(self) -> list[int]:
        """Numbers of all blocks: those of rows, and then one for each map of each controller. A map is begun first,
        because it takes longer than a block of rows."""
        rows, maps = self._of_rows, len(self.maps) * len(self.study.controllers)
        return [*range(rows, rows + maps), *range(rows)]

    @property
    def _of_rows(self) -> int:
        return -(-len(self.items) // self.block)

    def map_of(self, number: int) -> tuple[str, int] | None:
        """Kind and controller of the map that a block is; None for a block of rows."""
        if number < self._of_rows:
            return None
        controller, kind = divmod(number - self._of_rows, len(self.maps))
        return self.maps[kind], controller

    def tests_of(self, number: int) -> tuple[tuple[Suite, SuiteTest, int], ...]:
        """Suite, test and controller of each row of a block."""
        first = number * self.block
        chosen = self._in_blocks[first : first + self.block]
        return tuple((self.suites[s], self.suites[s].tests[t], k) for s, t, k in chosen)

    @cached_property
    def subjects(self) -> tuple[Subject, ...]:
        """The controllers. What the studies of their tests have in common is read once, and goes with them to other
        processes."""
        ready = Ready(tables=self.tables)
        found = tuple(
            Subject(study=self.study, spec=spec, ready=ready, units=self.units) for spec in self.study.controllers
        )
        for one in found:
            with suppress(StudyError):  # its rows say why it cannot be read
                _ = one.base
        return found

    def run(self, number: int) -> dict[str, Any]:
        """What a block gives under its number: ``rows``, whose traces are written to the folder of the job, with the
        ``hashes`` of these files, or a ``map``. A map that cannot be drawn is a ``note`` that says why."""
        return self.call(number)()

    def call(self, number: int) -> Callable[[], dict[str, Any]]:
        """The run of a block as it goes to another process: with its own tests alone."""
        of_map = self.map_of(number)
        if of_map is not None:
            return partial(_drawn, number, of_map[0], self.subjects[of_map[1]])
        asked = [(self.subjects[k], replace(suite, tests=()), test) for suite, test, k in self.tests_of(number)]
        return partial(_rows, number, asked, self.folder, self.comtrade)

    def count(self, part: dict[str, Any]) -> int:
        """The rows of some blocks."""
        return sum(len(block["rows"]) for block in part.values())

    @property
    def key(self) -> str:
        """Hash of everything that a row depends on, the source of the package included."""
        study, tables = self.study.content, {name: table.sha256 for name, table in sorted(self.tables.items())}
        parts = package_hash(), study, tables, self.suites, self.block, self.maps, self.comtrade, self.units
        return hashlib.sha256(repr(parts).encode()).hexdigest()


def _rows(
    block: int, asked: Sequence[tuple[Subject, Suite, SuiteTest]], folder: str, comtrade: str | None
) -> dict[str, Any]:
    rows: list[dict[str, Any]] = [{} for _ in asked]
    hashes: dict[str, str] = {}
    of_subject: dict[int, list[int]] = {}
    for place, (subject, _, _) in enumerate(asked):
        of_subject.setdefault(id(subject), []).append(place)
    keep_memory()
    for places in of_subject.values():
        subject = asked[places[0]][0]
        for number, judged in judged_tests(subject, [asked[place][1:] for place in places]):
            _, suite, test = asked[places[number]]
            rows[places[number]] = _written(subject, suite, test, judged, folder, comtrade, hashes)
    return {str(block): {"rows": rows, "hashes": hashes}}


def _written(
    subject: Subject,
    suite: Suite,
    test: SuiteTest,
    judged: Judged,
    folder: str,
    comtrade: str | None,
    hashes: dict[str, str],
) -> dict[str, Any]:
    """A row, whose trace is now in the folder, and the SHA-256 of its files among the ``hashes``."""
    row = judged.row
    if judged.evidence is not None:
        row = replace(row, csv=csv_path(suite.name, test.id, row.controller))
        path = Path(folder) / str(row.csv)
        path.parent.mkdir(parents=True, exist_ok=True)
        hashes[str(row.csv)] = write_evidence(path, thinned(judged.evidence, _instants(test)))
        if comtrade is not None:
            first = min((event.t_s for event in test.events), default=0.0)
            trace, converter = judged.evidence.trace, subject.study.converter
            for one in write_evidence_comtrade(path.with_suffix(""), trace, comtrade, converter, first):
                hashes[one.relative_to(folder).as_posix()] = file_hash(one)
    found: dict[str, Any] = plain(row)
    return found


def _drawn(number: int, kind: str, subject: Subject) -> dict[str, Any]:
    found: dict[str, Any] = {"rows": []}
    try:
        drawn = survival_map(kind, Mapped(study=subject.study, spec=subject.spec, ready=subject.ready))
    except InfeasibleStudyError as error:
        found["note"] = f"There is no survival map ({kind}) of {subject.spec.name}: {error}"
    else:
        found["map"] = plain(drawn.document())
    return {str(number): found}


def _instants(test: SuiteTest) -> list[float]:
    """When something changes suddenly, and when a ramp ends, s."""
    return sorted({t for event in test.events for t in (event.t_s, event.end_s)})


def in_order(whole: dict[str, Any], name: str) -> list[Any]:
    """What the finished blocks have under a name, in the order of the blocks."""
    return [whole[number][name] for number in sorted(whole, key=int) if name in whole[number]]
