"""What has to hold for the swing function to fall, as programs for boxes (docs/theory/large-signal.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import basis_of, drop_sq
from vsgdesign.certificate.enclosure import PIECES, Estimate, Loops, true_grid, voltage_conditions
from vsgdesign.certificate.region import Region, System
from vsgdesign.certificate.tracing import Program, Symbol, Tracer, program_of
from vsgdesign.equations.frames import PHASES, SQRT_2
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import power_flow

Array = NDArray[np.float64]

REST_SHARE = 0.9
"""Largest current at rest as a share of the limit. Operating points with more current are not part of a statement."""

_INSIDE = 0.98
"""The same as a share of the soft limit, which a rest is not to touch."""


@dataclass(frozen=True)
class SwingLaw:
    """The limiter's parameters that the statement depends on. Currents are in per unit of the rated one, Z_v in per
    unit, tau in s, g in 1/s, largest_pull in rad/s."""

    i_soft: float
    i_max: float
    Z_v: float
    tau: float
    g: float
    largest_pull: float
    v_gate: float
    doubt: float
    one_sided: bool = True
    """Whether P may not drive the angle away from the admitted voltage (:eq:`one-sided-power`)."""

    @property
    def i_rest(self) -> float:
        """Largest current at rest of the operating points that a statement is about, per unit."""
        return min(REST_SHARE * self.i_max, _INSIDE * self.i_soft)


class Test(NamedTuple):
    """A program over six coordinates. Its last outputs are those of ``conditions`` (c, 2): where one lies outside of
    its limits, there is nothing to prove. ``names`` are those of the first outputs."""

    program: Program
    names: tuple[str, ...]
    conditions: Array


class Gains(NamedTuple):
    """What the gains of an estimate contribute. Powers are in V²/|Ẑ_g|."""

    K_ip: Any
    K_pq: Any
    k_P: Any
    k_Q: Any
    slope: Any
    """K_pq/K_ip"""
    kept: Any
    """1 − k_P D_p"""
    reserve: Any
    """4 K_ip(1 − k_P D_p) − g k_P² D_p (:eq:`pull-reserve`)"""


def gains_tests(system: System, region: Region, law: SwingLaw) -> list[Test]:
    """Gains of every estimate that the region allows. Coordinates: estimate (2), p, q, errors of R̂ and L̂."""
    found = []
    for piece in PIECES:
        tracer = Tracer(6)
        first, angle, p, q, e_R, e_L = tracer.symbols()
        here = Estimate.of(system, first, angle)
        r, x = true_grid(system, region, tracer, here, (e_R, e_L))
        path = (r + here.fixed[0], (x + here.fixed[1]) * here.share)
        inverse_V, conditions = voltage_conditions(system, region, p, q, path, here.base)
        conditions += _of_grid(system, region, here, r, x)
        gains, choices = _gains(system, tracer, here, p, q, inverse_V, piece, law)
        conditions += [(choice, -np.inf, 0.0) for choice in choices]
        outputs = {name: getattr(gains, name) for name in ("K_ip", "k_P", "kept")}
        found.append(_test(tracer, outputs, conditions))
    return found


def rest_tests(system: System, region: Region, law: SwingLaw) -> list[Test]:
    """The resting point and its unstable counterpart (:eq:`unstable-rest`). Coordinates: estimate (2), p, q; the last
    is the largest error of the impedance angle in rad."""
    found = []
    for piece in PIECES[:3]:
        tracer = Tracer(6)
        first, angle, p, q, _, error = tracer.symbols()
        at = _Rest.of(system, region, law, first, angle, p, q)
        gains, choices = _gains(system, tracer, at.here, p, q, at.inverse_V, piece, law)
        conditions = [*at.conditions, *((choice, -np.inf, 0.0) for choice in choices)]
        r, x, t = at.r, at.x, gains.slope
        # (x + jr)(1 + jt) has the angle β + ζ at which the power is largest.
        a, b = x - r * t, r + x * t
        size = (r * r + x * x) * (1.0 + t * t)
        twice = (a * a - b * b) * at.along + 2.0 * (a * b) * at.across
        soft_sq, hard_sq = at.path_sq * at.soft * at.soft, at.path_sq * at.hard * at.hard
        chord = 1.0 + at.drop - soft_sq
        sine = np.sin(error)
        held = at.path_sq.sqrt(_least_path_sq(system)) * at.hard
        behind = at.v_g - held * error
        gate = 2.0 * (law.v_gate * law.v_gate * (at.inverse_V * at.inverse_V) + law.doubt * law.doubt * hard_sq)
        outputs = {
            "rising": a * at.along + b * at.across,
            "beyond": chord + 2.0 * twice / size,
            "open": behind * behind - gate,
            # No part of the impedance takes more from the grid voltage than the whole of it, whatever the angle.
            "near": at.v_g - held - SQRT_2 * law.v_gate * at.inverse_V,
            "clear": at.drop - 0.25 * (chord * chord) - hard_sq * (sine * sine),
        }
        found.append(_test(tracer, outputs, conditions))
    return found


def limited_tests(system: System, region: Region, law: SwingLaw) -> list[Test]:
    """Power and angle while the limiter acts. Coordinates: estimate (2), p, q, δ in rad, error of the impedance angle
    in rad. Between the soft and the hard limit the voltage follows its reference; beyond, the current is held."""
    return [_limited(system, region, law, hard, piece) for hard in (False, True) for piece in PIECES[:3]]


def _limited(system: System, region: Region, law: SwingLaw, hard: bool, piece: Any) -> Test:
    tracer = Tracer(6)
    first, angle, p, q, delta, error = tracer.symbols()
    at = _Rest.of(system, region, law, first, angle, p, q)
    gains, choices = _gains(system, tracer, at.here, p, q, at.inverse_V, piece, law)
    conditions = [*at.conditions, *((choice, -np.inf, 0.0) for choice in choices)]
    sine, cosine = np.sin(delta), np.cos(delta)
    turn, along = np.sin(error), np.cos(error)
    path = at.path_sq.sqrt(_least_path_sq(system))
    # u − v_g in the frame of u, its length, and the radius of what the limits admit.
    d_re, d_im = 1.0 - at.v_g * cosine, at.v_g * sine
    reach_sq = 1.0 + at.drop - 2.0 * (at.v_g * cosine)
    least = _least_reach_sq(system, region, law)
    reach = reach_sq.sqrt(least)
    soft_sq, hard_sq = at.path_sq * at.soft * at.soft, at.path_sq * at.hard * at.hard
    if hard:
        conditions.append((reach_sq - hard_sq, 0.0, np.inf))
        radius = path * at.hard
        chord = (reach_sq - hard_sq * (turn * turn)).sqrt(0.9 * least)
        short = chord - radius * along  # |e| of the voltage loop
        # The direction of e in the frame of u.
        n_re = (d_re * chord - d_im * radius * turn) / reach_sq
        n_im = (d_im * chord + d_re * radius * turn) / reach_sq
        a, b = (at.r * along - at.x * turn) / path, (at.x * along + at.r * turn) / path
        scale = PHASES * at.hard
        P = scale * (a * (n_re - short) + b * n_im)
        Q = scale * (b * (n_re - short) - a * n_im)
        pulled = short + law.Z_v * (law.i_max - law.i_soft) * at.inverse_V
    else:
        conditions += [(reach_sq - soft_sq, 0.0, np.inf), (reach_sq - hard_sq, -np.inf, 0.0)]
        P, Q = power_flow(delta, 1.0, at.v_g, at.r, at.x)
        n_re, n_im = (d_re * along - d_im * turn) / reach, (d_im * along + d_re * turn) / reach
        pulled = law.Z_v * (reach / (path * at.here.size) - law.i_soft * at.inverse_V)
    e_P, e_Q = P - p, Q - q
    outputs = {
        "e_P": e_P,
        "e_Q": gains.slope * e_Q,
        "error": e_P + gains.slope * e_Q,
        "pulled_by_P": gains.K_ip * e_P,
        "pulled_by_Q": gains.K_pq * e_Q,
        "turned_by_P": gains.k_P * e_P,
        "turned_by_Q": gains.k_Q * e_Q,
        "kept": gains.kept,
        "reserve": gains.reserve,
        "turned": pulled * n_im,
        "left": 1.0 - pulled * n_re,
        "steepest": _steepest(at, gains, turn),
        "clear": at.drop * (sine * sine) - hard_sq * (turn * turn),
    }
    if not hard:
        outputs["towards"] = _towards_largest(at, gains.slope, delta)
    return _test(tracer, outputs, conditions)


def _steepest(at: _Rest, gains: Gains, turn: Any) -> Any:
    """No less than K_ip|h| at any angle, 1/s² (:eq:`steepest`). The limited voltage is no longer than V, V_g and what
    the error of the angle turns it away; x² bounds the size of x, and so do these parabolas for √(1 + x²) and for
    max(1, x)."""
    longest = 0.5 * (1.0 + at.v_g) + 1.25 * ((1.0 - at.v_g) * (1.0 - at.v_g)) + 0.05
    aside = at.path_sq * at.hard * at.hard + turn * turn
    power = PHASES * at.hard * (REST_SHARE + longest + aside)
    return gains.K_ip * power * (1.0 + 0.5 * (gains.slope * gains.slope))


def _towards_largest(at: _Rest, slope: Any, delta: Any) -> Any:
    """Has the sign of cos((δ + δ_0)/2 − β − ζ). The error is the product of this and of sin((δ − δ_0)/2) as long as the
    voltage follows its reference (:eq:`error-product`)."""
    half_c, half_s = np.cos(0.5 * delta), np.sin(0.5 * delta)
    re, im = at.v_g + at.along, at.across  # has the angle δ_0/2
    turned_re, turned_im = half_c * re - half_s * im, half_c * im + half_s * re
    return (at.x - at.r * slope) * turned_re + (at.r + at.x * slope) * turned_im


class _Rest(NamedTuple):
    """An operating point on the estimated grid in units of V and V/|Ẑ_g|, and what is of interest of it."""

    here: Estimate
    r: Any
    x: Any
    path_sq: Any
    drop: Any
    v_g: Any
    along: Any
    across: Any
    """Grid voltage in the frame of V: along − j·across."""
    inverse_V: Any
    soft: Any
    hard: Any
    """Both limits of the current."""
    conditions: list[tuple[Any, float, float]]

    @classmethod
    def of(cls, system: System, region: Region, law: SwingLaw, first: Any, angle: Any, p: Any, q: Any) -> _Rest:
        here = Estimate.of(system, first, angle)
        r, x = here.direction[0] + here.fixed[0], (here.direction[1] + here.fixed[1]) * here.share
        inverse_V, conditions = voltage_conditions(system, region, p, q, (r, x), here.base)
        if basis_of(system).name != system.study.scr_basis:  # else the boxes are those of the grids
            conditions += _of_grid(system, region, here, *here.direction)
        unit = here.size * inverse_V
        soft, hard = law.i_soft * unit, law.i_max * unit
        rest = law.i_rest * unit
        conditions.append(((p * p + q * q) * (1.0 / PHASES**2) - rest * rest, -np.inf, 0.0))
        source = system.study.grid_source.V_g_rms / system.study.converter.V_rated_rms
        return cls(
            here,
            r,
            x,
            r * r + x * x,
            drop_sq(r, x, p, q),
            inverse_V * source,
            1.0 - (r * p + x * q) * (1.0 / PHASES),
            (x * p - r * q) * (1.0 / PHASES),
            inverse_V,
            soft,
            hard,
            conditions,
        )


def _gains(
    system: System, tracer: Tracer, here: Estimate, p: Any, q: Any, inverse_V: Symbol, piece: Any, law: SwingLaw
) -> tuple[Gains, list[Symbol]]:
    """The gains that the schedule makes on one of its pieces, and what is negative there."""
    J, choices = here.scheduled(p, q, piece)
    loops = Loops.of(system, here.normalised(tracer), J, inverse_V, here.base)
    g, symbol = loops.gains, loops.algebra.symbol
    kept = 1.0 - g.k_P * g.D_p
    reserve = 4.0 * (g.K_ip * kept) - law.g * (g.k_P * g.k_P * g.D_p)
    values = (g.K_ip, g.K_pq, g.k_P, g.k_Q, g.K_pq / g.K_ip, kept, reserve)
    return Gains(*(symbol(loops.algebra.value(one)) for one in values)), choices


def _of_grid(system: System, region: Region, here: Estimate, r: Any, x: Any) -> list[tuple[Any, float, float]]:
    """SCR and X/R of a grid r + jx, in |Ẑ_g|, within the region."""
    weakness = here.size * SCR_BASES[system.study.scr_basis].counted(r, x)
    limits = ((weakness, region.scr), (r / x, region.x_over_r))
    return [(value, 1.0 / most, 1.0 / least) for value, (least, most) in limits]


def _least_path_sq(system: System) -> float:
    """A number below |Z|²/|Ẑ_g|²: the grid-side inductor adds to the grid, and a slow grid takes from its reactance."""
    return 0.99 * min(system.study.grid_source.omega_g / system.study.converter.omega_n, 1.0) ** 2


def _least_reach_sq(system: System, region: Region, law: SwingLaw) -> float:
    """A number below |u − v_g|²/V² where the limiter acts: |Z| is at least 1/SCR on either basis."""
    shortest = law.i_soft / (region.scr[1] * system.study.converter.V_max_pu)
    return _least_path_sq(system) * shortest * shortest


def _test(tracer: Tracer, outputs: dict[str, Any], conditions: list[tuple[Any, float, float]]) -> Test:
    program = program_of(tracer, [*outputs.values(), *(value for value, _, _ in conditions)])
    return Test(program, tuple(outputs), np.array([[low, high] for _, low, high in conditions]))
