"""What the page asks: one study with its gain tables, ready, and an answer to every state of the page."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import Fault, StudyError
from vsgdesign.report.explore.state import State, StateError, defaults, faults_of, state_of
from vsgdesign.report.explore.wire import Answer, never
from vsgdesign.study.parameters.grid import only_a_grid
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.artifacts.network_weights import NetworkWeights
    from vsgdesign.equations.structures import Structure
    from vsgdesign.execution.workers import AnsweringProcess


KEPT = 16
"""Changed studies that are kept: one drags the grid much more often than one changes the study."""
AVERAGED, SWITCHED = "averaged", "pwm"
"""Bridges."""
COMPILING = "Compiling once: the simulation follows in a moment."
PATIENCE_S = 2.0
"""How long a request for EMT waits for the compiler before it says so."""


class Session:
    """A study with its gain tables. Every method may be called from several threads at once.

    Its matrices are small: let BLAS work on one thread (``OPENBLAS_NUM_THREADS=1``), or answers take twice the time.
    Modules are loaded when their answer is asked for first: the linear answer is there before EMT is loaded.
    """

    def __init__(
        self,
        study: Study,
        ready: Ready,
        *,
        files: Mapping[str, Path] | None = None,
        words: str = "",
        start: Mapping[str, Any] | None = None,
        bridge: str = AVERAGED,
    ) -> None:
        """``files`` says from which file a controller's table was read, ``words`` where the tables come from,
        ``start`` with which state the page begins, if not with the study's own, and ``bridge`` ("averaged" or "pwm")
        which bridge it runs with in place of the study's. A switched one is run by a page without a server alone.
        Raises StateError for a wrong start, StudyError for another bridge, InfeasibleStudyError for a study with a
        load, a fault or an open breaker at the start.
        """
        only_a_grid(study.network, "the explorer")
        if bridge not in (AVERAGED, SWITCHED):
            fault = Fault("bridge", str(bridge), f'is neither "{AVERAGED}" nor "{SWITCHED}"', "Give one of them.")
            raise StudyError("the explorer", [fault])
        self.bridge, self.bridge_of_study = bridge, study.simulation.bridge
        self.study, self.ready = replace(study, simulation=replace(study.simulation, bridge=bridge)), ready
        self.files = dict(files or {})
        self.words = words
        self._changed: OrderedDict[str, Study] = OrderedDict()
        self._lock = threading.Lock()
        self._warm = threading.Event()
        self._warm.set()
        self._closed = threading.Event()
        self._colours = {spec.name: colour_of(k) for k, spec in enumerate(study.controllers)}
        self._info: dict[str, Any] | None = None
        self._apart: list[AnsweringProcess] = []
        self._processes: list[AnsweringProcess] = []
        """Those that answer EMT, and those that begin."""
        self.start = self.state(start or {})

    def info(self) -> dict[str, Any]:
        """Everything that the page needs to know of the study, in JSON's types."""
        from vsgdesign.report.explore.fields import study_info

        with self._lock:
            if self._info is None:
                self._info = study_info(self.study, self.ready, self._colours)
            return self._info

    def check(self, document: Any) -> list[dict[str, Any]]:
        """The faults of a state, each with field, value, limit, unit and text; none for one that has answers."""
        try:
            self.study_of(self.state(document))
        except StateError as error:
            return error.faults
        return []

    def state(self, document: Any) -> State:
        """A state that the page sends. Raises StateError with every fault, those of changed fields of the study too."""
        faults: list[dict[str, Any]] = []
        try:
            state = state_of(document, self.study)
        except StateError as error:
            faults, state = error.faults, None
        changes = document.get("changes") if isinstance(document, Mapping) else None
        if isinstance(changes, dict) and all(isinstance(value, str | int | float) for value in changes.values()):
            try:
                self._with_changes(changes)
            except StateError as error:
                known = [one["field"] for one in faults]
                faults = faults + [one for one in error.faults if one["field"] not in known]
        if faults or state is None:
            raise StateError(faults)
        return state

    def study_of(self, state: State) -> Study:
        """The study with the changes of a state. Raises StateError."""
        return self._with_changes(dict(state.changes))

    def answer(self, kind: str, document: Any, stale: Callable[[], bool] = never) -> Answer | None:
        """The answer of a kind, ``linear``, ``modes``, ``emt`` or ``map``, to a state of the page as the page sends it.

        None: a newer request made this one ``stale`` meanwhile. Raises StateError with every fault of the state.
        """
        state = self.state(document)
        study = self.study_of(state)
        if kind in ("linear", "modes"):
            return self.linear(study, state) if kind == "linear" else self.modes(study, state)
        return self.map(study, state) if kind == "map" else self.emt(study, state, stale)

    def linear(self, study: Study, state: State, *, details: bool = False) -> Answer:
        """Modes, margins, Bode and linear steps (:func:`vsgdesign.report.explore.linear.linear_answer`)."""
        from vsgdesign.report.explore.linear import linear_answer

        return self._coloured(linear_answer(study, self.ready, state, details=details))

    def modes(self, study: Study, state: State) -> Answer:
        """What takes part in each mode and what moves it (:func:`vsgdesign.report.explore.linear.modes_answer`)."""
        from vsgdesign.report.explore.linear import modes_answer

        return self._coloured(modes_answer(study, self.ready, state))

    def map(self, study: Study, state: State) -> Answer:
        """One figure over the grids (:func:`vsgdesign.report.explore.maps.map_answer`)."""
        from vsgdesign.report.explore.maps import map_answer

        return map_answer(study, self.ready, state)

    def emt(self, study: Study, state: State, stale: Callable[[], bool] = never) -> Answer | None:
        """The simulated event (:func:`vsgdesign.report.explore.live.emt_answer`).

        While the simulation is being compiled, an answer without controllers says so; its ``again`` asks the page to
        ask again.
        """
        if not self._warm.wait(PATIENCE_S):
            return Answer({"controllers": [], "words": COMPILING, "again": True})
        return self._emt(study, state, stale)

    def warm_up(self, *, apart: int = 0) -> None:
        """Load and compile what EMT and maps need, with the state with which the page begins.

        ``apart``: the number of processes in which EMT is computed from then on, at the same time as the linear answer:
        two threads of one process would take turns. They end with this process. Should one be lost, or with 0, EMT is
        computed here.
        """
        from vsgdesign.report.explore.maps import map_answer

        self._warm.clear()
        try:
            if apart:
                self._apart = [self._process()]
            self._emt(self.study_of(self.start), self.start, self._closed.is_set)
        finally:
            self._warm.set()
        if self._closed.is_set():
            return
        map_answer(self.study_of(self.start), self.ready, self.start)
        # The first answers do not wait for these.
        for _ in range(min(apart, len(self.study.controllers)) - 1):
            process = self._process()
            process.ask((self.start, (0,)))
            self._apart = [*self._apart, process]

    def _process(self) -> AnsweringProcess:
        from vsgdesign.equations.structures import STRUCTURES
        from vsgdesign.execution.workers import AnsweringProcess

        ready = self.ready
        process = AnsweringProcess(_emt_of, self.study, dict(ready.tables), ready.network, STRUCTURES.added)
        with self._lock:
            closed = self._closed.is_set()
            if not closed:
                self._processes.append(process)
        if closed:
            process.close()
        return process

    def close(self) -> None:
        """Ends the processes in which EMT is computed, and a warm-up at its next step."""
        with self._lock:
            self._closed.set()
            processes, self._processes = self._processes, []
        for process in processes:
            process.close()
        self._apart = []

    def save(self, document: Any) -> dict[str, str]:
        """A name and the text of a study file for a state of the page, and words on what the file does not say.

        Raises StateError.
        """
        from vsgdesign.report.explore.saving import saved_study

        state = self.state(document)
        try:
            text, notes = saved_study(self.study_of(state), self.ready, state, self.files)
        except StudyError as error:
            raise StateError(faults_of(error)) from error
        return {"name": f"{self.study.name}-explored.toml", "toml": text, "words": " ".join(notes)}

    def _emt(self, study: Study, state: State, stale: Callable[[], bool]) -> Answer | None:
        found = None
        apart = [process for process in self._apart if process.alive]
        if apart and not stale():
            from vsgdesign.execution.workers import ask_all
            from vsgdesign.report.explore.wire import joined_emt

            count = max(min(len(apart), len(state.controllers)), 1)
            places = [range(k, len(state.controllers), count) for k in range(count)]
            asked = ask_all([(process, (state, of_one)) for process, of_one in zip(apart, places, strict=False)])
            parts: list[Answer] = [part for part in asked if part is not None]
            if len(parts) == count:
                found = joined_emt(list(zip(places, parts, strict=True)))
        if found is None:
            from vsgdesign.report.explore.live import emt_answer

            found = emt_answer(study, self.ready, state, stale)
        return None if found is None else self._coloured(found)

    def _with_changes(self, changes: dict[str, Any]) -> Study:
        from vsgdesign.report.explore.fields import changed_study

        if not changes:
            return self.study
        key = json.dumps(changes, sort_keys=True)
        with self._lock:
            if key in self._changed:
                self._changed.move_to_end(key)
                return self._changed[key]
        found = changed_study(self.study, changes)
        with self._lock:
            self._changed[key] = found
            while len(self._changed) > KEPT:
                self._changed.popitem(last=False)
        return found

    def colour(self, name: str) -> str:
        """The colour of a controller."""
        return self._colours.get(name, OWN_COLOUR)

    def _coloured(self, answer: Answer) -> Answer:
        rows = [row | {"colour": self.colour(row["name"])} for row in answer.header["controllers"]]
        return Answer({**answer.header, "controllers": rows}, answer.arrays)


