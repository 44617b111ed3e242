"""The verb diff: what differs between two results."""

from __future__ import annotations

import sys

import click

from vsgdesign.verbs.cli.common import EXIT_IMPOSSIBLE, JSON, print_json, verb

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
    from vsgdesign.verbs.pipeline.diff import compare_results

    found = compare_results(a, b)
    if as_json:
        print_json(found.document())
    else:
        from vsgdesign.report.page.terminal import print_terminal
        from vsgdesign.report.terminals import diff_blocks

        print_terminal(diff_blocks(found.document()))
    if found.worse:
        sys.exit(EXIT_IMPOSSIBLE)
