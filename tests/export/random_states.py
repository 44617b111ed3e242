"""Random states and measurements of the whole controller, inside and outside of all limits, for Python and C."""

from __future__ import annotations

import typing
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import controller_step
from vsgdesign.equations.controller_data import ControllerOutput, ControllerState, Measurement, flat_state
from vsgdesign.equations.frames import base_impedance, peak_to_rms
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.equations.limiters import GridEstimate, Limiter
from vsgdesign.export import CompiledC
from vsgdesign.export.known_answers import KnownSteps, known_steps
from vsgdesign.runtime import Scheduler


class Sample(NamedTuple):
    """A state with what it is given: arrays over the samples, as single precision holds them."""

    state: ControllerState
    measured: Measurement
    grid: GridEstimate


@dataclass(frozen=True)
class Far:
    """How far C is from Python, of the scale of each number: the worst, and shares of the samples."""

    worst: float
    """Over all numbers of the next state and of the output."""
    limited: float
    """Share of the samples in which the limiter acts in Python."""
    decided: float
    """Share of the samples in which a comparison came out otherwise; they are not in ``worst``."""


def random_samples(known: KnownSteps, limiter: Limiter, count: int, seed: int) -> Sample:
    """A third of the samples is near a steady state, so that nothing is limited; the others are anywhere."""
    rng = np.random.default_rng(seed)
    V, I_pk, S = known.size.v_b_alpha, known.settings.i_max_pk / 1.2, known.size.P
    omega, Z = known.refs.omega_0, base_impedance(S, peak_to_rms(V))
    wide = np.where(rng.random(count) < 1.0 / 3.0, 0.02, 1.0)

    def about(centre: Any, spread: float) -> Any:
        return centre + spread * wide * rng.uniform(-1.0, 1.0, count)

    theta = rng.uniform(-2.0 * np.pi, 2.0 * np.pi, count)
    load, lag = about(0.5, 1.5), about(0.2, np.pi)
    v_d, v_q = about(V, 1.5 * V), about(0.0, 1.0 * V)
    i_d, i_q = load * I_pk * np.cos(lag), -load * I_pk * np.sin(lag)
    frame = np.exp(1j * theta)
    v, i_s, i_g = (
        frame * (d + 1j * q)
        for d, q in (
            (v_d, v_q),
            (about(i_d, 0.5 * I_pk), about(i_q, 0.5 * I_pk)),
            (about(i_d, 0.5 * I_pk), about(i_q, 0.5 * I_pk)),
        )
    )
    state = ControllerState(
        theta=theta,
        omega_i=about(omega + 0.05 * omega, 0.2 * omega),
        V=peak_to_rms(np.maximum(about(V, 0.8 * V), 0.0)),
        P_f=about(0.5 * S, 2.0 * S),
        Q_f=about(0.1 * S, 2.0 * S),
        xi_vd=about(0.0, 2.0 * I_pk),
        xi_vq=about(0.0, 2.0 * I_pk),
        xi_id=about(0.0, 0.5 * V),
        xi_iq=about(0.0, 0.5 * V),
        i_f_d=about(i_d, I_pk),
        i_f_q=about(i_q, I_pk),
        u_alpha=v.real + about(0.0, 0.5 * V),
        u_beta=v.imag + about(0.0, 0.5 * V),
        ripple_P=about(0.0, 0.5 * S),
        ripple_Q=about(0.0, 0.5 * S),
        mean_P=about(0.5 * S, S),
        mean_Q=about(0.1 * S, S),
        limiter=tuple(_memory(name, rng, wide, omega, I_pk, V, count) for name in memory_of(limiter)._fields),
    )
    measured = Measurement(v.real, v.imag, i_s.real, i_s.imag, i_g.real, i_g.imag)
    impedance = Z / np.exp(rng.uniform(np.log(1.0), np.log(25.0), count))
    angle = np.arctan(np.exp(rng.uniform(np.log(0.2), np.log(20.0), count)))
    grid = GridEstimate(R_g=impedance * np.cos(angle), L_g=impedance * np.sin(angle) / omega)
    return Sample(_single(state), _single(measured), _single(grid))


