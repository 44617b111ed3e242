"""The data of the field estimator, all plain floats: settings, what changes with every sample, and the answer.

Voltages are in per unit of the rated peak phase voltage, currents of the rated peak phase current, impedances of the
base impedance, unless a field says otherwise. docs/theory/field-estimator.md derives the method.
"""

from __future__ import annotations

from typing import Any, NamedTuple

LEARN = 0.0
"""Mode: nothing is known yet, and the first answer is being formed."""
TRACK = 1.0
"""Mode: the answer follows the measurements."""
DOUBT = 2.0
"""Mode: something has happened, and the estimator does not know yet whether the impedance or the grid voltage changed.
The answer is held."""


class FieldSettings(NamedTuple):
    """Constants of the estimator of one converter. :func:`vsgdesign.identification.field.field_settings` makes them."""

    T_s: Any
    """Sampling period, s."""
    omega_n: Any
    """Nominal angular frequency, rad/s."""
    per_volt: Any
    """One over the rated phase voltage, 1/V of the peak: v in per unit of a volt."""
    per_ampere: Any
    """One over the rated phase current, 1/A of the peak."""
    Z_base: Any
    """Base impedance, Ω."""
    R_2: Any
    X_2: Any
    """Impedance between the measured voltage and the PCC at omega_n, pu: the grid side of an LCL filter. It is taken
    off the answer."""
    smoothing: Any
    """1 − exp(−T_s/τ) of the low-pass on v, i and the probe."""
    R_first: Any
    X_first: Any
    """Impedance from the measured voltage to the grid's source with which learning starts, pu."""
    amplitude_least: Any
    """Least amplitude of a line of the probe as it is sent, pu of voltage."""
    amplitude_sent: Any
    """Largest amplitude of a line as it is sent."""
    amplitude_rest: Any
    """Largest amplitude of a line at the PCC at rest, an rms value over changes of the sign."""
    amplitude_burst: Any
    """Largest amplitude of a line at the PCC while the estimator learns or is in doubt."""
    current_rest: Any
    """Largest current of a line at rest, pu."""
    ripple_rest: Any
    """Largest rms value of the power that both lines add at rest, pu of the rated power."""
    sigma_rest: Any
    """Standard deviation of Z relative to its length that the probe is to give at rest."""
    sigma_burst: Any
    """The same after four cycles while the estimator learns or is in doubt."""
    noise_first: Any
    """Variance of one line over one cycle that is assumed at first, pu²."""
    gain_class: Any
    """Standard deviation of the error that the sensors' gains make in Z, relative."""
    sigma_valid: Any
    """Relative standard deviation up to which an answer is valid."""
    seed: Any
    """First value of the shift register of the sign code, a whole number from 1 to 511."""
    line: Any
    """Speed of the first line in the flywheel's frame, relative to the flywheel's own: 1/2, −5/2, 5/2 or −9/2. The
    second line is the next one farther from 0."""
    neighbours: Any
    """1 where other converters that form the grid stand beside: R and X alone are then fitted, and what both lines
    differ by says nothing. Else 0."""


class LineSums(NamedTuple):
    """Sums over a cycle of v, i and the sent probe u, turned back by the angle of a line (:eq:`field-sums`)."""

    v_re: Any
    v_im: Any
    i_re: Any
    i_im: Any
    u_re: Any
    u_im: Any


class LockIn(NamedTuple):
    """What changes at every sample.

    The estimator's own frame is a flywheel: it turns at a speed ``omega`` that is constant within a cycle. A cycle ends
    where ``phi`` passes 2π.
    """

    phi: Any
    """Angle of the flywheel at the coming sample, rad."""
    omega: Any
    """Speed of the flywheel in this cycle, rad/s."""
    half_re: Any
    half_im: Any
    """e^{jφ/2} of the whole angle: it changes its sign from one cycle to the next."""
    step_less_one: Any
    step_im: Any
    """e^{jωT_s/2} − 1: its real part is so small that single precision would lose it beside the 1."""
    v_re: Any
    v_im: Any
    i_re: Any
    i_im: Any
    u_re: Any
    u_im: Any
    """v, i and the sent probe in the flywheel's frame behind the low-pass, pu."""
    i_before_re: Any
    i_before_im: Any
    """i of the sample before."""
    primed: Any
    """0 until a sample has set the low-passes, then 1."""
    mean: LineSums
    """Sums of the running cycle for the fundamental."""
    line_1: LineSums
    """The same for the first line of the probe."""
    line_2: LineSums
    """The same for the second one."""
    weight: Any
    """Number of samples in the sums, a fraction included."""
    left: Any
    """Fraction of the last sample that belongs to the next cycle; meaningful when ``closed``."""
    i_start_re: Any
    i_start_im: Any
    """i where the running cycle began."""
    samples: Any
    """Samples of this cycle."""
    limited: Any
    """Samples of this cycle in which the current limiter acted."""
    spoilt: Any
    """Samples of this cycle that were not finite or beyond any sensor."""
    muted: Any
    """1 after a sample in which the limiter acted: no probe is sent in the next one."""
    a_1: Any
    a_2: Any
    """Amplitudes of the two lines in this cycle with their signs, pu of voltage."""
    closed: Any
    """1 after the sample in which the cycle ended, until :func:`conclude` has been called, else 0."""


class FieldAnswer(NamedTuple):
    """The answer of a cycle, in SI units at the PCC."""

    R_g: Any
    """Ω"""
    L_g: Any
    """H"""
    var_R: Any
    cov_RL: Any
    var_L: Any
    """Covariance of (R_g, L_g) in Ω², Ω·H and H²."""
    sigma: Any
    """Standard deviation of Z at omega_n relative to |Z|."""
    valid: Any
    """1 if a schedule may follow the answer, else 0: while learning, in doubt, where sigma is too large, beside another
    probe on the same lines, and where the grid is not passive."""
    changed: Any
    """1 in the cycle in which the estimator decided that the impedance has changed, else 0."""
    event: Any
    """1 in the cycle in which doubt began or began anew, else 0."""
    doubt: Any
    """1 while the answer is held because something has happened, else 0."""
    mode: Any
    """LEARN, TRACK or DOUBT."""
    limited: Any
    """Share of the cycle's samples in which the current limiter acted."""
    spoilt: Any
    """1 if a sample of the cycle was not finite or beyond any sensor: the answer before is repeated."""
    amplitude: Any
    """Largest amplitude of a line in the next cycle, pu of voltage."""
    foreign: Any
    """1 while another converter's probe is heard on the same lines, else 0."""
    passive: Any
    """0 while no grid of R, L and C, or with a load, explains what both lines say; else 1."""
