"""Libraries do what they are for: an own solver saves an import, and is one more thing to trust."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ALWAYS = {"casadi", "clarabel", "control", "cvxpy", "numpy", "scipy"}


def asked_for(lines: list[str]) -> set[str]:
    return {re.split(r"[^\w-]", line, maxsplit=1)[0] for line in lines}


def test_the_package_asks_for_the_libraries_of_its_field() -> None:
    assert asked_for(PROJECT["dependencies"]) >= ALWAYS
    assert "torch" in asked_for(PROJECT["optional-dependencies"]["train"])


@pytest.mark.parametrize("name", sorted({*ALWAYS, "torch"}))
def test_it_uses_them(name: str) -> None:
    uses = re.compile(rf"^\s*(?:import|from) {name}\b|import_module\(\"{name}\"\)", re.MULTILINE)
    assert any(uses.search(path.read_text(encoding="utf-8")) for path in (ROOT / "vsgdesign").rglob("*.py"))
