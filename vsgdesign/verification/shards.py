"""Parts of a verification on several machines: which blocks belong to which part, and whether parts make a whole."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import json_text
from vsgdesign.artifacts.guarded_file import content_hash
from vsgdesign.errors import ArtifactError, counted
from vsgdesign.verification.blocks import VerificationJob
from vsgdesign.verification.summary import Summary, summary_document, summary_of

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
        document = json.loads(path.read_text(encoding="utf-8"))
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
