"""The period of a plant as one map, with its derivative, and the steady state at which it only turns
(:eq:`plant-period`).

The map goes from instant to instant: the units that sample take their next state, and the circuit moves to the next
instant. It is written in the frame of the grid's source, so that a steady state is a fixed point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.frames import instantaneous_power, rms_to_peak
from vsgdesign.errors import InfeasibleStudyError, LimitHitError
from vsgdesign.linear.model.full_order import ControllerMap, limiter_states
from vsgdesign.linear.model.parts_of_plant import LinkMap, inverter_map, link_map
from vsgdesign.linear.operating_point.circuit_of_units import (
    UnitsCircuit,
    circuit_of_units,
    names_of_states,
    wiring_of,
)
from vsgdesign.linear.operating_point.flow_of_units import (
    InverterAsked,
    Situation,
    UnitAsked,
    clock_of_study,
    power_flow,
)
from vsgdesign.linear.operating_point.full_order import (
    controller_of,
    link_at_rest,
    link_in_model,
    pack,
    parameters_of,
)
from vsgdesign.linear.operating_point.many import Lanes, lanes_of, many_steady_states
from vsgdesign.linear.operating_point.sampled import cold_start, fault_of_rest
from vsgdesign.study.parameters import inverter_kinds
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_STEPS, _EXACT, _GOOD = 20, 1e-13, 1e-9
"""Newton's steps, the change of a state, relative to its size, at which they end, and at which they have converged."""

_ROUNDED, _SLOWER = 1e-9, 0.1
"""Newton's steps are of the size of roundings where one is this small and the next one is not a tenth of it."""


@dataclass(frozen=True, eq=False)
class UnitsAtRest:
    """The steady state of a plant, at the beginning of its clock's period and with the grid's source at angle zero."""

    model: PlantMap
    z: Array
    """The state of the map."""
    A: Array
    """Its derivative there: the full-order model of the whole plant."""

    def controller(self, unit: int, phase: float) -> tuple[ControllerState, complex, complex]:
        """The controller of a unit with the grid's source at a phase (rad), the bridge voltage that acts and the one
        that its delay holds back, αβ."""
        model, turn = self.model, np.exp(1j * phase)
        own = model.slices[unit]
        named = dict(zip(model.maps[unit].names, self.z[own.controller].tolist(), strict=True))
        asleep = cold_start(model.situation.units[unit].study).controller
        memory = type(asleep.limiter)(*(named[name] for name in limiter_states(asleep.limiter._fields)))
        held = complex(*self.z[own.held]) * turn
        waits = complex(named["pending_d"], named["pending_q"]) * turn if "pending_d" in named else held
        y = model.measured(self.z, unit)
        i_g = (y[4] + 1j * y[5]) * np.exp(-1j * named["delta"])
        P, Q = model.powers(self.z, unit)
        # A state that the structure does not have has any value; these are at rest.
        rest = {"P_f": P, "Q_f": Q, "i_f_d": i_g.real, "i_f_q": i_g.imag, "mean_P": P, "mean_Q": Q}
        known = rest | {name: value for name, value in named.items() if name in ControllerState._fields}
        known |= {"theta": named["delta"] + phase, "u_alpha": waits.real, "u_beta": waits.imag}
        return asleep._replace(**known, limiter=memory), held, waits

    def inverter(self, k: int, phase: float) -> tuple[Any, complex, complex]:
        """The state of an inverter with the grid's source at a phase (rad), the bridge voltage that acts and the one
        that its delay holds back, αβ."""
        model, turn = self.model, np.exp(1j * phase)
        at = len(model.situation.units) + k
        kind, own = model.situation.inverters[k].inverter.kind, model.slices[at]
        named = dict(zip(model.maps[at].names, self.z[own.controller].tolist(), strict=True))
        held = complex(*self.z[own.held]) * turn
        waits = complex(named.pop("pending_d"), named.pop("pending_q")) * turn if "pending_d" in named else held
        for name in kind.angles:
            named[name] += phase
        for one, other in kind.pairs:
            turned = complex(named[one], named[other]) * turn
            named[one], named[other] = turned.real, turned.imag
        return kind.state(**named), held, waits

    def circuit(self, phase: float) -> Complex:
        """The circuit's states y with the grid's source at a phase, αβ."""
        return self.model.states(self.z) * np.exp(1j * phase)


class _Slices(NamedTuple):
    controller: slice
    held: slice
    before: slice
    """i_s, v_c and i_g at its last sample, of a unit whose dc link is not ideal."""
    link: slice
    """Of its link."""


