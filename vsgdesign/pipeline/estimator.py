"""From a study to the estimators' pages: comparison of methods, and stress."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts import staged_folder, write_json
from vsgdesign.artifacts.network_weights import NetworkWeights, read_network_weights
from vsgdesign.artifacts.progress import Progress, silent
from vsgdesign.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.estimator.comparison import ComparisonSettings


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
    from vsgdesign.report.estimator_figures import comparison_figures, write_all
    from vsgdesign.report.estimator_page import write_comparison_page

    tell = progress or silent
    with staged_folder(out) as folder:
        found = compare_methods(study, _networks(study, weights, tell), settings, progress=tell)
        (folder / "figures").mkdir()
        figures = write_all(comparison_figures(found), folder / "figures")
        write_comparison_page(study.title, found, figures, folder / "report.html")
        document = {
            "study": study.name,
            "study_hash": study.hash,
            "weights": found.weights,
            "settings": vars(found.settings),
            "accuracy": [vars(one) for one in found.accuracy],
            "disturbances": [vars(one) for one in found.disturbances],
            "grid_steps": [
                {"method": step.method, "scr": step.scr, "delay_s": step.delay, "error": step.error, "t_s": step.t_s}
                for step in found.grid_steps
            ],
            "figures": [figure.name for figure in figures],
        }
        write_json(folder / "results.json", document)
    return document


def report_stress(
    study: Study, out: str | Path, *, weights: tuple[str, ...] = (), settings: ComparisonSettings | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The same for the stress page."""
    from vsgdesign.estimator.stress import stress_methods
    from vsgdesign.report.estimator_figures import stress_figures, write_all
    from vsgdesign.report.estimator_page import write_stress_page

    tell = progress or silent
    with staged_folder(out) as folder:
        found = stress_methods(study, _networks(study, weights, tell), settings, progress=tell)
        (folder / "figures").mkdir()
        figures = write_all(stress_figures(found), folder / "figures")
        write_stress_page(study.title, found, figures, folder / "report.html")
        document = {
            "study": study.name,
            "study_hash": study.hash,
            "weights": found.weights,
            "settings": vars(found.settings),
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
            "figures": [figure.name for figure in figures],
        }
        write_json(folder / "results.json", document)
    return document


def _networks(study: Study, files: tuple[str, ...], progress: Progress) -> dict[str, NetworkWeights]:
    if files:
        return {f"Neural, {Path(path).stem}": read_network_weights(path) for path in files}
    from vsgdesign.estimator.comparison import train_networks

    return train_networks(study, progress=progress)
