"""Steps for which no limit acts, in words and as a table: the same on the terminal and on a table's page."""

from __future__ import annotations

import math

from vsgdesign.artifacts.step_record import Pair, StepRow, StepStatement

STEP_HEAD = ("SCR", "P [kW]", "Q [kvar]", "P_ref [kW]", "Q_ref [kvar]", "phase [°]", "V_g [V]", "f_g [Hz]", "proof")


def step_sentence(found: StepStatement) -> str:
    """The limits that are meant, and what the numbers of the table are."""
    limits = [f"V stays from {_number(found.V_low_pu)} to {_number(found.V_high_pu)} pu"] if _bounded(found) else []
    if found.current_pu is None:
        first = "The converter has no current limit, so no limit acts after any step."
        asked = f"that {limits[0]}" if limits else ""
    else:
        kind = "soft limit" if found.soft else "limit"
        first = f'No limit of current_limiter = "{found.limiter}" acts'
        limits.insert(0, f"the current stays below its {kind}, {_number(found.current_pu)} pu")
        asked = " and ".join(limits)
        first = f"{first} as long as {asked}."
        asked = "that no limit acts"
    if found.reason is not None:
        return f"{first} No step is certified, because {found.reason}."
    rate = "" if found.decay is None else f" of {_number(found.decay)} 1/s"
    return (
        f"{first} The table has the largest steps, each alone, for which it is certified {asked}, in the linear model "
        f"on a grid of the stated part. P and Q are those after the step. The Lyapunov function of the steps has a "
        f"decay{rate} ({found.proof})."
    )


def step_rows(found: StepStatement) -> list[tuple[str, ...]]:
    """The rows of STEP_HEAD as text."""
    return [_row(row, found) for row in found.rows]


def step_lines(found: StepStatement) -> list[str]:
    """The sentence and the table for a terminal."""
    rows = [STEP_HEAD, *step_rows(found)] if found.rows else []
    widths = [max(len(row[k]) for row in rows if len(row) > k) for k in range(len(STEP_HEAD))] if rows else []
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=False)]
        lines.append("  " + "  ".join(cells).rstrip())
    return [step_sentence(found), *lines]


def _row(row: StepRow, found: StepStatement) -> tuple[str, ...]:
    place = (_range(row.scr), _range(row.P, 1e3), _range(row.Q, 1e3))
    steps = (row.P_ref, row.Q_ref, row.phase, row.V_g, row.omega_g)
    if any(step is None for step in steps):
        return (*place, *("none",) * len(steps), _why_none(row, found))
    scales = (1e3, 1e3, math.pi / 180.0, 1.0, 2.0 * math.pi)
    return (*place, *(_down((step or 0.0) / scale) for step, scale in zip(steps, scales, strict=True)), row.proof)


def _why_none(row: StepRow, found: StepStatement) -> str:
    if row.rest_current_pu is None:
        return "no operating point"
    if found.current_pu is not None and row.rest_current_pu >= found.current_pu:
        return f"current at rest up to {_number(row.rest_current_pu)} pu"
    return "V at rest reaches its limit"


def _bounded(found: StepStatement) -> bool:
    return found.V_low_pu is not None and found.V_high_pu is not None


def _range(pair: Pair, scale: float = 1.0) -> str:
    low, high = (value / scale for value in pair)
    return f"±{_number(high)}" if low == -high and high > 0.0 else f"{_number(low)} to {_number(high)}"


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def _down(value: float) -> str:
    """Three digits, rounded down: what is shown is certified, too."""
    if value <= 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.3g}"
