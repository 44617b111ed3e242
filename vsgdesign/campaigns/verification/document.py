"""What a verification says in JSON's types: what is drawn, in words; shares, bounds, quantiles and the map."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from vsgdesign.artifacts.table_text import error_text
from vsgdesign.artifacts.verification_text import family_words
from vsgdesign.campaigns.verification.blocks import VerificationJob
from vsgdesign.campaigns.verification.counting import FIGURES, Promise
from vsgdesign.campaigns.verification.summary import QUANTILE_ERROR, FamilyCount, PromiseCount, Summary, quantile
from vsgdesign.identification.interface import samples_itself
from vsgdesign.metrics.survival import HARDWARE_PU
from vsgdesign.simulation.lanes.rests import SWITCHED_WINDOW
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.ranges import Range
from vsgdesign.study.parameters.study import ControllerSpec, Study

CONFIDENCE = 0.99
"""Where nothing is said."""


def upper_bound(broken: int, judged: int, confidence: float = CONFIDENCE) -> float:
    """The share of broken cases that is not exceeded with a stated confidence (:eq:`clopper-pearson`).

    It is the share p at which at most ``broken`` of ``judged`` independent cases are broken with the probability
    1 - confidence: the one-sided bound of Clopper and Pearson, exact and never too small. It is 1 where every case is
    broken, and where nothing was judged. Raises ValueError for counts or a confidence that cannot be.
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence = {confidence!r}: must be between 0 and 1")
    if not 0 <= broken <= judged:
        raise ValueError(f"{broken} of {judged} cases cannot be broken")
    if broken == judged:
        return 1.0
    if broken == 0:  # the same number in closed form, without the rounding of a search for it
        return -math.expm1(math.log1p(-confidence) / judged)
    from scipy.special import betaincinv  # all of scipy.stats would take longer to load than a table to verify

    return float(betaincinv(broken + 1, judged - broken, confidence))


def one_in(bound: float) -> int:
    """The n of "fewer than 1 in n": 1 over a bound, rounded down to three digits, so that it never says too much."""
    if bound >= 1.0:
        return 1
    n = math.floor(1.0 / bound)
    unit = 10 ** max(len(str(n)) - 3, 0)
    return n // unit * unit


def record_faults(record: Mapping[str, Any]) -> Iterator[str]:
    """Where the shares, bounds and worst figures of a table's record do not belong to its counts, one sentence each."""
    for key, family in record["families"].items():
        for promised, promise in family["promises"].items():
            name = f"verification.families.{key}.promises.{promised}"
            for field, made in _share(promise["broken"], promise["judged"], record["confidence"]).items():
                stated = promise[field]
                same = stated is made if stated is None or made is None else abs(stated - made) <= 1e-9 * abs(made)
                if not same:
                    yield f"{name}.{field} is {stated}, {promise['broken']} of {promise['judged']} give {made}"
            worst, least = promise["worst"], promise.get("at_least", False)
            limit = promise["limit"] + promise.get("noise", 0.0)
            beyond = worst is not None and (worst < limit if least else worst > limit)
            if promise["broken"] and worst is not None and not beyond:
                yield f"{name}.worst is {worst:g}, within the limit {limit:g}, but {promise['broken']} are broken"
            if not promise["broken"] and beyond and abs(worst - limit) > _ALLOWED * limit:
                yield f"{name}.worst is {worst:g}, beyond the limit {limit:g}, but none is broken"


_ALLOWED = 0.1
"""Share of a limit by which a kept promise may be beyond it: more than any allowance of the judge."""

QUANTILES = ("50", "90", "99", "99.9")
"""Percentiles of each figure that are given."""


def counts_document(job: VerificationJob, summary: Summary, confidence: float) -> dict[str, Any]:
    """The counts of a verification with their bounds. A figure that does not exist (never settled) is infinite.

    A share is of the judged cases, and its bound is exact because all of them are drawn independently.
    """
    broken = sum(family.broken for family in summary.families.values())
    return {
        "runs": summary.drawn,
        "judged": summary.judged,
        **_share(broken, summary.judged, confidence),
        "families": {
            name: _family(job, summary.families[name], confidence) for name in job.families if name in summary.families
        },
        "map": {
            "scr_basis": job.axes.scr_basis,
            "scr_edges": job.axes.scr_edges,
            "x_over_r_edges": job.axes.x_over_r_edges,
            "families": {
                name: {
                    "judged": summary.families[name].judged_map,
                    "broken": summary.families[name].broken_map,
                    "worst_of": {
                        promise.figure: summary.families[name].promises[promise.name].worst_map
                        for promise in job.promises
                        if promise.name in summary.families[name].promises
                    },
                }
                for name in job.families
                if name in summary.families
            },
        },
        "quantile_error": QUANTILE_ERROR,
        "broken_cases": [
            {
                "case": case.number,
                "family": case.family,
                "promises": case.promises,
                "status": case.status,
                "figures": figures_document(case.figures),
            }
            for case in summary.broken
        ],
    }


