"""What results.json says of each test and of the converter: the rows of the clause matrix, and the base values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from vsgdesign.equations.frames import phase_to_ll
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
    """Whether the limits are this project's and not the source's."""
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
    source: dict[str, str]
    """document, edition, confidence, note."""
    csv: str | None = None
    """Evidence files, relative to the folder of the result."""
    figure: str | None = None
    study: str | None = None
    """Study file with which ``vsgdesign simulate`` repeats the run."""
    explore: str | None = None
    """State of the explorer at this test's grid, as the part of a link after #."""


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
