"""From a study to the sizes of its dc side: report.html and results.json."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.study.parameters.study import ControllerSpec, Study
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
    source: str | None = None,
    keep: Mapping[str, float] | None = None,
    suites: Sequence[str] = (),
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Sizes the dc side of a controller (None: the last one) for the events of its study, or for suites of grid-code
    tests by their names or files, and writes report.html and results.json.

    ``C``, ``source`` (None: that of [dc], a converter where it is not sized) and ``keep``: as in
    :class:`vsgdesign.campaigns.sizing.Asked`. Returns results.json. Raises the errors of
    :func:`vsgdesign.campaigns.sizing.size_dc_side`, of the suites, and ArtifactError.
    """
    from vsgdesign.campaigns.sizing import KINDS, Asked, size_dc_side
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.sizing import sizing_page
    from vsgdesign.simulation.lanes.beforehand import told_beforehand

    if source is None:
        source = study.dc.source if study.dc is not None and study.dc.source in KINDS else "converter"
    faults = list(_faults(study, C, source, keep or {}, suites))
    if faults:
        raise StudyError(study.name, faults)
    with staged_folder(out, VERB, inputs=study.input_files) as folder:
        spec = study.controller_named(controller)
        alone = replace(study, controllers=(spec,))
        ready = Ready(tables=kept_tables(alone, progress=progress, say=say).tables)
        tests = _tests(study, spec, ready, suites)
        if say is not None and not suites:
            for text in told_beforehand(alone, ready):
                say(f"as the study is, {text}")
        asked = Asked(source=source, C=C, keep=keep or {})
        found = size_dc_side(study, spec, ready, asked, tests, progress=progress or silent)
        document = {
            "study": study.name,
            "title": study.title,
            "S_rated_w": study.converter.S_rated,
            "V_dc_v": study.converter.V_dc,
            "controller": found.controller,
            "source": found.source,
            "kept": list(found.kept),
            "suites": list(suites),
            "tests": list(found.runs),
            "left_out": [list(one) for one in found.left_out],
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


def _faults(
    study: Study, C: float | None, source: str, keep: Mapping[str, float], suites: Sequence[str]
) -> Iterator[Fault]:
    """What is asked for and cannot be sized."""
    from vsgdesign.campaigns.sizing import CAPACITOR, KEEPS, KINDS, POWER

    of_C = [("capacitor", "", C)] if C is not None else []
    of_C += [("keep", "capacitor = ", keep[CAPACITOR])] if CAPACITOR in keep else []
    for name, which, value in of_C:
        if not LEAST_C <= value <= MOST_C:  # NaN as well
            limits = f"must be a capacitance from {LEAST_C * 1e9:g} nF to {MOST_C:g} F"
            yield Fault(name, f"{which}{value:g} F", limits, "Give it in F.")
    if source not in KINDS:
        advice = "The power of an array is that of its modules and of the weather: choose these."
        yield Fault("source", source, f"is not sized; {' and '.join(KINDS)} are", advice)
    for name, value in keep.items():
        if name not in KEEPS:
            yield Fault("keep", name, "is no size", f"Give one of {', '.join(KEEPS)}.")
        elif name != CAPACITOR and not 0.0 < value < math.inf:
            unit = "W" if name == POWER else "J"
            yield Fault("keep", f"{name} = {value:g} {unit}", "must be positive and finite", "Give another value.")
    if len(keep) == len(KEEPS):
        yield Fault("keep", ", ".join(keep), "nothing is left to size", "vsgdesign simulate runs a given dc side.")
    if not suites and any(event.of_dc for event in study.events):
        advice = "Take these events away: the sizes are those of the whole source."
        yield Fault("events", "dc_power, dc_charge or irradiance", "a source that changes is not sized", advice)


def _tests(study: Study, spec: ControllerSpec, ready: Ready, suites: Sequence[str]) -> list[tuple[str, Study]]:
    """The tests of suites that apply to the controller and that some converter could do."""
    if not suites:
        return []
    from vsgdesign.campaigns.compliance.applies import impossible, not_applicable
    from vsgdesign.campaigns.compliance.case import Subject, case_of
    from vsgdesign.campaigns.compliance.reading import suite_named

    subject = Subject(study=replace(study, dc=None), spec=spec, ready=ready)
    return [
        (test.id if len(suites) == 1 else f"{suite.name}: {test.id}", case_of(subject, test))
        for suite in map(suite_named, suites)
        for test in suite.tests
        if not_applicable(subject, test) is None and impossible(subject.own_study, test) is None
    ]


def _trial(one: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in one.items()}
