"""From a study to the result pages of the estimators: the comparison of methods and the stress test."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from vsgdesign.artifacts import staged_folder, write_record
from vsgdesign.artifacts.network_weights import NetworkWeights, read_network_weights
from vsgdesign.errors import ArtifactError
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.parameters.study import Study
from vsgdesign.pipeline.training import network_document
from vsgdesign.simulation.estimated import weights_faults

if TYPE_CHECKING:
    from vsgdesign.estimator.comparison import Comparison
    from vsgdesign.estimator.methods import ComparisonSettings
    from vsgdesign.estimator.stress import Stress

T = TypeVar("T")


def report_comparison(
    study: Study,
    out: str | Path,
    *,
    weights: tuple[str, ...] = (),
    recipes: tuple[str, ...] = (),
    seed: int = 0,
    workers: int | None = 1,
    settings: ComparisonSettings | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Writes results.json, figures and report.html to ``out``. Returns the content of results.json.

    ``weights`` are files of networks to compare. ``recipes`` are names or files of recipes; one network is trained for
    each, with ``seed`` on ``workers`` processes. Without either, the published network and one with noise in its
    training data are trained. The folder appears when everything is done. Raises the errors of
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

    make = (compare_methods, document, comparison_figures, write_comparison_page)
    networks = (weights, recipes, seed, workers)
    settings = settings or ComparisonSettings()
    return _report("vsgdesign estimator compare", study, out, networks, settings, progress, *make)


def report_stress(
    study: Study,
    out: str | Path,
    *,
    weights: tuple[str, ...] = (),
    recipes: tuple[str, ...] = (),
    seed: int = 0,
    workers: int | None = 1,
    settings: ComparisonSettings | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Does the same as :func:`report_comparison` for the stress test."""
    from vsgdesign.estimator.methods import nominal_settings
    from vsgdesign.estimator.stress import STRESS_SETTINGS, stress_methods
    from vsgdesign.report.estimator.figures import stress_figures
    from vsgdesign.report.estimator.page import write_stress_page

    def document(found: Stress) -> dict[str, Any]:
        return {
            "methods": found.methods,
            "axes": [
                {
                    "name": one.axis.name,
                    "unit": one.axis.unit,
                    "values": one.axis.values,
                    "rms": one.rms,
                    "p95": one.p95,
                }
                for one in found.results
            ],
        }

    make = (stress_methods, document, stress_figures, write_stress_page)
    networks = (weights, recipes, seed, workers)
    settings = nominal_settings(settings or STRESS_SETTINGS)
    return _report("vsgdesign estimator stress", study, out, networks, settings, progress, *make)


def _report(
    verb: str,
    study: Study,
    out: str | Path,
    networks: tuple[tuple[str, ...], tuple[str, ...], int, int | None],
    settings: ComparisonSettings,
    progress: Progress | None,
    find: Callable[..., T],
    document: Callable[[T], dict[str, Any]],
    figures_of: Callable[[T], Any],
    write_page: Callable[..., Any],
) -> dict[str, Any]:
    from vsgdesign.estimator.methods import runnable_settings
    from vsgdesign.report.estimator.figures import write_all

    tell = progress or silent
    weights, recipes, *_ = networks
    with staged_folder(out, verb, inputs=[*study.input_files, *weights, *recipes]) as folder:
        # Asked before networks are trained: that nothing can be run is known in a moment.
        runnable_settings(study, settings)
        made = _networks(study, *networks, tell)
        found: Any = find(study, made, settings, progress=tell)
        (folder / "figures").mkdir()
        figures = write_all(figures_of(found), folder / "figures")
        write_page(study.title, found, figures, folder / "report.html")
        whole = {"study": study.name, "study_hash": study.hash, "weights": found.weights}
        whole |= {"networks": {name: network_document(one) for name, one in made.items()}}
        whole |= {"settings": vars(found.settings), "left_out": found.left_out} | document(found)
        whole["figures"] = [figure.name for figure in figures]
        return write_record(folder, whole, verb)


def _networks(
    study: Study, files: tuple[str, ...], recipes: tuple[str, ...], seed: int, workers: int | None, progress: Progress
) -> dict[str, NetworkWeights]:
    from vsgdesign.estimator.comparison import train_networks
    from vsgdesign.estimator.recipes import WINDOW_RECIPES

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
    for name, weights in train_networks(study, loaded, seed=seed, workers=workers, progress=progress):
        found[_free(name, found)] = weights
    return found


def _free(name: str, taken: Collection[str]) -> str:
    """The name, numbered where another network has it."""
    return next(one for k in itertools.count(1) if (one := name if k == 1 else f"{name} ({k})") not in taken)
