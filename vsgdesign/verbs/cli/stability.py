"""The verbs that compute with the model of a study: gains, modes and margins, their page, and the proof."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsgdesign.verbs.cli.common import (
    EXIT_IMPOSSIBLE,
    EXPLORER,
    FILE,
    JSON,
    STUDY,
    STUDY_OF_TABLE,
    Real,
    check_study_of,
    echo_aside,
    in_blocks,
    kept_words,
    load,
    print_json,
    progress,
    results_at,
    verb,
)

if TYPE_CHECKING:
    from vsgdesign.execution.executors import How
    from vsgdesign.report.page.blocks import Block


@click.command()
@STUDY
@click.option(
    "--out", default=None, metavar="DIR", help="Also write a page with maps of the power flow into this folder."
)
@JSON
@verb
def design(study_file: str, out: str | None, as_json: bool) -> None:
    """Show power flow, gains, margins, inertia and droop.

    The power flow says where each controller rests with its droops, over the grids and powers of the specification
    (else over the axes of [stability]), and what limits. The other tables have one row for every controller on every
    grid of the study.
    """
    from vsgdesign.design.study_design import design_study
    from vsgdesign.verbs.pipeline.margins import report_design

    study = _on_the_grid_alone(load(study_file, left_tables=True, plants="as one unit"))
    with nullcontext() if out is None else results_at(out):
        found = design_study(study) if out is None else report_design(study, out)
        if as_json:
            print_json(found.document())
            return
        from vsgdesign.report.page.terminal import print_terminal
        from vsgdesign.report.stability.design import design_blocks

        print_terminal(design_blocks(found))
        if out is not None:
            click.echo(f"report: {out}/report.html")


@click.command()
@STUDY
@click.option("--evidence/--no-evidence", default=False, help="Also simulate small steps in EMT.  [default: no]")
@JSON
@verb
def margins(study_file: str, evidence: bool, as_json: bool) -> None:
    """Print modes and margins over the study's grids.

    The output gives the worst cells, the details of the study's own grids, and which of its limits for margins are
    met.
    """
    from vsgdesign.verbs.pipeline import assess_study, stability_document
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.study_tables import with_left_tables

    whole = load(study_file, plants="whole")
    study = with_left_tables(_on_the_grid_alone(as_unit(whole, "vsgdesign margins")), say=echo_aside)
    with progress(quiet=as_json) as tell:
        result = assess_study(study, evidence=evidence, several=whole.plant is not None, progress=tell)
    if as_json:
        print_json(stability_document(result))
        return
    from vsgdesign.report.page.terminal import print_terminal
    from vsgdesign.report.stability.page import terminal_blocks

    print_terminal(terminal_blocks(result))


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the report.  [default: out/NAME-stability]")
@click.option("--pdf", is_flag=True, help="Also write report.pdf.")
@EXPLORER
@JSON
@verb
def report(study_file: str, out: str | None, pdf: bool, explorer: bool, as_json: bool) -> None:
    """Write the modes and margins as one page.

    The page contains maps, modes, margins, impedances and EMT results, with CSV files. It shows explorer.html, on
    which one drags the grid.
    """
    from vsgdesign.verbs.pipeline import report_stability
    from vsgdesign.verbs.pipeline.one_unit import as_unit

    whole = load(study_file, left_tables=True, plants="whole")
    study = replace(_on_the_grid_alone(as_unit(whole, "vsgdesign report")), controllers=whole.controllers)
    folder = Path("out") / f"{study.name}-stability" if out is None else Path(out)
    blocks: list[Block] = []
    with results_at(folder):
        with progress(quiet=as_json) as tell:
            document = report_stability(
                study,
                folder,
                pdf=pdf,
                explorer=explorer and whole.plant is None,
                whole=whole,
                progress=tell,
                show=None if as_json else blocks.extend,
            )
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.page.terminal import print_terminal

        print_terminal(blocks)
        click.echo(f"report: {folder / 'report.html'}")


@click.command()
@FILE
@STUDY_OF_TABLE
@click.option(
    "--model",
    type=click.Choice(["reduced", "full"]),
    default="reduced",
    show_default=True,
    help="What is proved: the power loops with ideal inner loops while the grid moves, or the sampled full-order loop "
    "on every grid that rests.",
)
@click.option(
    "--controller", default=None, metavar="NAME", help="The scheduled controller to prove.  [default: the last one]"
)
@click.option(
    "--scr",
    type=(float, float),
    default=None,
    metavar="LOW HIGH",
    help="Range of SCR, on the basis of the controller's table if it has one.  [default: the table's, else the axes]",
)
@click.option(
    "--x-over-r",
    type=(float, float),
    default=None,
    metavar="LOW HIGH",
    help="Range of X/R.  [default: the table's, else the axes]",
)
@click.option(
    "--p-pu",
    type=(float, float),
    default=None,
    metavar="LOW HIGH",
    help="Range of P in pu.  [default: the table's, else ±0.9]",
)
@click.option(
    "--q-pu",
    type=(float, float),
    default=None,
    metavar="LOW HIGH",
    help="Range of Q in pu.  [default: the table's, else ±0.4]",
)
@click.option(
    "--error",
    type=float,
    default=None,
    help="Relative error of the estimated R_g and of L_g.  [default: the table's, else 0.2]",
)
@click.option(
    "--error-z",
    type=float,
    default=None,
    help="Error of the estimate in any direction, relative to |Z_g|. The larger error counts.  "
    "[default: the table's, else 0]",
)
@click.option(
    "--rate", type=float, default=float("inf"), help="Largest |d ln SCR/dt| and |d ln(X/R)/dt|, 1/s.  [default: inf]"
)
@click.option("--decay", type=float, default=None, help="Decay rate to prove, 1/s.  [default: the largest]")
@click.option(
    "--boxes",
    type=click.IntRange(0),
    default=1_500_000,
    show_default=True,
    help="Largest number of boxes for the proof of the reduced model.",
)
@click.option(
    "--proof",
    default=None,
    metavar="FILE.proof",
    help="File for the boxes and arcs of --model full.  [default: beside the table, none for a study]",
)
@click.option(
    "--moving",
    type=Real(0.0),
    default=0.0,
    metavar="SECONDS",
    help="Time for --model full to prove decay while the gains change, and as much again to look at a lattice of "
    "grids and to size steps there.  [default: 0, none of it]",
)
@in_blocks
@JSON
@verb
def certify(
    file: str,
    study_file: str | None,
    model: str,
    controller: str | None,
    scr: tuple[float, float] | None,
    x_over_r: tuple[float, float] | None,
    p_pu: tuple[float, float] | None,
    q_pu: tuple[float, float] | None,
    error: float | None,
    error_z: float | None,
    rate: float,
    decay: float | None,
    boxes: int,
    proof: str | None,
    moving: float,
    how: How,
    as_json: bool,
) -> None:
    """Prove stability on a range of grids, or refute it.

    The proof is one Lyapunov function for a range of grids, powers and estimate errors. It also says after which steps
    no limit of the controller acts and, for an angle-damped controller with the limiter "projection", on which grids
    the angle returns while the current is limited. Of a plant of equal units there are two proofs, of the units
    together and against each other; with the reduced model each has a function for every place of the grid.

    With --model full it is the sampled full-order loop that is proved, on every grid that rests: processes share the
    work, and an interrupted proof goes on from its finished parts. Its boxes and arcs are kept in a file that "table
    check --proof" checks. With --moving it is asked, too, what the loop does while its gains change; the units of a
    plant then have one estimate, and a file FILE.moving.proof lies beside that of --proof. The exit code is that of
    the first statement.
    """
    from dataclasses import replace

    from vsgdesign.artifacts.proof_file import proof_of
    from vsgdesign.artifacts.ready import Ready, read_tables
    from vsgdesign.certificate import (
        Counterexample,
        beyond_table,
        certify,
        of_a_pair,
        on_basis_of_table,
        region_of,
        step_budget,
        with_steps,
    )
    from vsgdesign.certificate.swing import large_signal
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.study_tables import study_tables, with_left_tables
    from vsgdesign.verbs.pipeline.verify import with_table

    check_study_of(file, study_file)
    whole = load(file if study_file is None else study_file, plants="whole")
    several = whole.plant is not None and len(whole.plant.units) > 1
    if study_file is not None:
        whole, controller = with_table(whole, file, controller)
    study = _on_the_grid_alone(as_unit(whole, "vsgdesign certify"))
    if study_file is None:
        study = with_left_tables(study, say=echo_aside)
    named = Ready(tables=read_tables(study))
    study = on_basis_of_table(study, controller, named)
    spec, region = region_of(study, controller, scr, x_over_r, p_pu, q_pu, error, rate, named, error_z)
    if model == "full":
        if proof is None and study_file is not None:
            proof = str(proof_of(file))
        _certify_full(study, spec, region, decay, several, proof, moving, how, as_json)
        return
    if moving:
        raise click.BadOptionUsage("moving", "--moving asks about the sampled full-order loop: add --model full.")
    with progress(quiet=as_json) as tell:
        ready = study_tables(replace(study, controllers=(spec,)), progress=tell).ready
        prove = of_a_pair if several else certify
        found = prove(study, spec, region, ready=ready, decay=decay, budget=boxes, progress=tell)
        found = with_steps(study, spec, found, ready=ready, budget=step_budget(boxes), progress=tell)
        swing = large_signal(study, spec, region, ready=ready, budget=boxes, progress=tell)
    if as_json:
        more = {} if swing is None else {"large_signal": swing.as_document()}
        beyond = list(beyond_table(region, ready.tables.get(spec.name)))
        more |= {"beyond_table": beyond} if beyond else {}
        print_json(found.as_document() | more)
    else:
        from vsgdesign.report.gain_table.words import certificate_text, swing_text

        for line in beyond_table(region, ready.tables.get(spec.name)):
            click.echo(line)
        click.echo(certificate_text(found))
        if swing is not None:
            click.echo(swing_text(swing))
    apart = None if isinstance(found, Counterexample) else found.differential
    if isinstance(found, Counterexample) or (apart is not None and not apart.certified):
        sys.exit(EXIT_IMPOSSIBLE)


def _certify_full(
    study: Any,
    spec: Any,
    region: Any,
    decay: float | None,
    pair: bool,
    proof: str | None,
    moving: float,
    how: How,
    as_json: bool,
) -> None:
    """Proves the sampled full-order loop, of a ``pair`` units against each other as well, and ends with exit code 1
    where a part of the region is not proved."""
    from vsgdesign.report.gain_table.full_order import full_order_text, moving_text
    from vsgdesign.verbs.pipeline.full_order import WORK, of_changing_gains, place_of, prove_changing, prove_full

    place = place_of(study, spec)
    with results_at(place, lambda: kept_words(place, WORK, "part")), progress(quiet=as_json) as tell:
        found = prove_full(study, spec, region, decay, pair=pair, proof=proof, progress=tell, **how)
        asked = moving > 0.0 and not found.unstable
        other = None if proof is None else of_changing_gains(proof)
        changing = (
            prove_changing(study, spec, region, moving, pair=pair, proof=other, progress=tell, **how) if asked else None
        )
    if as_json:
        more = {} if changing is None else {"moving": changing.as_document()}
        print_json(found.as_document() | more)
    else:
        click.echo(full_order_text(found))
        if changing is not None:
            click.echo(moving_text(changing))
        if proof is not None and not found.unstable:
            click.echo(f"proof: {proof}")
        if other is not None and changing is not None and changing.decay is not None:
            click.echo(f"proof of changing gains: {other}")
    if not found.complete:
        sys.exit(EXIT_IMPOSSIBLE)


def _on_the_grid_alone(study: Any) -> Any:
    """A study, with a warning where it has more at the PCC than these models know."""
    if not study.network.plain:
        click.echo("warning: [network] is left out: gains, modes and margins are those of the grid alone.", err=True)
    return study
