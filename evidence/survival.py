"""Jumps, faults and phase steps: three converters through the whole set of disturbances, beside what is asked.

The angle-damped closed form and table with the projection limiter go through the systematic and the random set on all
three converters. The other controllers and limiters go through the systematic set on the first converter. Finished
runs are kept in the folder, so an interrupted measurement goes on where it was. ``VSGDESIGN_SURVIVAL_SHARE=0.1``
measures a tenth of the cases.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.parameters import load_study
from vsgdesign.pipeline.survival import (
    LIMITERS,
    subjects_of,
    survival_cases,
    survival_document,
    survival_tables,
    variant_name,
    write_cases,
)
from vsgdesign.simulation.survival import CaseResult, SurvivalCase, run_many

STUDIES = Path(__file__).resolve().parents[1] / "studies" / "survival"
CONVERTERS = {"5 kVA": "study", "12.5 kVA": "laboratory", "1 MVA": "utility"}
ASKED = ("angle_damped", "table")
"""The controllers whose figures are asked for, with the projection limiter."""

COMPARED = "5 kVA"
"""The converter on which the other controllers and limiters are measured, too."""

RECOVERY = {"5 kVA": 1.5}
"""The longest recovery that is asked for, in settling times; 2 of the others."""


def share_of(cases: Sequence[SurvivalCase]) -> tuple[SurvivalCase, ...]:
    """All cases, or the share of them that the environment asks for, drawn with a seed."""
    share = float(os.environ.get("VSGDESIGN_SURVIVAL_SHARE", "1"))
    count = round(share * len(cases))
    chosen = np.sort(np.random.default_rng(1).permutation(len(cases))[:count])
    return tuple(cases[k] for k in chosen)


def measure(name: str, file: str, folder: Path) -> dict[str, Any]:
    """One converter: its tables, its runs, and its document."""
    study = load_study(STUDIES / f"{file}.toml")
    ready = survival_tables(study, folder)
    everything, systematic = share_of(survival_cases(study)), share_of(survival_cases(study, random=False))
    asked = subjects_of(study, ready, controllers=ASKED, limiters=("projection",))
    others = {}
    if name == COMPARED:
        others = {key: one for key, one in subjects_of(study, ready, limiters=LIMITERS).items() if key not in asked}
    results: dict[str, tuple[CaseResult, ...]] = {}
    for subjects, cases in ((asked, everything), (others, systematic)):
        results |= run_many(subjects, cases, folder / f"{study.name}.runs.jsonl", progress=_progress(name))
    document = survival_document(study, asked | others, results)
    write_cases(folder / f"{study.name}.csv", results)
    return document


def main(folder: Path) -> None:
    kept = folder / "survival"
    kept.mkdir(exist_ok=True)
    documents = {name: measure(name, file, kept) for name, file in CONVERTERS.items()}
    (folder / "survival.json").write_text(json.dumps(documents, indent=1, ensure_ascii=False))
    print_asked(documents)
    print_variants(documents[COMPARED])
    print_groups(documents)
    for name, document in documents.items():
        for controller in ASKED:
            for lost in document["variants"][variant_name(controller, "projection")]["lost"]:
                print(f"lost: {name}, {controller}: {lost['group']}: {lost['case']}: {lost['reason']}")


def print_asked(documents: dict[str, Any]) -> None:
    """What is asked beside what was measured."""
    print("| converter, controller | survived | stale for ever | ≤ 1.26 pu | largest | first 5 ms to 60° | recovery |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    print("| asked | 100 % | ≥ 95 % | ≥ 99 % | ≤ 1.32 pu | ≤ 1.5 pu | median ≤ 1.1 T, all ≤ 1.5 T (others 2 T) |")
    for name, document in documents.items():
        for controller in ASKED:
            one = document["variants"][variant_name(controller, "projection")]
            near, ever = one["stale_to_1_s"], one["for_ever"]
            limit = RECOVERY.get(name, 2.0)
            times = f"{near['recovery_median']:.2f}, {near['recovery_worst']:.2f} (≤ {limit:g})"
            cells = (
                f"{name}, {controller}",
                _survived(near),
                _survived(ever),
                f"{100.0 * near['peak_kept']:.2f} %",
                f"{near['peak_pu']:.3f} pu",
                f"{one['phase_to_60']['first_peak_pu']:.2f} pu",
                f"{times}, T = {one['settling_time']:g} s",
            )
            print(f"| {' | '.join(cells)} |")
    print()


def print_variants(document: dict[str, Any]) -> None:
    """Every controller with every limiter on the systematic set."""
    print(f"| controller ({COMPARED}) | limiter | survived | stale for ever | largest current | largest swing |")
    print("| --- | --- | --- | --- | --- | --- |")
    for key in sorted(document["variants"], key=lambda one: one.split(", ")[0]):
        near, ever = (document["variants"][key][part] for part in ("stale_to_1_s", "for_ever"))
        controller, limiter = key.split(", ")
        figures = f"{near['peak_pu'] or 0.0:.2f} pu | {near['swing_rad'] or 0.0:.1f} rad"
        print(f"| {controller} | {limiter} | {_survived(near)} | {_survived(ever)} | {figures} |")
    print()


def print_groups(documents: dict[str, Any]) -> None:
    """The asked controllers by group of disturbances."""
    keys = [(name, controller) for name in documents for controller in ASKED]
    print("| group |" + "".join(f" {name}, {controller} |" for name, controller in keys) + " left out |")
    print("| --- |" + " --- |" * (len(keys) + 1))
    variants = [documents[name]["variants"][variant_name(controller, "projection")] for name, controller in keys]
    for group in variants[0]["groups"]:
        found = [one["groups"][group] for one in variants if group in one["groups"]]
        left = {f"{figures['cases'] - figures['judged']}" for figures in found}
        print(f"| {group} | {' | '.join(map(_survived, found))} | {', '.join(sorted(left))} |")
    print()
    for (name, controller), one in zip(keys, variants, strict=True):
        count: dict[str, int] = {}
        for figures in one["groups"].values():
            for status, number in figures["statuses"].items():
                count[status] = count.get(status, 0) + number
        print(f"{name}, {controller}: {sum(count.values())} cases: {count}")


def _survived(figures: dict[str, Any]) -> str:
    if not figures["judged"]:
        return "–"
    return f"{figures['survived']}/{figures['judged']} ({100.0 * figures['share']:.1f} %)"


def _progress(name: str) -> Any:
    last = [-1]

    def tell(what: str, share: float) -> None:
        if round(20 * share) != last[0]:
            last[0] = round(20 * share)
            print(f"{name}: {what} {100 * share:.0f} %", file=sys.stderr, flush=True)

    return tell
