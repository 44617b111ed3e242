"""What the network adds: the recursions alone, with the network behind its gate, and with the network unguarded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.field_weights import MODES, FieldLayers
from vsgdesign.equations.field_fusion import (
    FIRST_GATE,
    FusedImpedance,
    GateLimits,
    fused_impedance,
    may_speak,
    next_gate,
)
from vsgdesign.estimator.field.cycles import CHANGES, FieldCycles
from vsgdesign.estimator.field.training import evaluate
from vsgdesign.metrics.answers import Answers, inside_ellipse, time_to_stay, valid_and_wrong

Array = NDArray[np.float64]

WAYS = ("physics", "gated", "ungated")
"""The recursions alone; the network where its gate lets it speak, otherwise the recursions; the network always."""

GROUPS = {"jump": (1,), "jump_and_step": (2,), "grid_step": (3,), "rest": (4, 0)}
"""Codes of CHANGES that are judged together: ``rest`` has no event of the grid."""

AFTER = (5, 8, 10, 15)
"""Cycles after a change at which the error is stated."""

WINDOWS = {"2 to 8": (2, 8), "10 to 20": (10, 20), "from 20": (20, 10**6)}
"""Cycles after a change over which coverage is stated."""

_BEFORE = 5


@dataclass(frozen=True, kw_only=True)
class GroupScore:
    """One way of answering, over all changes of a group. Errors are |Ẑ − Z|/|Z|; NaN where there is nothing."""

    changes: int
    error_p95: tuple[float, ...]
    """95th percentile of the answer's error, valid or not, so many cycles after the change as AFTER says."""
    valid_share: tuple[float, ...]
    """Share of the changes with a valid answer then."""
    valid_error_p95: tuple[float, ...]
    """95th percentile of the error of those."""
    t10_s: tuple[float, float, float]
    """Median, 90th and 95th percentile of the time to stay within 10 %, s; infinite where it is not reached."""
    coverage: dict[str, float]
    """Share of the valid answers whose 95 % ellipse contains the truth, by WINDOWS."""
    wrong_s: float
    """Mean time of valid answers with an error above 20 % per change, s, from 40 ms after it."""
    worst: float
    """Largest error of a valid answer, from 40 ms after a change."""
    rest_error: tuple[float, float]
    """Median and 95th percentile of the error five cycles before the change."""
    rest_coverage: float
    """Coverage of the valid answers there."""


@dataclass(frozen=True, eq=False)
class Streams:
    """Answers of one way, a row for each cycle: R and X (N, 2), covariance (N, 3), whether they are valid (N,)."""

    estimate: Array
    covariance: Array
    valid: NDArray[np.bool_]


def field_scores(
    cycles: FieldCycles, layers: FieldLayers, radius_squared: dict[str, float], gate: GateLimits
) -> dict[str, dict[str, GroupScore]]:
    """The three ways on some runs, by way and group."""
    return {way: _judged(cycles, stream) for way, stream in streams(cycles, layers, radius_squared, gate).items()}


def streams(
    cycles: FieldCycles, layers: FieldLayers, radius_squared: dict[str, float], gate: GateLimits
) -> dict[str, Streams]:
    """The answers of the three ways."""
    posterior = evaluate(layers, cycles.features)
    radii = np.array([radius_squared[name] for name in MODES])[cycles.mode]
    fused = fused_impedance(cycles.estimate[:, 0], cycles.estimate[:, 1], posterior, radii)
    physics = Streams(cycles.estimate, cycles.covariance, cycles.valid)
    network = _stream(fused, fused.sigma < gate.confident)
    speaks = (speaking(cycles, gate) & network.valid)[:, None]
    gated = Streams(
        np.where(speaks, network.estimate, physics.estimate),
        np.where(speaks, network.covariance, physics.covariance),
        np.where(speaks[:, 0], True, physics.valid),
    )
    return dict(zip(WAYS, (physics, gated, network), strict=True))


def speaking(cycles: FieldCycles, limits: GateLimits) -> NDArray[np.bool_]:
    """(N,) where the gate is open, by the same equations as on the controller."""
    found, gate, run = np.zeros(len(cycles), dtype=bool), FIRST_GATE, None
    for k in range(len(cycles)):
        if cycles.run[k] != run:
            gate, run = FIRST_GATE, cycles.run[k]
        gate = next_gate(gate, float(cycles.event[k]))
        found[k] = may_speak(gate, float(cycles.refuted[k]), limits) > 0.5
    return found


def _stream(fused: FusedImpedance, valid: NDArray[np.bool_]) -> Streams:
    covariance = np.column_stack([fused.var_R, fused.cov_RX, fused.var_X])
    return Streams(np.column_stack([fused.R, fused.X]), covariance, valid)


