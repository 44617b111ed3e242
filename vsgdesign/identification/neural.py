"""The neural estimator as it runs on the controller. From a window it estimates R and L of the grid, or says why
not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.errors import ArtifactError
from vsgdesign.identification.interface import (
    Array,
    Estimate,
    Installation,
    Needs,
    NoMemory,
    Samples,
    no_estimate,
)

_NOT_FINITE = no_estimate("not finite")
_SATURATED = no_estimate("saturated")
_LIMITED = no_estimate("limited")


def fold(network: Any) -> tuple[Array, Array, Array, Array]:
    """W_1, b_1, W_2, b_2 of a network (artifacts.network_weights.Network) with its scaling folded in.

    They take windows in V and A and give answers in Ω and H (:eq:`fold-scaling`).
    """
    gain, offset = network.inputs.gain_and_offset()
    gain_out, offset_out = network.outputs.gain_and_offset()
    return (
        network.W_1 * gain,
        network.b_1 + network.W_1 @ offset,
        network.W_2 / gain_out[:, None],
        (network.b_2 - offset_out) / gain_out,
    )


@dataclass(frozen=True, eq=False)
class NeuralEstimator:
    """A network with its scaling folded in. Made by :func:`neural_estimator`.

    ``v_limit`` (V) and ``i_limit`` (A) are the limits of the sensors. A window with a sample at its limit is not used.
    """

    W_1: Array
    b_1: Array
    W_2: Array
    b_2: Array
    samples: int
    components: int
    least: tuple[float, float]
    largest: tuple[float, float]
    v_limit: float
    i_limit: float
    sample_interval: float = 200e-6
    """s."""
    channels: str = "phase_a"
    synchronised: bool = False
    """Whether its windows begin at a given phase of the grid's own voltage."""
    title: str = "Neural network"
    signals: str = "steady"

    @property
    def needs(self) -> Needs:
        """It needs windows like those of its training."""
        return Needs(self.samples, self.sample_interval, self.channels, self.synchronised)

    def first(self) -> NoMemory:
        """Nothing."""
        return NoMemory()

    def probe(self, state: NoMemory) -> None:
        """This method needs no probe."""

    def update(self, state: NoMemory, samples: Samples) -> tuple[NoMemory, Estimate]:
        """The :meth:`estimate` of a window. There is none if the current was limited in it."""
        return state, self.estimate(samples.v, samples.i) if samples.limited == 0 else _LIMITED

    def estimate(self, window_v: Array, window_i: Array) -> Estimate:
        """R_g and L_g from one window of v_pcc (V) and i_pcc (A) (:eq:`network`).

        Each has the shape (samples,), or (components, samples) for αβ and dq. The rows may also follow one another in
        one array. Raises ArtifactError for another shape. The values of the samples never raise an exception.
        """
        half = self.components * self.samples
        if window_v.size != half or window_i.size != half or window_v.shape != window_i.shape:
            raise ArtifactError(
                f"window: v has shape {window_v.shape}, i {window_i.shape}; these weights take "
                f"{self.components} × {self.samples} samples of each. Take windows as the network was trained."
            )
        v, i = window_v.ravel(), window_i.ravel()
        # The largest magnitudes are NaN or infinite if any sample is.
        v_peak, i_peak = max(v.max(), -v.min()), max(i.max(), -i.min())
        if not (v_peak < self.v_limit and i_peak < self.i_limit):
            finite = np.isfinite(v).all() and np.isfinite(i).all()
            return _SATURATED if finite else _NOT_FINITE
        W_1 = self.W_1
        hidden = np.tanh(W_1[:, :half] @ v + W_1[:, half:] @ i + self.b_1)
        R_g, L_g = (self.W_2 @ hidden + self.b_2).tolist()
        (R_low, L_low), (R_high, L_high) = self.least, self.largest
        if R_low <= R_g <= R_high and L_low <= L_g <= L_high:
            return Estimate(R_g, L_g, "ok")
        return Estimate(min(max(R_g, R_low), R_high), min(max(L_g, L_low), L_high), "outside")


def neural_estimator(
    weights: Any,
    *,
    sample_interval: float,
    channels: str = "phase_a",
    grid_phase: bool = False,
    v_limit: float = np.inf,
    i_limit: float = np.inf,
    margin: float = 0.2,
) -> NeuralEstimator:
    """The estimator of some weights (artifacts.network_weights.NetworkWeights) for a sample interval (s) and a frame.

    ``grid_phase`` says that windows will start at the grid phase with which the weights were trained, and that this
    phase is known from another source. Weights that need it are refused without it. ``v_limit`` and ``i_limit`` are the
    limits of the sensors in V and A. ``margin`` is the distance beyond the trained range, relative to it, up to which
    an answer is accepted. Raises ArtifactError with everything that does not fit.
    """
    window, faults = weights.window, []
    if not abs(sample_interval - window.sample_interval) <= 1e-9 * window.sample_interval:
        faults.append(
            f"sample_interval = {sample_interval * 1e6:g} µs: the weights were trained at "
            f"{window.sample_interval * 1e6:g} µs. Sample the window so, or train on yours"
        )
    if channels != window.channels:
        faults.append(f"channels = {channels}: the weights take {window.channels}. Give those, or train on yours")
    if window.synchronised and not grid_phase:
        faults.append(
            "grid_phase = false: the weights were trained on windows synchronised with the grid's own voltage, which "
            "a converter does not measure. If you have that signal, say so with the option --grid-phase, or with "
            "grid_phase = true under [estimator] in a study; otherwise train without it"
        )
    for name, value in (("v_limit", v_limit), ("i_limit", i_limit)):
        if not value > 0.0:
            faults.append(f"{name} = {value:g}: must be positive")
    if not margin >= 0.0:
        faults.append(f"margin = {margin:g}: must be zero or more")
    if faults:
        raise ArtifactError("these weights do not fit:\n" + "\n".join(f"  - {fault}." for fault in faults))
    (R_low, R_high), (L_low, L_high) = weights.trained_on["R_g"], weights.trained_on["L_g"]
    R_more, L_more = margin * (R_high - R_low), margin * (L_high - L_low)
    return NeuralEstimator(
        *fold(weights.network),
        samples=window.samples,
        components=window.length // (2 * window.samples),
        least=(R_low - R_more, L_low - L_more),
        largest=(R_high + R_more, L_high + L_more),
        v_limit=float(v_limit),
        i_limit=float(i_limit),
        sample_interval=window.sample_interval,
        channels=window.channels,
        synchronised=window.synchronised,
    )


def installed_network(at: Installation) -> NeuralEstimator:
    """The network of an installation's weights. Raises ArtifactError with everything that does not fit."""
    if at.weights is None:
        raise ArtifactError("there is no network to estimate with. Give trained weights.")
    return neural_estimator(
        at.weights,
        sample_interval=at.sample_interval,
        channels=at.weights.window.channels,
        grid_phase=at.grid_phase,
        v_limit=at.v_limit,
        i_limit=at.i_limit,
    )
