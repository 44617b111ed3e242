"""Many runs whose controllers learn their grids with a field estimator, cycle by cycle."""

from __future__ import annotations

import itertools
import math
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.llvm import Program, best_lanes, empty_rows
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.field import FieldAnswer, first_lock_in, first_track
from vsgdesign.equations.integration import TURN
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.execution.signals import interrupts_deferred
from vsgdesign.identification.field import FieldEstimator
from vsgdesign.linear.operating_point.many_rests import many_rests_with_measured_gains
from vsgdesign.runtime.many import ManyCovariances, ManySchedulers
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.runtime.scheduler import scheduler_of
from vsgdesign.simulation.circuit_program import CutSample
from vsgdesign.simulation.compiled_schedulers import CompiledSchedulers
from vsgdesign.simulation.field_feed import LEAST_RESISTANCE, box_of, network_of, settings_of_study
from vsgdesign.simulation.field_observer import conclusion_loop
from vsgdesign.simulation.lanes.before_steps import in_groups, mains_alone, put_beside
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.part import Part
from vsgdesign.simulation.lanes.rests import Rests, circuits_at_rest
from vsgdesign.simulation.lanes.results import JUDGED, NO_REST, LaneResults
from vsgdesign.simulation.lanes.speaking import ManyNetworks
from vsgdesign.simulation.scenario import mean_cycles
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]
Samples = NDArray[np.int64]


_GROUPS = 64
"""Groups that are moved at once where they are given noise: it takes some 35 MB."""

_TIE = 1e-6
"""Share of a sample by which the end of a cycle lies beside it at least, where rounding cannot decide."""


