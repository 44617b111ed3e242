"""The networks of a study, read or trained, and the comparison and the stress test of the estimators."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack

from vsgdesign.artifacts import staged_folder, write_record
from vsgdesign.artifacts.network_weights import NetworkWeights, read_network_weights
from vsgdesign.errors import ArtifactError, Fault, StudyError
from vsgdesign.execution.executors import How, Progress, one_thread, silent
from vsgdesign.identification.interface import needs_network
from vsgdesign.simulation.estimated import same_period, weights_faults
from vsgdesign.study.parameters.estimator import EstimatorSpec
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:  # the estimator's room is loaded by who trains
    from vsgdesign.estimator.comparison import Comparison
    from vsgdesign.estimator.methods import ComparisonSettings
    from vsgdesign.estimator.recipes import WindowRecipe
    from vsgdesign.estimator.stress import Stress
    from vsgdesign.estimator.trained import TrainedEstimator, TrainedFieldNetwork
    from vsgdesign.report.page.blocks import Page
    from vsgdesign.simulation.scenario.judging import Judgement


def trains(study: Study) -> bool:
    """Whether a controller asks for a network that no file has, so that it has to be trained."""
    spec = study.estimator
    return spec is not None and spec.weights_file is None and any(needs_network(c.estimate) for c in study.controllers)


def make_network(
    study: Study, *, bridge: str | None = None, progress: Progress | None = None
) -> tuple[NetworkWeights | None, TrainedEstimator | None]:
    """Returns the network of a study (None if no controller asks for one) and, if it was trained, how it was trained.

    If the study names a file, the network is read from it. Training windows are taken with the bridge of the run: a
    switched bridge biases samples of v_pcc, and the training data must contain this. Raises StudyError if recipe and
    study do not fit, ArtifactError for a file that is not a network, and the errors of
    :func:`vsgdesign.estimator.specification.train`.
    """
    spec = study.estimator
    if spec is None or not any(needs_network(c.estimate) for c in study.controllers):
        return None, None
    if spec.weights_file is not None:
        return read_network_weights(spec.weights_file), None
    from vsgdesign.estimator.specification import WINDOW_NETWORK, train

    with one_thread():  # the same digits wherever it is trained, and beside whatever
        recipe, size = recipe_of(study, spec, bridge), {name: getattr(spec, name) for name in WINDOW_NETWORK.size}
        trained = train(WINDOW_NETWORK, study, recipe, seed=spec.seed, size=size, progress=progress or silent)
    return trained.weights, trained


def recipe_of(study: Study, spec: EstimatorSpec, bridge: str | None) -> WindowRecipe:
    """The recipe of a training in a run with this bridge. Raises StudyError if it does not fit the study, and
    InfeasibleStudyError without PyTorch."""
    from vsgdesign.estimator.recipes import WINDOW_RECIPES
    from vsgdesign.estimator.trained import require_torch

    recipe = replace(WINDOW_RECIPES.load(spec.recipe), bridge=bridge or study.simulation.bridge)
    check_fit(study, spec, recipe)
    require_torch()
    return recipe


def check_fit(study: Study, spec: EstimatorSpec, recipe: WindowRecipe) -> None:
    """Checks recipe and study before the work starts. Raises StudyError with every fault."""
    faults = []
    if recipe.synchronised and not spec.grid_phase:
        faults.append(
            Fault(
                "estimator.grid_phase",
                "false",
                f"recipe {recipe.name} trains on windows synchronised with the grid's own voltage, which no converter "
                "in the field can measure",
                "Give a recipe with a range of phase, or set grid_phase = true to use the simulator's own phase.",
            )
        )
    from vsgdesign.estimator.recipes import describe_sampling, with_sampling

    sampled = with_sampling(recipe, study.converter)
    for controller in study.controllers:
        period = controller.update_period
        if needs_network(controller.estimate) and period and not same_period(period, sampled.update_period, study):
            faults.append(
                Fault(
                    f"controller {controller.name}.update_period",
                    f"{period:g} s",
                    f"recipe {recipe.name} has windows of {describe_sampling(sampled, study.converter)}",
                    "Leave update_period out: the network answers at the end of every window. Or give the recipe "
                    "samples and sample_interval of that length.",
                )
            )
    if faults:
        raise StudyError(study.name, faults)


def train_weights_file(
    study: Study,
    spec: EstimatorSpec,
    out: str | Path,
    *,
    data: str | Path | None = None,
    report: str | Path | None = None,
    done: Callable[[TrainedEstimator | TrainedFieldNetwork], None] | None = None,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> dict[str, Any]:
    """Trains the network that the recipe of ``spec`` is for, and writes its weights. Returns file, network and training
    in JSON's types.

    ``data`` is a file for the windows or runs that it is trained on; windows are then taken with the bridge of the
    recipe. ``report`` is a folder for results.json, figures and report.html, of the field estimator's network alone.
    ``done`` is given the training. Raises StudyError if ``spec`` has what this network does not have, and the errors of
    :func:`vsgdesign.estimator.specification.train`.
    """
    from vsgdesign.estimator.data_set import check_data_target
    from vsgdesign.estimator.specification import FIELD_NETWORK, WINDOW_NETWORK, specification_of, train

    network = specification_of(spec.recipe)
    given = {name: getattr(spec, name) for name in WINDOW_NETWORK.size}
    faults = [
        Fault(name, str(value), "the network of the field estimator has none", "Leave it out.")
        for name, value in given.items()
        if name not in network.size and value is not None
    ]
    if report is not None and network is not FIELD_NETWORK:
        faults.append(Fault("report", f'"{report}"', "only the recipe field has one", "Leave it out."))
    if faults:
        raise StudyError("estimator", faults)
    _check_places(out, data, report)
    network.file.check_target(out)
    if data is not None:
        check_data_target(data)
    recipe = network.recipes.load(spec.recipe)
    with _report_folder(report, study, spec) as folder:
        trained: Any = train(
            network, study, recipe, seed=spec.seed, size=given, out=data, progress=progress or silent, **how
        )
        document = _trained_document(study, recipe, trained)
        if folder is not None:
            from vsgdesign.report.drawing.figures import write_all
            from vsgdesign.report.estimator.page import field_training_page
            from vsgdesign.report.estimator.training import field_training_figures
            from vsgdesign.report.page.html import print_html

            figures = write_all(field_training_figures(trained), folder / "figures")
            print_html(field_training_page(study.title, trained, figures), folder / "report.html")
            named = {"study": study.name, "study_hash": study.hash, "figures": [figure.name for figure in figures]}
            write_record(folder, named | document, _TRAIN)
        network.file.write(trained.weights, out)
    if done is not None:
        done(trained)
    return {"file": str(out)} | document


def _trained_document(study: Study, recipe: Any, trained: TrainedEstimator | TrainedFieldNetwork) -> dict[str, Any]:
    """Network and training in JSON's types."""
    from vsgdesign.estimator.recipes import sampling_document, with_sampling
    from vsgdesign.estimator.scores import scores_document, verdict
    from vsgdesign.estimator.trained import TrainedEstimator

    if isinstance(trained, TrainedEstimator):
        window = sampling_document(with_sampling(recipe, study.converter), study.converter)
        return network_document(trained.weights) | training_document(trained) | {"window": window}
    return {
        "weights_sha256": trained.weights.hash,
        "data_sha256": trained.weights.data_hash,
        "recipe": recipe.name,
        "seed": trained.weights.seed,
        "converters": [dict(one) for one in trained.weights.converters],
        "features": trained.weights.features,
        "hidden": len(trained.weights.layers.b_1),
        "epochs": len(trained.history["epoch"]),
        "best_epoch": trained.best_epoch,
        "runs": trained.runs,
        "broken_off": trained.broken,
        "cycles": trained.cycles,
        "changes": trained.changes,
        "scores": scores_document(trained.scores),
        "verdict": verdict(trained.scores),
        "timing_s": trained.timing_s,
    }


