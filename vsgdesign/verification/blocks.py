"""A verification as a job: random cases in blocks, and what each block counts."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.provenance import package_hash
from vsgdesign.artifacts.ready import Ready
from vsgdesign.execution import jobs
from vsgdesign.identification.registry import samples_itself
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.rests import SWITCHED_WINDOW
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S
from vsgdesign.simulation.survival.demand import settling_time_of
from vsgdesign.verification.counting import MapAxes, Results, count_block
from vsgdesign.verification.promises import Promise
from vsgdesign.verification.summary import Summary, summary_document, summary_of

BLOCK = 2048
"""Runs of a block: some tenths of a second of work, and a whole number of lanes on any machine."""

RUNS = "EMT runs"
"""What progress calls the runs."""

_NUMBER = re.compile(r"\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+\b")


class SingleRun(NamedTuple):
    """A case that was simulated by itself."""

    figures: Mapping[str, float]
    """Those that the single run has, by the names of :data:`vsgdesign.verification.promises.FIGURES`."""
    P: float
    Q: float
    """At rest before the first event, at the control point, W and var."""
    decay: float
    """Rate of the slowest mode of the full-order model at the last rest, 1/s; NaN where there is no such rest."""


class Batch(NamedTuple):
    """How cases are drawn and run. Functions of modules, because they go to other processes."""

    draw: Callable[..., Any]
    """(study, spec, first, count, ready) -> (LaneCases, family (count,))."""
    cases_of: Callable[..., Any]
    """(study, spec, uniforms, family, ready) -> (LaneCases, family), for the search."""
    run: Callable[..., Any]
    """(study, spec, ready, cases, bridge=, strict=) -> results (:class:`vsgdesign.verification.counting.Results`)."""
    instruction_set: Callable[[], str]
    """Of this machine, for results that are not strict."""
    written: Callable[..., str]
    """(study, spec, ready, cases, index, place, bridge) -> the text of a study that is this case, for a file there."""
    simulated: Callable[..., SingleRun]
    """(path, ready) -> the study of a case as a single run."""


@dataclass(frozen=True, kw_only=True)
class VerificationJob(jobs.Job[int, Summary]):
    """What is verified: everything that the summary of a block depends on."""

    study: Study
    """With its [verification], whose seed draws the cases."""
    spec: ControllerSpec
    tables: Mapping[str, GainTable]
    families: tuple[str, ...]
    """Names of the families; the index of a name is what the draw returns."""
    promises: tuple[Promise, ...]
    axes: MapAxes
    runs: int
    bridge: str = "averaged"
    strict: bool = False
    """Whether the loop rounds as Python does, on any instruction set; a third slower."""
    block: int = BLOCK
    batch: Batch

    what = RUNS
    most_lines = 64  # a summary of many blocks is as small as that of one

    @property
    def ready(self) -> Ready:
        """The tables as the runs take them."""
        return Ready(tables=dict(self.tables))

    def drawn(self, first: int, count: int) -> tuple[LaneCases, Any]:
        """The cases from number ``first`` on, and the family of each."""
        cases, family = self.batch.draw(self.study, self.spec, first, count, self.ready)
        return self._at_rest(cases), family

    def cases_of(self, coordinates: Any, family: int) -> LaneCases:
        """Cases of one family by their numbers in [0, 1), one case a row."""
        return self._at_rest(self.batch.cases_of(self.study, self.spec, coordinates, family, self.ready)[0])

    def _at_rest(self, cases: LaneCases) -> LaneCases:
        """The cases with the time that a switched bridge needs to come to its own rest before the first event."""
        if self.bridge != "pwm":
            return cases
        learns = self.spec.kind == "scheduled" and samples_itself(self.spec.estimate)
        lead_s = SWITCHED_WINDOW * settling_time_of(self.spec, self.ready)
        return cases.later(max(lead_s - (LEARNING_S if learns else LEAD_S), 0.0))

    def results_of(self, cases: LaneCases) -> Results:
        """The results of cases."""
        return self.batch.run(self.study, self.spec, self.ready, cases, bridge=self.bridge, strict=self.strict)

    @property
    def blocks(self) -> range:
        """Numbers of all blocks."""
        return range(-(-self.runs // self.block))

    def run(self, number: int) -> Summary:
        """Draws, runs and counts the cases of one block."""
        first, count = self.span(number)
        cases, family = self.drawn(first, count)
        return count_block(
            number,
            first,
            cases,
            family,
            self.results_of(cases),
            names=self.families,
            promises=self.promises,
            axes=self.axes,
            converter=self.study.converter,
            instruction_set="strict" if self.strict else self.batch.instruction_set(),
        )

    @property
    def nothing(self) -> Summary:
        """The summary of no blocks."""
        return Summary()

    def merged(self, whole: Summary, part: Summary) -> Summary:
        """The summary of the blocks of both. The order does not matter."""
        return whole.merged(part)

    def left(self, whole: Summary) -> list[int]:
        """The blocks that are not counted yet."""
        done = set(whole.blocks)
        return [number for number in self.blocks if number not in done]

    def count(self, part: Summary) -> int:
        """The runs of a summary."""
        return part.drawn

    def document(self, part: Summary) -> dict[str, Any]:
        """A summary in JSON's types."""
        return summary_document(part)

    def part_of(self, document: Any) -> Summary:
        """The summary of a document."""
        return summary_of(document)

    def span(self, number: int) -> tuple[int, int]:
        """(first, count) of the runs of a block; the last one may be shorter."""
        first = number * self.block
        return first, min(self.block, self.runs - first)

    @property
    def key(self) -> str:
        """Hash of everything that a summary depends on, the source of the package included.

        The instruction set is not part of it: it may differ from one shard to the next, and a job that is not strict
        may then differ in the last digits of a figure. The summary says which there were.
        """
        return hashlib.sha256(self.description.encode()).hexdigest()

    @property
    def description(self) -> str:
        """Everything that a summary depends on, as a text that is the same in every process."""
        study = replace(self.study, files=(), name="", title="", source="", hash="", origin=None)
        if study.verification is not None:  # a set, whose order is another in each process, and which was made use of
            study = replace(study, verification=replace(study.verification, given=frozenset()))
        tables = {name: table.sha256 for name, table in sorted(self.tables.items())}
        parts = (package_hash(), study, self.spec, tables, self.promises, self.runs, self.bridge, self.block)
        parts += (self.strict,)
        # Twelve digits of every number: what is computed from a study may differ in the last one between machines.
        return _NUMBER.sub(lambda found: f"{float(found[0]):.12g}", repr(parts))
