"""A plant between two events: the power flow that its set points and droops say (:eq:`plant-flow`), and the instants at
which its units sample, over the time after which they repeat (:eq:`plant-clock`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import PHASES, rms_to_peak
from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import Topology, phasors_of
from vsgdesign.study.parameters.converter import Filter
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.power_plant import Inverter
from vsgdesign.study.parameters.study import Study

Complex = NDArray[np.complex128]


class UnitAsked(NamedTuple):
    """What a unit is asked for between two events."""

    study: Study
    """Its own: converter, filter, inner loops and current limit."""
    gains: PowerLoopGains
    refs: References
    grid: Grid
    """The grid that its controller takes for its own."""


class InverterAsked(NamedTuple):
    """What an inverter is asked for between two events."""

    inverter: Inverter
    refs: SetPoints


class Situation(NamedTuple):
    """A plant between two events."""

    study: Study
    topology: Topology
    units: tuple[UnitAsked, ...]
    omega: float
    sources: tuple[tuple[float, float], ...]
    """V (phase rms) and angle (rad) of each source to the grid's."""
    inverters: tuple[InverterAsked, ...] = ()

    @property
    def filters(self) -> tuple[Filter, ...]:
        """Of all converters."""
        return (*(one.study.filter for one in self.units), *(one.inverter.filter for one in self.inverters))

    @property
    def phasors(self) -> Complex:
        """Of the sources, V peak."""
        return np.array([rms_to_peak(V) * np.exp(1j * angle) for V, angle in self.sources])


class Flow(NamedTuple):
    """Phasors at the capacitor nodes, phase rms."""

    v: Complex
    i: Complex


def power_flow(situation: Situation) -> Flow:
    """The phasors with which all units have the powers that their set points and droops say (:eq:`plant-flow`)."""
    found = _newton(situation, 1.0)
    if found is not None:
        return found
    low, high = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _newton(situation, middle) is not None else (low, middle)
    every = (*situation.units, *situation.inverters)
    asked = ", ".join(
        f"{converter.name} {one.refs.P_ref / 1e3:.4g} kW, {one.refs.Q_ref / 1e3:.4g} kvar"
        for converter, one in zip(situation.study.plant.converters, every, strict=True)  # type: ignore[union-attr]
    )
    raise InfeasibleStudyError(
        f"no operating point: the network does not take what its converters are asked for ({asked}); it takes about "
        f"{100.0 * low:.0f} % of it. Ask for less, or strengthen the network."
    )


def _newton(situation: Situation, share: float) -> Flow | None:
    """With a share of the powers; None where Newton does not find it."""
    plant, omega = situation.study.plant, situation.omega
    if plant is None:
        return None
    network = phasors_of(plant, situation.topology, omega)
    own = np.array(
        [
            one.study.filter.R_2 + 1j * omega * one.study.filter.L_2 for one in situation.units
        ]  # with R and L of the unit
        + [
            one.R + filter_.R_2 + 1j * omega * (one.L + filter_.L_2)
            for one, filter_ in zip(plant.inverters, situation.filters[len(plant.units) :], strict=True)
        ]
    )
    Y = np.linalg.inv(network.Z + np.diag(own))
    V = network.V @ (situation.phasors / rms_to_peak(1.0))
    every = [_asked(one, omega) for one in situation.units] + [
        _inverter_asked(one, omega) for one in situation.inverters
    ]
    P, Q, D_q, V_n, V_near = (np.array(one) for one in zip(*every, strict=True))
    ratings = [one.study.converter.S_rated for one in situation.units]
    scale = np.array(ratings + [one.inverter.S_rated for one in situation.inverters])
    v = V / np.maximum(np.abs(V), 1e-9) * V_near
    for _ in range(30):
        i = Y @ (v - V)
        S = PHASES * v * i.conj()
        wrong = S - share * (P + 1j * Q) - 1j * D_q * (V_n - np.abs(v))
        if np.abs(wrong / scale).max() < 1e-12:
            return Flow(v, i)
        dS = PHASES * np.diag(i.conj()), PHASES * v[:, None] * Y.conj()  # for dv, and for its conjugate
        direction = v / np.abs(v)
        columns = []
        for unit in (1.0, 1j):
            column = dS[0] * unit + dS[1] * np.conj(unit)
            column = column + np.diag(1j * D_q * (direction.conj() * unit).real)
            columns.append(np.concatenate([column.real, column.imag]))
        matrix = np.concatenate(columns, axis=1)
        step = np.linalg.lstsq(matrix, np.concatenate([wrong.real, wrong.imag]), rcond=None)[0]
        v = v - (step[: len(v)] + 1j * step[len(v) :])
        if not np.isfinite(v).all() or (np.abs(v) < 0.05 * V_near).any() or (np.abs(v) > 3.0 * V_near).any():
            return None
    return None


