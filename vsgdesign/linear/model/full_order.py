"""The full-order sampled-data model: one control period of plant, delay and controller, differentiated exactly.

The map is the simulator's own (averaged bridge), generated from the same equations and written in the frame of
the grid source, so a steady state is a fixed point and its Jacobian's eigenvalues are the system's: no Padé, no
continuous approximation of the sampling.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_sample
from vsgdesign.equations.controller_data import Nothing
from vsgdesign.equations.frames import instantaneous_power, rms_to_peak, rotate_back
from vsgdesign.equations.grid import FilterGrid, capacitor_node_voltage, filter_grid_derivative
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import CIRCULAR, GridEstimate, LimiterLaw
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.linear.model.dc_link import CircuitOfPeriod, LinkInModel
from vsgdesign.linear.model.power_loops import numpy_on_symbols

PARAMETERS = (
    *FilterGrid._fields,
    *PowerLoopGains._fields,
    *InnerLoopGains._fields,
    *References._fields,
    "V_g",
    "omega_g",
)
"""Names of the map's parameters, SI: circuit, gains, references, V_g (phase rms) and ω_g (rad/s)."""

SETTINGS = tuple(name for name in ControllerSettings._fields if name != "limiter")
"""Names of the controller's constants, after the parameters. The limiter's own constants come last."""

INPUTS = ("P_ref", "Q_ref", "omega_g", "V_g", "P_meas", "Q_meas", "theta_cmd", "V_cmd")
"""Inputs of the linear model. The last four are added to the measured powers (the plant's output) and to the
commanded angle and voltage (its input): they break the loop for the margins."""

OUTPUTS = ("P", "Q", "omega", "V", "delta", "v_b_d", "v_b_q")
"""Outputs of the linear model: measured powers, frequency, commanded V and δ, and the bridge voltage that is
applied from this sample on (peak, in the source's frame)."""

_TAYLOR_ORDER = 13
_EDGE_DEGREE = 16
"""Of the responses to edges: 1e-12 of them is left out where the fastest mode moves by 3 rad in a period."""
_PLANT = 6
"""States of the filter, which come first."""
_NOTCH = ("ripple_P", "ripple_Q", "mean_P", "mean_Q")
_INTEGRATORS = ("xi_vd", "xi_vq", "xi_id", "xi_iq")
POWER_LOOP_STATES = ("delta", "omega_i", "V", "P_f", "Q_f", *_NOTCH)
"""Those of the states that belong to the power loops and their filters."""


class LimiterInModel(NamedTuple):
    """A limiter as the model needs it: its law, and the NamedTuple classes of its memory and of its constants."""

    law: LimiterLaw
    memory: type
    constants: type


def limiter_states(fields: tuple[str, ...]) -> tuple[str, ...]:
    """Names of a limiter's own numbers among those of the whole controller."""
    return tuple(f"limiter_{name}" for name in fields)


@dataclass(frozen=True)
class FullOrderMap:
    """The CasADi functions of one structure (delay, power filters, notch, transient impedance), for any parameters.

    ``states`` names z. ``step(z, p)`` gives the next z; ``linear(z, p)`` gives A, B, C, D for INPUTS and
    OUTPUTS; ``directional(z, p, dz, dp)`` gives dA along a direction; ``of_parameters(z, p)`` gives ∂step/∂p.
    p holds PARAMETERS, then SETTINGS, then the limiter's constants.
    """

    states: tuple[str, ...]
    step: ca.Function
    linear: ca.Function
    _period: ca.SX
    """The next z, in ``_z`` and ``_p``: what the derivatives are made of."""
    _A: ca.SX
    _z: ca.SX
    _p: ca.SX

    # Few need the others, and two of them take longer to build than all the rest.

    @functools.cached_property
    def state_matrix(self) -> ca.Function:
        """A alone."""
        return ca.Function("state_matrix", [self._z, self._p], [ca.densify(self._A)], {"cse": True})

    @functools.cached_property
    def directional(self) -> ca.Function:
        """dA along (dz, dp)."""
        A, z, p = self._A, self._z, self._p
        dz, dp = ca.SX.sym("dz", z.shape), ca.SX.sym("dp", p.shape)
        dA = ca.reshape(ca.jtimes(ca.vec(A), ca.vertcat(z, p), ca.vertcat(dz, dp)), *A.shape)
        return ca.Function("directional", [z, p, dz, dp], [ca.densify(dA)], {"cse": True})

    @functools.cached_property
    def of_parameters(self) -> ca.Function:
        """∂step/∂p."""
        z, p = self._z, self._p
        return ca.Function("of_parameters", [z, p], [ca.densify(ca.jacobian(self._period, p))], {"cse": True})


