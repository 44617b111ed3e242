"""Calls of the restricted language, of what is known by then: the function and the values of its arguments."""

from __future__ import annotations

import ast
import functools
import inspect
import types
from collections.abc import Sequence
from typing import Any

import numpy as np

from vsgdesign.codegen.body import Body
from vsgdesign.codegen.expressions import (
    ADVANCED,
    COUNT,
    NUMBERS,
    REAL,
    Argument,
    Evaluate,
    Expression,
    Field,
    Function,
    Invocation,
    Number,
    Operation,
    Parameter,
    Variable,
    alike,
    as_real,
    kind_of,
    operation,
)
from vsgdesign.codegen.language import FUNCTIONS, instead_of, integrates
from vsgdesign.codegen.records import SCALARS, Changed, Record, is_record, known, leaves

_signature = functools.cache(inspect.signature)


class Calls(Body):
    """The calls of one function: their values, and the statements that they leave."""

    def called(
        self, node: ast.Call, callee: Any, given: list[Any], named: dict[str, Any], wanted: tuple[str, ...]
    ) -> Any:
        """A call's value; ``wanted`` are the names of its results, if they get any."""
        if isinstance(callee, types.FunctionType) and integrates(callee):
            return self.advance(node, self.bound(node, callee, given, named))
        if callee is np.where:
            condition, one, other = given
            return self.chosen(self.scalar(condition, node), one, other, node)
        if callee is np.clip:
            value, low, high = (self.scalar(item, node) for item in given)
            return operation("min", *alike(operation("max", *alike(value, low)), high))
        if callee is len or callee is np.searchsorted:
            return self.of_numbers(node, callee, given, named)
        if isinstance(callee, np.ufunc) and callee in FUNCTIONS and not named:
            values = [self.scalar(item, node) for item in given]
            alone = callee not in (np.maximum, np.minimum)
            return operation(FUNCTIONS[callee], *(map(as_real, values) if alone else alike(*values)))
        if is_record(callee):
            return self.construct(node, callee, given, named)
        if isinstance(callee, Changed):
            if given:
                raise self.source.refuse(node.lineno, ast.unparse(node), "Give the new fields by name.")
            return self.construct(node, callee.record.cls, given, callee.record.values | named)
        if isinstance(callee, types.FunctionType):
            return self.invoke(node, callee, self.bound(node, callee, given, named), wanted)
        shown = ast.unparse(node.func)
        raise self.source.refuse(node.lineno, f"a call of {shown}", instead_of(shown))

    def of_numbers(self, node: ast.Call, callee: Any, given: list[Any], named: dict[str, Any]) -> Expression:
        """How many numbers are in a row, or how many of them are not above a value."""
        row = given[0] if given else None
        if isinstance(row, SCALARS) and kind_of(row) == NUMBERS:
            if callee is len:
                return operation("length", row)
            if len(given) == 2 and named == {"side": "right"}:
                return operation("search", row, self.scalar(given[1], node))
        raise self.source.refuse(
            node.lineno, ast.unparse(node), 'Write len(row) or np.searchsorted(row, value, side="right") of a row.'
        )

    def construct(self, node: ast.Call, cls: Any, given: list[Any], named: dict[str, Any]) -> Record:
        """A NamedTuple of its fields by position and name."""
        values = dict(zip(cls._fields, given, strict=False)) | named
        for name, default in cls._field_defaults.items():
            values.setdefault(name, known(default))
        missing = [name for name in cls._fields if name not in values]
        if missing or len(given) > len(cls._fields) or set(values) - set(cls._fields):
            what = f"{cls.__name__} without {', '.join(missing)}" if missing else f"the fields of {cls.__name__}"
            raise self.source.refuse(node.lineno, what, f"Give {', '.join(cls._fields)}.")
        for name in cls._fields:
            if not self.library.kinds.takes(cls, name, values[name]):
                raise self.source.refuse(
                    node.lineno, f"{name} of {cls.__name__} is of another kind", "Give it what its class says."
                )
        chosen = {name: isinstance(values[name], Record) and values[name].choice is not None for name in cls._fields}
        return Record(cls, {name: self.held(name, values[name]) if chosen[name] else values[name] for name in chosen})

    def bound(self, node: ast.Call, callee: Any, given: list[Any], named: dict[str, Any]) -> dict[str, Any]:
        try:
            bound = _signature(callee).bind(*given, **named)
        except TypeError as error:
            raise self.source.refuse(node.lineno, f"{callee.__name__}: {error}", "Give its arguments.") from error
        bound.apply_defaults()
        return {name: known(value) for name, value in bound.arguments.items()}

    def advance(self, node: ast.Call, bound: dict[str, Any]) -> Expression:
        """A move of an integrator: it must be a state as it came in, for its compensated sum is kept beside it."""
        x, dx = (self.scalar(value, node) for value in bound.values())
        came = self.origin.get(x.name, x) if isinstance(x, Variable) else x
        if isinstance(came, Variable) and came.name in self.scalars:
            self.lost.setdefault(came.name, [])
        elif isinstance(came, Field) and came.record in self.records:
            paths = self.lost.setdefault(came.record, [])
            if came.path in paths:
                raise self.source.refuse(node.lineno, f"{came.path} is advanced twice", "Advance it once.")
            paths.append(came.path)
        else:
            raise self.source.refuse(
                node.lineno, "an integrator that is not as it came in", "Advance the argument or the state's field."
            )
        self.advances += 1
        return Operation(ADVANCED, (came, dx))

    def invoke(self, node: ast.Call, callee: Any, bound: dict[str, Any], wanted: tuple[str, ...]) -> Any:
        fixed = {
            name: value.value if isinstance(value, Number) else value
            for name, value in bound.items()
            if not isinstance(value, (*SCALARS, Record))
            or (isinstance(value, Number) and isinstance(value.value, bool))
        }
        if any(isinstance(value, tuple) and not is_record(type(value)) for value in fixed.values()):
            raise self.source.refuse(node.lineno, "a tuple as an argument", "Give a NamedTuple, or each number.")
        function = self.library.read(callee, fixed)
        nothing = {name for name, value in bound.items() if isinstance(value, Record) and not leaves(value)}
        names = [name for name in bound if name not in fixed and name not in nothing]
        arguments: list[Argument] = []
        for parameter, name in zip(function.parameters, names, strict=True):
            value = bound[name]
            if isinstance(parameter.kind, str):
                arguments.append(self.given(parameter, self.scalar(value, node), node))
            elif isinstance(value, Record) and value.cls is parameter.kind:
                arguments.append(self.record(value, name))
            else:
                raise self.source.refuse(
                    node.lineno, f"argument {name} of {callee.__name__}", f"Give a {parameter.kind.__name__}."
                )
        self.keep_lost(node, function, [bound[name] for name in names])
        if function.result is not None:
            return Invocation(function, tuple(arguments))
        if wanted == ("",):  # the function returns what this one returns
            targets = function.results
        elif len(wanted) == len(function.outputs):
            targets = tuple(
                output.name.removesuffix("_out") if name == "_" else name
                for name, output in zip(wanted, function.outputs, strict=True)
            )
        else:
            targets = function.results
        own = tuple(self.name(name) for name in targets)
        self.body.append(Evaluate(function, tuple(arguments), own))
        made: list[Any] = []
        for name, output in zip(own, function.outputs, strict=True):
            if isinstance(output.kind, str):
                made.append(Variable(name, output.kind))
            else:
                made.append(self.library.kinds.at(output.kind, name, given=False))
        several = len(made) > 1 or isinstance(function.outputs[0].kind, str)
        return tuple(made) if several else made[0]

    def given(self, parameter: Parameter, value: Expression, node: ast.Call) -> Expression:
        """A value as an argument of its kind."""
        kind, wanted = kind_of(value), parameter.kind
        if wanted == REAL and kind == COUNT:
            return as_real(value)
        if kind != wanted and (COUNT in (kind, wanted) or NUMBERS in (kind, wanted)):
            raise self.source.refuse(node.lineno, f"argument {parameter.name} is no {wanted}", "Give one.")
        return value

    def keep_lost(self, node: ast.Call, function: Function, values: list[Any]) -> None:
        """What the callee keeps compensated sums of belongs to arguments of this function, too."""
        for parameter, value in zip(function.parameters, values, strict=True):
            if parameter.name not in function.lost:
                continue
            self.advances += 1
            came = self.origin.get(value.name, value) if isinstance(value, Variable) else value
            if isinstance(came, Record) and came.given:
                paths = self.lost.setdefault(came.home, [])
                prefix = f"{came.path}." if came.path else ""
                new: Sequence[str] = [f"{prefix}{path}" for path in function.lost[parameter.name]]
            elif isinstance(came, Field) and came.record in self.records:
                paths, new = self.lost.setdefault(came.record, []), (came.path,)
            elif isinstance(came, Variable) and came.name in self.scalars:
                paths, new = self.lost.setdefault(came.name, []), ()
            else:
                raise self.source.refuse(
                    node.lineno,
                    f"{parameter.name} of {function.name} is an integrator that is not as it came in",
                    "Give it the argument or the state's field.",
                )
            for path in new:
                if path in paths:
                    raise self.source.refuse(node.lineno, f"{path} is advanced twice", "Advance it once.")
                paths.append(path)
