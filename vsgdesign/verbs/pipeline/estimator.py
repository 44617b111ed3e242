"""From a study to the result pages of the estimators: the comparison of methods and the stress test."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack

from vsgdesign.artifacts import staged_folder, write_record
from vsgdesign.artifacts.network_weights import NetworkWeights, read_network_weights
from vsgdesign.errors import ArtifactError
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.simulation.estimated import weights_faults
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.training import network_document

if TYPE_CHECKING:
    from vsgdesign.estimator.comparison import Comparison
    from vsgdesign.estimator.methods import ComparisonSettings
    from vsgdesign.estimator.stress import Stress


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
    write_page: Callable[..., Any]


def report_comparison(study: Study, out: str | Path, **asked: Unpack[Asked]) -> dict[str, Any]:
    """Compares methods (:class:`Asked`) and writes results.json, figures and report.html to ``out``. Returns the
    content of results.json.

    The folder appears when everything is done. Raises the errors of
    :func:`vsgdesign.estimator.comparison.compare_methods`, and ArtifactError.
    """
    from vsgdesign.estimator.comparison import compare_methods
    from vsgdesign.estimator.methods import ComparisonSettings
    from vsgdesign.report.estimator.figures import comparison_figures
    from vsgdesign.report.estimator.page import write_comparison_page

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
    kind = _Kind(verb, compare_methods, document, comparison_figures, write_comparison_page)
    return _report(kind, study, out, asked.get("settings") or ComparisonSettings(), asked)


def report_stress(study: Study, out: str | Path, **asked: Unpack[Asked]) -> dict[str, Any]:
    """Does the same as :func:`report_comparison` for the stress test."""
    from vsgdesign.estimator.methods import nominal_settings
    from vsgdesign.estimator.stress import STRESS_SETTINGS, stress_methods
    from vsgdesign.report.estimator.figures import stress_figures
    from vsgdesign.report.estimator.page import write_stress_page

    def document(found: Stress) -> dict[str, Any]:
        names = ("name", "unit", "values")
        axes = [
            {name: getattr(one.axis, name) for name in names} | {"rms": one.rms, "p95": one.p95}
            for one in found.results
        ]
        return {"methods": found.methods, "axes": axes}

    kind = _Kind("vsgdesign estimator stress", stress_methods, document, stress_figures, write_stress_page)
    return _report(kind, study, out, nominal_settings(asked.get("settings") or STRESS_SETTINGS), asked)


def _report(kind: _Kind, study: Study, out: str | Path, settings: ComparisonSettings, asked: Asked) -> dict[str, Any]:
    from vsgdesign.estimator.methods import runnable_settings
    from vsgdesign.report.drawing.files import write_all

    tell = asked.get("progress") or silent
    inputs = [*study.input_files, *asked.get("weights", ()), *asked.get("recipes", ())]
    with staged_folder(out, kind.verb, inputs=inputs) as folder:
        # Asked before networks are trained: that nothing can be run is known in a moment.
        runnable_settings(study, settings)
        made = _networks(study, asked, tell)
        found: Any = kind.find(study, made, settings, progress=tell)
        figures = write_all(kind.figures(found), folder / "figures")
        kind.write_page(study.title, found, figures, folder / "report.html")
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
