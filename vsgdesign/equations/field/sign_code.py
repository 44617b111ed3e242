"""The sign of the probe and its size: what is sent in the next cycle, and whether another converter sends its probe on
the same lines. The residual then follows a sign that is not the own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import DOUBT, FieldSettings
from vsgdesign.equations.field.noise import CHIP_CYCLES
from vsgdesign.equations.field.tracks import Lines, LineTrack, Window, residual
from vsgdesign.equations.frames import rotate_back

REST_CYCLES = 60.0
BURST_CYCLES = 4.0
"""Cycles within which the probe is to give the wanted standard deviation, at rest and else."""
SINKS_TO = 0.85
LEAST_RESPONSE = 0.05
CHANGE_CYCLES = 3.0
"""Cycles that a change of the sign takes at rest."""
RMS_OF_CHANGES = 0.856
"""Rms value of the sign at rest. The limits at rest hold for the rms value of a line."""
RIPPLE_SHARE = 0.8157
"""What both lines may be of their sizes where the ripple of the power limits them, for the rms value of equal lines."""
FORCED_AT = 3.0
"""Cycles of the fast track in doubt at which the sign is changed once, whatever the code says."""


class SignCode(NamedTuple):
    """Manchester code of a shift register: of two chips the second has the other sign, that of the first is random."""

    bits: Any
    """Whole number from 1 to 511: nine bits with the feedback x⁹ + x + 1."""
    second: Any
    """0 in the first chip of a pair, 1 in the second."""
    cycles: Any
    """Cycles of the running chip."""
    sign: Any
    """+1 or −1."""
    since_flip: Any
    """Cycles since the sign changed."""


def first_code(settings: FieldSettings) -> SignCode:
    """The code of the first cycle."""
    return SignCode(bits=settings.seed, second=1.0, cycles=1.0, sign=1.0, since_flip=50.0)


def code_moved(code: SignCode, mode: Any, used: Any) -> SignCode:
    """The code of the next cycle; ``used`` are the cycles of the fast track in doubt."""
    forced = mode == DOUBT and used == FORCED_AT and code.cycles > 2.5
    due = forced or code.cycles > CHIP_CYCLES - 0.5
    half = np.floor(0.5 * code.bits)
    lowest = code.bits - 2.0 * half
    next_bit = half - 2.0 * np.floor(0.5 * half)
    bits = half + 256.0 * np.abs(lowest - next_bit)
    drawn = 2.0 * (bits - 2.0 * np.floor(0.5 * bits)) - 1.0
    second = 1.0 - code.second
    new = -code.sign if forced or second > 0.5 else drawn
    sign = new if due else code.sign
    since_flip = 1.0 if sign * code.sign < 0.0 else np.minimum(code.since_flip + 1.0, 50.0)
    new_bits = bits if due else code.bits
    new_second = second if due else code.second
    new_cycles = 1.0 if due else code.cycles + 1.0
    return SignCode(bits=new_bits, second=new_second, cycles=new_cycles, sign=sign, since_flip=since_flip)


def towards(before: Any, sign: Any, amplitude: Any, at_rest: Any) -> Any:
    """The amplitude of a line in the next cycle, with its sign (:eq:`field-towards`).

    ``before`` is that of the last cycle. At rest a change of the sign takes three cycles, 1, 1/3, −1/3, −1, because a
    change at once moves the mean of the power over two cycles (:eq:`field-mean`). ``at_rest`` is 1 or 0.
    """
    wanted = sign * amplitude
    most = 2.0 * amplitude / CHANGE_CYCLES
    slow = before + np.minimum(np.maximum(wanted - before, -most), most)
    return slow if at_rest > 0.5 else wanted


class Response(NamedTuple):
    """What arrives of one line of the probe, per unit of what is sent."""

    v: Any
    """Voltage between the grid's source and where it is measured."""
    pcc: Any
    """Voltage at the PCC."""
    i: Any
    """Current."""


def no_response() -> Response:
    """Before anything has been measured: all of the voltage arrives."""
    return Response(v=1.0, pcc=1.0, i=1.0)


def response_of(line: LineTrack, before: Response, settings: FieldSettings) -> Response:
    """The response of a line from the sums of a track (:eq:`field-response`)."""
    sent = np.maximum(line.uu, 1e-30)
    known = line.uu > 1e-12
    p_re = line.v_re - settings.R_2 * line.i_re - settings.X_2 * line.x_re
    p_im = line.v_im - settings.R_2 * line.i_im - settings.X_2 * line.x_im
    v = np.sqrt(line.v_re * line.v_re + line.v_im * line.v_im) / sent
    pcc = np.sqrt(p_re * p_re + p_im * p_im) / sent
    i = np.sqrt(line.i_re * line.i_re + line.i_im * line.i_im) / sent
    v = np.minimum(np.maximum(v, LEAST_RESPONSE), 2.0) if known else before.v
    pcc = np.minimum(np.maximum(pcc, LEAST_RESPONSE), 2.0) if known else before.pcc
    i = np.minimum(np.maximum(i, 0.1), 50.0) if known else before.i
    return Response(v=v, pcc=pcc, i=i)


