"""Which power, capacitor and energy the dc side needs for what a study does.

As long as the bridge is not at the limit of its voltage, the dc link does not act on the circuit: the power that the
bridge takes is that of one run, whatever feeds it. Sizes are therefore found on the scalar equation of the link alone,
many candidates side by side, and then confirmed in full simulations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.dc_profiles import LinkSearch, Size, SizedRun, every_sample, link_with, profile_of
from vsgdesign.equations.dc_sources import BATTERY, CONVERTER
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.reader import format_quantity
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

MORE_POWER = 1.1
"""Over the least power, where the capacitor is sized."""

TRADE_OFF = (1.0, 1.03, MORE_POWER, 1.25, 1.5, 2.0)
"""Powers over the least one for which the capacitor is sized."""

LESS = 0.95
"""What the confirming runs have of one of the three sizes."""

_MOST_STEPS, _FINE, _NOTHING = 60, 1.0 - 0.05 / 8.0, 1e-6
"""Of the search in full simulations: steps of 5 % up to a size that survives, how near to it a lost one has to be,
and the share of the first value below which nothing is needed."""

KEPT = 1.02
"""Over the voltage that the bridge needs at rest, what the link has to keep."""

SLACK = 2e-3
"""Share of V_dc by which a full simulation may fall below it: where the bridge is at its limit for some samples, its
power depends on the link a little."""

SAME_REST = 0.02
"""Share of the rating by which the power of the bridge in the last cycle may differ from that with an ideal link."""

TIGHT = 3
"""So many runs of a suite, those that the equation of the link says are nearest to their limits, decide in full
simulations. The sizes are then confirmed with all of them."""

DROP = 0.05
"""Of a battery whose resistance is not given, at the rating: share of V_dc."""

KINDS = (CONVERTER.name, BATTERY.name)
"""Sources that are sized."""

POWER, CAPACITOR, ENERGY = KEEPS = ("power", "capacitor", "energy")
"""What may be kept."""

_MOST_DOUBLED = 1000.0
"""Over the first capacitor."""

_MOST_GIVEN = 100.0
"""The largest capacitor that is looked at, over the given one."""


@dataclass(frozen=True)
class Trial:
    """A full simulation with a dc side."""

    what: str
    survived: bool
    why: str
    """Empty where it survived."""
    lowest_v: float
    highest_v: float
    """Of the link, V."""


class Asked(NamedTuple):
    """What is sized, and what is not."""

    source: str = CONVERTER.name
    """One of KINDS."""
    C: float | None = None
    """The capacitor with which the least power is found, F; None: that of [dc], or what stores 10 ms of the rating,
    doubled until it is enough."""
    keep: Mapping[str, float] = MappingProxyType({})
    """Sizes that are given, by KEEPS: W, F and J."""


@dataclass(frozen=True, kw_only=True)
class Sizing:
    """The answer."""

    controller: str
    source: str
    least_power: float
    """Least power with the capacitor that was given, W; that which is kept."""
    size: Size
    """What survives all events: 10 % more than the least power, then the least capacitor, then the least energy."""
    C_given: float
    """The capacitor with which the least power was found, F."""
    kept: tuple[str, ...]
    """Which of the sizes were given."""
    trade_off: tuple[tuple[float, float], ...]
    """Pairs of p_max (W) and the least capacitor with it (F; inf where none is large enough)."""
    by_hand: dict[str, float]
    """Sums for comparison: :func:`by_hand`."""
    largest_p: float
    smallest_p: float
    """Mean powers of the bridge in a sample, W."""
    least_v: float
    """Voltage that the link keeps, V."""
    short: float
    """Share of the samples in which the bridge is at its limit with an ideal link."""
    trials: tuple[Trial, ...]
    """The full simulations: with the sizes, and with 5 % less of each."""
    energy_given: Array
    """What the source has given up to each sample of the sized run, J, thinned (n, 2) with the time, s: of the run that
    needs most energy."""
    runs: tuple[str, ...]
    """The tests for which it is sized; empty: the study's own events."""
    left_out: tuple[tuple[str, str], ...]
    """Tests that are not survived with an ideal link, or whose rest needs more than V_dc, and why."""


