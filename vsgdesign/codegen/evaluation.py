"""Expressions and calls of the restricted language, from the syntax tree to values."""

from __future__ import annotations

import ast
import inspect
import types
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.codegen.expressions import (
    ADVANCED,
    Argument,
    Build,
    Choose,
    Evaluate,
    Expression,
    Field,
    Function,
    Invocation,
    Let,
    Number,
    Operation,
    RecordName,
    Statement,
    Variable,
    advances,
    is_flag,
    operation,
)
from vsgdesign.codegen.language import COMPARISONS, FUNCTIONS, KEYWORDS, OPERATORS, REFUSED, instead_of
from vsgdesign.codegen.records import SCALARS, Record, is_record, known, leaves
from vsgdesign.codegen.source import Source, UntranslatableError
from vsgdesign.equations.integration import advanced

if TYPE_CHECKING:
    from vsgdesign.codegen.reader import Library


@dataclass(frozen=True)
class Unbound:
    """A name that only one branch of an ``if`` has bound."""

    line: int


def free_name(name: str, taken: set[str], suffix: str = "new") -> str:
    """The name, or one made from it that is free."""
    suffix = suffix.replace(" ", "_")
    wanted = f"{name}_" if name in KEYWORDS else name
    found, count = wanted, 1
    while found in taken:
        found = f"{wanted}_{suffix}" if count == 1 else f"{wanted}_{suffix}_{count}"
        count += 1
    return found


