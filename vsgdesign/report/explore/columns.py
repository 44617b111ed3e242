"""Numbers of the cells of a lattice, packed for a file: columns that are the same for all cells are one number, equal
columns are kept once, and neighbours are predicted from each other, so that little is left to deflate.

``page/columns.js`` reads it back. Numbers that a simulation begins with keep all their bits; figures keep
:data:`BITS` of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

BITS = {"figure": 17, "shape": 11}
"""Bits of the mantissa of what is rounded, by its kind: 4e-6 of a figure, which is more than any digit that is shown,
and 2e-4 of what is only drawn or is a start of a refinement."""
SAME, EXACT, FIGURE, SHAPE, WHOLE = "s", "e", "f", "d", "w"
"""Kinds of columns, a letter each."""


@dataclass
class Columns:
    """Columns of numbers, one number for each cell. Cells are in rows of ``width``."""

    count: int
    width: int
    kinds: list[str] = field(default_factory=list)
    _known: dict[tuple[str, bytes], int] = field(default_factory=dict)
    _values: list[NDArray[Any]] = field(default_factory=list)

    def exact(self, values: ArrayLike) -> int:
        """The number of a column of which every bit is kept."""
        return self._add(EXACT, np.ascontiguousarray(values, dtype="<f8"))

    def figure(self, values: ArrayLike) -> int:
        """The number of a column of figures. What is not finite stays; None is NaN."""
        return self._add(FIGURE, rounded(np.asarray(values, dtype=float), BITS["figure"]))

    def shape(self, values: ArrayLike) -> int:
        """The number of a column of what is drawn."""
        return self._add(SHAPE, rounded(np.asarray(values, dtype=float), BITS["shape"]))

    def whole(self, values: ArrayLike) -> int:
        """The number of a column of whole numbers below 2^24."""
        return self._add(WHOLE, np.asarray(values, dtype="<u4"))

    def _add(self, kind: str, values: NDArray[Any]) -> int:
        if values.shape != (self.count,):
            raise ValueError(f"values = {values.shape}: a column has {self.count} numbers.")
        bits = values.view(np.uint64 if kind == EXACT else np.uint32)
        if (bits == bits[0]).all():
            kind, values = SAME, np.array([values[0]], dtype="<f8")
        key = kind, values.tobytes()
        if key not in self._known:
            self._known[key] = len(self.kinds)
            self.kinds.append(kind)
            self._values.append(values)
        return self._known[key]

    def document(self) -> dict[str, Any]:
        """What is needed to read :meth:`packed`."""
        return {
            "kinds": "".join(self.kinds),
            "count": self.count,
            "width": self.width,
            "dropped": _DROPPED,
        }

    def packed(self) -> bytes:
        """All columns: numbers that are the same, then the bytes of every other one, byte by byte of its numbers."""
        listed = list(zip(self.kinds, self._values, strict=True))
        parts = [np.array([values[0] for kind, values in listed if kind == SAME], dtype="<f8").tobytes()]
        for kind in (EXACT, FIGURE, SHAPE, WHOLE):
            for own, values in listed:
                if own == kind:
                    parts += self._planes(kind, values)
        return b"".join(parts)

    def _planes(self, kind: str, values: NDArray[Any]) -> list[bytes]:
        words = values.view("<u4").astype(np.uint32)
        if kind == EXACT:  # the lower half of a number is noise: it is kept as it is
            low, high = words[0::2], words[1::2]
            return [*_bytes_of(low, 4), *_bytes_of(self._left(high, 32), 4)]
        return _bytes_of(self._left(words >> np.uint32(_DROPPED[kind]), 8 * _PLANES[kind]), _PLANES[kind])

    def _left(self, words: NDArray[np.uint32], size: int) -> NDArray[np.uint32]:
        """What three neighbours leave of whole numbers of ``size`` bits, in the order 0, −1, 1, −2, …"""
        found = words.copy()
        for lag, sign in ((1, 1), (self.width, 1), (self.width + 1, -1)):
            if lag < len(words):
                found[lag:] = found[lag:] - words[:-lag] if sign > 0 else found[lag:] + words[:-lag]
        moved = found << np.uint32(32 - size)
        signs = (moved.view(np.int32) >> 31).view(np.uint32)
        return (((moved >> np.uint32(32 - size)) << np.uint32(1)) ^ signs) & np.uint32(2**size - 1)


_PLANES = {FIGURE: 4, SHAPE: 3, WHOLE: 3}
"""Bytes of a number."""
_DROPPED = {FIGURE: 23 - BITS["figure"], SHAPE: 23 - BITS["shape"], WHOLE: 0}
"""Bits that are zero."""


def _bytes_of(words: NDArray[np.uint32], planes: int) -> list[bytes]:
    """The first bytes of all numbers, then the second ones, and so on."""
    return [((words >> np.uint32(8 * k)) & np.uint32(0xFF)).astype(np.uint8).tobytes() for k in range(planes)]


def rounded(values: NDArray[Any], bits: int) -> NDArray[np.float32]:
    """Values as float32 with so many bits of the mantissa, to the nearest; what is not finite stays."""
    found = np.ascontiguousarray(values, dtype="<f4")
    drop = 23 - bits
    words = found.view(np.uint32)
    kept = ((words + np.uint32(1 << (drop - 1))) & np.uint32(0xFFFFFFFF << drop & 0xFFFFFFFF)).view("<f4")
    return np.where(np.isnan(found), np.float32(np.nan), np.where(np.isfinite(found) & np.isfinite(kept), kept, found))
