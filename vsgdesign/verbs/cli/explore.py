"""The verb that opens the explorer in the browser, or writes it to a file."""

from __future__ import annotations

import os
import sys
import threading
from typing import TYPE_CHECKING

import click

from vsgdesign.verbs.cli.common import (
    FILE,
    STUDY_OF_TABLE,
    Interrupted,
    check_study_of,
    load,
    progress,
    results_at,
    verb,
)

if TYPE_CHECKING:
    from vsgdesign.report.explore.server import ExplorerServer, Opening
    from vsgdesign.report.explore.session import Session

_SWITCH_S = 5e-4
"""How long a thread computes while another one waits. Python's own 5 ms are half a linear answer."""
_MOST_APART = 3
"""Processes for EMT at most."""
_COMPILED_S = 20.0
"""How long the end waits for what is being compiled."""
_LAST_WORDS_S = 1.0
"""How long a page that waits has time to hear that the study is wrong."""


@click.command()
@FILE
@STUDY_OF_TABLE
@click.option(
    "--controller", default=None, metavar="NAME", help="The controller that has TABLE.json.  [default: the last one]"
)
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser.  [default: yes]")
@click.option(
    "--port",
    type=click.IntRange(1, 65535),
    default=None,
    metavar="N",
    help="Port on this machine.  [default: any free one]",
)
@click.option(
    "--state",
    "link",
    default=None,
    metavar="TEXT",
    help="Begin with the state in this link, which the page has copied.",
)
@click.option(
    "--page",
    "--static",
    "page",
    default=None,
    metavar="FILE.html",
    help="Write one file that needs no server and simulates by itself, and open nothing. --static says the same.",
)
@click.option(
    "--lattice",
    default=None,
    metavar="WxH",
    help="Numbers of SCR and of X/R in FILE.html.  [default: 48x32]",
)
@click.option(
    "--bridge",
    type=click.Choice(["averaged", "pwm"]),
    default=None,
    help="Bridge of the runs in FILE.html: averaged, or switched and without verdicts.  [default: averaged]",
)
@verb
def explore(
    file: str,
    study_file: str | None,
    controller: str | None,
    browser: bool,
    port: int | None,
    link: str | None,
    page: str | None,
    lattice: str | None,
    bridge: str | None,
) -> None:
    """Drag the grid in the browser, and watch modes, margins and EMT.

    The page is served on this machine alone, at an address with a random token. It needs no internet. Ctrl-C ends it.
    Gain tables that the study asks for are read where earlier commands have left them, or designed first.
    """
    _check_options(file, study_file, controller)
    if lattice is not None and page is None:
        raise click.UsageError("--lattice says how fine a page without a server is; --page names its file")
    if bridge is not None and page is None:
        raise click.UsageError(
            "--bridge says which bridge a page without a server runs; --page names its file, and with a server the "
            "bridge is averaged"
        )
    # The matrices are small. On several threads, BLAS takes twice the time, and no library reads this later.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("MKL_NUM_THREADS", "1")
    if page is not None:
        _write(file, study_file, controller, link, page, lattice, bridge or "averaged")
        return
    # A request for EMT comes while the linear answer is computed: its thread gets its turn soon.
    sys.setswitchinterval(_SWITCH_S)
    from vsgdesign.report.explore.server import Opening

    opening = Opening()
    server = _served(opening, port)
    try:
        click.echo(f"explorer: {server.gate.address}{_fragment(link)}")
        if browser:
            _open_browser(server.gate.address + _fragment(link))
        session = _session(file, study_file, controller, link, opening)
        session.info()  # its models are loaded here, where Ctrl-C is heard
        _explored(opening, session)
        click.echo("The explorer has ended.", err=True)
    except Exception as error:
        opening.fail(str(error))
        opening.told.wait(_LAST_WORDS_S if browser else 0.0)
        raise
    finally:
        server.end()


def _check_options(file: str, study_file: str | None, controller: str | None) -> None:
    check_study_of(file, study_file)
    if study_file is None and controller is not None:
        raise click.UsageError("--controller says whose gain table TABLE.json is; a study has its own")
    # A file that is missing is said before a browser opens.
    from vsgdesign.errors import Fault, StudyError

    path = file if study_file is None else study_file
    if not os.path.isfile(path):
        raise StudyError(path, [Fault("study file", "", "there is no such file", "Give the path of a study.")])


