"""From waveforms to the readings of a converter's sensors: background harmonics, noise, quantisation, channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.frames import clarke, clarke_inverse, rms_to_peak, rotate_back
from vsgdesign.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.study import Study
from vsgdesign.stability.impedance import grid_impedance, output_admittance

if TYPE_CHECKING:
    from vsgdesign.simulation import MeasuredWindow

Array = NDArray[np.float64]


def measured_channels(
    converter: Converter,
    recipe: WindowRecipe,
    vectors: Array,
    theta: Array,
    noise: tuple[float, float],
    rng: np.random.Generator,
) -> Array:
    """Windows (N, 2·C·n) as the sensors measure them, in V and A peak.

    ``vectors`` (N, 2, 2, n) are voltage and current, α and β, samples. Noise (relative to the rated peak) and
    quantisation act on the sensor of each phase, before any transformation. ``theta`` (N, n) is the converter's own
    angle in rad, for the dq channels.
    """
    ratings = np.array([rms_to_peak(converter.V_rated_rms), converter.I_rated_pk]).reshape(1, 2, 1, 1)
    phases = np.stack(clarke_inverse(vectors[:, :, 0], vectors[:, :, 1]), axis=2)
    if max(noise) > 0.0:
        phases = phases + rng.normal(size=phases.shape) * ratings * np.reshape(noise, (1, 2, 1, 1))
    if recipe.adc_bits:
        full = recipe.adc_range_pu * ratings
        step = 2.0 * full / 2.0**recipe.adc_bits
        phases = np.clip(np.round(phases / step) * step, -full, full - step)
    if recipe.channels == "phase_a":
        return phases[:, :, 0].reshape(len(phases), -1)
    alpha, beta = clarke(phases[:, :, 0], phases[:, :, 1], phases[:, :, 2])
    if recipe.channels == "dq":
        alpha, beta = rotate_back(alpha, beta, np.cos(theta)[:, None], np.sin(theta)[:, None])
    return np.stack([alpha, beta], axis=2).reshape(len(phases), -1)


def harmonic_phasors(
    study: Study, grid: Grid, gains: PowerLoopGains, references: tuple[float, float], orders: Sequence[int]
) -> dict[int, tuple[Array, Array]]:
    """The responses of v_pcc and i_pcc to a unit harmonic of the grid's voltage, for each order.

    They are dq phasors (2,) in the frame of the source, at |order − 1|·ω_g; an order is negative for the negative
    sequence. The converter responds with the admittance of its sampled full-order model
    (:eq:`background-harmonics`), which is exact for small harmonics. Raises InfeasibleStudyError if there is no steady
    state.
    """
    omega_g = study.grid_source.omega_g
    model = linearise_full_order(study, [Cell(grid, gains, *references)])
    if model.faults[0] is not None:
        raise InfeasibleStudyError(model.faults[0])
    found = {}
    for order in orders:
        omega = np.array([abs(order - 1) * omega_g])
        Y = output_admittance(model, 0, omega)[0]
        Z = grid_impedance(grid.R_g, grid.L_g, omega_g, omega)[0]
        # e^{±jx} on d + jq is d = cos x, q = ±sin x: phasors 1 and ∓j.
        source = np.array([1.0, -1j if order > 0 else 1j])
        v = np.linalg.solve(np.eye(2) + Z @ Y, source)
        found[order] = (v, -Y @ v)
    return found


def background_vectors(
    phasors: Mapping[int, tuple[Array, Array]], amplitudes: Mapping[int, complex], source_phase: Array
) -> Array:
    """Voltage and current of background harmonics (2, 2, n), α and β, at angles of the source (n), rad.

    With the ``amplitudes`` (V peak, complex), the grid's vector is a·e^{jhθ_g} for an order h > 0 and a*·e^{−j|h|θ_g}
    for h < 0, where θ_g is the angle of its fundamental.
    """
    turn = np.exp(1j * source_phase)
    total: NDArray[np.complex128] = np.zeros((2, len(source_phase)), dtype=complex)
    for order, amplitude in amplitudes.items():
        wave = amplitude * np.exp(1j * abs(order - 1) * source_phase)
        for row, (d, q) in enumerate(phasors[order]):
            total[row] += ((d * wave).real + 1j * (q * wave).real) * turn
    return np.stack([total.real, total.imag], axis=1)


def background(
    study: Study, recipe: WindowRecipe, scenario: Any, windows: Sequence[MeasuredWindow], after: NDArray[np.bool_]
) -> Array:
    """The voltages and currents (N, 2, 2, n) that the background harmonics of a scenario add to its windows."""
    source = scenario.source
    phasors = [
        harmonic_phasors(study, *held, list(scenario.harmonics))
        for held in zip(scenario.grids, scenario.gains, scenario.references, strict=True)
    ]
    amplitudes = {order: value * rms_to_peak(source.V_g_rms) for order, value in scenario.harmonics.items()}
    turned = source.omega_g * recipe.sample_interval * np.arange(recipe.samples)
    return np.array(
        [
            background_vectors(phasors[int(later)], amplitudes, window.source_phase + turned)
            for window, later in zip(windows, after, strict=True)
        ]
    )
