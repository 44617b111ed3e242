"""The extra `dev` installs what the tests import: a module that arrives by chance is missing on another machine."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OURS = ("tests", "bench", "evidence", "website", "studies")


def named(extra: str, project: dict) -> set[str]:
    """The distributions that an extra and the package itself ask for by name, those of extras in the extra included."""
    found: set[str] = set()
    for line in project["dependencies"] + project["optional-dependencies"][extra]:
        name, _, inside = re.fullmatch(r"([\w.-]+)(\[(.*)\])?.*", line).groups()  # pyright: ignore[reportOptionalMemberAccess]
        found.add(normal(name))
        for other in (inside or "").split(",") if name == project["name"] else ():
            found |= named(other, project)
    return found


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


IMPORT = re.compile(
    r"""^\s*(?:import\ (?P<modules>[\w.]+(?:,\ [\w.]+)*)(?:\ as\ \w+)?
    |from\ (?P<package>\w[\w.]*)\ import\ (?P<names>\([^)]*\)|[\w,\ ]+))\s*(?:\#.*)?$
    |(?:importorskip|import_module)\(['"](?P<wanted>[\w.]+)['"]""",
    re.MULTILINE | re.VERBOSE,
)
"""Of the text: to parse every file takes three seconds."""


def imported(text: str) -> Iterator[str]:
    """The modules that a file imports, or without which a test of it is skipped."""
    for found in IMPORT.finditer(text):
        modules, package, names, wanted = found.group("modules", "package", "names", "wanted")
        if package:
            yield package
            yield from (f"{package}.{name}" for name in re.findall(r"\w+", names))
        else:
            yield from (wanted or modules).split(", ")


def reached() -> dict[str, Path]:
    """Each module from elsewhere, with one file that imports it: a test, or what a test imports of this folder."""
    found: dict[str, Path] = {}
    waiting = [*(ROOT / "tests").rglob("*.py")]
    seen = set(waiting)
    while waiting:
        path = waiting.pop()
        for name in imported(path.read_text(encoding="utf-8")):
            top = name.partition(".")[0]
            if top in OURS:
                module = ROOT.joinpath(*name.split("."))
                files = {file for file in (module.with_suffix(".py"), module / "__init__.py") if file.exists()} - seen
                seen |= files
                waiting += files
            elif top not in sys.stdlib_module_names:
                found[top] = path
    return found


@cache
def distributions() -> Mapping[str, list[str]]:
    return packages_distributions()


def without_a_name(modules: dict[str, Path], names: set[str]) -> dict[str, str]:
    """The modules of which no distribution is asked for by name, each with a file that imports it."""
    of = distributions()
    return {
        module: str(path)
        for module, path in modules.items()
        if not names & {normal(name) for name in of.get(module, [module])}
    }


def test_what_tests_import_is_named_in_the_extra() -> None:
    """Before: latex2mathml was installed with the documents' extra alone, and its test was skipped."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    modules = reached()
    assert {"numpy", "onnx", "torch", "latex2mathml", "hypothesis"} <= set(modules)
    assert without_a_name(modules, named("dev", project)) == {}


def test_a_module_that_nobody_asks_for_is_found() -> None:
    lines = ["    import mkdocs.utils", "from PIL import Image", "from tests.a import (", "    one,", "    two,", ")"]
    text = "\n".join([*lines, "onnx = pytest.importorskip" + '("onnx")'])
    names = list(imported(text))
    assert names == ["mkdocs.utils", "PIL", "PIL.Image", "tests.a", "tests.a.one", "tests.a.two", "onnx"]
    modules = {name.partition(".")[0]: ROOT / "tests" / "test_a.py" for name in names}
    assert set(without_a_name(modules, {"pillow", "onnx"})) == {"mkdocs", "tests"}
