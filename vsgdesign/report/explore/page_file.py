"""The explorer as one HTML file without a server: the linear model's figures and the start of every controller on a
lattice of grids, and compiled loops with which the page simulates and draws the rest by itself."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign import __version__
from vsgdesign.artifacts.files import plain, staged_file
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import ArtifactError, Fault, StudyError, VsgDesignError
from vsgdesign.execution.executors import Progress, known_here_alone, one_thread, silent, worker_count, worker_processes
from vsgdesign.execution.jobs import each_of
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.report.explore.dc_side import V_DC, check_page
from vsgdesign.report.explore.lattice import (
    LATTICE,
    QUICK_LATTICE,
    Lattice,
    Texts,
    cells_of,
    figures_document,
    shown_in,
)
from vsgdesign.report.explore.live import asked_of_steps, bands, told_note
from vsgdesign.report.explore.page_runs import page_runs
from vsgdesign.report.explore.page_starts import CellStarts, PageCase, joined, starts_of
from vsgdesign.report.explore.scene import scene_of
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import SWITCHED, Session
from vsgdesign.report.explore.state import LABELS, PlaceOfState, State
from vsgdesign.report.page.html import POLICY
from vsgdesign.report.page.live import StaticPage
from vsgdesign.study.parameters.study import Study

LIMIT_BYTES = 5_000_000
"""Largest file: small enough to be attached to a mail."""
MADE = "Made by vsgdesign {} from the study {} ({}), for {} grids. {}"
"""What a page says of itself: the version, the study, the beginning of its hash, its grids, and its bridge."""
OF_BRIDGE = {
    "averaged": "Events are simulated and judged here.",
    "of a switched one": (
        "Events are simulated and judged here with an averaged bridge, although the study's own switches: a page that "
        "is made with --bridge pwm shows that."
    ),
    "pwm": (
        "Events are simulated and judged here with a switched bridge, for which every grid has its responses to "
        "switching edges in the file. A run is judged by the rest to which the bridge itself comes. The curves are "
        "samples of the controller, and the ripple between them is not seen. They begin at the rest of the averaged "
        "bridge, so that they move before the event. Maps, modes, margins and linear steps are those of the averaged "
        "bridge. A page without --bridge pwm also has a map of the grids on which the event is survived."
    ),
}
"""What it says of its bridge."""
AT_CHARGE = "Maps, modes, margins and linear steps are those at the state of charge of the study."
"""What it says of a dc link whose state of charge can be changed."""
MARK = "written by vsgdesign explore --static"
_TOGETHER = 128
"""Grids that are computed in one call."""


def write_page(
    session: Session,
    path: str | Path,
    *,
    lattice: tuple[int, int] = LATTICE,
    progress: Progress | None = None,
    workers: int | None = 1,
) -> int:
    """Writes the page of a session for a lattice of so many SCR and X/R, and returns its size in bytes.

    Everything but the grid is that of the state with which the session begins. Gains follow the grid or, unless all
    gains are fixed, are those of the session's first grid. The file is replaced only if it is a page of this kind.
    ``workers``: processes that compute at the same time, None for one a core; the bytes are the same. Raises
    ArtifactError.
    """
    path, tell = Path(path), progress or silent
    with staged_file(path, "a page of the explorer", is_page) as staged:
        text = page_of_session(session, lattice, tell, workers)
        size = len(text.encode("utf-8"))
        if size > LIMIT_BYTES:
            raise ArtifactError(f"{path}: {_too_large(size)} {_SMALLER}")
        staged.write_text(text, encoding="utf-8", newline="\n")
    return size


_SMALLER = "Give a coarser --lattice, or show fewer controllers: --state takes the state of a link."


def _too_large(size: int) -> str:
    return f"the page would have {size / 1e6:.1f} MB, and the limit is {LIMIT_BYTES / 1e6:g} MB."


def bridge_shown(session: Session) -> str:
    """A key of :data:`OF_BRIDGE`."""
    other = session.bridge != SWITCHED == session.bridge_of_study
    return "of a switched one" if other else session.bridge


def is_page(path: str | Path) -> bool:
    """Whether a file is a page that :func:`write_page` has written."""
    with Path(path).open(encoding="utf-8", errors="replace") as stream:
        return MARK in stream.read(400)


def live_page(
    study: Study,
    ready: Ready,
    lattice: tuple[int, int] = QUICK_LATTICE,
    *,
    controllers: Sequence[str] | None = None,
    cases: Sequence[PageCase] = (),
    tell: Progress = silent,
) -> StaticPage:
    """The page of a study with some of its controllers, None for those with which the explorer begins, as one call
    that another process can make. With ``cases`` it opens with the first of them.

    The page is an addition to what it is made beside. A study that the page cannot show, because its powers or its
    grid are beyond the limits of the page's fields or because it has too many controllers, is therefore no error.
    """
    try:
        start = {} if controllers is None else {"controllers": list(controllers)}
        text = page_of_session(Session(study, ready, start=start), lattice, tell, cases=cases, quickly=True)
    except VsgDesignError as error:
        return StaticPage(None, str(error))
    size = len(text.encode("utf-8"))
    return (
        StaticPage(text, cases=tuple(one.label for one in cases))
        if size <= LIMIT_BYTES
        else StaticPage(None, _too_large(size))
    )


def page_of_session(
    session: Session,
    lattice: tuple[int, int] = LATTICE,
    tell: Progress = silent,
    workers: int | None = 1,
    *,
    cases: Sequence[PageCase] = (),
    quickly: bool = False,
) -> str:
    """The text of :func:`write_page`. ``quickly`` is that of :func:`page_runs`."""
    check_page(session.study, session.bridge)
    return page_text(_kept(session, lattice, tell, workers, cases, quickly))


def _check_known(study: Study, start: State) -> None:
    """Raises StudyError where scheduled controllers are told something else than the grid as it is: the page does not
    simulate that."""
    if all(spec.kind == "fixed" for spec in study.controllers if spec.name in start.controllers):
        return
    told = {name: getattr(start, name) for name in ("error_R", "error_X", "silent_s")}
    problem = "the page simulates scheduled controllers that know their grid at once and exactly"
    advice = "Set it to 0 in the state, or use vsgdesign explore without --page."
    faults = [Fault(LABELS[name], f"{value:g}", problem, advice) for name, value in told.items() if value != 0.0]
    if faults:
        raise StudyError("--state", faults)


class _Part(NamedTuple):
    """Some of the cells: the rows of every controller, the use of the static limits, and the starts."""

    rows: list[list[dict[str, Any]]]
    limit_use: list[NDArray[np.float64]]
    starts: CellStarts


def _part_of(study: Study, ready: Ready, states: Sequence[State]) -> _Part:
    places = [PlaceOfState(one.scr, one.x_over_r) for one in states]
    found = [cells_of(one, states[0], places) for one in shown_in(study, ready, states[0])]
    return _Part([one.rows for one in found], [one.limit_use for one in found], starts_of(study, ready, states))


def _kept(
    session: Session,
    counts: tuple[int, int],
    tell: Progress,
    workers: int | None,
    cases: Sequence[PageCase],
    quickly: bool,
) -> dict[str, Any]:
    """What the page holds."""
    info, start, study = session.info(), session.start, session.study_of(session.start)
    _check_known(study, start)
    lattice = Lattice.around(start, (info["map"]["scr"], info["map"]["x_over_r"]), counts)
    fixed = all(spec.kind == "fixed" for spec in study.controllers if spec.name in start.controllers)
    states = {held: lattice.states(start, held=held) for held in ((False,) if fixed else (False, True))}
    blocks = [(held, k) for held in states for k in range(0, len(states[held]), _TOGETHER)]
    tasks = [states[held][k : k + _TOGETHER] for held, k in blocks]
    found: dict[bool, list[_Part]] = {held: [] for held in states}
    alone = worker_count(workers) == 1 or known_here_alone() or len(tasks) == 1
    with one_thread(), ExitStack() as held_open:
        executor = None if alone else held_open.enter_context(worker_processes(worker_count(workers)))
        each = each_of(executor)
        for done, ((held, _), part) in enumerate(
            zip(blocks, each(partial(_part_of, study, session.ready), tasks), strict=True)
        ):
            tell("cells of the page", done / len(blocks))
            found[held].append(part)
        columns, texts = lattice.columns(), Texts()
        of_cells = {
            "held" if held else "follow": [
                figures_document(columns, texts, [row for part in parts for row in part.rows[k]])
                | {"limit_use": columns.figure(np.concatenate([part.limit_use[k] for part in parts]))}
                for k in range(len(start.controllers))
            ]
            for held, parts in found.items()
        }
        cells = {held: (states[held], joined([part.starts for part in parts])) for held, parts in found.items()}
        models = _models(session, study, states)
        runs = page_runs(study, session.ready, lattice, cells, models, texts, cases, quickly=quickly)
    tell("cells of the page", 1.0)
    scene = scene_of(study, session.ready, start)
    controllers = [
        {
            "name": one.name,
            "colour": session.colour(one.name),
            "structure": one.spec.target.structure,
            "note": one.note,
            "told": told_note(one),
        }
        for one in scene.shown
    ]
    limits = [band for band in bands(scene, session.ready, start) if band["signal"] in ("i_s_pu", V_DC)]
    switched = session.bridge == SWITCHED
    grids = f"{counts[0]} × {counts[1]}"
    made = MADE.format(__version__, study.name, study.hash[:12], grids, OF_BRIDGE[bridge_shown(session)])
    made += f" {AT_CHARGE}" if runs.info.get("dc", {}).get("charge") else ""
    figures = [one for one in info["figures"] if not (switched and one["name"] == "survived")]
    start = start if any(one["name"] == start.figure for one in figures) else replace(start, figure=figures[0]["name"])
    return {
        "info": info
        | {
            "static": True,
            "made": made,
            "figures": figures,
            "controllers": [one for one in info["controllers"] if one["name"] in start.controllers],
            "defaults": start.document() | {"hold": None} | ({"case": 0} if cases else {}),
            "lattice": {
                "scr": lattice.scr,
                "x_over_r": lattice.x_over_r,
                "hold": {"scr": lattice.hold.scr, "x_over_r": lattice.hold.x_over_r},
            },
        },
        "cells": of_cells
        | {
            "controllers": controllers,
            "columns": columns.document(),
            "bands": limits,
            "asked": asked_of_steps(scene, start),
        },
        "figures": _deflated(columns.packed()),
        "texts": _deflated(json.dumps(list(texts.known), ensure_ascii=False).encode()),
        "runs": {"info": runs.info, "data": _deflated(runs.data)},
        "worker": joined_modules(PAGE, "worker.js"),
    }


def _models(
    session: Session, study: Study, states: Mapping[bool, Sequence[State]]
) -> dict[tuple[bool, int], FullOrderModel]:
    """The linear model of every controller, by whether its gains are held and its place: its equations fit all grids
    between the corners of the lattice and the start."""
    found = {}
    scr, ratio = ([getattr(one, name) for one in states[False]] for name in ("scr", "x_over_r"))
    corners = [PlaceOfState(a, b) for a in (min(scr), max(scr)) for b in (min(ratio), max(ratio))]
    places = [PlaceOfState(session.start.scr, session.start.x_over_r), *corners]
    for held, several in states.items():
        for k, one in enumerate(shown_in(study, session.ready, several[0])):
            model = cells_of(one, several[0], places).model
            if model is not None:
                found[held, k] = model
    return found


def _deflated(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def page_text(kept: Mapping[str, Any], folder: Path = PAGE) -> str:
    """The page of a folder as one HTML text with its style, its scripts and what they show."""
    html = (folder / "index.html").read_text(encoding="utf-8")
    style = (folder / "style.css").read_text(encoding="utf-8")
    data = json.dumps(plain(kept), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    policy = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
    parts = {
        r"<!doctype html>": f"<!doctype html>\n<!-- {MARK} -->",
        r'<meta charset="utf-8">': f'<meta charset="utf-8">\n{policy}',
        r'<link rel="stylesheet" href="style\.css">': f"<style>\n{style}</style>",
        r'<script type="module" src="main\.js"></script>': (
            f"<script>window.STATIC = {_inside_script(data)};</script>\n"
            f'<script type="module">\n{_inside_script(joined_modules(folder, "file.js"))}</script>'
        ),
    }
    for pattern, text in parts.items():
        html, count = re.subn(pattern, lambda _, text=text: text, html, count=1, flags=re.IGNORECASE)
        if count != 1:
            raise ArtifactError(f"index.html of the page: it has no {pattern!r}.")
    return html


def _inside_script(text: str) -> str:
    """A text that cannot end the script that it stands in. Strings of JavaScript and JSON mean the same by it."""
    return text.replace("</", "<\\/").replace("<!--", "<\\!--")


_IMPORT = re.compile(r'^import\s*\{([^}]*)\}\s*from\s*"\./([\w.-]+)";?[ \t]*$', re.MULTILINE)
_EXPORT = re.compile(r"^export\s+(?=(?:async\s+)?(?:function\*?|class|const|let)\s+(\w+))", re.MULTILINE)


def joined_modules(folder: Path, first: str = "main.js") -> str:
    """The modules that a script imports, and itself, as one script. Each is a function that returns its exports.

    Modules import names in braces from files beside them, and export declarations. Raises ArtifactError for more.
    """
    done: dict[str, str] = {}
    open_: list[str] = []

    def add(name: str) -> None:
        if name in done:
            return
        if name in open_:
            raise ArtifactError(f"{name} of the page: imports itself by way of {', '.join(open_)}.")
        open_.append(name)
        text = (folder / name).read_text(encoding="utf-8")
        for match in _IMPORT.finditer(text):
            add(match[2])
        names = [match[1] for match in _EXPORT.finditer(text)]
        body = _EXPORT.sub(
            "", _IMPORT.sub(lambda m: f"const {{{m[1].replace(' as ', ': ')}}} = {_module(m[2])};", text)
        )
        if re.search(r"^(import|export)\b", body, re.MULTILINE):
            raise ArtifactError(f"{name} of the page: a form of import or export that cannot be joined.")
        done[name] = f"const {_module(name)} = (() => {{\n{body}\nreturn {{ {', '.join(names)} }};\n}})();\n"
        open_.pop()

    add(first)
    return "".join(done.values())


def _module(name: str) -> str:
    return "module_" + re.sub(r"\W", "_", name)