def _served(opening: Opening, port: int | None) -> ExplorerServer:
    from vsgdesign.report.explore.server import ExplorerServer

    try:
        server = ExplorerServer(opening, port or 0, complain=lambda text: click.echo(text, err=True))
    except OSError as error:
        advice = "Give another one, or leave --port out for any free port."
        raise click.UsageError(f"--port {port} cannot be used: {error.strerror}. {advice}") from None
    server.begin()
    return server


def _fragment(link: str | None) -> str:
    """The part of a link from # on, for the address that the browser opens."""
    from urllib.parse import quote, unquote

    return "" if link is None else "#" + quote(unquote(link.partition("#")[2] or link), safe="")


def _open_browser(address: str) -> None:
    import webbrowser

    # A text browser would wait until it is closed.
    threading.Thread(target=webbrowser.open, args=(address,), name="browser", daemon=True).start()


def _session(
    file: str,
    study_file: str | None,
    controller: str | None,
    link: str | None,
    opening: Opening | None,
    bridge: str = "averaged",
) -> Session:
    doing = ["Reading the study."]

    def show(words: str) -> None:
        if opening is not None:
            opening.say(words)

    def say(sentence: str) -> None:
        doing.append(sentence)
        show(sentence)
        click.echo(sentence, err=True)

    show(doing[0])
    # A page without a server computes in the browser, for one impedance: there is no second one of units apart.
    study = load(file if study_file is None else study_file, plants="refused" if opening is None else "whole")
    of_plant = []
    if study.plant is not None:
        from vsgdesign.verbs.pipeline.one_unit import written_as_unit

        units, study = len(study.plant.units), written_as_unit(study, "vsgdesign explore")
        of_plant = [
            f"A plant of {units} units, shown as one of them behind its transformer: SCR is that of the plant with all "
            f"units on line; with n on line the unit sees {units}/n times of it."
        ]
        click.echo(of_plant[0], err=True)
    from vsgdesign.verbs.pipeline.study_tables import kept_tables

    if study_file is not None:
        from vsgdesign.verbs.pipeline.verify import with_table

        study, _ = with_table(study, file, controller)
    with progress(quiet=False) as bar:

        def tell(what: str, share: float) -> None:
            show(f"{doing[-1]} {what[:1].upper()}{what[1:]}: {share:.0%}.")
            if bar is not None:
                bar(what, share)

        try:
            kept = kept_tables(study, progress=tell, say=say)
        except KeyboardInterrupt:
            raise Interrupted("finished cells of gain tables are kept, and the same command continues there") from None
    show("Loading the models.")
    from vsgdesign.artifacts.ready import Ready
    from vsgdesign.report.explore.session import session_from

    ready, words = Ready(tables=kept.tables), " ".join([*of_plant, *kept.words])
    return session_from(study, ready, link, files=kept.files, words=words, bridge=bridge)


def _write(
    file: str,
    study_file: str | None,
    controller: str | None,
    link: str | None,
    page: str,
    lattice: str | None,
    bridge: str,
) -> None:
    from vsgdesign.report.explore.lattice import LATTICE, lattice_counts
    from vsgdesign.report.explore.page_file import OF_BRIDGE, bridge_shown, write_page

    counts = LATTICE if lattice is None else lattice_counts(lattice)
    session = _session(file, study_file, controller, link, None, bridge)
    with results_at(page):
        with progress(quiet=False) as tell:
            size = write_page(session, page, lattice=counts, progress=tell, workers=None)
        click.echo(f"page: {page} ({size / 1e6:.1f} MB)")
        shown = bridge_shown(session)
        if shown != "averaged":
            click.echo(f"It holds {counts[0]} × {counts[1]} grids. {OF_BRIDGE[shown]}", err=True)


def _explored(opening: Opening, session: Session) -> None:
    """Serve the session until Ctrl-C, which is the way to end it from the moment in which it is open."""
    warm_up = threading.Thread(target=session.warm_up, kwargs={"apart": _apart()}, name="warm-up", daemon=True)
    try:
        opening.open(session)
        warm_up.start()
        click.echo("Ctrl-C ends the explorer.", err=True)
        threading.Event().wait()
    except KeyboardInterrupt:
        return
    finally:
        session.close()
        # A thread that stops within the compiler, because the process ends, keeps its lock: the end then waits for it.
        if warm_up.is_alive():
            warm_up.join(_COMPILED_S)


def _apart() -> int:
    """How many processes compute EMT: the linear answer and the browser have a core of their own."""
    return min(max((os.cpu_count() or 1) - 1, 1), _MOST_APART)
