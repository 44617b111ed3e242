"""Writes docs/limits.md, all that the program refuses, from the refusals in its code: ``python -m website.limits``.

A refusal is an error that descends from ``VsgDesignError``, a ``Fault``, or a call of ``fault``. Its text is read from
the code without running it: a constant of a module is put in, and what only a run knows is shown as "…".
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import product
from math import prod
from pathlib import Path
from typing import NamedTuple, TypeVar

from website.staging import ROOT

PACKAGE = ROOT / "vsgdesign"
PAGE = ROOT / "docs" / "limits.md"
HEAD = """\
# Limits: what is refused

This page lists the sentences with which vsgdesign refuses an input or a task: the field, what is wrong with the limit,
and what to do. It is written by a program from the code (`python -m website.limits`), and a test holds it equal. "…"
stands for what depends on your input, and a field that is "…" is any one of its kind. Words that a function of its own
puts together are missing. The limits of each field of a study are in its [table](study-file.md), with unit and default:
a value outside of them is refused with "outside … to …". The [limits of validity](architecture.md#limits) say what the
models leave out.
"""
ROOMS = {
    "study/parameters": "Studies",
    "study": "Datasheets and given files",
    "artifacts": "Gain tables, weights, records and folders of results",
    "design": "Design of gains, tables and inner loops",
    "certificate": "Certificates",
    "linear": "Operating points, modes and margins",
    "simulation": "Simulation",
    "campaigns/compliance": "Grid-code tests: comply",
    "campaigns": "Verification and survival: verify, survive",
    "estimator": "Estimators: estimator",
    "identification": "Methods of estimation",
    "runtime": "Scheduler beside a controller",
    "execution": "Processes, clusters and unfinished work",
    "export": "C and ONNX: export",
    "codegen": "Equations that are printed or compiled",
    "equations": "Equations",
    "metrics": "Figures",
    "report": "Pages and the explorer: report, explore",
    "verbs/cli": "Options of the command line",
    "verbs": "Verbs and Python",
}
"""Where a refusal is made, the more special place before its room, and the heading of the page."""
UNKNOWN = "…"
MOST = 64
"""Forms of one sentence that are looked at; a text with more choices is shown with "…"."""
FIELDS = ("field", "value", "problem", "advice")


class Block(NamedTuple):
    """Lines that run one after the other. The function itself is no block, and has the number 0."""

    number: int
    first: int
    last: int


Node = TypeVar("Node", bound=ast.AST)
Loop = ast.For | ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp
WHOLE = Block(0, 0, sys.maxsize)
"""A function."""

Local = dict[str, list[tuple[Block, ast.expr]]]
"""What the names of a function may be, each with the block of code in which it is said."""
Texts = list[tuple[int, str]]
"""What may be said, with the number of a block."""


@cache
def errors() -> frozenset[str]:
    """The names of the package's own errors, of whichever module, and of those of click that a user sees."""
    classes = [one for path in sources() for one in re.findall(r"^class (\w+)\(([\w., ]+)\):", text_of(path), re.M)]
    known, before = {"VsgDesignError"}, 0
    while len(known) > before:
        before = len(known)
        known |= {name for name, bases in classes if known & set(re.findall(r"\w+", bases))}
    return frozenset(known | {"UsageError", "BadParameter"})


@cache
def sources() -> tuple[Path, ...]:
    """The modules of the package."""
    return tuple(sorted(PACKAGE.rglob("*.py")))


@cache
def text_of(path: Path) -> str:
    """The code of a module."""
    return path.read_text(encoding="utf-8")


@cache
def tree_of(path: Path) -> ast.Module:
    """The same, taken apart."""
    return ast.parse(text_of(path))


@cache
def nodes_of(path: Path, kind: type[Node]) -> tuple[Node, ...]:
    """All nodes of one kind in a module."""
    return tuple(node for node in _walked(path) if isinstance(node, kind))


@cache
def _walked(path: Path) -> tuple[ast.AST, ...]:
    """As :func:`ast.walk`, in half of its time, and without the marks of what is loaded or stored."""
    found: list[ast.AST] = [tree_of(path)]
    for node in found:
        for name in node._fields:
            value = getattr(node, name, None)
            if isinstance(value, list):
                found += [one for one in value if isinstance(one, ast.AST)]
            elif isinstance(value, ast.AST) and not isinstance(value, ast.expr_context):
                found.append(value)
    return tuple(found)


@cache
def calls_of(path: Path) -> dict[str, list[ast.Call]]:
    """Every call in a module, by the name of what is called."""
    found: dict[str, list[ast.Call]] = {}
    for node in nodes_of(path, ast.Call):
        found.setdefault(_name(node), []).append(node)
    return found


@cache
def constants(path: Path) -> dict[str, object]:
    """Numbers and texts that a module names, those that it imports from this package included."""
    found: dict[str, object] = {}
    for node in tree_of(path).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("vsgdesign."):
            file = ROOT.joinpath(*str(node.module).split(".")).with_suffix(".py")
            names = {one.name: one.asname or one.name for one in node.names if one.name.isupper()}
            if names and file.is_file():
                found |= {names[name]: value for name, value in constants(file).items() if name in names}
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            value = known_value(node.value, found)
            if isinstance(value, int | float | str):
                found[node.targets[0].id] = value
    return found


def known_value(node: ast.expr, names: dict[str, object]) -> object:
    """The value of arithmetic on constants; None where it needs more."""
    allowed = (ast.Constant, ast.Name, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop, ast.expr_context)
    if not all(isinstance(one, allowed) for one in ast.walk(node)):
        return None
    if not all(one.id in names for one in ast.walk(node) if isinstance(one, ast.Name)):
        return None
    return eval(compile(ast.Expression(node), "", "eval"), {"__builtins__": {}}, names)  # constants alone, see above


def texts(node: ast.expr | None, path: Path, local: Local) -> Texts:
    """What a text of the code may say, one entry for each choice in it, with the block of the choice."""
    if node is None or isinstance(node, ast.Constant):
        return [(0, str(getattr(node, "value", None) or ""))]
    if isinstance(node, ast.IfExp):
        return [*texts(node.body, path, local), *texts(node.orelse, path, local)]
    if isinstance(node, ast.JoinedStr):
        parts = [texts(part, path, local) for part in node.values]
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        parts = [texts(part, path, local) for part in (node.left, node.right)]
    elif isinstance(node, ast.FormattedValue):
        value = known_value(node.value, constants(path))
        if value is not None:
            form = texts(node.format_spec, path, local)[0][1]
            return [(0, format(value, "" if UNKNOWN in form else form))]
        found = texts(node.value, path, local) if isinstance(node.value, ast.Name | ast.IfExp) else []
        return [(block, text or UNKNOWN) for block, text in found] or [(0, UNKNOWN)]
    elif isinstance(node, ast.Name) and node.id in local:
        others = {name: said for name, said in local.items() if name != node.id}  # a name in its own text has no end
        found = [(block.number, one) for block, one in local[node.id]]
        return [(number or inner, text) for number, one in found for inner, text in texts(one, path, others)]
    else:
        value = known_value(node, constants(path))
        return [(0, UNKNOWN if value is None else str(value))]
    return [(max(block for block, _ in chosen), "".join(text for _, text in chosen)) for chosen in together(parts)]


def together(parts: list[Texts]) -> Iterator[tuple[tuple[int, str], ...]]:
    """The choices of several texts that can be said at the same time."""
    while prod(map(len, parts)) > MOST:
        longest = max(range(len(parts)), key=lambda k: len(parts[k]))
        parts[longest] = [(0, UNKNOWN)]
    for chosen in product(*parts) if parts else [((0, ""),)]:
        if len({block for block, _ in chosen if block}) < 2:
            yield chosen


def refusals(path: Path) -> Iterator[tuple[str, ...]]:
    """Field, problem and advice of every refusal in a module, in the order of its code."""
    if not re.search(r"(Fault|fault|Error|Parameter)\(", text_of(path)):
        return
    lines = [call.lineno for call in nodes_of(path, ast.Call) if _refuses(call, path)]
    for function in sorted(nodes_of(path, ast.FunctionDef), key=lambda node: node.lineno):
        if not any(function.lineno <= line <= (function.end_lineno or 0) for line in lines):
            continue
        said = (node for child in ast.iter_child_nodes(function) for node in _below(child))
        calls = [call for call in said if isinstance(call, ast.Call) and _refuses(call, path)]
        local: Local = {}
        for block, name, value in _assigned(function.body, WHOLE) if calls else ():
            local.setdefault(name, []).append((block, value))
        for call in calls:
            known = {name: known_at(call.lineno, said) for name, said in local.items()}
            rows = [one for one in rounds(function, call, path) if not known.keys() & one.keys()] or [{}]
            yield from _folded(found for row in rows for found in _said(call, path, {**known, **row}))


def _refuses(call: ast.Call, path: Path) -> bool:
    return (name := _name(call)) in errors() or name in ("Fault", "fault") or bool(_of_record(call, path))


def _of_record(call: ast.Call, path: Path) -> list[ast.Tuple]:
    """The tuples of a field, a problem and an advice with which a reader of records refuses one."""
    if _name(call) not in ("RecordError", "append") or "RecordError" not in text_of(path):
        return []
    return [one for one in call.args if isinstance(one, ast.Tuple) and len(one.elts) == 3]


def _folded(found: Iterable[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """The refusals of one call, those of several fields in the same words as one."""
    fields: dict[tuple[str, ...], dict[str, None]] = {}
    for field, *words in found:
        fields.setdefault(tuple(words), {})[field] = None
    return ((", ".join(names), *words) for words, names in fields.items())


def rounds(function: ast.FunctionDef, call: ast.Call, path: Path) -> list[Local]:
    """What the names of the loops around a call go through, and what its own module passes to its function, where
    the code says it: what the names are in each round."""
    found: list[Local] = [{}]
    for node in loops_of(path):
        if _inside(node, function) and _inside(call, node):
            loops = [node] if isinstance(node, ast.For) else node.generators
            found = [{**one, **row} for one in found for loop in loops for row in _rows(loop, path)] or found
    return [{**one, **row} for one in found for row in _passed(function, path) or [{}]]


@cache
def loops_of(path: Path) -> tuple[Loop, ...]:
    """All loops in a module, those in brackets included."""
    return tuple(node for node in _walked(path) if isinstance(node, Loop))


def _inside(node: ast.expr | ast.stmt, other: ast.expr | ast.stmt) -> bool:
    """Whether a node stands in the text of another, or is this other."""
    first, last = ((one.lineno, one.col_offset) for one in (other, node))
    ends = [(one.end_lineno or 0, one.end_col_offset or 0) for one in (node, other)]
    return first <= last and ends[0] <= ends[1]


def _rows(loop: ast.For | ast.comprehension, path: Path) -> list[Local]:
    """What a loop over written values gives its names; one empty round for any other."""
    target = loop.target.elts if isinstance(loop.target, ast.Tuple) else [loop.target]
    found: list[Local] = []
    for element in _elements(loop.iter, path):
        values = element.elts if isinstance(element, ast.Tuple) and len(target) > 1 else [element]
        pairs = zip(target, values, strict=False)
        found.append({name.id: [(WHOLE, value)] for name, value in pairs if isinstance(name, ast.Name)})
    return found or [{}]


def _elements(node: ast.expr, path: Path) -> list[ast.expr]:
    """The elements of a tuple, a list or a dictionary that stands there or is a constant of its module."""
    of_call = node.func if isinstance(node, ast.Call) else None
    if isinstance(of_call, ast.Attribute) and of_call.attr in ("items", "keys"):
        node = of_call.value
    if isinstance(node, ast.Name):
        node = literals(path).get(node.id, node)
    if isinstance(node, ast.Dict):
        return [ast.Tuple([key, value]) for key, value in zip(node.keys, node.values, strict=True) if key is not None]
    return list(node.elts) if isinstance(node, ast.Tuple | ast.List | ast.Set) else []


@cache
def literals(path: Path) -> dict[str, ast.expr]:
    """The tuples, lists and dictionaries that a module names."""
    named = [node for node in tree_of(path).body if isinstance(node, ast.Assign | ast.AnnAssign)]
    pairs = [(node.targets[0] if isinstance(node, ast.Assign) else node.target, node.value) for node in named]
    return {target.id: value for target, value in pairs if isinstance(target, ast.Name) and value is not None}


def _passed(function: ast.FunctionDef, path: Path) -> list[Local]:
    """What the calls in its own module pass to a function, for each of them: the arguments that are texts in all."""
    calls = calls_of(path).get(function.name, [])
    names = [one.arg for one in function.args.args if one.arg not in ("self", "cls")]
    rows = [
        dict(zip(names, call.args, strict=False)) | {one.arg: one.value for one in call.keywords if one.arg}
        for call in calls
    ]
    always = [name for name in names if all(isinstance(getattr(row.get(name), "value", None), str) for row in rows)]
    return [{name: [(WHOLE, row[name])] for name in always} for row in rows] if always else []


def known_at(line: int, said: list[tuple[Block, ast.expr]]) -> list[tuple[Block, ast.expr]]:
    """What a name may be there: not what is said later, and not what is certainly said anew before."""
    before = [(block, one) for block, one in said if one.lineno < line]
    last = max((one.lineno for block, one in before if block.first <= line <= block.last), default=0)
    return [(block, one) for block, one in before if one.lineno >= last]


def _said(call: ast.Call, path: Path, local: Local) -> Iterator[tuple[str, ...]]:
    """What one call refuses."""
    if refused := _of_record(call, path):
        for one in refused:
            parts = [texts(part, path, local) for part in one.elts]
            yield from ((field, problem, advice) for (_, field), (_, problem), (_, advice) in together(parts))
    elif _name(call) in ("Fault", "fault"):
        names = FIELDS if _name(call) == "Fault" else signature(path)
        given = dict(zip(names, call.args, strict=False)) | {one.arg: one.value for one in call.keywords if one.arg}
        parts = [texts(given.get(part), path, local) for part in ("field", "problem", "advice")]
        for (_, field), *others in together(parts) if "problem" in given else ():
            yield field or UNKNOWN, *(text for _, text in others)  # no field: the table itself
    elif _name(call) == "UnknownNameError" and call.args:
        named = _of_subclasses(call.args[0], path) or [text for _, text in texts(call.args[0], path, local)]
        yield from ((text, f"must be one of {UNKNOWN}", "") for text in named)
    elif call.args and _name(call) != "StudyError":  # that one carries faults
        yield from (_parted(text) for _, text in texts(call.args[0], path, local))


def _of_subclasses(node: ast.expr, path: Path) -> list[str]:
    """The texts that classes give to an attribute of theirs which a method of their base in a module says."""
    if not (isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "self"):
        return []
    bases = {one.name for one in nodes_of(path, ast.ClassDef) if _inside(node, one)}
    pattern = re.compile(rf"^class \w+\((?:{'|'.join(sorted(bases))})\b", re.M)
    classes = (one for file in sources() if pattern.search(text_of(file)) for one in nodes_of(file, ast.ClassDef))
    derived = [one for one in classes if bases & {part.id for base in one.bases for part in _names_in(base)}]
    return [text for one in derived for text in _attribute(one, node.attr)]


def _names_in(node: ast.expr) -> list[ast.Name]:
    return [part for part in ast.walk(node) if isinstance(part, ast.Name)]


def _attribute(of: ast.ClassDef, name: str) -> list[str]:
    """The text that a class gives to one of its attributes."""
    said = (one.value for one in of.body if isinstance(one, ast.Assign) and ast.unparse(one.targets[0]) == name)
    return [str(value.value) for value in said if isinstance(value, ast.Constant)]


@cache
def signature(path: Path) -> tuple[str, ...]:
    """The arguments of ``fault`` in a module: its own, that of a module beside it, or that of a study's reader."""
    for file in (path, *path.parent.glob("*.py")):
        own = r"(?:self, )?" if file == path else "self, "
        found = re.search(rf"def fault\({own}([^)]*\bproblem\b[^)]*)\)", text_of(file))
        if found:
            return tuple(one.partition(":")[0].strip().replace("name", "field") for one in found[1].split(","))
    return FIELDS


def _below(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all in it, without functions, which come by themselves, in the order of the code."""
    if not isinstance(node, ast.FunctionDef):
        yield node
        for child in ast.iter_child_nodes(node):
            yield from _below(child)


def _assigned(body: list[ast.stmt], block: Block) -> Iterator[tuple[Block, str, ast.expr]]:
    """What names are said to be, with the innermost block in which it is said."""
    for node in body:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                pairs = zip(names, values, strict=False)
                yield from ((block, one.id, value) for one, value in pairs if isinstance(one, ast.Name))
        inner = [getattr(node, name, []) for name in ("body", "orelse", "finalbody")]
        inner += [part.body for part in (*getattr(node, "handlers", ()), *getattr(node, "cases", ()))]
        for part in filter(None, inner):
            first, last = part[0].lineno, part[-1].end_lineno or 0
            yield from _assigned(part, Block(first, first, last))


def _name(call: ast.Call) -> str:
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def _parted(text: str) -> tuple[str, str, str]:
    """A sentence that may begin with its field and end with its advice."""
    found = re.match(r"([a-z][\w.\[\]…]*(?: = \S+)?): (.*)", text, re.DOTALL)
    field, rest = (found[1], found[2]) if found else ("", text)
    problem, stop, advice = rest.partition(". ")
    return field, problem + stop.strip(), advice


def rendered() -> str:
    """The text of the page."""
    parts: dict[str, dict[tuple[str, ...], None]] = {heading: {} for heading in ROOMS.values()}
    for path in sources():
        place = path.relative_to(PACKAGE).as_posix()
        heading = next((words for room, words in ROOMS.items() if place.startswith(f"{room}/")), "")
        for found in refusals(path) if heading else ():
            words = re.findall(r"[^\W_…]{2,}", found[1])
            if len(words) > (not found[0]):  # a text that comes from elsewhere is listed there
                parts[heading].setdefault(tuple(map(_cell, found)))
    head = "| field | what is refused | what to do |\n| --- | --- | --- |\n"
    sections = [
        f"## {heading}\n\n{head}" + "".join(f"| {' | '.join(row)} |\n" for row in rows)
        for heading, rows in parts.items()
        if rows
    ]
    return "\n".join([HEAD, *sections])


def _cell(text: str) -> str:
    text = re.sub(r"…+", UNKNOWN, " ".join(text.split()).rstrip("."))
    return re.sub(r"([|*_`$])", r"\\\1", text.replace("&", "&amp;").replace("<", "&lt;"))


if __name__ == "__main__":
    PAGE.write_text(rendered(), encoding="utf-8", newline="\n")
    sys.stdout.write(f"{PAGE}\n")
