"""Functions that leave the restricted language, each in one way. Nobody calls them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from tests.codegen.language import counted
from vsgdesign.equations.integration import advanced
from vsgdesign.equations.notation import Count, Numbers
from vsgdesign.equations.power_loops import References


def uses_while(x: Any) -> Any:
    while x > 1.0:
        x = x / 2.0
    return x


def uses_for(x: Any) -> Any:
    for _ in range(3):
        x = x / 2.0
    return x


def uses_try(x: Any) -> Any:
    try:
        return 1.0 / x
    except ZeroDivisionError:
        return 0.0


def uses_remainder(x: Any) -> Any:
    return x % 2.0


def uses_floor_division(x: Any) -> Any:
    return x // 2.0


def uses_power(x: Any) -> Any:
    return x**2


def uses_list(x: Any) -> Any:
    values = [x, x]
    return values[0]


def uses_comprehension(x: Any) -> Any:
    return sum(y for y in (x, x))


def uses_lambda(x: Any) -> Any:
    double = lambda y: 2.0 * y  # noqa: E731
    return double(x)


def uses_assert(x: Any) -> Any:
    assert x > 0.0
    return x


def uses_raise(x: Any) -> Any:
    if x > 0.0:
        raise ValueError("positive")
    return x


def uses_builtin(x: Any, y: Any) -> Any:
    return max(x, y)


def uses_math(x: Any) -> Any:
    return math.sqrt(x)


def uses_text(x: Any) -> Any:
    return x + "1"


def uses_walrus(x: Any) -> Any:
    return (y := 2.0 * x) + y


def uses_membership(x: Any) -> Any:
    return x in (1.0, 2.0)


def binds_in_one_branch(x: Any) -> Any:
    if x > 0.0:
        limit = 2.0 * x
    return limit  # pyright: ignore[reportPossiblyUnboundVariable]


PHASES = 3.0


def binds_late(x: Any) -> Any:
    y = PHASES * x  # noqa: F823  # pyright: ignore[reportUnboundVariable]
    PHASES = 2.0 * y
    return PHASES


def stores_in_a_field(refs: References) -> Any:
    refs.P_ref = 0.0  # type: ignore[misc]
    return refs.Q_ref


def without_names(x: Any) -> Any:
    return 2.0 * x, 3.0 * x


def without_a_return(x: Any) -> Any:
    y = 2.0 * x  # noqa: F841


def starred(*values: Any) -> Any:
    return values[0]


def of_a_text(name: str, x: Any) -> Any:
    return x if name == "a" else -x


def calls_itself(x: Any) -> Any:
    return calls_itself(x - 1.0)


def changes_no_field(refs: References) -> Any:
    return refs._replace(P=0.0)


def changes_by_place(refs: References) -> Any:
    return refs._replace(0.0)  # type: ignore


def advances_what_is_new(x: Any) -> Any:
    return advanced(2.0 * x, 1.0)


def advances_twice(refs: References) -> Any:
    """Returns (a, b)."""
    return advanced(refs.P_ref, 1.0), advanced(refs.P_ref, 2.0)


def advances_in_one_branch(x: Any, y: Any) -> Any:
    z = x
    if y > 0.0:
        z = advanced(x, y)
    return z


def generates(x: Any) -> Iterator[Any]:
    yield x


def unpacks_too_few(x: Any) -> Any:
    a, b = (x, x, x)  # pyright: ignore[reportAssignmentType]
    return a + b


def casts(x: Any) -> Any:
    return float(x) + np.float64(x)


def count_below_zero(later: Count, one: Count) -> Any:
    return later - one


def quotient_of_counts(a: Count, b: Count) -> Any:
    return a / b


def bits_of_numbers(x: Any, y: Any) -> Any:
    return x & y


def place_that_is_no_count(row: Numbers, x: Any) -> Any:
    return row[x]


def searches_otherwise(row: Numbers, x: Any) -> Any:
    return np.searchsorted(row, x, side="left")


def gives_a_number_for_a_count(x: Any, one: Count) -> Any:
    return counted(x) | one
