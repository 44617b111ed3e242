"""The estimators by name: what a study can ask for, and what is compared."""

from __future__ import annotations

from vsgdesign.errors import Fault, StudyError
from vsgdesign.identification.constant import ConstantGuess
from vsgdesign.identification.injection import Injection
from vsgdesign.identification.interface import Estimator, EstimatorKind, Installation
from vsgdesign.identification.kalman import ExtendedKalmanFilter
from vsgdesign.identification.neural import installed_network
from vsgdesign.identification.pseudo_random import PseudoRandomSequence
from vsgdesign.identification.recursive import RecursiveLeastSquares
from vsgdesign.identification.two_windows import TwoWindows

GUESS_SCR = 6.3
"""Short-circuit ratio (on the reactance, X/R 1) that estimators begin with where nothing better is known: the geometric
middle of 2 and 20."""

ESTIMATORS: dict[str, EstimatorKind] = {
    "constant": EstimatorKind("a constant guess", ConstantGuess),
    "two_windows": EstimatorKind("two windows about a step", TwoWindows),
    "rls": EstimatorKind("recursive least squares", RecursiveLeastSquares),
    "kalman": EstimatorKind("the extended Kalman filter", ExtendedKalmanFilter),
    "injection": EstimatorKind("the injected line", Injection),
    "prbs": EstimatorKind("the pseudo-random sequence", PseudoRandomSequence),
    "neural": EstimatorKind("the network", installed_network, trained=True, in_c=True),
}
"""Every estimator by the name that a study gives it. One more is one more entry: the study reader, the simulation and
the comparison go by this table alone."""


def estimator_kind(name: str) -> EstimatorKind:
    """The kind of a name. Raises StudyError for an unknown one, with the known names."""
    kind = ESTIMATORS.get(name)
    if kind is None:
        raise StudyError("estimator", [Fault("estimate", name, "unknown", f"Known: {', '.join(ESTIMATORS)}.")])
    return kind


def needs_network(name: str) -> bool:
    """Whether what a study says of ``estimate`` needs trained weights; ``truth`` and unknown names do not."""
    kind = ESTIMATORS.get(name)
    return kind is not None and kind.trained


def why_no_c(controller: str, estimate: str) -> str:
    """A sentence where a controller's estimator has no C; empty where it has, or where it is told the truth."""
    kind = ESTIMATORS.get(estimate)
    if kind is None or kind.in_c:
        return ""
    return (
        f"{controller}: there is no C for {kind.title} yet. The exported C has the scheduler without an estimator; it "
        "takes estimates from yours (vsg_update_estimate)."
    )


def build_estimator(name: str, at: Installation) -> Estimator:
    """The estimator of a name for an installation.

    Raises StudyError for an unknown name and ArtifactError where it cannot be built for the installation.
    """
    return estimator_kind(name).build(at)
