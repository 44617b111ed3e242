"""For every test."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import importlib
import io
import os
import pickle
import re
import signal
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

from tests.examples import load_profile
from tests.kept_code import FOLDER, keep_compiled_c
from vsgdesign.codegen import kept_code
from vsgdesign.codegen.kept_code import Store

# Before NumPy is loaded, here and in the processes that tests start. Two workers have two cores, and matrices here are
# small: a second BLAS thread spent up to ten times the processor's time on waiting for the first.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Each of some eighty processes that tests start would otherwise compile the whole package again.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

load_profile()

# Nothing of what is loaded from here on goes again before the tests begin: to look for it took a sixth of this time.
gc.disable()

# A shell that starts a job in the background makes it ignore SIGINT, and every process of it: tests of interruptions
# would wait for nothing.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# nohup does so with SIGHUP. Unlike a signal that is ignored, a handler is not passed on to a program that is started.
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Each worker begins to load the tests at a place of its own. In a new checkout nothing is compiled yet, and they
    would compile the same files at the same time: so each loads what another has compiled."""
    number, count = (os.environ.get(f"PYTEST_XDIST_WORKER{name}", "") for name in ("", "_COUNT"))
    if not count or session.config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    root = session.config.rootpath
    files = sorted(root.glob("tests/**/test_*.py"))
    names = [".".join(file.relative_to(root).with_suffix("").parts) for file in files]
    for name in names[int(number.removeprefix("gw")) * len(names) // int(count) :]:
        # What cannot be loaded is reported where it is collected.
        with contextlib.suppress(Exception, pytest.skip.Exception):
            importlib.import_module(name)


def thorough() -> dict[str, int]:
    """The tests of `tests/thorough.txt`, each with the number of its cases that stay in `make test`."""
    lines = (Path(__file__).parent / "thorough.txt").read_text(encoding="utf-8").splitlines()
    parts = [line.partition(" ; ") for line in lines if not line.startswith("#")]
    return {name: int(stay or 0) for name, _, stay in parts}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--thorough", action="store_true", help="run the tests of tests/thorough.txt, and no other")


def chosen(names: list[str], stay: dict[str, int], only: bool) -> list[bool]:
    """Whether each test belongs to the suite: that of `make test`, or with `only` that of `make test-thorough`."""
    left = dict(stay)
    answers = []
    for name in names:
        key = name if name in left else name.partition("[")[0]
        answers.append((left.get(key, 1) <= 0) == only)
        if key in left:
            left[key] -= 1
    return answers


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The whole suite leaves out what `tests/thorough.txt` lists. Tests that were named run whatever it says."""
    only = bool(config.getoption("--thorough"))
    if not only and config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    kept = chosen([item.nodeid for item in items], thorough(), only)
    config.hook.pytest_deselected(items=[item for item, keep in zip(items, kept, strict=True) if not keep])
    items[:] = [item for item, keep in zip(items, kept, strict=True) if keep]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """A worker tells of a test how it ended, and of its set-up and tear-down only where they did not pass: to send six
    messages for each of thousands of tests took as long as a hundred of them."""
    if not hasattr(item.config, "workerinput") or item.config.getoption("durations") is not None:
        return None
    for report in runtestprotocol(item, log=False, nextitem=nextitem):
        if report.when == "call" or not report.passed:
            item.ihook.pytest_runtest_logreport(report=report)
    return True


def pytest_collection_finish() -> None:
    """What is loaded by now stays: the collector need not look through it again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(200_000, 20, 50)
    gc.enable()
    # Pictures of a third of the product's resolution: what tests see of a PNG is that it is one, and the same twice.
    style: Any = sys.modules.get("vsgdesign.report.drawing.style")
    if style is not None:
        style._LOOK["savefig.dpi"] = 72


def pytest_unconfigure() -> None:
    """What is unreachable by now is collected once. Pytest does it five times more for what only then becomes so: these
    need not look through all that the tests have made."""
    gc.collect()
    gc.freeze()


_DRAWN: dict[str, bytes] = {}
_PICTURES: dict[str, bytes] = {}
_ADDRESS = re.compile(rb"\x8a\x06.{6}", re.DOTALL)


def everything_in(figure: Any, options: Any) -> str | None:
    """Hash of a figure with all that it holds, and of how it is drawn; None where something in it cannot be pickled.

    The only thing that differs between two equal figures are addresses of objects: each becomes its number in the order
    of its first appearance."""
    import matplotlib

    numbers: dict[bytes, int] = {}
    try:
        content = pickle.dumps(figure, 4)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    content = _ADDRESS.sub(lambda found: b"%d" % numbers.setdefault(found.group(), len(numbers)), content)
    look = (matplotlib.__version__, sorted(options.items()), sorted(matplotlib.rcParams.items()))
    return hashlib.sha256(content + repr(look).encode()).hexdigest()


DRAW_OFTEN = ("artifacts", "cli", "docs", "facade")
"""Folders of tests in which verbs and documents draw the same figures again and again, and no test looks into a PNG."""

SHOW_PAGES = ("browser", "evidence", "explore", "report", "studies")
"""Folders in which figures are a part of what is tested."""

DRAW_TWICE = ("test_compliance_pdf.py", "test_live_part.py", "test_page_file.py", "test_stability_figures.py")
"""Tests of whether a figure is drawn alike twice."""


@pytest.fixture(scope="module", autouse=True)
def each_picture_once(request: pytest.FixtureRequest, kept_store: Store | None) -> Iterator[None]:
    """The picture of a figure that is equal to one before in everything is that of before: asking takes a fifteenth of
    the time. In DRAW_OFTEN a PNG, which is the same figure, is drawn once for each name."""
    folder = request.path.parent.name
    if folder not in (*DRAW_OFTEN, *SHOW_PAGES) or request.path.name in DRAW_TWICE:
        yield
        return
    from matplotlib.figure import Figure

    draw = Figure.savefig

    def save(figure: Figure, file: Any, **options: Any) -> None:
        form = options.get("format")
        if form == "png" and isinstance(file, Path):
            if folder in DRAW_OFTEN:
                if file.name not in _DRAWN:
                    draw(figure, file, **options)
                    _DRAWN[file.name] = file.read_bytes()
                file.write_bytes(_DRAWN[file.name])
                return
            key = everything_in(figure, options)
            known = _picture(key, kept_store)
            if known is None:
                draw(figure, file, **options)
                _remember(key, file.read_bytes(), kept_store)
            else:
                file.write_bytes(known)
        elif form == "svg" and isinstance(file, io.StringIO):
            key = everything_in(figure, options)
            known = _picture(key, kept_store)
            if known is None:
                draw(figure, file, **options)
                _remember(key, file.getvalue().encode(), kept_store)
            else:
                file.write(known.decode())
        else:
            draw(figure, file, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        yield


def _picture(key: str | None, kept: Store | None) -> bytes | None:
    """What was drawn of a figure, in this process or before."""
    if key is None:
        return None
    if key not in _PICTURES and kept is not None:
        found = kept.get(key)
        if found is not None:
            _PICTURES[key] = found
    return _PICTURES.get(key)


def _remember(key: str | None, picture: bytes, kept: Store | None) -> None:
    if key is not None:
        _PICTURES[key] = picture
        if kept is not None:
            kept.put(key, picture)


@pytest.fixture(scope="session")
def kept_store() -> Store | None:
    """What was made before, for both workers and the next run (tests/kept_code.py)."""
    if os.environ.get("VSGDESIGN_NO_KEPT_CODE"):
        return None
    try:
        store = Store(FOLDER)
    except OSError:  # a checkout that nobody may write to
        return None
    return store


@pytest.fixture(scope="session", autouse=True)
def code_is_kept(kept_store: Store | None) -> Iterator[None]:
    """Machine code of a text that was compiled before is not made again, and none is written to the user's folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(kept_code.FOLDER, "" if kept_store is None else str(FOLDER / "llvm"))
        if kept_store is not None:
            keep_compiled_c(kept_store, patch)
        yield


NO_SKIPS = bool(os.environ.get("VSGDESIGN_NO_SKIPS"))
"""Set where everything is installed that a test may want, as in continuous integration: a skip is then a failure."""


def fail_what_was_skipped(report: pytest.TestReport | pytest.CollectReport) -> None:
    """What was skipped failed: a program or package that is wanted is missing."""
    if NO_SKIPS and report.outcome == "skipped" and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"skipped, and VSGDESIGN_NO_SKIPS is set: {report.longreprtext}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    report = yield
    fail_what_was_skipped(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, Any, Any]:
    report = yield
    fail_what_was_skipped(report)
    return report
