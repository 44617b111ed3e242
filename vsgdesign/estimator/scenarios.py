"""The scenarios of a data set: drawn from a recipe, and drawn again if the converter cannot run them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, LimitHitError, NoOperatingPointError
from vsgdesign.estimator.data_set import REASONS
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.linear.operating_point import solve_operating_point
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.operating_point.sampled import steady_state
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.study.parameters.grid import Grid, GridSource, Place
from vsgdesign.study.parameters.study import Study

ATTEMPTS = 100
"""Draws of a scenario before a recipe is given up as impossible."""

SURVEYED = 200
"""Scenarios that are drawn before the first one is run, so that a recipe that is mostly impossible costs a second."""

_AT_ONCE = 50
"""Scenarios of these that are drawn together."""

_ADVICE = {
    "no operating point": "Raise the low end of scr, or ask for less P_pu and Q_pu",
    "bridge voltage": "Raise the low end of scr, ask for less P_pu and Q_pu, or raise V_dc of the converter",
    "current": "Ask for less P_pu and Q_pu, or raise current_limit_pu of the converter",
    "voltage limits": "Raise the low end of scr, ask for less Q_pu, or widen V_min_pu and V_max_pu of the converter",
    "unstable": "Lower the high end of scr or x_over_r: with these inner loops and gains there are modes that grow "
    "(vsgdesign margins shows where)",
}

_WORDS = {
    "no operating point": ("has", "have", "no operating point"),
    "bridge voltage": ("needs", "need", "more voltage than the bridge makes"),
    "current": ("needs", "need", "more current than current_limit_pu"),
    "voltage limits": ("leaves", "leave", "V_min_pu to V_max_pu"),
    "unstable": ("is", "are", "unstable"),
}


_ONE = {
    "no operating point": "the grid cannot carry the power",
    "bridge voltage": "it needs more voltage than the bridge makes from V_dc",
    "current": "it needs more current than current_limit_pu",
    "voltage limits": "the voltage leaves V_min_pu to V_max_pu",
    "unstable": "the converter is unstable there",
}


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One run: its start, its change, and its gains."""

    index: int
    grids: tuple[Grid, Grid]
    gains: tuple[PowerLoopGains, PowerLoopGains]
    references: tuple[tuple[float, float], tuple[float, float]]
    """(P_ref, Q_ref) before and after the change."""
    source: GridSource
    phase: float
    noise: tuple[float, float]
    harmonics: dict[int, complex]
    """Background phasors by order (−5: negative sequence), relative to the fundamental."""
    seed: tuple[int, ...]
    redrawn: tuple[int, ...] = (0,) * len(REASONS)
    """Draws thrown away before this one, by reason."""


@dataclass(frozen=True)
class _Draw:
    """What a draw says, and why the converter cannot run it (empty: it can, or nobody has asked yet)."""

    numbers: dict[str, float]
    scenario: Scenario | None
    reason: str = ""


def draw_scenario(study: Study, recipe: WindowRecipe, seed: int, index: int) -> Scenario:
    """One scenario of a recipe: the first of its draws that the converter can run. It depends on the arguments alone.

    A draw is repeated if, before or after its change, the grid cannot carry the power, the bridge voltage or the
    current limit is exceeded at rest, the loops are unstable, or, with ``within_V_limits``, the voltage leaves the
    study's limits. Raises InfeasibleStudyError after ATTEMPTS draws.
    """
    return draw_scenarios((study,), recipe, seed, (index,))[0]


def draw_scenarios(studies: Sequence[Study], recipe: WindowRecipe, seed: int, indices: Sequence[int]) -> list[Scenario]:
    """The scenarios that :func:`draw_scenario` draws on one study, many at once in a fraction of the time."""
    (study,) = studies
    found = []
    for index, draws in zip(indices, _draws(study, recipe, seed, indices), strict=True):
        last = draws[-1].scenario
        if last is None:
            raise InfeasibleStudyError(_impossible(recipe, draws, f"scenario {index}"))
        found.append(last)
    return found


def why_not(study: Study, recipe: WindowRecipe, seed: int, index: int = 0) -> str:
    """The reason in words why the first draw of a scenario cannot be run; empty if it can be."""
    (draw,) = _judged(study, [_draw(study, recipe, index, (seed, index, 0), (0,) * len(REASONS))])
    return _ONE[draw.reason] if draw.reason else ""


