"""Everything that a run would refuse, found without a simulation: the functions of a run, up to its first sample."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from vsgdesign.artifacts.guarded_file import check_folder_target
from vsgdesign.artifacts.network_weights import read_network_weights
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.identification.registry import needs_network
from vsgdesign.simulation.lanes.beforehand import told_beforehand
from vsgdesign.simulation.scenario.checking import check_scenario
from vsgdesign.simulation.units.scenario import check_plant_run
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.estimators import recipe_of, trains
from vsgdesign.verbs.pipeline.one_unit import as_one_converter
from vsgdesign.verbs.pipeline.opening import KeptInnerLoops, check_named_files, check_possible, check_study
from vsgdesign.verbs.pipeline.run import export_tables


def check_file(
    study_file: str | Path, deep: bool = False, out: str | Path | None = None
) -> tuple[Study, str, list[str]]:
    """The study of a file, a sentence on its inner loops and, with ``deep``, what a run would warn of. Nothing is
    designed that is kept. Raises the errors of :func:`vsgdesign.verbs.pipeline.opening.check_study` and
    :func:`check_deep`."""
    study, inner_loops = check_study(study_file)
    check_named_files(study, str(study_file))
    check_possible(study)
    return study, inner_loops, check_deep(study_file, out)[1] if deep else []


def check_deep(study_file: str | Path, out: str | Path | None = None) -> tuple[Study, list[str]]:
    """The study of a file, and what a run of it would warn of.

    Inner loops that are not designed yet are designed, which takes seconds, and not kept. A gain table that is not
    built yet counts with the closed form of its structure, and a network that is not trained yet as the true grid.
    Raises the error with which :func:`vsgdesign.verbs.pipeline.run.run_study` would end before its first sample, or
    while it writes C.
    """
    study = load_study(study_file, KeptInnerLoops(Path(study_file), keep=False))
    check_named_files(study, str(study_file))
    check_folder_target(Path("out") / study.name if out is None else out, "vsgdesign run", study.input_files)
    study = as_one_converter(study)
    if study.plant is not None:
        return study, check_plant_run(
            _without_designs(study, untrained=False), Ready(tables=read_tables(plant_timeline(study).units[0]))
        )
    untrained, spec = trains(study), study.estimator
    if untrained and spec is not None:
        recipe_of(study, spec, None)
    network = (
        None if untrained or spec is None or spec.weights_file is None else read_network_weights(spec.weights_file)
    )
    ready = Ready(tables=read_tables(study), network=network)
    designed = _without_designs(study, untrained)
    said = [*told_beforehand(designed, ready, run=False), *check_scenario(designed, ready)]
    with TemporaryDirectory(prefix="vsgdesign-") as folder:
        export_tables(study, ready, Path(folder), warn=said.append)
    return study, said


def _without_designs(study: Study, untrained: bool) -> Study:
    """The study with the closed form in place of tables to be designed, and the truth in place of a network."""
    controllers = []
    for one in study.controllers:
        if one.schedule == "table" and one.table_file is None:
            one = replace(one, schedule="closed_form")
        if untrained and needs_network(one.estimate):
            one = replace(one, estimate="truth")
        controllers.append(one)
    return replace(study, controllers=tuple(controllers))
