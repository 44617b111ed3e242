"""The verb that shows the inner loops of a study, and designs them if the study leaves them open."""

from __future__ import annotations

from contextlib import nullcontext

import click

from vsgdesign.cli.common import JSON, STUDY, load, print_json, progress, results_at, verb


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Also write a page with maps into this folder.")
@click.option(
    "--what-if/--no-what-if",
    default=True,
    show_default=True,
    help="Also compute what sampling, delay and L_2 would improve.",
)
@JSON
@verb
def inner(study_file: str, out: str | None, what_if: bool, as_json: bool) -> None:
    """Show what the inner loops keep, and what limits them.

    The result also says what would improve them. Gains that the study leaves to be designed are designed once and
    kept beside it, for every verb.
    """
    from vsgdesign.pipeline.inner import assess_inner_loops, inner_document, report_inner_loops
    from vsgdesign.pipeline.opening import inner_loops_file

    study = load(study_file, quiet=as_json)
    with nullcontext() if out is None else results_at(out):
        with progress(quiet=as_json) as tell:
            if out is None:
                found = assess_inner_loops(study, what_if=what_if, progress=tell)
            else:
                found = report_inner_loops(study, out, what_if=what_if, progress=tell)
        document = inner_document(found)
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.inner.page import inner_page
        from vsgdesign.report.page.terminal import print_terminal

        kept = inner_loops_file(study_file)
        file = str(kept) if found.designed and kept.exists() else None
        print_terminal(inner_page(document, file=file).blocks)
        if out is not None:
            click.echo(f"report: {out}/report.html")
