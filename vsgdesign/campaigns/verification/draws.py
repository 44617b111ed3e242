"""Random cases: from numbers that a counter gives for each case to grids, powers, estimates and disturbances.

Case k has 16 numbers of a Philox generator, whose key is the seed and whose counter is 4 k. A case is therefore the
same in whichever block, shard or order it is drawn. :func:`cases_of` maps numbers from 0 to 1 to cases; a search or a
sequence that covers the box evenly gives it other numbers than a generator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import SCR_BASES, error_half_widths
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.errors import Fault, StudyError
from vsgdesign.identification.interface import samples_itself
from vsgdesign.linear.operating_point.equilibrium import converter_current_rms, static_limit_uses
from vsgdesign.metrics.survival import REST_SHARE
from vsgdesign.runtime.error_set import ErrorSet, error_shares
from vsgdesign.runtime.of_study import ControllerGains, gain_law
from vsgdesign.simulation.lanes.around import Around
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, REACTIVE, STEP, LaneCases, LaneEvents, no_events
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S
from vsgdesign.study.parameters.case_families import FAMILIES, LOSS, families
from vsgdesign.study.parameters.converter import scope_of
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.fields import at
from vsgdesign.study.parameters.grid import only_a_grid
from vsgdesign.study.parameters.ranges import Range, logarithmic_of, signed_of, uniform_of
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.study.parameters.verification import CaseBox, VerificationSpec

Array = NDArray[np.float64]
Index = NDArray[np.int8]
ShareOf = Callable[[Index], tuple[Array, Array]]
"""From the family of each case to the share of the grid's impedance that is seen before and after the disturbance."""

COORDINATES: tuple[str, ...] = (
    "family",
    "scr",
    "x_over_r",
    "P",
    "Q",
    "V_g",
    "f_g",
    "error_R",
    "error_X",
    "silent",
    "instant",
    "own_1",
    "own_2",
    "own_3",
    "own_4",
)
"""What each of a case's numbers decides. The last four belong to its family."""

UNIFORMS, _BLOCKS = len(COORDINATES), 4
"""Numbers of a case, and the blocks of four that it takes from the generator: one number is left for the future."""

_MOST_EVENTS = 2
_LEAST_APART_S = 0.01
"""A ramp takes at least this long, s: two events of a case are never at the same instant."""

_BISECTIONS = 24
_SEED_DIGITS = 9
"""Digits of a case's numbers that the seed of its background and sensors is made of: a search changes their last ones.
"""

_LEAST_ERROR = -1.0
"""No estimator says that a resistance is negative."""


def draw_cases(
    study: Study, spec: ControllerSpec, first: int, count: int, ready: Ready = NOTHING
) -> tuple[LaneCases, Index]:
    """Cases ``first`` to ``first + count`` of a controller by the study's [verification], and the number of the family
    of each in :data:`FAMILIES`. Case k depends on the seed and on k alone.

    Raises StudyError where nothing can be drawn, InfeasibleStudyError for a table that is not in ``ready``.
    """
    return cases_of(study, spec, uniforms_of(verification_of(study, spec, ready).seed, first, count), ready=ready)


def uniforms_of(seed: int, first: int, count: int, more: int = 0) -> Array:
    """(count, UNIFORMS + more): the numbers in [0, 1) of the cases from ``first`` on. ``more``, up to 16, are those of
    a plant."""
    found = []
    for stream, wanted in enumerate((UNIFORMS, more)):
        generator = np.random.Generator(np.random.Philox(key=seed, counter=[_BLOCKS * first, stream, 0, 0]))
        found.append(generator.random((count, 4 * _BLOCKS))[:, :wanted])
    return np.concatenate(found, axis=1) if more else found[0]