def network_document(weights: NetworkWeights) -> dict[str, Any]:
    """The description of a network in JSON's types."""
    return {
        "weights_sha256": weights.hash,
        "data_sha256": weights.data_hash,
        "recipe": weights.recipe.get("name"),
        "bridge": weights.recipe.get("bridge"),
        "seed": weights.seed,
        "synchronised": weights.window.synchronised,
        "channels": weights.window.channels,
        "window": {
            "samples": weights.window.samples,
            "sample_interval_s": weights.window.sample_interval,
            "period_s": weights.window.period,
            "cycles": weights.recipe.get("cycles"),
        },
        "hidden": len(weights.network.b_1),
        "trained_on": weights.trained_on,
    }


def training_document(trained: TrainedEstimator) -> dict[str, Any]:
    """How a training went, in JSON's types."""
    return {
        "draws": trained.draws,
        "stop": trained.stop,
        "epochs": trained.epochs,
        "components": trained.components,
        "parts": {
            name: {
                "windows": len(part.truth),
                "mse": part.mse,
                "correlation": dict(zip(("R_g", "L_g"), part.correlation, strict=True)),
                "errors": part.errors,
            }
            for name, part in trained.parts.items()
        },
        "timing_s": trained.timing_s,
    }


def judgement_document(judged: Judgement) -> dict[str, Any]:
    """What an estimate was worth, in JSON's types."""
    return {
        "windows": len(judged.log.status),
        "statuses": judged.statuses,
        "rate_limit": dict(zip(("rate_1_s", "held_s", "of_s"), judged.rate_limit or (None,) * 3, strict=True)),
        "inside_set": None if judged.inside is None else dict(zip(("at_rest", "of_all"), judged.inside, strict=True)),
        "rest": [asdict(one) for one in judged.rest],
        "grid_changes": [asdict(one) for one in judged.changes],
        "with_the_truth": judged.with_the_truth,
        "steps": [asdict(one) for one in judged.steps],
    }


