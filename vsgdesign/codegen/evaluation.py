"""Expressions of the restricted language, from the syntax tree to values."""

from __future__ import annotations

import ast
import inspect
import types
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from vsgdesign.codegen.calls import Calls
from vsgdesign.codegen.expressions import (
    BITS,
    COUNT,
    NUMBERS,
    Expression,
    Number,
    Variable,
    advances,
    alike,
    is_flag,
    kind_of,
    operation,
)
from vsgdesign.codegen.language import COMPARISONS, OPERATORS, REFUSED, UntranslatableError, instead_of
from vsgdesign.codegen.records import SCALARS, Changed, Record, is_record, known


@dataclass(frozen=True)
class Unbound:
    """A name that only one branch of an ``if`` has bound."""

    line: int


class Evaluation(Calls):
    """The expressions of one function: their values. Calls leave statements."""

    def value(self, node: ast.expr, environment: dict[str, Any], whole: bool = False) -> Any:
        """An expression's value; ``whole`` where it is all that is assigned or returned."""
        match node:
            case ast.Constant(value=bool() | int() | float() as number):
                return Number(number)
            case ast.Constant(value=other):
                return other
            case ast.Name(id=name):
                return self.named(name, node, environment)
            case ast.Attribute(value=inner, attr=name):
                return self.attribute(self.value(inner, environment), name, node)
            case ast.BinOp(left=left, op=op, right=right):
                return self.arithmetic(node, op, left, right, environment)
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
            case ast.Subscript(value=inner, slice=place):
                found, index = self.value(inner, environment), getattr(place, "value", None)
                if isinstance(found, SCALARS) and kind_of(found) == NUMBERS:
                    return self.read(found, place, node, environment)
                if not isinstance(place, ast.Constant) or not isinstance(index, int):
                    raise self.refused(node)
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
        if name == "len":
            return len
        if name not in scope:
            raise self.source.refuse(node.lineno, f"{name} is no name of this project", instead_of(name))
        return known(scope[name], name)

    def attribute(self, base: Any, name: str, node: ast.expr) -> Any:
        if isinstance(base, Record):
            if name == "_replace":
                return Changed(base)
            if name not in base.values:
                raise self.source.refuse(node.lineno, f"{base.cls.__name__} has no field {name}", "Name a field.")
            return base.values[name]
        if isinstance(base, SCALARS) or not hasattr(base, name):
            raise self.source.refuse(node.lineno, ast.unparse(node), "Take fields of a NamedTuple.")
        return known(getattr(base, name), name if isinstance(base, types.ModuleType) else "")

    def arithmetic(
        self, node: ast.expr, op: ast.operator, left: ast.expr, right: ast.expr, environment: dict[str, Any]
    ) -> Expression:
        """A sum, difference, product or quotient, or counts bit by bit."""
        if isinstance(op, ast.BitAnd | ast.BitOr):
            if isinstance(op, ast.BitAnd) and isinstance(left, ast.BinOp) and isinstance(left.op, ast.Sub):
                a = self.difference(left, environment)
            else:
                a = self.scalar_of(left, environment)
            b = self.scalar_of(right, environment)
            if (kind_of(a), kind_of(b)) != (COUNT, COUNT):
                raise self.source.refuse(node.lineno, ast.unparse(node), "Write `and` and `or`, or give two counts.")
            return operation(BITS["&" if isinstance(op, ast.BitAnd) else "|"], a, b)
        if type(op) not in OPERATORS:
            raise self.refused(op, node)
        a, b = alike(*(self.number_of(side, environment) for side in (left, right)))
        if kind_of(a) == COUNT and isinstance(op, ast.Div):
            raise self.source.refuse(node.lineno, f"{ast.unparse(node)} of counts", "Multiply one by 1.0 first.")
        if kind_of(a) == COUNT and isinstance(op, ast.Sub) and not isinstance(b, Number):
            raise self.source.refuse(
                node.lineno, f"{ast.unparse(node)} may be below zero", "Write (a - b) & WHOLE, which wraps."
            )
        return operation(OPERATORS[type(op)], a, b)

    def difference(self, node: ast.BinOp, environment: dict[str, Any]) -> Expression:
        """The difference of two counts, which a mask around it brings back into 32 bits."""
        return operation("-", *alike(*(self.scalar_of(side, environment) for side in (node.left, node.right))))

    def read(self, row: Expression, place: ast.expr, node: ast.expr, environment: dict[str, Any]) -> Expression:
        """A number of a row."""
        at = self.scalar_of(place, environment)
        if kind_of(at) != COUNT:
            raise self.source.refuse(node.lineno, ast.unparse(node), "Give a count as its place.")
        return operation("read", row, at)

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
                pieces.append(operation(COMPARISONS[type(op)], *alike(self.scalar(a, node), self.scalar(b, node))))
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
        named, makes = {}, is_record(callee) or isinstance(callee, Changed)
        for keyword in keywords:
            # A record that a call makes for a field of another one has the field's name.
            self.wanted = (str(keyword.arg),) if makes else ()
            named[str(keyword.arg)] = self.value(keyword.value, environment, whole=makes)
        self.wanted = ()
        return self.called(node, callee, given, named, wanted)

    def refused(self, node: ast.AST, at: ast.AST | None = None) -> UntranslatableError:
        node = node.value if isinstance(node, ast.Expr) else node
        what, instead = REFUSED.get(type(node), ("", ""))
        line = getattr(at or node, "lineno", self.source.tree.lineno)
        if not what:
            what = ast.unparse(at or node).split("\n")[0]
            instead = "Write scalars, NamedTuples and tuples; assignments, if, + - * / and NumPy's functions."
        return self.source.refuse(line, what, instead)
