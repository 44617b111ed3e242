"""Compiles the plain functions of ``equations`` with Numba, without a decorator in their source.

A function is rebuilt with every function of this project that it names replaced by its compiled twin, so the
text that Python and CasADi run is the text that LLVM gets.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba import types
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, register_model, typeof_impl, unbox
from numba.extending import models as data_models

from vsgdesign.equations.limiters import LimiterLaw
from vsgdesign.simulation.observing import ObserverLaw, pack, unpack

_PACKAGE = Path(__file__).resolve().parent.parent
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}, "nogil": True}
_INNER: dict[str, Any] = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Left to itself the compiler keeps the larger stages of the controller as calls: that costs a fifth of the speed."""

_ROOMS = ("equations", "simulation")

Law = LimiterLaw | ObserverLaw
"""Functions by name that a loop is compiled with."""


def _parts_of(kind: Any) -> list[Any] | None:
    """The types of a record's fields; None for a number."""
    return list(kind) if isinstance(kind, types.BaseTuple) else None  # type: ignore[call-overload]


@intrinsic
def _unpack(_context: Any, values: Any, like: Any) -> Any:
    """:func:`vsgdesign.simulation.observing.unpack`: one load for each number, whatever their count."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, given[0]).data
        place = itertools.count()

        def built(kind: Any) -> Any:
            parts = _parts_of(kind)
            if parts is not None:
                return context.make_tuple(builder, kind, [built(one) for one in parts])
            return builder.load(builder.gep(data, [context.get_constant(types.intp, next(place))]))

        return built(signature.return_type)

    return like(values, like), code


@intrinsic
def _pack(_context: Any, values: Any, record: Any) -> Any:
    """:func:`vsgdesign.simulation.observing.pack`: one store for each number."""

    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, given[0]).data
        place = itertools.count()

        def stored(kind: Any, value: Any) -> None:
            parts = _parts_of(kind)
            if parts is not None:
                for k, one in enumerate(parts):
                    stored(one, builder.extract_value(value, k))
                return
            number = context.cast(builder, value, kind, types.float64)
            builder.store(number, builder.gep(data, [context.get_constant(types.intp, next(place))]))

        stored(signature.args[1], given[1])
        return context.get_dummy_value()

    return types.none(values, record), code


_INTRINSICS: dict[Any, Any] = {pack: _pack, unpack: _unpack}
"""What compiled code has instead of functions that are plain loops in Python."""


@functools.cache
def compile_function(
    function: FunctionType, outermost: bool = False, cache: bool = False, **replaced: Any
) -> Callable[..., Any]:
    """The function, and every function of this package or of its own module that it calls, compiled for speed.

    ``outermost`` is the loop itself, into which everything else is inlined: it alone can be called from Python, because
    a wrapper for each of the others would take half of the compiler's time. ``cache=True`` keeps the machine code on
    disk; only for the outermost function, through :func:`source_stamp`, so that a change anywhere in the compiled
    sources makes it stale. ``replaced``: what names that the function takes from its module stand for instead.
    """
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        value = names.get(name)
        if isinstance(value, FunctionType) and _is_ours(value, function):
            names[name] = _INTRINSICS.get(value) or compile_function(value)
    names |= replaced
    rebuilt = FunctionType(function.__code__, names, function.__name__, function.__defaults__, function.__closure__)
    rebuilt.__module__ = function.__module__
    rebuilt.__qualname__ = function.__qualname__
    return numba.njit(cache=cache, **({} if outermost else _INNER), **_OPTIONS)(rebuilt)


def _is_ours(value: FunctionType, caller: FunctionType) -> bool:
    return value.__module__.startswith("vsgdesign.") or value.__module__ == caller.__module__


def is_packaged(functions: Iterable[FunctionType]) -> bool:
    """Whether functions come with the package.

    Machine code of others is not kept on disk: the compiler's index would name their module, and a process that cannot
    import it could not read the index, nor anything else that is kept there.
    """
    return all(function.__module__.startswith("vsgdesign.") for function in functions)


class CompiledLaw:
    """The functions of a law, compiled: what compiled code is given for a :class:`LimiterLaw` or an
    :class:`vsgdesign.simulation.observing.ObserverLaw`.

    To the compiler this is a type without a value: which functions are meant is known when the code is compiled, so
    that it can be kept on disk. (A tuple of functions would carry their addresses, which change from run to run.)
    """

    def __init__(self, law: Law) -> None:
        self.law = law
        self.functions = {name: compile_function(function) for name, function in law._asdict().items()}


@functools.cache
def compiled_law(law: Law) -> CompiledLaw:
    """The law's twin for compiled code."""
    return CompiledLaw(law)


class _LawType(types.Dummy):
    """Numba's type of one :class:`CompiledLaw`."""

    def __init__(self, compiled: CompiledLaw) -> None:
        self.compiled = compiled
        names = ", ".join(f"{function.__module__}.{function.__qualname__}" for function in compiled.law)
        super().__init__(f"CompiledLaw({names})")

    @property
    def key(self) -> Law:
        return self.compiled.law


register_model(_LawType)(data_models.OpaqueModel)


@typeof_impl.register(CompiledLaw)
def _type_of_law(value: CompiledLaw, context: Any) -> _LawType:  # noqa: ARG001
    return _LawType(value)


@infer_getattr
class _LawFunctions(AttributeTemplate):
    key = _LawType

    def generic_resolve(self, law: _LawType, name: str) -> Any:
        return types.Dispatcher(law.compiled.functions[name]) if name in law.compiled.functions else None


@lower_getattr_generic(_LawType)
def _function_of_law(context: Any, *_: Any) -> Any:
    return context.get_dummy_value()


@unbox(_LawType)
def _unbox_law(_type: Any, _value: Any, c: Any) -> NativeValue:
    return NativeValue(c.context.get_dummy_value())


@functools.cache
def source_stamp(*functions: FunctionType) -> int:
    """A hash of every source file whose functions are compiled, and of the files of these functions.

    Numba's disk cache looks at one file's date; a compiled loop is made of many files. A closure over this
    number is part of the cache key.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for room in _ROOMS:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(path.read_bytes())
    digest.update((_PACKAGE / "frames.py").read_bytes())
    for function in functions:
        digest.update(f"{function.__module__}.{function.__qualname__}".encode())
        digest.update(Path(function.__code__.co_filename).read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")
