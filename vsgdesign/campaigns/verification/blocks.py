"""A verification as a job: random cases in blocks, what a block counts, and the parts of several machines."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.files import json_text, package_hash
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.guarded_file import content_hash
from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.verification.counting import MapAxes, Promise, Results, count_block
from vsgdesign.campaigns.verification.summary import Summary, summary_document, summary_of
from vsgdesign.errors import ArtifactError, counted
from vsgdesign.execution import jobs
from vsgdesign.identification.interface import samples_itself
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.rests import SWITCHED_WINDOW
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S, settling_time_of
from vsgdesign.study.given_files import RESULT_BYTES, read_given
from vsgdesign.study.parameters.study import ControllerSpec, Study

BLOCK = 1024
"""Runs of a block: some tenths of a second of work, with a field estimator 15 seconds, and a whole number of lanes on
any machine. The workers end within one block of each other."""

RUNS = "EMT runs"
"""What progress calls the runs."""

_NUMBER = re.compile(r"\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+\b")


class SingleRun(NamedTuple):
    """A case that was simulated by itself."""

    figures: Mapping[str, float]
    """Those that the single run has, by the names of :data:`vsgdesign.campaigns.verification.counting.FIGURES`."""
    P: float
    Q: float
    """At rest before the first event, at the control point, W and var."""
    decay: float
    """Rate of the slowest mode of the full-order model at the last rest, 1/s; NaN where there is no such rest."""


def _all_of_it(cases: LaneCases) -> float:
    """The share of the grid's impedance that one converter sees."""
    del cases
    return 1.0


class Batch(NamedTuple):
    """How cases are drawn and run. Functions of modules, because they go to other processes."""

    draw: Callable[..., Any]
    """(study, spec, first, count, ready) -> (LaneCases, family (count,))."""
    cases_of: Callable[..., Any]
    """(study, spec, uniforms, family, ready) -> (LaneCases, family), for the search."""
    run: Callable[..., Any]
    """(study, spec, ready, cases, bridge=, strict=) -> results
    (:class:`vsgdesign.campaigns.verification.counting.Results`)."""
    instruction_set: Callable[[], str]
    """Of this machine, for results that are not strict."""
    written: Callable[..., str]
    """(study, spec, ready, cases, index, place, bridge) -> the text of a study that is this case, for a file there."""
    simulated: Callable[..., SingleRun]
    """(path, ready) -> the study of a case as a single run."""
    more: int = 0
    """Numbers of a case besides those of one converter (:func:`vsgdesign.campaigns.verification.draws.uniforms_of`)."""
    seen: Callable[[LaneCases], float] = _all_of_it
    """The share of the grid's impedance that a controller sees in the first of some cases."""


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
        """The cases with the time that a switched bridge, or a controller that is told its grid in a distorted one,
        needs to come to its own rest before the first event. One that learns its grid has time to do so."""
        learns = self.spec.kind == "scheduled" and samples_itself(self.spec.estimate)
        if self.bridge != "pwm" and (learns or not cases.around.distort(self.study)):
            return cases
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
        tables = {name: table.sha256 for name, table in sorted(self.tables.items())}
        parts = (package_hash(), self.study.content, self.spec, tables, self.promises)
        parts += (self.runs, self.bridge, self.block, self.strict)
        # Twelve digits of every number: what is computed from a study may differ in the last one between machines.
        return _NUMBER.sub(lambda found: f"{float(found[0]):.12g}", repr(parts))


COUNTS = "counts.json"
"""The file with the summary: the same bytes for the same seed, whatever the workers, the shards and the interruptions.
"""

KIND, SCHEMA = "vsgdesign verification counts", 1


@dataclass(frozen=True)
class Shard:
    """Part ``number`` of ``of``, from 1 on: every ``of``-th block."""

    number: int = 1
    of: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ValueError(f"{self}: the first of N is 1/N, the last is N/N")

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @classmethod
    def read(cls, text: str) -> Shard:
        """From ``i/N``. Raises ValueError with what is wrong."""
        first, slash, second = text.partition("/")
        if not slash or not first.strip().isdecimal() or not second.strip().isdecimal():
            raise ValueError(f"{text!r} is not i/N, as 3/16")
        return cls(int(first), int(second))

    def blocks(self, job: VerificationJob) -> range:
        """The numbers of its blocks."""
        return job.blocks[self.number - 1 :: self.of]


