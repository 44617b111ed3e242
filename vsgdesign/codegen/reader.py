"""Reads a function of the restricted language into expressions and statements, with everything known folded in.

The language: numbers, counts of 32 bits, rows of constants, NamedTuples (also by ``_replace``) and tuples; assignments,
``if`` and conditional expressions; the operators + − * / and comparisons, & and | of counts; NumPy's functions of
:data:`FUNCTIONS`; other functions of this project. Every name is bound once in the result: a name that Python binds
again is followed by ``_new``.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Mapping, Sequence
from typing import Any

from vsgdesign.codegen.body import free_name
from vsgdesign.codegen.evaluation import Evaluation, Unbound
from vsgdesign.codegen.expressions import (
    COUNT,
    FLAG,
    REAL,
    Build,
    Choose,
    Comment,
    Evaluate,
    Field,
    Function,
    Let,
    Number,
    Output,
    Parameter,
    RecordName,
    Statement,
    Variable,
    advances,
    kind_of,
    names_in,
    parts,
)
from vsgdesign.codegen.language import Source, UntranslatableError, documented_results, integrates, marked, source_of
from vsgdesign.codegen.records import SCALARS, Kinds, Record, is_record, known, leaves


class Library:
    """The functions that were read, each once for what was known of its arguments, callees first."""

    def __init__(
        self,
        names: Mapping[type, str] | None = None,
        kinds: Mapping[Any, Mapping[str, Any]] | None = None,
        prefix: str = "",
        macros: Mapping[str, str] | None = None,
    ) -> None:
        self.macros = dict(macros or {})
        self.names, self.kinds, self.prefix = dict(names or {}), Kinds(kinds or {}), prefix
        self.functions: list[Function] = []
        self._found: dict[Any, Function] = {}
        self._open: list[Any] = []
        self._kept: list[Any] = []
        """What is known by its identity: it must not go, and another take its place."""

    def read(self, function: Any, fixed: Mapping[str, Any] | None = None) -> Function:
        """The function with these arguments known. Raises UntranslatableError with file and line."""
        fixed = dict(fixed or {})
        if integrates(function):
            raise UntranslatableError(
                f"{function.__name__}: every target has its own. Give the functions that call it."
            )
        key = function, tuple(sorted((name, _identity(value)) for name, value in fixed.items()))
        if key not in self._found:
            source = source_of(function)
            if function in self._open:
                raise source.refuse(source.tree.lineno, "calls itself", "Write out the turns.")
            self._open.append(function)
            made = _Reader(self, source, fixed).function()
            self._open.pop()
            taken = {other.name for other in self.functions}
            if made.name in taken and not any(other is function for other, _ in self._found):
                made.name = f"{function.__module__.rpartition('.')[2]}_{made.name}"
            made.name = free_name(made.name, taken, "with other arguments")
            self.functions.append(made)
            self._found[key] = made
            self._kept.append(fixed)
        return self._found[key]

    def word(self, record: type) -> str:
        """What a NamedTuple is called: the name that was given, or its own in lower case behind the prefix."""
        if record in self.names:
            return self.names[record]
        own = re.sub(r"(?<!^)(?=[A-Z])", "_", record.__name__).lower()
        return own if own.startswith(self.prefix) else f"{self.prefix}{own}"


def _identity(value: Any) -> Any:
    return repr(value) if isinstance(value, bool | int | float | str) else f"{type(value).__name__} at {id(value)}"


class _Reader(Evaluation):
    """One function, from its syntax tree."""

    def __init__(self, library: Library, source: Source, fixed: dict[str, Any]) -> None:
        super().__init__(library, source, fixed)
        self.comments = dict(source.comments)
        self.comment_at = -1

    def function(self) -> Function:
        source = self.source
        names = list(inspect.signature(source.function).parameters)
        for name in self.fixed:
            if name not in names:
                raise source.refuse(source.tree.lineno, f'no argument "{name}" to fix', f"It has: {', '.join(names)}.")
        parameters, environment = [], {}
        for name in names:
            if name in self.fixed:
                environment[name] = known(self.fixed[name])
                continue
            if not name.isascii():
                raise source.refuse(source.tree.lineno, f"the name {name}", "Write it in ASCII.")
            own = free_name(name, self.taken)
            self.taken.add(own)
            kind = self.kind(name)
            if isinstance(kind, str):
                environment[name] = Variable(own, kind)
                (self.flags if kind == FLAG else self.scalars).add(own)
            else:
                environment[name] = self.library.kinds.at(kind, own)
                self.records.add(own)
                if not self.library.kinds.paths(kind):
                    continue  # nothing in the target
            parameters.append(Parameter(own, kind))
        found = self.block(source.tree.body, environment)
        if found is None:
            raise source.refuse(source.tree.lineno, "no return", "Return its results.")
        made = Function(source.function.__name__, source.doc, tuple(parameters), self.body)
        self.results(made, found)
        made.lost = {name: tuple(paths) for name, paths in self.lost.items()}
        _drop_unused(made)
        return made

    def kind(self, name: str) -> str | type:
        hint = self.source.hints.get(name, Any)
        if hint in (Any, float):
            return REAL
        if hint is bool:
            return FLAG
        if mark := marked(hint):
            return mark
        if is_record(hint):
            return hint
        raise self.source.refuse(
            self.source.tree.lineno,
            f"argument {name} of type {getattr(hint, '__name__', hint)}",
            "Write Any, bool, a count, numbers or a NamedTuple, or give its value in fixed.",
        )

    # Statements.

    def block(self, statements: Sequence[ast.stmt], environment: dict[str, Any]) -> Any:
        """Runs statements; what they return, or None."""
        for at, statement in enumerate(statements):
            match statement:
                case ast.Pass() | ast.Expr(value=ast.Constant()):
                    self.comments_until(statement.end_lineno)
                case ast.Assign(targets=[target], value=value):
                    self.assign(target, value, environment)
                case ast.AnnAssign(target=target, value=ast.expr() as value):
                    self.assign(target, value, environment)
                case ast.AugAssign(target=ast.Name() as target, op=op, value=value):
                    target.ctx, left = ast.Store(), ast.copy_location(ast.Name(target.id, ast.Load()), target)
                    self.assign(target, ast.copy_location(ast.BinOp(left, op, value), statement), environment)
                case ast.Return(value=ast.expr() as value):
                    self.comments_until(statement.end_lineno)
                    self.wanted = ("",)
                    found = self.value(value, environment, whole=True)
                    self.wanted = ()
                    return found
                case ast.If():
                    done, found = self.branch(statement, statements[at + 1 :], environment)
                    if done:
                        return found
                case _:
                    raise self.refused(statement)
        return None

    def branch(self, statement: ast.If, rest: Sequence[ast.stmt], environment: dict[str, Any]) -> tuple[bool, Any]:
        """An ``if``: folded where its condition is known, else both branches are evaluated and one is chosen."""
        self.comments_until(statement.test.end_lineno)
        condition = self.scalar(self.value(statement.test, environment), statement.test)
        if isinstance(condition, Number):
            left_out = statement.orelse if condition.value else statement.body
            self.forget_comments(statement, left_out)
            found = self.block(statement.body if condition.value else statement.orelse, environment)
            return found is not None, found
        condition = condition if isinstance(condition, Variable) else self.let("condition", condition)
        before, one, other = self.advances, dict(environment), dict(environment)
        first, second = self.block(statement.body, one), self.block(statement.orelse, other)
        returns = first is not None or second is not None
        if returns:  # an early return: what follows is the other branch
            first = self.block(rest, one) if first is None else first
            second = self.block(rest, other) if second is None else second
        if self.advances != before:
            raise self.source.refuse(
                statement.lineno,
                "an integrator that moves in one branch only",
                "Move it always, and choose its change with np.where.",
            )
        if returns:
            if first is None or second is None:
                raise self.source.refuse(statement.lineno, "a branch without a return", "Return in both.")
            return True, self.chosen(condition, first, second, statement)
        for name in dict.fromkeys([*one, *other]):
            if name not in one or name not in other:
                environment[name] = Unbound(statement.lineno)
            elif one[name] is not other[name] and one[name] != other[name]:
                self.bind(name, self.chosen(condition, one[name], other[name], statement), environment)
            else:
                environment[name] = one[name]
        return False, None

    def assign(self, target: ast.expr, value: ast.expr, environment: dict[str, Any]) -> None:
        self.comments_until(getattr(value, "end_lineno", None))
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        if not all(isinstance(name, ast.Name) for name in names):
            raise self.source.refuse(target.lineno, f"{ast.unparse(target)} =", "Bind plain names.")
        wanted = tuple(name.id for name in names if isinstance(name, ast.Name))
        self.wanted = wanted
        found = self.value(value, environment, whole=True)
        self.wanted = ()
        if not isinstance(target, ast.Tuple):
            self.bind(wanted[0], found, environment)
            return
        if not isinstance(found, tuple) or len(found) != len(wanted):
            count = len(found) if isinstance(found, tuple) else 1
            raise self.source.refuse(target.lineno, f"{count} values for {len(wanted)} names", "Name each value.")
        for name, item in zip(wanted, found, strict=True):
            self.bind(name, item, environment)

    def bind(self, name: str, value: Any, environment: dict[str, Any]) -> None:
        if isinstance(value, Number | Variable):
            environment[name] = value  # another name for it
        elif isinstance(value, SCALARS):
            environment[name] = self.let(name, value)
        elif isinstance(value, Record):
            environment[name] = self.held(name, value)
        elif isinstance(value, tuple) and not is_record(type(value)):
            environment[name] = tuple(self.held(f"{name}_{at}", item) for at, item in enumerate(value))
        else:
            environment[name] = value

    # Comments.

    def comments_until(self, line: int | None) -> None:
        for at in sorted(self.comments):
            if line is not None and at <= line:
                text = self.comments.pop(at)
                last = self.body[-1] if self.body else None
                if isinstance(last, Comment) and self.comment_at == at - 1:
                    self.body[-1] = Comment(f"{last.text} {text}")
                else:
                    self.body.append(Comment(text))
                self.comment_at = at

    def forget_comments(self, statement: ast.If, branch: Sequence[ast.stmt]) -> None:
        if not branch:
            return
        first = statement.test.end_lineno or statement.lineno
        if branch is statement.orelse:
            first = statement.body[-1].end_lineno or first
        for at in [at for at in self.comments if first < at <= (branch[-1].end_lineno or first)]:
            del self.comments[at]

    # Results.

    def results(self, made: Function, found: Any) -> None:
        if isinstance(found, SCALARS):
            made.result = found
            return
        items = found if isinstance(found, tuple) else (found,)
        last = self.body[-1] if self.body else None
        own = [item.name if isinstance(item, Variable) else self.whole_record(item) for item in items]
        if isinstance(last, Evaluate) and own == list(last.targets):
            # All that the last call gives is all that this function gives: it writes to the caller's places at once.
            self.taken -= set(last.targets)
            before = last.function.outputs
            names = tuple(self.name(output.name) for output in before)
            self.body[-1] = Evaluate(last.function, last.arguments, names, declare=False)
            made.outputs = tuple(Output(name, o.kind, (), o.empty) for name, o in zip(names, before, strict=True))
            return
        documented = documented_results(made.doc)
        if documented and len(documented) != len(items):
            line = self.source.tree.lineno
            raise self.source.refuse(
                line, f"{len(documented)} names for {len(items)} results", "Name each: Returns (a, b)."
            )
        outputs = []
        for at, item in enumerate(items):
            if isinstance(item, Record):
                name = documented[at] if documented else (item.label or item.home or self.library.word(item.cls))
                alone = [getattr(other, "cls", None) for other in items].count(item.cls) == 1
                values = tuple(leaves(self.settled(item, item.cls if alone else None, made)))
                outputs.append(Output(name, item.cls, values, empty=not values))
            else:
                value = self.scalar(item, self.source.tree.body[-1])  # type: ignore[arg-type]
                name = documented[at] if documented else self.python_name(at, len(items))
                if not (name.isidentifier() and name.isascii()):
                    raise self.source.refuse(
                        self.source.tree.lineno,
                        f"result {at + 1} of {len(items)} has no name",
                        "Write in its docstring: Returns (a, b), with a name for each.",
                    )
                kind = COUNT if kind_of(value) == COUNT else REAL
                outputs.append(Output(name, kind, (("", value),)))
        given = {parameter.name: parameter.kind for parameter in made.parameters}
        made.outputs = tuple(self.safe(output, outputs, given) for output in outputs)

    def settled(self, record: Record, own: Any, made: Function, path: str = "") -> Record:
        """The result with its records that are in memory now, and in another place then, as local copies. ``own`` is
        the class of an output whose fields may be their own places."""
        kinds = {parameter.name: parameter.kind for parameter in made.parameters}
        values: dict[str, Any] = {}
        for name, value in record.values.items():
            place = f"{path}{name}"
            if isinstance(value, Record) and not value.home:
                value = self.settled(value, own, made, f"{place}.")
            elif isinstance(value, Record) and value.home in self.records and leaves(value):
                stays = value.path == place and own is not None and kinds.get(value.home) is own
                value = value if stays else self.choose(name, value.cls, RecordName(value.home, value.path))
            values[name] = value
        return Record(record.cls, values, record.home, record.path, record.label, record.given)

    @staticmethod
    def whole_record(item: Any) -> str | None:
        """The name of a record that is not within another one."""
        return item.home if isinstance(item, Record) and not item.path else None

    def python_name(self, at: int, count: int) -> str:
        """The name that every return statement gives to a result; empty where it has none."""
        found = set()
        for statement in ast.walk(self.source.tree):
            if isinstance(statement, ast.Return) and isinstance(statement.value, ast.Tuple):
                items = statement.value.elts
                item = items[at] if len(items) == count else None
                found.add(item.id if isinstance(item, ast.Name) else "")
        return found.pop() if len(found) == 1 else ""

    def safe(self, output: Output, outputs: Sequence[Output], given: Mapping[str, str | type]) -> Output:
        """The output under a name that is free; what reads memory or moves an integrator is a local first, so that an
        output may be the place of an input. A field that stays what it was needs none: there it is its own place."""
        several = len(outputs) > 1 or len(output.values) > 1
        alone = [other.kind for other in outputs].count(output.kind) == 1
        values = []
        for path, value in output.values:
            kept = isinstance(value, Field) and value.path == path and given.get(value.record) is output.kind and alone
            reads = advances(value) or any(isinstance(p, Field) and p.record in self.records for p in parts(value))
            reads = reads and not kept
            local = path.replace(".", "_") or output.name
            values.append((path, self.let(local, value) if several and reads else value))
        name = self.name(output.name if output.name not in self.taken else f"{output.name}_out")
        return Output(name, output.kind, tuple(values), output.empty)


def _drop_unused(made: Function) -> None:
    """Leaves out locals that nothing reads, as folding may leave them."""
    read: set[str] = set()
    for value in [made.result, *(value for output in made.outputs for _, value in output.values)]:
        read |= names_in(value) if value is not None else set()
    kept: list[Statement] = []
    for statement in reversed(made.body):
        if isinstance(statement, Let):
            if statement.name not in read and not advances(statement.value):
                continue
            read |= names_in(statement.value)
        elif isinstance(statement, Build | Choose):
            if statement.name not in read:
                continue
            read |= statement.read
        elif isinstance(statement, Evaluate):
            if statement.declare and not read & set(statement.targets) and not statement.function.lost:
                continue
            for argument in statement.arguments:
                read |= names_in(argument)
        kept.append(statement)
    made.body = kept[::-1]
