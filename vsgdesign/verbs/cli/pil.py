"""The verb that runs the exported controller in QEMU, with the circuit of its study."""

from __future__ import annotations

import click

from vsgdesign.verbs.cli.common import FILE, JSON, STUDY_OF_TABLE, Real, print_json, progress, results_at, verb
from vsgdesign.verbs.cli.export import CONTROLLER, unit_asked


@click.command()
@FILE
@CONTROLLER
@STUDY_OF_TABLE
@click.option(
    "--core",
    type=click.Choice(["m4", "m7"]),
    default="m4",
    show_default=True,
    help="Cortex-M4F or Cortex-M7, QEMU's machines mps2-an386 and mps2-an500.",
)
@click.option(
    "--math",
    type=click.Choice(["printed", "library"]),
    default="printed",
    show_default=True,
    help="Sine, cosine and angle as printed into the export, or of each toolchain's C library.",
)
@click.option(
    "--duration",
    type=Real(0.0, min_open=True),
    default=None,
    metavar="S",
    help="Simulated time, s.  [default: that of the study]",
)
@click.option("--out", default=None, metavar="DIR", help="Also write report.html, results.json and series.csv there.")
@JSON
@verb
def pil(
    file: str,
    controller: str | None,
    study_file: str | None,
    core: str,
    math: str,
    duration: float | None,
    out: str | None,
    as_json: bool,
) -> None:
    """Run the exported firmware in QEMU, in the loop with its study.

    The circuit of the study is simulated here (processor in the loop). The same controller is compiled for this
    machine, and every bit of both is compared. The instructions of a sample are counted; they are no cycles.
    """
    from contextlib import nullcontext

    from vsgdesign.verbs.pipeline.export import run_processor

    with nullcontext() if out is None else results_at(out):
        unit, study = unit_asked(file, study_file, controller)
        with progress(quiet=as_json) as tell:
            found = run_processor(
                unit,
                study,
                core=core,
                math=math,
                duration=duration,
                out=out,
                inputs=(file, *study.input_files),
                progress=tell,
            )
        document = found.document()
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.page.terminal import print_terminal
        from vsgdesign.report.processor import processor_page

        print_terminal(processor_page(document).blocks)
        if out is not None:
            click.echo(f"report: {out}/report.html")
