"""Random legal studies: no traceback, no raw warning, the same figures whatever is logged, and those of the log itself.

Each study runs twice: with an odd spacing of its log, and with every sample. The two results must be equal to the bit,
and the figures, rests and outcomes are read anew from the log of every sample by NumPy alone (``_log_reader``).
``VSGDESIGN_RANDOM_STUDIES=100`` runs so many of them instead of 1,000; ``VSGDESIGN_RANDOM_SEED`` draws others.
"""

from __future__ import annotations

import json
import os
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from evidence._log_reader import Converter, Difference, differences
from evidence._random_studies import drawn_study, odd_log
from evidence._tables import leave, table
from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.scenario import ScenarioResult, run_scenario
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.verbs.pipeline.results import results_document

COUNT, SEED = 1000, 20260


def ran(study: Study) -> tuple[ScenarioResult, dict[str, Any]]:
    """A run, and what results.json says of it but for times, hashes and the log."""
    result = run_scenario(study, Ready(tables=read_tables(study)))
    document = json.loads(json.dumps(plain(results_document(result, {}))))
    for key in ("study", "provenance"):
        document.pop(key)
    for told in document["controllers"].values():
        told.pop("loop_s")
        told.pop("real_time_factor")
        (told["table"] or {}).pop("not_of_this_study", None)  # it names the hash of the study
    return result, document


def examined(seed: int, folder: Path) -> tuple[str, list[Difference]]:
    """What became of a study, "refused" where its grid cannot carry it, and what differs."""
    rng = np.random.default_rng(seed)
    text = drawn_study(rng, folder, f"s{seed}")
    T_s = study_from_text(text.replace(", {log}", ""), folder=folder).converter.T_s
    coarse = study_from_text(text.replace("{log}", odd_log(rng, T_s)), folder=folder)
    whole = study_from_text(text.replace("{log}", f"log_interval = {T_s!r}"), folder=folder)
    try:
        _, of_coarse = ran(coarse)
    except InfeasibleStudyError:
        try:
            ran(whole)
        except InfeasibleStudyError:
            return "refused", []
        return "refused", [Difference("refused with one log alone", "", "")]
    result, document = ran(whole)
    found = (
        [] if of_coarse == document else [Difference("log_interval changes the results", *_first(of_coarse, document))]
    )
    c, f = whole.converter, whole.filter
    numbers = Converter(c.S_rated, c.V_rated_rms, c.omega_n, c.T_s, f.R_2, f.L_2)
    for one in result.controllers:
        found += differences(document, one.series, numbers, one.spec.name, one.bridge == "pwm")
    return result.controllers[0].outcome.status, found


def _first(one: Any, other: Any, path: str = "") -> tuple[str, str]:
    """The first place in which two documents differ."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return next(_first(one[key], other[key], f"{path}.{key}") for key in one if one[key] != other[key])
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return next(_first(*pair, f"{path}[{k}]") for k, pair in pairs if pair[0] != pair[1])
    return f"{path}: {one}", f"{path}: {other}"


def many(count: int, seed: int, folder: Path) -> tuple[Counter[str], list[dict[str, Any]]]:
    """Outcomes of so many studies, and one row for each difference, traceback or warning."""
    outcomes: Counter[str] = Counter()
    rows: list[dict[str, Any]] = []
    for k in range(seed, seed + count):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                status, found = examined(k, folder)
            except Exception:  # noqa: BLE001 - whatever fails is a finding
                status, found = "failed", [Difference("traceback", "", traceback.format_exc())]
        outcomes[status] += 1
        rows += [{"seed": k, **one._asdict()} for one in found]
    return outcomes, rows


def main(folder: Path) -> None:
    kept = folder / "random_studies"
    kept.mkdir(exist_ok=True)
    count = int(os.environ.get("VSGDESIGN_RANDOM_STUDIES", COUNT))
    outcomes, rows = many(count, int(os.environ.get("VSGDESIGN_RANDOM_SEED", SEED)), kept)
    lines = table(["outcome", "studies"], [(name, str(n)) for name, n in outcomes.most_common()])
    leave(folder, "random_studies", {"studies": count, "outcomes": outcomes, "differences": rows}, lines)
    print(f"{count} studies, {len(rows)} differences")
    for row in rows[:20]:
        print(f"  {row['seed']}: {row['where']}: {row['said']} against {row['read']}")
