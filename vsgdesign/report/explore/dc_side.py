"""The dc side on the explorer's page: its signals with the levels at which the bridge blocks, and what a page without a
server needs to begin a run at another state of charge."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.loop_spec import LoopSpec
from vsgdesign.equations.sampled_path import bridge_power_at_rest
from vsgdesign.errors import Fault, StudyError
from vsgdesign.report.explore.page_verdicts import function_spec
from vsgdesign.simulation.dc_start import BLOCKS_AT, blocked, dc_columns
from vsgdesign.simulation.run import Simulation
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import Study

V_DC, CHARGE = "v_dc", "dc_charge"
"""Signals: the link's voltage, V, and the state of charge, %."""

WORDS = {
    "no_charge": "At a state of charge of {:.3g} % the source of the dc link cannot hold this operating point.",
    "clamped_charge": (
        "At a state of charge of {:.3g} % the controller asks its source for less than this operating point; "
        "`vsgdesign explore` shows it."
    ),
    "clamps": (
        "the controller asks for no more power than its source can give, and this page does not know the rest that "
        "follows; `vsgdesign explore` does"
    ),
    "charge_range": "The state of charge must be a number between 0 and 100 %.",
}
"""What a page without a server says."""


def signals_of(study: Study) -> list[dict[str, Any]]:
    """The signals of a study's dc link, as the page lists them: name, words, and the least and the most that an axis
    spans. None of an ideal link."""
    if study.dc is None:
        return []
    V = study.converter.V_dc
    found = [
        {"name": V_DC, "short": "dc link", "label": "voltage of the dc link in V", "least": 0.01 * V, "most": 3 * V}
    ]
    if _full(study, study.dc) is not None:
        found.append({"name": CHARGE, "short": "charge", "label": "state of charge in %", "least": 0.01, "most": 200.0})
    return found


def _full(study: Study, link: DcLink) -> tuple[str, float] | None:
    return link.full(link.settings(study.converter, study.filter))


def curves_of_dc(study: Study, run: Simulation) -> dict[str, NDArray[np.float64]]:
    """The signals of a run, every row of its log."""
    if study.dc is None or run.dc_log is None:
        return {}
    columns = dict(zip(dc_columns(study), run.dc_log.T, strict=True))
    full = _full(study, study.dc)
    charge = {} if full is None else {CHARGE: 100.0 / full[1] * columns[f"memory.{full[0]}"]}
    return {V_DC: columns["v"]} | charge


def levels_of(study: Study) -> list[dict[str, Any]]:
    """The voltages beyond which the bridge blocks, as bands of the response but for their time."""
    if study.dc is None:
        return []
    low, high = study.dc.V_low, study.dc.V_high
    return [
        {"signal": V_DC, "low": None, "high": high, "label": f"the bridge blocks above {high:.5g} V"},
        {"signal": V_DC, "low": low, "high": None, "label": f"the bridge blocks below {low:.5g} V", "under": True},
    ]


def check_page(study: Study, bridge: str) -> None:
    """Raises StudyError where a page without a server does not simulate the dc link of a study."""
    link = study.dc
    if link is None:
        return
    reasons = {
        f'control = "{link.control}"': link.droops,
        f'compensation = "{link.compensation}"': not link.compensates,
        f'bridge = "{bridge}"': bridge != "averaged",
    }
    faults = [
        Fault("dc", given, "a page that simulates has no verdict for a dc link that moves the converter's rest", ADVICE)
        for given, bad in reasons.items()
        if bad
    ]
    if faults:
        raise StudyError(study.name, faults)


ADVICE = "Use vsgdesign explore without --page, or vsgdesign simulate."


def page_of_dc(study: Study, loops: dict[str, LoopSpec]) -> dict[str, Any]:
    """What a page reads of a study's dc link; its loops join ``loops``. Nothing of an ideal link."""
    link = study.dc
    if link is None:
        return {}
    of = study.converter, study.filter
    settings, full = link.settings(*of), _full(study, link)
    loops |= {
        "link_rest": function_spec(link.kind.holds, {}),
        "bridge_power": function_spec(bridge_power_at_rest, {}),
    }
    return {
        "dc": {
            "signals": signals_of(study),
            "levels": [link.V_low, link.V_high],
            "blocked": [blocked(link, -math.inf, math.inf), blocked(link, math.inf, math.inf)],
            "blocks_at": BLOCKS_AT,
            "R_1": settings.R_1,
            "clamps": link.clamps,
            "charge": None if full is None else _charge(link, *full),
            "words": WORDS,
        }
    }


def _charge(link: DcLink, field: str, full: float) -> dict[str, Any]:
    return {
        "path": path_of_charge(link),
        "row": f"dc.memory.{field}",
        "full": full,
        "value": link.values["charge"],
        "section": f"[dc.{link.source}]",
    }


def path_of_charge(link: DcLink) -> str:
    """The field of a study file with the state of charge."""
    return f"dc.{link.source}.charge"


def with_written_charge(document: dict[str, Any], study: Study) -> dict[str, Any]:
    """The document of a study with its state of charge, if it has one."""
    link = study.dc
    if link is None or _full(study, link) is None:
        return document
    dc = document["dc"]
    own = {**dc.get(link.source, {}), "charge": link.values["charge"]}
    return {**document, "dc": {**dc, link.source: own}}
