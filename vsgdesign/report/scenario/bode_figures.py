"""Bode plots of the open P loop on every grid of the scenario, for each controller's gains there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.linear.operating_point import solve_operating_point
from vsgdesign.linear.stability.loops import LoopMargins, coupled_loop, loop_margins, power_loops
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import plain_quantity
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, line_style, look, new_figure
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.report.page.converter import grid_label
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.feeds import as_told
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult
from vsgdesign.study.parameters import Grid

_MOST_GRIDS = 6
_LEFT, _RIGHT, _BOTTOM, _BETWEEN = 0.55, 0.13, 0.36, 0.62
_MAGNITUDE_HEIGHT, _PHASE_HEIGHT, _GAP = 1.35, 1.15, 0.1
_LEGEND_ROW = 0.145


def bode_figures(result: ScenarioResult) -> Iterator[NamedFigure]:
    """Open P loops, two controllers side by side in a figure, fixed gains before scheduled ones."""
    columns = []
    for kind in ("fixed", "scheduled"):
        for controller in result.controllers:
            # With an estimate the loop is that with the truth, as far as the estimate is right.
            if controller.spec.kind == kind and controller.estimates is None:
                loops = loops_on_grids(result, controller)
                if loops:
                    columns.append((controller.spec.name, kind, loops))
    for first in range(0, len(columns), 2):
        name = "bode_P" if len(columns) <= 2 else f"bode_P_{first // 2 + 1}"
        yield _bode_figure(name, columns[first : first + 2])


def shown_grids(loops: Sequence[LoopOnGrid]) -> list[LoopOnGrid]:
    """At most six loops, from the weakest to the strongest grid; those left out lie between the shown ones."""
    ordered = sorted(loops, key=lambda loop: loop.Z_ohm, reverse=True)
    if len(ordered) <= _MOST_GRIDS:
        return ordered
    return [ordered[round(index)] for index in np.linspace(0, len(ordered) - 1, _MOST_GRIDS)]


@look()
def _bode_figure(name: str, columns: Sequence[tuple[str, str, Sequence[LoopOnGrid]]]) -> NamedFigure:
    shown = [shown_grids(loops) for _, _, loops in columns]
    rows = max(len(loops) for loops in shown)
    below = _BOTTOM + rows * _LEGEND_ROW + 0.12
    height = below + _PHASE_HEIGHT + _GAP + _MAGNITUDE_HEIGHT + 0.25
    width = (PAGE_IN - _LEFT - _RIGHT - _BETWEEN) / 2.0
    figure_width = PAGE_IN if len(columns) == 2 else _LEFT + width + _RIGHT
    figure = new_figure(figure_width, height)
    omega = _frequencies([loop for loops in shown for loop in loops])
    targets: dict[str, list[str]] = {}
    axes_of_magnitude = []
    for index, ((controller, kind, _), loops) in enumerate(zip(columns, shown, strict=True)):
        left = _LEFT + index * (width + _BETWEEN)
        magnitude = add_axes(figure, left, below + _PHASE_HEIGHT + _GAP, width, _MAGNITUDE_HEIGHT)
        phase = add_axes(figure, left, below, width, _PHASE_HEIGHT, sharex=magnitude)
        _draw(magnitude, phase, omega, loops)
        gains = "fixed gains" if kind == "fixed" else "gains scheduled for each grid"
        magnitude.set_title(symbols(f"{controller}, {gains}"))
        phase.set_xlabel("Angular frequency [rad/s]")
        magnitude.set_ylabel("Magnitude [dB]")
        phase.set_ylabel("Phase [°]")
        figure.legend(
            handles=magnitude.get_lines()[: len(loops)],
            labels=[_legend(loop) for loop in loops],
            loc="upper left",
            bbox_to_anchor=(left / figure_width, (below - _BOTTOM - 0.06) / height),
        )
        axes_of_magnitude.append(magnitude)
        at = f"{plain_quantity(loops[0].P, 'W')} and {plain_quantity(loops[0].Q, 'var')}"
        targets.setdefault(at, []).append(controller)
    # One scale for both, so that the loops can be compared.
    lows, highs = zip(*(axes.get_ylim() for axes in axes_of_magnitude), strict=True)
    for axes in axes_of_magnitude:
        axes.set_ylim(min(lows), max(highs))
    at = "; ".join(at if len(targets) == 1 else f"{at} for {', '.join(names)}" for at, names in targets.items())
    left_out = max(len(loops) for _, _, loops in columns) - rows
    more = f" {left_out} grids between them are in the table of margins only." if left_out > 0 else ""
    if any(len(loop.gains.named()) > 4 for _, _, loops in columns for loop in loops):
        more += " Structures that act on both powers: their P loop with the Q loop closed, coupling included."
    caption = (
        "Open active-power loop K_ip·A/(s(s + K_ip·D_p)) without coupling, A = ∂P/∂δ taken at the operating point of "
        f"the design ({at}) on each grid. Dots: gain crossover; the phase margin is the distance of the "
        f"dot from −180°. If curves coincide, the thinner one is drawn on top.{more}"
    )
    return NamedFigure(name, "Open active-power loop", caption, figure)


def _frequencies(loops: Sequence[LoopOnGrid]) -> Any:
    """A decade beyond every crossover and corner."""
    marks = [mark for loop in loops for mark in (loop.margins.crossover_rad_s, loop.corner_rad_s) if mark]
    return np.geomspace(0.1 * min(marks, default=1.0), 10.0 * max(marks, default=1.0), 120)


def _draw(magnitude: Any, phase: Any, omega: Any, loops: Sequence[LoopOnGrid]) -> None:
    for index, loop in enumerate(loops):
        response = loop.response(omega)
        # Broad below, narrow above: scheduled gains give the same loop on every grid, one line upon the other.
        style = {**line_style(index), "linewidth": 2.1 - 1.2 * index / max(len(loops) - 1, 1)}
        size = np.where(response == 0.0, np.nan, np.abs(response))  # gains that close no loop have no curve
        magnitude.semilogx(omega, 20.0 * np.log10(size), zorder=3 + 0.01 * index, **style)
        phase.semilogx(omega, np.rad2deg(np.unwrap(np.angle(response))), zorder=3 + 0.01 * index, **style)
    for index, loop in enumerate(loops):
        crossover, margin = loop.margins.crossover_rad_s, loop.margins.phase_margin_deg
        if crossover is None or margin is None:
            continue
        dot = {
            "marker": "o",
            "markersize": 3.6,
            "markerfacecolor": "white",
            "markeredgewidth": 0.9,
            "zorder": 4,
            "color": line_style(index)["color"],
            "linestyle": "",
        }
        stem = {"color": line_style(index)["color"], "linewidth": 0.7, "linestyle": (0, (1, 1)), "zorder": 2.5}
        magnitude.plot([crossover], [0.0], **dot)
        phase.plot([crossover, crossover], [-180.0, margin - 180.0], **stem)
        phase.plot([crossover], [margin - 180.0], **dot)
    magnitude.axhline(0.0, color="#555555", linewidth=0.6, zorder=2)
    phase.axhline(-180.0, color="#555555", linewidth=0.6, zorder=2)
    magnitude.set_xlim(omega[0], omega[-1])
    magnitude.tick_params(labelbottom=False)
    phase.set_ylim(-190.0, -80.0)
    phase.set_yticks([-180, -150, -120, -90])


def _legend(loop: LoopOnGrid) -> str:
    crossover, margin = loop.margins.crossover_rad_s, loop.margins.phase_margin_deg
    if crossover is None or margin is None:
        return f"{loop.label}: no crossover"
    return f"{loop.label}: $\\omega_c$ = {crossover:.3g} rad/s, $\\varphi_m$ = {margin:.1f}°"


@dataclass(frozen=True, kw_only=True)
class LoopOnGrid:
    """The open P loop of one controller on one grid, at the operating point of the controller's design."""

    label: str
    Z_ohm: float
    P: float
    Q: float
    gains: PowerLoopGains
    numerator: NDArray[np.float64]
    denominator: NDArray[np.float64]
    margins: LoopMargins

    @property
    def corner_rad_s(self) -> float:
        """The loop's fastest corner; K_ip·D_p for the published structure. 0 without any."""
        return float(np.abs(np.roots(self.denominator)).max(initial=0.0))

    def response(self, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Frequency response at angular frequencies in rad/s."""
        s = 1j * omega
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)


def distinct_grids(result: ScenarioResult) -> tuple[Grid, ...]:
    """Every grid of the scenario once, in order of appearance."""
    return tuple(dict.fromkeys(grid for _, grid in result.timeline.grids))


def loops_on_grids(result: ScenarioResult, controller: ControllerResult) -> tuple[LoopOnGrid, ...]:
    """The loops on all grids that can carry the power of the controller's design."""
    study, target = result.study, controller.spec.target
    law = as_told(gain_law(study, controller.spec, result.ready), controller.spec)
    loops = []
    for grid in distinct_grids(result):
        R, X = study.path_to_grid(grid)
        try:
            point = solve_operating_point(target.P, target.Q, study.grid_source.V_g_rms, R, X)
        except NoOperatingPointError:
            continue
        at_point = law(grid.R_g, grid.L_g, target.P, target.Q, point.V_rms)
        gains = PowerLoopGains(*(float(value) for value in at_point))
        if not np.isfinite(gains).all():
            continue
        # Beyond A = 0 the loop has positive feedback: it has no margin to speak of.
        if point.A <= 0.0:
            continue
        if STRUCTURES[target.structure].uncoupled:
            open_loop = power_loops(gains, point.A, point.D).P_open
        else:
            transient = study.power_lags._replace(tau_P=0.0, tau_Q=0.0)
            open_loop = coupled_loop(point, gains, study.grid_source.V_g_rms, (R, X), transient, loop=0)
        numerator, denominator = (np.trim_zeros(np.ravel(part[0][0]), "f") for part in (open_loop.num, open_loop.den))
        loops.append(
            LoopOnGrid(
                label=grid_label(result, grid),
                Z_ohm=float(np.hypot(R, X)),
                P=target.P,
                Q=target.Q,
                gains=gains,
                numerator=numerator,
                denominator=denominator,
                margins=loop_margins(open_loop),
            )
        )
    return tuple(loops)
