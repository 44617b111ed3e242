"""The command line. It contains only the verbs; each verb imports the heavy rooms that it needs."""

from __future__ import annotations

from vsgdesign.execution.signals import signals_end

with signals_end():  # Ctrl-C while modules are loaded is one line, too
    import sys
    from typing import Any

    import click

    from vsgdesign import __version__
    from vsgdesign.cli.common import BRIDGE as _BRIDGE
    from vsgdesign.cli.common import EXIT_IMPOSSIBLE, EXIT_WRONG_INPUT, streams_can_print
    from vsgdesign.cli.common import JSON as _JSON
    from vsgdesign.cli.common import STUDY as _STUDY
    from vsgdesign.cli.common import keeping as _keeping
    from vsgdesign.cli.common import load as _load
    from vsgdesign.cli.common import print_json as _print_json
    from vsgdesign.cli.common import progress as _progress
    from vsgdesign.cli.common import verb as _verb
    from vsgdesign.cli.compare import compare
    from vsgdesign.cli.comply import comply
    from vsgdesign.cli.estimator import estimator
    from vsgdesign.cli.explore import explore
    from vsgdesign.cli.export import export
    from vsgdesign.cli.inner import inner
    from vsgdesign.cli.new import new
    from vsgdesign.cli.survive import survive
    from vsgdesign.cli.table import table
    from vsgdesign.cli.verify import verify
    from vsgdesign.errors import counted