def verification_of(study: Study, spec: ControllerSpec, ready: Ready = NOTHING) -> VerificationSpec:
    """What is drawn for a controller: the study's [verification]. Where the controller has a gain table, the part of
    its box that the study does not give lies within the table's validity.

    Raises StudyError where the study gives a range that lies outside the table's validity, or has no verification.
    """
    asked = study.verification
    if asked is None:
        fault = Fault("verification", "", "the study was built from its parts and has none", "Read it from a document.")
        raise StudyError(study.name, [fault])
    asked, table = _with_loss(asked, study), ready.table(spec)
    if table is None:
        return asked
    valid, box, faults = table.validity, asked.box, []
    changes: dict[str, Range | str] = {}
    if table.base.scr_basis != box.scr_basis:
        if "scr" in asked.given:
            fault = f"the table of controller {spec.name} has the basis {table.base.scr_basis}"
            faults.append(Fault("verification.scr_basis", box.scr_basis, fault, "Give scr on that basis."))
        changes |= {"scr_basis": table.base.scr_basis, "scr": valid.scr}
    for name in ("scr", "x_over_r", "P", "Q"):
        (low, high), (least, most) = getattr(box, name), getattr(valid, name)
        if name in changes or (study.specification is None and name not in asked.given):
            changes[name] = (least, most)
            continue
        slack = 1e-9 * max(abs(least), abs(most))
        if low >= least - slack and high <= most + slack:
            continue
        if name in asked.given or max(low, least) > min(high, most):
            said = f"is not within the validity of the table of controller {spec.name}, {least:.6g} to {most:.6g}"
            advice = "Take a part of that range, or another table."
            faults.append(Fault(f"verification.{name}", f"{low:.6g} to {high:.6g}", said, advice))
        changes[name] = (max(low, least), min(high, most))
    errors = _errors_within(study, spec, asked, error_shares(table), faults)
    if faults:
        raise StudyError(study.name, faults)
    return replace(asked, box=replace(box, errors=errors, **changes))


def _with_loss(asked: VerificationSpec, study: Study) -> VerificationSpec:
    """Where nothing is said, units of a plant are lost as often as anything else happens."""
    family = asked.families.get("loss")
    if study.plant is None or len(study.plant.units) < 2 or family is None or family.weight is not None:
        return asked
    return replace(asked, families={**asked.families, "loss": replace(family, weight=1.0)})


def _errors_within(
    study: Study, spec: ControllerSpec, asked: VerificationSpec, made_for: ErrorSet, faults: list[Fault]
) -> tuple[float, float, float]:
    """The errors of the estimate: those that the study asks for, as far as the table was made for them; all of the
    table's where the study has no specification."""
    found = []
    for name, wanted, most in zip(ErrorSet._fields, asked.box.errors, made_for, strict=True):
        if name in asked.given and wanted > most * (1.0 + 1e-9):
            said = f"is more than the table of controller {spec.name} is made for, {most:g}"
            faults.append(Fault(f"verification.{name}", f"{wanted:g}", said, "Ask for less, or take another table."))
        given = name in asked.given or study.specification is not None
        found.append(min(wanted, most) if given else most)
    return found[0], found[1], found[2]


def rests_at_limit(study: Study) -> bool:
    """Whether a controller with the limit of the study has a current limit, and a limiter that can rest at it."""
    return study.limiter.rests and study.converter.current_limit_pu is not None


def cases_of(
    study: Study,
    spec: ControllerSpec,
    uniforms: ArrayLike,
    family: int | NDArray[np.integer] | None = None,
    ready: Ready = NOTHING,
    share_of: ShareOf | None = None,
) -> tuple[LaneCases, Index]:
    """The cases of numbers in [0, 1), (N, UNIFORMS), and the family of each.

    With ``family``, a number or (N,), the family is given, and the first coordinate is not used. ``share_of``: of a
    unit of a plant, which sees a share of the impedance that is drawn. See :func:`draw_cases` for the errors.
    """
    only_a_grid(study.network, "a verification")
    # Contiguous columns: what NumPy computes then does not depend on how many cases there are.
    u = dict(zip(COORDINATES, np.ascontiguousarray(np.asarray(uniforms, dtype=float).T), strict=True))
    study, asked = study.with_limit_of(spec), verification_of(study, spec, ready)
    weights = np.array(list(asked.weights(rests_at_limit(study)).values()))
    if family is None and not weights.sum() > 0.0:
        said = f"nothing is drawn for controller {spec.name}: no family has a weight above zero"
        raise StudyError(
            study.name, [Fault("verification", "", said, "Give one, as in [verification.step] weight = 1.")]
        )
    if family is None:
        drawn = np.searchsorted(np.cumsum(weights) / weights.sum(), u["family"], side="right")
        family = np.minimum(drawn, int(np.flatnonzero(weights)[-1]))
    kind = np.broadcast_to(np.asarray(family, dtype=np.int8), u["scr"].shape).copy()
    if share_of is None and (kind == families().index(LOSS)).any():
        fault = Fault("verification.loss.weight", "", "there is no unit to lose", "Leave it out, or give a [plant].")
        raise StudyError(study.name, [fault])
    around = Around.drawn(study, [] if study.undisturbed is study else _seeds(u))
    whole = np.ones(len(kind))
    shares = (whole, whole) if share_of is None else share_of(kind)
    draw = _Draw(study, asked, u, kind, rests_at_limit(study), around, shares)
    return _with_references(draw, _starts(draw), spec, gain_law(study, spec, ready)), kind


