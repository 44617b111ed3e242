"""The results in words: which targets are met or missed, by how much, why the closed form misses them, and for what
time its poles are placed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.equations.placing import OVERSHOOT_PCT, Poles, damping_of, placed_poles, settling_factor
from vsgdesign.equations.structures import STRUCTURES, effective_inertia, steady_droops
from vsgdesign.linear.stability.maps import cell_set, full_order_cells
from vsgdesign.linear.stability.step_responses import full_order_settling
from vsgdesign.metrics.events import UNSTABLE
from vsgdesign.metrics.survival import HARDWARE_PU, Survival
from vsgdesign.report.drawing.quantities import number, percent, plain, plain_quantity
from vsgdesign.report.scenario.outcomes import StepOutcome
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult
from vsgdesign.simulation.scenario.judging import CLOSED_FORM
from vsgdesign.study.parameters.study import ControllerSpec, Study

_MOST_LISTED = 6
_WEAK_COUPLING = 0.1
"""A |c| below this does not make a step overshoot by itself."""


def verdict(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> list[str]:
    """The paragraphs of the verdict: targets, then what else a reader must know."""
    if not outcomes:
        later = [event for event in result.study.events if event.t_s > 0.0]
        stepped = any(event.P_ref is not None or event.Q_ref is not None for event in later)
        reason = "No reference step moves its power measurably" if stepped else "No event steps a reference"
        no_step = f"{reason}, so there is no settling time or overshoot to hold to a target."
        return [text for text in (no_step, survival_text(result), _at_limit(result), _stress(result)) if text]
    paragraphs = [_summary(result, outcomes) + _unjudged(outcomes)]
    for controller in result.controllers:
        own = [outcome for outcome in outcomes if outcome.controller is controller]
        if own:
            paragraphs.append(_against_target(controller, own, _MOST_LISTED // min(len(result.controllers), 3)))
    return [text for text in (*paragraphs, survival_text(result), _at_limit(result), _stress(result)) if text]


def _at_limit(result: ScenarioResult) -> str:
    """Which controllers end at a limit, or are unstable there, and how; empty if none does."""
    said = [
        f"{c.spec.name}: {str(c.outcome.reason).split('. ')[0].removesuffix('.')}."
        for c in result.controllers
        if c.outcome.limits or c.outcome.status == "unstable"
    ]
    return " ".join(["At the end:", *said]) if said else ""


def _summary(result: ScenarioResult, outcomes: Sequence[StepOutcome]) -> str:
    """One sentence with the main result."""
    judged = [outcome for outcome in outcomes if outcome.judged]
    names = [c.spec.name for c in result.controllers if any(outcome.controller is c for outcome in judged)]
    failed = {outcome.controller.spec.name for outcome in judged if outcome.misses}
    good = [name for name in names if name not in failed]
    if not names:
        return "No reference step can be held to its target."
    left = _left_out([outcome for outcome in outcomes if outcome.controller.spec.name in good], len(names) > 1)
    if len(names) == 1:
        if failed:
            missed = [outcome for outcome in judged if outcome.misses]
            said = ": where it misses, its table gives up the promise" if all(m.given_up for m in missed) else ""
            return f"{names[0]} does not meet its settling time and overshoot on every step{said}."
        return f"{names[0]} meets its settling time and overshoot on every step{left}."
    if not good:
        return "No controller meets its settling time and overshoot on every reference step."
    if not failed:
        return f"Every controller meets its settling time and overshoot on every reference step{left}."
    if left:
        return f"Settling time and overshoot are met by {', '.join(good)} only, on every reference step{left}."
    return f"Settling time and overshoot are met on every reference step by {', '.join(good)} only."


def _unjudged(outcomes: Sequence[StepOutcome]) -> str:
    """The controllers of which no step is judged, beside others; empty if there are none."""
    names = dict.fromkeys(outcome.controller.spec.name for outcome in outcomes)
    judged = {outcome.controller.spec.name for outcome in outcomes if outcome.judged}
    silent = [name for name in names if name not in judged]
    return f" No step of {', '.join(silent)} is judged." if judged and silent else ""


def _left_out(outcomes: Sequence[StepOutcome], named: bool) -> str:
    """The steps about which "every step" says nothing: nothing is promised of them, or they have no verdict."""
    parts = []
    for why, of in (("of which nothing is promised", True), ("which cannot be judged", False)):
        chosen = [one.controller.spec.name for one in outcomes if not one.judged and bool(one.excuse) is of]
        parts += [f"{chosen.count(name)}{f' of {name}' if named else ''}, {why}" for name in dict.fromkeys(chosen)]
    return f" but {', and '.join(parts)}" if parts else ""


def _against_target(controller: ControllerResult, outcomes: Sequence[StepOutcome], most: int) -> str:
    promises = outcomes[0].promises
    judged = [outcome for outcome in outcomes if outcome.judged]
    limit, time = promises.overshoot_pct, promises.settling_time
    asked = [] if time is None else [f"within 2 % after {plain(time)} s"]
    if limit is not None:
        asked.append("no overshoot" if limit == 0.0 else f"at most {percent(limit)} % overshoot of P")
    text = f"{controller.spec.name} ({controller.spec.kind} gains; {promises.source}: {', '.join(asked) or 'no step'})"
    missed = [outcome for outcome in judged if outcome.misses]
    sentences = []
    if judged and not missed:
        sentences.append(f"{text} meets {'both' if len(asked) == 2 else 'it'} on {_steps(len(judged))}.")
    elif judged:
        settled = sum(outcome.settles for outcome in judged)
        below = sum(outcome.stays_below for outcome in judged)
        parts = [] if time is None else [f"settling time met on {settled}"]
        parts += [] if limit is None else [f"overshoot on {below}"]
        sentences.append(f"{text}: {' and '.join(parts)} of {_steps(len(judged))}.")
        missed.sort(key=lambda outcome: -1e9 if outcome.settling_time_s is None else -outcome.settling_time_s)
        shown = sorted(missed[:most], key=lambda outcome: (outcome.metrics.t_s, outcome.metrics.signal))
        more = f"; and {len(missed) - len(shown)} more, in the table below" if len(missed) > len(shown) else ""
        sentences.append("; ".join(_miss(outcome) for outcome in shown) + more + ".")
    excused = [outcome for outcome in outcomes if outcome.excuse]
    if excused:
        lead = "" if judged else f"{text}: "
        first = excused[0]
        sentences.append(f"{lead}Of {_steps(len(excused))} nothing is promised ({_step_name(first)}: {first.excuse}).")
    unknown = [outcome for outcome in outcomes if not outcome.judged and not outcome.excuse]
    if unknown and asked:
        lead = "" if judged or excused else f"{text}: "
        why = "; ".join(f"{_step_name(outcome)}, {outcome.why_not_judged}" for outcome in unknown[:most])
        more = f"; and {len(unknown) - most} more, in the table below" if len(unknown) > most else ""
        sentences.append(f"{lead}{_steps(len(unknown))} cannot be judged, neither met nor missed: {why}{more}.")
    return " ".join(sentences)


def _steps(count: int) -> str:
    return "1 reference step" if count == 1 else f"{count} reference steps"


def _step_name(outcome: StepOutcome) -> str:
    return f"{outcome.metrics.name} at {plain(outcome.metrics.t_s)} s"


def _miss(outcome: StepOutcome) -> str:
    parts = []
    settled, target = outcome.settling_time_s, outcome.target_settling_time_s or 0.0
    if outcome.unstable:
        parts.append(outcome.metrics.reason or UNSTABLE)
    elif settled is None and not outcome.settles:
        parts.append(f"not settled within the {plain(outcome.window_s)} s observed")
    elif settled is not None and not outcome.settles:
        parts.append(f"settled after {outcome.settling_text} s ({number(settled - target, 2)} s late)")
    if not outcome.stays_below and not outcome.unstable:
        over = outcome.overshoot_pct
        allowed = outcome.target_overshoot_pct or 0.0
        beyond = f" ({number(over - allowed, 2)} too much)" if allowed else ""
        parts.append(f"{outcome.overshoot_text} % overshoot{beyond}")
    if not outcome.at_rest:
        parts.append("not at rest when the step came")
    if outcome.given_up:
        parts.append(outcome.given_up)
    return f"{_step_name(outcome)}: {', '.join(parts)}"


def _stress(result: ScenarioResult) -> str:
    """Currents and voltages that the converter must withstand."""
    converter = result.study.converter
    sentences = []
    currents = [
        (event.peak_current_pu, event, c)
        for c in result.controllers
        for event in c.events
        if event.peak_current_pu is not None
    ]
    limits_pu = {c.spec.name: result.study.with_limit_of(c.spec).converter.current_limit_pu for c in result.controllers}
    for limit_pu in dict.fromkeys(limits_pu.values()):  # the worst of the controllers with the same limit
        of_limit = [item for item in currents if limits_pu[item[2].spec.name] == limit_pu]
        if not of_limit:
            continue
        value, event, c = max(of_limit, key=lambda item: item[0])
        current = f"{number(value)} pu of the rated peak ({c.spec.name}, {event.name} at {plain(event.t_s)} s)"
        limit = f"the limit of its current reference is {plain(limit_pu)} pu" if limit_pu else "no current limit is set"
        start = "The largest current after an event is" if not sentences else "With another limit, it is"
        sentences.append(f"{start} {current}; {limit}.")
    points = [(c.spec.name, rest.t_s, rest.point) for c in result.controllers for rest in c.rests if rest.point]
    flagged = [one for one in points if not one[2].V_within_limits]
    total = len(points)
    limits = f"{plain(converter.V_min_pu)} to {plain(converter.V_max_pu)} pu"
    if flagged:
        name, since, far = max(flagged, key=lambda item: abs(item[2].V_rms / converter.V_rated_rms - 1.0))
        sentences.append(
            f"The voltage leaves its limits of {limits} at {len(flagged)} of {total} rests, by most at "
            f"{number(far.V_rms / converter.V_rated_rms, 4)} pu ({name}, from {plain(since)} s on)."
        )
    elif total:
        sentences.append(f"The voltage is within its limits of {limits} wherever a controller rests.")
    return " ".join(sentences)


def explanation(outcomes: Sequence[StepOutcome]) -> list[str]:
    """Why closed-form gains miss their target, if they do, from the numbers of this scenario."""
    missed = [
        outcome
        for outcome in outcomes
        # A step into an earlier transient says nothing about the design.
        if outcome.controller.spec.gains is None
        and outcome.at_rest
        and outcome.misses
        and not outcome.unstable
        and STRUCTURES[outcome.controller.spec.target.structure].uncoupled
        and outcome.promises.source == CLOSED_FORM
    ]
    if not missed:
        return []
    return [text for text in (_rule(missed), _coupling(missed), _other_grid(missed)) if text]


def _rule(missed: Sequence[StepOutcome]) -> str:
    late = {
        outcome.controller.spec.name: outcome.controller.spec.target
        for outcome in missed
        if outcome.metrics.signal == "P_pcc" and not outcome.settles
    }
    times = []
    for name, target in late.items():
        factor = settling_factor(target.damping_ratio)
        omega_n = 4.0 / (target.damping_ratio * target.settling_time)
        if factor / omega_n > 1.02 * target.settling_time:
            times.append(
                f"{number(factor)}/ω_n = {number(factor / omega_n)} s for {name} (ξ = {plain(target.damping_ratio)}, "
                f"target {plain(target.settling_time)} s)"
            )
    if not times:
        return ""
    return (
        "The rule ω_n = 4/(ξ·T_s) takes 4/(ξ·ω_n) for the settling time, which is the 2 % rule of underdamped loops. "
        f"At the operating point of the design, and even without coupling, the P loop needs {'; '.join(times)}."
    )


def _coupling(missed: Sequence[StepOutcome]) -> str:
    known: list[tuple[float, StepOutcome]] = []
    for outcome in missed:
        c = outcome.coupling
        if c is not None and abs(c) >= _WEAK_COUPLING and outcome.uncoupled is not None and not outcome.stays_below:
            known.append((c, outcome))
    if not known:
        return ""
    values = [c for c, _ in known]
    low, high = number(min(values)), number(max(values))
    span = low if low == high else f"between {low} and {high}"
    _, worst = max(known, key=lambda item: item[1].overshoot_pct - (_predicted(item[1]) or 0.0))
    return (
        "The design takes P to depend on δ alone and Q on V alone; it ignores B = ∂P/∂V and C = ∂Q/∂δ. Their weight is "
        f"c = BC/(AD), zero without coupling, and here {span} at the operating points of the steps that overshoot. "
        f"Farthest apart: {worst.controller.spec.name}, {worst.metrics.name} at {plain(worst.metrics.t_s)} s "
        f"(c = {number(worst.coupling)}), where the uncoupled loop would overshoot {percent(_predicted(worst))} % "
        f"and the simulation shows {percent(worst.overshoot_pct)} %."
    )


def _predicted(outcome: StepOutcome) -> float | None:
    return None if outcome.uncoupled is None else outcome.uncoupled.overshoot_pct


def _other_grid(missed: Sequence[StepOutcome]) -> str:
    """Fixed gains on a grid for which they were not designed: their damping ratio."""
    parts = []
    for outcome in missed:
        uncoupled, target = outcome.uncoupled, outcome.controller.spec.target
        if outcome.controller.spec.kind == "fixed" and uncoupled is not None and uncoupled.damping_ratio is not None:
            ratio = uncoupled.damping_ratio
            if abs(ratio / target.damping_ratio - 1.0) > 0.2:
                parts.append(
                    f"{number(ratio, 2)} instead of {plain(target.damping_ratio)} ({outcome.controller.spec.name}, "
                    f"{outcome.metrics.name} at {plain(outcome.metrics.t_s)} s)"
                )
    if not parts:
        return ""
    return (
        "Fixed gains meet operating points for which they were not designed. The damping ratio of the uncoupled P "
        f"loop is {'; '.join(parts[:4])}."
    )


def survival_text(result: ScenarioResult) -> str:
    """Which controllers survive the events, and how; empty where the study does not ask for it."""
    return " ".join(survival_sentence(c.spec.name, c.survival) for c in result.controllers if c.survival is not None)


def survival_sentence(name: str, verdict: Survival) -> str:
    """Whether a controller survives the events of its scenario, and its largest current."""
    if not verdict.judged:
        return f"{name} is not judged as one disturbance: {verdict.status}, {_ended(verdict.reason)}"
    said = f"{name} does not survive the events: {verdict.status}, {_ended(verdict.reason)}"
    if verdict.survived and verdict.recovery_s is not None:
        said = f"{name} survives the events and is at rest {plain(verdict.recovery_s)} s after the last one."
        if verdict.reason is not None:
            said = f"{said[:-1]}: {_ended(verdict.reason)}"
    if verdict.peak_pu is not None:
        said += f" Its largest current later than 5 ms after an event is {plain(verdict.peak_pu)} pu of the rated peak."
    if verdict.beyond_hardware:
        said += (
            f" This is {MORE_THAN_HARDWARE}: hardware of this rating trips or breaks above about {plain(HARDWARE_PU)} "
            "pu, and the verdict is about the control loops alone. Set current_limit_pu."
        )
    return said


def _ended(reason: str | None) -> str:
    """A reason as the end of a sentence; some of them have several sentences and their own full stop."""
    return f"{(reason or 'no reason is known').removesuffix('.')}."


def placing_text(result: ScenarioResult) -> str:
    """T, T_d, m and H of the controllers whose closed form places its poles (:eq:`placed-poles`); empty without one."""
    said = []
    for controller in result.controllers:
        spec, target = controller.spec, controller.spec.target
        closed = spec.gains is None and result.ready.table(spec) is None
        if not closed or STRUCTURES[target.structure].uncoupled or set(target.given) == set(Poles._fields):
            continue
        but = f" all but {', '.join(target.given)}, which the study gives," if target.given else " its poles"
        said.append(
            f"{spec.name}: the closed form for T = {plain(target.settling_time)} s places{but} for T_d = "
            f"(T − {plain_quantity(0.5 * target.mean_s, 's')})(1 − m) = {number(target.placing_time)} s with "
            f"m = {plain(target.margin)}{_inertia(result.study, controller)}.{_price(result.study, controller)}"
        )
    if not said:
        return ""
    error = 0.0 if result.study.specification is None else result.study.specification.error
    known = f" and for an estimate that is wrong by up to {plain(100.0 * error)} %" if error else ""
    why = (
        f"Steps are judged by a mean, which is late by half its length. m is for gains that move during a step{known}."
    )
    return " ".join((*said, why))


def _inertia(study: Study, controller: ControllerResult) -> str:
    """The inertia at the first rest, and what poles for T itself would give there; empty without a rest."""
    rest = next((rest for rest in controller.rests if rest.point is not None), None)
    spec, target = controller.spec, controller.spec.target
    before = placed_poles(target.settling_time, damping_of(OVERSHOOT_PCT))._asdict()
    at_T = replace(target, **{name: value for name, value in before.items() if name not in target.given})
    if rest is None or rest.point is None:
        return ""
    point = rest.grid.R_g, rest.grid.L_g, rest.point.P, rest.point.Q, rest.point.V_rms
    H, without = (_H(study, replace(spec, target=one), point) for one in (target, at_T))
    if not math.isfinite(H) or not math.isfinite(without):
        return ""
    return f"; at its first rest H is {number(H)} s, and poles for T itself would give {number(without)} s"


def _price(study: Study, controller: ControllerResult) -> str:
    """What a fast V loop costs: overshoot of Q and droop at the first rest; empty for other structures."""
    rest = next((rest for rest in controller.rests if rest.point is not None), None)
    target = controller.spec.target
    if STRUCTURES[target.structure].fast_V is None or rest is None or rest.point is None:
        return ""
    c, gains = study.converter, rest.gains
    own = replace(study.with_limit_of(controller.spec), grid_source=rest.source)
    model = full_order_cells(own, cell_set(own, rest.grid.R_g, rest.grid.L_g, rest.point.P, rest.point.Q, gains))
    _, overshoot = full_order_settling(model, "Q_ref", "Q")
    droop = 100.0 * float(steady_droops(gains, c.S_rated, c.omega_n, c.V_rated_rms)[0])
    stable = len(overshoot) and math.isfinite(overshoot[0])
    of_Q = f"a small step of Q_ref overshoots by {percent(100.0 * overshoot[0])} %" if stable else "it is unstable"
    return f" Its V loop has k_2 = {plain(target.k_2)} 1/s: there {of_Q}, and the P–f droop is {percent(droop)} %."


def _H(study: Study, spec: ControllerSpec, point: tuple[float, ...]) -> float:
    gains = gain_law(study, spec)(*point)
    return float(effective_inertia(gains, study.converter.S_rated, study.converter.omega_n))