def _emt_of(
    study: Study,
    tables: Mapping[str, GainTable],
    network: NetworkWeights | None,
    structures: Sequence[Structure],
) -> Callable[[tuple[State, Collection[int]]], Answer | None]:
    """EMT of some of the shown controllers in states that were read before, for a process of its own. It has to be told
    of the structures that were registered here."""
    from vsgdesign.equations.structures import STRUCTURES

    if sys.platform != "win32":
        os.nice(5)  # the linear answer and the browser go first: they need less time
    for structure in structures:
        STRUCTURES.register(structure)
    ready = Ready(tables=tables, network=network)
    session = Session(study, ready)

    def answer(question: tuple[State, Collection[int]]) -> Answer | None:
        from vsgdesign.report.explore.live import emt_answer

        state, places = question
        return emt_answer(session.study_of(state), ready, state, never, places)

    return answer


def start_of(text: str, study: Study) -> dict[str, Any]:
    """The state in a link of the page, or in the part of it after #: what differs from the study's own state.

    Raises StateError.
    """
    from urllib.parse import unquote

    part = unquote(text.partition("#")[2] or text)
    try:
        found = json.loads(part)
    except (ValueError, RecursionError) as error:
        raise _no_state(text, str(error)) from None
    if not isinstance(found, dict):
        raise _no_state(text, "it is no object")
    return defaults(study) | found


def _no_state(text: str, why: str) -> StateError:
    shown = text if len(text) <= 60 else text[:57] + "..."
    words = f"{shown} is not the state of a link ({why}). Copy the link of the page, or its part after #."
    return StateError([{"field": "--state", "value": shown, "limit": "", "unit": "", "text": words}])


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#777777")
"""As in the figures of the report (:data:`vsgdesign.report.drawing.style.COLOURS`), without the black of the text."""


def colour_of(index: int) -> str:
    """The colour of a controller by its place in the study."""
    return COLOURS[index % len(COLOURS)]


OWN_COLOUR = "#000000"
"""Of gains that the user gives by hand."""


def session_from(study: Study, ready: Ready, start: Mapping[str, Any] | str | None = None, **told: Any) -> Session:
    """A session that begins with a state: what differs from that of the study, or a link of the page. ``told`` is what
    else a session is told. Raises StudyError for a wrong state."""
    try:
        begins = start_of(start, study) if isinstance(start, str) else start
        return Session(study, ready, start=begins, **told)
    except StateError as error:
        faults = [Fault(str(one["field"]), "", one["text"].rstrip(".")) for one in error.faults]
        raise StudyError("--state" if isinstance(start, str) else "the state", faults) from None
