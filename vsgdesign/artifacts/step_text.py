"""Steps for which no limit acts, in words and as a table: the same on the terminal and on a table's page."""

from __future__ import annotations

import math

from vsgdesign.artifacts.step_record import Pair, StepRow, StepStatement

STEP_HEAD = ("SCR", "P [kW]", "Q [kvar]", "P_ref [kW]", "Q_ref [kvar]", "phase [°]", "V_g [V]", "f_g [Hz]", "proof")


def step_sentence(found: StepStatement) -> str:
    """The limits that are meant, and what the numbers of the table are."""
    V = f"{_number(found.V_low_pu)} and {_number(found.V_high_pu)} pu"
    if found.current_pu is None:
        first = "The converter has no current limit, so no limit acts after any step."
        asked = f"V stays between {V}"
    else:
        kind = "soft limit" if found.soft else "limit"
        first = f'The current limiter "{found.limiter}" begins to act at {_number(found.current_pu)} pu, its {kind}'
        first += f", and it clips V at {V}." if found.clips_V else "."
        asked = "no limit acts"
    if found.reason is not None:
        return f"{first} No step is certified, because {found.reason}."
    decay = "" if found.decay is None else f" decays at {_number(found.decay)} 1/s or faster ({found.proof})"
    points = any(row.possible and row.proof != "gap-free" for row in found.rows)
    grade = ' A "gridded" row is verified at points, with a margin of 20 %, and not between them.' if points else ""
    return (
        f"{first} In the linear model, it is certified that {asked} after a step of the sizes in the table, each "
        f"alone, on a grid and to P and Q of the row. Their Lyapunov function{decay}.{grade}"
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


def _range(pair: Pair, scale: float = 1.0) -> str:
    low, high = (value / scale for value in pair)
    if low == high:
        return _number(low)
    return f"±{_number(high)}" if low == -high else f"{_number(low)} to {_number(high)}"


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def _down(value: float) -> str:
    """Three digits, rounded down: what is shown is certified, too."""
    if value <= 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.floor(value / unit * (1.0 + 1e-12)) * unit:.3g}"
