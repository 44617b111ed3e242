"""From a study to the estimators' pages: comparison of methods, and stress."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from vsgdesign.artifacts import staged_folder, write_json
from vsgdesign.artifacts.network_weights import NetworkWeights, read_network_weights
from vsgdesign.artifacts.progress import Progress, silent
from vsgdesign.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.estimator.comparison import Comparison, ComparisonSettings
    from vsgdesign.estimator.stress import Stress

T = TypeVar("T")


def report_comparison(
    study: Study, out: str | Path, *, weights: tuple[str, ...] = (), settings: ComparisonSettings | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Leave results.json, figures and report.html in ``out``; returns the content of results.json.

    ``weights`` are files of networks to compare; without, the published network and one that has seen noise are
    trained. The folder appears when everything is done. Raises as
    :func:`vsgdesign.estimator.comparison.compare_methods`, and ArtifactError.
    """
    from vsgdesign.estimator.comparison import compare_methods
    from vsgdesign.report.estimator_figures import comparison_figures
    from vsgdesign.report.estimator_page import write_comparison_page

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
    return _report(study, out, weights, settings, progress, *make)


def report_stress(
    study: Study, out: str | Path, *, weights: tuple[str, ...] = (), settings: ComparisonSettings | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The same for the stress page."""
    from vsgdesign.estimator.stress import stress_methods
    from vsgdesign.report.estimator_figures import stress_figures
    from vsgdesign.report.estimator_page import write_stress_page

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

    return _report(study, out, weights, settings, progress, stress_methods, document, stress_figures, write_stress_page)


def _report(
    study: Study, out: str | Path, weights: tuple[str, ...], settings: ComparisonSettings | None,
    progress: Progress | None, find: Callable[..., T], document: Callable[[T], dict[str, Any]],
    figures_of: Callable[[T], Any], write_page: Callable[..., Any],
) -> dict[str, Any]:  # fmt: skip
    from vsgdesign.report.estimator_figures import write_all

    tell = progress or silent
    with staged_folder(out) as folder:
        found: Any = find(study, _networks(study, weights, tell), settings, progress=tell)
        (folder / "figures").mkdir()
        figures = write_all(figures_of(found), folder / "figures")
        write_page(study.title, found, figures, folder / "report.html")
        whole = {"study": study.name, "study_hash": study.hash, "weights": found.weights}
        whole |= {"settings": vars(found.settings)} | document(found)
        whole["figures"] = [figure.name for figure in figures]
        write_json(folder / "results.json", whole)
    return whole


def _networks(study: Study, files: tuple[str, ...], progress: Progress) -> dict[str, NetworkWeights]:
    if files:
        return {f"Neural, {Path(path).stem}": read_network_weights(path) for path in files}
    from vsgdesign.estimator.comparison import train_networks

    return train_networks(study, progress=progress)
