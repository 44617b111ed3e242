"""No circle of imports, between modules or between packages, those inside functions included."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from website.limits import tree_of

ROOT = Path(__file__).resolve().parents[2]
Graph = Mapping[str, set[str]]


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Every statement that runs: what stands under ``if TYPE_CHECKING`` is for the type checker alone."""
    waiting = [node]
    while waiting:
        yield (one := waiting.pop())
        for child in ast.iter_child_nodes(one):
            if not isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
                continue  # an expression imports nothing
            if not (isinstance(child, ast.If) and ast.unparse(child.test).endswith("TYPE_CHECKING")):
                waiting.append(child)


def imported(module: str, tree: ast.Module, modules: set[str], packages: set[str]) -> set[str]:
    """The modules among `modules` that the code of one of them imports, at the top or inside a function."""
    found: set[str] = set()
    for node in statements(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            here = module.split(".") if module in packages else module.split(".")[:-1]
            above = here[: len(here) - node.level + 1] if node.level else []
            base = ".".join([*above, *filter(None, [node.module])])
            names = {f"{base}.{alias.name}" for alias in node.names}
            found |= (names & modules) | ({base} if names - modules else set())
    return (found & modules) - {module}


def import_graph(root: Path, package: str) -> tuple[dict[str, set[str]], set[str]]:
    """What each module of a package imports of it, and which of them are packages."""
    files = {".".join(path.relative_to(root).with_suffix("").parts): path for path in (root / package).rglob("*.py")}
    named = {name.removesuffix(".__init__"): path for name, path in files.items()}
    packages = {name for name, path in named.items() if path.name == "__init__.py"}
    # The page of limits is made of the same code: whichever test is first takes it apart.
    return {name: imported(name, tree_of(path), set(named), packages) for name, path in named.items()}, packages


def between_packages(graph: Graph, packages: set[str]) -> dict[str, set[str]]:
    """The same imports, seen from package to package (one inside another is another package). What ``python -m`` runs
    is part of none: nobody imports it."""

    def home(module: str) -> str:
        return module if module in packages else module.rpartition(".")[0]

    result: dict[str, set[str]] = {package: set() for package in packages}
    for module, targets in graph.items():
        if module.endswith(".__main__"):
            continue
        result[home(module)] |= {home(target) for target in targets} - {home(module)}
    return result


def circles(graph: Graph) -> list[list[str]]:
    """The groups of names that can all be reached from each other."""
    names = sorted(graph)
    place = {name: k for k, name in enumerate(names)}
    edges = np.array([(place[a], place[b]) for a in names for b in graph[a]], dtype=int).reshape(-1, 2)
    matrix = csr_array((np.ones(len(edges)), edges.T), shape=(len(names), len(names)))
    _, labels = connected_components(matrix, connection="strong")
    groups = [[name for name, label in zip(names, labels, strict=True) if label == k] for k in range(labels.max() + 1)]
    return [group for group in groups if len(group) > 1]


@pytest.fixture(scope="module")
def house() -> tuple[dict[str, set[str]], set[str]]:
    """The graph of the package itself, read once."""
    return import_graph(ROOT, "vsgdesign")


def test_modules_import_one_way(house: tuple[dict[str, set[str]], set[str]]) -> None:
    assert circles(house[0]) == []


def test_packages_import_one_way(house: tuple[dict[str, set[str]], set[str]]) -> None:
    assert circles(between_packages(*house)) == []


def test_a_circle_is_found_wherever_the_import_stands(tmp_path: Path) -> None:
    texts = {
        "__init__": "",
        "a.__init__": "",
        "b.__init__": "",
        "a.one": "from house.b import two\nfrom typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import house.c\n",
        "b.two": "def late():\n    from ..a.three import name\n",
        "a.three": "name = 1\n",
        "c": "import house.a.one\n",
        "d": "from . import e\n",
        "e": "def late():\n    import house.d\n",
    }
    for name, text in texts.items():
        path = tmp_path / "house" / f"{name.replace('.', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    graph, packages = import_graph(tmp_path, "house")
    assert circles(graph) == [["house.d", "house.e"]]
    assert circles(between_packages(graph, packages)) == [["house.a", "house.b"]]