class Learning:
    """The gains of N controllers that begin with no knowledge of their grids: what ``FieldScheduler`` does for one."""

    def __init__(self, study: Study, spec: ControllerSpec, ready: Ready, count: int) -> None:
        self._converter, self._box = study.converter, box_of(study)
        self._law, table = gain_law(study, spec, ready), ready.table(spec)
        self._schedulers = None
        if table is not None:
            one = scheduler_of(table, FieldEstimator(settings_of_study(study)))
            lanes = CompiledSchedulers(one.lookup, one.settings)
            self._schedulers = ManySchedulers(one.lookup, one.settings, count, lanes)
            self._tick = one.settings.tick
        middle = self._box.middle.grid(study.converter)
        self._held = self._grid = np.full(count, middle.R_g), np.full(count, middle.L_g)
        self._gains = self.first(np.zeros(count), np.zeros(count), np.full(count, study.converter.V_rated_rms))

    def first(self, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        """Gains from the start on (``gains_of`` of a rest); NaN: there are none."""
        if self._schedulers is not None:
            nothing = np.full(len(P), np.nan)
            self._gains = self._schedulers.update(nothing, nothing, P, Q, V_rms, 0)
        else:
            self._gains = self._law(*self._held, P, Q, V_rms)
        return self._gains

    def start_with(self, gains: PowerLoopGains) -> None:
        """The gains of the rest at the start."""
        self._gains = gains

    @property
    def gains(self) -> PowerLoopGains:
        """The present gains; those of :meth:`first` at first."""
        return self._gains

    def update(self, said: FieldAnswer, samples: Samples, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        """Gains after the cycles that end before these samples (N,), from the answers (N,) to them."""
        followed = (said.valid > 0.5) & (said.spoilt < 0.5) & np.isfinite(said.R_g) & np.isfinite(said.L_g)
        if self._schedulers is not None:
            self._gains = self._schedulers.update(
                np.where(followed, said.R_g, np.nan),
                np.where(followed, said.L_g, np.nan),
                P,
                Q,
                V_rms,
                np.rint(samples * self._converter.T_s / self._tick).astype(np.int64),
                limited=said.limited > 0.0,
                surprised=said.event > 0.5,
                changed=said.changed > 0.5,
                covariance=ManyCovariances(said.var_R, said.cov_RL, said.var_L),
            )
            return self._gains
        size = np.hypot(said.R_g, self._converter.omega_n * said.L_g)
        possible = (said.L_g > 0.0) & (said.R_g > LEAST_RESISTANCE * size)
        at = np.flatnonzero(followed & possible)
        held = self._held[0].copy(), self._held[1].copy()
        for values, clipped in zip(
            held, self._box.all_clipped(said.R_g[at], said.L_g[at], self._converter), strict=True
        ):
            values[at] = clipped
        self._held = held
        found = self._law(*held, P, Q, V_rms)
        good = np.isfinite(np.stack(found)).all(axis=0) & (possible | ~followed)
        self._gains = PowerLoopGains(*(np.where(good, new, old) for new, old in zip(found, self._gains, strict=True)))
        self._grid = np.where(good, held[0], self._grid[0]), np.where(good, held[1], self._grid[1])
        return self._gains

    def estimate(self) -> tuple[Array, Array]:
        """R_g (Ω) and L_g (H) of the grids that the present gains are for."""
        return self._grid if self._schedulers is None else self._schedulers.grid

    def take(self, chosen: NDArray[Any]) -> Learning:
        """The same of some lanes."""
        some = copy(self)
        some._held = self._held[0][chosen], self._held[1][chosen]
        some._grid = self._grid[0][chosen], self._grid[1][chosen]
        if self._schedulers is not None:
            some._schedulers = self._schedulers.take(chosen)
        some._gains = PowerLoopGains(*(values[chosen] for values in self._gains))
        return some


def before_learning(
    study: Study, spec: ControllerSpec, ready: Ready, cases: LaneCases, rests: Rests, results: LaneResults
) -> tuple[Rests, Learning]:
    """Where the cases rest at the start, with the gains of a controller that knows nothing. Cases without such a rest
    are marked."""
    learning = Learning(study, spec, ready, len(cases))
    phase = cases.around.phase
    linked = circuits_at_rest(study, cases, cases.at_start)
    start, gains = many_rests_with_measured_gains(
        study, cases.at_start, learning.first, phase=phase, circuit=linked.start
    )
    learning.start_with(gains)
    without = (results.status == JUDGED) & (start.fault > 0)
    results.status[without], results.fault[without] = NO_REST, start.fault[without]
    return replace(rests, start=start, delta_start=start.controller.theta - phase), learning


def samples_of_mean(study: Study) -> int:
    """The samples over which a scenario takes the mean of P and Q (:func:`mean_cycles`)."""
    c = study.converter
    return max(round(mean_cycles(study) * 2.0 * math.pi / c.omega_n / c.T_s), 1)


class Listeners:
    """The estimators of a part's lanes, and the lanes that they move: each lane goes from the end of one of its own
    cycles to the end of the next, and all cycles are concluded at once."""

    def __init__(self, study: Study, spec: ControllerSpec, part: Part, learning: Learning) -> None:
        self._study, self._spec, self._part, self._learning = study, spec, part, learning
        self._settings = settings_of_study(study)
        groups, _, width = part.rows.shape
        network, lanes = network_of(study, spec), best_lanes()
        mains = width // 2 if part.beside else width
        self._networks = None if network is None else ManyNetworks(network, self._settings, groups, mains)
        self._conclusion = conclusion_loop(lanes, mains // lanes)
        self._rows = empty_rows(self._conclusion.spec, groups)
        self._constants = np.array(numbers_of(self._settings))
        self._log = np.empty((groups, 1, len(self._conclusion.spec.logged), mains))
        self._lock = part.span("lock")
        lock = numbers_of(first_lock_in(self._settings, study.converter.omega_n))
        part.rows[:, self._lock, :] = np.array(lock)[:, None]
        self._rows[:, len(lock) :, :] = np.array(numbers_of(first_track(self._settings)))[:, None]
        self._samples = np.zeros(groups * width, dtype=np.int64)
        """The sample at which each lane is."""
        self._begun = 0
        """Samples of the loop so far."""
        program = part.program
        count = np.diff(program.first)
        self._lane = np.repeat(np.arange(groups), count) * width + program.lane
        """Of each record of the program."""
        self._period = max(len(part.kind.bridge.slopes), 1)
        """Samples of a carrier's period."""
        self._late = np.zeros(groups * width, dtype=np.int64)
        """By how many samples each lane begins a cycle later than the loop."""
        self._values = np.append(program.values, 0.0)
        self._cut: dict[int, list[CutSample]] = {}
        for one in part.cut:
            self._cut.setdefault(one.lane, []).append(one)
        self._put(learning.gains)

    def run(self) -> None:
        """Runs every lane to its end. Twins are beside their runs from before the first step on."""
        if self._part.beside:
            alone = Listeners(self._study, self._spec, mains_alone(self._part), self._learning)
            alone._run_to(self._part.logs[0].begin)
            self._go_on(alone)
        self._run_to(None)

    def _go_on(self, alone: Listeners) -> None:
        """Goes on where the runs have come to alone."""
        put_beside(self._part, alone._part)
        groups, _, mains = self._rows.shape
        self._rows[:] = in_groups(alone._rows, groups, mains)
        if self._networks is not None and alone._networks is not None:
            self._networks.go_on(alone._networks)
        self._samples, self._begun = np.repeat(alone._samples[: groups * mains], 2), alone._begun

    def _run_to(self, sample: int | None) -> None:
        """Runs every lane to its end, or as long as no cycle ends behind a sample."""
        ends = self._part.ends + 1
        width = self._part.rows.shape[2]
        while True:
            left = np.flatnonzero(self._samples[: len(ends)] < ends)
            if len(left) == 0:
                return
            groups = -(-(int(left[-1]) + 1) // width)
            counts = self._samples_to_the_end(self._part.rows[:groups])
            if sample is not None and int((self._samples[: groups * width] + counts).max()) > sample:
                return
            self._cycle(groups, counts)

    def _cycle(self, groups: int, counts: Samples) -> None:
        """One cycle of every lane of the first groups, which ends after so many samples."""
        part, width = self._part, self._part.rows.shape[2]
        lanes = slice(0, groups * width)
        rows, lock = part.rows[:groups], self._rows[:groups, : self._lock.stop - self._lock.start]
        late = self._wait_for_carrier(rows, lanes)
        longest = int((counts + late).max())
        with interrupts_deferred():
            self._move(groups, counts, late)
        part.look()
        self._begun += longest
        self._samples[lanes] += counts
        self._follow_rings(longest - counts - late)
        mains = self._part.mains
        lock[:] = rows[:, self._lock, mains]
        self._conclusion(0, 1, self._rows[:groups], self._constants, log=self._log[:groups], every=1)
        rows[:, self._lock, mains] = lock
        if self._part.beside:  # a twin sends what its run sends, but for what its own limiter has muted
            muted = rows[:, self._part.place["lock.muted"], 1::2].copy()
            rows[:, self._lock, 1::2] = lock
            rows[:, self._part.place["lock.muted"], 1::2] = muted
        said = self._log[:groups, 0]
        if self._networks is not None:
            said = self._networks.behind(said)
        self._answer(FieldAnswer(*(said[:, k].reshape(-1) for k in range(len(FieldAnswer._fields)))))

    def _wait_for_carrier(self, rows: Array, lanes: slice) -> Samples:
        """By how many samples each lane begins its cycle later, so that it is where the loop is on the carrier. Until
        then it stands still, as if its cycle had ended."""
        late = (self._samples[lanes] - self._begun) % self._period
        if late.any():
            rows[:, self._part.place["lock.closed"]] = (late > 0).reshape(len(rows), -1)
            self._follow_rings(late)
        return late

    def _move(self, groups: int, counts: Samples, late: Samples) -> None:
        """Moves the lanes of the first groups through their next samples. What they are given is made for many groups
        at once: each call costs as much as a tenth of a group's cycle, and memory does not."""
        part, program, begun = self._part, self._program(groups, counts, late), self._begun
        each = groups if part.feed is None else _GROUPS
        width = part.rows.shape[2]
        for first in range(0, groups, each):
            count = min(each, groups - first)
            own = replace(program, first=program.first[first : first + count + 1], done=program.done[first:][:count])
            fed = None if part.feed is None else part.feed.given(self._samples, counts, first, count, late)
            lanes = slice(first * width, (first + count) * width)
            logs = part.slots is not None and int((self._samples[lanes] + counts[lanes]).max()) > part.logs[0].begin
            cut = self._cut_samples(lanes, counts, late)
            # Until the first cycle ends, no lane has to look whether it stands still: a quarter of the time.
            together = int(late[lanes].max()), int((counts + late)[lanes].min())
            ends = {0, *together, int((counts + late)[lanes].max()), *cut, *(at + 1 for at in cut)}
            for begin, end in itertools.pairwise(sorted(ends)):
                here = None if fed is None else fed[:, begin:end]
                after = [(one.lane, part.after_cut(one, here, begun + begin, first)) for one in cut.get(begin, ())]
                part.advance_with(
                    own,
                    begun + begin,
                    begun + end,
                    first=first,
                    fed=here,
                    log=part.slots[first : first + count] if part.slots is not None and logs else None,
                    together=together[0] <= begin and end <= together[1],
                )
                for lane, state in after:
                    part.put_state(lane, state)

    def _cut_samples(self, lanes: slice, counts: Samples, late: Samples) -> dict[int, list[CutSample]]:
        """The samples of some lanes in whose intervals events fall, by their place in this cycle of the loop."""
        found: dict[int, list[CutSample]] = {}
        for lane in range(lanes.start, lanes.stop) if self._cut else ():
            for one in self._cut.get(lane, ()):
                at = one.sample - int(self._samples[lane])
                if 0 <= at < counts[lane]:
                    found.setdefault(at + int(late[lane]), []).append(one)
        return found

    def _samples_to_the_end(self, rows: Array) -> Samples:
        """In how many samples the cycle of each lane ends."""
        place, settings = self._part.place, self._settings
        phi, omega = rows[:, place["lock.phi"]].reshape(-1), rows[:, place["lock.omega"]].reshape(-1)
        turned = omega * settings.T_s
        with np.errstate(invalid="ignore"):
            steps = (TURN - 0.5 * turned - phi) / turned
            counts = np.ceil(steps)
            # So near to a sample, the rounding of the loop's own sums decides.
            near = np.flatnonzero(~(np.abs(steps - np.round(steps)) > _TIE))
        most = math.ceil(TURN / (0.95 * settings.omega_n * settings.T_s)) + 2
        angles = np.empty((most, len(near)))
        angles[0], angles[1:] = phi[near], turned[near]
        over = np.add.accumulate(angles, axis=0) + 0.5 * turned[near] >= TURN
        # A lane whose angle is no number has diverged: it goes along with the others to its end.
        counts[near] = np.where(over.any(axis=0), over.argmax(axis=0), most - 1)
        return counts.astype(np.int64) + 1

    def _program(self, groups: int, counts: Samples, late: Samples) -> Program:
        """The records of this cycle, at the samples of the loop."""
        program, width = self._part.program, self._part.rows.shape[2]
        until = int(program.first[groups])
        lane, at = self._lane[:until], program.at[:until]
        since = at - self._samples[lane]
        chosen = np.flatnonzero((since >= 0) & (since < counts[lane]))
        waiting = np.flatnonzero(late)
        lane = np.concatenate([waiting, lane[chosen]])
        at = self._begun + late[lane] + np.concatenate([np.zeros(len(waiting), dtype=np.int64), since[chosen]])
        order = np.lexsort((at, lane // width))
        # A lane that waits goes on where a zero is put into the place that says that its cycle has ended.
        opened = np.full(len(waiting), self._part.place["lock.closed"], dtype=np.int64)
        row = np.concatenate([opened, program.row[chosen]])
        count = np.concatenate([np.ones_like(opened), program.count[chosen]])
        source = np.concatenate([np.full_like(opened, len(self._values) - 1), program.source[chosen]])
        first = np.searchsorted(lane[order] // width, np.arange(groups + 1)).astype(np.int64)
        return Program(
            first=first,
            at=at[order],
            lane=(lane % width)[order],
            row=row[order],
            count=count[order],
            source=source[order],
            values=self._values,
            done=first[:-1].copy(),
        )

    def _follow_rings(self, idle: Samples) -> None:
        """A lane that stood still for some samples finds its past so many slots later."""
        part = self._part
        if part.rings is None or part.ring_length is None:
            return
        width, length = part.rings.shape[3], int(part.ring_length[0])
        for by in np.unique(idle[idle % length != 0]).tolist():
            group, lane = np.divmod(np.flatnonzero(idle == by), width)
            past = part.rings[group, :length, :, lane]
            part.rings[group, :length, :, lane] = np.roll(past, by, axis=1)

    def _answer(self, said: FieldAnswer) -> None:
        part, learning = self._part, self._learning
        P, Q, V_rms = (part.get(f"state.{name}")[part.mains] for name in ("P_f", "Q_f", "V"))
        count = min(len(P), len(said.R_g))
        whole = FieldAnswer(*(np.concatenate([values[:count], np.full(len(P) - count, np.nan)]) for values in said))
        self._put(learning.update(whole, self._samples[: len(part)][part.mains], P, Q, V_rms))

    def _put(self, gains: PowerLoopGains) -> None:
        """Puts gains into force; the frequency at which the integrator would rest stays (:eq:`gain-transfer`)."""
        part = self._part
        if part.beside:
            gains = PowerLoopGains(*(np.repeat(values, 2) for values in gains))
        if self._begun:
            before = PowerLoopGains(*(part.get(f"power_gains.{name}") for name in PowerLoopGains._fields))
            refs = References(*(part.get(f"refs.{name}") for name in References._fields))
            part.put("state.omega_i", gain_transfer(part.get("state.omega_i"), refs, before, gains))
        for name, values in gains._asdict().items():
            part.put(f"power_gains.{name}", values)
        for name, values in zip(("grid.R_g", "grid.L_g"), self._learning.estimate(), strict=True):
            if name in part.place:
                part.put(name, np.repeat(values, 2) if part.beside else values)
