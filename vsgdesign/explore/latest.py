"""Which request of a browser tab is the newest of its kind. An older one is not worth an answer."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

TABS = 256
"""Pairs of tab and kind that are remembered. Beyond this, the one that was silent longest is forgotten."""


class Latest:
    """The newest sequence number of every tab and kind. Tabs count on their own, or two would starve each other."""

    def __init__(self) -> None:
        self._newest: OrderedDict[tuple[str, str], int] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Number of pairs of tab and kind."""
        return len(self._newest)

    def arrived(self, tab: str, kind: str, seq: int) -> Callable[[], bool]:
        """Notes a request, and returns a function that says whether a newer one has arrived since."""
        key = tab, kind
        with self._lock:
            self._newest[key] = max(seq, self._newest.get(key, seq))
            self._newest.move_to_end(key)
            while len(self._newest) > TABS:
                self._newest.popitem(last=False)

        def stale() -> bool:
            with self._lock:
                return seq < self._newest.get(key, seq)

        return stale
