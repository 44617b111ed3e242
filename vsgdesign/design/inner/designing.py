"""From a converter, its filter and a box of grids to inner gains, with what they keep and what would help."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vsgdesign.design.inner.grids import (
    CHECKED,
    POWERS_PU,
    GridBox,
    GridPoint,
    angle_damped_target,
    closed_form_cells,
    highest_resonance,
    lattice,
    sampling_ratio,
    study_of,
)
from vsgdesign.design.inner.passivity import check_apart, searched_apart
from vsgdesign.design.inner.promises import (
    PromiseReached,
    check_gains,
    limiting,
    score_of,
    targets,
)
from vsgdesign.design.inner.search import FINE, Effort, search
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.executors import Progress, one_thread, silent
from vsgdesign.linear.operating_point.full_order import linearise_full_order
from vsgdesign.metrics.met import score_met
from vsgdesign.metrics.modes import least_damping, to_continuous
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.study import ClosedFormTarget


@dataclass(frozen=True, kw_only=True)
class FullOrderCheck:
    """The full-order model with the power loops closed, over grids × powers.

    A cell without a steady state (the grid cannot carry the power, or a limit is in the way) is not analysed: no inner
    gains help it.
    """

    cells: int
    analysed: int
    stable: int
    grids: int
    stable_grids: int
    """Grids with a cell that was analysed, and those of them whose every analysed cell is stable."""
    damping: float
    """Least damping ratio of all modes of all analysed cells."""
    scr: float
    x_over_r: float
    P: float
    """W; where that is."""

    @property
    def passed(self) -> bool:
        """Whether something was analysed and all of it is stable."""
        return 0 < self.analysed == self.stable


def check_full_order(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    target: ClosedFormTarget | None = None,
    settling_time: float = 1.0,
    grids: Sequence[GridPoint] | None = None,
    powers_pu: Sequence[float] = POWERS_PU,
) -> FullOrderCheck:
    """Modes of the sampled full-order model (:eq:`sampled-map`) with closed-form power loops that know the grid.

    ``target`` None: the angle-damped closed form for ``settling_time`` s. ``grids`` None: a lattice over the box.
    """
    target = target or angle_damped_target(settling_time, converter.omega_n)
    study = study_of(converter, filter_, gains, omega_t, box, target=target)
    points = lattice(box, *CHECKED) if grids is None else tuple(grids)
    requested, where = closed_form_cells(study, target, points, box.basis, powers_pu)
    model = linearise_full_order(study, requested)
    at = [where[k] for k in model.index]
    s = to_continuous(np.linalg.eigvals(model.A) if len(at) else np.ones((0, 1)), model.T_s)
    stable, damping = s.real.max(axis=1) < 0.0, least_damping(s)
    seen = {place[:2] for place in at}
    lost = {place[:2] for place, good in zip(at, stable, strict=True) if not good}
    worst = int(np.argmin(damping)) if len(at) else -1
    scr, x_over_r, P = at[worst] if at else (float("nan"),) * 3
    return FullOrderCheck(
        cells=len(points) * len(powers_pu),
        analysed=len(at),
        stable=int(stable.sum()),
        grids=len(seen),
        stable_grids=len(seen - lost),
        damping=float(damping[worst]) if at else float("nan"),
        scr=scr,
        x_over_r=x_over_r,
        P=P,
    )


L_2_PU = 0.03
"""An L_2 for a filter that has none, over the base inductance."""
APART = Effort(heat=30, generations=90, joined=30, rounds=3)
"""With the units against each other: a gain set takes eight times as long."""
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
        return score_met(self.t) and self.full_order.passed


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
        return score_met(self.t)


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
    decay_apart: float = 0.0,
) -> InnerDesign:
    """The inner gains with the largest worst score over the box (:eq:`inner-score`), checked with the power loops.

    ``settling_time`` (s): the power loops'. ``progress`` is called many times a second and may raise to stop.
    ``target``: power loops of the check; None: the angle-damped closed form for ``settling_time``. ``starts``: further
    gains (SI) with ω_t (rad/s) to begin from. ``decay_apart``: the decay (1/s) that a table of equal units behind R_2
    and L_2 is asked for between them: with their damping one more promise (:func:`check_apart`), which lowers t where
    it is not kept; 0: none. Equal arguments give equal gains to the last bit, whatever the number of threads. A box on
    which no gains keep everything is no error: t is below 1 then, and ``limiting`` says what fails
    where. Raises StudyError for a settling time that is no positive number.
    """
    if not (math.isfinite(settling_time) and settling_time > 0.0):
        raise StudyError("inner loops", [Fault("settling_time", f"{settling_time} s", "must be a positive number")])
    begin = time.perf_counter()
    with one_thread():
        apart, more_starts = searched_apart(converter, filter_, box, decay_apart)
        found = search(
            converter,
            filter_,
            box,
            settling_time=settling_time,
            seed=seed,
            effort=effort or (Effort() if apart is None else APART),
            tell=progress or silent,
            more_starts=(*starts, *more_starts),
            apart=apart,
        )
        more = ()
        if apart is not None:
            more = check_apart(converter, filter_, found.gains, found.omega_t, box, decay=decay_apart)
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
        t=min(found.t, *(one.score for one in more), math.inf),
        search_t=found.search_t,
        start_t=found.start_t,
        promises=(*score.promises, *more),
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
    decay_apart: float = 0.0,
) -> list[Alternative]:
    """What twice the sampling, no delay and a larger L_2 would buy: each designed anew, the best t first.

    The searches are shorter than a design's and begin, among others, with the present ``gains`` (SI) and ``omega_t``
    (rad/s). An alternative that is already there (no delay without delay) is left out. ``decay_apart``: as in
    :func:`design_inner_loops`. Raises StudyError with every fault of the gains.
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
            apart, _ = searched_apart(c, f, box, decay_apart)
            result = search(
                c,
                f,
                box,
                settling_time=settling_time,
                seed=seed,
                effort=effort,
                tell=part,
                more_starts=[(present, omega_t)],
                apart=apart,
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
        options.append(("sampling", f"sampling twice a carrier period ({1e-3 * rate:.6g} kHz)", twice, filter_))
    else:
        twice = replace(converter, f_sw=2.0 * converter.f_sw)
        words = f"twice the carrier ({1e-3 * twice.f_sw:.6g} kHz, sampled at {1e-3 * rate:.6g} kHz)"
        options.append(("sampling", words, twice, filter_))
    if converter.delay_samples:
        options.append(("no_delay", "no computation delay", replace(converter, delay_samples=0), filter_))
    if filter_.L_2 > 0.0:
        larger = replace(filter_, L_2=2.0 * filter_.L_2)
        options.append(("L_2", f"twice the L_2 ({1e3 * larger.L_2:.4g} mH)", converter, larger))
    else:
        larger = replace(filter_, L_2=L_2_PU * converter.Z_base / converter.omega_n)
        options.append(("L_2", f"an L_2 of {L_2_PU:g} pu ({1e3 * larger.L_2:.4g} mH)", converter, larger))
    return options
