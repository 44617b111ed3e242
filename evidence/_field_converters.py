"""The converters on which the field estimator is measured, and where they rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vsgdesign.equations.frames import PHASES, linear_modulation_limit, rms_to_peak
from vsgdesign.errors import VsgDesignError
from vsgdesign.linear.operating_point.equilibrium import OperatingPoint, solve_operating_point, solve_with_droop
from vsgdesign.simulation.survival.cases import GridState
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.event import BASIS
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import ControllerSpec, Event, Study

STUDIES = Path(__file__).resolve().parents[1] / "studies" / "survival"
CONVERTERS = {"5 kVA": "study", "12.5 kVA": "laboratory", "1 MVA": "utility"}
"""50 Hz with an LC filter; 50 Hz with LCL and one sample of delay; 60 Hz, 690 V with LCL and one sample of delay."""

CONTROLLER = "angle_damped"

ROOM_PU = 0.95
"""Largest fundamental of the bridge's current at rest, pu of rated: what is left of a limit of 1.2 pu is for
harmonics."""

_V_PU = (0.7, 1.3)
"""Voltage between which a rest is asked for, pu."""

_OF_BRIDGE = 0.95
"""Largest fundamental of the bridge's voltage at a rest, as a share of what it makes: the rest is for harmonics."""

_SLOPE = 0.1
"""Least share of its value without coupling that the stiffness of P over the angle keeps at a rest."""


@dataclass(frozen=True)
class Converter:
    """A converter under test, with the controller that drives it."""

    name: str
    study: Study
    """Switched, with the current limit of the controller."""
    spec: ControllerSpec

    @property
    def droops(self) -> tuple[float, float]:
        """D_p (W·s/rad) and D_q (var/V rms) of the angle-damped closed form."""
        c, target = self.study.converter, self.spec.target
        return c.S_rated / (target.P_droop * c.omega_n), c.S_rated / (target.Q_droop * c.V_rated_rms)


def converter_named(name: str) -> Converter:
    """One of CONVERTERS."""
    study = load_study(STUDIES / f"{CONVERTERS[name]}.toml")
    (spec,) = [one for one in study.controllers if one.name == CONTROLLER]
    study = replace(study.with_limit_of(spec), simulation=replace(study.simulation, bridge="pwm", start="steady_state"))
    return Converter(name, study, spec)


def references(converter: Converter, start: GridState) -> tuple[float, float]:
    """(P_ref in W, Q_ref in var) with which the powers at the start are those that were drawn.

    Raises NoOperatingPointError where the grid cannot carry them.
    """
    c, (D_p, D_q) = converter.study.converter, converter.droops
    P, Q = start.P_pu * c.S_rated, start.Q_pu * c.S_rated
    V_rms = solve_operating_point(P, Q, *_circuit(converter, start)).V_rms
    return P + D_p * 2.0 * math.pi * start.df_hz, Q - D_q * (c.V_rated_rms - V_rms)


def rest_at(converter: Converter, state: GridState, P_ref: float, Q_ref: float) -> OperatingPoint:
    """Where the droops and the grid agree (:eq:`operating-point`). Raises NoOperatingPointError where they do not."""
    c, (D_p, D_q) = converter.study.converter, converter.droops
    P = P_ref - D_p * 2.0 * math.pi * state.df_hz
    return solve_with_droop(P, Q_ref, D_q, c.V_rated_rms, *_circuit(converter, state))


def resting_currents(
    converter: Converter, start: GridState, changes: Sequence[Event], *, each: bool = False
) -> tuple[float, ...] | None:
    """Current of the bridge at rest, pu: at the start and after the last change, or ``each`` of the changes.

    ``P_pu`` and ``Q_pu`` of a change add to the references of the start. None where one of these rests does not exist,
    is on the wrong side of the nose curve, far from rated voltage, or needs more voltage than the bridge makes.
    """
    S = converter.study.converter.S_rated
    try:
        refs = references(converter, start)
        states = [(start, refs)]
        for change in changes:
            state, (P, Q) = states[-1]
            P = P if change.P_ref is None else refs[0] + change.P_ref * S
            Q = Q if change.Q_ref is None else refs[1] + change.Q_ref * S
            states.append((after(state, change), (P, Q)))
        asked = states if each else [states[0], states[-1]]
        found = [(state, rest_at(converter, state, *held)) for state, held in asked]
    except VsgDesignError:
        return None
    if not all(_possible(converter, point) for _, point in found):
        return None
    return tuple(bridge_current(converter, point) for _, point in found)


def after(state: GridState, change: Event) -> GridState:
    """The grid after a change; the powers of the state are left as they are."""
    scr, x_over_r = (None, None) if change.place is None else (change.place.scr, change.place.x_over_r)
    given = {"scr": scr, "x_over_r": x_over_r, "V_g_pu": change.V_g_rms, "df_hz": change.df_hz}
    return replace(state, **{name: value for name, value in given.items() if value is not None})


def bridge_phasors(converter: Converter, point: OperatingPoint) -> tuple[complex, complex]:
    """Fundamental of the bridge's current (A rms) and voltage (V rms), the capacitor's voltage being real."""
    c, part = converter.study.converter, converter.study.filter
    grid = complex(point.P, -point.Q) / (PHASES * point.V_rms)
    current = grid + 1j * c.omega_n * part.C * point.V_rms
    return current, point.V_rms + complex(part.R_1, c.omega_n * part.L_1) * current


def bridge_current(converter: Converter, point: OperatingPoint) -> float:
    """Fundamental of the bridge's current at an operating point, pu: that of the grid and of the capacitor."""
    return rms_to_peak(abs(bridge_phasors(converter, point)[0])) / converter.study.converter.I_rated_pk


def events_of(converter: Converter, start: GridState, changes: Sequence[Event]) -> tuple[Event, ...]:
    """The changes as events of a study: their references add to those of the start."""
    P_ref, Q_ref = references(converter, start)
    found = (one.on(converter.study.converter) for one in changes)
    return tuple(
        replace(
            one,
            name=f"change {k + 1}",
            P_ref=None if one.P_ref is None else P_ref + one.P_ref,
            Q_ref=None if one.Q_ref is None else Q_ref + one.Q_ref,
        )
        for k, one in enumerate(found)
    )


def _circuit(converter: Converter, state: GridState) -> tuple[float, float, float]:
    """The source's voltage, V rms, and R and X from the capacitor to the source at the state's frequency, Ω."""
    c = converter.study.converter
    grid, omega = Place(state.scr, state.x_over_r, BASIS).grid(c), c.omega_n + 2.0 * math.pi * state.df_hz
    return state.V_g_pu * c.V_rated_rms, *converter.study.path_to_grid(grid, omega)


def _possible(converter: Converter, point: OperatingPoint) -> bool:
    c, (_, D_q) = converter.study.converter, converter.droops
    stiffness, alone = point.A * (point.D + D_q) - point.B * point.C, point.A * (point.D + D_q)
    upright = point.A > 0.0 and stiffness > _SLOPE * alone
    asked = rms_to_peak(abs(bridge_phasors(converter, point)[1]))
    upright = upright and asked <= _OF_BRIDGE * linear_modulation_limit(c.V_dc, c.zero_sequence)
    return upright and _V_PU[0] < point.V_rms / c.V_rated_rms < _V_PU[1]