@functools.cache
def full_order_map(
    delay: int,
    filter_P: bool,
    filter_Q: bool,
    transient: bool,
    squarings: int,
    limiter: LimiterInModel = LimiterInModel(CIRCULAR.law, Nothing, Nothing),  # noqa: B008
    notch: bool = False,
    link: LinkInModel | None = None,
) -> FullOrderMap:
    """Build the map for 0 or 1 samples of delay, with or without power filters, transient impedance and notch.

    ``squarings`` k: matrix exponentials by Taylor series of (A T_s)/2^k, squared k times. The limiter's memory is part
    of the state, a field each. ``link``: a dc link that is not ideal; its states and parameters come last.
    """
    names = _state_names(delay, filter_P, filter_Q, transient, notch, limiter) + (() if link is None else link.states)
    z = ca.SX.sym("z", len(names))
    own = () if link is None else link.parameters
    p = ca.SX.sym("p", len(PARAMETERS) + len(SETTINGS) + len(limiter.constants._fields) + len(own))
    u = ca.SX.sym("u", len(INPUTS))
    with numpy_on_symbols():
        following, outputs = _one_period(names, z, p, u, squarings, limiter, link)
    at_rest = ca.DM.zeros(len(INPUTS))

    def rested(expression: ca.SX) -> ca.SX:
        return ca.substitute(expression, u, at_rest)

    A, B = rested(ca.jacobian(following, z)), rested(ca.jacobian(following, u))
    C, D = rested(ca.jacobian(outputs, z)), rested(ca.jacobian(outputs, u))
    following, outputs = rested(following), rested(outputs)
    return FullOrderMap(
        names,
        ca.Function("step", [z, p], [following, outputs]),
        ca.Function("linear", [z, p], [ca.densify(m) for m in (A, B, C, D)], {"cse": True}),
        following,
        A,
        z,
        p,
    )


def _state_names(
    delay: int, filter_P: bool, filter_Q: bool, transient: bool, notch: bool, limiter: LimiterInModel
) -> tuple[str, ...]:
    plant = ("i_s_d", "i_s_q", "v_c_d", "v_c_q", "i_g_d", "i_g_q")
    pending = ("pending_d", "pending_q") if delay else ()
    filters = (*(("P_f",) if filter_P else ()), *(("Q_f",) if filter_Q else ()))
    low_pass = ("i_f_d", "i_f_q") if transient else ()
    remembered = limiter_states(limiter.memory._fields)
    notches = _NOTCH if notch else ()
    return (*plant, *pending, "delta", "omega_i", "V", *filters, *notches, *_INTEGRATORS, *low_pass, *remembered)


class _Sampled(NamedTuple):
    """The controller's sample in symbols."""

    circuit: FilterGrid
    settings: ControllerSettings
    before: ControllerState
    after: ControllerState
    output: Any
    applied: tuple[ca.SX, ca.SX]
    """The bridge voltage from this sample on."""