def size_dc_side(
    study: Study,
    spec: ControllerSpec,
    ready: Ready,
    asked: Asked,
    tests: Sequence[tuple[str, Study]] = (),
    *,
    progress: Progress | None = None,
) -> Sizing:
    """Sizes the dc side of a controller for the events of its study, or for tests: a source of a kind with what the
    study's [dc] says of it, else with its defaults.

    ``tests``: a name and a study each (:func:`vsgdesign.campaigns.compliance.case.case_of`). One that is not survived
    with an ideal link, or at whose rest V_dc is not enough, is left out. A link is large enough if it keeps 2 % more
    than the bridge needs at its rests, and stays within V_low and V_high.
    Raises InfeasibleStudyError where nothing is left, or where no power is enough.
    """
    tell, keep, c = progress or silent, asked.keep, study.converter
    link = _link_of(study, asked)
    runs, left_out = _runs_of(study, spec, ready, link, tests, tell)
    least_v = max(link.V_low, KEPT * max(run.profile.at_rest for run in runs))
    link = replace(link, V_low=least_v)
    search, full = LinkSearch(study, link, runs), _Full(study, ready, link, runs)
    tell("size the source", 0.2)
    first = max(*(float(run.profile.p.max()) for run in runs), 1e-3 * c.S_rated)
    back = max(*(-float(run.profile.p.min()) for run in runs), 1e-3 * c.S_rated)
    charged = dict(link.given).get("charge", 0.5)
    big = Size(p_max=3.0 * first, p_charge_max=3.0 * back, C=link.C, charge=charged)
    big = _large_enough(search, asked, link, big)
    given, least = big.C, big.p_max
    if POWER not in keep:
        least = search.least(lambda x: replace(big, p_max=x), 1e-3 * first, big.p_max)
        least = full.least("p_max", replace(big, p_max=least), search).p_max
    more = 1.0 if POWER in keep else MORE_POWER
    sized = replace(big, p_max=more * least)
    charging = search.least(lambda x: replace(sized, p_charge_max=x), 1e-6 * back, 3.0 * back)
    charging = full.least("p_charge_max", replace(sized, p_charge_max=charging), search).p_charge_max
    sized = replace(sized, p_charge_max=MORE_POWER * charging)
    tell("size the capacitor", 0.4)
    trade_off = []
    for factor in (more,) if POWER in keep else TRADE_OFF:
        of_factor = replace(sized, p_max=factor * least, p_charge_max=max(factor, MORE_POWER) * charging)
        found = search.least_capacitor(of_factor, 1e-4 * given, _MOST_GIVEN * given)
        if math.isinf(found) and factor == more and CAPACITOR not in keep:
            raise InfeasibleStudyError(
                f"no capacitor up to {format_quantity(_MOST_GIVEN * given, 'F')} follows the power of the events with "
                f"{format_quantity(of_factor.p_max, 'W')}. Keep more power: --keep power=VALUE."
            )
        found = found if math.isinf(found) else full.least("C", replace(of_factor, C=found), search).C
        trade_off.append((of_factor.p_max, found))
        sized = replace(sized, C=found) if factor == more and CAPACITOR not in keep else sized
    tell("size the energy", 0.8)
    energy, charge, energy_given = full.energy(sized)
    if ENERGY not in keep:
        sized = full.least("energy", replace(sized, energy=energy, charge=charge), search)
    less = {
        POWER: ("5 % less than the least power, and the given capacitor", replace(sized, p_max=LESS * least, C=given)),
        CAPACITOR: ("5 % less capacitor", replace(sized, C=LESS * sized.C)),
        ENERGY: ("5 % less energy", replace(sized, energy=LESS * sized.energy)),
    }
    trials = [full.trial(sized, "all three sizes", every=True)]
    trials += [full.trial(size, what, every=True) for name, (what, size) in less.items() if name not in keep]
    tell("size the energy", 1.0)
    return Sizing(
        controller=spec.name,
        source=asked.source,
        least_power=least,
        size=sized,
        C_given=given,
        kept=tuple(name for name in KEEPS if name in keep),
        trade_off=tuple(trade_off),
        by_hand=by_hand(study, link, runs),
        largest_p=max(float(run.profile.p.max()) for run in runs),
        smallest_p=min(float(run.profile.p.min()) for run in runs),
        least_v=least_v,
        short=float(np.mean(np.concatenate([run.profile.needs for run in runs]) > c.V_dc)),
        trials=tuple(trials),
        energy_given=energy_given,
        runs=tuple(run.name for run in runs if run.name),
        left_out=left_out,
    )