def _check_places(out: str | Path, windows: str | Path | None, report: str | Path | None = None) -> None:
    """Raises StudyError, before the long work, where one result would take the place of another."""
    files = {name: os.path.realpath(path) for name, path in (("out", out), ("windows", windows)) if path is not None}
    faults = []
    if files.get("windows") == files["out"]:
        faults.append(Fault("windows", f'"{windows}"', "is the file of out as well", "Give another file."))
    if report is not None:
        folder = Path(os.path.realpath(report))
        for name, path in files.items():
            if folder in (Path(path), *Path(path).parents):
                problem = f"would replace {name}, which is in it"
                faults.append(Fault("report", f'"{report}"', problem, "Give a folder of its own."))
    if faults:
        raise StudyError("estimator train", faults)


_TRAIN = "vsgdesign estimator train"


@contextmanager
def _report_folder(report: str | Path | None, study: Study, spec: EstimatorSpec) -> Iterator[Path | None]:
    """A folder for a report that appears when everything is done; None without one."""
    if report is None:
        yield None
        return
    own = [spec.recipe] if spec.recipe.endswith(".toml") else []
    with staged_folder(report, _TRAIN, inputs=[*study.input_files, *own]) as folder:
        yield folder


class Asked(TypedDict, total=False):
    """What is asked of a comparison or a stress test."""

    weights: tuple[str, ...]
    """Files of networks to compare."""
    recipes: tuple[str, ...]
    """Names or files of recipes; one network is trained for each. Without networks of either kind, the published
    network and one with noise in its training data are trained."""
    seed: int
    """Of the training."""
    workers: int | None
    """Processes that make the windows: one where it is not said; None: one per core."""
    settings: ComparisonSettings | None
    done: Callable[[Any], None]
    """Is given what was found."""
    progress: Progress | None


class _Kind(NamedTuple):
    """A comparison or a stress test: how it is made, and what is made of it."""

    verb: str
    find: Callable[..., Any]
    document: Callable[[Any], dict[str, Any]]
    figures: Callable[[Any], Any]
    page: Callable[..., Page]