def _seeds(u: dict[str, Array]) -> list[int]:
    """One for each case, with which its background and its sensors are drawn."""
    numbers = np.round(10.0**_SEED_DIGITS * np.stack(list(u.values()), axis=1)).astype(np.int64)
    return [int(np.random.SeedSequence(row).generate_state(1)[0] >> 1) for row in numbers.tolist()]


class _Draw(NamedTuple):
    """What the cases are drawn from."""

    study: Study
    """With the current limit of the controller."""
    asked: VerificationSpec
    u: dict[str, Array]
    family: Index
    rests_at_limit: bool
    around: Around
    """Backgrounds and sensors of the cases; voltage and frequency are still to be changed by the former."""
    shares: tuple[Array, Array]
    """Of the impedance that is drawn, before and after the disturbance: 1, but of a unit of a plant n/N."""

    @property
    def box(self) -> CaseBox:
        return self.asked.box

    def of(self, name: str) -> NDArray[np.intp]:
        """The cases of a family."""
        return np.flatnonzero(self.family == families().index(name))

    def ranges(self, name: str) -> dict[str, Range]:
        return self.asked.ranges(name, self.rests_at_limit)


class _Starts(NamedTuple):
    """The place of every case before its disturbance, and what the power flow has to carry after it, (N,)."""

    R_g: Array
    L_g: Array
    R_after: Array
    L_after: Array
    V_g_rms: Array
    omega_g: Array
    P: Array
    Q: Array
    """Powers at the control point at rest."""
    dP: Array
    dQ: Array
    """By how much the references change."""


def _starts(draw: _Draw) -> _Starts:
    box, u = draw.box, draw.u
    R_g, L_g = _grid(draw, u["scr"], u["x_over_r"])
    R_after, L_after = R_g.copy(), L_g.copy()
    jumps = draw.of("grid")
    R_after[jumps], L_after[jumps] = _grid(draw, u["own_1"][jumps], u["own_2"][jumps])
    before, after = draw.shares
    R_g, L_g, R_after, L_after = before * R_g, before * L_g, after * R_after, after * L_after
    P, Q = uniform_of(box.P, u["P"]), uniform_of(box.Q, u["Q"])
    dP, dQ = _steps_of_references(draw, P, Q)
    V_g_rms, omega_g = draw.around.sources(uniform_of(box.V_g_rms, u["V_g"]), uniform_of(box.omega_g, u["f_g"]))
    starts = _Starts(
        R_g=R_g,
        L_g=L_g,
        R_after=R_after,
        L_after=L_after,
        V_g_rms=V_g_rms,
        omega_g=omega_g,
        P=P,
        Q=Q,
        dP=dP,
        dQ=dQ,
    )
    return _within_limits(draw, starts)


def _steps_of_references(draw: _Draw, P: Array, Q: Array) -> tuple[Array, Array]:
    """By how much P_ref and Q_ref change, W and var. A step that would leave the box goes the other way."""
    box, u = draw.box, draw.u
    changes = np.zeros_like(P), np.zeros_like(Q)
    steps = draw.of("step")
    sizes = draw.study.converter.S_rated * signed_of(draw.ranges("step")["size"], u["own_2"][steps])
    active = u["own_1"][steps] < 0.5
    for change, present, ends, chosen in zip(changes, (P, Q), (box.P, box.Q), (active, ~active), strict=True):
        at, d = steps[chosen], sizes[chosen]
        x = present[at]
        ahead = (x + d >= ends[0]) & (x + d <= ends[1])
        back = (x - d >= ends[0]) & (x - d <= ends[1])
        inwards = np.where(x == 0.0, d, -np.sign(x) * np.abs(d))  # where the box is narrower than the step
        change[at] = np.where(ahead, d, np.where(back, -d, inwards))
    large = draw.of("reference")
    changes[0][large] = uniform_of(box.P, u["own_1"][large]) - P[large]
    return changes


