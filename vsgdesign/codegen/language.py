"""The restricted language: what it has, and for what it has not, what to write instead."""

from __future__ import annotations

import ast
from typing import Any

import numpy as np

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
