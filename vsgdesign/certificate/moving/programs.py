"""The inequality of changing gains as programs for boxes: what the gains feed back, and the gain of the loop around
their uncertain part (:eq:`moving-answer`). The power loops are those of the proof on grids that rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from vsgdesign.certificate.enclosure import PIECES, Loops
from vsgdesign.certificate.full_order.programs import (
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
from vsgdesign.certificate.moving.ball import Ball
from vsgdesign.certificate.moving.places import DROOPS, kind_of
from vsgdesign.certificate.region import AtDesignPoint, Region, System
from vsgdesign.certificate.tracing import Program, Tracer, program_of
from vsgdesign.equations.power_loops import References, power_loops_about_rest
from vsgdesign.equations.sampled_path import Phasor, product
from vsgdesign.errors import InfeasibleStudyError

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
            found.append(
                (values_program(tracer, loops, _feeds(loops)), values_program(tracer, loops, _parts(system, loops)))
            )
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


def _feeds(loops: Loops) -> list[Any]:
    none, algebra = References(0.0, 0.0, 0.0, 0.0), loops.algebra
    columns = [power_loops_about_rest(0.0, 0.0, P, Q, none, loops.gains) for P, Q in ((1.0, 0.0), (0.0, 1.0))]
    return [-algebra.value(column[row]) for row in range(3) for column in columns]


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
