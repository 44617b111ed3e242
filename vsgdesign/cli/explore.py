"""The verb that opens the explorer in the browser."""

from __future__ import annotations

import click

from vsgdesign.cli.common import load, progress, verb


@click.command()
@click.argument("file", metavar="STUDY.toml|TABLE.json", type=click.Path())
@click.option("--study", "study_file", default=None, metavar="STUDY.toml", help="The study of a TABLE.json.")
@click.option("--port", type=click.IntRange(1, 65535), default=None, metavar="N", help="[default: a free one]")
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser.  [default: yes]")
@verb
def explore(file: str, study_file: str | None, port: int | None, browser: bool) -> None:
    """Drag the grid in the browser, and watch modes, margins and EMT.

    The page is served on this machine alone, under an address with a random token. Ctrl-C ends it.
    """
    import threading

    from vsgdesign.explore.server import ExplorerServer, Opening

    opening = Opening()
    server = ExplorerServer(opening, port or 0, complain=lambda text: click.echo(text, err=True))
    server.begin()
    click.echo(server.gate.address)
    if browser:
        import webbrowser

        threading.Thread(target=webbrowser.open, args=(server.gate.address,), daemon=True).start()

    def say(words: str) -> None:
        opening.say(words)
        click.echo(words, err=True)

    opening.say("Reading the study.")
    study = load(file if study_file is None else study_file)
    from vsgdesign.pipeline.kept_tables import kept_tables

    with progress(quiet=False) as tell:
        tables = kept_tables(study, progress=tell, say=say)
    opening.say("Loading the models.")
    from vsgdesign.artifacts.ready import Ready
    from vsgdesign.explore.session import Session

    opening.open(Session(study, Ready(tables=tables)))
    threading.Event().wait()
