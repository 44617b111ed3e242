"""What each number of a record is: its name, unit, meaning and default, read from the record's own text.

The text below a field, or below several, says what they are. It names the unit at its end behind a comma, or is the
unit alone: ``Filtered active power, W.`` Without one a number has none, or is in per unit, which is written as 1.
Docstrings and comments become C's comments: ASCII, no markup, nothing that could end a comment.
"""

from __future__ import annotations

import ast
import functools
import inspect
import re
import textwrap
from typing import Any, NamedTuple

from vsgdesign.codegen.expressions import COUNT, NUMBERS
from vsgdesign.codegen.records import Kinds, kind_of_field

WIDTH = 120

_ASCII = {
    "ω": "omega", "θ": "theta", "δ": "delta", "ξ": "xi", "α": "alpha", "β": "beta", "ζ": "zeta", "τ": "tau",
    "κ": "kappa", "φ": "phi", "ρ": "rho", "σ": "sigma", "Φ": "Phi", "Γ": "Gamma", "π": "pi", "Ω": "Ohm", "Ẑ": "Z_hat",
    "√": "sqrt ", "∂": "d", "∫": "integral ", "∈": "in", "∠": " at angle ", "·": "*", "×": "x", "−": "-", "–": "-",
    "≤": "<=", "≥": ">=", "≠": "!=", "±": "+-", "→": "->", "←": "<-", "²": "^2", "³": "^3", "⁴": "^4", "₀": "_0",
    "½": "1/2",    "°": " deg", "µ": "u", "μ": "u", "…": "...", "’": "'", "“": '"', "”": '"', "é": "e",
}  # fmt: skip

_GREEK = "ωθδξαβζτκφρσΦΓπ"


def ascii_text(text: str) -> str:
    """One line of ASCII without markup. A character that has no spelling here becomes a question mark."""
    text = re.sub(r":eq:\x60([^`]*)`", r"eq. \1", text)
    text = re.sub(r":\w+:`~?(?:[\w.]*\.)?([^`]*)`", r"\1", text).replace("``", "").replace("\\|", "|")
    text = text.replace("δ̇", "ddelta/dt").replace("αβ", "alpha-beta")
    text = re.sub(f"(?<=[0-9A-Z{_GREEK}₀])(?=[{_GREEK}])|(?<=[{_GREEK}₀])(?=[A-Z])", " ", text)  # 2ξω_n: three words
    for symbol, spelled in _ASCII.items():
        text = text.replace(symbol, spelled)
    text = text.encode("ascii", "replace").decode()
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").split())


def block_comment(text: str, indent: str = "") -> list[str]:
    """A comment of whole paragraphs as lines; none for an empty text."""
    paragraphs = [ascii_text(paragraph) for paragraph in re.split(r"\n\s*\n", text.strip()) if paragraph.strip()]
    lines: list[str] = []
    for paragraph in paragraphs:
        lines += ([""] if lines else []) + textwrap.wrap(
            paragraph, WIDTH - len(indent) - 3, break_long_words=False, break_on_hyphens=False
        )
    if not lines:
        return []
    if len(lines) == 1 and len(indent) + len(lines[0]) + 6 <= WIDTH:
        return [f"{indent}/* {lines[0]} */"]
    rest = [f"{indent} * {line}".rstrip() for line in lines[1:]]
    if not rest or len(rest[-1]) + 6 > WIDTH:
        rest.append(f"{indent} */")
    else:
        rest[-1] = f"{rest[-1]} */"
    return [f"{indent}/* {lines[0]}", *rest]


@functools.lru_cache(256)
def field_groups(record: Any) -> list[tuple[list[str], str]]:
    """The fields of a NamedTuple in order, in groups of those that one text is about.

    A text below fields is about those since the last text. "" where there is none.
    """
    groups: list[tuple[list[str], str]] = []
    open_names: list[str] = []
    try:
        body = ast.parse(textwrap.dedent(inspect.getsource(record))).body[0].body  # type: ignore[attr-defined]
    except (OSError, TypeError, SyntaxError, AttributeError):
        body = []
    for statement in body:
        match statement:
            case ast.AnnAssign(target=ast.Name(id=name)):
                open_names.append(name)
            case ast.Expr(value=ast.Constant(value=str() as text)) if open_names:
                groups.append((open_names, text))
                open_names = []
    grouped = {name for names, _ in groups for name in names}
    groups += [([name], "") for name in record._fields if name not in grouped]
    return sorted(groups, key=lambda group: record._fields.index(group[0][0]))


_ONE = r"(?:1|V|A|W|Hz|H|F|S|s|Ω|VA|var|rad|pu|ticks|samples|cycles|windows)(?:²|³|⁴)?"
_UNIT = re.compile(rf"(?:{_ONE})(?:[·/]\(?{_ONE}(?:·{_ONE})*\)?)*(?: peak| rms| phase rms)?(?: \(rms\))?")


class DescribedNumber(NamedTuple):
    """A number of a record."""

    name: str
    """Its name, with those of the records in which it is: ``gains.K_ip``."""
    unit: str
    meaning: str
    whole: bool
    """Whether it is a whole number."""
    start: float | None
    """With which it begins; None where it must be given."""


def described_numbers(record: Any, first: Any = None, prefix: str = "") -> list[DescribedNumber]:
    """Every number of a NamedTuple, in its order, those of records in it included.

    ``first`` is the record with which it begins; without it the class's defaults are taken.
    """
    of = Kinds({} if first is None else {record: {name: type(value) for name, value in first._asdict().items()}})
    inner, defaults = dict(of.fields(record)), record._field_defaults
    found: list[DescribedNumber] = []
    for names, text in field_groups(record):
        meaning = " ".join(text.split()).rstrip(".")
        head, _, last = meaning.rpartition(", ")
        unit = last if _UNIT.fullmatch(last) else "1"
        for name in names:
            if inner[name] is not None:
                found += described_numbers(inner[name], getattr(first, name, None), f"{prefix}{name}.")
                continue
            if kind_of_field(record, name) == NUMBERS:
                continue
            whole = kind_of_field(record, name) == COUNT
            said = head if unit == last else meaning
            start = defaults.get(name) if first is None else getattr(first, name)
            start = None if start is None else float(start)
            found.append(DescribedNumber(f"{prefix}{name}", unit, said or _first(record), whole, start))
    return found


def _first(record: Any) -> str:
    """The first paragraph of a record's own text."""
    return " ".join((record.__doc__ or "").split("\n\n")[0].split()).rstrip(".")