def _within_limits(draw: _Draw, starts: _Starts) -> _Starts:
    """The powers reduced by one factor until the converter and both grids carry them, before and after a step.

    A large step of P_ref becomes smaller with the powers; a small step keeps its size.
    """
    small = np.isin(draw.family, [FAMILIES.index("step")])

    def scaled(at: NDArray[np.intp], share: Array) -> _Starts:
        part = _Starts(*(values[at] for values in starts))
        of_step = np.where(small[at], 1.0, share)
        return part._replace(P=share * part.P, Q=share * part.Q, dP=of_step * part.dP, dQ=of_step * part.dQ)

    share = np.ones(len(starts.P))
    at = np.flatnonzero(~_carried(draw.study, scaled(np.arange(len(share)), share)))
    low, high = np.zeros(len(at)), np.ones(len(at))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        inside = _carried(draw.study, scaled(at, middle))
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    share[at] = low
    return scaled(np.arange(len(share)), share)


def _carried(study: Study, at: _Starts) -> NDArray[np.bool_]:
    """Which cases can be carried: the static limits hold before and after, and the converter's current is at most the
    share of its limit that a survival measurement asks for."""
    c = study.converter
    most = np.inf if c.current_limit_pu is None else REST_SHARE * c.current_limit_pu * c.I_rated_pk
    good = np.ones(len(at.P), dtype=bool)
    for R_g, L_g, P, Q in ((at.R_g, at.L_g, at.P, at.Q), (at.R_after, at.L_after, at.P + at.dP, at.Q + at.dQ)):
        R, X = study.filter.R_2 + R_g, at.omega_g * (study.filter.L_2 + L_g)
        with np.errstate(invalid="ignore"):
            V_rms, _ = operating_point(P, Q, at.V_g_rms, R, X)
            current = rms_to_peak(np.abs(converter_current_rms(study, at.omega_g, P, Q, V_rms)))
            for use in static_limit_uses(study, R, X, at.omega_g, P, Q, V_rms).values():
                good &= use <= 1.0
            good &= current <= most
    return good


def _with_references(draw: _Draw, at: _Starts, spec: ControllerSpec, law: ControllerGains) -> LaneCases:
    """The cases with their events. The references contain what the droops of the gains add."""
    c, u = draw.study.converter, draw.u
    R, X = draw.study.filter.R_2 + at.R_g, at.omega_g * (draw.study.filter.L_2 + at.L_g)
    V_rms, _ = operating_point(at.P, at.Q, at.V_g_rms, R, X)
    error_R, error_X, silent_s = _knowledge(draw, at, spec)
    with np.errstate(invalid="ignore", divide="ignore"):
        gains = law(at.R_g * (1.0 + error_R), at.L_g * (1.0 + error_X), at.P, at.Q, V_rms)
    droop_P = np.nan_to_num(gains.D_p * (at.omega_g - c.omega_n), nan=0.0)
    droop_Q = np.nan_to_num(gains.D_q * (V_rms - c.V_rated_rms), nan=0.0)
    references = at.P + droop_P, at.Q + droop_Q
    learns = spec.kind == "scheduled" and samples_itself(spec.estimate)
    events, cleared_s = _events(draw, at, references, LEARNING_S if learns else LEAD_S)
    step, signal = draw.of("step"), np.full(len(at.P), ACTIVE, dtype=np.int8)
    signal[step] = np.where(u["own_1"][step] < 0.5, ACTIVE, REACTIVE)
    return LaneCases(
        R_g=at.R_g,
        L_g=at.L_g,
        V_g_rms=at.V_g_rms,
        omega_g=at.omega_g,
        P_ref=references[0],
        Q_ref=references[1],
        events=events,
        error_R=error_R,
        error_X=error_X,
        silent_s=silent_s,
        cleared_s=cleared_s,
        kind=np.where(draw.family == FAMILIES.index("step"), STEP, DISTURBANCE).astype(np.int8),
        signal=signal,
        around=draw.around.neutral,
    )


