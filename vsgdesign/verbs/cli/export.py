"""Verbs that write what the controller needs: C99 and ONNX."""

from __future__ import annotations

from typing import Any

import click

from vsgdesign.errors import counted
from vsgdesign.verbs.cli.common import JSON, load, print_json, results_at, verb


@click.group()
def export() -> None:
    """Write the controller as C99, or the network as ONNX."""


@export.command(name="c")
@click.argument("table_file", metavar="TABLE.json", type=click.Path())
@click.option(
    "--weights",
    default=None,
    metavar="W.json",
    type=click.Path(),
    help="Also write the network that estimates the impedance.",
)
@click.option("--out", required=True, metavar="FOLDER", help="Folder to write. A folder with other files is refused.")
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
    table_file: str,
    weights: str | None,
    out: str,
    study_file: str | None,
    v_limit: float | None,
    i_limit: float | None,
    grid_phase: bool,
    estimator: str | None,
    rate: float | None,
    as_json: bool,
) -> None:
    """Write C99 of the scheduler, the controller and the estimator.

    The folder also contains a self-test, and the hashes of everything that it was made from.
    """
    from vsgdesign.export import export_c_files

    study = None if study_file is None else load(study_file)
    changes: dict[str, Any] = {} if rate is None else {"rate": rate}
    with results_at(out):
        made = export_c_files(
            table_file,
            out,
            weights=weights,
            study=study,
            v_limit=v_limit,
            i_limit=i_limit,
            grid_phase=grid_phase,
            estimator=estimator,
            **changes,
        )
        if as_json:
            print_json({"folder": str(made.folder)} | made.manifest)
            return
        files = counted(len(made.manifest["files"]), "file")
        click.echo(f"{made.folder}: {files} of table {made.manifest['table']['name']}")
        click.echo(f"next: make -C {made.folder} test")


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
