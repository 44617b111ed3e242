"""The verb cite: the papers and versions behind what a run used."""

from __future__ import annotations

import click

from vsgdesign.errors import visible
from vsgdesign.verbs.cli.common import verb


@click.command()
@click.argument("path", metavar="STUDY.toml|RESULT", type=click.Path())
@click.option("--bibtex", is_flag=True, help="Print entries of BibTeX.")
@verb
def cite(path: str, bibtex: bool) -> None:
    """Name the papers and versions behind a study or a result.

    The argument is a study file, a folder of results, or its results.json. A result names the versions that it was made
    with; of a study, those that are installed are named.
    """
    from vsgdesign.verbs.pipeline.citing import cite as found

    click.echo(visible("\n\n".join(one.bibtex() if bibtex else one.text() for one in found(path))))
