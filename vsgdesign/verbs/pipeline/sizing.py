"""From a study to the sizes of its dc side: report.html and results.json."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.study_tables import kept_tables

VERB = "vsgdesign size"
LEAST_C, MOST_C = 1e-7, 100.0
"""Limits of a capacitor, F, as in [dc]."""

WORK = "dc-side"


def size_study(
    study: Study,
    out: str | Path,
    *,
    controller: str | None = None,
    C: float | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Sizes the dc side of a controller (None: the last one) for the events of its study, and writes report.html and
    results.json. ``C``: as in :func:`vsgdesign.campaigns.sizing.size_dc_side`. Returns results.json. Raises its
    errors and ArtifactError."""
    from vsgdesign.campaigns.sizing import size_dc_side
    from vsgdesign.export.unit import controller_named
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.sizing import sizing_page

    if C is not None and not LEAST_C <= C <= MOST_C:  # NaN as well
        limits = f"must be a capacitance from {LEAST_C * 1e9:g} nF to {MOST_C:g} F"
        raise StudyError(study.name, [Fault("capacitor", f"{C:g} F", limits, "Give it in F.")])
    with staged_folder(out, VERB, inputs=study.input_files) as folder:
        spec = controller_named(study, controller)
        alone = replace(study, controllers=(spec,))
        ready = Ready(tables=kept_tables(alone, progress=progress, say=say).tables)
        found = size_dc_side(study, spec, ready, C=C, progress=progress or silent)
        document = {
            "study": study.name,
            "title": study.title,
            "S_rated_w": study.converter.S_rated,
            "V_dc_v": study.converter.V_dc,
            "controller": found.controller,
            "size": asdict(found.size),
            "least_power_w": found.least_power,
            "C_given_f": found.C_given,
            "trade_off": [[p, C if math.isfinite(C) else None] for p, C in found.trade_off],
            "by_hand": {name: value if math.isfinite(value) else None for name, value in found.by_hand.items()},
            "largest_p_w": found.largest_p,
            "smallest_p_w": found.smallest_p,
            "least_v": found.least_v,
            "short": found.short,
            "trials": [_trial(asdict(one)) for one in found.trials],
            "energy_given": found.energy_given.tolist(),
            "provenance": provenance(),
        }
        print_html(sizing_page(document), folder / "report.html")
        return write_record(folder, document, VERB)


def _trial(one: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in one.items()}
