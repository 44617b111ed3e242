"""The estimators by the names that a study or a comparison can select."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from vsgdesign.errors import Fault, StudyError
from vsgdesign.identification.interface import Estimator, EstimatorKind, Installation

GUESS_SCR = 6.3
"""Short-circuit ratio (on the reactance, X/R 1) with which estimators begin if nothing better is known. It is the
geometric mean of 2 and 20."""


def _later(module: str, name: str) -> Callable[[Installation], Estimator]:
    """Builds an estimator of a module here that is imported for the first one: a controller has one of them, and all
    imports together take longer than those of the scheduler."""

    def build(at: Installation) -> Estimator:
        return getattr(import_module(f"vsgdesign.identification.{module}"), name)(at)

    return build


ESTIMATORS: dict[str, EstimatorKind] = {
    "constant": EstimatorKind("a constant guess", _later("classical", "ConstantGuess")),
    "two_windows": EstimatorKind("two windows about a step", _later("classical", "TwoWindows")),
    "rls": EstimatorKind("recursive least squares", _later("recursive", "RecursiveLeastSquares")),
    "kalman": EstimatorKind("the extended Kalman filter", _later("recursive", "ExtendedKalmanFilter")),
    "injection": EstimatorKind("the injected line", _later("classical", "Injection")),
    "prbs": EstimatorKind("the pseudo-random sequence", _later("pseudo_random", "PseudoRandomSequence")),
    "field": EstimatorKind("the field estimator", _later("field", "field_estimator"), by_sample=True, in_c=True),
    "field_network": EstimatorKind(
        "the field estimator with its network",
        _later("field", "field_network_estimator"),
        by_sample=True,
        field_network=True,
        in_c=True,
    ),
    "neural": EstimatorKind("the network", _later("neural", "installed_network"), trained=True, in_c=True),
}
"""Every estimator by its name in a study. A new estimator is one more entry: the study reader, the simulation and the
comparison use this table alone."""


def estimator_kind(name: str) -> EstimatorKind:
    """The estimator of this name. Raises StudyError with the known names for an unknown one."""
    kind = ESTIMATORS.get(name)
    if kind is None:
        raise StudyError("estimator", [Fault("estimate", name, "unknown", f"Known: {', '.join(ESTIMATORS)}.")])
    return kind


def needs_network(name: str) -> bool:
    """Whether the value of ``estimate`` in a study needs trained weights. ``truth`` and unknown names do not."""
    kind = ESTIMATORS.get(name)
    return kind is not None and kind.trained


def samples_itself(name: str) -> bool:
    """Whether the value of ``estimate`` in a study is an estimator that takes every sample of the controller."""
    kind = ESTIMATORS.get(name)
    return kind is not None and kind.by_sample


def why_no_c(controller: str, estimate: str) -> str:
    """A sentence for a controller whose estimator has no C. It is empty if there is C or no estimator is used."""
    kind = ESTIMATORS.get(estimate)
    if kind is None or kind.in_c:
        return ""
    return (
        f"{controller}: there is no C for {kind.title} yet. The exported C has the scheduler without an estimator; it "
        "takes estimates from yours (vsg_update_estimate)."
    )


def build_estimator(name: str, at: Installation) -> Estimator:
    """Builds the estimator of this name for an installation.

    Raises StudyError for an unknown name, and ArtifactError if the estimator cannot be built for the installation.
    """
    return estimator_kind(name).build(at)
