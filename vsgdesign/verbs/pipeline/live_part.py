"""The explorer beside a result: its page as a part of a report, and the links that open a run in it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import Any

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.compliance.suite import SuiteTest
from vsgdesign.errors import WorkerError
from vsgdesign.execution.executors import Progress, known_here_alone, worker_count, worker_processes
from vsgdesign.execution.jobs import begun
from vsgdesign.report.explore.lattice import PART_LATTICE
from vsgdesign.report.explore.page_file import live_page
from vsgdesign.report.explore.page_starts import PageCase
from vsgdesign.report.explore.state import StateError, state_of
from vsgdesign.report.page.live import StaticPage
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import Sag
from vsgdesign.study.parameters.network_fields import NOTHING_SAID
from vsgdesign.study.parameters.study import ControllerSpec

MOST = 4
"""Controllers of a part: as many as the explorer begins with."""


def told_apart(study: Study, ready: Ready) -> list[ControllerSpec]:
    """The controllers of a study but those that are the same as another one but for their estimate."""

    def same(spec: ControllerSpec) -> bool:
        return any(
            replace(spec, name=other.name, estimate="truth") == other and ready.table(spec) == ready.table(other)
            for other in study.controllers
        )

    return [spec for spec in study.controllers if spec.estimate == "truth" or not same(spec)]


def shown_in_part(study: Study, ready: Ready, cases: Sequence[PageCase] = ()) -> list[str]:
    """The controllers of a part. Of more than fit: those of its cases, the last one, which a study is about, and the
    first ones. The page tells every controller the grid, so that those which differ in their estimate alone are one."""
    names = [spec.name for spec in told_apart(study, ready)]
    of_cases = [case.study.controllers[0].name for case in cases]
    kept = list(dict.fromkeys([*of_cases, names[-1], *names]))[:MOST]
    return [spec.name for spec in study.controllers if spec.name in kept]


@contextmanager
def live_begun(
    study: Study,
    ready: Ready,
    workers: int | None = None,
    lattice: tuple[int, int] = PART_LATTICE,
    executor: Executor | None = None,
    cases: Sequence[PageCase] = (),
) -> Iterator[Callable[[], StaticPage]]:
    """Begins to make the page of a study in another process; what is yielded waits for it. With one worker it is
    made in that call. An ``executor`` that is there anyway is used.
    With ``cases`` the page opens with the first of them."""
    with ExitStack() as held:
        alone = worker_count(workers) == 1 or known_here_alone()
        if executor is None and not alone:
            executor = held.enter_context(worker_processes(1))
        shown = shown_in_part(study, ready, cases)
        kept = tuple(case for case in cases if case.study.controllers[0].name in shown)
        yield begun(executor, live_page, study, ready, lattice, controllers=shown, cases=kept)


def waited_for(begin: Callable[[], StaticPage], tell: Progress) -> StaticPage:
    """The page when it is made. A report does without it where it cannot be made."""
    tell("make the live page", 0.0)
    try:
        found = begin()
    except WorkerError as error:
        found = StaticPage(None, f"It was not made: {error}")
    tell("make the live page", 1.0)
    return found


def explorer_link(study: Study, tables: Mapping[str, GainTable], test: SuiteTest, controller: str) -> str | None:
    """The part of a link after #, which ``vsgdesign explore STUDY --state`` takes; None where the explorer cannot show
    the test's grid, or its load. Without an event in it, the page shows the grid alone: it has no such event."""
    c = study.converter
    spec = next(one for one in study.controllers if one.name == controller)
    if test.load is not None or (spec.schedule == "table" and controller not in tables):
        return None
    place = test.place.grid(c).place(c, study.scr_basis)
    state = {
        "scr": _short(place.scr),
        "x_over_r": _short(place.x_over_r),
        "P_pu": test.P_pu,
        "Q_pu": test.Q_pu,
        "V_g_pu": test.V_g_pu,
        "f_hz": _short(c.omega_n / (2.0 * math.pi) + test.df_hz),
        "silent_s": min(test.silent_s, 36000.0) if spec.kind == "scheduled" else 0.0,
        "controllers": [controller],
        "map_of": controller,
    }
    event = _event(study, test)
    for shown in ([] if event is None else [state | {"event": event}]) + [state]:
        with suppress(StateError):  # such as a sag to zero, which the page does not have
            state_of(shown, study)
            return json.dumps(shown, separators=(",", ":"), ensure_ascii=False)
    return None


def _event(study: Study, test: SuiteTest) -> dict[str, Any] | None:
    """The test's event as the explorer has it."""
    if not test.events or any(_beyond(event) for event in test.events):
        return None
    first, *more = test.events
    changed = _changed(first)
    if len(more) == 1 and changed == _changed(more[0]) == {"V_g_pu"} and more[0].V_g_rms == test.V_g_pu:
        left = _left(first, test)
        if left is None or first.over or more[0].over:
            return None
        return {"kind": "sag", "size": _short(1.0 - left), "length_s": _short(more[0].t_s - first.t_s)}
    if more:
        return None
    if changed == {"phase_jump"}:
        return {"kind": "phase", "size": first.phase_deg}
    if changed == {"df"} and first.df_hz is not None and first.over > 0.0:
        return {"kind": "ramp", "size": _short(first.df_hz - test.df_hz), "length_s": first.over}
    if changed == {"grid"} and first.place is not None:
        c = study.converter
        to = first.place.grid(c).place(c, study.scr_basis)
        return {"kind": "grid", "to_scr": _short(to.scr), "to_x_over_r": _short(to.x_over_r)}
    if changed == {"P_pu"} and first.P_ref is not None:
        return {"kind": "step", "signal": "P", "size": _short(first.P_ref - test.P_pu)}
    for kind, step in EVENT_KINDS.explored.values():
        value = kind.value(first)
        if changed == {kind.of_suite.name} and value is not None:
            c = study.converter
            return {"kind": step.name, "size": _short((kind.on(value, c) - step.start(c)) / step.one(c))}
    if changed == {"Q_pu"} and first.Q_ref is not None:
        return {"kind": "step", "signal": "Q", "size": _short(first.Q_ref - test.Q_pu)}
    return None


def _beyond(event: Event) -> bool:
    """Whether an event has what the explorer does not know: unbalanced dips, faults, loads, the breaker."""
    sag = event.sag
    unbalanced = isinstance(sag, Sag) and (sag.kind != "A" or sag.angle != 0.0)
    return unbalanced or event.switched != NOTHING_SAID


def _left(event: Event, test: SuiteTest) -> float | None:
    """What a balanced dip leaves of the voltage before it, as a share."""
    if isinstance(event.sag, Sag):
        return event.sag.V_pu
    return event.V_g_rms / test.V_g_pu if event.V_g_rms is not None and test.V_g_pu else None


def _changed(event: Event) -> set[str]:
    names = {kind.of_suite.name for kind in event.changed} | ({"grid"} if event.place is not None else set())
    return names | ({"V_g_pu"} if event.sag is not None else set())


def _short(value: float) -> float:
    """Six digits: a link is to be read."""
    return float(f"{value:.6g}")
