"""Copies the documents into one folder in the layout of the repository, so that their links need no change."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE", "bench/README.md")
FOLDERS = ("docs", "studies")

EQUATION = re.compile(r"^\$\$\n(.*?)\n\$\$$", re.MULTILINE | re.DOTALL)
BAR = re.compile(r'<mo(?: stretchy="false")?>(&#x0007C;|&#x02016;)</mo>')
"""A bar that stands for itself: browsers would space it like a relation."""
ARG = re.compile(r"\\arg\b")
"""A command that latex2mathml does not know."""
OPENS = re.compile(r"(?<!\\)\{|\\begin\b|\\left\b")
CLOSES = re.compile(r"(?<!\\)\}|\\end\b|\\right\b")
DEPTH = re.compile(rf"({OPENS.pattern}|{CLOSES.pattern}|\\q?quad\b|\\\\)")
GATHERED = re.compile(r"^\\begin\{gathered\}(.*)\\end\{gathered\}$")
NOTE = re.compile(r"^<!-- (?:file|not run): [^\n]* -->\n(?=```)", re.MULTILINE)

API = {
    "facade": (
        "import vsgdesign as vd",
        (
            "vsgdesign.verbs.facade.studies",
            "vsgdesign.verbs.facade.simulated",
            "vsgdesign.verbs.facade.designed",
            "vsgdesign.verbs.facade.tables",
            "vsgdesign.verbs.facade.shown",
        ),
    ),
    "runtime": ("Runtime", ("vsgdesign.runtime",)),
    "equations": (
        "Equations",
        (
            "vsgdesign.equations.power_flow",
            "vsgdesign.equations.grid",
            "vsgdesign.equations.placing",
            "vsgdesign.equations.power_loops",
            "vsgdesign.equations.structures",
            "vsgdesign.equations.inner_loops",
            "vsgdesign.equations.grid",
            "vsgdesign.equations.controller",
        ),
    ),
    "parameters": (
        "Parameters",
        (
            "vsgdesign.study.parameters",
            "vsgdesign.study.parameters.study",
            "vsgdesign.study.parameters.converter",
            "vsgdesign.study.parameters.grid",
        ),
    ),
    "design": ("Design", ("vsgdesign.design", "vsgdesign.design.inner")),
    "simulation": ("Simulation", ("vsgdesign.simulation", "vsgdesign.simulation.scenario")),
    "certificate": ("Certificate", ("vsgdesign.certificate",)),
    "identification": ("Estimators of the grid", ("vsgdesign.identification",)),
    "stability": (
        "Stability",
        ("vsgdesign.linear.stability.maps", "vsgdesign.linear.stability.margins", "vsgdesign.linear.stability.loci"),
    ),
    "codegen": ("Code generation", ("vsgdesign.codegen",)),
    "metrics": ("Measures", ("vsgdesign.metrics",)),
    "compliance": (
        "Grid-code tests",
        ("vsgdesign.campaigns.compliance.reading", "vsgdesign.campaigns.compliance.suite"),
    ),
    "pipeline": (
        "Pipeline",
        (
            "vsgdesign.verbs.pipeline.opening",
            "vsgdesign.verbs.pipeline.run",
            "vsgdesign.verbs.pipeline.results",
            "vsgdesign.verbs.pipeline.verify",
            "vsgdesign.verbs.pipeline.comply",
            "vsgdesign.verbs.pipeline.survival",
            "vsgdesign.verbs.pipeline.comparison",
        ),
    ),
}
"""Page, its title, and the modules on it. A module that does not exist is left out, and a page without modules too."""


def stage(folder: Path, render: Callable[[str], str]) -> None:
    """The documents under ``folder``, equations rendered."""
    shutil.rmtree(folder, ignore_errors=True)
    for name in FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    for name in FOLDERS:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "out", "*.pyc"))
    for name in ("site.css", "iframe-worker.js"):
        shutil.copy(ROOT / "website" / name, folder / name)
    for page in folder.rglob("*.md"):
        text = NOTE.sub("", page.read_text(encoding="utf-8"))
        page.write_text(EQUATION.sub(lambda match: equation(match[1], render), text), encoding="utf-8")


def equation(body: str, render: Callable[[str], str]) -> str:
    """A display equation as MathML, with its label beside it. ValueError where a command of LaTeX is left over."""
    label = re.search(r"\\tag\{([^}]*)\}", body)
    plain = " ".join(re.sub(r"\\tag\{[^}]*\}", "", body).split())
    plain = ARG.sub(r"\\operatorname{arg}", plain.replace("{aligned}", "{align*}"))
    rows = ["".join(render(part) for part in row) for row in parted(plain)]
    math = '<span class="row"></span>'.join(rows)
    if "linebreak" in math:
        raise ValueError(f"an equation has rows that a browser would not break ({plain[:60]})")
    left = re.search(r".{0,40}(?:\\|&(?!#x[0-9A-F]+;)).{0,40}", math)
    if left:
        raise ValueError(f"an equation is not rendered whole ({left[0]}): {body}")
    math = BAR.sub(r'<mo lspace="0" rspace="0" stretchy="false">\1</mo>', math)
    said = f'<span class="label">({label[1]})</span>' if label else ""
    return f'<div class="equation"><div>{math}</div>{said}</div>'


def parted(text: str) -> list[list[str]]:
    """The rows of an equation, each in parts at its wide spaces: a narrow page puts them below each other.

    A space within braces, an environment, or \\left and \\right is none of these. Only {gathered} has rows here.
    """
    rows, depth = [[""]], 0
    for piece in DEPTH.split(GATHERED.sub(r"\1", text)):
        if piece == r"\\" and depth == 0:
            rows.append([""])
        elif piece in (r"\quad", r"\qquad") and depth == 0:
            rows[-1].append("")
        else:
            depth += 1 if OPENS.fullmatch(piece) else -1 if CLOSES.fullmatch(piece) else 0
            rows[-1][-1] += piece
    return [[part.strip() for part in row if part.strip()] for row in rows]


def stage_api(folder: Path) -> list[dict[str, str]]:
    """Pages of the public modules under ``folder/api``, and their entries for the navigation."""
    (folder / "api").mkdir(parents=True)
    entries = [{"Overview": "api/index.md"}]
    rows = []
    for page, (title, names) in API.items():
        modules = [name for name in names if exists(name)]
        if not modules:
            continue
        parts = [f"# {title}\n"]
        for module in modules:
            parts.append(f"## `{module}`\n\n::: {module}\n")
        (folder / "api" / f"{page}.md").write_text("\n".join(parts), encoding="utf-8")
        entries.append({title: f"api/{page}.md"})
        rows.append(f"| [{title}]({page}.md) | {', '.join(f'`{module}`' for module in modules)} |")
    text = "\n".join(
        [
            "# API\n",
            "These pages are made from the docstrings of the public modules. Units are SI, and names follow the",
            "[nomenclature](../docs/nomenclature.md). The page [Python](../docs/how-to/python.md) shows how to use the",
            "modules.\n",
            "| page | modules |",
            "| --- | --- |",
            *rows,
            "",
        ]
    )
    (folder / "api" / "index.md").write_text(text, encoding="utf-8")
    return entries


def exists(module: str) -> bool:
    """Whether this repository has a module."""
    path = ROOT.joinpath(*module.split("."))
    return path.with_suffix(".py").exists() or (path / "__init__.py").exists()
