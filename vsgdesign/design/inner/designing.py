"""From a converter, its filter and a box of grids to inner gains, with what they keep and what would help."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from vsgdesign.design.inner.check import FullOrderCheck, check_full_order
from vsgdesign.design.inner.grids import GridBox, GridPoint, highest_resonance, sampling_ratio
from vsgdesign.design.inner.promises import targets
from vsgdesign.design.inner.score import PromiseReached, check_gains, limiting, score_of
from vsgdesign.design.inner.search import FINE, Effort, search
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.execution.threads import one_thread
from vsgdesign.parameters.converter import Converter, Filter
from vsgdesign.parameters.study import ClosedFormTarget

L_2_PU = 0.03
"""An L_2 for a filter that has none, over the base inductance."""
FEWER = Effort(heat=30, generations=70, joined=20, rounds=2)
"""An alternative's search: within 3 % of a full one's t for five of six converters, 9 % for the slowest sampler."""


@dataclass(frozen=True, kw_only=True)
class InnerDesign:
    """Designed inner loops: gains in SI, and what they keep on 13 × 13 grids of the box."""

    gains: InnerLoopGains
    omega_t: float
    """Corner of the transient impedance, rad/s."""
    box: GridBox
    settling_time: float
    """s, of the power loops that the decay is held against."""
    seed: int
    t: float
    """Worst score over promises and grids, 13 × 13; 1 and more: everything is kept on all of them."""
    search_t: float
    """The same on the grids of the search."""
    start_t: float
    """t of the closed form that the search began with (the better, where there are two)."""
    promises: tuple[PromiseReached, ...]
    stable_grids: int
    grids: int
    """Of 13 × 13, those on which every mode of the frozen model decays."""
    full_order: FullOrderCheck
    """With the power loops."""
    resonance_hz: float
    """Highest resonance of filter and grid in the box."""
    sampling_ratio: float
    """Sampling rate over it: t of 1 and more is usually met from 7.6 on."""
    searched: tuple[GridPoint, ...]
    """SCR and X/R of the search's grids."""
    evaluations: int
    """Gain sets that were looked at."""
    seconds: float = field(compare=False)
    """Wall time: the only field that differs between two equal calls, and no part of their equality."""

    @property
    def limiting(self) -> PromiseReached:
        """The promise that t is the score of."""
        return limiting(self.promises)

    @property
    def kept(self) -> bool:
        """Whether every promise is kept on every grid, and the full order is stable wherever it was analysed."""
        return self.t >= 1.0 and self.full_order.passed


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """What another converter or filter would buy, designed anew with a shorter search."""

    name: str
    """``sampling``, ``no_delay`` or ``L_2``."""
    change: str
    """In words, with the value."""
    converter: Converter
    filter: Filter
    t: float
    limiting: PromiseReached
    sampling_ratio: float

    @property
    def kept(self) -> bool:
        """Whether everything is kept with it."""
        return self.t >= 1.0