def _sampled(
    state: dict[str, ca.SX], values: dict[str, ca.SX], push: dict[str, ca.SX], limiter: LimiterInModel
) -> _Sampled:
    """One sample of the controller in the frame of the source."""
    constants = limiter_states(limiter.constants._fields)
    circuit = FilterGrid(**{n: values[n] for n in FilterGrid._fields})
    power_gains = PowerLoopGains(**{n: values[n] for n in PowerLoopGains._fields})
    inner_gains = InnerLoopGains(**{n: values[n] for n in InnerLoopGains._fields})
    if "pending_d" not in state:  # without a delay there is nothing to predict over
        inner_gains = inner_gains._replace(kappa=0.0)
    settings = ControllerSettings(
        **{n: values[n] for n in SETTINGS}, limiter=limiter.constants(*(values[n] for n in constants))
    )
    refs = References(
        P_ref=values["P_ref"] + push["P_ref"],
        Q_ref=values["Q_ref"] + push["Q_ref"],
        omega_0=values["omega_0"],
        V_n=values["V_n"],
    )
    v_d, v_q = (capacitor_node_voltage(state[f"i_s_{a}"], state[f"v_c_{a}"], state[f"i_g_{a}"], circuit) for a in "dq")
    measured = Measurement(
        v_alpha=v_d,
        v_beta=v_q,
        i_s_alpha=state["i_s_d"],
        i_s_beta=state["i_s_q"],
        i_g_alpha=state["i_g_d"],
        i_g_beta=state["i_g_q"],
    )
    P, Q = instantaneous_power(v_d, v_q, measured.i_g_alpha, measured.i_g_beta)
    # Without a filter the remembered power is of no consequence: any value serves. Without a transient impedance the
    # remembered current is the present one, in which the impedance sees no change. The voltage that the prediction
    # takes is the one that waits out the delay. Without a notch there is no ripple to take away.
    i_g = rotate_back(state["i_g_d"], state["i_g_q"], np.cos(state["delta"]), np.sin(state["delta"]))
    controller = ControllerState(
        theta=state["delta"],
        omega_i=state["omega_i"],
        V=state["V"],
        P_f=state.get("P_f", P),
        Q_f=state.get("Q_f", Q),
        **{name: state[name] for name in _INTEGRATORS},
        i_f_d=state.get("i_f_d", i_g[0]),
        i_f_q=state.get("i_f_q", i_g[1]),
        u_alpha=state.get("pending_d", 0.0),
        u_beta=state.get("pending_q", 0.0),
        **{name: state[name] for name in _NOTCH if name in state},
        limiter=limiter.memory(*(state[name] for name in limiter_states(limiter.memory._fields))),
    )
    after, output = controller_sample(
        controller,
        measured,
        P + push["P_meas"],
        Q + push["Q_meas"],
        controller.theta + push["theta_cmd"],
        controller.V + push["V_cmd"],
        GridEstimate(R_g=values["R_g"], L_g=values["L_g"]),
        refs,
        power_gains,
        inner_gains,
        settings,
        limiter.law,
    )
    v_b = output.v_b_alpha, output.v_b_beta
    applied = (state["pending_d"], state["pending_q"]) if "pending_d" in state else v_b
    return _Sampled(circuit, settings, controller, after, output, applied)


def _one_period(
    names: tuple[str, ...],
    z: ca.SX,
    p: ca.SX,
    u: ca.SX,
    squarings: int,
    limiter: LimiterInModel,
    link: LinkInModel | None,
) -> tuple[ca.SX, ca.SX]:
    state = dict(zip(names, ca.vertsplit(z), strict=True))
    values = _values_of(p, limiter, () if link is None else link.parameters)
    push: dict[str, ca.SX] = dict(zip(INPUTS, ca.vertsplit(u), strict=True))
    circuit, settings, controller, after, output, applied = _sampled(state, values, push, limiter)
    omega_g = values["omega_g"] + push["omega_g"]
    V_g = rms_to_peak(values["V_g"] + push["V_g"])
    transition, bridge, source_re, source_im = _exact_step(circuit, omega_g, settings.T_s, squarings)
    turn_cos, turn_sin = np.cos(omega_g * settings.T_s), np.sin(omega_g * settings.T_s)
    acting = applied
    if link is not None and link.order:  # the modulation divides by the nominal voltage of the link
        share = state["v_dc"] / values["link.V_dc"]
        acting = (share * applied[0], share * applied[1])
    along = [transition @ ca.vertcat(*(state[f"{n}_{a}"] for n in ("i_s", "v_c", "i_g"))) for a in "dq"]
    along = [x + bridge * v for x, v in zip(along, acting, strict=True)]
    # The source's phasor is V_g∠0 at the start of the period: what it adds has a part in each axis.
    along = [along[0] + source_re * V_g, along[1] + source_im * V_g]
    before = [state[f"{n}_{a}"] for n in ("i_s", "v_c", "i_g") for a in "dq"]
    of_link: dict[str, ca.SX] = {}
    if link is not None and link.order:
        of = _circuit_of_period(circuit, omega_g, V_g, settings.T_s, squarings, (turn_cos, turn_sin))
        of_link, added = link.together(state, values, before, applied, of)
        along = [x + ca.vertcat(*more) for x, more in zip(along, added, strict=True)]
    plant = [rotate_back(along[0][k], along[1][k], turn_cos, turn_sin) for k in range(3)]
    theta, omega = after.theta, output.omega
    if link is not None:
        theta, omega = link.turned(theta, omega, state, values, settings.T_s)
    following = {
        **{f"{n}_{a}": plant[k][j] for k, n in enumerate(("i_s", "v_c", "i_g")) for j, a in enumerate("dq")},
        **after._asdict(),
        "delta": theta - settings.T_s * omega_g,
        **dict(zip(limiter_states(limiter.memory._fields), after.limiter, strict=True)),
    }
    pending = rotate_back(output.v_b_alpha, output.v_b_beta, turn_cos, turn_sin)
    following |= {"pending_d": pending[0], "pending_q": pending[1]}
    if link is not None and not link.order:
        beyond = [along[j][k] for k in range(3) for j in range(2)]
        of_link = link.following(state, values, before, beyond, applied)
    following |= of_link
    outputs = ca.vertcat(output.P, output.Q, omega, controller.V, controller.theta, *applied)
    return ca.vertcat(*(following[name] for name in names)), outputs


