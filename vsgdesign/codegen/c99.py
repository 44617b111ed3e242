"""Prints functions as C99 for either precision: ``vsg_real_t``, literals as ``VSG_C``, nothing promoted to double."""

from __future__ import annotations

import inspect
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from vsgdesign.codegen.c99_expressions import ROW_OF_NUMBERS, ExpressionPrinter
from vsgdesign.codegen.described import ascii_text, block_comment, field_groups
from vsgdesign.codegen.expressions import (
    COUNT,
    FLAG,
    NUMBERS,
    REAL,
    Build,
    Choose,
    Comment,
    Evaluate,
    Expression,
    Field,
    Function,
    Let,
    Output,
    Statement,
    kind_of,
    names_in,
)
from vsgdesign.codegen.language import KEYWORDS, UntranslatableError
from vsgdesign.codegen.reader import Library
from vsgdesign.codegen.records import kind_of_field

WIDTH = 120

_TYPES = {REAL: "vsg_real_t", FLAG: "int", COUNT: "uint32_t", NUMBERS: "vsg_numbers_t"}

TYPES = """/* Single precision unless VSG_DOUBLE is defined, for every file alike. */
#ifdef VSG_DOUBLE
typedef double vsg_real_t;
#define VSG_C(x) (x)
#else
typedef float vsg_real_t;
#define VSG_C(x) (x##F)
#endif
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
        whole = f"{structs}{self.constants}{self.functions}"
        needed = "".join(
            f"#include <{header}.h>\n"
            for header, word in (("stdint", "uint32_t"), ("string", "memcpy"))
            if word in whole
        )
        return f"#include <math.h>\n{needed}\n{TYPES}\n{structs}\n{self.constants}\n{self.functions}"

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
    macros: Mapping[str, str] | None = None,
    printed: Collection[str] = (),
) -> CText:
    """C99 of functions of the restricted language, and of all that they call.

    ``fixed``: arguments by name whose values are known now, for each function that has them; branches on them fold
    away. ``names``: what a NamedTuple is called in C, ``gains`` for ``vsg_gains_t``; else its own name in lower case.
    ``kinds``: NamedTuples in fields whose hint says Any, where it is not that of the default. ``prefix``: what
    begins the names of records without such a name, and in capitals those of constants: ``field_`` for
    ``vsg_field_lock_in_t`` and ``VSG_FIELD_TURN``. Two headers of one folder then have no name in common. ``macros``:
    constants that the target has already, and what it calls them. ``printed``: mathematical functions that
    the target has of its own as ``vsg_printed_…``; they are taken where VSG_PRINTED_MATH is defined.

    A function is ``vsg_`` and its name. Its arguments come in their order, then what compensated sums keep
    (``…_lost``), then its results, unless it has one scalar result, which is returned. An output may be the place of
    an input. Raises UntranslatableError with file, line and what to write instead.
    """
    library = Library(names, kinds, prefix, macros)
    fixed = dict(fixed or {})
    unused = set(fixed)
    for function in functions:
        arguments = inspect.signature(function).parameters
        known = {name: value for name, value in fixed.items() if name in arguments}
        unused -= set(known)
        library.read(function, known)
    if unused:
        raise ValueError(f"fixed = {sorted(unused)}: no function given has such an argument.")
    return _Printer(library, printed).all()


class _Printer(ExpressionPrinter):
    def __init__(self, library: Library, printed: Collection[str]) -> None:
        super().__init__(library, printed)
        self.records: list[type] = []
        self.lost_paths: dict[Any, list[str]] = {}
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
        if NUMBERS in self.used:
            structs = {"vsg_numbers_t": ROW_OF_NUMBERS} | structs
        lost = [record for record in self.records if record in self.lost_paths]
        structs |= {self.lost_type(record): self.lost_struct(record) for record in lost}
        return CText(structs, self.macros(), functions)

    # Declarations.

    def type(self, kind: str | type) -> str:
        if isinstance(kind, str):
            if kind == NUMBERS:
                self.used.add(NUMBERS)
            return _TYPES[kind]
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
                    declared.append(f"    {self.type(inner or kind_of_field(record, name))} {name};")
            if not declared:
                continue
            beside = f"{declared[0]} /* {ascii_text(text)} */"
            if not text or (len(names) == 1 and len(beside) <= WIDTH):
                lines += [beside] if text else declared
            else:
                lines += [*block_comment(text, "    "), *declared]
        return "\n".join([*block_comment(doc), "typedef struct {", *lines, f"}} {self.type(record)};", ""])

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
        returned = "void" if function.result is None else self.type(kind_of(function.result))
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
            kind = self.type(kind_of(statement.value))
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
