"""How long work says where it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with what is being done and the share done, 0 to 1; may raise to stop the work."""


def silent(_what: str, _share: float) -> None:
    """No progress is wanted."""