def _values_of(p: ca.SX, limiter: LimiterInModel, more: tuple[str, ...] = ()) -> dict[str, ca.SX]:
    constants = limiter_states(limiter.constants._fields)
    return dict(zip((*PARAMETERS, *SETTINGS, *constants, *more), ca.vertsplit(p), strict=True))


@dataclass(frozen=True)
class ControllerMap:
    """The controller alone, for a unit of a plant: ``sample(z, p)`` gives its states after a sample, without the turn
    of the frame, and the bridge voltage that acts from this sample on; ``linear(z, p)`` gives the derivative of both.

    z begins with the six states of its filter, and ``names`` are those of the controller, which follow.
    """

    names: tuple[str, ...]
    sample: ca.Function
    linear: ca.Function
    angles: tuple[str, ...] = ("delta",)
    """Those of the states that are angles to the source."""
    pairs: tuple[tuple[str, str], ...] = ()
    """Those that are components of a vector in the frame of the source."""


@functools.cache
def controller_map(
    delay: int, filter_P: bool, filter_Q: bool, transient: bool, limiter: LimiterInModel, notch: bool
) -> ControllerMap:
    """The controller's part of :func:`full_order_map`."""
    names = _state_names(delay, filter_P, filter_Q, transient, notch, limiter)
    z = ca.SX.sym("z", len(names))
    p = ca.SX.sym("p", len(PARAMETERS) + len(SETTINGS) + len(limiter.constants._fields))
    with numpy_on_symbols():
        state = dict(zip(names, ca.vertsplit(z), strict=True))
        still: dict[str, ca.SX] = {name: ca.SX(0.0) for name in INPUTS}
        found = _sampled(state, _values_of(p, limiter), still, limiter)
    following = {
        **found.after._asdict(),
        "delta": found.after.theta,
        "pending_d": found.output.v_b_alpha,
        "pending_q": found.output.v_b_beta,
        **dict(zip(limiter_states(limiter.memory._fields), found.after.limiter, strict=True)),
    }
    result = ca.vertcat(*(following[name] for name in names[_PLANT:]), *found.applied)
    derivative = ca.densify(ca.jacobian(result, z))
    return ControllerMap(
        names[_PLANT:],
        ca.Function("sample", [z, p], [result], {"cse": True}),
        ca.Function("sample_linear", [z, p], [result, derivative], {"cse": True}),
        pairs=(("pending_d", "pending_q"),) if delay else (),
    )


