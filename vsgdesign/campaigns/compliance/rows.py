"""What results.json says of each test and of the converter: the rows of the clause matrix, and the base values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vsgdesign.campaigns.compliance.suite import OURS, SOURCE, USER
from vsgdesign.equations.frames import phase_to_ll
from vsgdesign.metrics.survival import HARDWARE_PU, SURVIVED
from vsgdesign.metrics.survival import VERDICTS as JUDGED
from vsgdesign.study.parameters.event import BASIS
from vsgdesign.study.parameters.study import Study

PASS, FAIL, INFORMATIONAL, NOT_APPLICABLE, IMPOSSIBLE = "pass", "fail", "informational", "not applicable", "impossible"
VERDICTS = (PASS, FAIL, INFORMATIONAL, NOT_APPLICABLE, IMPOSSIBLE)
"""``impossible``: no converter with this current limit can do it; ``why`` gives the arithmetic."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One measured value of a row."""

    measure: str
    label: str
    value: float | None
    """None: the value is not known; ``why`` says why."""
    unit: str
    plus_minus: float = 0.0
    """How far the measuring may be from the value, in its unit."""
    at_least: float | None = None
    at_most: float | None = None
    envelope: str | None = None
    ours: bool = False
    """Whether the limits are this project's in a test of another source."""
    limit_of: str = ""
    """Whose the limits are (:meth:`vsgdesign.campaigns.compliance.suite.Criterion.limit_of`)."""
    verdict: str = INFORMATIONAL
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One test of one controller."""

    suite: str
    test: str
    """The test's id."""
    group: str
    title: str
    controller: str
    network: str
    """In words: ``SCR 3, X/R 10, P 0.5 pu``."""
    verdict: str
    why: str = ""
    checks: tuple[Check, ...] = ()
    status: str = ""
    """The survival judge's answer (``metrics.survival.STATUSES``)."""
    settling_time_s: float | None = None
    """The settling time T with which the judge has judged it, s."""
    deadline_s: float | None = None
    """By when it had to be at rest after the disturbance, s."""
    peak_pu: float | None = None
    """Largest current later than 5 ms after an event, pu of the rated peak."""
    source: dict[str, str]
    """document, edition, confidence, note."""
    csv: str | None = None
    """Evidence files, relative to the folder of the result."""
    figure: str | None = None
    study: str | None = None
    """Study file with which ``vsgdesign simulate`` repeats the run."""
    explore: str | None = None
    """State of the explorer at this test's grid, as the part of a link after #."""


LIMITS = (SOURCE, OURS, USER)
"""Whose a limit may be, in the order in which a passing row is counted."""


def passes_against(row: Mapping[str, Any]) -> str:
    """Whose limits a passing row keeps: those of its source if it keeps any of them, else ours or those of the suite's
    author. ``row`` as in results.json. Empty for any other row."""
    kept = {check["limit_of"] for check in row["checks"] if check["verdict"] == PASS}
    return next((whose for whose in LIMITS if whose in kept), "") if row["verdict"] == PASS else ""


def not_begun(row: Mapping[str, Any]) -> bool:
    """Whether a row has a verdict without a run, because the converter has no rest from which the test could begin."""
    return row["verdict"] in (FAIL, INFORMATIONAL) and row["csv"] is None


def summary_of(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """How many rows (as in results.json) have which verdict, for each suite and controller in the order of the rows.

    ``pass_source``, ``pass_ours`` and ``pass_user``: whose limits those that pass keep. ``not_begun``: rows among those
    that fail or are informational whose test could not begin. ``judged``: runs with a verdict on survival;
    ``survived``: those that survived, ``beyond_hardware`` those of them with a current that hardware does not carry
    (HARDWARE_PU). ``settling_time_s`` and ``deadline_s``: the largest with which they were judged.
    """
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        key = row["suite"], row["controller"]
        if key not in found:
            counts = dict.fromkeys((verdict.replace(" ", "_") for verdict in VERDICTS), 0)
            counts |= dict.fromkeys((*(f"pass_{whose}" for whose in LIMITS), "not_begun", "survived", "judged"), 0)
            counts |= {"beyond_hardware": 0, "settling_time_s": 0.0, "deadline_s": 0.0}
            found[key] = {"suite": key[0], "controller": key[1], **counts}
        found[key][row["verdict"].replace(" ", "_")] += 1
        if row["verdict"] == PASS:
            found[key][f"pass_{passes_against(row)}"] += 1
        found[key]["not_begun"] += not_begun(row)
        found[key]["judged"] += row["status"] in JUDGED
        found[key]["survived"] += row["status"] == SURVIVED
        found[key]["beyond_hardware"] += row["status"] == SURVIVED and (row.get("peak_pu") or 0.0) > HARDWARE_PU
        for name in ("settling_time_s", "deadline_s"):
            found[key][name] = max(found[key][name], row[name] or 0.0)
    return list(found.values())


def limits_of(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Every limit that was asked, in the order of the rows (as in results.json), and what it tells apart.

    ``judged``: runs that it judged, ``failed``: those that failed it; ``lost``: those among ``judged`` that did not
    survive, ``lost_kept``: those of them that kept it. A limit that no run fails, not even one that is lost, does not
    separate.
    """
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    names = "measure", "label", "at_least", "at_most", "envelope", "unit", "ours", "limit_of"
    for row in rows:
        for check in row["checks"] if row["csv"] is not None else ():
            if not check["limit_of"]:
                continue
            said = {"suite": row["suite"], **{name: check[name] for name in names}}
            counts = dict.fromkeys(("judged", "failed", "lost", "lost_kept"), 0)
            one = found.setdefault(tuple(said.values()), said | counts)
            lost = row["status"] != SURVIVED
            one["judged"] += 1
            one["failed"] += check["verdict"] == FAIL
            one["lost"] += lost
            one["lost_kept"] += lost and check["verdict"] == PASS
    return list(found.values())


def identity_of(study: Study) -> dict[str, Any]:
    """Numbers in SI, with their units in the names. ``limits``: current limit and limiter of every controller.

    ``scr_basis`` is that of the tests, which a study need not share: its own is ``scr_basis_of_study``.
    """
    c, f = study.converter, study.filter
    limited = {spec.name: study.with_limit_of(spec) for spec in study.controllers}
    return {
        "S_rated_va": c.S_rated,
        "V_rated_ll_rms_v": phase_to_ll(c.V_rated_rms),
        "f_n_hz": c.omega_n / (2.0 * math.pi),
        "Z_base_ohm": c.Z_base,
        "I_rated_pk_a": c.I_rated_pk,
        "V_dc_v": c.V_dc,
        **({} if study.dc is None else {"dc_source": study.dc.source}),
        "f_sw_hz": c.f_sw,
        "T_s_s": c.T_s,
        "delay_samples": c.delay_samples,
        "bridge": study.simulation.bridge,
        "filter": {"L_1_h": f.L_1, "R_1_ohm": f.R_1, "C_f": f.C, "R_c_ohm": f.R_c, "L_2_h": f.L_2, "R_2_ohm": f.R_2},
        "scr_basis": BASIS,
        "scr_basis_of_study": study.scr_basis,
        "limits": [
            {"controller": name, "current_limit_pu": own.converter.current_limit_pu, "limiter": own.current_limiter}
            for name, own in limited.items()
        ],
    }