def line_amplitude(noise: Any, calm: Any, size: Any, before: Any, response: Response, settings: FieldSettings) -> Any:
    """Amplitude of a line (:eq:`field-amplitude`): what the wanted standard deviation needs, within the limits.

    ``calm`` is 1 at rest and 0 while the estimator learns, doubts or suspects a change. ``size`` is how much larger the
    line is at rest. ``before`` is the amplitude of the last cycle: after a burst it sinks by no more than SINKS_TO in a
    cycle.
    """
    rest = calm > 0.5
    larger = size if rest else 1.0
    cycles = REST_CYCLES if rest else BURST_CYCLES
    sigma = settings.sigma_rest if rest else settings.sigma_burst
    wanted = larger * np.sqrt(noise / (2.0 * cycles)) / (sigma * response.v)
    arrives = settings.amplitude_rest / RMS_OF_CHANGES if rest else settings.amplitude_burst
    # Each line may make its part of the ripple of the power.
    by_current = np.minimum(settings.current_rest, RIPPLE_SHARE * size * settings.ripple_rest) / response.i
    largest = np.minimum(settings.amplitude_burst / response.pcc, settings.amplitude_sent)
    top = np.minimum(arrives / response.pcc, settings.amplitude_sent)
    top = np.minimum(top, by_current) if rest else top
    amplitude = np.minimum(np.maximum(wanted, settings.amplitude_least), top)
    sinking = np.minimum(SINKS_TO * np.abs(before), largest)
    return np.maximum(amplitude, sinking) if rest else amplitude


FOREIGN_MEMORY = 50.0
"""Cycles over which residuals are compared."""
FOREIGN_AFTER = 30.0
"""Cycles after which they tell something."""
ON_ONE_AXIS = 0.42
"""From which mean of z² on, over both lines, the residuals lie on one axis: for noise it is 0 ± 0.08."""
STILL_ON_IT = 0.3
"""The same where another probe has been heard."""
STEADY = 0.6
"""From which mean of z on a line keeps its sign, and is no probe."""


class Phasor(NamedTuple):
    """A complex number."""

    re: Any
    im: Any


class ForeignLine(NamedTuple):
    """What is known of one line's residual e: the part that follows the own probe u, and how the rest turns.

    z is the rest times the conjugate of that four cycles before, over its length: the differences of both have no cycle
    in common.
    """

    ue: Phasor
    """Σ w u* e"""
    uu: Any
    """Σ w |u|², where w takes its size from a residual that is larger than the noise."""
    one: Phasor
    two: Phasor
    three: Phasor
    four: Phasor
    """The rests of the last cycles."""
    z: Phasor
    """Σ z"""
    zz: Any
    """Re Σ z²"""


class Foreign(NamedTuple):
    """Both lines."""

    line_1: ForeignLine
    line_2: ForeignLine
    count: Any
    """Cycles in the sums, forgotten ones as what is left of them."""
    heard: Any
    """1 while another probe is heard, else 0."""


def no_foreign() -> Foreign:
    """Nothing heard."""
    zero = Phasor(re=0.0, im=0.0)
    line = ForeignLine(ue=zero, uu=0.0, one=zero, two=zero, three=zero, four=zero, z=zero, zz=0.0)
    return Foreign(line_1=line, line_2=line, count=0.0, heard=0.0)


def foreign_line(sums: ForeignLine, window: Window, R: Any, X: Any, noise: Any) -> ForeignLine:
    """The sums with the residual of one more cycle that R and X leave; ``noise`` is its variance over a cycle."""
    keep = 1.0 - 1.0 / FOREIGN_MEMORY
    e_re, e_im = residual(window, R, X)
    weight = noise / np.maximum(e_re * e_re + e_im * e_im, noise)
    by_re, by_im = rotate_back(e_re, e_im, window.u_re, window.u_im)
    ue = Phasor(re=keep * sums.ue.re + weight * by_re, im=keep * sums.ue.im + weight * by_im)
    uu = keep * sums.uu + weight * (window.u_re * window.u_re + window.u_im * window.u_im)
    known = 1.0 / np.maximum(uu, 1e-30)
    rest_re = e_re - known * (ue.re * window.u_re - ue.im * window.u_im)
    rest_im = e_im - known * (ue.re * window.u_im + ue.im * window.u_re)
    z_re, z_im = rotate_back(rest_re, rest_im, sums.four.re, sums.four.im)
    now = np.maximum(rest_re * rest_re + rest_im * rest_im, 1e-30)
    before = np.maximum(sums.four.re * sums.four.re + sums.four.im * sums.four.im, 1e-30)
    size = np.sqrt(now) * np.sqrt(before)
    z_re, z_im = z_re / size, z_im / size
    return ForeignLine(
        ue=ue,
        uu=uu,
        one=Phasor(re=rest_re, im=rest_im),
        two=sums.one,
        three=sums.two,
        four=sums.three,
        z=Phasor(re=keep * sums.z.re + z_re, im=keep * sums.z.im + z_im),
        zz=keep * sums.zz + z_re * z_re - z_im * z_im,
    )


def moves(sums: ForeignLine, count: Any) -> Any:
    """1 if a line's rest does not keep its sign, else 0."""
    return 1.0 if sums.z.re * sums.z.re + sums.z.im * sums.z.im < STEADY * STEADY * count * count else 0.0


def foreign_with(foreign: Foreign, line_1: Window, line_2: Window, lines: Lines, noise_1: Any, noise_2: Any) -> Foreign:
    """The sums of both lines with one more cycle, and what they tell (:eq:`field-foreign`)."""
    count = (1.0 - 1.0 / FOREIGN_MEMORY) * foreign.count + 1.0
    one = foreign_line(foreign.line_1, line_1, lines.R_1, lines.X_1, noise_1)
    two = foreign_line(foreign.line_2, line_2, lines.R_2, lines.X_2, noise_2)
    share = STILL_ON_IT if foreign.heard > 0.5 else ON_ONE_AXIS
    on_axis = 0.5 * (one.zz + two.zz) > share * count and count > FOREIGN_AFTER
    heard = moves(one, count) * moves(two, count) if on_axis else 0.0
    return Foreign(line_1=one, line_2=two, count=count, heard=heard)
