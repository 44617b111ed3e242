"""Prints functions as C99 for either precision: ``vsg_real_t``, literals as ``VSG_C``, nothing promoted to double."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vsgdesign.codegen.comments import ascii_text, block_comment, field_groups
from vsgdesign.codegen.expressions import (
    ADVANCED,
    Argument,
    Build,
    Choose,
    Comment,
    Evaluate,
    Expression,
    Field,
    Function,
    Invocation,
    Let,
    Number,
    Operation,
    Output,
    RecordName,
    Statement,
    Variable,
    is_flag,
    names_in,
)
from vsgdesign.codegen.language import KEYWORDS
from vsgdesign.codegen.reader import Library
from vsgdesign.codegen.source import UntranslatableError

WIDTH = 120

_PRECEDENCE = {"select": 1, "or": 2, "and": 3, "==": 4, "!=": 4, "<": 5, ">": 5, "<=": 5, ">=": 5}
_PRECEDENCE |= {"+": 6, "-": 6, "*": 7, "/": 7, "neg": 8, "not": 8}
_ATOM = 9
_SYMBOLS = {"and": "&&", "or": "||"}
_LIBRARY = {"abs": "fabs"}
"""C's name of a function where it is another one; single precision has an f at its end."""

TYPES = """/* Single precision unless VSG_DOUBLE is defined, for every file alike. */
#ifdef VSG_DOUBLE
typedef double vsg_real_t;
#define VSG_C(x) (x)
#else
typedef float vsg_real_t;
#define VSG_C(x) (x##F)
#endif
"""

_MAX = """/* The larger of two; NaN where either is. */
static inline vsg_real_t vsg_max(vsg_real_t a, vsg_real_t b)
{
    return ((a >= b) || (a != a)) ? a : b;
}
"""
_MIN = """/* The smaller of two; NaN where either is. */
static inline vsg_real_t vsg_min(vsg_real_t a, vsg_real_t b)
{
    return ((a <= b) || (a != a)) ? a : b;
}
"""
_ADVANCED = """\
/* The integrator x after its change dx of one sample. In single precision T_s times a rate may be less than the
 * last digit of x: what a sum leaves out is kept in lost for the next one (Kahan). In double it is x + dx. */
static inline vsg_real_t vsg_advanced(vsg_real_t x, vsg_real_t dx, vsg_real_t *lost)
{
#ifdef VSG_DOUBLE
    *lost = VSG_C(0.0);
    return x + dx;
#else
    const vsg_real_t change = dx - *lost;
    const vsg_real_t sum = x + change;
    *lost = (sum - x) - change;
    return sum;
#endif
}
"""


@dataclass(frozen=True)
class CText:
    """What belongs into one header or into two: some structs may be public, ``functions`` need all of them."""

    structs: dict[str, str]
    """By name and in order: every NamedTuple and, of what is integrated, what rounding left out. They need TYPES."""
    constants: str
    """Macros of the mathematical functions and of named constants, and the small functions that replace operators."""
    functions: str
    """One static inline function for each that was read, callees first."""

    @property
    def text(self) -> str:
        """All of it, to be compiled by itself."""
        structs = "\n".join(self.structs.values())
        return f"#include <math.h>\n\n{TYPES}\n{structs}\n{self.constants}\n{self.functions}"

    def needed_by(self, records: Iterable[str]) -> list[str]:
        """These structs and those that they hold, in order."""
        wanted = set(records)
        for name in reversed(self.structs):
            if name in wanted:
                wanted |= {
                    other for other in self.structs if re.search(rf"^    {other} ", self.structs[name], re.MULTILINE)
                }
        return [name for name in self.structs if name in wanted]


