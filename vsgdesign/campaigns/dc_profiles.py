"""What runs ask of a dc link, and candidates for its sizes on the scalar equation of the link alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.flat import flat_block
from vsgdesign.codegen.llvm import Loop, LoopSpec, compiled_loop, empty_rows
from vsgdesign.codegen.records import numbers_of, zero_record
from vsgdesign.equations.dc_link import DcSettings, DcState, link_step
from vsgdesign.equations.dc_sources import BATTERY
from vsgdesign.equations.dc_sources.converter import UNLIMITED_J
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.dc_beyond import STIFF_S
from vsgdesign.simulation.dc_parts import DcKind, dc_kind
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

LANES = 8
"""Candidates side by side."""

ROUNDS = 4
"""Each divides what is left of a range by LANES + 1, so that its logarithm is known to 1/6561."""

_BLOCK = 16_384
"""Samples that are given to the loop at a time."""

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

    def largest_change(self, within_s: float) -> float:
        """Of the power within a time, W."""
        late = max(round(within_s / self.T_s), 1)
        return float(np.abs(self.p[late:] - self.p[:-late]).max()) if len(self.p) > late else 0.0


@dataclass(frozen=True)
class SizedRun:
    """A run for which a dc side is sized: the events of a study, or a test of a suite."""

    name: str
    """Of the test; empty: the study's own events."""
    study: Study
    spec: ControllerSpec
    profile: Profile


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


def link_with(study: Study, link: DcLink, size: Size) -> DcLink:
    """A link with the sizes of a candidate."""
    V, given = study.converter.V_dc, dict(link.given) | {"charge": size.charge}
    if link.source == BATTERY.name:
        given |= {"i_max": size.p_max / V, "i_charge_max": size.p_charge_max / V}
        given["capacity_Ah"] = size.energy / (3600.0 * V)
    else:
        given |= {"p_max": size.p_max, "p_charge_max": size.p_charge_max, "energy": size.energy}
    sized = replace(link, C=size.C)
    values = sized.kind.values(sized.ratings(study.converter), given)
    return replace(sized, given=tuple(values.items()))


def every_sample(study: Study, link: DcLink) -> Study:
    """The study on a link, with a log of every sample."""
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
    large = Size(p_max=1e3 * c.S_rated, p_charge_max=1e3 * c.S_rated, C=2.0 * STIFF_S * c.S_rated / c.V_dc**2)
    wide = replace(link_with(study, link, large), V_low=1e-3 * c.V_dc, V_high=1e3 * c.V_dc)
    own = every_sample(study.with_limit_of(spec), wide)
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


class LinkSearch:
    """Candidates on the equation of the link alone."""

    def __init__(self, study: Study, link: DcLink, runs: Sequence[SizedRun]) -> None:
        kind = dc_kind(link)
        if kind is None:
            raise ValueError("a link to size is not ideal.")
        self._study, self._link, self._kind = study, link, kind
        self._runs = list(runs)
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
        """Whether each candidate keeps the link within its limits in every run. The run that lost one comes first the
        next time."""
        good = [True] * len(sizes)
        for run in list(self._runs):
            left = [k for k, one in enumerate(good) if one]
            if not left:
                break
            for k, margin in zip(left, self._margins([sizes[k] for k in left], run), strict=True):
                good[k] = margin >= 0.0
            if not all(good[k] for k in left):
                self._runs.remove(run)
                self._runs.insert(0, run)
        return good

    def tightest(self, size: Size) -> list[SizedRun]:
        """The runs in the order of what they leave to the limits of the link."""
        return sorted(self._runs, key=lambda run: self._margins([size], run)[0])

    def _margins(self, sizes: list[Size], run: SizedRun) -> list[float]:
        """What is left to the nearer limit, V; negative: the link leaves it."""
        low, high = self._link.V_low, self._link.V_high
        moved = self.moved(sizes, run.profile)
        return [-math.inf if one is None else min(one.lowest - low, high - one.highest) for one in moved]

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

    def moved(self, sizes: list[Size], profile: Profile) -> list[DcState | None]:
        """The link of each candidate at the end; None where its source cannot give the power of the start."""
        study = self._study
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
            self._run(rows, profile)
            for lane, start in enumerate(starts[: len(some)]):
                numbers = dict(zip(self._state, rows[0, : len(self._state), lane].tolist(), strict=True))
                own = {name: numbers[f"state.{name}"] for name in DcState._fields if name != "memory"}
                found.append(None if start is None else start._replace(**own))
        return found

    def _run(self, rows: Array, profile: Profile) -> None:
        p, needs = profile.p, profile.needs
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
