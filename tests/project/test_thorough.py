"""The list of tests that `make test` leaves to `make test-thorough` names tests that exist; some of each file stay."""

from __future__ import annotations

import ast
import functools
from collections import Counter
from pathlib import Path

from tests.conftest import chosen, thorough

ROOT = Path(__file__).parents[2]


@functools.cache
def functions(file: str) -> set[str]:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}


def test_every_line_names_a_test() -> None:
    for line in thorough():
        file, _, name = line.partition("::")
        assert name.partition("[")[0] in functions(file), line


def test_every_file_keeps_a_test() -> None:
    late = Counter(line.partition("::")[0] for line, stay in thorough().items() if not stay and "[" not in line)
    for file, number in late.items():
        assert number < len(functions(file)), file


def test_a_case_belongs_to_one_of_the_two_suites() -> None:
    names = ["a.py::cases[0]", "a.py::cases[1]", "a.py::long", "a.py::quick", "a.py::page[x]", "a.py::page[y]"]
    stay = {"a.py::cases": 1, "a.py::long": 0, "a.py::page[y]": 0}
    assert chosen(names, stay, only=False) == [True, False, False, True, True, False]
    assert chosen(names, stay, only=True) == [False, True, True, False, False, True]