def _runs_of(
    study: Study, spec: ControllerSpec, ready: Ready, link: DcLink, tests: Sequence[tuple[str, Study]], tell: Progress
) -> tuple[list[SizedRun], tuple[tuple[str, str], ...]]:
    """The runs for which a link can be sized, and the tests that are left out. Raises InfeasibleStudyError where no run
    is left."""
    found, left_out = [], []
    listed = tests or (("", study),)
    for k, (name, one) in enumerate(listed):
        tell("simulate with an ideal dc side", 0.2 * k / len(listed))
        own = one.controllers[0] if tests else spec
        try:
            profile = profile_of(one, own, ready, link)
            _check_kept(max(link.V_low, KEPT * profile.at_rest), study.converter.V_dc)
            found.append(SizedRun(name, one, own, profile))
        except InfeasibleStudyError as error:
            if not tests:
                raise
            left_out.append((name, str(error)))
    if not found:
        raise InfeasibleStudyError(f"the dc side cannot be sized for any test: {left_out[0][0]}: {left_out[0][1]}")
    return found, tuple(left_out)


def _check_kept(kept: float, V_dc: float) -> None:
    """Raises InfeasibleStudyError where a link at V_dc has no room above the voltage that it has to keep."""
    if kept >= V_dc:
        raise InfeasibleStudyError(
            f"the link has to keep {kept:.4g} V, 2 % more than the bridge needs at rest, and V_dc is {V_dc:.4g} V: no "
            "capacitor may be used. Raise V_dc."
        )


def _large_enough(search: LinkSearch, asked: Asked, link: DcLink, first: Size) -> Size:
    """Sizes with which all runs are survived, and those that are kept."""
    keep = asked.keep
    big = replace(first, C=keep.get(CAPACITOR, first.C), p_max=keep.get(POWER, first.p_max))
    big = replace(big, energy=keep.get(ENERGY, big.energy))
    while not search.survives([big])[0]:
        if POWER in keep or ENERGY in keep or asked.C or CAPACITOR in keep or big.C > _MOST_DOUBLED * link.C:
            kept = f" and the {' and '.join(keep)} that {'is' if len(keep) == 1 else 'are'} kept" if keep else ""
            more = "more of what is kept, " if keep else ""
            raise InfeasibleStudyError(
                f"no {asked.source} follows the power of the events with {format_quantity(big.C, 'F')}{kept}. Give "
                f"{more}a larger capacitor, or a smaller tau of a converter or R_i of a battery in [dc]."
            )
        big = replace(big, C=2.0 * big.C)
    return big


def _link_of(study: Study, asked: Asked) -> DcLink:
    """A source of the kind that is asked for, with what the study says of one."""
    c, own = study.converter, study.dc
    given = own.values if own is not None and own.source == asked.source else {}
    C = asked.C or (own.C if own is not None else 2.0 * 0.01 * c.S_rated / c.V_dc**2)
    bleed = None if own is None else own.R_bleed
    low, high = (0.7 * c.V_dc, 1.2 * c.V_dc) if own is None else (own.V_low, own.V_high)
    names = ("tau", "ramp", "feed_forward", "charge", "open_circuit", "R_i")
    kept = {name: value for name, value in given.items() if name in names}
    if asked.source == BATTERY.name:
        kept = {"R_i": DROP * c.V_dc**2 / c.S_rated} | kept
    return DcLink(source=asked.source, C=C, R_bleed=bleed, V_low=low, V_high=high, given=tuple(kept.items()))


