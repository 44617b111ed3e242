"""vsgdesign/verbs/facade/studies.pyi: what an editor shows of the facade's arguments is what the fields of a study say.

``python -m tests.facade.test_typed_arguments`` writes it anew.
"""

from __future__ import annotations

import inspect
import keyword
import textwrap
from pathlib import Path

import pytest

import vsgdesign as vd
from vsgdesign.study.parameters.building import Sections
from vsgdesign.study.parameters.fields import Field, fields_of
from vsgdesign.study.parameters.loading import tables_of, type_text
from vsgdesign.verbs.facade import studies
from website.study_file import argument_line

ROOT = Path(__file__).resolve().parents[2]
STUB = ROOT / "vsgdesign" / "verbs" / "facade" / "studies.pyi"

HEAD = '''"""Types of the arguments of :mod:`vsgdesign.verbs.facade.studies`, by the fields of a study."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict

from vsgdesign.study.parameters.fields import Field
from vsgdesign.study.parameters.study import Study

Quantity = float | str
"""A number in SI, or a text with a unit."""
'''


def _class_name(path: str) -> str:
    return "".join(part.capitalize() for word in path.split(".") for part in word.split("_")) + "Table"


def _type(one: Field, path: str) -> str:
    """The type of a field of a table; a table may also be a mapping that was made elsewhere."""
    own = _class_name(f"{path}.{one.name}" if path else one.name)
    return type_text(one, f"{own} | Mapping[str, Any]" if one.fields else "Mapping[str, Any]")


def _doc(text: str, indent: int) -> list[str]:
    lines = textwrap.wrap(text, 110 - indent, break_long_words=False, break_on_hyphens=False)
    return [" " * indent + line for line in lines]


def _table(path: str, fields: tuple[Field, ...]) -> list[str]:
    if any(keyword.iskeyword(one.name) for one in fields):
        # A class cannot have a field that is a word of the language.
        inside = ", ".join(f'"{one.name}": {_type(one, path)}' for one in fields)
        name = _class_name(path)
        return ["", f'{name} = TypedDict("{name}", {{{inside}}}, total=False)', f'"""The fields of [{path}]."""']
    lines = ["", f"class {_class_name(path)}(TypedDict, total=False):", f'    """The fields of [{path}]."""', ""]
    return [*lines, *(f"    {one.name}: {_type(one, path)}" for one in fields)]


def _function(name: str, path: str) -> list[str]:
    signature = inspect.signature(inspect.unwrap(getattr(studies, name)))
    fields = {one.name: one for one in studies.arguments()[name]}
    result = signature.return_annotation
    lines = ["", f"def {name}("]
    star = False
    for parameter in signature.parameters.values():
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            lines += [] if star else ["    *,"]
            star = True
            lines.append(f"    {parameter.name}: {_type(fields[parameter.name], path)} = ...,")
        else:
            default = "" if parameter.default is inspect.Parameter.empty else f" = {parameter.default!r}"
            known = fields.get(parameter.name)
            kind = parameter.annotation if known is None else _type(known, path)
            lines.append(f"    {parameter.name}: {kind}{default},")
    described = inspect.cleandoc(getattr(studies, name).__doc__).splitlines()
    lines += [f") -> {result}:", f'    """{described[0]}', *(f"    {line}".rstrip() for line in described[1:]), ""]
    lines.append("    Parameters:")
    for one in fields.values():
        lines += _doc(f"{one.name}: {argument_line(one)}", 8)
    return [*lines, '    """', "    ..."]


def written() -> str:
    """The stub."""
    lines = HEAD.splitlines()
    for path, fields in tables_of(fields_of(Sections)):
        lines += _table(path, fields) if path and fields else []
    for name, path in (("load", ""), ("grid", "grid"), ("event", "events"), ("controller", "controllers")):
        lines += _function(name, path)
    return "\n".join([*lines, "", "def arguments() -> dict[str, tuple[Field, ...]]: ...", ""])


def test_the_stub_is_what_the_fields_say() -> None:
    assert STUB.read_text(encoding="utf-8") == written(), "python -m tests.facade.test_typed_arguments writes it anew"


@pytest.mark.parametrize("name", ["load", "grid", "event", "controller"])
def test_notebooks_show_the_fields(name: str) -> None:
    shown = inspect.signature(getattr(vd, name)).parameters
    assert {one.name for one in studies.arguments()[name]} <= set(shown)


if __name__ == "__main__":
    STUB.write_text(written(), encoding="utf-8")
