"""Made results of a bench: every verdict, several controllers, as many rows as a real one has, drawn with a seed."""

from __future__ import annotations

import dataclasses
import itertools
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from vsgdesign.campaigns.compliance.evidence import Evidence, csv_path, limits_at
from vsgdesign.campaigns.compliance.measuring import Trace
from vsgdesign.campaigns.compliance.rows import (
    FAIL,
    IMPOSSIBLE,
    INFORMATIONAL,
    NOT_APPLICABLE,
    PASS,
    Check,
    Row,
    limits_of,
    summary_of,
)
from vsgdesign.campaigns.compliance.suite import OURS, SOURCE

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
LIMIT_PU = 1.2
GROUPS = {"p": "phase jump", "+": "ramp of the frequency", "S": "SCR jump", "V": "voltage step"}

OWN = {"document": "vsgdesign's own suite", "edition": "2026-11", "confidence": "ours", "note": "No grid code."}
TEMPLATES = {
    "document": "RTE, DyCoV grid-forming templates",
    "edition": "1.1",
    "confidence": "read",
    "note": "Analytic envelopes with parameters within ±10 %.",
}
FRAMEWORK = {
    "document": "AEMO, Voluntary specification for grid-forming inverters: core requirements test framework",
    "edition": "January 2024",
    "confidence": "secondary",
    "note": "The 60° jump is judged per site.",
}


def document(controllers: int = 3, sizes: int = 1, maps: bool = True, seed: int = 1) -> dict[str, Any]:
    """About 25 tests for ``sizes`` = 0, 100 for 1 and 570 for 7. Later controllers fail less."""
    names = ("CVSG", "AVSG-ANN", "DAMPED-ANN", "OPT")[:controllers]
    rng = np.random.default_rng(seed)
    rows = [
        dataclasses.asdict(_row(test, name, k, controllers, rng))
        for test in _tests(sizes)
        for k, name in enumerate(names)
    ]
    for row in rows:
        row["checks"] = list(row["checks"])
    suites = [("dycov", "RTE: DyCoV grid-forming templates", TEMPLATES), ("own", "Our own suite, harder than all", OWN)]
    suites.insert(1, ("aemo", "AEMO: grid-forming test framework", FRAMEWORK))
    return {
        "study": {
            "name": "own_5kva",
            "title": "A 5 kVA converter <& its grid>",
            "hash": "5d" * 32,
            "file": "my study.toml",
        },
        "suites": [
            {"name": name, "title": title, "about": "Made up\nfor tests.", "source": source}
            for name, title, source in suites
        ],
        "hashes": {"study": "5d" * 32, "tables": {names[-1]: "ab" * 32}, "package": "0c" * 32, "c": None},
        "controllers": [{"name": name, "colour": colour} for name, colour in zip(names, COLOURS, strict=False)],
        "converter": converter(names),
        "rows": rows,
        "summary": summary_of(rows),
        "limits": limits_of(rows),
        "maps": [_map(name, k, rng) for k, name in enumerate(names)] if maps else [],
        "provenance": {"vsgdesign": "1.2.3", "python": "3.11.2", "numpy": "2.1"},
    }


def converter(names: tuple[str, ...]) -> dict[str, Any]:
    """A 5 kVA converter, as ``compliance.identity.identity_of`` says it."""
    return {
        "S_rated_va": 5000.0,
        "V_rated_ll_rms_v": 190.5,
        "f_n_hz": 50.0,
        "Z_base_ohm": 7.26,
        "I_rated_pk_a": 21.4,
        "V_dc_v": 800.0,
        "f_sw_hz": 10e3,
        "T_s_s": 5e-5,
        "delay_samples": 1,
        "bridge": "averaged",
        "filter": {"L_1_h": 1e-3, "R_1_ohm": 1e-3, "C_f": 5e-5, "R_c_ohm": 0.0, "L_2_h": 0.0, "R_2_ohm": 0.0},
        "scr_basis": "impedance",
        "scr_basis_of_study": "reactance",
        "limits": [{"controller": name, "current_limit_pu": LIMIT_PU, "limiter": "circular"} for name in names],
    }


