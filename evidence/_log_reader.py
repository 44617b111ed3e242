"""Figures and rests of a run from the log of every sample: NumPy and docs/definitions.md, nothing of the package.

``document`` is results.json of a run whose log has every sample, ``series`` the arrays of a controller's file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

BAND = 0.02
"""Half the width of the band of a settling time, over the step or the rating."""
SMALLEST_STEP = 1e-3
"""A change of less than this share of the rating is no step."""

Series = Mapping[str, np.ndarray]


class Converter(NamedTuple):
    """What is known of the converter, SI."""

    S_rated: float
    V_rated_rms: float
    omega_n: float
    T_s: float
    R_2: float
    L_2: float


class Difference(NamedTuple):
    """A figure that is not what the log says."""

    where: str
    said: Any
    read: Any


def trailing_mean(y: np.ndarray, count: int) -> np.ndarray:
    """Mean over ``count`` samples up to each one, or over as many as there are."""
    total = np.concatenate([[0.0], np.cumsum(y)])
    first = np.maximum(np.arange(1, len(y) + 1) - count, 0)
    return (total[1:] - total[first]) / (np.arange(1, len(y) + 1) - first)


def differences(document: Mapping[str, Any], series: Series, c: Converter, name: str, pwm: bool) -> list[Difference]:
    """Every figure and rest of a controller that differs from what its log says."""
    told = document["controllers"][name]
    ends = [*sorted({row["t_s"] for row in document["operating_points"] if row["controller"] == name})[1:], np.inf]
    found = []
    for event in told["events"]:
        if event["status"] not in ("measured", "not settled"):
            continue
        end_s = min(t_s for t_s in ends if t_s > event["t_s"] + 1e-12)
        found += _figures(event, series, c, pwm, end_s)
    return found + (list(_rests(document, series, c, name)) if not pwm else []) + list(_outcome(told, series, c))


def _figures(event: Mapping[str, Any], series: Series, c: Converter, pwm: bool, end_s: float) -> Iterator[Difference]:
    t, y = series["t_s"], series[event["signal"]]
    rows = np.flatnonzero((t > event["t_s"] - 0.5 * c.T_s) & (t < end_s - 0.5 * c.T_s))
    begin, stop = rows[0], rows[-1] + 1
    cycle = round(2.0 * np.pi / c.omega_n / c.T_s)
    since, where = t[begin:stop] - event["t_s"], f"{event['name']}, {event['signal']}"
    initial = float(np.mean(y[max(begin - cycle, 0) : begin]))
    yield from _apart(f"{where}: initial", event["initial"], initial, 1e-9 * c.S_rated)
    final = event["final"]
    if pwm:  # the mean of whole cycles in the last tenth
        whole = 2.0 * np.pi / (float(series["omega"][stop - 1]) * c.T_s)
        count = max(int((stop - begin) / 10 / whole), 1) * round(whole)
        yield from _apart(f"{where}: final", final, float(np.mean(y[stop - count : stop])), 2e-3 * c.S_rated)
    elif event["status"] == "measured":  # the computed rest: the last cycle is as near as its band and its decay
        scale = abs(final - initial) if event["kind"] == "step" else c.S_rated
        yield from _apart(f"{where}: final", final, float(np.mean(y[stop - cycle : stop])), BAND * scale)
    i = np.stack([series[f"i_pcc_{phase}"][begin:stop] for phase in "abc"])
    peak = np.sqrt(2.0 / 3.0 * (i**2).sum(axis=0)).max() / (np.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms))
    yield from _apart(f"{where}: peak current", event["peak_current_pu"], float(peak), 1e-9)
    mean = trailing_mean(y[max(begin - cycle, 0) : stop], cycle)[-(stop - begin) :]
    kinds = (("mean", event, mean), ("instantaneous", event["instantaneous"], y[begin:stop]))
    for words, figures, signal in kinds:
        yield from _response(f"{where}, {words}", event, figures, since, signal, initial, final, c)


def _response(
    where: str,
    event: Mapping[str, Any],
    figures: Mapping[str, Any],
    since: np.ndarray,
    y: np.ndarray,
    initial: float,
    final: float,
    c: Converter,
) -> Iterator[Difference]:
    step = final - initial
    reference = abs(step) if event["kind"] == "step" else c.S_rated
    error = np.abs(y - final)
    yield from _apart(f"{where}: peak deviation", figures["peak_deviation"], float(error.max()), 1e-9 * c.S_rated)
    if event["kind"] == "step":
        beyond = max(float(((y - final) * np.sign(step)).max()), 0.0) / abs(step) * 100.0
        yield from _apart(f"{where}: overshoot", figures["overshoot_pct"], beyond, 1e-6)
    outside = np.flatnonzero(error > BAND * reference)
    settles = figures["settling_time_s"]
    if event["status"] == "not settled":
        if settles is not None:
            yield Difference(f"{where}: settling time of what is not settled", settles, None)
    elif len(outside) == 0:
        yield from _apart(f"{where}: settling time", settles, 0.0, 1e-12)
    elif outside[-1] == len(y) - 1:
        if settles is not None:
            yield Difference(f"{where}: settling time", settles, None)
    else:  # between the last sample outside and the next
        k = outside[-1]
        if settles is None or not since[k] - 1e-9 <= settles <= since[k + 1] + 1e-9:
            yield Difference(f"{where}: settling time", settles, float(since[k + 1]))


def _rests(document: Mapping[str, Any], series: Series, c: Converter, name: str) -> Iterator[Difference]:
    """With an averaged bridge: each rest is on its grid, its droops hold, and a log that is at rest is at this one."""
    rows = [row for row in document["operating_points"] if row["controller"] == name]
    starts = [row["t_s"] for row in rows]
    for row, end_s in zip(rows, [*starts[1:], np.inf], strict=True):
        if row["P"] is None:
            continue
        where = f"rest from {row['t_s']:g} s"
        end = int(np.searchsorted(series["t_s"], end_s - 0.5 * c.T_s)) - 1
        begin = int(np.searchsorted(series["t_s"], row["t_s"] - 0.5 * c.T_s))
        for field in ("R_g", "L_g"):
            yield from _apart(f"{where}: {field}", row[field], float(series[field][end]), 1e-12)
        # The source behind the path, as long and as far behind as the power flow of P and Q at V asks for.
        Z = complex(row["R_g"] + c.R_2, c.omega_n * (row["L_g"] + c.L_2))
        v_g = row["V_rms"] - Z * complex(row["P"], -row["Q"]) / (3.0 * row["V_rms"])
        yield from _apart(f"{where}: delta", row["delta"], -float(np.angle(v_g)), 5e-3)
        # At the end of a part whose last two cycles are alike to 10⁻⁴ of the rating.
        cycle = round(2.0 * np.pi / c.omega_n / c.T_s)
        if end - 2 * cycle < begin:
            continue
        means = [
            [float(series[key][end - n * cycle : end - (n - 1) * cycle].mean()) for n in (1, 2)] for key in _POWERS
        ]
        still = all(abs(one - other) < 1e-4 * c.S_rated for one, other in means)
        if still and np.ptp(series["omega"][end - cycle : end]) < 1e-5 * c.omega_n:
            P, Q, V = (float(series[key][end - cycle : end].mean()) for key in (*_POWERS, "V_rms"))
            i_2 = (P * P + Q * Q) / (3.0 * V * V)  # what R_2 and L_2 take between the capacitor and the PCC
            yield from _apart(f"{where}: P", row["P"], P + c.R_2 * i_2, 5e-3 * c.S_rated)
            yield from _apart(f"{where}: Q", row["Q"], Q + c.omega_n * c.L_2 * i_2, 5e-3 * c.S_rated)
            yield from _apart(f"{where}: V", row["V_rms"], V, 2e-3 * c.V_rated_rms)


_POWERS = ("P_pcc", "Q_pcc")


def _outcome(told: Mapping[str, Any], series: Series, c: Converter) -> Iterator[Difference]:
    """What became of a run in the end: its log ends early only where it diverged, and settled is at rest."""
    status, last = told["outcome"]["status"], told["events"][-2:]
    numbers = all(np.isfinite(series[key]).all() for key in ("P_pcc", "Q_pcc", "V_rms", "omega"))
    if not numbers:
        yield Difference("numbers", status, "a row is no number")
    survival = told.get("survival")
    if survival is not None and survival["status"] == "survived" and np.ptp(np.unwrap(series["delta"])) > 2.0 * np.pi:
        yield Difference("survived", "survived", "it slipped by a turn")
    if status == "settled":
        for event in last:
            y = series[event["signal"]][-round(2.0 * np.pi / c.omega_n / c.T_s) :]
            yield from _apart(f"settled: {event['signal']}", event["final"], float(y.mean()), BAND * c.S_rated)


def _apart(where: str, said: float | None, read: float, tolerance: float) -> Iterator[Difference]:
    if said is None or not abs(said - read) <= tolerance:
        yield Difference(where, said, read)