class PlantMap:
    """One period of a plant's clock as a map z → F(z), with its derivative.

    z are the circuit's states q (d, q in turn), then for each unit its controller's, and the bridge voltage that acts.
    """

    def __init__(self, situation: Situation) -> None:
        study, self.situation = situation.study, situation
        wiring = wiring_of(study)
        self.plant = wiring.plant
        converters = [one.name for one in wiring.plant.converters]
        self.network: UnitsCircuit = circuit_of_units(
            wiring, situation.topology, names_of_states(wiring.plant, [situation.topology])
        )
        self.clock = clock_of_study(study)
        others = [one.inverter for one in situation.inverters]
        self.maps: tuple[ControllerMap, ...] = (
            *(controller_of(one.study) for one in situation.units),
            *(inverter_map(one.kind, one.delay_samples) for one in others),
        )
        self._p = [_parameters(one, situation) for one in situation.units]
        self._p += [
            np.array([one.inverter.filter.R_c, *one.refs, *one.inverter.settings]) for one in situation.inverters
        ]
        self.of_links: dict[int, list[float]] = {}
        """The constants of the dc link of a unit, at its rest."""
        self.slices: list[_Slices] = []
        at = 2 * len(self.network.A)
        states = [f"{name}_{axis}" for name in _names_of(self.network) for axis in "dq"]
        self._angles, self._pairs = list[int](), list[list[int]]()
        self._links = [_link_of(one.study) for one in situation.units] + [None] * len(others)
        for converter, one, link in zip(converters, self.maps, self._links, strict=True):
            end = at + len(one.names)
            kept = _SIX if link is not None else ()
            of_link = slice(end + 2 + len(kept), end + 2 + len(kept) + (len(link.names) if link is not None else 0))
            self.slices.append(_Slices(slice(at, end), slice(end, end + 2), slice(end + 2, of_link.start), of_link))
            self._angles += [at + one.names.index(name) for name in one.angles]
            self._pairs += [[at + one.names.index(name) for name in pair] for pair in one.pairs]
            self._pairs += [[end + k, end + k + 1] for k in range(0, 2 + len(kept), 2)]
            own = [*one.names, "held_d", "held_q", *(f"before.{name}" for name in kept)]
            states += [f"{converter}.{name}" for name in (*own, *(link.names if link is not None else ()))]
            at = of_link.stop
        self.names = tuple(states)
        """``CONVERTER.STATE``, or the element of the network."""
        self.kept = np.ones(at, dtype=bool)
        """Without the bridge voltages that the first instant overwrites and no link sees before."""
        for k in self.clock.instants[0].units:
            self.kept[self.slices[k].held] = self._links[k] is not None

    def states(self, z: Array) -> Complex:
        """The circuit's states y."""
        q = z[0 : 2 * len(self.network.A) : 2] + 1j * z[1 : 2 * len(self.network.A) : 2]
        return self.network.X @ q + self.network.X_g @ self.situation.phasors

    def measured(self, z: Array, unit: int) -> Array:
        """i_s, v_c and i_g of a converter (d, q in turn)."""
        y = self.states(z)[3 * unit : 3 * unit + 3]
        return np.stack([y.real, y.imag], axis=1).ravel()

    def powers(self, z: Array, unit: int) -> tuple[float, float]:
        """P (W) and Q (var) at the capacitor node of a converter."""
        i_s, v_c, i_g = self.states(z)[3 * unit : 3 * unit + 3]
        v = v_c + self.situation.filters[unit].R_c * (i_s - i_g)
        P, Q = instantaneous_power(v.real, v.imag, i_g.real, i_g.imag)
        return float(P), float(Q)

    def __call__(self, z: Array, *, derivative: bool = True) -> tuple[Array, Array]:
        """F(z) and dF/dz; without a derivative the second is meaningless."""
        z, J, omega = z.copy(), np.eye(len(z)), self.situation.omega
        v_g, n = self.situation.phasors, len(self.network.A)
        for instant in self.clock.instants:
            for k in instant.units:
                self._sample(z, J, k, derivative)
            phi, gamma, rho = self.network.step(instant.gap, omega)
            turn = np.exp(-1j * omega * instant.gap)
            held = [self.slices[k].held for k in range(len(self.maps))]
            moved = np.zeros((2 * n, len(z)))
            moved[:, : 2 * n] = _real(np.asarray(turn * phi, dtype=complex))
            for k, place in enumerate(held):
                moved[:, place] = _real(np.asarray(turn * gamma[:, k : k + 1], dtype=complex))
            q = turn * (rho @ v_g)
            z[: 2 * n] = moved @ z + np.stack([q.real, q.imag], axis=1).ravel()
            J[: 2 * n] = moved @ J if derivative else J[: 2 * n]
            rotation = _real(np.array([[turn]]))
            for pair in self._pairs:
                z[pair], J[pair] = rotation @ z[pair], rotation @ J[pair]
            z[self._angles] -= omega * instant.gap
        return z, J

    def _sample(self, z: Array, J: Array, unit: int, derivative: bool) -> None:
        """The converter's next state, and the bridge voltage that acts from now on."""
        own, n = self.slices[unit], 2 * len(self.network.A)
        of_circuit = _real(self.network.X[3 * unit : 3 * unit + 3].astype(complex))
        if (link := self._links[unit]) is not None:
            self._move_link(link, z, J, unit, of_circuit, derivative)
        given = np.concatenate([self.measured(z, unit), z[own.controller]])
        result, slope = self.maps[unit].linear(given, self._p[unit])
        z[own.controller.start : own.held.stop] = result.full().ravel()
        if derivative:
            slope = slope.full()
            J[own.controller.start : own.held.stop] = (
                slope[:, :6] @ (of_circuit @ J[:n]) + slope[:, 6:] @ J[own.controller]
            )

    def _move_link(self, link: LinkMap, z: Array, J: Array, unit: int, of_circuit: Array, derivative: bool) -> None:
        """The link of a unit since its last sample, and the circuit from which it goes on."""
        own, n, now = self.slices[unit], 2 * len(self.network.A), self.measured(z, unit)
        given = np.concatenate([z[own.link], z[own.before], now, z[own.held]])
        result, slope = link.linear(given, self.of_links[unit])
        z[own.link], z[own.before] = result.full().ravel(), now
        if derivative:
            slope, parts = slope.full(), np.cumsum([own.link.stop - own.link.start, 6, 6])
            states = J[own.link], J[own.before], of_circuit @ J[:n], J[own.held]
            J[own.link] = sum(part @ of for part, of in zip(np.split(slope, parts, axis=1), states, strict=True))
            J[own.before] = states[2]

    def rest(self, guess: Array) -> UnitsAtRest:
        """The fixed point near a guess, by Newton. Raises InfeasibleStudyError where it is not found."""
        z, before = guess.copy(), math.inf
        for _ in range(_STEPS):
            after, J = self(z)
            wrong = np.where(self.kept, after - z, 0.0)
            size = np.abs(z) + 1e-3 * np.abs(z).max()
            matrix = (J - np.eye(len(z))) * size[None, :] / size[:, None]
            some = np.flatnonzero(self.kept)
            step = _solved(matrix[np.ix_(some, some)], (wrong / size)[some])
            change = float(np.abs(step).max())
            z[some] -= step * size[some]
            # Where steps no longer become smaller, what is left are the roundings of the map.
            if change < _EXACT or not np.isfinite(change) or (before < _ROUNDED and change > _SLOWER * before):
                break
            before = change
        after, J = self(z)
        z = np.where(self.kept, z, after)
        wrong = np.abs(after - z)[self.kept] / (np.abs(z) + 1e-3 * np.abs(z).max())[self.kept]
        if not np.isfinite(z).all() or wrong.max() > _GOOD:
            raise InfeasibleStudyError(
                "the plant has phasors that fit its set points, but its sampled controllers do not rest there. Ask for "
                "less, or start cold."
            )
        return UnitsAtRest(self, z, J[np.ix_(self.kept, self.kept)])