def c_functions(
    functions: Iterable[Any],
    *,
    fixed: Mapping[str, Any] | None = None,
    names: Mapping[type, str] | None = None,
    kinds: Mapping[Any, Mapping[str, Any]] | None = None,
    prefix: str = "",
) -> CText:
    """C99 of functions of the restricted language, and of all that they call.

    ``fixed``: arguments by name whose values are known now, for each function that has them; branches on them fold
    away. ``names``: what a NamedTuple is called in C, ``gains`` for ``vsg_gains_t``; else its own name in lower case.
    ``kinds``: NamedTuples in fields whose hint says Any, where it is not that of the default. ``prefix``: what
    begins the names of records without such a name, and in capitals those of constants: ``field_`` for
    ``vsg_field_lock_in_t`` and ``VSG_FIELD_TURN``. Two headers of one folder then have no name in common.

    A function is ``vsg_`` and its name. Its arguments come in their order, then what compensated sums keep
    (``…_lost``), then its results, unless it has one scalar result, which is returned. An output may be the place of
    an input. Raises UntranslatableError with file, line and what to write instead.
    """
    library = Library(names, kinds, prefix)
    fixed = dict(fixed or {})
    unused = set(fixed)
    for function in functions:
        arguments = inspect.signature(function).parameters
        known = {name: value for name, value in fixed.items() if name in arguments}
        unused -= set(known)
        library.read(function, known)
    if unused:
        raise ValueError(f"fixed = {sorted(unused)}: no function given has such an argument.")
    return _Printer(library).all()