def figures_document(figures: tuple[float, ...]) -> dict[str, float]:
    """The figures of a case by name."""
    return dict(zip(FIGURES, figures, strict=True))


def _family(job: VerificationJob, family: FamilyCount, confidence: float) -> dict[str, Any]:
    return {
        "drawn": family.drawn,
        "judged": family.judged,
        "left_out": dict(family.left_out),
        "lost": dict(family.lost),
        "beyond_hardware": {
            "above_pu": HARDWARE_PU,
            "survived": family.beyond,
            "largest_pu": HARDWARE_PU * family.beyond_worst[0].severity if family.beyond else None,
            "cases": [case.number for case in family.beyond_worst],
        },
        **_share(family.broken, family.judged, confidence),
        "promises": {
            promise.name: {
                "limit": promise.limit,
                **({} if promise.limit_Q is None else {"limit_Q": promise.limit_Q}),
                "most": promise.most,
                **({"noise": count.noise} if count.noise > 0.0 else {}),
                "unit": promise.unit,
                "figure": promise.figure,
                "survival": promise.survival,
                "at_least": False,
                "judged": family.judged,
                **_share(count.broken, family.judged, confidence),
                "worst": (worst := _worst(promise, count)),
                "quantiles": {key: quantile(count.bins, float(key) / 100.0, worst) for key in QUANTILES},
            }
            for promise in job.promises
            if (count := family.promises.get(promise.name)) is not None
        },
    }


def _worst(promise: Promise, count: PromiseCount) -> float:
    """The largest value of a promise's figure; NaN where nothing was judged."""
    if not count.worst:
        return math.nan
    first = count.worst[0]
    return math.inf if math.isinf(first.severity) else first.figures[tuple(FIGURES).index(promise.figure)]


def _share(broken: int, judged: int, confidence: float) -> dict[str, Any]:
    """How many, which share of the judged cases, and the bound on the share of all cases."""
    bound = upper_bound(broken, judged, confidence)
    return {
        "broken": broken,
        "share": broken / judged if judged else None,
        "bound": bound,
        "one_in": one_in(bound),
    }


Words = Callable[[float], str]


def distributions(study: Study, spec: ControllerSpec, bridge: str = "averaged") -> list[dict[str, str]]:
    """``quantity`` and ``words`` of everything that is drawn for a controller by the study's [verification], and how
    powers that ripple are judged; empty for a study that has none."""
    return [{"quantity": quantity, "words": words} for quantity, words in _lines(study, spec, bridge)]


def _lines(study: Study, spec: ControllerSpec, bridge: str) -> Iterator[tuple[str, str]]:
    asked = study.verification
    if asked is None:
        return
    box, c = asked.box, study.converter
    yield f"SCR, {box.scr_basis} basis", _uniform(box.scr, _number, logarithmic=True)
    yield "X/R", _uniform(box.x_over_r, _number, logarithmic=True)
    reduced = "; P and Q are reduced together where the grid or the converter cannot carry them"
    plant = study.plant
    if plant is not None:
        yield from _of_plant(study, len(plant.units), plant.least or len(plant.units))
    yield "P at rest", _uniform(box.P, _per_unit(c.S_rated)) + reduced
    yield "Q at rest", _uniform(box.Q, _per_unit(c.S_rated))
    yield "Source voltage", _uniform(box.V_g_rms, _per_unit(c.V_rated_rms))
    yield "Source frequency", _uniform(box.omega_g, lambda omega: f"{_number(omega / (2.0 * math.pi))} Hz")
    error_R, error_X, error_Z = box.errors
    if spec.kind == "scheduled" and spec.estimate == "truth":  # any other controller is told nothing
        if error_R == error_X:
            yield "Estimate of R_g and L_g", _known(error_R, error_Z)
        else:
            yield "Estimate of R_g", _known(error_R, error_Z)
            yield "Estimate of L_g", _known(error_X, error_Z)
        silent = _uniform(asked.silent_s, _seconds, logarithmic=True)
        yield "Silence of the estimator", f"after a change of the grid or its source {silent}"
    yield "Instant of the event", "within one cycle of the grid, uniform"
    learns = spec.kind == "scheduled" and samples_itself(spec.estimate)
    if bridge == "pwm":
        yield (
            "Bridge",
            f"switched; each case runs for {SWITCHED_WINDOW:g} settling times before its event, and is judged by the "
            "rest to which it comes",
        )
    over = "2 nominal cycles, because of the probe" if learns else "one nominal cycle"
    yield "Figures of a step", f"of the mean of its power over {over}"
    if study.background is not None:
        yield "Background", f"{study.background.level}, with a draw of its own in every case{_judged_in(study, bridge)}"
    if study.sensors is not None:
        yield "Sensors", f"{study.sensors.level}, with errors and noise of their own in every case"
    with_limit = study.with_limit_of(spec)
    rests = with_limit.limiter.rests and with_limit.converter.current_limit_pu is not None
    weights = asked.weights(rests)
    total = sum(weights.values())
    for name, weight in weights.items():
        if weight > 0.0:
            ranges = asked.ranges(name, rests)
            share = f"{100.0 * weight / total:.3g} % of the cases"
            yield family_words(name)[0], f"{share}: {_EVENTS[name](ranges) if name in _EVENTS else _step(name, ranges)}"