def check_draws(study: Study, recipe: WindowRecipe, seed: int) -> None:
    """Draws the first scenarios without running them. Raises InfeasibleStudyError if most draws cannot be run."""
    draws: list[_Draw] = []
    index, count = 0, min(recipe.scenarios, SURVEYED)
    # As many draws as would be too many for all of the scenarios are enough to know.
    while index < count and len(draws) <= 2 * SURVEYED:
        for of_one in _draws(study, recipe, seed, range(index, min(index + _AT_ONCE, count))):
            if len(draws) <= 2 * SURVEYED:
                draws += of_one
                index += 1
    if sum(not one.reason for one in draws) < len(draws) / 2:
        raise InfeasibleStudyError(_impossible(recipe, draws, f"the first {index} scenarios"))


def _draws(study: Study, recipe: WindowRecipe, seed: int, indices: Sequence[int]) -> list[list[_Draw]]:
    """The draws of each scenario, of which all but the last are thrown away. In each round, those that still need one
    are drawn and judged together."""
    found: list[list[_Draw]] = [[] for _ in indices]
    open_ = list(range(len(found)))
    for attempt in range(ATTEMPTS):
        drawn = []
        for k in open_:
            counts = Counter(one.reason for one in found[k])
            thrown = tuple(counts[name] for name in REASONS)
            drawn.append(_draw(study, recipe, indices[k], (seed, indices[k], attempt), thrown))
        for k, judged in zip(open_, _judged(study, drawn), strict=True):
            found[k].append(judged)
        open_ = [k for k in open_ if found[k][-1].reason]
        if not open_:
            break
    return found


def _draw(study: Study, recipe: WindowRecipe, index: int, key: tuple[int, ...], redrawn: tuple[int, ...]) -> _Draw:
    """A draw, of which it is not known yet whether it has a steady state and is stable."""
    rng, c = np.random.default_rng(key), study.converter
    V_g_pu = recipe.V_g_pu.draw(rng, index)
    source = GridSource(V_g_pu * c.V_rated_rms, recipe.f_g_pu.draw(rng, index) * c.omega_n)

    scr, x_over_r = recipe.scr.draw(rng, index), recipe.x_over_r.draw(rng, index)
    first = Place(scr, x_over_r, recipe.scr_basis).grid(c)
    P_pu, Q_pu = (spread.draw(rng, index) for spread in (recipe.P_pu, recipe.Q_pu))
    steps = tuple(spread.draw(rng, index) for spread in (recipe.P_step_pu, recipe.Q_step_pu))
    second = _other_grid(study, recipe, rng, scr) if rng.random() < recipe.grid_step_share else first
    numbers = {"scr": scr, "x_over_r": x_over_r, "P_pu": P_pu, "Q_pu": Q_pu, "V_g_pu": V_g_pu}
    gains, refs = [], []
    for k, held in enumerate((first, second)):
        # Gains as a schedule would have them there, and references that put P and Q where they were drawn.
        P, Q = (value * c.S_rated + k * (step * c.S_rated) for value, step in zip((P_pu, Q_pu), steps, strict=True))
        try:
            gains.append(closed_form_schedule(study, study.target, P, Q).gains(held.R_g, held.L_g))
            point = solve_operating_point(
                P, Q, source.V_g_rms, *study.path_to_grid(held, source.omega_g), V_limits_rms=c.V_limits_rms
            )
        except NoOperatingPointError:
            return _Draw(numbers, None, "no operating point")
        if recipe.within_V_limits and not point.V_within_limits:
            return _Draw(numbers, None, "voltage limits")
        droop_P = gains[k].D_p * (c.omega_n - source.omega_g)
        refs.append((P - droop_P, Q - gains[k].D_q * (c.V_rated_rms - point.V_rms)))
    noise = (recipe.noise_v.draw(rng, index), recipe.noise_i.draw(rng, index))
    harmonics = {}
    for order, spread in ((-5, recipe.harmonic_5), (7, recipe.harmonic_7)):
        amplitude, angle = spread.draw(rng, index), rng.uniform(0.0, 2.0 * math.pi)
        if amplitude > 0.0:
            harmonics[order] = amplitude * complex(math.cos(angle), math.sin(angle))
    phase = recipe.phase.draw(rng, index)
    scenario = Scenario(
        index=index,
        grids=(first, second),
        gains=(gains[0], gains[1]),
        references=(refs[0], refs[1]),
        source=source,
        phase=phase,
        noise=noise,
        harmonics=harmonics,
        seed=key,
        redrawn=redrawn,
    )
    return _Draw(numbers, scenario)


