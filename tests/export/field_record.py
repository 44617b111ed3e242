"""A run of the EMT as samples for the exported field estimator, and what C makes of them."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vsgdesign.equations.field import FieldAnswer
from vsgdesign.export.compiled import STRICT, run_compiler
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.study.parameters import Study


@dataclass(frozen=True, eq=False)
class FieldRecord:
    """The samples that the estimator had in a run, and its answers."""

    rows: np.ndarray
    """(N, 6): v_α, v_β (V), i_α, i_β (A) as the sensors say them, θ with the probe (rad), limited."""
    answers: np.ndarray
    """(K, 14): the fields of FieldAnswer of every cycle."""
    sent: np.ndarray | None = None
    """(N, 2): the probe as it was sent, u e^{jθ'}; None if it is the estimator's own."""


def recorded_run(study: Study) -> FieldRecord:
    """The EMT of a study's first controller, with the field estimator; every sample is kept."""
    every = study.with_changes(simulation={"log_interval": study.converter.T_s})
    feed = FieldScheduler(every, every.controllers[0])
    run = simulate(every, feed).to_its_end()
    log = run.log
    if feed.sensed is not None and len(feed.sensed):
        measured = feed.sensed[: len(log)]
    else:
        v = log[:, 2:4] + every.filter.R_c * (log[:, 0:2] - log[:, 4:6])
        measured = np.column_stack([v, log[:, 4:6]])
    limited = np.diff(run.column("limited_samples"), prepend=0.0)
    rows = np.column_stack([measured, run.column("theta"), limited])
    return FieldRecord(rows, np.array([row.answer for row in feed.rows], dtype=float))


@dataclass(frozen=True)
class Replayed:
    """What C said and took, ns and bytes."""

    answers: np.ndarray
    """(K, 14), as in :class:`FieldRecord`."""
    sent: np.ndarray
    """(N, 2): the probe of every sample."""
    sample_ns: float
    sample_ns_p99: float
    sample_ns_worst: float
    conclude_ns: float
    conclude_ns_worst: float
    state_bytes: float
    lock_in_bytes: float
    track_bytes: float


def replay(folder: Path, build: Path, record: FieldRecord, *, double: bool, compiler: str = "gcc") -> Replayed:
    """The record through the exported C."""
    program, given = build / f"replay_{double}", build / "given.bin"
    told, probes = build / "told.bin", build / "probes.bin"
    sources = [str(Path(__file__).with_name("field_replay.c"))]
    sources += [str(folder / name) for name in ("vsg_field.c", "vsg_data.c", "vsg.c")]
    flags = ["-DVSG_DOUBLE"] if double else []
    strict = [flag for flag in STRICT if flag != "-std=c99"]
    run_compiler([compiler, "-std=gnu99", *strict, "-O2", *flags, f"-I{folder}", *sources, "-o", str(program), "-lm"])
    sent = np.zeros((len(record.rows), 2)) if record.sent is None else record.sent
    rows = np.column_stack([record.rows, sent])
    np.concatenate([[len(rows), float(record.sent is not None)], rows.ravel()]).tofile(given)
    command = [str(program), str(given), str(told), str(probes)]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = np.fromfile(told).reshape(-1, 1 + len(FieldAnswer._fields))
    numbers = said.split()
    return Replayed(rows[:, 1:], np.fromfile(probes).reshape(-1, 2), *map(float, numbers))


def apart(found: np.ndarray, wanted: np.ndarray, omega: float) -> np.ndarray:
    """|Z − Z'|/|Z| of every valid cycle."""
    valid = wanted[:, FieldAnswer._fields.index("valid")] > 0.5
    one, other = (rows[valid, 0] + 1j * omega * rows[valid, 1] for rows in (found, wanted))
    return np.abs(one - other) / np.abs(other)
