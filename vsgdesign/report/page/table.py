"""A table as texts ready to be set, and the units of gains."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Table:
    """A table: head, rows of texts (as long as the head), notes below. ``texts`` columns are set flush left."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int = 1
    groups: tuple[tuple[str, int], ...] = ()
    """A row above the head: (label, how many columns)."""
    notes: tuple[str, ...] = ()
    flagged: frozenset[int] = field(default_factory=frozenset)
    """Rows that deserve attention."""
    links: tuple[str, ...] = ()
    """Where the first cell of each row leads, relative to the page; empty: no row has a link."""


GAIN_UNITS = {
    "K_ip": "rad/(s²·W)",
    "D_p": "W·s/rad",
    "K_iq": "V/(s·var)",
    "D_q": "var/V",
    "K_pq": "rad/(s²·var)",
    "K_qp": "V/(s·W)",
    "k_P": "rad/(s·W)",
    "k_Q": "rad/(s·var)",
}
"""Units of the power loops' gains by name."""