class _Program(click.Group):
    """The verbs. Before a verb begins and after it has ended, a signal ends the process with one line."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        streams_can_print()
        with signals_end():
            return super().main(*args, **kwargs)


@click.group(cls=_Program, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="vsgdesign")
def main() -> None:
    """From a converter's datasheet to a gain schedule for grid-forming control, proven in EMT simulation.

    Exit codes: 0 done, 1 the study asks for something impossible, 2 wrong input, 130 interrupted.
    """


@main.command()
@_STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME]")
@_BRIDGE
@_JSON
@_verb
def run(study_file: str, out: str | None, bridge: str | None, as_json: bool) -> None:
    """Design, simulate and report everything, and write C.

    The folder contains time series, figures, results.json, report.html, gain tables and their C.
    """
    _run(study_file, out, bridge, as_json, report=True)


@main.command()
@_STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME-simulation]")
@_BRIDGE
@_JSON
@_verb
def simulate(study_file: str, out: str | None, bridge: str | None, as_json: bool) -> None:
    """Simulate every controller, and write the time series.

    The folder contains time series and results.json.
    """
    _run(study_file, out, bridge, as_json, report=False)


@main.command()
@_STUDY
@_JSON
@_verb
def design(study_file: str, as_json: bool) -> None:
    """Show operating points, gains, margins, inertia and droop.

    The tables have one row for every controller on every grid of the study.
    """
    from dataclasses import asdict

    from vsgdesign.artifacts.ready import Ready, read_tables
    from vsgdesign.design import design_closed_form, distinct_grids

    study = _on_the_grid_alone(_load(study_file, left_tables=True))
    ready = Ready(tables=read_tables(study))
    known = [spec for spec in study.controllers if spec.schedule != "table" or spec.name in ready.tables]
    missing = [
        f"{spec.name}: its gain table is not built yet. vsgdesign run builds it, vsgdesign table build keeps it."
        for spec in study.controllers
        if spec not in known
    ]
    designs = [design_closed_form(study, spec, grid, ready) for spec in known for grid in distinct_grids(study)]
    if as_json:
        _print_json(
            {
                "study": study.name,
                "hash": study.hash,
                "designs": [
                    asdict(d) | {"gains": d.gains.named(), "inertia_s": d.inertia_s, "droop_W_per_Hz": d.droop_W_per_Hz}
                    for d in designs
                ],
                "missing": missing,
            }
        )
    else:
        from vsgdesign.cli.console.design import design_tables

        design_tables(study, designs, missing)


@main.command()
@_STUDY
@click.option("--evidence/--no-evidence", default=False, help="Also simulate small steps in EMT.  [default: no]")
@_JSON
@_verb
def margins(study_file: str, evidence: bool, as_json: bool) -> None:
    """Print modes and margins over the study's grids.

    The output gives the worst cells, the details of the study's own grids, and which of its limits for margins are
    met.
    """
    from vsgdesign.pipeline import assess_study, stability_document

    study = _on_the_grid_alone(_load(study_file, left_tables=True))
    with _progress(quiet=as_json) as progress:
        document = stability_document(assess_study(study, evidence=evidence, progress=progress))
    if as_json:
        _print_json(document)
        return
    from vsgdesign.cli.console.scenario import stability_tables

    stability_tables(document)


@main.command()
@_STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the report.  [default: out/NAME-stability]")
@click.option("--pdf", is_flag=True, help='Also write report.pdf (needs the extra "pdf").')
@click.option("--explorer/--no-explorer", default=True, help="Also write explorer.html.  [default: yes]")
@_JSON
@_verb
def report(study_file: str, out: str | None, pdf: bool, explorer: bool, as_json: bool) -> None:
    """Write the modes and margins as one page.

    The page contains maps, modes, margins, impedances and EMT results, with CSV files. It shows explorer.html, on
    which one drags the grid.
    """
    from pathlib import Path

    from vsgdesign.pipeline import report_stability

    study = _on_the_grid_alone(_load(study_file, left_tables=True))
    folder = Path("out") / f"{study.name}-stability" if out is None else Path(out)
    with _progress(quiet=as_json) as progress:
        document = report_stability(study, folder, pdf=pdf, explorer=explorer, progress=progress)
    if as_json:
        _print_json(document)
        return
    from vsgdesign.cli.console.scenario import stability_tables

    stability_tables(document)
    click.echo(f"report: {folder / 'report.html'}")


@main.command()
@_STUDY
@click.option(
    "--controller", default=None, metavar="NAME", help="The scheduled controller to prove.  [default: the last one]"
)
@click.option(
    "--scr",
    type=(float, float),
    default=None,
    metavar="LOW HIGH",
    help="Range of SCR.  [default: the table's, else the axes]",
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
    help="Largest number of boxes for the proof.",
)
@_JSON
@_verb
def certify(
    study_file: str,
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
    as_json: bool,
) -> None:
    """Prove stability on a range of grids, or refute it.

    The proof is one Lyapunov function for a range of grids, powers and estimate errors. It also says after which steps
    no limit of the controller acts and, for an angle-damped controller with the limiter "projection", on which grids
    the angle returns while the current is limited.
    """
    from dataclasses import replace

    from vsgdesign.artifacts.ready import Ready, read_tables
    from vsgdesign.certificate import Certificate, certify, region_of, with_steps
    from vsgdesign.certificate.swing import large_signal
    from vsgdesign.pipeline.table import make_tables

    study = _on_the_grid_alone(_load(study_file, left_tables=True))
    named = Ready(tables=read_tables(study))
    spec, region = region_of(study, controller, scr, x_over_r, p_pu, q_pu, error, rate, named, error_z)
    with _progress(quiet=as_json) as progress:
        ready = Ready(tables=make_tables(replace(study, controllers=(spec,)), progress=progress))
        found = certify(study, spec, region, ready=ready, decay=decay, budget=boxes, progress=progress)
        found = with_steps(study, spec, found, ready=ready, budget=boxes, progress=progress)
        swing = large_signal(study, spec, region, ready=ready, budget=boxes, progress=progress)
    if as_json:
        more = {} if swing is None else {"large_signal": swing.as_document()}
        _print_json(found.as_document() | more)
    else:
        from vsgdesign.report.gain_table.words import certificate_text, swing_text

        click.echo(certificate_text(found))
        if swing is not None:
            click.echo(swing_text(swing))
    if not isinstance(found, Certificate):
        sys.exit(EXIT_IMPOSSIBLE)


@main.command()
@_STUDY
@_JSON
@_verb
def validate(study_file: str, as_json: bool) -> None:
    """Check a study and its files, and report all faults at once."""
    from vsgdesign.errors import StudyError
    from vsgdesign.pipeline.named_files import check_named_files
    from vsgdesign.pipeline.opening import check_study

    try:
        study, inner_loops = check_study(study_file)
        check_named_files(study, study_file)
    except StudyError as error:
        if not as_json:
            raise
        faults = [vars(fault) for fault in error.faults]
        _print_json({"valid": False, "source": error.source, "faults": faults})
        sys.exit(EXIT_WRONG_INPUT)
    if as_json:
        document = {"valid": True, "study": study.name, "hash": study.hash}
        _print_json(document | ({"inner_loops": inner_loops} if inner_loops else {}))
    else:
        counts = [(len(study.controllers), "controller"), (len(study.events), "event")]
        shown = ", ".join(counted(count, word) for count, word in counts)
        click.echo(f"{study_file}: valid ({shown})")
        if inner_loops:
            click.echo(inner_loops)


def _warn(text: str) -> None:
    click.echo(f"warning: {text}", err=True)


def _on_the_grid_alone(study: Any) -> Any:
    """A study, with a warning where it has more at the PCC than these models know."""
    if not study.network.plain:
        _warn("[network] is left out: gains, modes and margins are those of the grid alone.")
    return study


def _run(study_file: str, out: str | None, bridge: str | None, as_json: bool, report: bool) -> None:
    from pathlib import Path

    from vsgdesign.pipeline import run_study

    study = _load(study_file, left_tables=not report)
    name = study.name if report else f"{study.name}-simulation"
    folder = Path("out") / name if out is None else Path(out)
    with _keeping(folder):
        with _progress(quiet=as_json) as progress:
            results = run_study(study, folder, bridge=bridge, report=report, progress=progress, warn=_warn)
        if as_json:
            _print_json(results)
        else:
            from vsgdesign.cli.console.scenario import results_tables

            results_tables(results)
            click.echo(f"results: {folder / ('report.html' if report else 'results.json')}")
    _refuse_divergence(results)


def _refuse_divergence(results: dict[str, Any]) -> None:
    """The results are there; still a script has to notice that a part of them is missing."""
    outcomes = {name: controller["outcome"] for name, controller in results["controllers"].items()}
    from vsgdesign.errors import SimulationDivergedError

    diverged = [f"{name}: {one['reason']}" for name, one in outcomes.items() if one["status"] == "diverged"]
    if diverged:
        raise SimulationDivergedError(". ".join(diverged) + ".")


main.add_command(compare)
main.add_command(comply)
main.add_command(estimator)
main.add_command(explore)
main.add_command(export)
main.add_command(inner)
main.add_command(new)
main.add_command(survive)
main.add_command(table)
main.add_command(verify)

if __name__ == "__main__":
    main()