def _tests(sizes: int) -> Iterator[tuple[str, str, str, str, dict[str, str]]]:
    """(suite, group, title, network, source) of every test."""
    scrs = (1.25, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
    ratios = (0.5, 1.0, 2.0, 5.0, 10.0)
    for scr, event in itertools.product((10, 2), ("phase jump", "+0.5 Hz/s for 3 s", "SCR jump 2 ↔ 10", "V step −5 %")):
        yield "dycov", GROUPS[event[0]], f"{event}, SCR {scr}", f"SCR {scr}, X/R 10, P 0.5 pu", TEMPLATES
    for scr, jump in itertools.product((3, 10), (-60, -30, -10, 10, 30, 60)):
        yield "aemo", "phase jump", f"phase {jump:+d}°", f"SCR {scr}, X/R 6, P 0.5 pu", FRAMEWORK
    for scr, ratio, jump in itertools.product(scrs[:sizes], ratios, (-60, -30, -10, 10, 30, 60)):
        yield "own", "phase jump", f"phase {jump:+d}°", f"SCR {scr:g}, X/R {ratio:g}, P 0.75 pu", OWN
    depths, lengths = (0.7, 0.5, 0.2, 0.05, 0.0), (50, 150, 250, 1000)
    for scr, depth, ms, kind in itertools.product(scrs[:sizes], depths, lengths, ("balanced", "two-phase")):
        title = f"{kind} sag to {depth:g} pu for {ms} ms"
        yield "own", f"{kind} sags", title, f"SCR {scr:g}, X/R 5, P 0.75 pu", OWN
    for scr, ratio, rate in itertools.product(scrs[:sizes], ratios[:2], (0.5, 1, 2, 4)):
        yield "own", "ramps of the frequency", f"{rate:g} Hz/s to 51 Hz", f"SCR {scr:g}, X/R {ratio:g}, P 0.5 pu", OWN
    for share in (0.2, 0.4, 0.6, 0.8, 1.0):
        yield "own", "islanding", f"island with {share:g} pu, re-connected", "SCR 5, X/R 5, P 0.5 pu", OWN


def _row(test: tuple[str, str, str, str, dict[str, str]], name: str, k: int, of: int, rng: np.random.Generator) -> Row:
    suite, group, title, network, source = test
    key = f"{title}, {network}"
    usual: dict[str, Any] = {
        "suite": suite, "test": key, "group": group, "title": title, "controller": name, "network": network,
        "source": source, "csv": csv_path(suite, key, name), "study": f"cases/{suite}-{hash_of(key) % 1000}.toml",
        "settling_time_s": 1.0, "deadline_s": 2.2,
        "explore": '#{"scr": 2.0, "x_over_r": 5.0, "event": {"kind": "phase", "size": 60}}',
    }  # fmt: skip
    not_run: dict[str, Any] = usual | {"csv": None, "explore": None, "study": None}
    if group == "islanding" and "1 pu" in title:
        why = (
            "A load of 1 pu with 0.8 pu of reactive power needs √(1² + 0.8²) = 1.28 pu of current; the limit is 1.2 pu."
        )
        return Row(**not_run, verdict=IMPOSSIBLE, why=why)
    if group == "voltage step":
        why = "The test needs a tap changer, and the study has none."
        return Row(**not_run, verdict=NOT_APPLICABLE, why=why)
    settled, peak = float(rng.uniform(0.2, 1.5)), float(rng.uniform(0.7, LIMIT_PU))
    broken = rng.random() < 0.2 * (of - 1 - k) / max(of - 1, 1) + 0.004
    verdict, whose = FAIL if broken else PASS, OURS if source is OWN else SOURCE
    checks = [
        Check(measure="settling", label="Settling time", value=None if broken else settled, unit="s", at_most=2.0,
              verdict=verdict, why="it never settles" if broken else "", limit_of=whose),
        Check(measure="peak_current", label="Peak current", value=peak, unit="pu", verdict=INFORMATIONAL),
    ]  # fmt: skip
    if suite == "dycov":
        excess = float(rng.uniform(0.01, 0.2)) if broken else 0.0
        checks.append(
            Check(measure="excess", label="Power outside its envelope", value=excess, unit="pu", verdict=verdict,
                  envelope="phase_jump", limit_of=whose)
        )  # fmt: skip
    if group.startswith("ramp"):
        checks = [Check(measure="H", label="Inertia constant H", value=2.5 * peak, unit="s", verdict=INFORMATIONAL)]
        return Row(**usual, verdict=INFORMATIONAL, checks=tuple(checks), status="survived")
    why = "The angle slips by a turn 0.41 s after the event." if broken else ""
    return Row(**usual, verdict=verdict, why=why, checks=tuple(checks), status="slipped" if broken else "survived")


def hash_of(text: str) -> int:
    """A number of a text that is the same in every run."""
    return zlib.crc32(text.encode())


def _map(name: str, k: int, rng: np.random.Generator) -> dict[str, Any]:
    depths, lengths = (0.0, 0.05, 0.2, 0.5, 0.7), (0.05, 0.1, 0.15, 0.25, 0.5, 1.0)
    values: list[list[float | None]] = [
        [round(min(100.0, 40.0 + 30 * k + 40 * depth + 20 * rng.random()), 0) for _ in lengths] for depth in depths
    ]
    values[0][-1] = None
    return {
        "title": "Sags survived", "controller": name, "unit": "%", "values": values,
        "x": {"name": "duration_s", "label": "duration [s]", "values": list(lengths)},
        "y": {"name": "V_pu", "label": "voltage left [pu]", "values": list(depths)},
        "words": "Share of 20 sags of each kind that the controller survives at SCR 5. A dash: none was drawn.",
    }  # fmt: skip


def evidence(row: Mapping[str, Any], n: int = 3000, interval_s: float = 1e-3) -> Evidence:
    """A decaying oscillation; one that grows if the row fails."""
    rng = np.random.default_rng(hash_of(row["test"] + row["controller"]))
    t: Any = np.arange(n) * interval_s - 0.1
    after = np.where(t > 0.0, t, 0.0)
    decay = -0.8 if row["verdict"] == FAIL else rng.uniform(3.0, 8.0)
    swing = np.where(t > 0.0, np.exp(-decay * after) * np.sin(2 * np.pi * rng.uniform(1, 4) * after), 0.0)
    P = 0.5 + 0.4 * swing
    i = np.minimum(np.abs(P) * 1.05 + 0.02 * rng.random(n), LIMIT_PU)
    wave = 2 * np.pi * 50.0 * t
    trace = Trace(
        t_s=t, P_pu=P, Q_pu=0.1 * swing, f_hz=50.0 + 0.3 * swing, V_pu=1.0 + 0.02 * swing, delta_rad=0.3 + 0.5 * swing,
        i_s_pu=i, i_phase_pu=i, v_alpha_pu=np.cos(wave), v_beta_pu=np.sin(wave), i_g_alpha_pu=P * np.cos(wave),
        i_g_beta_pu=P * np.sin(wave), P_dc_pu=P, v_dc_pu=np.ones(n), limited=(i >= LIMIT_PU).astype(float),
    )  # fmt: skip
    limits = ()
    if row["suite"] == "dycov":
        times = np.array([0.0, 0.05, 0.5, 1.0, 2.5])
        low, high = np.array([-0.2, -0.1, 0.2, 0.4, 0.45]), np.array([1.2, 1.1, 0.8, 0.6, 0.55])
        limits = (limits_at(t, "P_pu", times, low, high),)
    return Evidence(trace=trace, limits=limits)


def traces_of(found: Mapping[str, Any], n: int = 3000) -> dict[str, Evidence]:
    """The evidence of every row that was run."""
    return {row["csv"]: evidence(row, n) for row in found["rows"] if row["csv"]}
