"""One case in numbers and words: where it begins and ends, what happens, and why it is bad, where that is known."""

from __future__ import annotations

import math

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.verification.counting import last_grids
from vsgdesign.verification.promises import FIGURES

_EDGE = 0.02
"""A case is at the edge of what is drawn where a coordinate is this near to 0 or 1."""

_NOTICED_S = 1e-3
"""A limiter that acted for less is not named."""

_SLOW = 0.7
"""A slowest mode is named where it alone takes this share of the limit."""

_LOST = {
    "diverged": "The run diverges.",
    "slipped": "The angle slips by a turn.",
    "latched": "The controller stays in its current limit.",
    "not at rest": "It is not at rest in time.",
}
"""What became of a case that was not survived, by its status."""

SETTLED = math.log(1.0 / 0.02)
"""Time constants until an exponential is within 2 %."""


def start_of(study: Study, cases: LaneCases, k: int, powers: tuple[float, float] | None = None) -> dict[str, float]:
    """Where case ``k`` begins, per unit. ``powers``: P and Q at rest, W and var; without them the references."""
    c = study.converter
    P, Q = powers or (float(cases.P_ref[k]), float(cases.Q_ref[k]))
    basis = _basis(study)
    place = Grid(float(cases.R_g[k]), float(cases.L_g[k])).place(c, basis)
    return {
        "scr": place.scr,
        "x_over_r": place.x_over_r,
        "P_pu": P / c.S_rated,
        "Q_pu": Q / c.S_rated,
        "V_g_pu": float(cases.V_g_rms[k]) / c.V_rated_rms,
        "f_hz": float(cases.omega_g[k]) / (2.0 * math.pi),
        "error_R": float(cases.error_R[k]),
        "error_X": float(cases.error_X[k]),
    }


def end_of(study: Study, cases: LaneCases, k: int) -> dict[str, float]:
    """The grid on which case ``k`` comes to rest."""
    R_g, L_g = last_grids(cases.take(np.array([k])))
    place = Grid(float(R_g[0]), float(L_g[0])).place(study.converter, _basis(study))
    return {"scr": place.scr, "x_over_r": place.x_over_r}


def _basis(study: Study) -> str:
    if study.verification is not None:
        return study.verification.scr_basis
    return study.scr_basis


def what_of(study: Study, cases: LaneCases, k: int) -> str:
    """What happens in case ``k``, in words."""
    c, parts = study.converter, []
    place = Grid(float(cases.R_g[k]), float(cases.L_g[k])).place(c, _basis(study))
    references = {"P_ref": float(cases.P_ref[k]), "Q_ref": float(cases.Q_ref[k])}
    for event in cases.events.events(k):
        changes, values = [], {kind: kind.value(event) for kind in event.changed}
        for kind, value in values.items():
            if kind.quantity in references and value is not None:
                changes.append(f"{kind.name} changes by {(value - references[kind.quantity]) / c.S_rated:+.3g} pu")
                references[kind.quantity] = value
        if event.grid is not None:
            old, place = place, event.grid.place(c, _basis(study))
            changes.append(f"SCR changes from {old.scr:.3g} to {place.scr:.3g} (X/R {place.x_over_r:.3g})")
        if event.V_g_rms is not None:
            changes.append(f"the voltage goes to {event.V_g_rms / c.V_rated_rms:.3g} pu")
        if event.omega_g is not None:
            over = f" in {event.over:.3g} s" if event.over > 0.0 else ""
            changes.append(f"the frequency goes to {event.omega_g / (2.0 * math.pi):.5g} Hz{over}")
        if event.phase_jump != 0.0:
            changes.append(f"the phase jumps by {math.degrees(event.phase_jump):+.3g}°")
        others = (kind for kind in values if kind.of_controller and kind.quantity not in references)
        changes += [f"{kind.words(value, c)} is set" for kind in others if (value := values[kind]) is not None]
        parts.append(f"at {event.t_s:.4g} s {_listed(changes)}")
    said = "; ".join(parts)
    if cases.silent_s[k] > 0.0:
        said += f"; the schedule is told {cases.silent_s[k]:.3g} s later"
    return said[:1].upper() + said[1:]


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def why_of(
    figures: tuple[float, ...],
    promise: str,
    coordinates: dict[str, float],
    *,
    status: str = "",
    limited: bool = True,
    relaxed: bool = False,
    decay: float = math.nan,
    limit: float = math.nan,
) -> str | None:
    """Why a case is bad, in a sentence for each reason that is known; None where none is.

    ``status``: of the case, where it was not survived; ``limited``: whether the controller limits its current.
    ``coordinates``: those of the case that are drawn, 0 to 1, by name. ``relaxed``: whether the gain table gives up a
    requirement there (:func:`beside_relaxed`). ``decay``: rate of the slowest mode of the linear full-order model at
    the last rest, 1/s. ``limit``: that of the promise.
    """
    by_name = dict(zip(FIGURES, figures, strict=True))
    said = []
    if status in _LOST:
        said.append(_LOST[status])
        if not limited:
            said.append(f"The controller has no current limit, and the current reaches {by_name['peak_pu']:.3g} pu.")
    if relaxed:
        said.append("A node of the table beside the estimated grid is relaxed: it gives up a requirement.")
    if by_name["limited_s"] > _NOTICED_S:
        said.append(f"The current limiter acts for {_duration(by_name['limited_s'])}.")
    if promise == "settling" and decay <= 0.0:
        said.append("The linear model is unstable at the new rest.")
    elif promise == "settling" and SETTLED / decay > _SLOW * limit:
        mode = f"The slowest mode of the linear model decays with {decay:.3g} 1/s"
        said.append(f"{mode}, for which 2 % take {SETTLED / decay:.3g} s.")
    edges = [name for name, u in coordinates.items() if min(u, 1.0 - u) < _EDGE]
    if edges:
        said.append(f"It lies at the edge of what is drawn in {_listed(edges)}.")
    return " ".join(said) or None


def _duration(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


def beside_relaxed(table: GainTable | None, study: Study, R_g: float, L_g: float) -> bool:
    """Whether a gain table gives up a requirement at one of the nodes around a grid (Ω, H)."""
    if table is None:
        return False
    place = Grid(R_g, L_g).place(study.converter, table.base.scr_basis)
    rows, columns = _around(table.scr, place.scr), _around(table.x_over_r, place.x_over_r)
    return bool((table.status[np.ix_(rows, columns)] == "relaxed").any())


def _around(nodes: np.ndarray, value: float) -> list[int]:
    k = int(np.clip(np.searchsorted(nodes, value), 1, len(nodes) - 1))
    return [k - 1, k]