def _link_of(study: Study) -> LinkMap | None:
    """The dc link of a unit; None: it is ideal."""
    link = link_in_model(study)
    return None if link is None else link_map(link)


def _solved(matrix: Array, right: Array) -> Array:
    """Newton's step; where a state may have any value, the smallest one."""
    try:
        found: Array = np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        found = np.full(len(right), np.nan)
    if not np.isfinite(found).all():
        found = np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-14)[0], dtype=np.float64)
    return found


def _names_of(network: UnitsCircuit) -> list[str]:
    """What the states q are called: the variable of y that one is, else the network."""
    found = []
    for k in range(len(network.A)):
        same = [j for j, row in enumerate(network.X) if row[k] == 1.0 and np.count_nonzero(row) == 1]
        found.append(network.names[same[0]] if same else f"network.{k}")
    return found


def _real(matrix: Complex) -> Array:
    """A complex matrix for (d, q) in turn."""
    found = np.empty((2 * matrix.shape[0], 2 * matrix.shape[1]))
    found[0::2, 0::2], found[1::2, 1::2] = matrix.real, matrix.real
    found[1::2, 0::2], found[0::2, 1::2] = matrix.imag, -matrix.imag
    return found


def _parameters(unit: UnitAsked, situation: Situation) -> Array:
    lanes, gains = lanes_of(unit.study, _lanes(unit, unit.grid, situation.sources[0][0], situation.omega), unit.gains)
    return parameters_of(unit.study, lanes, gains)[0]


