"""The proof of a study's sampled full-order loop: its table first, then the proof in parts that are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.proof_file import PROOF_FILE, SUFFIX, ProofFile, content_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.certificate import (
    FullOrderProof,
    MovingProof,
    Region,
    moving_proof_file,
    proof_file,
    prove_full_order,
    prove_moving,
)
from vsgdesign.errors import ArtifactError, InfeasibleStudyError, StudyError
from vsgdesign.execution.executors import Progress
from vsgdesign.execution.journal import Journal, journal_of, work_folder
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.verbs.pipeline.study_tables import study_tables

if TYPE_CHECKING:  # its kernels are loaded by who checks
    from vsgdesign.certificate.recheck.verdict import ProofCheck

Kept = Callable[[Any], AbstractContextManager[Journal[Any]]] | None

WORK = "full-order"
"""Of the folder with the finished parts."""


def place_of(study: Study, spec: ControllerSpec) -> Path:
    """Beside what the finished parts of a proof are kept until all are done."""
    return Path("out") / f"{study.name}-{spec.name}"


def prove_full(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    decay: float | None = None,
    *,
    proof: str | Path | None = None,
    fresh: bool = False,
    say: Callable[[str], None] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> FullOrderProof:
    """The statement of :func:`vsgdesign.certificate.prove_full_order`, whose ``options`` it takes and whose errors it
    raises. An interrupted call goes on from its finished parts; ``fresh`` begins again. ``proof`` is the file for the
    boxes and arcs; its place is looked at before the work. ``say`` takes a sentence where what is kept is of other
    work."""
    if proof is not None:
        PROOF_FILE.check_target(proof)
    ready = study_tables(replace(study, controllers=(spec,)), progress=progress).ready
    kept = partial(journal_of, out=place_of(study, spec), work=WORK, fresh=fresh, say=say)
    found = prove_full_order(study, spec, region, ready=ready, decay=decay, kept=kept, progress=progress, **options)
    if proof is not None and not found.unstable:
        PROOF_FILE.write(proof_file(study, found, ready.tables.get(spec.name)), proof)
    return found


def prove_changing(  # noqa: PLR0913 - those of certify
    study: Study,
    spec: ControllerSpec,
    region: Region,
    seconds: float,
    *,
    pair: bool = False,
    proof: str | Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    fresh: bool = False,
    say: Callable[[str], None] | None = None,
    progress: Progress | None = None,
) -> MovingProof:
    """The statement of :func:`vsgdesign.certificate.prove_moving`, whose errors it raises. What ``seconds`` were not
    enough for is named; another call goes on from its finished parts. ``proof`` is the file for the boxes, arcs and
    weights, which is written where anything is proved between points."""
    if proof is not None:
        PROOF_FILE.check_target(proof)
    ready = study_tables(replace(study, controllers=(spec,)), progress=progress).ready

    def kept(job: Any) -> AbstractContextManager[Journal[Any]]:
        work = f"{WORK}-{job.what.replace(' ', '-')}"
        return journal_of(job, out=place_of(study, spec), work=work, fresh=fresh, say=say)

    found = prove_moving(
        study, spec, region, ready=ready, pair=pair, kept=kept, workers=workers, cluster=cluster, progress=progress,
        seconds=seconds,
    )  # fmt: skip
    file = None if proof is None else moving_proof_file(study, spec, found)
    if proof is not None and file is not None:
        PROOF_FILE.write(file, proof)
    return found


def of_changing_gains(proof: str | Path) -> Path:
    """Where the proof of changing gains lies, beside that of gains that are held."""
    return Path(proof).with_suffix(f".moving{SUFFIX}")


def with_full_order(
    study: Study,
    spec: ControllerSpec,
    table: GainTable,
    seconds: float,
    *,
    workers: int | None = 1,
    progress: Progress | None = None,
) -> tuple[GainTable, ProofFile | None]:
    """A designed table with what ``seconds`` prove of its sampled full-order loop, and the proof.

    Finished parts are kept where :func:`prove_full` goes on from them. Without seconds nothing is done. Where no proof
    can be made, the table says why.
    """
    if seconds <= 0.0:
        return table, None
    from vsgdesign.certificate import on_basis_of_table, region_of

    ready = Ready(tables={spec.name: table})
    asked = study.specification
    pair = asked is not None and asked.differential_decay > 0.0
    # A table may be built for a controller of the study that does not follow one.
    spec = replace(spec, kind="scheduled", schedule="table", gains=None, design_grid=None)
    study = on_basis_of_table(replace(study, controllers=(spec,)), spec.name, ready)
    try:
        _, region = region_of(study, spec.name, None, None, ready=ready)
        with _kept(study, spec) as kept:
            found = prove_full_order(
                study,
                spec,
                region,
                ready=ready,
                pair=pair,
                kept=kept,
                workers=workers,
                progress=progress,
                seconds=seconds,
            )
    except (InfeasibleStudyError, StudyError) as error:
        reason = {"model": "full", "certified": False, "proved": 0.0, "reason": str(error)}
        return replace(table, full_order=reason), None
    proof = None if found.unstable else proof_file(study, found, table)
    statement = _shortened(found.as_document())
    if proof is not None:
        statement["proof_sha256"] = content_of(proof)
    return replace(table, full_order=statement), proof


def _shortened(statement: dict[str, Any]) -> dict[str, Any]:
    """A statement with the largest of the parts that are not proved."""
    own = statement | {"left": statement["left"][:_MOST_LEFT], "parts_left": len(statement["left"])}
    return own | ({"differential": _shortened(own["differential"])} if "differential" in own else {})


_MOST_LEFT = 20
"""Parts that are not proved, the largest ones, which a table's file names."""


@contextmanager
def _kept(study: Study, spec: ControllerSpec) -> Iterator[Kept]:
    """How finished parts are kept; not at all where another process is at work on the same proof."""
    try:
        with work_folder(place_of(study, spec), WORK):
            pass
        yield partial(journal_of, out=place_of(study, spec), work=WORK)
    except ArtifactError:
        yield None


def check_proof_file(
    proof: str | Path, study: Study, table: GainTable | None, *, progress: Progress | None = None
) -> ProofCheck:
    """A second look at the proof in a file (:func:`vsgdesign.certificate.recheck.verdict.check_proof`).

    A file that is missing leaves the proof unchecked. Raises ArtifactError where it is not one of a proof.
    """
    from vsgdesign.certificate.recheck.verdict import MISSING, ProofCheck, check_proof

    if not Path(proof).exists():
        return ProofCheck(carried=(MISSING,))
    return check_proof(PROOF_FILE.read(proof), study, table, progress=progress)
