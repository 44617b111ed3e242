"""The restricted language: what it has, and for what it has not, what to write instead. A function's text as a syntax
tree, with its comments, and the one error that names a place in it.
"""

from __future__ import annotations

import ast
import functools
import inspect
import io
import re
import textwrap
import tokenize
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.codegen.expressions import COUNT, INTEGRATED, NUMBERS
from vsgdesign.errors import VsgDesignError

FUNCTIONS: dict[Any, str] = {
    np.sqrt: "sqrt",
    np.cos: "cos",
    np.sin: "sin",
    np.tan: "tan",
    np.exp: "exp",
    np.log: "log",
    np.tanh: "tanh",
    np.abs: "abs",
    np.floor: "floor",
    np.hypot: "hypot",
    np.arctan2: "atan2",
    np.maximum: "max",
    np.minimum: "min",
}
"""NumPy's functions that every target has."""

OPERATORS: dict[type, str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
COUNTS = {ast.BitAnd: "&", ast.BitOr: "|"}
"""Operators of counts alone."""

COMPARISONS: dict[type, str] = {
    ast.Lt: "<",
    ast.Gt: ">",
    ast.LtE: "<=",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}
REFUSED: dict[type, tuple[str, str]] = {
    ast.While: ("while", "Write a step without a loop, and let its caller repeat it."),
    ast.For: ("for", "Write out its turns."),
    ast.Try: ("try", "Write np.where for what may go wrong."),
    ast.With: ("with", "Leave it out."),
    ast.Raise: ("raise", "Check inputs where they come in, not in an equation."),
    ast.Assert: ("assert", "Check inputs where they come in, not in an equation."),
    ast.Break: ("break", "Write a step without a loop."),
    ast.Continue: ("continue", "Write a step without a loop."),
    ast.Delete: ("del", "Leave it out."),
    ast.Global: ("global", "Give it as an argument."),
    ast.Nonlocal: ("nonlocal", "Give it as an argument."),
    ast.Import: ("import", "Import at the top of the file."),
    ast.ImportFrom: ("import", "Import at the top of the file."),
    ast.FunctionDef: ("a function in a function", "Write it at the top of the file."),
    ast.Lambda: ("lambda", "Write a function at the top of the file."),
    ast.List: ("a list", "Write a tuple or a NamedTuple."),
    ast.Dict: ("a dict", "Write a NamedTuple."),
    ast.Set: ("a set", "Write a NamedTuple."),
    ast.ListComp: ("a comprehension", "Write out its items."),
    ast.SetComp: ("a comprehension", "Write out its items."),
    ast.DictComp: ("a comprehension", "Write out its items."),
    ast.GeneratorExp: ("a comprehension", "Write out its items."),
    ast.JoinedStr: ("a text", "Give numbers alone."),
    ast.NamedExpr: (":=", "Write an assignment of its own."),
    ast.Yield: ("yield", "Return a tuple."),
    ast.Await: ("await", "Leave it out."),
    ast.Mod: ("%", "Write np.floor, or one comparison and a subtraction."),
    ast.FloorDiv: ("//", "Write np.floor of a division."),
    ast.Pow: ("**", "Write the product x * x, or np.exp and np.log."),
    ast.MatMult: ("@", "Write the sums out."),
    ast.Is: ("is", "Compare numbers, or give it as an argument that is known."),
    ast.IsNot: ("is not", "Compare numbers, or give it as an argument that is known."),
    ast.In: ("in", "Compare with each."),
    ast.NotIn: ("not in", "Compare with each."),
}
KEYWORDS = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    atan2 cos exp fabs floor hypot log sin sqrt tan tanh""".split()  # noqa: SIM905
)


def instead_of(name: str) -> str:
    builtin = {"max": "np.maximum", "min": "np.minimum", "abs": "np.abs", "float": "the number itself"}
    if name in builtin:
        return f"Write {builtin[name]}."
    if name.startswith("math."):
        return f"Write np.{name[5:]}."
    shown = ", ".join(f"np.{function.__name__}" for function in FUNCTIONS)
    return f"Call functions of this project, or {shown}, np.where, np.clip."


_FOR_TOOLS = ("fmt:", "noqa", "type:", "pyright:", "ruff:")


class UntranslatableError(VsgDesignError):
    """A function leaves the restricted language: with file and line, and what to write instead."""


@dataclass(frozen=True)
class Source:
    """The text of a function. Line numbers are those of its file."""

    function: Any
    tree: ast.FunctionDef
    comments: dict[int, str]
    doc: str
    hints: dict[str, Any]
    file: str

    def refuse(self, line: int, what: str, instead: str) -> UntranslatableError:
        """The error that names a place of this function."""
        return UntranslatableError(f"{self.file}:{line}: {self.function.__name__}: {what}. {instead}")


@functools.cache
def source_of(function: Any) -> Source:
    """The source of a plain function, read once a process.

    Raises UntranslatableError where there is none or its hints cannot be read.
    """
    name = getattr(function, "__name__", repr(function))
    try:
        lines, first = inspect.getsourcelines(function)
        file = str(inspect.getsourcefile(function))
    except (OSError, TypeError) as error:
        raise UntranslatableError(f"{name}: has no Python source. Give a function of this project.") from error
    shown = "/".join(Path(file).resolve().parts[-1 - function.__module__.count(".") :])
    text = textwrap.dedent("".join(lines))
    try:
        tree = ast.increment_lineno(ast.parse(text), first - 1).body[0]
    except SyntaxError:
        tree = ast.Pass()
    if not isinstance(tree, ast.FunctionDef):
        raise UntranslatableError(f"{shown}:{first}: {name}: is not a plain function. Write it with def.")
    comments = {
        token.start[0] + first - 1: token.string.lstrip("#").strip()
        for token in tokenize.generate_tokens(io.StringIO(text if "#" in text else "").readline)
        if token.type == tokenize.COMMENT and not token.string.lstrip("# ").startswith(_FOR_TOOLS)
    }
    source = Source(function, tree, comments, ast.get_docstring(tree) or "", {}, shown)
    if tree.decorator_list:
        raise source.refuse(first, "a decorator", "Leave it out: the text says all that is translated.")
    arguments = tree.args
    if arguments.vararg or arguments.kwarg:
        raise source.refuse(first, "*args or **kwargs", "Name every argument.")
    try:
        source.hints.update(typing.get_type_hints(function, include_extras=True))
    except NameError as error:
        raise source.refuse(first, f"type hints: {error}", "Import the types outside TYPE_CHECKING.") from error
    return source


def marked(hint: Any) -> str | None:
    """What a hint says of a value: COUNT of ``Annotated[int, COUNT]``, NUMBERS or INTEGRATED; else None."""
    return next((mark for mark in getattr(hint, "__metadata__", ()) if mark in (COUNT, NUMBERS, INTEGRATED)), None)


@functools.cache
def integrates(function: Any) -> bool:
    """Whether a function moves an integrator by one step, so that each target has its own."""
    returned = getattr(function, "__annotations__", {}).get("return")
    return returned is not None and marked(typing.get_type_hints(function, include_extras=True)["return"]) == INTEGRATED


def documented_results(doc: str) -> tuple[str, ...]:
    """Names that a docstring gives to what is returned: ``Returns (drop_d, drop_q): …``; () without."""
    found = re.search(r"\bReturns\s+\(([^)]*)\)", doc)
    if found is None:
        return ()
    return tuple(name.strip() for name in found[1].split(","))