def _lanes(unit: UnitAsked, grid: Grid, V_rms: float, omega: float) -> Lanes:
    return Lanes.at(grid, GridSource(V_rms, omega), unit.refs)


def rest_of_units(situation: Situation) -> UnitsAtRest:
    """The steady state of a plant, with its droops and limits. Raises InfeasibleStudyError where there is none, with
    the unit that cannot have its powers, and with the share of the set points that there is."""
    model = PlantMap(situation)
    flow = power_flow(situation)
    plant, omega = situation.study.plant, situation.omega
    z = np.zeros(len(model.kept))
    held = np.zeros(len(model.maps), dtype=complex)
    for k, unit in enumerate(situation.units):
        name = plant.units[k].name if plant is not None else ""
        f, grid = unit.study.filter, unit.grid
        # Behind any impedance there is the source that gives this voltage and this current.
        V = flow.v[k] - (f.R_2 + grid.R_g + 1j * omega * (f.L_2 + grid.L_g)) * flow.i[k]
        lanes = _lanes(unit, grid, abs(V), omega)
        found = many_steady_states(unit.study, lanes, unit.gains, float(np.angle(V)))
        if found.fault[0]:
            source = GridSource(abs(V), omega)
            error = fault_of_rest(unit.study, grid, source, unit.refs, unit.gains, found)
            kind = type(error)
            if isinstance(error, LimitHitError):
                raise LimitHitError(f"unit {name}: {error}", limit=error.limit)
            raise kind(f"unit {name}: {error}")
        own, all_names = model.slices[k], (*_SIX, *model.maps[k].names)
        z[own.controller] = pack(all_names, found)[0][6:]
        held[k] = complex(*found.pending[:, 0])
        if (link := link_in_model(unit.study)) is not None:
            z[own.before] = found.plant[:, 0]
            z[own.link], model.of_links[k] = link_at_rest(unit.study, link, found.plant[:, 0])
        _since_sample(model, z, k, held[k])
    for j, one in enumerate(situation.inverters):
        k = len(situation.units) + j
        z[model.slices[k].controller], held[k] = _inverter_guess(one, flow.v[k], flow.i[k], omega)
        _since_sample(model, z, k, held[k])
    # The circuit at rest with these bridge voltages, as if all units sampled together.
    phi, gamma, rho = model.network.step(model.clock.period, omega)
    turn = np.exp(1j * omega * model.clock.period)
    q = np.linalg.solve(turn * np.eye(len(phi)) - phi, gamma @ held + rho @ situation.phasors)
    z[: 2 * len(q)] = np.stack([q.real, q.imag], axis=1).ravel()
    return model.rest(z)


_SIX = ("i_s_d", "i_s_q", "v_c_d", "v_c_q", "i_g_d", "i_g_q")


def _since_sample(model: PlantMap, z: Array, unit: int, held: complex) -> None:
    """A unit that samples later in the clock's period: the frame turns until then, and has turned since its last
    sample."""
    omega, clock = model.situation.omega, model.clock
    mine = [one.t_s for one in clock.instants if unit in one.units]
    until = mine[0] - clock.instants[0].t_s
    since = clock.period - (mine[-1] - clock.instants[0].t_s)
    own, one = model.slices[unit], model.maps[unit]
    first = own.controller.start
    for name in one.angles:
        z[first + one.names.index(name)] += omega * until
    for pair in one.pairs:
        at = [first + one.names.index(name) for name in pair]
        turned = complex(*z[at]) * np.exp(1j * omega * until)
        z[at] = turned.real, turned.imag
    acts = held * np.exp(-1j * omega * since)
    z[own.held] = acts.real, acts.imag
    before = (z[own.before][0::2] + 1j * z[own.before][1::2]) * np.exp(-1j * omega * since)
    z[own.before] = np.stack([before.real, before.imag], axis=1).ravel()


def _inverter_guess(one: InverterAsked, v_rms: complex, i_rms: complex, omega: float) -> tuple[Array, complex]:
    """The states of an inverter near its phasors, and the bridge voltage that acts from its sample on."""
    own, f = one.inverter, one.inverter.filter
    v, i_g = complex(rms_to_peak(v_rms)), complex(rms_to_peak(i_rms))
    i_c = v / (f.R_c + 1.0 / (1j * omega * f.C))
    i_s = i_g + i_c
    u = v + (f.R_1 + 1j * omega * f.L_1) * i_s
    state = own.kind.at_rest(inverter_kinds.Phasors(v, i_s, i_g, u, omega), own.settings)
    held = complex(u * np.exp(0.5j * omega * own.T_s))
    return np.array([*state, *((held.real, held.imag) if own.delay_samples else ())]), held
