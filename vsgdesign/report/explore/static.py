"""The explorer as one HTML file without a server: answers on a lattice of grids, computed beforehand, and compiled
loops with which the page simulates other events by itself."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign import __version__
from vsgdesign.artifacts.files import plain, staged_file
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import ArtifactError, VsgDesignError
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.execution.threads import one_thread
from vsgdesign.report.explore.answer import Answer, as_bytes, thinned
from vsgdesign.report.explore.page_runs import page_runs
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import Session
from vsgdesign.report.explore.state import PlaceOfState, State
from vsgdesign.report.page.html import POLICY
from vsgdesign.report.page.live import StaticPage
from vsgdesign.study.parameters.study import Study

LIMIT_BYTES = 5_000_000
"""Largest file: small enough to be attached to a mail."""
Lattices = Sequence[tuple[int, int]]
LATTICES: Lattices = ((14, 9), (12, 8), (10, 7), (8, 6), (7, 5), (6, 4), (5, 3))
"""Numbers of SCR and of X/R of a page that is sent, the finest first."""
QUICK_LATTICES = LATTICES[3:]
"""Of a page that is made beside something else: it takes half the time."""
PART_LATTICES = LATTICES[5:]
"""Of a part of a report."""
BITS = 11
"""Bits of the mantissa that curves keep: 2e-4 of a value, less than the width of a line. Figures keep all of them."""
POINTS = 160
"""Most points of a curve. Its least and its largest value stay."""
_START_BYTES = 300
"""About what the start of one controller on one grid takes, deflated."""
MADE = "Made by vsgdesign {} from the study {} ({}). Other events are simulated and judged here."
"""What a page says of itself: the version, the study and the beginning of its hash."""
MARK = "written by vsgdesign explore --static"


def write_static(
    session: Session, path: str | Path, *, lattices: Lattices = LATTICES, progress: Progress | None = None
) -> int:
    """Writes the page of a session with answers on a lattice of grids, and returns its size in bytes.

    Everything but the grid is that of the state with which the session begins; maps have every figure. For each grid
    there is one answer with gains that follow the grid and, unless all gains are fixed, one with the gains of the
    session's first grid held. ``lattices`` are numbers of SCR and of X/R, the finest first; the first one whose file is
    small enough is taken. The file is replaced only if it is a page of this kind. Raises ArtifactError.
    """
    path, tell = Path(path), progress or silent
    with staged_file(path, "a page of the explorer", is_static_page) as staged:
        text = static_text(session, tell, lattices)
        size = len(text.encode("utf-8"))
        if size > LIMIT_BYTES:
            raise ArtifactError(
                f"{path}: {_too_large(size)} Show fewer controllers: --state takes the state of a link."
            )
        staged.write_text(text, encoding="utf-8", newline="\n")
    return size


def _too_large(size: int) -> str:
    return f"the page would have {size / 1e6:.1f} MB, and the limit is {LIMIT_BYTES / 1e6:g} MB."


def is_static_page(path: str | Path) -> bool:
    """Whether a file is a page that :func:`write_static` has written."""
    with Path(path).open(encoding="utf-8", errors="replace") as stream:
        return MARK in stream.read(400)


def static_page_of(
    study: Study, ready: Ready, lattices: Lattices = QUICK_LATTICES, tell: Progress = silent
) -> StaticPage:
    """The page of a study from its own state, as one call that another process can make.

    The page is an addition to what it is made beside. A study that the page cannot show, because its powers or its
    grid are beyond the limits of the page's fields or because it has too many controllers, is therefore no error.
    """
    try:
        text = static_text(Session(study, ready), tell, lattices)
    except VsgDesignError as error:
        return StaticPage(None, str(error))
    size = len(text.encode("utf-8"))
    return StaticPage(text) if size <= LIMIT_BYTES else StaticPage(None, _too_large(size))


def static_text(session: Session, tell: Progress = silent, lattices: Lattices = LATTICES) -> str:
    """The text of :func:`write_static`."""
    info, study = session.info(), session.study_of(session.start)
    counts = _counts(session, lattices)
    with one_thread():  # everything is loaded by now
        return _static_text(session, study, info, counts, tell)


def _static_text(session: Session, study: Study, info: dict[str, Any], counts: tuple[int, int], tell: Progress) -> str:
    scr, x_over_r = (
        [float(f"{value:.3g}") for value in np.geomspace(info["map"][name][0], info["map"][name][1], count)]
        for name, count in zip(("scr", "x_over_r"), counts, strict=True)
    )
    start = replace(session.start, hold=None)
    scr[_nearest(scr, start.scr)], x_over_r[_nearest(x_over_r, start.x_over_r)] = start.scr, start.x_over_r
    hold = PlaceOfState(start.scr, start.x_over_r)
    answers: dict[str, str] = {}
    questions = list(_questions(session, start, hold, scr, x_over_r))
    for done, (key, state, ask) in enumerate(questions):
        tell("answer for the page", done / len(questions))
        answer = ask(study, state)
        if answer is not None:
            answers[key] = base64.b64encode(packed(answer)).decode("ascii")
    runs = page_runs(study, session.ready, _grids(start, hold, scr, x_over_r, session.study))
    tell("answer for the page", 1.0)
    kept = {
        "runs": {"info": runs.info, "data": _deflated(runs.data), "saves": _deflated(json.dumps(runs.saves).encode())},
        "worker": joined_modules(PAGE, "worker.js"),
        "info": info
        | {
            "static": True,
            "made": MADE.format(__version__, study.name, study.hash[:12]),
            "defaults": start.document(),
            "lattice": {"scr": scr, "x_over_r": x_over_r, "hold": {"scr": hold.scr, "x_over_r": hold.x_over_r}},
        },
        "answers": answers,
    }
    return page_text(kept)


def _deflated(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def _nearest(values: list[float], value: float) -> int:
    return int(np.argmin(np.abs(np.log(np.asarray(values) / value))))


def _counts(session: Session, lattices: Lattices) -> tuple[int, int]:
    """The finest lattice whose file stays below the limit, with a fifth in reserve, by the size of one grid."""
    study, linear = session.study_of(session.start), partial(session.linear, details=True)
    one = sum(len(packed(answer)) for ask in (linear, session.emt) if (answer := ask(study, session.start)) is not None)
    maps = 2 * len(session.info()["figures"]) * len(packed(session.map(study, session.start)))
    one += _START_BYTES * len(session.start.controllers)
    room = 0.8 * 0.75 * LIMIT_BYTES - maps  # in base 64, three bytes become four
    return next((counts for counts in lattices if 2 * counts[0] * counts[1] * one < room), lattices[-1])


def _held(study: Study, start: State, hold: PlaceOfState) -> tuple[tuple[PlaceOfState | None, str], ...]:
    """Whether the gains follow the grid or are held, with the mark of its answers. Gains that are all fixed are not
    held."""
    fixed = all(spec.kind == "fixed" for spec in study.controllers if spec.name in start.controllers)
    return ((None, ""),) if fixed else ((None, ""), (hold, ",h"))


def _grids(
    start: State, hold: PlaceOfState, scr: list[float], x_over_r: list[float], study: Study
) -> Iterator[tuple[str, State]]:
    """The states of all grids with their keys."""
    for held, mark in _held(study, start, hold):
        for i, s in enumerate(scr):
            for j, x in enumerate(x_over_r):
                yield f"{i},{j}{mark}", replace(start, scr=s, x_over_r=x, hold=held)


_Ask = Callable[[Any, State], Answer | None]


def _questions(
    session: Session, start: State, hold: PlaceOfState, scr: list[float], x_over_r: list[float]
) -> Iterator[tuple[str, State, _Ask]]:
    linear = partial(session.linear, details=True)
    for held, mark in _held(session.study, start, hold):
        for figure in session.info()["figures"]:
            yield f"map:{figure['name']}{mark}", replace(start, figure=figure["name"], hold=held), session.map
    for key, state in _grids(start, hold, scr, x_over_r, session.study):
        yield f"linear:{key}", state, linear
        yield f"emt:{key}", state, session.emt


def packed(answer: Answer) -> bytes:
    """An answer as on the wire, with curves thinned and rounded for drawing, deflated."""
    arrays = {name: np.asarray(values) for name, values in answer.arrays.items()}
    groups: dict[Any, list[str]] = {}
    for name, values in arrays.items():
        if values.ndim == 1 and "/" in name:  # curves of one controller and of one length have one axis
            groups.setdefault((name.partition("/")[0], len(values)), []).append(name)
    for names in groups.values():
        rows = thinned([np.nan_to_num(arrays[name]) for name in names], POINTS)
        arrays |= {name: arrays[name][rows] for name in names}
    return zlib.compress(as_bytes(Answer(answer.header, {name: rounded(one) for name, one in arrays.items()})), 9)


def rounded(values: np.ndarray) -> np.ndarray:
    """Values as float32 with BITS bits of the mantissa, to the nearest; what is not finite stays."""
    found = np.ascontiguousarray(values, dtype=np.float32)
    drop = 23 - BITS
    bits = found.view(np.uint32)
    kept = ((bits + np.uint32(1 << (drop - 1))) & np.uint32(0xFFFFFFFF << drop & 0xFFFFFFFF)).view(np.float32)
    return np.where(np.isfinite(found) & np.isfinite(kept), kept, found)


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
