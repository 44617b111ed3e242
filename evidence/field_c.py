"""The exported field estimator over a recorded run of 60 s: what C answers beside the simulation, and what it costs.

The run is the published scenario (SCR 2, 8, 20; two steps of P, one of Q) with the dirty background and dirty sensors,
a switched bridge, and a schedule that follows the estimator. Every sample that the estimator had is given to the
exported C in both precisions. Times are means over a cycle on this machine, of which the least is given, since other
work only adds. Multiply-adds are counted in the expression trees from which the C is printed. It needs gcc.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from evidence._tables import leave, table
from tests.codegen.counting import cost_of
from tests.export.exchange import written
from tests.export.field_record import FieldRecord, apart, recorded_run, replay
from tests.export.footprint import COMPILER, measure_field_footprint
from vsgdesign.artifacts.field_weights import read_field_weights
from vsgdesign.equations.field import FieldAnswer, FieldFeatures, conclude, features, listen, probe_value
from vsgdesign.equations.field.lock_in import probe_offset
from vsgdesign.equations.frames import rotate
from vsgdesign.export.c_code import export_c
from vsgdesign.export.c_content import Origin
from vsgdesign.export.field import converter_constants
from vsgdesign.identification.field import field_network
from vsgdesign.runtime import load_scheduler
from vsgdesign.study.parameters import study_from_text

SCENARIO = """
base = "case:hoang2025_5kva"
grid = { scr_basis = "impedance", scr = 2, x_over_r = 1 }
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
inner_loops = { transient_resistance_pu = 0.08 }
power_loops = { tau_P = "5 ms", tau_Q = "5 ms" }
simulation = { duration = "60 s", bridge = "pwm", P_ref = "2 kW", Q_ref = "1 kvar" }
background = { level = "dirty", seed = 14 }
sensors = { level = "dirty", seed = 14 }
controllers = [{ name = "field", kind = "scheduled", structure = "angle_damped", estimate = "field" }]
events = [
    { time = "10 s", P_ref = "2.5 kW" },
    { time = "20 s", grid = { scr = 8 } },
    { time = "30 s", P_ref = "3 kW" },
    { time = "40 s", grid = { scr = 20 } },
    { time = "50 s", Q_ref = "1.5 kvar" },
]
"""
DECISIONS = ("valid", "changed", "event", "doubt", "mode")


def main(folder: Path) -> None:
    """Prints the tables and writes their rows to field_c.json."""
    study = study_from_text(SCENARIO)
    record = recorded_run(study)
    network = field_network(read_field_weights(), FieldFeatures._fields)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="vsg") as name:
        place = Path(name)
        origin = Origin("t", "0" * 64, "s", "0" * 64, limiter=study.current_limiter)
        scheduler = load_scheduler(written(place)[0])
        plain, behind = (
            export_c(scheduler, origin, place / kind, converter=converter_constants(study, net)).folder
            for kind, net in (("plain", None), ("network", network))
        )
        print(f"60 s, {len(record.rows):,} samples, {len(record.answers):,} cycles, gcc -O2")
        head = ("precision", "error of Z, largest (median)", "cycles decided otherwise")
        times = ("ns a sample: mean, 99 %, longest", "us a cycle: mean, longest", "us a cycle with network")
        print("\n".join(table((*head, *times, "bytes"), ())))
        first = replay(plain, place, record, double=True)
        for double in (True, False):
            # Single precision is given the probe that was sent in the run: its own would not be what was measured.
            given = FieldRecord(record.rows, record.answers, None if double else first.sent)
            found = replay(plain, place, given, double=double)
            with_network = replay(behind, place, given, double=double)
            error = apart(found.answers, record.answers, study.converter.omega_n)
            decided = otherwise(found.answers, record.answers)
            row = {
                "precision": "double" if double else "single",
                "error_largest": float(error.max()),
                "error_median": float(np.median(error)),
                "decided_otherwise": decided,
                "sample_ns": [found.sample_ns, found.sample_ns_p99, found.sample_ns_worst],
                "conclude_ns": [found.conclude_ns, found.conclude_ns_worst],
                "conclude_with_network_ns": with_network.conclude_ns,
                "bytes": found.state_bytes,
                "bytes_with_network": with_network.state_bytes,
            }
            rows.append(row)
            print(
                f"| {row['precision']} | {error.max():.1e} ({np.median(error):.1e}) | {decided} | "
                f"{found.sample_ns:.0f}, {found.sample_ns_p99:.0f}, {found.sample_ns_worst:.0f} | "
                f"{found.conclude_ns / 1e3:.2f}, {found.conclude_ns_worst / 1e3:.1f} | "
                f"{with_network.conclude_ns / 1e3:.2f} | {found.state_bytes:.0f} |",
                flush=True,
            )
        rows.append(counted())
        if shutil.which(COMPILER) is not None:
            for kind, exported in (("plain", plain), ("network", behind)):
                footprint = measure_field_footprint(exported)
                print(f"Cortex-M4F, {kind}: {footprint}")
                rows.append({"footprint": kind} | footprint._asdict())
    leave(folder, "field_c", rows)


def otherwise(found: np.ndarray, wanted: np.ndarray) -> int:
    """Cycles in which a decision differs."""
    columns = [FieldAnswer._fields.index(name) for name in DECISIONS]
    return int(np.any(found[:, columns] != wanted[:, columns], axis=1).sum())


def counted() -> dict[str, Any]:
    """Operations of a sample and of a cycle."""
    sample = [cost_of(function) for function in (probe_value, probe_offset, rotate, listen)]
    cycle = cost_of(conclude)
    seen = cost_of(features)
    multiply_adds = max(sum(one.products for one in sample), sum(one.sums for one in sample))
    print(f"a sample: {multiply_adds} multiply-adds, {sum(one.divisions for one in sample)} division, and in sending "
          f"{sum(one.functions for one in sample) + 2} functions")  # fmt: skip
    print(f"a cycle: {cycle.multiply_adds} multiply-adds, {cycle.divisions} divisions, {cycle.functions} functions; "
          f"features of the network {seen.multiply_adds}, {seen.divisions}, {seen.functions}")  # fmt: skip
    return {"sample_multiply_adds": multiply_adds, "cycle": vars(cycle), "features": vars(seen)}