def _of_plant(study: Study, most: int, least: int) -> Iterator[tuple[str, str]]:
    """What is drawn of a plant besides what is drawn of one converter, which is the mean of all units."""
    asked = study.verification
    if asked is None:
        return
    yield "Units on line", f"{most}" if least == most else f"{least} to {most}, every number as often"
    apart = f"by up to {_number(asked.units_apart)} pu from the mean of all units, uniform"
    yield "P and Q of a unit", f"{apart}; less where its current limit leaves less"
    yield "Units that step", "all of them, or in half of the steps one alone"
    if asked.more_reactance[1] > 0.0:
        more = _uniform(asked.more_reactance, lambda value: f"{_number(value)} pu")
        yield "Reactance of a unit's transformer", f"that of the plant and {more} more"


def _judged_in(study: Study, bridge: str) -> str:
    """By which rest a case is judged whose powers ripple because of the source alone."""
    if study.background is None or not study.background.distorts or bridge == "pwm":
        return ""
    return "; a case is judged by the rest to which it comes"


def _step(name: str, ranges: dict[str, Range]) -> str:
    _, step = EVENT_KINDS.steps[name]
    words = _uniform(ranges["size"], lambda size: f"{size:.4g}{'' if step.unit == '1' else f' {step.unit}'}")
    return f"{step.label}, {words}" if step.new else f"{step.label} by {words}, up or down"


def _known(error: float, error_Z: float) -> str:
    known = error_text(error, error_Z)
    return "exact" if known == "exactly" else f"{known.removeprefix('to ')}, uniform"


def _uniform(ends: Range, words: Words, logarithmic: bool = False) -> str:
    low, high = (words(end) for end in ends)
    if low == high:
        return low
    # From zero on, there is no logarithm: the quantity itself is uniform.
    how = "uniform in the logarithm" if logarithmic and ends[0] > 0.0 else "uniform"
    return f"{low} to {high}, {how}"


def _number(value: float) -> str:
    return f"{value:.4g}"


def _per_unit(base: float) -> Words:
    return lambda value: f"{value / base:.4g} pu"


def _seconds(value: float) -> str:
    return f"{1e3 * value:.4g} ms" if value < 1.0 else f"{value:.4g} s"


def _degrees(value: float) -> str:
    return f"{math.degrees(value):.4g}°"


def _percent(value: float) -> str:
    return f"{100.0 * value:.4g} %"


def _hertz(value: float) -> str:
    return f"{value:.4g} Hz"


def _with_phase(ranges: dict[str, Range]) -> str:
    low, high = ranges["phase"]
    return "" if low == high == 0.0 else f", with a phase jump of {_uniform((low, high), _degrees)}, either way"


_EVENTS: dict[str, Callable[[dict[str, Range]], str]] = {
    "step": lambda r: f"P_ref or Q_ref by {_uniform(r['size'], _percent)} of the rated power, up or down",
    "grid": lambda r: f"to another grid that is drawn as the first one{_with_phase(r)}",
    "phase": lambda r: f"by {_uniform(r['jump'], _degrees)}, either way",
    "sag": lambda r: (
        f"the voltage loses {_uniform(r['depth'], _percent)}, for {_uniform(r['duration'], _seconds, logarithmic=True)}"
        f"{_with_phase(r)} and back at the end"
    ),
    "ramp": lambda r: (
        f"by {_uniform(r['size'], _hertz)} at {_uniform(r['rate'], _number, logarithmic=True)} Hz/s, up or down; back "
        f"after {_uniform(r['hold'], _seconds)}"
    ),
    "reference": lambda _: "P_ref to another power that is drawn as the first one",
    "loss": lambda _: "the breaker of one unit opens, at least one unit stays, and the others are judged",
}
