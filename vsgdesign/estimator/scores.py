"""What the network adds: the recursions alone, with the network behind its gate, and with the network unguarded."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.field_weights import MODES, FieldLayers
from vsgdesign.artifacts.files import plain
from vsgdesign.equations.field import FieldAnswer
from vsgdesign.equations.field.fusion import FIRST_GATE, LONG_AGO, GateLimits, Posterior, fused_answer, next_gate
from vsgdesign.estimator.data_set import CHANGES, FieldCycles
from vsgdesign.metrics.answers import Answers, answers_of, inside_ellipse, time_to_stay, valid_and_wrong

Array = NDArray[np.float64]

WAYS = ("physics", "gated", "ungated")
"""The recursions alone; the network where its gate lets it speak, otherwise the recursions; the network always."""

GROUPS = ("jump", "jump_and_step", "small_jump", "grid_step", "rest")
"""Changes that are judged together. The first two change |Z_g| by a factor of at least LEAST_FACTOR at a current of at
least LEAST_CURRENT, ``small_jump`` is every other change of the impedance, and ``rest`` has no event of the grid."""

GROUP_WORDS = {
    "jump": "Jumps of |Z_g| by a factor of 1.5 or more at 0.1 pu of current or more",
    "jump_and_step": "Such jumps with a step of the grid's voltage, phase or frequency",
    "small_jump": "Smaller jumps, or at less current",
    "grid_step": "Steps of the grid's voltage, phase or frequency alone",
    "rest": "Without an event of the grid",
}
"""The groups of changes in words."""

LEAST_FACTOR, LEAST_CURRENT = 1.5, 0.1

AFTER = (5, 8, 10, 15)
"""Cycles after a change at which the error is stated in tables."""

SEEN = 31
"""Cycles after a change over which it is drawn, with the cycle of the change."""

WINDOWS = {"2 to 8": (2, 8), "10 to 20": (10, 20), "from 20": (20, 10**6)}
"""Cycles after a change over which coverage is stated."""

_BEFORE = 5


@dataclass(frozen=True, kw_only=True)
class GroupScore:
    """One way of answering, over all changes of a group. Errors are |Ẑ − Z|/|Z|; NaN where there is nothing."""

    changes: int
    error_p95: tuple[float, ...]
    """95th percentile of the answer's error, valid or not, 0 to SEEN − 1 cycles after the cycle of the change."""
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


def field_scores(
    cycles: FieldCycles, layers: FieldLayers, radius_squared: Mapping[str, float], gate: GateLimits
) -> dict[str, dict[str, GroupScore]]:
    """The three ways on some runs, by way and group."""
    return {
        way: _judged(cycles, answer) for way, answer in answers_of_ways(cycles, layers, radius_squared, gate).items()
    }


def answers_of_ways(
    cycles: FieldCycles, layers: FieldLayers, radius_squared: Mapping[str, float], gate: GateLimits
) -> dict[str, Array]:
    """The answers of the three ways, each (N, 14) as in :class:`FieldCycles`, by the controller's own equations."""
    always = GateLimits(first=0.0, first_refuted=0.0, last=LONG_AGO, confident=gate.confident)
    silent = cycles.answer.copy()
    silent[:, FieldAnswer._fields.index("valid")] = 0.0
    gated = _spoken(cycles, cycles.answer, layers, radius_squared, gate)
    ungated = _spoken(cycles, silent, layers, radius_squared, always)
    return dict(zip(WAYS, (cycles.answer, gated, ungated), strict=True))


def _spoken(
    cycles: FieldCycles,
    said: Array,
    layers: FieldLayers,
    radius_squared: Mapping[str, float],
    limits: GateLimits,
) -> Array:
    """The answers with the network behind the recursions' answers ``said`` (N, 14)."""
    outputs = np.column_stack(evaluate(layers, cycles.features))
    radii = np.array([radius_squared[name] for name in MODES])[cycles.mode]
    settings = [cycles.settings(k) for k in range(len(cycles.header["converters"]))]
    found, gate, run = np.zeros_like(cycles.answer), FIRST_GATE, None
    for k in range(len(cycles)):
        if cycles.run[k] != run:
            gate, run = FIRST_GATE, cycles.run[k]
        answer = FieldAnswer(*said[k].tolist())
        gate, spoken = fused_answer(
            answer,
            next_gate(gate, answer.event),
            Posterior(*outputs[k].tolist()),
            float(cycles.refuted[k]),
            float(radii[k]),
            limits,
            settings[cycles.converter[k]],
        )
        found[k] = spoken
    return found


def evaluate(layers: FieldLayers, features: Array) -> Posterior:
    """The five outputs, an array (N,) each, for features (N, n)."""
    x = (features - layers.mean) / layers.deviation
    hidden = np.tanh(np.tanh(x @ layers.W_1.T + layers.b_1) @ layers.W_2.T + layers.b_2)
    return Posterior(*(hidden @ layers.W_3.T + layers.b_3).T)


