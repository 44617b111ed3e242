"""Names of the numbers of a record in a compiled loop."""

from __future__ import annotations

import typing
from typing import Any


def names_of(record: Any, prefix: str, kinds: dict[str, Any] | None = None) -> list[str]:
    """Inputs of a record, in the order of its fields. ``kinds``: records in fields whose hint says Any."""
    hints = typing.get_type_hints(record)
    found: list[str] = []
    for name in record._fields:
        inner = (kinds or {}).get(name, hints[name])
        path = f"{prefix}.{name}"
        found += names_of(inner, path) if hasattr(inner, "_fields") else [path]
    return found
