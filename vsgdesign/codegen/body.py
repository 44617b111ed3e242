"""What reading a function leaves: its names, its statements, and the values that they give."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING, Any

from vsgdesign.codegen.expressions import (
    Build,
    Choose,
    Expression,
    Field,
    Invocation,
    Let,
    Operation,
    RecordName,
    Statement,
    Variable,
    alike,
    is_flag,
    kind_of,
    operation,
)
from vsgdesign.codegen.language import KEYWORDS, Source
from vsgdesign.codegen.records import SCALARS, Record, leaves

if TYPE_CHECKING:
    from vsgdesign.codegen.reader import Library


def free_name(name: str, taken: set[str], suffix: str = "new") -> str:
    """The name, or one made from it that is free."""
    suffix = suffix.replace(" ", "_")
    wanted = f"{name}_" if name in KEYWORDS else name
    found, count = wanted, 1
    while found in taken:
        found = f"{wanted}_{suffix}" if count == 1 else f"{wanted}_{suffix}_{count}"
        count += 1
    return found


class Body:
    """The statements of one function in ``body``, and what is known of its names."""

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
        return Variable(own, kind_of(value))

    def name(self, wanted: str) -> str:
        own = free_name(wanted, self.taken)
        self.taken.add(own)
        return own

    def record(self, value: Record, name: str) -> RecordName:
        """A record in the target; it is built there where it has no name."""
        if not value.home:
            value.home = self.name(value.label or name)
            self.body.append(Build(value.home, value.cls, tuple(leaves(value))))
        return RecordName(value.home, value.path)

    def scalar(self, value: Any, node: ast.expr) -> Expression:
        if isinstance(value, SCALARS):
            return value
        what = "a tuple" if isinstance(value, tuple) else ("a NamedTuple" if isinstance(value, Record) else repr(value))
        raise self.source.refuse(node.lineno, f"{ast.unparse(node)} is {what}", "Write a number there.")

    def chosen(self, condition: Expression, one: Any, other: Any, at: ast.AST) -> Any:
        if isinstance(one, SCALARS) and isinstance(other, SCALARS):
            return operation("select", condition, *alike(one, other))
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
