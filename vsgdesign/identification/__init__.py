"""Estimators of the grid's impedance, as they run on a controller. They share one interface and need NumPy alone."""

from vsgdesign.identification.interface import (
    ESTIMATORS,
    GUESS_SCR,
    SIGNAL_SETS,
    STATUSES,
    Estimate,
    Estimator,
    EstimatorKind,
    Installation,
    Needs,
    Probe,
    Samples,
    build_estimator,
    estimator_kind,
)

__all__ = [
    "ESTIMATORS",
    "GUESS_SCR",
    "SIGNAL_SETS",
    "STATUSES",
    "Estimate",
    "Estimator",
    "EstimatorKind",
    "Installation",
    "Needs",
    "Probe",
    "Samples",
    "build_estimator",
    "estimator_kind",
]