def _asked(unit: UnitAsked, omega: float) -> tuple[float, ...]:
    """P (W) with its droop, Q (var) at V_n, D_q, V_n, and a voltage near which the flow is."""
    refs, gains = unit.refs, unit.gains
    P = refs.P_ref + gains.D_p * (refs.omega_0 - omega)
    return P, refs.Q_ref, gains.D_q, refs.V_n, refs.V_n


def _inverter_asked(one: InverterAsked, omega: float) -> tuple[float, ...]:
    """The same of an inverter."""
    own = one.inverter
    return (*own.kind.rest(one.refs, omega, own.settings), own.V_rated_rms)


def situation_of(
    study: Study, topology: Topology, units: Sequence[UnitAsked], omega: float, V_g_rms: float
) -> Situation:
    """A plant with its sources as they are at nominal phase."""
    sources = () if study.plant is None else study.plant.sources
    return Situation(
        study, topology, tuple(units), omega, ((V_g_rms, 0.0), *((one.V_rms, one.phase) for one in sources))
    )


_MOST_INSTANTS = 128
_SAME = 1e-6
"""Share of a sampling period within which instants are one."""


class Instant(NamedTuple):
    """An instant at which units sample."""

    t_s: float
    """Since the beginning of the clock's period."""
    units: tuple[int, ...]
    """Indices of converters."""
    gap: float
    """Time to the next instant, s."""


class Clock(NamedTuple):
    """All instants of a period."""

    period: float
    instants: tuple[Instant, ...]

    @property
    def equal_gaps(self) -> bool:
        """Whether the next instant is equally far from all of them."""
        first = self.instants[0].gap
        return all(abs(one.gap - first) <= _SAME * first for one in self.instants)

    def time(self, k: int) -> float:
        """The k-th instant from t = 0 on, s."""
        turn, at = divmod(k, len(self.instants))
        return turn * self.period + self.instants[at].t_s


def clock_of(names: Sequence[str], T_s: Sequence[float], offsets: Sequence[float]) -> Clock:
    """The clock of units with these sampling periods, which sample for the first time after ``offsets``.

    Raises InfeasibleStudyError where they do not repeat within some 100 instants, with their names.
    """
    offsets = [one - min(offsets) for one in offsets]
    ratios = [Fraction(one / T_s[0]).limit_denominator(_MOST_INSTANTS) for one in T_s]
    common = Fraction(math.lcm(*(one.numerator for one in ratios)), math.gcd(*(one.denominator for one in ratios)))
    counts = [common / one for one in ratios]
    fits = all(abs(float(one) * T_s[0] / T - 1.0) < 1e-9 for one, T in zip(ratios, T_s, strict=True))
    if not fits or sum(map(int, counts)) > _MOST_INSTANTS:
        shown = ", ".join(f"{name} {1.0 / T:.6g} Hz" for name, T in zip(names, T_s, strict=True))
        raise InfeasibleStudyError(
            f"network: the sampling frequencies ({shown}) do not repeat within {_MOST_INSTANTS} instants. Give "
            "frequencies in the ratio of small whole numbers."
        )
    due = sorted(
        (offset + k * T, unit)
        for unit, (T, offset, count) in enumerate(zip(T_s, offsets, counts, strict=True))
        for k in range(int(count))
    )
    period, found = float(common) * T_s[0], list[tuple[float, list[int]]]()
    for t_s, unit in due:
        if found and t_s - found[-1][0] <= _SAME * min(T_s):
            found[-1][1].append(unit)
        else:
            found.append((t_s, [unit]))
    ends = [t_s for t_s, _ in found[1:]] + [found[0][0] + period]
    instants = (Instant(t_s, tuple(units), end - t_s) for (t_s, units), end in zip(found, ends, strict=True))
    return Clock(period, tuple(instants))


def clock_of_study(study: Study) -> Clock:
    """That of a study's plant."""
    some = () if study.plant is None else study.plant.converters
    periods = [one.T_s if isinstance(one, Inverter) else (one.case or study).converter.T_s for one in some]
    return clock_of([one.name for one in some], periods, [one.offset for one in some])