def report_comparison(study: Study, out: str | Path, **asked: Unpack[Asked]) -> dict[str, Any]:
    """Compares methods (:class:`Asked`) and writes results.json, figures and report.html to ``out``. Returns the
    content of results.json.

    The folder appears when everything is done. Raises the errors of
    :func:`vsgdesign.estimator.comparison.compare_methods`, and ArtifactError.
    """
    from vsgdesign.estimator.comparison import compare_methods
    from vsgdesign.estimator.methods import ComparisonSettings
    from vsgdesign.report.estimator.figures import comparison_figures
    from vsgdesign.report.estimator.page import comparison_page

    def document(found: Comparison) -> dict[str, Any]:
        return {
            "accuracy": [vars(one) for one in found.accuracy],
            "disturbances": [vars(one) for one in found.disturbances],
            "grid_steps": [
                {"method": step.method, "scr": step.scr, "delay_s": step.delay, "error": step.error, "t_s": step.t_s}
                for step in found.grid_steps
            ],
        }

    verb = "vsgdesign estimator compare"
    kind = _Kind(verb, compare_methods, document, comparison_figures, comparison_page)
    return _report(kind, study, out, asked.get("settings") or ComparisonSettings(), asked)


def report_stress(study: Study, out: str | Path, **asked: Unpack[Asked]) -> dict[str, Any]:
    """Does the same as :func:`report_comparison` for the stress test."""
    from vsgdesign.estimator.methods import nominal_settings
    from vsgdesign.estimator.stress import STRESS_SETTINGS, stress_methods
    from vsgdesign.report.estimator.figures import stress_figures
    from vsgdesign.report.estimator.page import stress_page

    def document(found: Stress) -> dict[str, Any]:
        names = ("name", "unit", "values")
        axes = [
            {name: getattr(one.axis, name) for name in names} | {"rms": one.rms, "p95": one.p95}
            for one in found.results
        ]
        return {"methods": found.methods, "axes": axes}

    kind = _Kind("vsgdesign estimator stress", stress_methods, document, stress_figures, stress_page)
    return _report(kind, study, out, nominal_settings(asked.get("settings") or STRESS_SETTINGS), asked)


def _report(kind: _Kind, study: Study, out: str | Path, settings: ComparisonSettings, asked: Asked) -> dict[str, Any]:
    from vsgdesign.estimator.methods import runnable_settings
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.page.html import print_html

    tell = asked.get("progress") or silent
    inputs = [*study.input_files, *asked.get("weights", ()), *asked.get("recipes", ())]
    with staged_folder(out, kind.verb, inputs=inputs) as folder:
        # Asked before networks are trained: that nothing can be run is known in a moment.
        runnable_settings(study, settings)
        made = _networks(study, asked, tell)
        found: Any = kind.find(study, made, settings, progress=tell)
        figures = write_all(kind.figures(found), folder / "figures")
        print_html(kind.page(study.title, found, figures), folder / "report.html")
        whole = {"study": study.name, "study_hash": study.hash, "weights": found.weights}
        whole |= {"networks": {name: network_document(one) for name, one in made.items()}}
        whole |= {"settings": vars(found.settings), "left_out": found.left_out} | kind.document(found)
        whole["figures"] = [figure.name for figure in figures]
        if "done" in asked:
            asked["done"](found)
        return write_record(folder, whole, kind.verb)


def _networks(study: Study, asked: Asked, progress: Progress) -> dict[str, NetworkWeights]:
    from vsgdesign.estimator.comparison import train_networks
    from vsgdesign.estimator.recipes import WINDOW_RECIPES

    files, recipes = asked.get("weights", ()), asked.get("recipes", ())
    loaded = [WINDOW_RECIPES.load(recipe) for recipe in recipes]
    found: dict[str, NetworkWeights] = {}
    unfit: list[str] = []
    for path in files:
        weights = read_network_weights(path)
        unfit += [f"  - {path}: {fault}." for fault in weights_faults(study.converter, weights)]
        found[_free(f"Neural, {Path(path).stem}", found)] = weights
    if unfit:
        raise ArtifactError("these weights do not fit the converter of the study:\n" + "\n".join(unfit))
    if files and not recipes:
        return found
    options = {"seed": asked.get("seed", 0), "workers": asked.get("workers", 1)}
    for name, weights in train_networks(study, loaded, **options, progress=progress):
        found[_free(name, found)] = weights
    return found


def _free(name: str, taken: Collection[str]) -> str:
    """The name, numbered where another network has it."""
    return next(one for k in itertools.count(1) if (one := name if k == 1 else f"{name} ({k})") not in taken)