class _Full:
    """Full simulations of candidates."""

    def __init__(self, study: Study, ready: Ready, link: DcLink, runs: Sequence[SizedRun]) -> None:
        self._study, self._ready, self._link, self._runs = study, ready, link, list(runs)
        self._watched = self._runs

    def run(self, size: Size, of: SizedRun) -> tuple[Simulation, Study]:
        """A simulation, and its study. Raises InfeasibleStudyError where it cannot start."""
        slack = SLACK * self._study.converter.V_dc
        link = replace(link_with(self._study, self._link, size), V_low=self._link.V_low - slack)
        own = every_sample(of.study.with_limit_of(of.spec), link)
        feed = feed_of(own, of.spec, build_timeline(own), self._ready)
        return simulate(own, feed, finds=of.spec), own

    def trial(self, size: Size, what: str = "", *, every: bool = False) -> Trial:
        """The verdict on a candidate: of the runs that decide, or of every one. It ends with the first that is lost."""
        lowest, highest = math.inf, -math.inf
        for of in self._runs if every else self._watched:
            one = self._verdict(size, of)
            lowest, highest = min(lowest, one.lowest_v), max(highest, one.highest_v)
            if not one.survived:
                why = f"{of.name}: {one.why}" if of.name else one.why
                return Trial(what, survived=False, why=why, lowest_v=one.lowest_v, highest_v=one.highest_v)
        return Trial(what, survived=True, why="", lowest_v=lowest, highest_v=highest)

    def _verdict(self, size: Size, of: SizedRun) -> Trial:
        try:
            run, own = self.run(size, of)
        except InfeasibleStudyError as error:
            return Trial("", survived=False, why=str(error), lowest_v=math.nan, highest_v=math.nan)
        v, p = (_column(run, own, name) for name in ("v", "p"))
        why, cycle = "" if run.divergence is None else run.divergence.reason, of.profile.cycle
        if not why:
            apart = abs(float(np.mean(p[-cycle:]) - np.mean(of.profile.p[-cycle:])))
            if apart > SAME_REST * self._study.converter.S_rated:
                why = f"at the end the power of the bridge is {apart:.4g} W beside that with an ideal link"
        return Trial("", survived=not why, why=why, lowest_v=float(v.min()), highest_v=float(v.max()))

    def least(self, name: str, size: Size, search: LinkSearch) -> Size:
        """The size with the least value of one of its fields near the one that it has: where the bridge is at its limit
        for some samples, its power depends on the link, and the equation of the link alone is not exact. The runs
        decide to which that equation leaves least with 5 % less, those first that are lost then."""

        def with_value(value: float) -> Size:
            return replace(size, **{name: value})

        good, bad = getattr(size, name), 0.0
        self._runs = search.tightest(with_value(LESS * good))
        self._watched = self._runs[:TIGHT]
        for _ in range(_MOST_STEPS):
            if self.trial(with_value(good)).survived:
                break
            good, bad = good / LESS, good
        least, step = _NOTHING * getattr(size, name), LESS  # each step down is as large as all before it
        while bad == 0.0 and good > least:
            lower = max(step * good, least)
            if self.trial(with_value(lower)).survived:
                good, step = lower, step * step
            else:
                bad = lower
        while 0.0 < bad < _FINE * good:
            middle = 0.5 * (good + bad)
            good, bad = (middle, bad) if self.trial(with_value(middle)).survived else (good, middle)
        return with_value(good)

    def energy(self, size: Size) -> tuple[float, float, Array]:
        """The energy that the source of a candidate gives and takes, J, the share of it that it needs at the start, and
        what it has given over time in the run that needs most, thinned (n, 2): s and J."""
        most, least, largest, shown = 0.0, 0.0, -1.0, np.zeros((0, 2))
        for of in self._runs:
            run, own = self.run(size, of)
            given = _column(run, own, "given")
            most, least = max(most, float(given.max())), min(least, float(given.min()))
            if np.ptp(given) > largest:
                largest, every = float(np.ptp(given)), max(len(given) // 2000, 1)
                shown = np.column_stack([run.t_s, given])[::every]
        energy = max(most - least, 1e-3)
        return energy, most / energy, shown


def _column(run: Simulation, study: Study, name: str) -> Array:
    if run.dc_log is None:
        raise ValueError("the run has no dc link.")
    return run.dc_log[:, dc_columns(study).index(name)]


def by_hand(study: Study, link: DcLink, runs: Sequence[SizedRun]) -> dict[str, float]:
    """Sums for comparison: the largest change of the power within the lag of the stage, W, and the capacitor whose
    energy from V_dc down to V_low gives it for this time, F (:eq:`dc-capacitor-by-hand`). A battery has no lag: it is
    the time in which its resistance charges the capacitor."""
    V = study.converter.V_dc
    values = link_with(study, link, Size(p_max=1.0, p_charge_max=1.0, C=link.C)).values
    tau = values["tau"] if "tau" in values else values["R_i"] * link.C
    step, room = max(run.profile.largest_change(tau) for run in runs), V * V - link.V_low**2
    return {"largest_change_w": step, "C_f": math.inf if room <= 0.0 else 2.0 * step * tau / room}
