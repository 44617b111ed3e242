"""The proof of a study's sampled full-order loop: its table first, then the proof in parts that are kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.proof_file import PROOF_FILE
from vsgdesign.certificate import FullOrderProof, Region, proof_file, prove_full_order
from vsgdesign.execution.journal import journal_of
from vsgdesign.execution.progress import Progress
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.verbs.pipeline.study_tables import study_tables

if TYPE_CHECKING:  # its kernels are loaded by who checks
    from vsgdesign.certificate.recheck.verdict import ProofCheck

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
    workers: int | None = None,
    cluster: str | None = None,
    fresh: bool = False,
    say: Callable[[str], None] | None = None,
    progress: Progress | None = None,
) -> FullOrderProof:
    """The statement of :func:`vsgdesign.certificate.prove_full_order`, whose errors it raises. An interrupted call
    goes on from its finished parts; ``fresh`` begins again. ``proof`` is the file for the boxes and arcs; its
    place is looked at before the work. ``say`` takes a sentence where what is kept is of other work."""
    if proof is not None:
        PROOF_FILE.check_target(proof)
    ready = study_tables(replace(study, controllers=(spec,)), progress=progress).ready
    kept = partial(journal_of, out=place_of(study, spec), work=WORK, fresh=fresh, say=say)
    found = prove_full_order(
        study, spec, region, ready=ready, decay=decay, kept=kept, workers=workers, cluster=cluster, progress=progress
    )
    if proof is not None and not found.unstable:
        PROOF_FILE.write(proof_file(study, found, ready.tables.get(spec.name)), proof)
    return found


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
