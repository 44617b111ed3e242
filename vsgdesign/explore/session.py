"""What the page asks: one study with its gain tables, ready, and an answer to every state of the page."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

from vsgdesign.artifacts.ready import Ready
from vsgdesign.explore import standin
from vsgdesign.explore.answer import Answer
from vsgdesign.explore.info import study_info
from vsgdesign.parameters.study import Study

KEPT = 16
"""Changed studies that are kept: one drags the grid much more often than one changes the study."""


class Session:
    """A study with its gain tables. Every method may be called from several threads at once."""

    def __init__(self, study: Study, ready: Ready, words: str = "") -> None:
        """``words`` says where the gain tables come from."""
        self.study, self.ready = study, ready
        self.words = words
        self._changed: OrderedDict[str, Study] = OrderedDict()
        self._lock = threading.Lock()
        self._info = study_info(study, ready)

    def info(self) -> dict[str, Any]:
        """Everything that the page needs to know of the study, in JSON's types."""
        return self._info

    def answer(self, kind: str, document: Mapping[str, Any], stale: Callable[[], bool]) -> Answer | None:
        """The answer of a kind, ``linear``, ``emt`` or ``map``, to a state of the page as the page sends it.

        None: a newer request made this one ``stale`` meanwhile. Raises StateError with every fault of the state.
        """
        state = standin.state_of(document, self.study)
        study = self.study
        if kind == "linear":
            return standin.linear_answer(study, self.ready, state)
        if kind == "map":
            return standin.map_answer(study, self.ready, state)
        return standin.emt_answer(study, self.ready, state, stale)

    def save(self, document: Mapping[str, Any]) -> dict[str, str]:
        """A name and the text of a study file for a state of the page. Raises StateError."""
        standin.state_of(document, self.study)
        return {"name": f"{self.study.name}-explored.toml", "toml": ""}