def memory_of(limiter: Limiter) -> Any:
    """The NamedTuple in which a limiter remembers."""
    return typing.get_type_hints(limiter.at_rest)["return"]


def _memory(name: str, rng: Any, wide: Any, omega: float, I_pk: float, V: float, count: int) -> Any:
    """A remembered number: currents, voltages and frequencies are told by their names; a share is up to 1.5."""
    spread = rng.uniform(-1.0, 1.0, count)
    if name.startswith("omega"):
        return omega + 0.1 * omega * wide * spread
    if name.startswith("i_"):
        return 0.4 * I_pk + 2.0 * I_pk * wide * spread
    if name.startswith("v_"):
        return V * (name == "v_d") + V * wide * spread
    return 1.5 * wide * np.abs(spread)


def compare_steps(scheduler: Scheduler, limiter: Limiter, compiled: CompiledC, count: int, seed: int) -> Far:
    """One step of each sample in Python and in C, from the same numbers."""
    known = known_steps(scheduler.lookup, scheduler.settings, limiter)
    samples = random_samples(known, limiter, count, seed)
    kind = memory_of(limiter)
    state = samples.state._replace(limiter=kind(*samples.state.limiter))
    following, output = controller_step(
        state, samples.measured, samples.grid, known.refs, known.gains[0], known.inner_gains, known.settings,
        limiter.law,
    )  # fmt: skip
    following = following._replace(theta=within_a_turn(following.theta))
    wanted = np.array([np.broadcast_to(x, count) for x in (*flat_state(following), *output)]).T
    got = np.empty_like(wanted)
    control = compiled.control(known.gains[0], known.inner_gains, known.grid, known.refs, known.settings)
    rows = [np.array(part).T.tolist() for part in (flat_state(samples.state), samples.measured, samples.grid)]
    names = [*ControllerState._fields[:-1]]
    for k, (numbers, measured, grid) in enumerate(zip(*rows, strict=True)):
        data = control.data
        for name, value in zip(names, numbers, strict=False):
            setattr(data.state, name, value)
            if hasattr(data.lost, name):
                setattr(data.lost, name, 0.0)
        for name, value in zip(kind._fields, numbers[len(names) :], strict=True):
            setattr(data.state.limiter, name, value)
        data.grid.R_g, data.grid.L_g = grid
        answer = control.step(Measurement(*measured))
        after = [getattr(data.state, name) for name in names]
        after += [getattr(data.state.limiter, name) for name in kind._fields]
        got[k] = [*after, *answer]
    error = np.abs(got - wanted) / scales(known, limiter)
    error[:, 0] = np.minimum(error[:, 0], np.abs(error[:, 0] - 1.0))  # theta may be a turn further
    limited = ControllerOutput._fields.index("limited") - len(ControllerOutput._fields)
    decided = got[:, limited] != wanted[:, limited]
    return Far(float(error[~decided].max()), float(wanted[:, limited].mean()), float(decided.mean()))


def scales(known: KnownSteps, limiter: Limiter) -> np.ndarray:
    """What the error of each number is relative to: a turn, the nominal frequency, rated voltage, power and current."""
    V, I_pk, S = known.size.v_b_alpha, known.settings.i_max_pk / 1.2, known.size.P
    state = ControllerState(
        2.0 * np.pi, known.refs.omega_0, known.refs.V_n, S, S, I_pk, I_pk, V, V, I_pk, I_pk, V, V, S, S, S, S
    )
    of = {"omega": known.refs.omega_0, "i": I_pk, "v": V}
    memory = [of.get(name.partition("_")[0], 1.0) for name in memory_of(limiter)._fields]
    return np.array([*state[:-1], *memory, *known.size])


def _single(record: Any) -> Any:
    """Arrays as single precision holds them, so that both precisions get the same numbers."""
    return type(record)(
        *(tuple(_round(part) for part in value) if isinstance(value, tuple) else _round(value) for value in record)
    )


def _round(values: Any) -> Any:
    return np.asarray(values, dtype=np.float32).astype(float)