def _judged(study: Study, draws: Sequence[_Draw]) -> list[_Draw]:
    """The draws; those without a steady state before or after their change, or unstable there, say so."""
    judged = [one.scenario for one in draws if one.scenario is not None]
    cells = [
        Cell(grid, gains, *refs, scenario.source)
        for scenario in judged
        for grid, gains, refs in zip(scenario.grids, scenario.gains, scenario.references, strict=True)
    ]
    model = linearise_full_order(study, cells)
    largest = np.full(len(cells), np.nan)
    if len(model.index):
        largest[model.index] = np.abs(np.linalg.eigvals(model.A)).max(axis=1)
    found, place = [], 0
    for one in draws:
        if one.scenario is None:
            found.append(one)
            continue
        both = range(place, place + len(one.scenario.grids))
        place = both.stop
        faulty = next((cells[k] for k in both if model.faults[k] is not None), None)
        reason = "" if faulty is None else _obstacle(study, faulty, one.scenario.source)
        if faulty is None and largest[list(both)].max() > 1.0 + 1e-9:
            reason = "unstable"
        found.append(_Draw(one.numbers, None, reason) if reason else one)
    return found


def _obstacle(study: Study, cell: Cell, source: GridSource) -> str:
    """Which of REASONS a cell without a steady state has."""
    try:
        steady_state(study, cell.grid, source, study.converter.references(cell.P_ref, cell.Q_ref), cell.gains)
    except LimitHitError as error:
        return error.limit
    except InfeasibleStudyError:
        pass
    return "no operating point"


def _other_grid(study: Study, recipe: WindowRecipe, rng: np.random.Generator, scr: float) -> Grid:
    for _ in range(ATTEMPTS):
        number = int(rng.integers(1 << 16))
        other, x_over_r = recipe.scr.draw(rng, number), recipe.x_over_r.draw(rng, number)
        if other != scr and max(other / scr, scr / other) <= recipe.grid_step_ratio:
            return Place(other, x_over_r, recipe.scr_basis).grid(study.converter)
    raise InfeasibleStudyError(
        f"recipe {recipe.name}: no second grid within a ratio of {recipe.grid_step_ratio:g} of SCR {scr:g}. "
        "Raise grid_step_ratio, set grid_step_share to 0, or give scr more values."
    )


def _impossible(recipe: WindowRecipe, draws: Sequence[_Draw], of: str) -> str:
    """What is wrong with a recipe of which most draws are thrown away, and which field to change."""
    thrown = Counter(one.reason for one in draws if one.reason)
    parts = ", ".join(f"{count} {_words(reason, count)}" for reason, count in thrown.most_common())
    share = f"{sum(thrown.values())} of {len(draws)} draws for {of}"
    advice = _ADVICE[thrown.most_common(1)[0][0]]
    return f"recipe {recipe.name}: {share} cannot be run on this converter ({parts}). {_deciding(draws)}{advice}."


def _deciding(draws: Sequence[_Draw]) -> str:
    """The field that tells draws that can be run from the others best; empty where there is none to compare."""
    bad = np.array([bool(one.reason) for one in draws])
    if bad.all() or not bad.any():
        held = ", ".join(f"{name} = {value:.3g}" for name, value in draws[-1].numbers.items())
        return f"The last has {held}. "
    best, text = 0.0, ""
    for name in draws[0].numbers:
        values = np.array([one.numbers[name] for one in draws])
        if np.ptp(values) == 0.0:
            continue
        scaled = np.log(values) if name in ("scr", "x_over_r") else values
        apart = abs(scaled[bad].mean() - scaled[~bad].mean()) / scaled.std()
        if apart > best:
            middle = float(np.median(values))
            low, high = (float(np.mean(bad[side])) for side in (values <= middle, values > middle))
            best = apart
            text = (
                f"{name} decides most: {100.0 * low:.0f} % of the draws up to {middle:.3g} cannot be run, "
                f"{100.0 * high:.0f} % of those above. "
            )
    return text


def describe_draws(draws: dict[str, object]) -> str:
    """One line on what was thrown away (:attr:`vsgdesign.estimator.data_set.DataSet.draws`); empty: nothing was."""
    thrown = draws["thrown_away"]
    if not isinstance(thrown, dict) or not thrown:
        return ""
    parts = ", ".join(f"{count} {_words(reason, count)}" for reason, count in thrown.items())
    return f"drawn again: {sum(thrown.values())} of {draws['draws']} draws, because {parts}"


def _words(reason: str, count: int) -> str:
    one, several, rest = _WORDS[reason]
    return f"{one if count == 1 else several} {rest}"