def _events(draw: _Draw, at: _Starts, references: tuple[Array, Array], lead_s: float) -> tuple[LaneEvents, Array]:
    """What happens in each case after a rest of lead_s, and when the last change is over, s."""
    u, events = draw.u, no_events(len(at.P), _MOST_EVENTS)
    begin = lead_s + u["instant"] * (2.0 * np.pi / draw.study.converter.omega_n)
    events.t_s[:, 0] = begin
    cleared_s = begin.copy()
    for ref, changes, events_of in zip(references, (at.dP, at.dQ), (events.P_ref, events.Q_ref), strict=True):
        moved = np.flatnonzero(changes)
        events_of[moved, 0] = ref[moved] + changes[moved]
    grid = draw.of("grid")
    events.R_g[grid, 0], events.L_g[grid, 0] = at.R_after[grid], at.L_after[grid]
    events.phase_jump[grid, 0] = signed_of(draw.ranges("grid")["phase"], u["own_3"][grid])
    phase = draw.of("phase")
    events.phase_jump[phase, 0] = signed_of(draw.ranges("phase")["jump"], u["own_1"][phase])
    sag, ranges = draw.of("sag"), draw.ranges("sag")
    jump = signed_of(ranges["phase"], u["own_3"][sag])
    events.V_g_rms[sag, 0] = at.V_g_rms[sag] * (1.0 - uniform_of(ranges["depth"], u["own_1"][sag]))
    events.V_g_rms[sag, 1] = at.V_g_rms[sag]
    events.phase_jump[sag, 0], events.phase_jump[sag, 1] = jump, -jump
    events.t_s[sag, 1] = cleared_s[sag] = begin[sag] + logarithmic_of(ranges["duration"], u["own_2"][sag])
    ramp, ranges = draw.of("ramp"), draw.ranges("ramp")
    size = signed_of(ranges["size"], u["own_1"][ramp])
    over = np.maximum(np.abs(size) / logarithmic_of(ranges["rate"], u["own_2"][ramp]), _LEAST_APART_S)
    events.omega_g[ramp, 0] = at.omega_g[ramp] + 2.0 * np.pi * size
    events.omega_g[ramp, 1] = at.omega_g[ramp]
    events.over[ramp] = over[:, None]
    events.t_s[ramp, 1] = begin[ramp] + over + uniform_of(ranges["hold"], u["own_3"][ramp])
    cleared_s[ramp] = events.t_s[ramp, 1] + over
    _step_kinds(draw, events)
    return events, cleared_s


def _step_kinds(draw: _Draw, events: LaneEvents) -> None:
    """Steps of the kinds that have no family of their own here. One that would leave the limits ends at them."""
    c = draw.study.converter
    for name, (kind, step) in EVENT_KINDS.steps.items():
        of = draw.of(name)
        if of.size:
            size = (uniform_of if step.new else signed_of)(draw.ranges(name)["size"], draw.u["own_1"][of])
            scope = scope_of(c, draw.study.simulation.reference_limit_pu)
            low, high = (kind.one(c) * at(end, scope) for end in (kind.low, kind.high))
            getattr(events, kind.quantity)[of, 0] = np.clip(step.value(size, c), low, high)


def _knowledge(draw: _Draw, at: _Starts, spec: ControllerSpec) -> tuple[Array, Array, Array]:
    """error_R, error_X and silent_s: zero for a controller that is told nothing, and for steps nothing is silent."""
    none, u = np.zeros(len(at.P)), draw.u
    if spec.kind != "scheduled" or spec.estimate != "truth":
        return none, none.copy(), none.copy()
    X = draw.study.converter.omega_n * at.L_g
    h_R, h_X = error_half_widths(at.R_g, X, *draw.box.errors)
    error_R = np.maximum((2.0 * u["error_R"] - 1.0) * h_R / at.R_g, _LEAST_ERROR)
    error_X = (2.0 * u["error_X"] - 1.0) * h_X / X
    silent_s = logarithmic_of(draw.asked.silent_s, u["silent"])
    return error_R, error_X, np.where(draw.family == FAMILIES.index("step"), 0.0, silent_s)


def _grid(draw: _Draw, of_scr: Array, of_ratio: Array) -> tuple[Array, Array]:
    """R_g (Ω) and L_g (H), log-uniform over the box."""
    c, box = draw.study.converter, draw.box
    scr, x_over_r = logarithmic_of(box.scr, of_scr), logarithmic_of(box.x_over_r, of_ratio)
    R_g, L_g = SCR_BASES[box.scr_basis].grid(scr, x_over_r, c.Z_base, c.omega_n)
    return R_g, L_g


__all__ = [
    "COORDINATES",
    "FAMILIES",
    "UNIFORMS",
    "cases_of",
    "draw_cases",
    "families",
    "uniforms_of",
    "verification_of",
]
