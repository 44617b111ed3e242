"""Which power, capacitor and energy the dc side needs for what a study does.

As long as the bridge is not at the limit of its voltage, the dc link does not act on the circuit: the power that the
bridge takes is that of one run, whatever feeds it. Sizes are therefore found on the scalar equation of the link alone,
many candidates side by side, and then confirmed in full simulations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.flat import flat_block
from vsgdesign.codegen.llvm import Loop, LoopSpec, compiled_loop, empty_rows
from vsgdesign.codegen.records import numbers_of, zero_record
from vsgdesign.equations.dc_link import DcSettings, DcState, link_step
from vsgdesign.equations.dc_sources.converter import UNLIMITED_J
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.simulation.dc_parts import DcKind, dc_kind
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

LANES = 8
"""Candidates side by side."""

ROUNDS = 4
"""Each divides what is left of a range by LANES + 1, so that its logarithm is known to 1/6561."""

MORE_POWER = 1.1
"""Over the least power, where the capacitor is sized."""

TRADE_OFF = (1.0, 1.03, MORE_POWER, 1.25, 1.5, 2.0)
"""Powers over the least one for which the capacitor is sized."""

LESS = 0.95
"""What the confirming runs have of one of the three sizes."""

_MOST_STEPS, _HALVINGS, _NOTHING = 60, 3, 1e-6
"""Of the search in full simulations: steps of 5 % up to a size that survives, halvings of the last step, and the share
of the first value below which nothing is needed."""

_BLOCK = 16_384
"""Samples that are given to the loop at a time."""

_STIFF = 1e4
"""Energy of the capacitor of the run from which the power is taken, over that of the rating in a second."""

KEPT = 1.02
"""Over the voltage that the bridge needs at rest, what the link has to keep."""

SLACK = 2e-3
"""Share of V_dc by which a full simulation may fall below it: where the bridge is at its limit for some samples, its
power depends on the link a little."""

SAME_REST = 0.02
"""Share of the rating by which the power of the bridge in the last cycle may differ from that with an ideal link."""

_MOST_DOUBLED = 1000.0
"""Over the first capacitor."""

MOST_SAMPLES = 4_000_000
"""Of that run: its log has every one of them."""


@dataclass(frozen=True)
class Profile:
    """What the bridge asks of the link in each sample of a run, (n,)."""

    T_s: float
    p: Array
    """Mean power, W."""
    needs: Array
    """Voltage of the link that the commanded voltage needs, V."""
    at_rest: float
    """The largest one over the cycles before each event and at the end, V."""
    cycle: int
    """Samples of a cycle."""
    begin: float
    """Power at rest before the first sample, W."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """A dc side."""

    p_max: float
    """Largest power that the source gives, W."""
    p_charge_max: float
    """Largest power that it takes, W."""
    C: float
    """F."""
    energy: float = UNLIMITED_J
    """Usable energy, J."""
    charge: float = 0.5
    """Share of it at the start."""


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


@dataclass(frozen=True, kw_only=True)
class Sizing:
    """The answer."""

    controller: str
    least_power: float
    """Least power with the capacitor that was given, W."""
    size: Size
    """What survives all events: 10 % more than the least power, then the least capacitor, then the least energy."""
    C_given: float
    """The capacitor with which the least power was found, F."""
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
    """What the source has given up to each sample of the sized run, J, thinned (n, 2) with the time, s."""


def size_dc_side(
    study: Study,
    spec: ControllerSpec,
    ready: Ready,
    *,
    C: float | None = None,
    progress: Progress | None = None,
) -> Sizing:
    """Sizes the dc side of a controller for the events of its study: a source behind a dc–dc stage with the stage's
    parameters of the study's [dc], else with its defaults.

    ``C``: the capacitor with which the least power is found; None: that of [dc], or what stores 10 ms of the rating,
    doubled until it is enough.
    A link is large enough if it keeps 2 % more than the bridge needs at its rests, and stays within V_low and V_high.
    Raises InfeasibleStudyError where the run diverges with an ideal link, where V_dc itself is not enough at a rest, or
    where no power is enough.
    """
    tell = progress or silent
    link = _link_of(study, C)
    tell("simulate with an ideal dc side", 0.0)
    profile = profile_of(study, spec, ready, link)
    least_v = max(link.V_low, KEPT * profile.at_rest)
    if least_v >= study.converter.V_dc:
        raise InfeasibleStudyError(
            f"the link has to keep {least_v:.4g} V, 2 % more than the bridge needs at rest, and V_dc is "
            f"{study.converter.V_dc:.4g} V: no capacitor may be used. Raise V_dc."
        )
    link = replace(link, V_low=least_v)
    search = _Search(study, link, profile)
    full = _Full(study, spec, ready, link, profile)
    tell("size the source", 0.1)
    first = max(float(profile.p.max()), 1e-3 * study.converter.S_rated)
    back = max(-float(profile.p.min()), 1e-3 * study.converter.S_rated)
    big = Size(p_max=3.0 * first, p_charge_max=3.0 * back, C=link.C)
    while not search.survives([big])[0]:
        if C is not None or big.C > _MOST_DOUBLED * link.C:
            raise InfeasibleStudyError(
                f"no source behind this stage survives the events with {big.C * 1e6:.4g} µF: the capacitor alone has "
                "to give the power until the stage follows. Give a larger one, or a smaller tau in [dc.converter]."
            )
        big = replace(big, C=2.0 * big.C)
    given = big.C
    least = search.least(lambda x: replace(big, p_max=x), 1e-3 * first, big.p_max)
    least = full.least("p_max", replace(big, p_max=least)).p_max
    sized = replace(big, p_max=MORE_POWER * least)
    charging = search.least(lambda x: replace(sized, p_charge_max=x), 1e-6 * back, 3.0 * back)
    charging = full.least("p_charge_max", replace(sized, p_charge_max=charging)).p_charge_max
    sized = replace(sized, p_charge_max=MORE_POWER * charging)
    tell("size the capacitor", 0.4)
    trade_off = []
    for factor in TRADE_OFF:
        of_factor = replace(sized, p_max=factor * least, p_charge_max=factor * charging)
        found = search.least_capacitor(of_factor, 1e-4 * given, 100.0 * given)
        found = found if math.isinf(found) else full.least("C", replace(of_factor, C=found)).C
        trade_off.append((of_factor.p_max, found))
        sized = replace(sized, C=found) if factor == MORE_POWER else sized
    tell("size the energy", 0.8)
    energy, charge, energy_given = full.energy(sized)
    sized = full.least("energy", replace(sized, energy=energy, charge=charge))
    trials = [
        ("all three sizes", sized),
        ("5 % less than the least power, and the given capacitor", replace(sized, p_max=LESS * least, C=given)),
        ("5 % less capacitor", replace(sized, C=LESS * sized.C)),
        ("5 % less energy", replace(sized, energy=LESS * sized.energy)),
    ]
    confirmed = [full.trial(size, what) for what, size in trials]
    tell("size the energy", 1.0)
    return Sizing(
        controller=spec.name,
        least_power=least,
        size=sized,
        C_given=given,
        trade_off=tuple(trade_off),
        by_hand=by_hand(study, link, profile),
        largest_p=float(profile.p.max()),
        smallest_p=float(profile.p.min()),
        least_v=least_v,
        short=float(np.mean(profile.needs > study.converter.V_dc)),
        trials=tuple(confirmed),
        energy_given=energy_given,
    )


def _link_of(study: Study, C: float | None) -> DcLink:
    """A source behind a stage, with what the study says of one."""
    c, own = study.converter, study.dc
    given = own.values if own is not None and own.source == "converter" else {}
    C = C or (own.C if own is not None else 2.0 * 0.01 * c.S_rated / c.V_dc**2)
    bleed = None if own is None else own.R_bleed
    low, high = (0.7 * c.V_dc, 1.2 * c.V_dc) if own is None else (own.V_low, own.V_high)
    kept = tuple((name, value) for name, value in given.items() if name in ("tau", "ramp", "feed_forward"))
    return DcLink(source="converter", C=C, R_bleed=bleed, V_low=low, V_high=high, given=kept)


def link_with(study: Study, link: DcLink, size: Size) -> DcLink:
    """A link with the sizes of a candidate."""
    given = dict(link.given) | {
        "p_max": size.p_max, "p_charge_max": size.p_charge_max, "energy": size.energy, "charge": size.charge,
    }  # fmt: skip
    sized = replace(link, C=size.C)
    values = sized.kind.values(sized.ratings(study.converter), given)
    return replace(sized, given=tuple(values.items()))


def _every_sample(study: Study, link: DcLink) -> Study:
    T_s = study.converter.T_s
    return replace(study, dc=link, simulation=replace(study.simulation, log_interval=T_s, bridge="averaged"))


def profile_of(study: Study, spec: ControllerSpec, ready: Ready, link: DcLink) -> Profile:
    """What the bridge asks of a link that does not move. Raises InfeasibleStudyError where the run does not end."""
    c = study.converter
    samples = round(study.simulation.duration / c.T_s)
    if samples > MOST_SAMPLES:
        raise InfeasibleStudyError(
            f"the run has {samples} samples, and a dc side is sized for at most {MOST_SAMPLES}. Shorten duration."
        )
    stiff = Size(p_max=1e3 * c.S_rated, p_charge_max=1e3 * c.S_rated, C=2.0 * _STIFF * c.S_rated / c.V_dc**2)
    wide = replace(link_with(study, link, stiff), V_low=1e-3 * c.V_dc, V_high=1e3 * c.V_dc)
    own = _every_sample(study.with_limit_of(spec), wide)
    run = simulate(own, feed_of(own, spec, build_timeline(own), ready), finds=spec)
    if run.divergence is not None or run.dc_log is None:
        why = "" if run.divergence is None else run.divergence.reason
        raise InfeasibleStudyError(f"{spec.name} does not survive its events with an ideal dc side: {why}.")
    names = dc_columns(own)
    p, needs = (np.ascontiguousarray(run.dc_log[:, names.index(name)]) for name in ("p", "needs"))
    cycle = max(round(2.0 * math.pi / c.omega_n / c.T_s), 1)
    ends = {round(event.t_s / c.T_s) for event in run.study.events} | {len(needs)}
    late = [needs[max(end - cycle, 1) : end] for end in ends if cycle < end <= len(needs)]
    at_rest = max((float(one.max()) for one in late), default=float(needs[1:].max()))
    return Profile(c.T_s, p[1:], needs[1:], at_rest, cycle, float(p[0]))


class _Full:
    """Full simulations of candidates."""

    def __init__(self, study: Study, spec: ControllerSpec, ready: Ready, link: DcLink, profile: Profile) -> None:
        self._study, self._spec, self._ready, self._link, self._profile = study, spec, ready, link, profile

    def run(self, size: Size) -> tuple[Simulation, Study]:
        """A simulation, and its study. Raises InfeasibleStudyError where it cannot start."""
        slack = SLACK * self._study.converter.V_dc
        link = replace(link_with(self._study, self._link, size), V_low=self._link.V_low - slack)
        own = _every_sample(self._study.with_limit_of(self._spec), link)
        feed = feed_of(own, self._spec, build_timeline(own), self._ready)
        return simulate(own, feed, finds=self._spec), own

    def trial(self, size: Size, what: str = "") -> Trial:
        """Its verdict."""
        try:
            run, own = self.run(size)
        except InfeasibleStudyError as error:
            return Trial(what, survived=False, why=str(error), lowest_v=math.nan, highest_v=math.nan)
        v, p = (_column(run, own, name) for name in ("v", "p"))
        why, cycle = "" if run.divergence is None else run.divergence.reason, self._profile.cycle
        if not why:
            apart = abs(float(np.mean(p[-cycle:]) - np.mean(self._profile.p[-cycle:])))
            if apart > SAME_REST * self._study.converter.S_rated:
                why = f"at the end the power of the bridge is {apart:.4g} W beside that with an ideal link"
        return Trial(what, survived=not why, why=why, lowest_v=float(v.min()), highest_v=float(v.max()))

    def least(self, name: str, size: Size) -> Size:
        """The size with the least value of one of its fields near the one that it has: where the bridge is at its limit
        for some samples, its power depends on the link, and the equation of the link alone is not exact."""

        def with_value(value: float) -> Size:
            return replace(size, **{name: value})

        good, bad = getattr(size, name), 0.0
        for _ in range(_MOST_STEPS):
            if self.trial(with_value(good)).survived:
                break
            good, bad = good / LESS, good
        while bad == 0.0 and good > _NOTHING * getattr(size, name):
            lower = LESS * good
            if self.trial(with_value(lower)).survived:
                good = lower
            else:
                bad = lower
        for _ in range(_HALVINGS if bad else 0):
            middle = 0.5 * (good + bad)
            good, bad = (middle, bad) if self.trial(with_value(middle)).survived else (good, middle)
        return with_value(good)

    def energy(self, size: Size) -> tuple[float, float, Array]:
        """The energy that the source of a candidate gives and takes, J, the share of it that it needs at the start, and
        what it has given over time, thinned (n, 2): s and J."""
        run, own = self.run(size)
        given = _column(run, own, "given")
        most, least = max(float(given.max()), 0.0), min(float(given.min()), 0.0)
        energy, every = max(most - least, 1e-3), max(len(given) // 2000, 1)
        return energy, most / energy, np.column_stack([run.t_s, given])[::every]


def _column(run: Simulation, study: Study, name: str) -> Array:
    if run.dc_log is None:
        raise ValueError("the run has no dc link.")
    return run.dc_log[:, dc_columns(study).index(name)]


def by_hand(study: Study, link: DcLink, profile: Profile) -> dict[str, float]:
    """Sums for comparison: the largest change of the power within the lag of the stage, W, and the capacitor whose
    energy from V_dc down to V_low gives it for this time, F (:eq:`dc-capacitor-by-hand`)."""
    V, tau = study.converter.V_dc, link_with(study, link, Size(p_max=1.0, p_charge_max=1.0, C=link.C)).values["tau"]
    late = max(round(tau / profile.T_s), 1)
    steps = np.abs(profile.p[late:] - profile.p[:-late]) if len(profile.p) > late else np.zeros(1)
    step, room = float(steps.max()), V * V - link.V_low**2
    return {"largest_change_w": step, "C_f": math.inf if room <= 0.0 else 2.0 * step * tau / room}


class _Search:
    """Candidates on the equation of the link alone."""

    def __init__(self, study: Study, link: DcLink, profile: Profile) -> None:
        kind = dc_kind(link)
        if kind is None:
            raise ValueError("a link to size is not ideal.")
        self._study, self._link, self._profile, self._kind = study, link, profile, kind
        block = flat_block(link_step, fixed={"source": kind.law}, kinds=kind.records)
        self._state = [name for name in block.inputs if name.startswith("state.")]
        settings = tuple(name for name in block.inputs if name.startswith("dc."))
        fed = ("power.begin", "power.middle", "power.end", "power.mean", "needs")
        self._spec = LoopSpec(
            (block,),
            tuple((name, name.replace("state.", "dc_state.", 1)) for name in self._state),
            settings,
            fed=fed,
            lanes=LANES,
        )
        self._loop: Loop = compiled_loop(self._spec)

    def survives(self, sizes: list[Size]) -> list[bool]:
        """Whether each candidate keeps the link within its limits."""
        low, high = self._link.V_low, self._link.V_high
        return [one is not None and one.lowest >= low and one.highest <= high for one in self.moved(sizes)]

    def least(self, size: Callable[[float], Size], low: float, high: float) -> float:
        """The least value between two with which a candidate survives; it does with ``high``."""
        for _ in range(ROUNDS):
            tried = np.geomspace(low, high, LANES + 2)[1:-1].tolist()
            good = self.survives([size(value) for value in tried])
            last = max((k for k, one in enumerate(good) if not one), default=-1)
            low = low if last < 0 else tried[last]
            high = high if last == LANES - 1 else tried[last + 1]
        return high

    def least_capacitor(self, size: Size, low: float, high: float) -> float:
        """The least capacitor with a source; inf where none up to ``high`` is large enough."""
        if not self.survives([replace(size, C=high)])[0]:
            return math.inf
        return self.least(lambda C: replace(size, C=C), low, high)

    def moved(self, sizes: list[Size]) -> list[DcState | None]:
        """The link of each candidate at the end; None where its source cannot give the power of the start."""
        study, profile = self._study, self._profile
        found: list[DcState | None] = []
        for some in (sizes[k : k + LANES] for k in range(0, len(sizes), LANES)):
            starts, rows = [], empty_rows(self._spec, 1)
            for lane in range(LANES):
                one = link_with(study, self._link, some[min(lane, len(some) - 1)])
                settings = one.settings(study.converter, study.filter)
                try:
                    state: DcState | None = one.at_rest(profile.begin, study.converter, study.filter)
                except InfeasibleStudyError:
                    state = None
                starts.append(state)
                begin = _one_that_stands(settings, self._kind) if state is None else state
                rows[0, :, lane] = [*numbers_of(begin), *numbers_of(settings)]
            self._run(rows)
            for lane, start in enumerate(starts[: len(some)]):
                numbers = dict(zip(self._state, rows[0, : len(self._state), lane].tolist(), strict=True))
                own = {name: numbers[f"state.{name}"] for name in DcState._fields if name != "memory"}
                found.append(None if start is None else start._replace(**own))
        return found

    def _run(self, rows: Array) -> None:
        p, needs = self._profile.p, self._profile.needs
        for begin in range(0, len(p), _BLOCK):
            end = min(begin + _BLOCK, len(p))
            columns = np.stack([p[begin:end]] * 4 + [needs[begin:end]], axis=1)
            fed = np.repeat(columns[None, :, :, None], LANES, axis=3)
            self._loop(begin, end, rows, np.zeros(0), fed=fed)


def _one_that_stands(settings: DcSettings, kind: DcKind) -> DcState:
    """A state in place of one that there is not."""
    V: Any = settings.V_dc
    memory = zero_record(kind.memory)
    return DcState(
        v=V, p=0.0, needs=0.0, spare=V, lowest=V, highest=V, least=0.0, most=0.0, given=0.0, taken=0.0, memory=memory
    )
