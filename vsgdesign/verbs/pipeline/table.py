"""From a study to a gain table, and from that to its figures and page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts import staged_folder, write_record, write_table_file
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.gain_table_file import TABLE_FILE
from vsgdesign.artifacts.proof_file import PROOF_FILE, proof_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.artifacts.table_text import certificate_summary, full_order_summary
from vsgdesign.artifacts.time_series import UNITS, write_table
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.executors import Progress, executor_of, silent
from vsgdesign.execution.journal import begins_again, kept_elsewhere, work_folder
from vsgdesign.report.page.live import StaticPage
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.live_part import live_begun, waited_for
from vsgdesign.verbs.pipeline.study_tables import CELLS

if TYPE_CHECKING:  # the optimizer's libraries are loaded by who builds
    from vsgdesign.certificate.recheck.verdict import ProofCheck
    from vsgdesign.design.table import BuiltTable
    from vsgdesign.linear.stability.gain_table import TableCheck

CSV_FILE = "table.csv"
STATUSES = ("met", "relaxed", "outside")
REPORT = "vsgdesign table report"
FULL_ORDER = "full-order proof"
"""What a check of a table carries where it does not look at the proof."""


def build_table_file(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    fresh: bool = False,
    points: int | None = None,
    verify: int = 0,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Designs the gain table of a controller (the last one, if none is named) and writes it to ``out``.

    Returns the result in JSON's types. Finished cells are kept beside ``out`` until the file is complete, so the same
    call continues from them after an interruption and writes the same bytes. ``fresh`` ignores them. ``workers`` and
    ``cluster`` are those of :func:`vsgdesign.execution.executors.executor_of`. ``points`` is the number of random
    grids of each check between nodes (default 2000). ``verify`` is the number of random cases in EMT with which the
    table is verified; the file then has their counts and bounds. Raises StudyError, InfeasibleStudyError, WorkerError,
    and ArtifactError if the file cannot be written or would replace anything but a gain table.
    """
    out = Path(out)
    spec = study.controller_named(controller)
    study = study.with_limit_of(spec)
    if study.specification is None:
        advice = "Add one: it gives the requirements of the table and their box."
        raise StudyError(study.name, [Fault("specification", "", "missing table", advice)])
    TABLE_FILE.check_target(out)
    from vsgdesign.design.between import POINTS
    from vsgdesign.design.record import cells_file
    from vsgdesign.design.table import build_table
    from vsgdesign.verbs.pipeline.verify import Asked, check_verifiable, verified_table

    if verify:
        check_verifiable(study, Asked(controller=spec.name))
    with work_folder(out, CELLS, own=True, fresh=fresh) as folder:
        if say is not None and kept_elsewhere(folder, cells_file(folder)):
            say(begins_again(out))
        with executor_of(workers, cluster) as executor:
            built = build_table(
                study, spec, folder, executor=executor, points=POINTS if points is None else points, progress=progress
            )
            if verify:
                table = verified_table(study, spec, built.table, verify, folder, executor=executor, progress=progress)
                built = replace(built, table=table)
        write_table_file(built.table, out)
    return _built_document(built, out)


