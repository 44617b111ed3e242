"""The verbs that read results: cite and diff."""

from __future__ import annotations

import sys

import click

from vsgdesign.errors import visible
from vsgdesign.verbs.cli.common import EXIT_IMPOSSIBLE, JSON, print_json, verb


@click.command()
@click.argument("path", metavar="STUDY.toml|RESULT", type=click.Path())
@click.option("--bibtex", is_flag=True, help="Print entries of BibTeX.")
@verb
def cite(path: str, bibtex: bool) -> None:
    """Name the papers and versions behind a study or a result.

    The argument is a study file, a folder of results, or its results.json. A result names the versions that it was made
    with; of a study, those that are installed are named.
    """
    from vsgdesign.verbs.pipeline.given_results import cite as found

    click.echo(visible("\n\n".join(one.bibtex() if bibtex else one.text() for one in found(path))))


RESULT = click.Path()


@click.command()
@click.argument("a", metavar="A", type=RESULT)
@click.argument("b", metavar="B", type=RESULT)
@JSON
@verb
def diff(a: str, b: str, as_json: bool) -> None:
    """Show what changed from result A to result B.

    A and B are folders of results, or their results.json. The output gives changed inputs, changed verdicts and changed
    figures with both values. The exit code is 1 if a verdict got worse.
    """
    from vsgdesign.verbs.pipeline.given_results import compare_results

    found = compare_results(a, b)
    if as_json:
        print_json(found.document())
    else:
        from vsgdesign.report.page.terminal import diff_blocks, print_terminal

        print_terminal(diff_blocks(found.document()))
    if found.worse:
        sys.exit(EXIT_IMPOSSIBLE)