class Evaluation:
    """The expressions of one function: their values, and the statements that calls leave in ``body``."""

    def __init__(self, library: Library, source: Source, fixed: dict[str, Any]) -> None:
        self.library, self.source, self.fixed = library, source, fixed
        self.body: list[Statement] = []
        self.taken: set[str] = set()
        self.lost: dict[str, list[str]] = {}
        self.scalars: set[str] = set()
        self.records: set[str] = set()
        """Arguments, by kind."""
        self.flags: set[str] = set()
        """Arguments and locals that are true or false."""
        self.origin: dict[str, Expression] = {}
        """Locals that are a field or an argument under another name."""
        self.wanted: tuple[str, ...] = ()
        """Names of the targets of the assignment at hand."""
        self.advances = 0

    def held(self, name: str, value: Any) -> Any:
        """The value of a field under a name of its own, so that it is evaluated once."""
        if isinstance(value, Operation | Invocation):
            return self.let(name, value)
        if isinstance(value, Record) and not value.home:
            if value.choice is not None:
                condition, one, other = value.choice
                return self.choose(name, value.cls, self.record(one, name), condition, self.record(other, name))
            return Record(value.cls, {key: self.held(key, item) for key, item in value.values.items()}, label=name)
        return value

    def choose(
        self, name: str, cls: Any, one: RecordName, condition: Expression | None = None, other: RecordName | None = None
    ) -> Record:
        """A local record that is one of two others, or a copy of one."""
        own = self.name(name)
        self.body.append(Choose(own, cls, one, condition, other))
        return self.library.kinds.at(cls, own, given=False)

    def let(self, name: str, value: Expression) -> Variable:
        if not name.isascii():
            raise self.source.refuse(self.source.tree.lineno, f"the name {name}", "Write it in ASCII.")
        own = self.name(name)
        self.body.append(Let(own, value))
        if is_flag(value):
            self.flags.add(own)
        if isinstance(value, Field):
            self.origin[own] = value
        return Variable(own)

    def name(self, wanted: str) -> str:
        own = free_name(wanted, self.taken)
        self.taken.add(own)
        return own

    def value(self, node: ast.expr, environment: dict[str, Any], whole: bool = False) -> Any:
        """An expression's value; ``whole`` where it is all that is assigned or returned."""
        match node:
            case ast.Constant(value=bool() | int() | float() as number):
                return Number(number if isinstance(number, bool) else float(number))
            case ast.Constant(value=other):
                return other
            case ast.Name(id=name):
                return self.named(name, node, environment)
            case ast.Attribute(value=inner, attr=name):
                return self.attribute(self.value(inner, environment), name, node)
            case ast.BinOp(left=left, op=op, right=right):
                if type(op) not in OPERATORS:
                    raise self.refused(op, node)
                a, b = (self.number_of(side, environment) for side in (left, right))
                return operation(OPERATORS[type(op)], a, b)
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return operation("not", self.scalar_of(inner, environment))
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return operation("neg", self.number_of(inner, environment))
            case ast.UnaryOp():
                raise self.source.refuse(node.lineno, ast.unparse(node), "Leave the sign out.")
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self.comparison([left, *others], ops, node, environment)
            case ast.BoolOp(op=op, values=values):
                found = [self.scalar_of(value, environment) for value in values]
                result = found[0]
                for other in found[1:]:
                    result = operation("and" if isinstance(op, ast.And) else "or", result, other)
                return result
            case ast.IfExp(test=test, body=one, orelse=other):
                condition = self.scalar_of(test, environment)
                if isinstance(condition, Number):
                    return self.value(one if condition.value else other, environment)
                return self.chosen(condition, self.value(one, environment), self.value(other, environment), node)
            case ast.Tuple(elts=items):
                return tuple(self.items(items, environment))
            case ast.Subscript(value=inner, slice=ast.Constant(value=int() as index)):
                found = self.value(inner, environment)
                values = tuple(found.values.values()) if isinstance(found, Record) else found
                if not isinstance(values, tuple) or not -len(values) <= index < len(values):
                    raise self.source.refuse(node.lineno, ast.unparse(node), "Give the results names.")
                return values[index]
            case ast.Call(func=callee, args=args, keywords=keywords):
                return self.call(node, self.value(callee, environment), args, keywords, environment, whole)
        raise self.refused(node)

    def named(self, name: str, node: ast.expr, environment: dict[str, Any]) -> Any:
        function = self.source.function
        found = environment.get(name)
        if isinstance(found, Unbound):
            raise self.source.refuse(
                node.lineno, f"{name} is bound in one branch only (line {found.line})", "Bind it in both."
            )
        if name in environment:
            return found
        if name in function.__code__.co_varnames:
            raise self.source.refuse(node.lineno, f"{name} is not bound here", "Bind it before.")
        scope = {**function.__globals__, **inspect.getclosurevars(function).nonlocals}
        if name not in scope:
            raise self.source.refuse(node.lineno, f"{name} is no name of this project", instead_of(name))
        return known(scope[name], name)

    def attribute(self, base: Any, name: str, node: ast.expr) -> Any:
        if isinstance(base, Record):
            if name not in base.values:
                raise self.source.refuse(node.lineno, f"{base.cls.__name__} has no field {name}", "Name a field.")
            return base.values[name]
        if isinstance(base, SCALARS) or not hasattr(base, name):
            raise self.source.refuse(node.lineno, ast.unparse(node), "Take fields of a NamedTuple.")
        return known(getattr(base, name), name if isinstance(base, types.ModuleType) else "")

    def comparison(
        self, values: Sequence[ast.expr], ops: Sequence[ast.cmpop], node: ast.expr, environment: dict[str, Any]
    ) -> Expression:
        found = [self.value(value, environment) for value in values]
        if any(isinstance(value, SCALARS) and advances(value) for value in found[1:-1]):
            raise self.source.refuse(node.lineno, ast.unparse(node), "Give the integrator's new value a name first.")
        pieces = []
        for op, a, b in zip(ops, found, found[1:], strict=False):
            if isinstance(op, ast.Is | ast.IsNot | ast.Eq | ast.NotEq) and not (
                isinstance(a, SCALARS) and isinstance(b, SCALARS)
            ):  # of what is known: names, functions, None
                if isinstance(a, (*SCALARS, Record)) or isinstance(b, (*SCALARS, Record)):
                    raise self.source.refuse(node.lineno, ast.unparse(node), "Compare numbers.")
                same = a is b if isinstance(op, ast.Is | ast.IsNot) else a == b
                pieces.append(Number(bool(same) is isinstance(op, ast.Is | ast.Eq)))
            elif type(op) in COMPARISONS:
                pieces.append(operation(COMPARISONS[type(op)], self.scalar(a, node), self.scalar(b, node)))
            else:
                raise self.refused(op, node)
        result = pieces[0]
        for piece in pieces[1:]:
            result = operation("and", result, piece)
        return result

    def items(self, nodes: Sequence[ast.expr], environment: dict[str, Any]) -> list[Any]:
        found: list[Any] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                several = self.value(node.value, environment)
                several = tuple(several.values.values()) if isinstance(several, Record) else several
                if not isinstance(several, tuple):
                    raise self.source.refuse(node.lineno, ast.unparse(node), "Star a tuple or a NamedTuple.")
                found += several
            else:
                found.append(self.value(node, environment))
        return found

    def scalar_of(self, node: ast.expr, environment: dict[str, Any]) -> Expression:
        return self.scalar(self.value(node, environment), node)

    def number_of(self, node: ast.expr, environment: dict[str, Any]) -> Expression:
        """A value for arithmetic: 1 or 0 for what is true or false."""
        value = self.scalar_of(node, environment)
        flag = is_flag(value) or (isinstance(value, Variable) and value.name in self.flags)
        return operation("select", value, Number(1.0), Number(0.0)) if flag else value

    def scalar(self, value: Any, node: ast.expr) -> Expression:
        if isinstance(value, SCALARS):
            return value
        what = "a tuple" if isinstance(value, tuple) else ("a NamedTuple" if isinstance(value, Record) else repr(value))
        raise self.source.refuse(node.lineno, f"{ast.unparse(node)} is {what}", "Write a number there.")

    def chosen(self, condition: Expression, one: Any, other: Any, at: ast.AST) -> Any:
        if isinstance(one, SCALARS) and isinstance(other, SCALARS):
            return operation("select", condition, one, other)
        if isinstance(one, Record) and isinstance(other, Record) and one.cls is other.cls:
            pairs = {name: self.chosen(condition, one.values[name], other.values[name], at) for name in one.values}
            whole = (one.home or other.home) and len(pairs) > 1
            return Record(one.cls, pairs, choice=(condition, one, other) if whole else None)
        if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
            return tuple(self.chosen(condition, a, b, at) for a, b in zip(one, other, strict=True))
        if one is other:
            return one
        raise self.source.refuse(
            getattr(at, "lineno", 0), "branches of different kinds", "Give the same kind of value in both."
        )

    # Calls.

    def call(
        self,
        node: ast.Call,
        callee: Any,
        args: Sequence[ast.expr],
        keywords: Sequence[ast.keyword],
        environment: dict[str, Any],
        whole: bool,
    ) -> Any:
        wanted, self.wanted = (self.wanted if whole else ()), ()  # arguments come first, and are not the targets'
        given = self.items(args, environment)
        if any(keyword.arg is None for keyword in keywords):
            raise self.source.refuse(node.lineno, "** in a call", "Name every argument.")
        named = {}
        for keyword in keywords:
            # A record that a call makes for a field of another one has the field's name.
            self.wanted = (str(keyword.arg),) if is_record(callee) else ()
            named[str(keyword.arg)] = self.value(keyword.value, environment, whole=is_record(callee))
        self.wanted = ()
        if callee is advanced:
            return self.advance(node, self.bound(node, callee, given, named))
        if callee is np.where:
            condition, one, other = given
            return self.chosen(self.scalar(condition, node), one, other, node)
        if callee is np.clip:
            value, low, high = (self.scalar(item, node) for item in given)
            return operation("min", operation("max", value, low), high)
        if isinstance(callee, np.ufunc) and callee in FUNCTIONS and not named:
            return operation(FUNCTIONS[callee], *(self.scalar(item, node) for item in given))
        if is_record(callee):
            return self.construct(node, callee, given, named)
        if isinstance(callee, types.MethodType) and callee.__name__ == "_replace":
            raise self.source.refuse(node.lineno, "_replace", "Write the constructor with every field by name.")
        if isinstance(callee, types.FunctionType):
            return self.invoke(node, callee, self.bound(node, callee, given, named), wanted)
        shown = ast.unparse(node.func)
        raise self.source.refuse(node.lineno, f"a call of {shown}", instead_of(shown))

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
            bound = inspect.signature(callee).bind(*given, **named)
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
                arguments.append(self.scalar(value, node))
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
                made.append(Variable(name))
            else:
                made.append(self.library.kinds.at(output.kind, name, given=False))
        several = len(made) > 1 or isinstance(function.outputs[0].kind, str)
        return tuple(made) if several else made[0]

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

    def record(self, value: Record, name: str) -> RecordName:
        """A record in the target; it is built there where it has no name."""
        if not value.home:
            value.home = self.name(value.label or name)
            self.body.append(Build(value.home, value.cls, tuple(leaves(value))))
        return RecordName(value.home, value.path)

    def refused(self, node: ast.AST, at: ast.AST | None = None) -> UntranslatableError:
        node = node.value if isinstance(node, ast.Expr) else node
        what, instead = REFUSED.get(type(node), ("", ""))
        line = getattr(at or node, "lineno", self.source.tree.lineno)
        if not what:
            what = ast.unparse(at or node).split("\n")[0]
            instead = "Write scalars, NamedTuples and tuples; assignments, if, + - * / and NumPy's functions."
        return self.source.refuse(line, what, instead)