class _Printer:
    def __init__(self, library: Library) -> None:
        self.library = library
        self.records: list[type] = []
        self.lost_paths: dict[Any, list[str]] = {}
        self.used: set[str] = set()
        """Mathematical functions."""
        self.constants: dict[str, float] = {}
        self.pointers: set[str] = set()
        """Records of the function at hand that came in as pointers."""
        self.classes: dict[str, Any] = {}
        """The classes of the records of the function at hand."""

    def all(self) -> CText:
        functions = "\n".join(self.function(function) for function in self.library.functions)
        for function in self.library.functions:
            kinds = {parameter.name: parameter.kind for parameter in function.parameters}
            for name, paths in function.lost.items():
                if not isinstance(kind := kinds[name], str):
                    self.note_lost(kind, paths)
        structs = {
            self.type(record): self.struct(record) for record in self.records if self.library.kinds.paths(record)
        }
        lost = [record for record in self.records if record in self.lost_paths]
        structs |= {self.lost_type(record): self.lost_struct(record) for record in lost}
        return CText(structs, self.macros(), functions)

    # Declarations.

    def type(self, kind: str | type) -> str:
        if isinstance(kind, str):
            return "vsg_real_t" if kind == "real" else "int"
        self.word(kind)
        return f"vsg_{self.word(kind)}_t"

    def lost_type(self, kind: type) -> str:
        return f"vsg_{self.word(kind)}_lost_t"

    def note_lost(self, record: Any, paths: Iterable[str]) -> None:
        """Remembers what compensated sums keep of a record, and of the records in it."""
        kinds = dict(self.library.kinds.fields(record))
        for path in paths:
            first, _, rest = path.partition(".")
            known = self.lost_paths.setdefault(record, [])
            known += [first] if first not in known else []
            if rest:
                self.note_lost(kinds[first], [rest])

    def lost_struct(self, record: type) -> str:
        lines = [
            f"    {'vsg_real_t' if inner is None else self.lost_type(inner)} {name};"
            for name, inner in self.library.kinds.fields(record)
            if name in self.lost_paths[record]
        ]
        head = block_comment(f"What rounding left out of the integrators of {self.type(record)}; zero at first.")
        return "\n".join([*head, "typedef struct {", *lines, f"}} {self.lost_type(record)};", ""])

    def word(self, record: type) -> str:
        if record not in self.records:
            other = next(
                (other for other in self.records if self.library.word(other) == self.library.word(record)), None
            )
            if other is not None:
                raise UntranslatableError(
                    f"{record.__module__}.{record.__name__} and {other.__module__}.{other.__name__}: are both called "
                    f"{self.library.word(record)}. Give one of them another name (names)."
                )
            for _, inner in self.library.kinds.fields(record):
                if inner is not None and self.library.kinds.paths(inner):
                    self.word(inner)
            self.records.append(record)
        return self.library.word(record)

    def struct(self, record: type) -> str:
        fields = dict(self.library.kinds.fields(record))
        doc = (record.__doc__ or "").split("\n\n")[0]
        doc = "" if doc.startswith(f"{record.__name__}(") else doc  # a NamedTuple's own, which only repeats the fields
        lines = []
        for names, text in field_groups(record):
            declared = []
            for name in names:
                if name in KEYWORDS:
                    raise UntranslatableError(f"{record.__name__}.{name}: is a word of C. Give the field another name.")
                inner = fields[name]
                if inner is None or self.library.kinds.paths(inner):
                    declared.append(f"    {self.type('real' if inner is None else inner)} {name};")
            if not declared:
                continue
            beside = f"{declared[0]} /* {ascii_text(text)} */"
            if not text or (len(names) == 1 and len(beside) <= WIDTH):
                lines += [beside] if text else declared
            else:
                lines += [*block_comment(text, "    "), *declared]
        return "\n".join([*block_comment(doc), "typedef struct {", *lines, f"}} {self.type(record)};", ""])

    def macros(self) -> str:
        mathematical = sorted(self.used - {"max", "min", ADVANCED})
        text = ""
        if mathematical:
            pairs = [(f"VSG_{name.upper()}", _LIBRARY.get(name, name)) for name in mathematical]
            double = "\n".join(f"#define {macro} {name}" for macro, name in pairs)
            single = "\n".join(f"#define {macro} {name}f" for macro, name in pairs)
            text += f"#ifdef VSG_DOUBLE\n{double}\n#else\n{single}\n#endif\n\n"
        for name, value in self.constants.items():
            text += f"#define VSG_{name} VSG_C({value!r})\n"
        text += "\n" if self.constants else ""
        helpers = (("max", _MAX), ("min", _MIN), (ADVANCED, _ADVANCED))
        return text + "\n".join(helper for name, helper in helpers if name in self.used)

    # Functions.

    def function(self, function: Function) -> str:
        self.pointers = {parameter.name for parameter in function.parameters if not isinstance(parameter.kind, str)}
        self.pointers |= {output.name for output in function.outputs if not isinstance(output.kind, str)}
        self.classes = {parameter.name: parameter.kind for parameter in function.parameters}
        for statement in function.body:
            if isinstance(statement, Build | Choose):
                self.classes[statement.name] = statement.record
            elif isinstance(statement, Evaluate) and statement.declare:
                kinds = (output.kind for output in statement.function.outputs)
                self.classes |= dict(zip(statement.targets, kinds, strict=True))
        declared = []
        for parameter in function.parameters:
            scalar = isinstance(parameter.kind, str)
            declared.append(
                f"{self.type(parameter.kind)} {parameter.name}"
                if scalar
                else f"const {self.type(parameter.kind)} *{parameter.name}"
            )
        for parameter in function.parameters:
            if parameter.name in function.lost:
                kind = "vsg_real_t" if isinstance(parameter.kind, str) else self.lost_type(parameter.kind)
                declared.append(f"{kind} *{parameter.name}_lost")
        declared += [f"{self.type(output.kind)} *{output.name}" for output in function.written]
        body: list[str] = []
        for statement in function.body:
            body += self.statement(statement)
        read = set().union(*(_read(statement) for statement in function.body), set())
        for output in function.outputs:
            for path, value in output.values if isinstance(output.kind, str) else self.assigned(output):
                place = f"{output.name}->{path}" if path else f"*{output.name}"
                body += _wrapped(f"    {place} = {self.expression(value)};", 8)
                read |= names_in(value)
        if function.result is not None:
            body += _wrapped(f"    return {self.expression(function.result)};", 8)
            read |= names_in(function.result)
        unused = [parameter.name for parameter in function.parameters if parameter.name not in read]
        body += [f"    (void){name};" for name in unused if name not in function.lost]
        returned = "void" if function.result is None else ("int" if _is_flag(function) else "vsg_real_t")
        head = f"static inline {returned} vsg_{function.name}({', '.join(declared)})"
        return "\n".join([*block_comment(function.doc), *_wrapped(head, 4), "{", *body, "}", ""])

    def assigned(self, output: Output) -> list[tuple[str, Expression]]:
        """The fields of a record that is written, with those that are a whole record elsewhere in one piece."""
        values = dict(output.values)

        def of(record: Any, path: str) -> list[tuple[str, Expression]]:
            paths = self.library.kinds.paths(record)
            first = values[f"{path}.{paths[0]}" if path else paths[0]]
            if isinstance(first, Field) and first.path.endswith(paths[0]) and self.class_at(first, paths[0]) is record:
                home = first.path[: len(first.path) - len(paths[0])]
                if all(values[f"{path}.{at}" if path else at] == Field(first.record, f"{home}{at}") for at in paths):
                    return [(path, Field(first.record, home.rstrip(".")))]
            found: list[tuple[str, Expression]] = []
            for name, inner in self.library.kinds.fields(record):
                place = f"{path}.{name}" if path else name
                if inner is None:
                    found.append((place, values[place]))
                elif self.library.kinds.paths(inner):
                    found += of(inner, place)
            return found

        return of(output.kind, "") if values else []

    def class_at(self, field: Field, end: str) -> Any:
        """The class of the record in which a field is, ``end`` being its path there; None where it is not known."""
        found = self.classes.get(field.record)
        if found is None or not (field.path == end or field.path.endswith(f".{end}")):
            return None
        for name in filter(None, field.path[: len(field.path) - len(end)].split(".")):
            found = dict(self.library.kinds.fields(found))[name]
        return found

    def statement(self, statement: Statement) -> list[str]:
        if isinstance(statement, Comment):
            return block_comment(statement.text, "    ")
        if isinstance(statement, Let):
            kind = "int" if is_flag(statement.value) else "vsg_real_t"
            return _wrapped(f"    const {kind} {statement.name} = {self.expression(statement.value)};", 8)
        if isinstance(statement, Build):
            values = ", ".join(f".{path} = {self.expression(value)}" for path, value in statement.fields)
            return _wrapped(f"    const {self.type(statement.record)} {statement.name} = {{{values}}};", 8)
        if isinstance(statement, Choose):
            text = self.whole(statement.one)
            if statement.condition is not None and statement.other is not None:
                text = f"{self.enclosed(statement.condition)} ? {text} : {self.whole(statement.other)}"
            return _wrapped(f"    const {self.type(statement.record)} {statement.name} = {text};", 8)
        function, lines = statement.function, []
        if statement.declare:
            kinds: dict[str, list[str]] = {}
            for name, output in zip(statement.targets, function.outputs, strict=True):
                if not output.empty:
                    kinds.setdefault(self.type(output.kind), []).append(name)
            for kind, names in kinds.items():
                lines += _wrapped(f"    {kind} {', '.join(names)};", 8)
        pairs = zip(statement.targets, function.outputs, strict=True)
        written = [name for name, output in pairs if not output.empty]
        targets = [f"&{name}" if statement.declare else name for name in written]
        return lines + _wrapped(f"    {self.invoked(function, statement.arguments, targets)};", 8)

    def invoked(self, function: Function, arguments: Sequence[Argument], targets: Sequence[str] = ()) -> str:
        given = [self.argument(argument) for argument in arguments]
        for parameter, argument in zip(function.parameters, arguments, strict=True):
            if parameter.name not in function.lost:
                continue
            if isinstance(argument, Field):
                given.append(f"&{argument.record}_lost->{argument.path}")
            elif isinstance(argument, RecordName) and argument.path:
                given.append(f"&{argument.name}_lost->{argument.path}")
            elif isinstance(argument, Variable | RecordName):
                given.append(f"{argument.name}_lost")
        return f"vsg_{function.name}({', '.join([*given, *targets])})"

    def whole(self, record: RecordName) -> str:
        """A record as a value."""
        return self.expression(Field(record.name, record.path))

    def argument(self, argument: Argument) -> str:
        if isinstance(argument, RecordName):
            if argument.path:
                return f"&{argument.name}{'->' if argument.name in self.pointers else '.'}{argument.path}"
            return argument.name if argument.name in self.pointers else f"&{argument.name}"
        return self.expression(argument)

    # Expressions.

    def expression(self, e: Expression, above: int = 0) -> str:
        if isinstance(e, Number):
            return self.number(e)
        if isinstance(e, Variable):
            return e.name
        if isinstance(e, Field):
            pointer = e.record in self.pointers
            if not e.path:  # all of a record
                return f"*{e.record}" if pointer else e.record
            return f"{e.record}{'->' if pointer else '.'}{e.path}"
        if isinstance(e, Invocation):
            return self.invoked(e.function, e.arguments)
        precedence, text = _PRECEDENCE.get(e.name, _ATOM), ""
        if e.name == ADVANCED:
            self.used.add(ADVANCED)
            x, dx = e.arguments
            kept = f"&{x.record}_lost->{x.path}" if isinstance(x, Field) else f"{self.expression(x)}_lost"
            text = f"vsg_advanced({self.expression(x)}, {self.expression(dx)}, {kept})"
        elif e.name in ("neg", "not"):
            text = f"{'-' if e.name == 'neg' else '!'}{self.expression(e.arguments[0], _ATOM)}"
        elif e.name == "select":
            condition, one, other = e.arguments
            text = f"{self.enclosed(condition)} ? {self.expression(one, 2)} : {self.expression(other, 2)}"
        elif e.name in _SYMBOLS:
            text = f" {_SYMBOLS[e.name]} ".join(self.enclosed(argument) for argument in _chain(e))
        elif precedence == _ATOM:
            self.used.add(e.name)
            name = f"vsg_{e.name}" if e.name in ("max", "min") else f"VSG_{e.name.upper()}"
            text = f"{name}({', '.join(self.expression(argument) for argument in e.arguments)})"
        else:
            left, right = e.arguments
            text = f"{self.expression(left, precedence)} {e.name} {self.expression(right, precedence + 1)}"
        return f"({text})" if precedence < above else text

    def enclosed(self, e: Expression) -> str:
        """In parentheses, as a condition is read without knowing what binds how."""
        return f"({self.expression(e)})" if isinstance(e, Operation) and e.name != "not" else self.expression(e)

    def number(self, number: Number) -> str:
        if isinstance(number.value, bool):
            return str(int(number.value))
        if not math.isfinite(number.value):
            raise UntranslatableError(f"constant {number.name or number.value}: is not finite. Give a large number.")
        if number.name:
            name = f"{self.library.prefix}{number.name}".upper()
            if self.constants.setdefault(name, number.value) != number.value:
                raise UntranslatableError(
                    f"constant {number.name}: has two values, {self.constants[name]!r} and {number.value!r}, in the "
                    "functions that are translated together. Give one of them another name."
                )
            return f"VSG_{name}"
        return f"VSG_C({number.value!r})"


