"""What the hints of an equation say of a number, beside Any for a real one: counts, and rows of constants.

Python runs counts as ``int``. In C they are ``uint32_t``, and in machine code whole numbers among the others.
"""

from __future__ import annotations

from typing import Annotated, Any

Count = Annotated[int, "count"]
"""A whole number from 0 to 2^32 − 1. Counts are compared, added, and joined bit by bit (``&``, ``\\|``). Beside a real
number a count becomes one."""

Numbers = Annotated[tuple[float, ...], "numbers"]
"""A row of constants: ``row[at]``, ``len(row)``, ``np.searchsorted(row, value, side="right")``."""

Integrated = Annotated[Any, "integrated"]
"""What a function returns that moves an integrator by one step: ``x`` after its change ``dx``. A target may replace the
function by a compensated sum."""

WHOLE = 0xFFFFFFFF
"""The largest count. A counter wraps behind it: the ticks from one reading to a later one are (later − one) & WHOLE."""
