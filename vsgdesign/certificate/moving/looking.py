"""One look at boxes of grids and powers: on which all gains of an estimate have one function in common.

Its inequality is traced into programs for boxes: what the gains feed back, and the gain of the loop around their
uncertain part (:eq:`moving-answer`). The power loops are those of the proof on grids that rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.enclosure import PIECES, Loops
from vsgdesign.certificate.full_order.boxes import Part
from vsgdesign.certificate.full_order.cells import HIGH
from vsgdesign.certificate.full_order.higher import gains_of, tables
from vsgdesign.certificate.full_order.kernel import exclude, survey
from vsgdesign.certificate.full_order.looking import (
    PROVED,
    UNDECIDED,
    CellGroup,
    HighSizes,
    Looks,
    high_sizes,
    look_at,
    to_cut,
)
from vsgdesign.certificate.full_order.programs import (
    DIMENSIONS,
    INPUTS,
    Chart,
    LoopsOnArc,
    loops_on,
    minus,
    plus,
    times,
    values_of,
    values_program,
)
from vsgdesign.certificate.full_order.search import Problem
from vsgdesign.certificate.moving.places import DROOPS, Ball, kind_of, moved_by_unit
from vsgdesign.certificate.proof import arrays
from vsgdesign.certificate.region import AtDesignPoint, Region, System
from vsgdesign.certificate.taylor_kernel import rows
from vsgdesign.certificate.tracing import Program, Tracer, program_of
from vsgdesign.equations.sampled_path import Phasor, product
from vsgdesign.errors import InfeasibleStudyError

Array = NDArray[np.float64]

_ERRORS = 6
"""Pieces of the range of each error on which the gains are enclosed."""

_ERROR_COORDINATES = slice(2, 4)
_UP = 1.0 + 1e-12
_LAST = 1 + DIMENSIONS + DIMENSIONS * (DIMENSIONS + 1) // 2


@dataclass(frozen=True)
class MovingProblem(Problem):
    """A problem of grids that rest, whose boxes have no errors but those of the middle, and the inequality of all gains
    about it. ``arcs``: a program for each piece of the schedule."""

    moving: MovingPrograms
    ball: Ball
    arcs: tuple[Program, ...]

    @classmethod
    def about(cls, problem: Problem, moving: MovingPrograms, ball: Ball) -> MovingProblem:
        """With the gains of a ball."""
        arcs = tuple(moving.arc(k, ball, problem.loop.ratio) for k in range(len(moving.gains)))
        return cls(**vars(problem), moving=moving, ball=ball, arcs=arcs)

    def look(self, group: CellGroup, part: Part) -> Looks:
        """The loop with the gains of the middle has to be as good as one at rest; then the ball is looked at."""
        looks = look_at(self.programs, self.pieces, group, part)
        held = np.flatnonzero(looks.state == PROVED)
        if len(held) == 0:
            return looks
        found = self._gain(group, part.take(held))
        state, dimension, frequency = looks.state.copy(), looks.dimension.copy(), looks.frequency.copy()
        state[held], dimension[held], frequency[held] = found.state, found.dimension, found.frequency
        return Looks(state, dimension, frequency, looks.values + found.values)

    def _gain(self, group: CellGroup, part: Part) -> Looks:
        """The small gain on every arc of some boxes (:eq:`moving-small-gain`)."""
        count = len(part)
        piece = np.argmax(self._pieces(group, part.low, part.high, part), axis=0)
        reach, moved = self.reach(group, part, piece)
        state, frequency = np.full(count, UNDECIDED), part.frequency.copy()
        score = np.full((count, DIMENSIONS), np.nan)
        values = 0
        for case in np.unique(piece):
            some = np.flatnonzero(piece == case)
            own, cell = part.take(some), part.cell[some]
            gains = self._forms(self.moving.gains[case], group, own.low, own.high, own)
            limits = own.low, own.high
            good = self._high(self.moving.gains[case][0], group, limits, cell, gains, reach[some])
            frequency[some[~good]] = HIGH
            some, own, cell, gains = some[good], own.take(good), cell[good], gains[good]
            if len(some) == 0:
                continue
            given = np.zeros((len(some), 1, rows(DIMENSIONS)))
            given[:, 0, 0] = (reach[some] * _UP) ** 2 * _UP
            held, where = np.zeros(len(some), dtype=np.int64), np.zeros(len(some), dtype=np.int64)
            pull = np.zeros((len(some), DIMENSIONS))
            middle: Any = np.ones((len(some), int(group.counts.max())), dtype=complex)
            begin = group.places(cell, own.frequency)
            arcs = (group.functions, group.first, group.counts, group.order)
            forms = np.ascontiguousarray(np.concatenate([gains, given], axis=1))
            values += exclude(
                (own.low, own.high, cell, begin), forms, arcs, arrays(self.arcs[case]), DIMENSIONS,
                (held, where, pull, middle),
            )  # fmt: skip
            # A difference that is below zero everywhere has no zero, either.
            above = np.array([(middle[n, : group.counts[k]].real > 0.0).all() for n, k in enumerate(cell)])
            good = (held == 1) & above
            state[some[good]] = PROVED
            frequency[some] = group.frequencies(cell, where)
            # β² is about as much of the whole as what is left of it.
            score[some] = np.where((held == 0)[:, None], pull + moved[some] / reach[some, None], np.nan)
        return Looks(state, to_cut(part, score), frequency, values)

    def reach(self, group: CellGroup, part: Part, piece: NDArray[np.intp]) -> tuple[Array, Array]:
        """β of :eq:`moving-ball` for each box: bounds over all its grids, powers and errors, and over all pieces of the
        schedule that occur; and how much each dimension moves it, (N, d). ``piece``: that of the middle."""
        count, error = len(part), self.region.largest_error
        feeds = self._feeds_of(group, part, part.low, part.high, piece)
        inverse_left, inverse_right = np.linalg.inv(self.ball.left), np.linalg.inv(self.ball.right)
        edges, most = np.linspace(-error, error, _ERRORS + 1), np.zeros(count)
        moved = np.zeros((count, DIMENSIONS))
        for k in range(_ERRORS**2):
            low, high = part.low.copy(), part.high.copy()
            for column, n in ((2, k // _ERRORS), (3, k % _ERRORS)):
                low[:, column], high[:, column] = edges[n], edges[n + 1]
            for case, applies in enumerate(self._pieces(group, low, high, part)):
                some = np.flatnonzero(applies)
                if len(some) == 0:
                    continue
                own = part.take(some)
                case_of = np.full(len(some), case)
                off = self._feeds_of(group, own, low[some], high[some], case_of)
                off[..., :_LAST] -= feeds[some][..., :_LAST]
                off[..., _LAST:] += feeds[some][..., _LAST:]
                off[..., _LAST] += 1e-15 * np.abs(feeds[some]).sum(axis=-1)
                radius = off[..., _LAST : _LAST + DIMENSIONS].sum(axis=-1)
                off = np.einsum("ij,njkm,kl->nmil", inverse_left, off[..., : _LAST + DIMENSIONS], inverse_right)
                linear = np.linalg.norm(off[:, : 1 + DIMENSIONS], 2, axis=(2, 3))
                size = linear.sum(axis=1)
                size += np.linalg.norm(off[:, 1 + DIMENSIONS : _LAST], axis=(2, 3)).sum(axis=1)
                size += np.linalg.norm(np.abs(inverse_left) @ radius @ np.abs(inverse_right), axis=(1, 2))
                larger = some[size > most[some]]
                moved[larger] = linear[size > most[some], 1:]
                most[some] = np.maximum(most[some], size * _UP)
        return most * self.ball.rounding, moved

    def _pieces(self, group: CellGroup, low: Array, high: Array, part: Part) -> NDArray[np.bool_]:
        """Which pieces of the schedule occur in boxes, (pieces, N)."""
        programs, count = self.programs, len(part)
        empty, applies = np.zeros(count, dtype=np.bool_), np.zeros((len(programs.signs), count), dtype=np.bool_)
        columns = self.pieces.parameters(low, high, part.piece)
        boxes = (low, high, part.cell, group.rest, columns)
        survey(boxes, arrays(programs.situation), programs.conditions, programs.signs, DIMENSIONS, (empty, applies))
        return applies

    def _feeds_of(self, group: CellGroup, part: Part, low: Array, high: Array, piece: NDArray[np.intp]) -> Array:
        """The forms of the feeds of boxes, the rows of the ball alone, (N, rows, 2, rows(d))."""
        found = np.zeros((len(part), 6, rows(DIMENSIONS)))
        for case in np.unique(piece):
            some, (parts, _) = np.flatnonzero(piece == case), self.moving.feeds[case]
            forms = self._forms(self.moving.feeds[case], group, low[some], high[some], part.take(some))
            known = np.array([number is not None for number in parts])
            own = np.zeros((len(some), 6, rows(DIMENSIONS)))
            own[:, known, 0] = [number for number in parts if number is not None]
            own[:, ~known] = forms
            found[some] = own
        return found.reshape(len(part), 3, 2, -1)[:, self.ball.first :]

    def _forms(self, program: Parts, group: CellGroup, low: Array, high: Array, part: Part) -> Array:
        """What a program of gains gives on boxes, (N, outputs, rows(d))."""
        found = np.zeros((len(part), len(program[1].outputs), rows(DIMENSIONS)))
        columns = self.pieces.parameters(low, high, part.piece)
        gains_of((low, high, part.cell), group.rest, columns, arrays(program[1]), tables(), found)
        return found

    def _high(
        self, numbers: Any, group: CellGroup, limits: tuple[Array, Array], cell: Any, gains: Array, reach: Array
    ) -> NDArray[np.bool_]:
        """The small gain on the high arcs, by sizes alone."""
        good = np.zeros(len(cell), dtype=np.bool_)
        for found in high_sizes(numbers, group, *limits, cell, gains):
            with np.errstate(all="ignore"):
                total = found.total
                gain = reach[found.own, None] * self._high_gain(found, total)
                good[found.own] = ((total < 1.0 - 1e-9) & (found.s > 0.0) & (gain < 1.0 - 1e-9)).all(axis=1)
        return good

    def _high_gain(self, found: HighSizes, total: Array) -> Array:
        """A bound of \\|R n/f\\| (:eq:`moving-high`), (boxes, arcs)."""
        s = found.s
        e_11, e_12, e_21, e_22 = found.entries
        K_ip_D_p, free, inverse_free, D_p, D_q, D_p_k_Q = (found.parts[:, k, None] for k in range(-MORE, 0))
        slope = found.parts[:, 6, None]
        P_d, Q_d, P_V, Q_V = found.powers
        right, sum_of_squares = np.abs(self.ball.right), np.zeros(np.broadcast_shapes(s.shape, e_11.shape))
        for first, second, third in np.abs(self.ball.columns).T.tolist():
            b_1 = (1.0 + K_ip_D_p / s) * first + free * second / s
            b_2 = slope * first + third
            moved = ((1.0 + e_22) * b_1 + e_12 * b_2) / (1.0 - total)  # of δ, times s
            V = (e_21 * b_1 + (1.0 + e_11) * b_2) / (1.0 - total) / s
            Q = Q_d * moved / s + (Q_V + D_q) * V
            P = inverse_free * (P_d * moved / s + P_V * V + D_p * (moved + first) + D_p_k_Q * Q)
            for one, other in right.tolist():
                sum_of_squares = sum_of_squares + (one * P + other * Q) ** 2
        return np.sqrt(sum_of_squares)


def with_middle(part: Part, error: float) -> Part:
    """Boxes with the errors of the middle alone."""
    low, high = part.low.copy(), part.high.copy()
    low[:, _ERROR_COORDINATES] = high[:, _ERROR_COORDINATES] = error
    return replace(part, low=low, high=high)


Parts = tuple[list[float | None], Program]

MORE = 6
"""Parts beyond those of :func:`~vsgdesign.certificate.full_order.programs.values_of`: K_ip D_p, 1 − k_P D_p, its
inverse, D_p, D_q and D_p k_Q."""


@dataclass(frozen=True)
class MovingPrograms:
    """For each piece of the schedule: ``feeds``, the six numbers of :eq:`moving-feeds` row by row; and ``gains``, what
    the power loops in the middle of the ball are made of."""

    feeds: tuple[Parts, ...]
    gains: tuple[Parts, ...]

    @classmethod
    def of(cls, system: System, region: Region) -> MovingPrograms:
        """The programs of a study's loops in a region. Raises InfeasibleStudyError where a change of gains changes more
        than what is fed back from one pair of powers."""
        pieces = PIECES if not isinstance(system.schedule, AtDesignPoint) else (PIECES[0],)
        found: list[tuple[Parts, Parts]] = []
        for piece in pieces:
            tracer = Tracer(INPUTS)
            loops = loops_on(system, Chart(system, region, tracer, drawn=False), tracer, piece)
            fed = [-loops.algebra.value(one) for one in moved_by_unit(loops.gains)]
            found.append((values_program(tracer, loops, fed), values_program(tracer, loops, _parts(system, loops))))
        return cls(tuple(one for one, _ in found), tuple(one for _, one in found))

    def arc(self, piece: int, ball: Ball, ratio: bool) -> Program:
        """\\|f\\|² − β²\\|n\\|² and 0, where n/f is the answer of the powers to what the ball feeds, from the inputs of
        :class:`LoopsOnArc` and from β² (:eq:`moving-difference`)."""
        loops = LoopsOnArc(self.gains[piece][0], ratio, given=1)
        K_ip_D_p, free, inverse_free, D_p, D_q, D_p_k_Q = loops.more
        P_d, Q_d, P_V, Q_V = loops.FG
        s, determinant = loops.s, loops.determinant()
        f = product(determinant, loops.divided)
        total: Any = 0.0
        for first, second, third in ball.columns.T.tolist():
            b_1 = plus(times(first, plus(s, Phasor(K_ip_D_p, 0.0))), Phasor(free * second, 0.0))
            b_2 = Phasor(loops.slope * first + third, 0.0)
            delta = minus(product(loops.m_22, b_1), product(loops.m_12, b_2))
            V = minus(product(loops.m_11, b_2), product(loops.m_21, b_1))
            Q = plus(plus(product(Q_d, delta), product(Q_V, V)), times(D_q, V))
            P = plus(product(P_d, delta), product(P_V, V))
            more = minus(product(s, delta), times(first, determinant))
            P = times(inverse_free, plus(plus(P, times(D_p, more)), times(D_p_k_Q, Q)))
            for one, other in ball.right.tolist():
                n = product(plus(times(one, P), times(other, Q)), loops.divided)
                total = total + (n.re * n.re + n.im * n.im)
        difference = f.re * f.re + f.im * f.im - loops.given[0] * total
        return program_of(loops.tracer, [difference, 0.0])


def _parts(system: System, loops: Loops) -> list[Any]:
    gains, algebra = loops.gains, loops.algebra
    kind = kind_of(system)
    product_P, product_Q = algebra.value(gains.K_ip * gains.D_p), algebra.value(gains.K_iq * gains.D_q)
    if kind == DROOPS:
        normalised: Any = system.schedule
        q = getattr(normalised, "schedule", normalised).normalised(0.0, 0.0).q
        if q == 0.0:
            free = algebra.value(1.0 - gains.k_P * gains.D_p)
            return [*values_of(loops), product_P, free, 1.0 / free, gains.D_p, gains.D_q, gains.D_p * gains.k_Q]
    elif (
        kind is not None
        and not any(algebra.value(value).terms for value in (gains.k_P, gains.k_Q, gains.K_pq, gains.K_qp))
        and set(product_P.terms) <= {()}
        and set(product_Q.terms) <= {()}
    ):
        return [*values_of(loops), product_P, 1.0, 1.0, 0.0, 0.0, 0.0]
    raise InfeasibleStudyError(
        "gains that change are proved for schedules in closed form with both droops given, or of the published law: in "
        "this one a change of gains moves a droop by itself. Points alone can be looked at."
    )
