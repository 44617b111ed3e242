"""Golden vectors: what Python answers to a sequence of calls that passes every guard."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.identification.neural import NeuralEstimator
from vsgdesign.runtime.guards import NO_ESTIMATE, NO_REASON
from vsgdesign.runtime.scheduler import SAID, Scheduler, advance, first_state


@dataclass(frozen=True)
class KnownAnswer:
    """One call and its answer. ``given``: R_g, L_g, P, Q, V, as single precision holds them."""

    ticks: int
    hold: bool
    given: tuple[float, ...]
    status: int
    reason: int
    answer: PowerLoopGains
    size: tuple[float, ...]
    """What an error of each gain is relative to."""


def gain_sizes(gains: PowerLoopGains) -> tuple[float, ...]:
    """What errors of the gains are relative to: the larger of a row, whose other entry may pass through zero."""
    K_ip, D_p, K_iq, D_q, K_pq, K_qp, k_P, k_Q = (abs(float(value)) for value in gains)
    P_row, Q_row, damping = max(K_ip, K_pq), max(K_iq, K_qp), max(k_P, k_Q)
    return P_row, D_p, Q_row, D_q, P_row, Q_row, damping, damping


def known_answers(scheduler: Scheduler) -> list[KnownAnswer]:
    """A sequence from the first state on: confirmed jump, rate, edges, refusals, time backwards, fallback."""
    lookup, c = scheduler.lookup, scheduler.settings
    middle = float(np.sqrt(c.scr[0] * c.scr[1])), float(np.sqrt(c.r_over_x[0] * c.r_over_x[1]))
    R, L = lookup.grid(*middle)
    R_weak, L_weak = lookup.grid(0.9 * c.scr[0], 1.3 * middle[1])
    P, Q, V = 0.4 * c.P[1], 0.3 * c.Q[1], 0.5 * (c.V_rms[0] + c.V_rms[1])
    calls: list[tuple[int, bool, tuple[float, ...]]] = [(0, True, (0.0, 0.0, P, Q, V))]
    calls += [(20_000 * k, False, (R, L, P, Q, V)) for k in range(1, 9)]
    calls += [(20_000 * k, False, (1.01 * R, 1.01 * L, P, -Q, V)) for k in range(9, 11)]
    calls += [
        (220_000, False, (R, L, 20.0 * P, Q, V)),
        (240_000, False, (R, L, 2.0 * c.power_range, Q, V)),
        (260_000, False, (-100.0 * R, L, P, Q, V)),
        (280_000, False, (R, -L, P, Q, V)),
        (5, False, (R, L, P, Q, V)),
        (20_005, False, (R, L, P, Q, 1.9 * c.V_rms[1])),
    ]
    calls += [(20_005 + 20_000 * k, False, (R_weak, L_weak, P, Q, V)) for k in range(1, 12)]
    calls += [(240_005 + 400_000 * k, True, (0.0, 0.0, P, Q, V)) for k in range(1, 4)]
    known: list[KnownAnswer] = []
    state = first_state(lookup, c)
    for ticks, hold, values in calls:
        R_g, L_g, P, Q, V = given = tuple(float(np.float32(value)) for value in values)
        said = NO_ESTIMATE if hold else NO_REASON
        state, answer = advance(lookup, c, state, said, R_g, L_g, P, Q, V, ticks)
        known.append(
            KnownAnswer(ticks, hold, given, answer.status, answer.reason, answer.gains, gain_sizes(answer.gains))
        )
    return known


def known_windows(estimator: NeuralEstimator) -> tuple[tuple[float, float], list[tuple[float, float, int]]]:
    """The steps of v and i, and R_g, L_g and reason of windows made of whole numbers times them.

    The steps are powers of two, so that every sample is exact in single precision.
    """
    largest = (50.0, 48.0)
    steps = tuple(
        2.0 ** math.floor(math.log2(min(limit / size, bound) * 0.4))
        for limit, size, bound in zip((estimator.v_limit, estimator.i_limit), largest, (8.0, 1.0), strict=True)
    )
    k, found = np.arange(estimator.components * estimator.samples, dtype=np.float64), []
    for j in range(8):
        v = steps[0] * ((37 * k + 11 * j) % 101 - 50.0)
        i = steps[1] * ((53 * k + 7 * j) % 97 - 48.0)
        R_g, L_g, status = estimator.estimate(v, i)[:3]
        found.append((R_g, L_g, SAID[status]))
    return (steps[0], steps[1]), found