def _chain(e: Operation) -> list[Expression]:
    """What one "and" or one "or" joins, in order."""
    first, last = e.arguments
    return [*(_chain(first) if isinstance(first, Operation) and first.name == e.name else [first]), last]


def _is_flag(function: Function) -> bool:
    return function.result is not None and is_flag(function.result)


def _read(statement: Statement) -> set[str]:
    if isinstance(statement, Let):
        return names_in(statement.value)
    if isinstance(statement, Choose):
        return statement.read
    if isinstance(statement, Build):
        return set().union(*(names_in(value) for _, value in statement.fields))
    if isinstance(statement, Evaluate):
        return set().union(*(names_in(argument) for argument in statement.arguments), set())
    return set()


def _wrapped(line: str, indent: int) -> list[str]:
    """Lines of at most WIDTH, cut after a comma or before an operator."""
    lines, pad = [], " " * indent
    while len(line) > WIDTH:
        cuts = [m.end() for m in re.finditer(r", |(?= [-+*/?:] )|(?= && )|(?= \|\| )", line[: WIDTH + 1])]
        cuts = [cut for cut in cuts if cut > len(pad) + 8]
        if not cuts:
            break
        lines.append(line[: cuts[-1]].rstrip())
        line = pad + line[cuts[-1] :].lstrip()
    return [*lines, line]
