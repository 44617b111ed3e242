"""Classical ways to measure a grid's impedance, all on the same records: one file per method."""

from vsgdesign.estimator.baselines.constant import ConstantGuess
from vsgdesign.estimator.baselines.injection import Injection
from vsgdesign.estimator.baselines.kalman import ExtendedKalmanFilter
from vsgdesign.estimator.baselines.neural import NeuralMethod
from vsgdesign.estimator.baselines.pseudo_random import PseudoRandomSequence
from vsgdesign.estimator.baselines.record import Estimates, Method, Record, Run, measure, run_case
from vsgdesign.estimator.baselines.recursive import RecursiveLeastSquares
from vsgdesign.estimator.baselines.two_window import TwoWindows

__all__ = [
    "ConstantGuess",
    "Estimates",
    "ExtendedKalmanFilter",
    "Injection",
    "Method",
    "NeuralMethod",
    "PseudoRandomSequence",
    "Record",
    "RecursiveLeastSquares",
    "Run",
    "TwoWindows",
    "measure",
    "run_case",
]
