"""The files that a study names. They are opened before the work, and all faults in them are reported at once."""

from __future__ import annotations

from vsgdesign.artifacts.network_weights import read_network_weights
from vsgdesign.artifacts.ready import read_named_table
from vsgdesign.errors import ArtifactError, Fault, StudyError
from vsgdesign.identification.registry import needs_network
from vsgdesign.parameters.study import Study


def check_named_files(study: Study, source: str) -> None:
    """Opens gain tables, network weights and the recipe of a study and checks whether they fit it.

    Raises StudyError for ``source`` with every fault: a file that cannot be read or has the wrong kind, a table for
    another converter, and weights or a recipe that do not fit the windows of a controller.
    """
    faults: list[Fault] = []
    for k, spec in enumerate(study.controllers):
        try:
            read_named_table(study, spec)
        except ArtifactError as error:
            faults.append(_fault(f"controllers[{k}].table", str(spec.table_file), error))
    faults += _estimator_faults(study)
    if faults:
        raise StudyError(source, faults)


def _estimator_faults(study: Study) -> list[Fault]:
    spec = study.estimator
    if spec is None:
        return []
    if spec.weights_file is None:
        return _recipe_faults(study, spec.recipe)
    field = "estimator.weights"
    try:
        weights = read_network_weights(spec.weights_file)
    except ArtifactError as error:
        return [_fault(field, spec.weights_file, error)]
    from vsgdesign.simulation.estimated import installed_weights

    faults = []
    for controller in study.controllers:
        if not needs_network(controller.estimate):
            continue
        try:
            installed_weights(study, controller, weights)
        except ArtifactError as error:
            faults.append(_fault(field, spec.weights_file, error))
    return faults


def _recipe_faults(study: Study, recipe: str) -> list[Fault]:
    from vsgdesign.estimator.recipes import WINDOW_RECIPES
    from vsgdesign.pipeline.training import check_fit

    try:
        made_of = WINDOW_RECIPES.load(recipe)
    except StudyError as error:
        return [
            Fault(f"estimator.recipe: {fault.field}", fault.value, fault.problem, fault.advice)
            for fault in error.faults
        ]
    if study.estimator is not None and any(needs_network(spec.estimate) for spec in study.controllers):
        try:
            check_fit(study, study.estimator, made_of)
        except StudyError as error:
            return list(error.faults)
    return []


def _fault(field: str, file: str, error: ArtifactError) -> Fault:
    """The error's text as what is wrong with the file, on one line."""
    text = " ".join(line.strip().removeprefix("- ") for line in str(error).splitlines())
    return Fault(field, f'"{file}"', text.removeprefix(f"{file}: ").removesuffix("."))