def design_inner_loops(
    converter: Converter,
    filter_: Filter,
    box: GridBox,
    *,
    settling_time: float = 1.0,
    seed: int = 0,
    progress: Progress | None = None,
    target: ClosedFormTarget | None = None,
    effort: Effort | None = None,
    starts: Sequence[tuple[InnerLoopGains, float]] = (),
) -> InnerDesign:
    """The inner gains with the largest worst score over the box (:eq:`inner-score`), checked with the power loops.

    ``settling_time`` (s): the power loops'. ``progress`` is called many times a second and may raise to stop.
    ``target``: power loops of the check; None: the angle-damped closed form for ``settling_time``. ``starts``: further
    gains (SI) with ω_t (rad/s) to begin from. Equal arguments give equal gains to the last bit, whatever the number of
    threads. A box on which no gains keep everything is no error: t is below 1 then, and ``limiting`` says what fails
    where. Raises StudyError for a settling time that is no positive number.
    """
    if not (math.isfinite(settling_time) and settling_time > 0.0):
        raise StudyError("inner loops", [Fault("settling_time", f"{settling_time} s", "must be a positive number")])
    begin = time.perf_counter()
    with one_thread():
        found = search(
            converter,
            filter_,
            box,
            settling_time=settling_time,
            seed=seed,
            effort=effort or Effort(),
            tell=progress or silent,
            more_starts=starts,
        )
        score = score_of(box, found.promises, targets(converter, settling_time), *FINE)
        full_order = check_full_order(
            converter, filter_, found.gains, found.omega_t, box, target=target, settling_time=settling_time
        )
    resonance = highest_resonance(converter, filter_, box) / (2.0 * math.pi)
    return InnerDesign(
        gains=found.gains,
        omega_t=found.omega_t,
        box=box,
        settling_time=settling_time,
        seed=seed,
        t=found.t,
        search_t=found.search_t,
        start_t=found.start_t,
        promises=score.promises,
        stable_grids=int(score.stable.sum()),
        grids=int(score.stable.size),
        full_order=full_order,
        resonance_hz=resonance,
        sampling_ratio=sampling_ratio(converter, filter_, box),
        searched=found.grids,
        evaluations=found.evaluations,
        seconds=time.perf_counter() - begin,
    )


def what_would_help(
    converter: Converter,
    filter_: Filter,
    box: GridBox,
    gains: InnerLoopGains,
    omega_t: float,
    *,
    settling_time: float = 1.0,
    seed: int = 0,
    progress: Progress | None = None,
    effort: Effort = FEWER,
) -> list[Alternative]:
    """What twice the sampling, no delay and a larger L_2 would buy: each designed anew, the best t first.

    The searches are shorter than a design's and begin, among others, with the present ``gains`` (SI) and ``omega_t``
    (rad/s). An alternative that is already there (no delay without delay) is left out. Raises StudyError with
    every fault of the gains.
    """
    check_gains(converter, gains, omega_t, settling_time)
    tell = progress or silent
    options = alternatives(converter, filter_)
    found = []
    for k, (name, change, c, f) in enumerate(options):

        def part(_what: str, share: float, k: int = k, change: str = change) -> None:
            tell(change, (k + share) / len(options))

        with one_thread():
            present = gains._replace(kappa=gains.kappa if c.delay_samples else 0.0)
            result = search(
                c,
                f,
                box,
                settling_time=settling_time,
                seed=seed,
                effort=effort,
                tell=part,
                more_starts=[(present, omega_t)],
            )
        score = score_of(box, result.promises, targets(c, settling_time), *FINE)
        ratio = sampling_ratio(c, f, box)
        found.append(
            Alternative(
                name=name,
                change=change,
                converter=c,
                filter=f,
                t=result.t,
                limiting=score.limiting,
                sampling_ratio=ratio,
            )
        )
    return sorted(found, key=lambda alternative: -alternative.t)


def alternatives(converter: Converter, filter_: Filter) -> list[tuple[str, str, Converter, Filter]]:
    """Name, words, converter and filter of everything that is worth asking."""
    options = []
    rate = 2.0 / converter.T_s
    if converter.samples_per_carrier == 1:
        twice = replace(converter, samples_per_carrier=2)
        options.append(("sampling", f"sampling twice a carrier period ({rate:.6g} Hz)", twice, filter_))
    else:
        twice = replace(converter, f_sw=2.0 * converter.f_sw)
        words = f"twice the carrier ({twice.f_sw:.6g} Hz, sampled at {rate:.6g} Hz)"
        options.append(("sampling", words, twice, filter_))
    if converter.delay_samples:
        options.append(("no_delay", "no computation delay", replace(converter, delay_samples=0), filter_))
    if filter_.L_2 > 0.0:
        larger = replace(filter_, L_2=2.0 * filter_.L_2)
        options.append(("L_2", f"twice the L_2 ({larger.L_2:.4g} H)", converter, larger))
    else:
        larger = replace(filter_, L_2=L_2_PU * converter.Z_base / converter.omega_n)
        options.append(("L_2", f"an L_2 of {L_2_PU:g} pu ({larger.L_2:.4g} H)", converter, larger))
    return options
