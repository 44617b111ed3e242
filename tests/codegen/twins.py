"""What a compiled loop must equal to the last bit: the functions themselves, run by Python one lane after the other."""

from __future__ import annotations

import math
import types
from typing import Any

from vsgdesign.codegen import vector_math


def _largest(a: float, b: float) -> float:
    return a if a >= b or a != a else b


def _smallest(a: float, b: float) -> float:
    return a if a <= b or a != a else b


PLAIN = types.SimpleNamespace(
    sqrt=math.sqrt,
    abs=abs,
    floor=lambda x: float(math.floor(x)),
    maximum=_largest,
    minimum=_smallest,
    clip=lambda x, low, high: _smallest(_largest(x, low), high),
    searchsorted=lambda row, x, side: sum(one <= x for one in row) if side == "right" else None,
    where=lambda condition, one, other: one if condition else other,
    sin=vector_math.sine,
    cos=vector_math.cosine,
    tan=vector_math.tangent,
    arctan2=vector_math.arctangent_2,
    hypot=vector_math.length,
    exp=vector_math.exponential,
    log=vector_math.logarithm,
    tanh=vector_math.hyperbolic_tangent,
    pi=math.pi,
)
"""In place of NumPy: the same functions of floats, with the plain sine and the like."""


def twin(value: Any, done: dict[Any, Any] | None = None) -> Any:
    """The same function, or NamedTuple of functions, with :data:`PLAIN` in place of NumPy in all that it calls."""
    done = {} if done is None else done
    if isinstance(value, tuple):
        return type(value)(*(twin(item, done) for item in value))
    if not isinstance(value, types.FunctionType) or not value.__module__.startswith(("vsgdesign", "tests")):
        return value
    if value not in done:
        scope = dict(value.__globals__) | ({"np": PLAIN} if "np" in value.__globals__ else {})
        done[value] = types.FunctionType(value.__code__, scope, value.__name__, value.__defaults__)
        for name, item in value.__globals__.items():
            if isinstance(item, types.FunctionType):
                scope[name] = twin(item, done)
    return done[value]
