"""The bench's own suite on three converters: what is survived of what is possible, the currents, and every failure.

The angle-damped closed form and table with the projection limiter go through every test, from four powers, told of the
grid 0.2 s late and never again after the first change; every eighth test with the field estimator in the loop, too.
Finished runs are kept. ``VSGDESIGN_FIELD_SHARE=0.1`` runs a tenth of the tests, drawn with a seed.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_converters import CONVERTERS, STUDIES
from evidence._grid_code_runs import AT_THE_PCC, CONTROLLERS, POINTS_PU, TOLD, GridCodeTask, run_task, tests
from evidence._kept_runs import kept_runs, share
from evidence._tables import leave, table
from vsgdesign.campaigns.compliance.rows import FAIL, IMPOSSIBLE, NOT_APPLICABLE
from vsgdesign.campaigns.compliance.suite import SuiteTest
from vsgdesign.metrics.survival import NOT_AT_REST, SURVIVED
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.grid import PHASE_TO_PHASE, Fault, Sag
from vsgdesign.verbs.pipeline.survival import survival_tables

Result = tuple[GridCodeTask, dict[str, Any]]

FIELD_SHARE = 8
"""One test in so many runs with the estimator in the loop."""

LIMIT_PU = 1.26
"""A phase current above this, later than 5 ms after an event, is counted: 5 % above the limit of 1.2 pu."""

NO_START = "no rest to begin at"
POINT_WORDS = {P_pu: f"{P_pu:g} pu" for P_pu in POINTS_PU} | {POINTS_PU[0]: "as in the suite, most 0.5 pu"}


def tasks() -> list[GridCodeTask]:
    """All runs, or the share of them that the environment asks for."""
    names = [name for name, test in tests().items() if test.group != AT_THE_PCC]
    everything = [
        GridCodeTask(converter, controller, told, P_pu, name)
        for converter in CONVERTERS
        for controller in CONTROLLERS
        for told in TOLD
        for P_pu in (POINTS_PU if told != TOLD[2] else POINTS_PU[:1])
        for name in (names if told != TOLD[2] else names[::FIELD_SHARE])
        if P_pu == POINTS_PU[0] or tests()[name].P_pu == POINTS_PU[0]
    ]
    order = np.random.default_rng(17).permutation(len(everything))
    chosen = np.sort(order[: round(share() * len(everything))])
    at_the_pcc = [name for name, test in tests().items() if test.group == AT_THE_PCC]
    both = [(converter, controller) for converter in CONVERTERS for controller in CONTROLLERS]
    added = [GridCodeTask(*one, TOLD[0], POINTS_PU[0], name) for one in both for name in at_the_pcc]
    return [*(everything[k] for k in chosen), *added]


def main(folder: Path) -> None:
    kept = folder / "grid_code"
    kept.mkdir(exist_ok=True)
    for name in CONVERTERS.values():  # the tables are designed once, before many processes need them
        survival_tables(load_study(STUDIES / f"{name}.toml"), kept)
    asked = tasks()
    run: Callable[[Any], dict[str, Any]] = functools.partial(run_task, folder=str(kept))
    found = list(zip(asked, kept_runs(run, asked, kept / "runs.jsonl", "grid_code"), strict=True))
    leave(folder, "grid_code", [{**task._asdict(), **result} for task, result in found], lines_of(found))


def lines_of(found: Sequence[Result]) -> list[str]:
    """The tables and the list of failures, as Markdown."""
    added = [one for one in found if one[1]["group"] == AT_THE_PCC]
    found = [one for one in found if one[1]["group"] != AT_THE_PCC]
    ordered = sorted(found, key=lambda one: POINTS_PU.index(one[0].P_pu))
    parts = {
        "Survived, of what is possible": table_of_controllers(found),
        "By group": table_by(found, "group", lambda one: str(one[1]["group"])),
        "By power before the test": table_by(ordered, "P before the test", lambda one: POINT_WORDS[one[0].P_pu]),
        "Currents": table_of_currents(found),
        "Unbalanced faults and sags": table_of_unbalanced(found),
        "Every failure": list_of_failures(found),
        "Added: a bolted fault at the PCC": table_at_the_pcc(added),
    }
    return [headline(found), *(one for title, part in parts.items() for one in ("", f"### {title}", "", *part))]


def kind_of(result: dict[str, Any]) -> str:
    """What a run counts as: survived, lost, impossible, not applicable, or that it has no rest to begin at."""
    if result["verdict"] in (IMPOSSIBLE, NOT_APPLICABLE):
        return str(result["verdict"])
    if result["status"] == SURVIVED:
        return SURVIVED
    return NO_START if "before the" in result["why"] else "lost"


def counted(found: Iterable[Result]) -> Counter[str]:
    """How many runs count as what."""
    return Counter(kind_of(result) for _, result in found)


def survived_of(found: Iterable[Result], good: Callable[[dict[str, Any]], bool] | None = None) -> str:
    """``survived of judged (share)``, as the judge of survival or ``good`` has it; a dash without any."""
    judged = [result for _, result in found if kind_of(result) in (SURVIVED, "lost")]
    count = sum(map(good or (lambda result: kind_of(result) == SURVIVED), judged))
    return f"{count:,} of {len(judged):,} ({_percent(count, len(judged))})" if judged else "–"


def within_2_T(result: dict[str, Any]) -> bool:
    """Whether a run survived at rest within 2 T + 0.2 s, whatever its schedule is told."""
    return bool(result["within_2_T"])


def rests_at_last(result: dict[str, Any]) -> bool:
    """Whether a run survived, or comes to rest later and neither slips nor is held by its limiter."""
    return kind_of(result) == SURVIVED or is_late(result)


def _percent(part: int, whole: int) -> str:
    """A share that is 100 % only where it is the whole."""
    share = 100.0 * part / whole
    return f"{share:.1f} %" if part == whole or share < 99.95 else f"{share:.2f} %"


def is_late(result: dict[str, Any]) -> bool:
    """Whether a run is lost for its time alone: it comes to rest while it is watched, and neither slips nor is held."""
    return kind_of(result) == "lost" and result["status"] == NOT_AT_REST and "later than" in result["why"]


def headline(found: Sequence[Result]) -> str:
    """The answer in some sentences."""
    count = counted(found)
    lost = [result for _, result in found if kind_of(result) == "lost"]
    late = sum(map(is_late, lost))
    told = [one for one in found if one[0].told != TOLD[1]]
    never = [one for one in found if one[0].told == TOLD[1]]
    return (
        f"{len(found):,} runs. Told the grid 0.2 s late, or with the field estimator in the loop: **{survived_of(told)}"
        f" are survived of what is possible. Never told again: {survived_of(never)}**; "
        f"{survived_of(never, within_2_T)} are at rest within the 2 T + 0.2 s of the others, and "
        f"{survived_of(never, rests_at_last)} come to rest. Of the "
        f"{len(lost):,} that are lost, {late:,} are late alone: they come to rest later, and neither slip nor latch. "
        f"{count[IMPOSSIBLE]:,} runs are impossible for any converter of this current, {count[NO_START]:,} "
        f"have {NO_START} with this controller's droops, and {count[NOT_APPLICABLE]:,} do not apply."
    )


def table_of_controllers(found: Sequence[Result]) -> list[str]:
    """Survived per converter and controller, for each thing that a schedule is told."""
    rows = []
    for converter in CONVERTERS:
        for controller in CONTROLLERS:
            own = [one for one in found if one[0].converter == converter and one[0].controller == controller]
            count = counted(own)
            cells = [survived_of(one for one in own if one[0].told == told) for told in TOLD]
            never = [one for one in own if one[0].told == TOLD[1]]
            cells[2:2] = [survived_of(never, within_2_T), survived_of(never, rests_at_last)]
            rows.append([f"{converter}, {controller}", *cells, str(count[IMPOSSIBLE]), str(count[NO_START])])
    titles = [*TOLD[:2], "within 2 T + 0.2 s", "at rest at last", *TOLD[2:], "impossible", NO_START]
    return table(["converter, controller", *titles], rows)


def table_by(found: Sequence[Result], title: str, key: Callable[[Result], str]) -> list[str]:
    """Survived per value of ``key`` and converter, with both controllers and whatever they are told."""
    rows = []
    for value in dict.fromkeys(map(key, found)):
        own = [one for one in found if key(one) == value]
        count = counted(own)
        cells = [survived_of(one for one in own if one[0].converter == name) for name in CONVERTERS]
        rows.append([value, *cells, str(count[IMPOSSIBLE]), str(count[NO_START])])
    return table([title, *CONVERTERS, "impossible", NO_START], rows)


def table_of_currents(found: Sequence[Result]) -> list[str]:
    """The largest phase currents of the bridge per group and converter."""
    rows = []
    for group in dict.fromkeys(str(result["group"]) for _, result in found):
        cells = []
        for name in CONVERTERS:
            own = [result for task, result in found if task.converter == name and result["group"] == group]
            peaks = [one["peak_after_5ms_pu"] for one in own if one["peak_after_5ms_pu"] is not None]
            first = [one["peak_pu"] for one in own if one["peak_pu"] is not None]
            above = sum(peak > LIMIT_PU for peak in peaks)
            cells.append(f"{max(peaks):.2f} pu, {above} of {len(peaks)}; {max(first):.2f} pu" if peaks else "–")
        rows.append([group, *cells])
    words = f"Largest later than 5 ms after an event, how many runs are above {LIMIT_PU:g} pu then; largest of all."
    return [*table(["group", *CONVERTERS], rows), "", words]


def unbalanced(test: SuiteTest) -> bool:
    """Whether a test has a two-phase fault or a dip that is not of type A."""
    return any(
        (isinstance(event.sag, Sag) and event.sag.kind != "A")
        or (isinstance(fault := event.switched.fault, Fault) and fault.kind == PHASE_TO_PHASE)
        for event in test.events
    )


def table_of_unbalanced(found: Sequence[Result]) -> list[str]:
    """Balanced beside unbalanced faults and sags: peaks and sequences of the current."""
    currents = ("largest phase current after 5 ms", "above", "current into the PCC, largest phase")
    head = ("converter, fault or sag", "runs", *currents, "positive sequence", "negative sequence")
    rows: list[list[str]] = []
    with_fault = [name for name, test in tests().items() if any(one.sag or one.switched.fault for one in test.events)]
    for converter in CONVERTERS:
        for words, wanted in (("balanced", False), ("unbalanced", True)):
            names = {name for name in with_fault if unbalanced(tests()[name]) == wanted}
            own = [one for task, one in found if task.converter == converter and task.test in names]
            peaks = [one["peak_after_5ms_pu"] for one in own if one["peak_after_5ms_pu"] is not None]
            if not peaks:
                continue
            cells = [f"{len(peaks)}", f"{max(peaks):.3f} pu", f"{sum(peak > LIMIT_PU for peak in peaks)}"]
            cells += [_range(own, f"{name}_pu") for name in ("fault_current", "positive_sequence", "negative_sequence")]
            cells += [_range(own, name) for name in ("P_mean_pu", "P_ripple_pu")] + [_range(own, "f_ripple_hz", "Hz")]
            rows.append([f"{converter}, {words}", *cells])
    return table((*head, "P, mean", "P at 2ω", "frequency at 2ω"), rows)


def _range(results: Iterable[dict[str, Any]], name: str, unit: str = "pu") -> str:
    values = [one[name] for one in results if one.get(name) is not None]
    return f"{min(values):.2f} to {max(values):.2f} {unit}" if values else "–"


def table_at_the_pcc(found: Sequence[Result]) -> list[str]:
    """What becomes of each converter, in the order of its tests."""
    rows = []
    for key in dict.fromkeys((task.converter, task.controller) for task, _ in found):
        own = [(task, one) for task, one in found if (task.converter, task.controller) == key]
        others = [
            f"{task.test.removeprefix(AT_THE_PCC + ', ')}: {one['why']}"
            for task, one in own
            if kind_of(one) != SURVIVED
        ]
        rows.append([", ".join(key), survived_of(own), "; ".join(others) or "–"])
    return table(("converter, controller", "survived", "the others"), rows)


def list_of_failures(found: Sequence[Result]) -> list[str]:
    """Those that are only late, counted with the latest of each; then every other failure in words."""
    lost = [(task, one) for task, one in found if kind_of(one) == "lost"]
    late = [(task, one) for task, one in lost if is_late(one)]
    others = [one for one in lost if one not in late]
    others += [(task, one) for task, one in found if (one["verdict"], kind_of(one)) == (FAIL, SURVIVED)]
    rows = []
    for key in dict.fromkeys((task.told, task.controller, str(one["group"])) for task, one in late):
        own = [(task, one) for task, one in late if (task.told, task.controller, str(one["group"])) == key]
        task, worst = max(own, key=lambda each: math.inf if each[1]["recovery_s"] is None else each[1]["recovery_s"])
        when = "not in the run" if worst["recovery_s"] is None else f"{worst['recovery_s']:.2f} s"
        latest = f"{when}: {task.converter}, P {task.P_pu:g} pu, {task.test}"
        rows.append([", ".join(key), f"{len(own)}", latest])
    lines = [*table(("late: what is told, controller, group", "runs", "the latest"), rows), ""] if late else []
    told = [f"- {t.converter}, {t.controller}, {t.told}, P {t.P_pu:g} pu, {t.test}: {one['why']}" for t, one in others]
    return [*lines, *(told or ["No run is lost in another way, and no run that survives fails another demand."])]
