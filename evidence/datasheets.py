"""Random legal converters from datasheet to simulation: no traceback, and a sentence where something is impossible.

Each converter goes through ``new --from``, ``validate``, ``inner`` and ``simulate`` in one process.
The inner loops are searched with less effort than a user's (a fifth of the time). The scenario is the one that ``new``
writes, with closed-form gains in place of a table.
"""

from __future__ import annotations

import json
import os
import tempfile
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from evidence._tables import leave
from vsgdesign.design.inner import designing
from vsgdesign.design.inner.search import Effort
from vsgdesign.verbs.cli.program import main as command_line

COUNT, SEED = 300, 2026
QUICK = Effort(heat=15, generations=30, joined=10, rounds=1)
VERBS = ("new", "validate", "inner", "simulate")

VOLTAGES = ((1e4, (208.0, 400.0, 480.0)), (2e5, (400.0, 480.0, 690.0)), (1e9, (690.0, 3300.0)))
"""Line to line, by rating up to."""

ABOVE = """
base = "study.toml"
[[controllers]]
name = "closed_form"
kind = "scheduled"
"""


def sheet(rng: np.random.Generator) -> str:
    """A datasheet as CSV, in the units that people use."""
    S = float(np.exp(rng.uniform(np.log(1e3), np.log(5e6))))
    V = float(rng.choice(next(voltages for up_to, voltages in VOLTAGES if up_to >= S)))
    f = float(rng.choice([50.0, 60.0]))
    Z, omega = V * V / S, 2.0 * np.pi * f
    L_1, C = rng.uniform(0.03, 0.15) * Z / omega, np.exp(rng.uniform(np.log(0.02), np.log(0.2))) / (Z * omega)
    L_2 = rng.uniform(0.01, 0.1) * Z / omega if rng.random() < 0.6 else 0.0
    outer = L_2 + 0.3 / np.hypot(1.0, 0.3) * Z / 20.0 / omega
    resonance = np.sqrt((L_1 + outer) / (L_1 * outer * C)) / (2.0 * np.pi)
    twice, delta = rng.random() < 0.7, rng.random() < 0.3
    carrier = resonance * np.exp(rng.uniform(np.log(3.0), np.log(20.0))) / (2.0 if twice else 1.0)
    carrier = float(f"{max(carrier, 25.0 * f):.3g}")
    rows = {
        "Rated power": f"{S / 1e3:.4g} kVA" if S < 1e6 else f"{S / 1e6:.4g} MVA",
        "Rated voltage": f"{V:g} V L-L" if rng.random() < 0.7 else f"{V / 1e3:g} kV",
        "Frequency": f"{f:g} Hz",
        "DC link voltage": f"{V * np.sqrt(2.0) * rng.uniform(1.1, 1.6):.4g} V",
        "Switching frequency": f"{carrier / 1e3:.4g} kHz",
        "Samples per carrier": "twice" if twice else "once",
        "Computation delay": str(int(rng.random() < 0.75)),
        "PWM": str(rng.choice(["SVPWM", "min-max", "third harmonic"])),
        "Current limit": f"{rng.uniform(1.1, 2.0):.3g} pu",
        "L_1": f"{1e3 * L_1:.4g} mH" if rng.random() < 0.5 else f"{1e6 * L_1:.4g} uH",
        "C": f"{1e6 * C / (3.0 if delta else 1.0):.4g} uF",
        "Capacitor connection": "delta" if delta else "star",
    }
    if L_2 > 0.0:
        rows["L_2"] = f"{1e6 * L_2:.4g} uH"
    if rng.random() < 0.5:
        rows["R_1"] = f"{1e3 * 0.005 * Z:.4g} mohm"
    if rng.random() < 0.5:
        rows["R_c"] = f"{1e3 * 0.01 * Z:.4g} mohm"
    separator = str(rng.choice([",", ";", "\t"]))
    return "".join(f"{key}{separator}{value}\n" for key, value in rows.items())


def travel(number: int) -> dict[str, Any]:
    """One converter's way: exit code of each verb, the last line of an error, a traceback where there is one."""
    designing.Effort = lambda: QUICK  # type: ignore[assignment]
    found: dict[str, Any] = {"number": number, "codes": {}, "says": "", "traceback": ""}
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            Path("sheet.csv").write_text(sheet(np.random.default_rng([SEED, number])), encoding="utf-8")
            Path("closed.toml").write_text(ABOVE, encoding="utf-8")
            for arguments in (
                ["new", "--from", "sheet.csv"],
                ["validate", "closed.toml"],
                ["inner", "closed.toml", "--no-what-if", "--json"],
                ["simulate", "closed.toml", "--json"],
            ):
                result = CliRunner().invoke(command_line, arguments)
                found["codes"][arguments[0]] = result.exit_code
                if result.exception is not None and not isinstance(result.exception, SystemExit):
                    found["traceback"] = "".join(traceback.format_exception(result.exception))
                    break
                if arguments[0] == "inner" and result.exit_code == 0:
                    found["score"] = json.loads(result.stdout)["score"]
                if result.exit_code != 0:
                    found["says"] = f"{arguments[0]}: {result.stderr.strip()[:400]}"
                    break
        finally:
            os.chdir(here)
    return found


def main(folder: Path) -> None:
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        rows = list(pool.map(travel, range(COUNT)))
    leave(folder, "datasheets", rows)
    for verb in VERBS:
        codes = Counter(row["codes"].get(verb, "-") for row in rows)
        print(f"{verb}: exit codes {dict(sorted(codes.items(), key=str))}")
    scores = np.array([row["score"] for row in rows if "score" in row])
    stable, whole = (scores > 0).sum(), (scores >= 1).sum()
    print(f"scores: {len(scores)} designs, {stable} stable everywhere, {whole} keep everything")
    print(f"tracebacks: {sum(bool(row['traceback']) for row in rows)} of {COUNT}")
    for row in rows:
        if row["traceback"] or row["says"]:
            print(f"  {row['number']}: {row['traceback'] or row['says']}")
