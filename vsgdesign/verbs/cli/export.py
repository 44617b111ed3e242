"""Verbs that write the controller for other tools, C99, ONNX and wrappers of the exported C, and the verb that runs it
in QEMU with the circuit of its study.
"""

from __future__ import annotations

import shlex
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from vsgdesign.errors import counted
from vsgdesign.verbs.cli.common import (
    FILE,
    JSON,
    STUDY_OF_TABLE,
    Real,
    check_study_of,
    echo_aside,
    is_table,
    load,
    print_json,
    progress,
    results_at,
    verb,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from vsgdesign.export import Exported, ExportedC, Unit
    from vsgdesign.study.parameters.study import Study

CONTROLLER = click.option(
    "--controller", default=None, metavar="NAME", help="The controller of the study.  [default: the last one]"
)
OUT = click.option(
    "--out", required=True, metavar="FOLDER", help="Folder to write. A folder with other files is refused."
)
VARIANT = click.option(
    "--variant",
    type=click.Choice(["controller", "reference"]),
    default="controller",
    show_default=True,
    help="The whole controller, with the bridge voltage as output, or the power loops alone, with V, theta and omega.",
)


def unit_asked(
    file: str, study_file: str | None, controller: str | None, rate: float | None = None
) -> tuple[Unit, Study]:
    """The controller that the arguments of a verb name, and its study."""
    from vsgdesign.verbs.pipeline.export import unit_of_files
    from vsgdesign.verbs.pipeline.one_unit import as_unit

    check_study_of(file, study_file)
    table = is_table(file)
    study = load(file if study_file is None else study_file, left_tables=not table, plants="whole")
    alone = as_unit(study, "export")
    with progress(quiet=False) as tell:
        unit = unit_of_files(study, file if table else None, controller, rate=rate, progress=tell, say=echo_aside)
    for note in unit.notes:
        echo_aside(note)
    return unit, alone


@click.group()
def export() -> None:
    """Write the controller for another tool."""


@export.command(name="c")
@FILE
@click.option(
    "--weights",
    default=None,
    metavar="W.json",
    type=click.Path(),
    help="Also write the network that estimates the impedance.",
)
@OUT
@CONTROLLER
@click.option(
    "--study",
    "study_file",
    default=None,
    metavar="STUDY.toml",
    help="Refuse the table if it belongs to another study, and take the study's current limiter.",
)
@click.option(
    "--v-limit",
    type=float,
    default=None,
    metavar="V",
    help="Full scale of the voltage sensors.  [default: 4 rated peaks]",
)
@click.option(
    "--i-limit",
    type=float,
    default=None,
    metavar="A",
    help="Full scale of the current sensors.  [default: 4 rated peaks]",
)
@click.option(
    "--grid-phase",
    is_flag=True,
    help="The controller knows the phase of the grid: windows start at it, as in the training.",
)
@click.option(
    "--estimator",
    type=click.Choice(["field", "field_network", "none"]),
    default=None,
    help="Also write the field estimator for the converter of --study, or not.  [default: as the study's controllers]",
)
@click.option(
    "--rate",
    type=float,
    default=None,
    metavar="1/s",
    help="Largest rate of change of SCR and R/X.  [default: certified]",
)
@JSON
@verb
def c(
    file: str,
    weights: str | None,
    out: str,
    controller: str | None,
    study_file: str | None,
    v_limit: float | None,
    i_limit: float | None,
    grid_phase: bool,
    estimator: str | None,
    rate: float | None,
    as_json: bool,
) -> None:
    """Write C99 of the scheduler, the controller and the estimator.

    The folder also contains a self-test, and the hashes of everything that it was made from. Of a study, or of a table
    with --study and --controller, it also has the controller with its ports, at rest at the operating point of the
    study.
    """
    from vsgdesign.export import export_c_files
    from vsgdesign.export.c_code import export_unit_c

    if not is_table(file) or controller is not None:
        of_tables = {"--weights": weights, "--v-limit": v_limit, "--i-limit": i_limit, "--estimator": estimator}
        given = [name for name, value in of_tables.items() if value is not None] + ["--grid-phase"] * grid_phase
        if given:
            raise click.UsageError(f"{', '.join(given)}: of a TABLE.json alone; a controller of a study has its own")
        with results_at(out):
            unit, of = unit_asked(file, study_file, controller, rate)
            made = export_unit_c(unit, out, inputs=(file, *of.input_files))
            _show(made, f"controller {unit.controller} of study {of.name}", as_json, tested=True)
        return
    study = None if study_file is None else load(study_file, plants="as one unit")
    changes: dict[str, Any] = {} if rate is None else {"rate": rate}
    with results_at(out):
        made = export_c_files(
            file,
            out,
            weights=weights,
            study=study,
            v_limit=v_limit,
            i_limit=i_limit,
            grid_phase=grid_phase,
            estimator=estimator,
            **changes,
        )
        _show(made, f"table {made.manifest['table']['name']}", as_json, tested=True)


def _show(made: Exported | ExportedC, of: str, as_json: bool, tested: bool = False) -> None:
    """What was written, and the command that tests it if there is one; or its manifest as JSON."""
    if as_json:
        print_json({"folder": str(made.folder)} | made.manifest)
        return
    click.echo(f"{made.folder}: {counted(len(made.manifest['files']), 'file')} of {of}")
    if tested:
        click.echo(f"next: make -C {shlex.quote(str(made.folder))} test")


@export.command()
@click.argument("weights_file", metavar="W.json", type=click.Path())
@click.option("--out", required=True, metavar="FILE.onnx", help="File to write.")
@click.option("--double", is_flag=True, help="Use double instead of single precision.")
@verb
def onnx(weights_file: str, out: str, double: bool) -> None:
    """Write the network that estimates the impedance as ONNX.

    Scaling is included: the inputs are V and A, the outputs ohm and henry.
    """
    from vsgdesign.export.onnx_model import export_onnx

    with results_at(out):
        digest = export_onnx(weights_file, out, double=double)
        click.echo(f"{out}: of weights {digest[:12]}")


def asked_for(run: Callable[..., None]) -> Callable[..., None]:
    """The arguments of every verb that writes a controller of a study or of a table for another tool."""
    for argument in (STUDY_OF_TABLE, CONTROLLER, OUT, FILE):
        run = argument(run)
    return run


def _wrap(
    write: Callable[..., Exported],
    *,
    file: str,
    study_file: str | None,
    controller: str | None,
    out: str,
    as_json: bool,
) -> None:
    """Writes a wrapper of the controller that the arguments name, and says what was written."""
    with results_at(out):
        unit, study = unit_asked(file, study_file, controller)
        made = write(unit, out, inputs=(file, *study.input_files))
        for sentence in made.said:
            echo_aside(sentence)
        _show(made, f"controller {unit.controller} of study {study.name}", as_json)


@export.command()
@asked_for
@VARIANT
@click.option("--fmi", type=click.Choice(["3", "2"]), default="3", show_default=True, help="Version of FMI.")
@JSON
@verb
def fmu(variant: str, fmi: str, **asked: Any) -> None:
    """Write a controller as an FMU (FMI 3.0 or 2.0).

    The file NAME.fmu has sources, and binaries for Linux and, where mingw is installed, for Windows.
    """
    from vsgdesign.export import export_fmu

    _wrap(partial(export_fmu, variant=variant, version=fmi), **asked)


@export.command()
@asked_for
@VARIANT
@JSON
@verb
def dll(variant: str, **asked: Any) -> None:
    """Write a controller as a DLL (IEEE/CIGRE TB 958).

    The folder has the sources, a library for Linux and, where mingw is installed, one for Windows.
    """
    from vsgdesign.export import export_dll

    _wrap(partial(export_dll, variant=variant), **asked)


@export.command()
@asked_for
@VARIANT
@JSON
@verb
def simulink(variant: str, **asked: Any) -> None:
    """Write a controller for MATLAB, Simulink and Octave.

    The folder has the table as a MAT file and as a script, a MEX function, an S-function and the buses of its ports.
    """
    from vsgdesign.export import export_simulink

    _wrap(partial(export_simulink, variant=variant), **asked)


@export.command()
@asked_for
@VARIANT
@JSON
@verb
def plecs(variant: str, **asked: Any) -> None:
    """Write a controller for PLECS.

    The folder has the text of a C-Script block, the sources, and libraries for the DLL block.
    """
    from vsgdesign.export import export_plecs

    _wrap(partial(export_plecs, variant=variant), **asked)


@export.command()
@asked_for
@VARIANT
@JSON
@verb
def modelica(variant: str, **asked: Any) -> None:
    """Write a controller for Modelica.

    The folder has the table in Modelica alone, the controller as a block of external C, and the C.
    """
    from vsgdesign.export import export_modelica

    _wrap(partial(export_modelica, variant=variant), **asked)


@export.command()
@asked_for
@JSON
@verb
def firmware(**asked: Any) -> None:
    """Write a controller as a project for Cortex-M4F and M7.

    The folder has start-up, linker scripts, empty drivers with their contract, and a self-test for QEMU.
    """
    from vsgdesign.export import export_firmware

    _wrap(export_firmware, **asked)


@export.command()
@asked_for
@JSON
@verb
def sunspec(**asked: Any) -> None:
    """Map the values of a controller to SunSpec's models.

    The file sunspec.json has every point of models 702, 704, 711, 712 and 713 and of the proposed 64416, with a value
    or with the reason why there is none. The map is a proposal.
    """
    from vsgdesign.export import export_sunspec

    _wrap(export_sunspec, **asked)


@export.command(name="all")
@asked_for
@JSON
@verb
def all_kinds(as_json: bool, **asked: Any) -> None:
    """Write a controller in every form, each in a folder of its own."""
    from vsgdesign.export import export_all

    def write(unit: Unit, folder: str, *, inputs: tuple[str, ...]) -> Exported:
        with progress(quiet=as_json) as tell:
            return export_all(unit, folder, inputs=inputs, progress=tell)

    _wrap(write, as_json=as_json, **asked)


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