def _circuit_of_period(
    circuit: FilterGrid, omega: ca.SX, V_g: ca.SX, T_s: ca.SX, squarings: int, turn: tuple[ca.SX, ca.SX]
) -> CircuitOfPeriod:
    """What a dc link needs of the circuit, with the source's phasor V_g∠0 at the beginning and turned at the end."""
    A, b = _rates(circuit)
    middle = _exact_step(circuit, omega, 0.5 * T_s, squarings)[0] @ b
    edge = []
    for k in range(1, _EDGE_DEGREE + 1):  # the Taylor series about the middle (:eq:`edge-polynomial`)
        middle = middle * (0.5 * T_s / k)
        edge.append(ca.vertsplit(middle))
        middle = A @ middle
    per_source = filter_grid_derivative(0.0, 0.0, 0.0, 0.0, V_g, circuit)[2]
    rest = [(per_source, per_source * turn[0]), (0.0, per_source * turn[1])]
    return CircuitOfPeriod(near=[A[2, k] for k in range(3)], rest=rest, edge=edge)


def _rates(circuit: FilterGrid) -> tuple[ca.SX, ca.SX]:
    """A and b of a circuit."""
    symbols = ca.SX.sym("s", 4)
    i_s, v_c, i_g, v_b = ca.vertsplit(symbols)
    found = ca.jacobian(ca.vertcat(*filter_grid_derivative(i_s, v_c, i_g, v_b, 0.0, circuit)), symbols)
    return found[:, :3], found[:, 3]


WATCHED = ("i_want_d", "i_want_q", "v_b_d", "v_b_q", "V", "v_d", "v_q", "i_g_d", "i_g_q")
"""What the limits look at: the current that is asked for and the bridge voltage that is set (peak), V (rms), and the
voltage and the grid current that were measured (peak, in the converter's frame)."""


@functools.cache
def watched_map(
    delay: int, filter_P: bool, filter_Q: bool, transient: bool, limiter: LimiterInModel, notch: bool
) -> tuple[tuple[str, ...], ca.Function]:
    """The names of z, and ``watched(z, p)``: WATCHED of a sample, and their derivative by z."""
    names = _state_names(delay, filter_P, filter_Q, transient, notch, limiter)
    z = ca.SX.sym("z", len(names))
    p = ca.SX.sym("p", len(PARAMETERS) + len(SETTINGS) + len(limiter.constants._fields))
    views: list[Any] = []

    def limit(memory: Any, view: Any, *others: Any) -> Any:
        views.append(view)
        return limiter.law.limit(memory, view, *others)

    looking = limiter._replace(law=LimiterLaw(limit, limiter.law.move))
    with numpy_on_symbols():
        state = dict(zip(names, ca.vertsplit(z), strict=True))
        still: dict[str, ca.SX] = {name: ca.SX(0.0) for name in INPUTS}
        found = _sampled(state, _values_of(p, limiter), still, looking)
    (view,) = views
    measured = view.v_d, view.v_q, view.i_g_d, view.i_g_q
    set_ = found.output.v_b_alpha, found.output.v_b_beta
    result = ca.vertcat(view.i_want_d, view.i_want_q, *set_, state["V"], *measured)
    return names, ca.Function("watched", [z, p], [result, ca.densify(ca.jacobian(result, z))], {"cse": True})


def _exact_step(circuit: FilterGrid, omega: ca.SX, h: ca.SX, squarings: int) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Φ, Γ and the real and imaginary response to a source e^{jωs}: one exponential of a 6×6 matrix.

    The circuit is augmented by a constant (the bridge) and by an oscillator (the source); row i of the result
    holds what each of them adds to state i.
    """
    symbols = ca.SX.sym("s", 5)
    i_s, v_c, i_g, v_b, v_g = ca.vertsplit(symbols)
    rates = ca.vertcat(*filter_grid_derivative(i_s, v_c, i_g, v_b, v_g, circuit))
    M = ca.SX(6, 6)
    M[:3, :5] = ca.jacobian(rates, symbols)
    M[4, 5], M[5, 4] = -omega, omega
    scaled = M * (h / 2.0**squarings)
    exponential, term = ca.SX.eye(6), ca.SX.eye(6)
    for k in range(1, _TAYLOR_ORDER + 1):
        term = ca.mtimes(term, scaled) / k
        exponential = exponential + term
    for _ in range(squarings):
        exponential = ca.mtimes(exponential, exponential)
    # The α axis sees the oscillator's first state; the β axis is a quarter turn behind, hence the sign.
    return exponential[:3, :3], exponential[:3, 3], exponential[:3, 4], -exponential[:3, 5]