def prove_table_file(
    study: Study,
    out: str | Path,
    seconds: float,
    *,
    controller: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Spends some seconds on the proof of the sampled full-order loop of a table that was just built, and writes the
    statement into its file and the proof beside it. Returns the statement in JSON's types, by its name; nothing where
    no seconds are given. Raises ArtifactError."""
    if seconds <= 0.0:
        return {}
    from vsgdesign.verbs.pipeline.full_order import with_full_order

    spec, place = study.controller_named(controller), proof_of(out)
    PROOF_FILE.check_target(place)
    own, built = study.with_limit_of(spec), TABLE_FILE.read(out)
    table, proof = with_full_order(own, spec, built, seconds, workers=workers, progress=progress)
    write_table_file(table, out)
    if proof is not None:
        PROOF_FILE.write(proof, place)
    return full_order_summary(table)


def _built_document(built: BuiltTable, out: Path) -> dict[str, Any]:
    table, between = built.table, built.between
    return {
        "file": str(out),
        "table": {
            "name": table.name,
            "structure": table.structure,
            "law": table.law,
            "sha256": table.sha256,
            "scr": table.scr.tolist(),
            "x_over_r": table.x_over_r.tolist(),
            "study": table.study,
            "study_hash": table.study_hash,
            "design_hash": table.design_hash,
        },
        "certificate": certificate_summary(table.certificate),
        **full_order_summary(table),
        **({} if table.verification is None else {"verification": table.verification}),
        "cells": {status: int((table.status == status).sum()) for status in STATUSES},
        "added": [{"axis": axis, "value": value} for axis, value in built.added],
        "relaxed": [
            {
                "scr": record.scr,
                "x_over_r": record.x_over_r,
                "inner_loops_rad_s": record.inner_rad_s,
                "inner_loops_fail": "inner_loops" in record.missed,
                "would_be_feasible_with": {k: v for k, v in record.missed.items() if k != "inner_loops"},
            }
            for record in built.records
            if record.missed
        ],
        "causes": table.causes,
        "between": {
            "points": len(between.points) + between.outside,
            "seed": between.seed,
            "outside": between.outside,
            "promised": between.promised,
            "broken": [
                {"scr": p.scr, "x_over_r": p.x_over_r, "reached": p.missed, "figures": asdict(p.figures)}
                for p in between.broken
            ],
        },
    }


def check_whole_table(table: GainTable, study: Study | None = None, looked: ProofCheck | None = None) -> TableCheck:
    """All that can be checked of a table: its figures, what it says twice, its certificate at points, and the counts of
    its verification. With a study, it must be the table of this study, too. ``looked``: what a look at its
    full-order proof found."""
    from vsgdesign.campaigns.verification.document import record_faults
    from vsgdesign.certificate.checking import check_certificate
    from vsgdesign.linear.stability.gain_table import check_table

    # A number that cannot be computed agrees with none: it becomes a fault and not a warning.
    with np.errstate(all="ignore"):
        found, proof = check_table(table, study), check_certificate(table)
    counted = () if table.verification is None else tuple(record_faults(table.verification))
    carried = (*found.carried, *proof.carried, *_unchecked_proof(table, looked))
    return replace(found, faults=(*found.faults, *proof.faults, *counted), carried=carried)


def _unchecked_proof(table: GainTable, looked: ProofCheck | None) -> list[str]:
    """The statement on the full-order loop, where its proof was not looked at, or proves less."""
    said = table.full_order
    if said is None or "reason" in said or _holds(said, looked):
        return []
    return [FULL_ORDER]


def _holds(said: dict[str, Any], looked: ProofCheck | None) -> bool:
    """Whether a proof that was looked at proves what a table says, of units against each other as well."""
    if looked is None or looked.looked is None or looked.faults:
        return False
    less = looked.proved is not None and looked.proved < said["proved"] - 1e-9
    slower = looked.alpha is not None and looked.alpha < said["decay"] * (1.0 - 1e-9)
    return not (less or slower) and ("differential" not in said or _holds(said["differential"], looked.apart))


def check_document(outcome: TableCheck) -> dict[str, Any]:
    """The result of a check in JSON's types. ``good``: everything was computed again, and no fault was found."""
    return {"good": outcome.good} | vars(outcome)


def table_header(table: GainTable) -> list[str]:
    """Column names of :func:`table_rows`, with units where they are known."""
    from vsgdesign.linear.stability.table_claims import FIGURES, OF_BEFORE

    known = FIGURES | OF_BEFORE
    figures = [f"{name} [{known[name].unit}]" if name in known else name for name in table.figures]
    gains = [f"{name} [{UNITS[name]}]" for name in table.gains._fields]
    return ["SCR", "X/R", "status", "active", *gains, *figures]


def table_rows(table: GainTable) -> Iterator[list[object]]:
    """One row for each node: the gains at the table's design point, and its margins."""
    fields = [*table.gains, *table.figures.values()]
    for (i, j), status in np.ndenumerate(table.status):
        place = [float(table.scr[i]), float(table.x_over_r[j]), str(status), str(table.active[i, j])]
        yield [*place, *(float(values[i, j]) for values in fields)]


def _live(table: GainTable, study: Study | None) -> AbstractContextManager[Callable[[], StaticPage] | None]:
    """Begins to make the live part of the page, with the converter of a study."""
    if study is None:
        return nullcontext()
    return live_begun(study, Ready(tables={study.controllers[-1].name: table}))


def report_table(
    table: GainTable,
    out: str | Path,
    *,
    study: Study | None = None,
    inputs: Iterable[str | Path] = (),
    progress: Progress | None = None,
    done: Callable[[TableCheck], None] | None = None,
) -> dict[str, Any]:
    """Writes table.json and table.csv, figures, results.json and report.html to ``out``. Returns results.json.

    With a ``study`` whose only controller has the table, the page simulates in the browser: a table alone has no filter
    and no inner loops. ``inputs`` are the files from which the table comes. A folder that contains one of them is not
    replaced. ``done`` is given what was found when the table was checked. The folder appears when everything is done.
    Raises ArtifactError.
    """
    from vsgdesign.artifacts.measured_errors import shipped_errors
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.gain_table.page import table_figures, table_page
    from vsgdesign.report.page.html import print_html

    tell = progress or silent
    with staged_folder(out, REPORT, inputs=inputs) as folder, _live(table, study) as live:
        tell("check the table", 0.0)
        outcome = check_whole_table(table)
        tell("check the table", 1.0)
        write_table_file(table, folder / "table.json")
        write_table(folder / CSV_FILE, table_header(table), table_rows(table))
        tell("draw figures", 0.0)
        figures = write_all(table_figures(table, shipped_errors()), folder / "figures")
        tell("draw figures", 1.0)
        page = None if live is None else waited_for(live, tell)
        print_html(table_page(table, figures, outcome, page), folder / "report.html")
        document = {
            "table": {
                "name": table.name,
                "sha256": table.sha256,
                "study": table.study,
                "study_hash": table.study_hash,
                "design_hash": table.design_hash,
            },
            "certificate": certificate_summary(table.certificate),
            "between": table.between,
            "cells": {status: int((table.status == status).sum()) for status in STATUSES},
            "check": check_document(outcome),
            "figures": [figure.name for figure in figures],
        }
        if done is not None:
            done(outcome)
        return write_record(folder, document, REPORT)
