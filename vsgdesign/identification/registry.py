"""The estimators by the names that a study or a comparison can select."""

from __future__ import annotations

from vsgdesign.errors import Fault, StudyError
from vsgdesign.identification.constant import ConstantGuess
from vsgdesign.identification.field import field_estimator, field_network_estimator
from vsgdesign.identification.injection import Injection
from vsgdesign.identification.interface import Estimator, EstimatorKind, Installation
from vsgdesign.identification.kalman import ExtendedKalmanFilter
from vsgdesign.identification.neural import installed_network
from vsgdesign.identification.pseudo_random import PseudoRandomSequence
from vsgdesign.identification.recursive import RecursiveLeastSquares
from vsgdesign.identification.two_windows import TwoWindows

GUESS_SCR = 6.3
"""Short-circuit ratio (on the reactance, X/R 1) with which estimators begin if nothing better is known. It is the
geometric mean of 2 and 20."""

ESTIMATORS: dict[str, EstimatorKind] = {
    "constant": EstimatorKind("a constant guess", ConstantGuess),
    "two_windows": EstimatorKind("two windows about a step", TwoWindows),
    "rls": EstimatorKind("recursive least squares", RecursiveLeastSquares),
    "kalman": EstimatorKind("the extended Kalman filter", ExtendedKalmanFilter),
    "injection": EstimatorKind("the injected line", Injection),
    "prbs": EstimatorKind("the pseudo-random sequence", PseudoRandomSequence),
    "field": EstimatorKind("the field estimator", field_estimator, by_sample=True, in_c=True),
    "field_network": EstimatorKind(
        "the field estimator with its network", field_network_estimator, by_sample=True, field_network=True, in_c=True
    ),
    "neural": EstimatorKind("the network", installed_network, trained=True, in_c=True),
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
