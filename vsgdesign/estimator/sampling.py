"""How a recipe's windows are sampled on a given converter: whole control periods, whole cycles of the grid."""

from __future__ import annotations

import math
from dataclasses import replace

from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.identification.sampling import EXACT, LEAST_PER_CYCLE, MOST_CYCLES, NEAR, choose_window
from vsgdesign.parameters.converter import Converter


def with_sampling(recipe: WindowRecipe, converter: Converter) -> WindowRecipe:
    """The recipe with ``sample_interval``, ``samples`` and ``cycles`` filled in for a converter.

    A sample interval is a whole number of control periods T_s. What the recipe leaves open is chosen by
    :func:`vsgdesign.identification.sampling.choose_window`. What the recipe gives is kept. Raises StudyError where
    it does not fit the converter.
    """
    rate = converter.f_sw * converter.samples_per_carrier
    per_cycle = rate * 2.0 * math.pi / converter.omega_n
    if per_cycle < LEAST_PER_CYCLE:
        raise StudyError(f"recipe {recipe.name}", [_too_slow(converter, per_cycle)])
    steps = _given_steps(recipe, converter, rate)
    plan = choose_window(rate, per_cycle, steps=steps, samples=recipe.samples, cycles=recipe.cycles)
    if plan is None:
        raise StudyError(f"recipe {recipe.name}", [_too_long(recipe, converter)])
    interval = plan.steps / rate
    if recipe.cycles and plan.missed >= NEAR:
        fault = _contradiction(recipe, plan.samples, interval, plan.cycles, plan.missed)
        raise StudyError(f"recipe {recipe.name}", [fault])
    return replace(recipe, sample_interval=interval, samples=plan.samples, cycles=plan.cycles)


def _given_steps(recipe: WindowRecipe, converter: Converter, rate: float) -> int:
    """Control periods of the sample interval that the recipe gives; 0: it gives none."""
    if not recipe.sample_interval:
        return 0
    steps = recipe.sample_interval * rate
    if round(steps) >= 1 and abs(steps - round(steps)) <= 1e-6 * steps:
        return round(steps)
    near = sorted({max(math.floor(steps), 1), math.ceil(steps)})
    fault = Fault(
        "sample_interval",
        f"{recipe.sample_interval * 1e6:g} µs",
        f"no whole number of the converter's control periods of {converter.T_s * 1e6:.6g} µs",
        "Leave it out, or give " + " or ".join(f"{k / rate * 1e6:.9g} µs" for k in near) + ".",
    )
    raise StudyError(f"recipe {recipe.name}", [fault])


def _contradiction(recipe: WindowRecipe, samples: int, interval: float, cycles: int, missed: float) -> Fault:
    length = f"{samples} samples every {interval * 1e6:.6g} µs"
    given = "samples and sample_interval" if recipe.samples and recipe.sample_interval else "sample_interval"
    return Fault(
        "cycles",
        str(cycles),
        f"{length} miss {cycles} nominal cycles by {missed:.3g} of one",
        f"Leave cycles out, or {given}.",
    )


def _too_long(recipe: WindowRecipe, converter: Converter) -> Fault:
    cycles = recipe.cycles or MOST_CYCLES
    longest = 2.0 * math.pi * cycles / converter.omega_n / 4.0
    return Fault(
        "sample_interval",
        f"{recipe.sample_interval:g} s",
        f"leaves fewer than 4 samples in {cycles} nominal cycles",
        f"Give at most {longest:.3g} s, or leave it out.",
    )


def _too_slow(converter: Converter, per_cycle: float) -> Fault:
    return Fault(
        "converter.f_sw",
        f"{converter.f_sw:g} Hz",
        f"{per_cycle:.3g} control periods in a cycle of the grid are too few for a window (least: {LEAST_PER_CYCLE})",
        "Raise f_sw or samples_per_carrier.",
    )


def missed_cycles(recipe: WindowRecipe, converter: Converter) -> float:
    """By how much a sampled window is longer than its ``cycles``, in nominal cycles; 0 exactly where it is whole."""
    missed = recipe.update_period * converter.omega_n / (2.0 * math.pi) - recipe.cycles
    return 0.0 if abs(missed) < EXACT else missed


def turn_per_window(recipe: WindowRecipe, converter: Converter) -> float:
    """Angle (rad) by which a grid of nominal frequency turns from the begin of one window to that of the next.

    Zero exactly where a window is whole cycles. Synchronised windows are turned back by it, window by window, so that
    the grid's vector begins each of them at the same angle.
    """
    return 2.0 * math.pi * missed_cycles(recipe, converter)


def describe_sampling(recipe: WindowRecipe, converter: Converter) -> str:
    """What a sampled recipe's windows are, in words."""
    missed, f_n = missed_cycles(recipe, converter), converter.omega_n / (2.0 * math.pi)
    count = "1 cycle" if recipe.cycles == 1 else f"{recipe.cycles} cycles"
    text = (
        f"{recipe.samples} samples every {recipe.sample_interval * 1e6:.6g} µs, {recipe.update_period * 1e3:.6g} ms: "
        f"{count} of {f_n:g} Hz"
    )
    return text if missed == 0.0 else f"{text} {'less' if missed < 0.0 else 'and'} {abs(missed):.2g} of one"


def sampling_document(recipe: WindowRecipe, converter: Converter) -> dict[str, float | int | str]:
    """The same in JSON's types."""
    return {
        "samples": recipe.samples,
        "sample_interval_s": recipe.sample_interval,
        "period_s": recipe.update_period,
        "cycles": recipe.cycles,
        "missed_cycles": missed_cycles(recipe, converter),
        "text": describe_sampling(recipe, converter),
    }