def _judged(cycles: FieldCycles, answer: Array) -> dict[str, GroupScore]:
    rows = {name: _Rows() for name in GROUPS}
    for run in np.unique(cycles.run):
        of_run = np.flatnonzero(cycles.run == run)
        answers = _answers(cycles, answer, of_run)
        covered, error = inside_ellipse(answers), answers.error
        numbers = cycles.change_number[of_run]
        for number in range(numbers.max() + 1):
            after = np.flatnonzero(numbers == number)
            if len(after):
                first = int(of_run[after[0]])
                rows[_group(cycles, first)].add(answers, error, covered, after, float(cycles.since_change[first]))
    return {name: one.score(name) for name, one in rows.items()}


def _group(cycles: FieldCycles, row: int) -> str:
    """The group of the change before a cycle."""
    name = CHANGES[cycles.change[row]]
    if name.startswith("jump"):
        large = cycles.factor[row] >= LEAST_FACTOR and cycles.current[row] >= LEAST_CURRENT
        return name if large else "small_jump"
    return name if name == "grid_step" else "rest"


def _answers(cycles: FieldCycles, answer: Array, rows: NDArray[np.int64]) -> Answers:
    """One run's answers."""
    said = FieldAnswer(*answer[rows].T)
    return answers_of(
        cycles.t_s[rows],
        (cycles.truth[rows, 0], cycles.truth[rows, 1]),
        (said.R_g, said.L_g),
        (said.var_R, said.cov_RL, said.var_L),
        said.valid > 0.5,
        said.changed > 0.5,
        omega_n=cycles.settings(int(cycles.converter[rows[0]])).omega_n,
        end_s=float(cycles.t_s[rows[-1]]),
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
        at = np.minimum(after[0] + np.arange(SEEN), after[-1])
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
            nothing = (math.nan,) * SEEN
            empty = dict.fromkeys(WINDOWS, math.nan)
            return GroupScore(
                changes=0,
                error_p95=nothing,
                valid_share=nothing,
                valid_error_p95=nothing,
                t10_s=(math.nan, math.nan, math.nan),
                coverage=empty,
                wrong_s=math.nan,
                worst=math.nan,
                rest_error=(math.nan, math.nan),
                rest_coverage=math.nan,
            )
        errors, valid, rest = np.array(self._errors), np.array(self._valid), np.array(self._rest)
        moved = "jump" in name
        return GroupScore(
            changes=count,
            error_p95=_tuple(_quantile(errors[:, k], 0.95) for k in range(SEEN)),
            valid_share=_tuple(valid.mean(axis=0)),
            valid_error_p95=_tuple(_quantile(errors[valid[:, k], k], 0.95) for k in range(SEEN)),
            t10_s=(
                _quantile(self._t10, 0.5) if moved else math.nan,
                _quantile(self._t10, 0.9) if moved else math.nan,
                _quantile(self._t10, 0.95) if moved else math.nan,
            ),
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


def scores_document(scores: dict[str, dict[str, GroupScore]]) -> dict[str, Any]:
    """The scores in JSON's types; what is no number, or is not reached, is None."""
    return plain({way: {group: asdict(scores[way][group]) for group in GROUPS} for way in WAYS})


def short_document(scores: dict[str, dict[str, GroupScore]]) -> dict[str, Any]:
    """The scores for the weights' file: of the series only the cycles of AFTER."""
    document = scores_document(scores)
    for groups in document.values():
        for one in groups.values():
            for name in ("error_p95", "valid_share", "valid_error_p95"):
                one[name] = {str(k): one[name][k] for k in AFTER}
    return document


def verdict(scores: dict[str, dict[str, GroupScore]]) -> list[str]:
    """Sentences: what the network behind its gate does better or worse than the recursions alone."""
    sentences = []
    for group, words in GROUP_WORDS.items():
        alone, gated = scores["physics"][group], scores["gated"][group]
        if alone.changes == 0:
            continue
        found = [
            f"{AFTER[0]} cycles after it {_percent(gated.valid_share[AFTER[0]])} of the answers are valid instead of "
            f"{_percent(alone.valid_share[AFTER[0]])}, with a 95th percentile of their error of "
            f"{_percent(gated.valid_error_p95[AFTER[0]])} instead of {_percent(alone.valid_error_p95[AFTER[0]])}"
        ]
        if "jump" in group:
            found.append(
                f"the 95th percentile of the time to stay within 10 % is {_milliseconds(gated.t10_s[2])} instead of "
                f"{_milliseconds(alone.t10_s[2])}"
            )
        found.append(
            f"a valid answer is wrong by more than 20 % for {_milliseconds(gated.wrong_s)} per change instead of "
            f"{_milliseconds(alone.wrong_s)}"
        )
        sentences.append(f"{words} ({alone.changes}): {'; '.join(found)}.")
    return sentences


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %" if math.isfinite(share) else "–"


def _milliseconds(seconds: float) -> str:
    if math.isnan(seconds):
        return "–"
    return f"{1e3 * seconds:.3g} ms" if math.isfinite(seconds) else "never within the run"
