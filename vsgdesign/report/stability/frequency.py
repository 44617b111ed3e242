"""Detailed cells over frequency: network-frequency perturbation, Nichols, admittance, passivity, Nyquist."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.stability.assessment import ControllerAssessment, FocusCell
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import decades
from vsgdesign.report.drawing.panels import groups
from vsgdesign.report.drawing.quantities import plain, prefix_for
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, line_style, look, new_figure, text_width
from vsgdesign.report.drawing.ticks import Labels, power_of_ten
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.simulation.stability_result import StabilityResult

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

PART = 6
MOST_CELLS = 8
_LEFT, _RIGHT, _BOTTOM, _BETWEEN, _GAP = 0.58, 0.13, 0.36, 0.62, 0.1
_LEGEND_ROW = 0.145
_ONE = {"marker": "+", "markersize": 7.0, "markeredgewidth": 1.2, "color": "#000000", "linestyle": "", "zorder": 5}

Column = tuple[int, ControllerAssessment, Sequence[FocusCell]]


def frequency_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    """All plots over frequency, two controllers side by side; nothing if no grid could be analysed in detail."""
    omega_n = result.study.converter.omega_n
    columns: list[Column] = [(k, a, shown_cells(a.focus, omega_n)) for k, a in enumerate(result.assessments) if a.focus]
    columns.sort(key=lambda item: item[1].spec.kind != "fixed")
    parts = groups(columns, 2)
    makers: tuple[tuple[str, Callable[..., NamedFigure]], ...] = (
        ("nfp", _nfp_figure),
        ("nichols", _nichols_figure),
        ("passivity", _passivity_figure),
        ("nyquist", _nyquist_figure),
    )
    for base, maker in makers:
        for k, part in enumerate(parts):
            with look():
                figure = maker(result, part, base if len(parts) == 1 else f"{base}_{k + 1}")
            yield figure
    for column in columns:
        with look():
            figure = _admittance_figure(result, column)
        yield figure


def shown_cells(cells: Sequence[FocusCell], omega_n: float) -> list[FocusCell]:
    """At most eight, spread over the strengths of the grid at omega_n (rad/s) where there are more."""
    if len(cells) <= MOST_CELLS:
        return list(cells)
    order = sorted(range(len(cells)), key=lambda k: abs(complex(cells[k].grid.R_g, omega_n * cells[k].grid.L_g)))
    picked = {order[round(float(k))] for k in np.linspace(0, len(order) - 1, MOST_CELLS)}
    return [cells[k] for k in sorted(picked)]


class _Layout:
    """Columns of controllers, rows of panels, a legend of cells below."""

    def __init__(
        self, part: Sequence[Column], heights: Sequence[float], gaps: Sequence[float], top: float = 0.25
    ) -> None:
        self.width = (PAGE_IN - _LEFT - _RIGHT - _BETWEEN) / 2.0
        self.total = PAGE_IN if len(part) == 2 else _LEFT + self.width + 2.0 * _RIGHT
        labels = [cell.label for cell in max((cells for _, _, cells in part), key=len)]
        per_row = max(int(self.total / (max(text_width(label) for label in labels) + 0.6)), 1)
        self.per_row = min(per_row, len(labels))
        rows = -(-len(labels) // per_row)
        self.below = _BOTTOM + rows * _LEGEND_ROW + 0.12
        self.height = self.below + sum(heights) + sum(gaps) + top
        self.figure = new_figure(self.total, self.height)
        self.heights, self.gaps = heights, gaps

    def axes(self, column: int, row: int, **kwargs: Any) -> Any:
        lower = sum(self.heights[row + 1 :]) + sum(self.gaps[row:])
        left = _LEFT + column * (self.width + _BETWEEN)
        return add_axes(self.figure, left, self.below + lower, self.width, self.heights[row], **kwargs)

    def legend(self, part: Sequence[Column]) -> None:
        """One entry a cell; the controllers see the same grids."""
        from matplotlib.lines import Line2D

        labels = list(dict.fromkeys(cell.label for _, _, cells in part for cell in cells))
        styles = _styles(part)
        handles = [Line2D([], [], **styles[label]) for label in labels]
        self.figure.legend(
            handles,
            labels,
            ncols=self.per_row,
            loc="lower left",
            bbox_to_anchor=(_LEFT / self.total, 0.04 / self.height),
        )


def _styles(part: Sequence[Column]) -> dict[str, dict[str, Any]]:
    labels = dict.fromkeys(cell.label for _, _, cells in part for cell in cells)
    return {label: line_style(k) for k, label in enumerate(labels)}


def _hertz(cell: FocusCell) -> Array:
    return cell.view.omega / (2.0 * np.pi)


def _title(a: ControllerAssessment) -> str:
    return symbols(f"{a.spec.name} ({a.spec.kind})")


def where(result: StabilityResult) -> str:
    """The operating point of the detailed cells."""
    s = result.study.stability
    return f"Full order, at P = {plain(s.P[0] / 1e3)} kW and Q = {plain(s.Q[0] / 1e3)} kvar."


def _frequency_axis(axes: Any, part: Sequence[Column], last: bool) -> None:
    omega = [c.view.omega for _, _, cells in part for c in cells]
    axes.set_xscale("log")
    axes.set_xlim(min(w[0] for w in omega) / (2.0 * np.pi), max(w[-1] for w in omega) / (2.0 * np.pi))
    decades(axes.xaxis)
    if last:
        axes.set_xlabel("Frequency [Hz]")
    else:
        axes.tick_params(axis="x", which="both", labelbottom=False)


def _phase(axes: Any, f: Array, values: Complex, style: dict[str, Any]) -> None:
    """Phase within ±180°, broken where it wraps."""
    axes.plot(f, _broken(np.degrees(np.angle(values)), 180.0), **style)


def _broken(degrees: Array, jump: float) -> Array:
    found = degrees.copy()
    found[1:][np.abs(np.diff(degrees)) > jump] = np.nan
    return found


def _degree_axis(axes: Any) -> None:
    axes.set_ylim(-190.0, 190.0)
    axes.set_yticks([-180, -90, 0, 90, 180])
    axes.set_ylabel("Phase [°]")


def _nfp_figure(result: StabilityResult, part: Sequence[Column], name: str) -> NamedFigure:
    layout = _Layout(part, (1.5, 1.1), (_GAP,))
    styles = _styles(part)
    for k, (_, a, cells) in enumerate(part):
        magnitude, phase = layout.axes(k, 0), layout.axes(k, 1)
        for cell in cells:
            magnitude.plot(_hertz(cell), np.abs(cell.view.nfp), **styles[cell.label])
            _phase(phase, _hertz(cell), cell.view.nfp, styles[cell.label])
        magnitude.set_yscale("log")
        low, high = magnitude.get_ylim()
        magnitude.set_ylim(max(low, 1e-6 * high), high)
        decades(magnitude.yaxis)
        magnitude.set_title(_title(a))
        magnitude.set_ylabel("|ΔP/Δω$_g$| [pu/pu]")
        _degree_axis(phase)
        _frequency_axis(magnitude, part, last=False)
        _frequency_axis(phase, part, last=True)
    _same_limits(layout.figure.axes[::2])
    layout.legend(part)
    caption = (
        "How to read: active power answered to a sinusoidal perturbation of the grid's frequency, over its frequency "
        "(network-frequency perturbation plot), in per unit of rating and of nominal frequency. The plateau at low "
        "frequency is the droop, a slope of inertia follows, a peak is a poorly damped mode. A phase near ±180° "
        f"opposes the change. {where(result)}"
    )
    return NamedFigure(name, "Network-frequency perturbation", caption, layout.figure, PART)


def _same_limits(axes: Sequence[Any]) -> None:
    lows, highs = zip(*(one.get_ylim() for one in axes), strict=True)
    for one in axes:
        one.set_ylim(min(lows), max(highs))


def _nichols_figure(result: StabilityResult, part: Sequence[Column], name: str) -> NamedFigure:
    gates = result.study.stability.gates
    layout = _Layout(part, (2.0, 2.0), (0.42,))
    styles = _styles(part)
    for k, (_, a, cells) in enumerate(part):
        for row, loop in enumerate("PQ"):
            axes = layout.axes(k, row)
            _sensitivity_circle(axes, gates.M_s)
            _margin_cross(axes, gates.gain_margin_db, gates.phase_margin_deg)
            for cell in cells:
                L = getattr(cell.view, f"L_{loop}")
                degrees = np.mod(np.degrees(np.angle(L)), 360.0) - 360.0
                size = 20.0 * np.log10(np.maximum(np.abs(L), 1e-9))
                axes.plot(_broken(degrees, 180.0), size, **styles[cell.label])
            axes.plot([-180.0], [0.0], **_ONE)
            axes.set_xlim(-360.0, 0.0)
            axes.set_xticks([-360, -270, -180, -90, 0])
            axes.set_ylim(-40.0, 40.0)
            axes.set_yticks([-40, -20, 0, 20, 40])
            axes.set_title(_title(a) + f": $L_{loop}$")
            axes.set_ylabel("Magnitude [dB]")
            if row == 1:
                axes.set_xlabel("Phase [°]")
    layout.legend(part)
    caption = (
        "How to read: each loop at its measured power with the other loop closed, magnitude against phase. The cross "
        "marks −180°, 0 dB; the vertical and horizontal bars about it are our gates of gain "
        f"({plain(gates.gain_margin_db)} dB) and phase margin ({plain(gates.phase_margin_deg)}°), and "
        f"the grey region holds the points where |1/(1 + L)| exceeds {plain(gates.M_s)}. "
        "A curve that keeps clear of all of it meets them in its loop. An "
        f"unstable cell has a curve but no margins. {where(result)}"
    )
    return NamedFigure(name, "Nichols plots of the P and Q loops", caption, layout.figure, PART)


def _sensitivity_circle(axes: Any, M_s: float) -> None:
    """Region |1 + L| < 1/M_s on a Nichols chart."""
    if M_s <= 1.0:
        return  # the circle passes through the origin: no closed region on this chart
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    L = -1.0 + np.exp(1j * turn) / M_s
    degrees = np.mod(np.degrees(np.angle(L)), 360.0) - 360.0
    axes.fill(degrees, 20.0 * np.log10(np.abs(L)), facecolor="#D9D9D9", edgecolor="#8A8A8A", linewidth=0.6, zorder=1.5)


def _margin_cross(axes: Any, gain_db: float, phase_deg: float) -> None:
    style = {"color": "#000000", "linewidth": 0.9, "zorder": 2.4}
    axes.plot([-180.0, -180.0], [-gain_db, gain_db], **style)
    axes.plot([-180.0 - phase_deg, -180.0 + phase_deg], [0.0, 0.0], **style)


def _passivity_figure(result: StabilityResult, part: Sequence[Column], name: str) -> NamedFigure:
    layout = _Layout(part, (1.75,), ())
    styles = _styles(part)
    base = 1.0 / result.study.converter.Z_base
    factor, prefix = prefix_for(base, 1e-6)
    for k, (_, a, cells) in enumerate(part):
        axes = layout.axes(k, 0)
        for cell in cells:
            axes.plot(_hertz(cell), cell.view.passivity / factor, **styles[cell.label])
        axes.set_yscale("symlog", linthresh=0.1 * base / factor, linscale=0.7)
        axes.axhline(0.0, color="#000000", linewidth=0.8, zorder=2)
        axes.set_title(_title(a))
        axes.set_ylabel(f"Passivity index [{prefix}S]")
        _frequency_axis(axes, part, last=True)
    _same_limits(layout.figure.axes)
    for axes in layout.figure.axes:
        axes.yaxis.set_major_formatter(Labels(power_of_ten))
        low, high = axes.get_ylim()
        axes.axhspan(min(low, 0.0), 0.0, facecolor="#F6E3D3", linewidth=0.0, zorder=0.5)
        axes.set_ylim(low, high)
    layout.legend(part)
    caption = (
        "How to read: least eigenvalue of (Y + Yᴴ)/2 of the dq output admittance; where it is negative (tinted) the "
        "converter can feed an oscillation of that frequency if the grid lets it, where it is positive it cannot. "
        f"Linear within ±{plain(0.1 * base / factor, 2)} {prefix}S (a tenth of the base admittance), else logarithmic. "
        f"Frequencies are those of the dq frame. {where(result)}"
    )
    return NamedFigure(name, "Passivity index", caption, layout.figure, PART)


def _nyquist_figure(result: StabilityResult, part: Sequence[Column], name: str) -> NamedFigure:
    width = (PAGE_IN - _LEFT - _RIGHT - _BETWEEN) / 2.0
    layout = _Layout(part, (width,), ())
    styles = _styles(part)
    points = np.concatenate([cell.view.nyquist.ravel() for _, _, cells in part for cell in cells])
    reach = float(np.clip(1.15 * np.max(np.abs(points)), 1.5, 4.0))
    for k, (_, a, cells) in enumerate(part):
        axes = layout.axes(k, 0)
        turn = np.linspace(0.0, 2.0 * np.pi, 121)
        axes.plot(np.cos(turn), np.sin(turn), color="#8A8A8A", linewidth=0.5, zorder=1.5)
        for cell in cells:
            for locus in np.moveaxis(cell.view.nyquist, 1, 0):
                far = np.abs(locus) > 2.0 * reach
                re, im = (np.where(far, np.nan, part) for part in (locus.real, locus.imag))
                axes.plot(re, im, **styles[cell.label])
        axes.plot([-1.0], [0.0], **_ONE)
        axes.set_xlim(-reach, reach)
        axes.set_ylim(-reach, reach)
        axes.set_aspect("equal")
        axes.set_title(_title(a))
        axes.set_xlabel("Re λ [1]")
        axes.set_ylabel("Im λ [1]")
    layout.legend(part)
    first = min(float(_hertz(cell)[0]) for _, _, cells in part for cell in cells)
    caption = (
        "How to read: the two eigenvalues λ of Z_g(jω)·Y(jω), the grid's dq impedance times the converter's "
        f"admittance, from {plain(first, 2)} Hz up; negative frequencies mirror them at the real axis. The cross marks "
        "−1, the circle has radius one. The nearer a curve comes to −1, the smaller the distance from a loss of "
        f"stability; parts beyond the window are cut. {where(result)}"
    )
    return NamedFigure(name, "Generalised Nyquist plot of grid and converter", caption, layout.figure, PART)


def _admittance_figure(result: StabilityResult, column: Column) -> NamedFigure:
    index, a, cells = column
    part: Sequence[Column] = [column, column]
    layout = _Layout(part, (1.15, 0.8, 1.15, 0.8), (_GAP, 0.3, _GAP))
    styles = _styles(part)
    sizes = []
    for i, row in enumerate("dq"):
        for j, col in enumerate("dq"):
            magnitude, phase = layout.axes(j, 2 * i), layout.axes(j, 2 * i + 1)
            for cell in cells:
                Y = cell.view.admittance[:, i, j]
                magnitude.plot(_hertz(cell), np.abs(Y), **styles[cell.label])
                _phase(phase, _hertz(cell), Y, styles[cell.label])
            magnitude.set_yscale("log")
            magnitude.set_title(symbols(f"{a.spec.name}: ") + f"$Y_{{{row}{col}}}$")
            if j == 0:
                magnitude.set_ylabel("Magnitude [S]")
            _degree_axis(phase)
            if j == 1:
                phase.set_ylabel("")
            _frequency_axis(magnitude, part, last=False)
            _frequency_axis(phase, part, last=i == 1)
            sizes.append(magnitude)
    _same_limits(sizes)
    low, high = sizes[0].get_ylim()
    for axes in sizes:
        axes.set_ylim(max(low, 1e-6 * high), high)
        decades(axes.yaxis)
    layout.figure.align_ylabels(layout.figure.axes[:2] + layout.figure.axes[4:6])
    layout.legend([column])
    caption = (
        "How to read: current into the converter at the point of common coupling over voltage there, on the axes of "
        "the grid source's dq frame (peak over peak), entry row–column: Y_dq is the d current of a q voltage. "
        f"Frequencies are those of the dq frame. {where(result)}"
    )
    return NamedFigure(
        f"admittance_{index + 1}", f"dq output admittance of {a.spec.name}", caption, layout.figure, PART
    )