def _judged(cycles: FieldCycles, stream: Streams) -> dict[str, GroupScore]:
    rows = {name: _Rows() for name in GROUPS}
    group_of = {code: name for name, codes in GROUPS.items() for code in codes}
    for run in np.unique(cycles.run):
        of_run = np.flatnonzero(cycles.run == run)
        answers = _answers(cycles, stream, of_run)
        covered, error = inside_ellipse(answers), answers.error
        numbers = cycles.change_number[of_run]
        for number in range(numbers.max() + 1):
            after = np.flatnonzero(numbers == number)
            if len(after):
                name = group_of[int(cycles.change[of_run[after[0]]])]
                rows[name].add(answers, error, covered, after, cycles.since_change[of_run[after[0]]])
    return {name: one.score(name) for name, one in rows.items()}


def _answers(cycles: FieldCycles, stream: Streams, rows: NDArray[np.int64]) -> Answers:
    """One run's answers at the PCC: the filter's own grid side is taken off."""
    converter = cycles.header["converters"][int(cycles.converter[rows[0]])]
    behind = complex(converter["R_2"], converter["X_2"])
    RR, RX, XX = stream.covariance[rows].T
    t_s = cycles.t_s[rows]
    return Answers(
        t_s=t_s,
        Z=cycles.truth[rows] @ (1.0, 1j) - behind,
        Z_hat=stream.estimate[rows] @ (1.0, 1j) - behind,
        covariance=np.stack([np.stack([RR, RX], -1), np.stack([RX, XX], -1)], -2),
        valid=stream.valid[rows],
        changed=np.zeros(len(rows), dtype=bool),
        end_s=float(t_s[-1]),
    )


class _Rows:
    """Collects what one group's changes show."""

    def __init__(self) -> None:
        self._errors: list[Array] = []
        self._valid: list[NDArray[np.bool_]] = []
        self._t10: list[float] = []
        self._covered: dict[str, list[bool]] = {name: [] for name in WINDOWS}
        self._wrong: list[float] = []
        self._worst: list[float] = []
        self._rest: list[tuple[float, bool, bool]] = []

    def add(
        self, answers: Answers, error: Array, covered: NDArray[np.bool_], after: NDArray[np.int64], since: float
    ) -> None:
        """One change, whose first cycle ends ``since`` s after it."""
        at = np.minimum(after[0] + np.array(AFTER), after[-1])
        self._errors.append(error[at])
        self._valid.append(answers.valid[at])
        change_s, until_s = float(answers.t_s[after[0]]) - since, float(answers.t_s[after[-1]])
        self._t10.append(time_to_stay(answers, change_s, until_s))
        wrong = valid_and_wrong(answers, change_s, until_s, (change_s,))
        self._wrong.append(wrong.seconds)
        self._worst.append(wrong.worst)
        for name, (low, high) in WINDOWS.items():
            part = after[low : high + 1]
            self._covered[name] += covered[part][answers.valid[part]].tolist()
        before = max(after[0] - _BEFORE, 0)
        self._rest.append((float(error[before]), bool(answers.valid[before]), bool(covered[before])))

    def score(self, name: str) -> GroupScore:
        count = len(self._t10)
        if count == 0:
            nothing = (math.nan,) * len(AFTER)
            empty = dict.fromkeys(WINDOWS, math.nan)
            return GroupScore(
                changes=0,
                error_p95=nothing,
                valid_share=nothing,
                valid_error_p95=nothing,
                t10_s=(math.nan,) * 3,
                coverage=empty,
                wrong_s=math.nan,
                worst=math.nan,
                rest_error=(math.nan, math.nan),
                rest_coverage=math.nan,
            )
        errors, valid, rest = np.array(self._errors), np.array(self._valid), np.array(self._rest)
        moved = name.startswith("jump")
        return GroupScore(
            changes=count,
            error_p95=_tuple(_quantile(errors[:, k], 0.95) for k in range(len(AFTER))),
            valid_share=_tuple(valid.mean(axis=0)),
            valid_error_p95=_tuple(_quantile(errors[valid[:, k], k], 0.95) for k in range(len(AFTER))),
            t10_s=tuple(_quantile(self._t10, q) if moved else math.nan for q in (0.5, 0.9, 0.95)),  # type: ignore[arg-type]
            coverage={key: float(np.mean(one)) if one else math.nan for key, one in self._covered.items()},
            wrong_s=float(np.mean(self._wrong)),
            worst=float(np.max(self._worst)),
            rest_error=(_quantile(rest[:, 0], 0.5), _quantile(rest[:, 0], 0.95)),
            rest_coverage=float(rest[rest[:, 1] > 0.5, 2].mean()) if (rest[:, 1] > 0.5).any() else math.nan,
        )


def _tuple(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _quantile(values: Sequence[float] | Array, q: float) -> float:
    """The smallest value that at least a share q does not exceed: it stays a value where some are infinite."""
    return float(np.quantile(values, q, method="inverted_cdf")) if len(values) else math.nan


def changes_by_name(cycles: FieldCycles) -> dict[str, int]:
    """How many changes of each kind some runs have."""
    keys = np.column_stack([cycles.run, cycles.change_number, cycles.change])
    kinds = np.unique(keys[cycles.change_number >= 0], axis=0)[:, 2]
    return {name: int(np.sum(kinds == code)) for code, name in enumerate(CHANGES)}