def counts_of_job(job: VerificationJob, summary: Summary) -> dict[str, Any]:
    """The content of counts.json."""
    document = {
        "kind": KIND,
        "schema": SCHEMA,
        "study": job.study.name,
        "controller": job.spec.name,
        "tables": {name: table.sha256 for name, table in sorted(job.tables.items())},
        "seed": None if job.study.verification is None else job.study.verification.seed,
        "runs": job.runs,
        "block": job.block,
        "bridge": job.bridge,
        "strict": job.strict,
        "key": job.key,
        "summary": summary_document(summary),
    }
    return document | {"sha256": content_hash(document)}


def write_counts(path: Path, job: VerificationJob, summary: Summary) -> None:
    """Write counts.json."""
    path.write_text(json_text(counts_of_job(job, summary)), encoding="utf-8", newline="\n")


def read_counts(path: Path) -> dict[str, Any]:
    """The content of a counts.json. Raises ArtifactError where it is damaged, or of something else."""
    try:
        document = json.loads(read_given(path, RESULT_BYTES))
        said = document.pop("sha256")
        if document["kind"] != KIND or document["schema"] != SCHEMA:
            raise ArtifactError(
                f'"{path}" is {document["kind"]!r} of schema {document["schema"]}, not {KIND!r} of {SCHEMA}.'
            )
        if content_hash(document) != said:
            raise ArtifactError(f'"{path}" was changed after it was written. Run this shard again.')
        summary_of(document["summary"])
    except OSError as error:
        raise ArtifactError(f'cannot read "{path}": {error.strerror}. Give a folder that `--shard` wrote.') from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ArtifactError(
            f'"{path}" is not the counts of a verification. Give a folder that `--shard` wrote.'
        ) from None
    return document


def counts_files(places: Iterable[str | Path]) -> list[Path]:
    """The counts.json of every place: a folder of a shard, or a folder that has such folders in it.

    Raises ArtifactError where a place has none.
    """
    found: list[Path] = []
    for place in map(Path, places):
        own = [place / COUNTS] if (place / COUNTS).is_file() else sorted(place.glob(f"*/{COUNTS}"))
        if not own:
            raise ArtifactError(f'"{place}" has no {COUNTS}, and no folder in it has one. Give what `--shard` wrote.')
        found += own
    return found


_HEADER = ("study", "controller", "seed", "runs", "strict", "bridge", "tables")
"""What differs first is said first; the key covers everything else."""


def check_same(files: Sequence[Path], documents: Sequence[Mapping[str, Any]]) -> None:
    """Raises ArtifactError with every file that belongs to another verification than the first."""
    first, faults = documents[0], []
    for path, one in zip(files[1:], documents[1:], strict=True):
        other = [f"{name} {one[name]!r} instead of {first[name]!r}" for name in _HEADER if one[name] != first[name]]
        if not other and one["key"] != first["key"]:
            other = ["another content of the study, or another version of vsgdesign"]
        if other:
            faults.append(f'"{path}" is of another verification: {", ".join(other)}')
    if faults:
        raise ArtifactError(
            f'shards of different verifications cannot be merged with "{files[0]}": {"; ".join(faults)}.'
        )


def merged_counts(files: Sequence[Path], documents: Sequence[Mapping[str, Any]], job: VerificationJob) -> Summary:
    """The summary of all shards of a job. Raises ArtifactError for another job, and for blocks that are there twice or
    missing.
    """
    if documents[0]["key"] != job.key:
        raise ArtifactError(
            f'"{files[0]}" was counted for another content of the study, of its table, or by another version of '
            "vsgdesign. Give the study as it was, or run the shards again."
        )
    whole, owners = Summary(), dict[int, Path]()
    for path, document in zip(files, documents, strict=True):
        part = summary_of(document["summary"])
        twice = next((k for k in part.blocks if k in owners), None)
        if twice is not None:
            raise ArtifactError(
                f'"{path}" and "{owners[twice]}" both have block {twice}: the same runs would count twice. Give each '
                "shard once."
            )
        owners |= dict.fromkeys(part.blocks, path)
        whole = whole.merged(part)
    missing = [k for k in job.blocks if k not in owners]
    if missing:
        raise ArtifactError(
            f"{counted(len(missing), 'block')} of {len(job.blocks)}, the first with number {missing[0]}, "
            f"{'is' if len(missing) == 1 else 'are'} missing: a shard is not there. Give the folders of all shards."
        )
    return whole
