"""Eigenvalues over the grids and between the nodes of the maps, and what a pointer reads out of loci and maps."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.linear.stability.assessment import ControllerAssessment, Locus
from vsgdesign.linear.stability.maps import OUTSIDE, MarginMap
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import UNSTABLE, colour_bar, edges, round_decades
from vsgdesign.report.drawing.panels import groups
from vsgdesign.report.drawing.quantities import plain, typeset
from vsgdesign.report.drawing.style import LABEL_PT, PAGE_IN, add_axes, look, new_figure
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.report.stability.maps import DAMPING, axis_labels, baseline_first, of_model, used_gains
from vsgdesign.report.stability.schedule import place_of_design
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

PART = 5
RAYS = (0.1, 0.3, 0.5, 0.7)
VIEWS = {"power": "modes of the power loops", "network": "modes below 3ω_g", "all": "all modes"}
POWER_STATES = ("delta", "omega_i", "V")


def mode_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    """Loci of every controller, then the check between the nodes."""
    for index, a in enumerate(result.assessments):
        figure = _loci_figure(result, index, a)
        if figure is not None:
            yield figure
    parts = groups([item for item in baseline_first(result) if len(item[1].between.stable)], 3)
    for k, part in enumerate(parts):
        yield _between_figure(result, part, "between_nodes" if len(parts) == 1 else f"between_nodes_{k + 1}")


def finite_points(locus: Locus) -> tuple[Array, NDArray[np.complex128]]:
    """(parameter, s) of every eigenvalue of a locus that is a number."""
    values = np.repeat(locus.values, locus.eigenvalues.shape[1])
    s = locus.eigenvalues.ravel()
    good = np.isfinite(s)
    return values[good], s[good].astype(complex)


def locus_limits(study: Study, a: ControllerAssessment, locus: Locus, view: str) -> tuple[float, float, float, float]:
    """Limits of a panel in 1/s and rad/s, for one of VIEWS."""
    _, s = finite_points(locus)
    if s.size == 0:
        return -1.0, 1.0, -1.0, 1.0
    if view == "network":
        near = s[np.abs(s) <= 3.0 * study.grid_source.omega_g]
        s = near if near.size else s
    elif view == "power":
        # Of each close look the three least stable modes that the power loops take part in most.
        slow = [
            abs(mode.s)
            for cell in a.focus
            for mode in [m for m in cell.modes if m.participation[0][0] in POWER_STATES][:3]
        ]
        reach = 2.0 * max(slow, default=float(np.median(np.abs(s))))
        s = s[np.abs(s) <= max(reach, 1.01 * float(np.abs(s).min()))]
    left, right = float(s.real.min()), max(float(s.real.max()), 0.0)
    top = max(float(np.abs(s.imag).max()), 0.3 * (right - left), 1e-3)
    room = 0.06 * max(right - left, 1e-3)
    return left - room, right + 1.5 * room, -0.06 * top, 1.08 * top


@look()
def _loci_figure(result: StabilityResult, index: int, a: ControllerAssessment) -> NamedFigure | None:
    from matplotlib.colors import LogNorm

    loci = [(which, locus) for which, locus in enumerate(a.loci) if finite_points(locus)[1].size]
    if not loci:
        return None
    study = result.study
    left, bottom, height, between_x, between_y, bar = 0.55, 0.36, 1.4, 1.02, 0.44, 0.1
    width = (PAGE_IN - left - between_x - 0.5 - bar) / 2.0
    figure_height = bottom + 3.0 * height + 2.0 * between_y + 0.22
    figure = new_figure(left + len(loci) * width + (len(loci) - 1) * between_x + 0.5 + bar, figure_height)
    total = float(figure.get_size_inches()[0])
    for column, (which, locus) in enumerate(loci):
        values, s = finite_points(locus)
        low, high = float(values.min()), float(values.max())
        norm = LogNorm(low, high if high > low else 1.01 * low)
        upper = s.imag >= -1e-9
        drawn: Any = None
        x0 = left + column * (width + between_x)
        for row, (view, what) in enumerate(VIEWS.items()):
            axes = add_axes(figure, x0, bottom + (2 - row) * (height + between_y), width, height)
            limits = locus_limits(study, a, locus, view)
            _rays(axes, limits, study)
            seen = np.flatnonzero(upper & (s.real >= limits[0]) & (s.real <= limits[1]) & (s.imag <= limits[3]))
            seen = seen[_distinct(s[seen], limits)]
            drawn = axes.scatter(
                s.real[seen], s.imag[seen], c=values[seen], norm=norm, cmap="cividis", s=5.0, linewidths=0.0, zorder=3
            )
            axes.set_xlim(limits[0], limits[1])
            axes.set_ylim(limits[2], limits[3])
            axes.patch.set_gid(f"hover.locus.{index}.{which}.{view}")
            axes.set_title(symbols(f"{a.spec.name} over {locus.parameter}: ") + what.replace("ω_g", "$\\omega_g$"))
            axes.set_ylabel("Im s [rad/s]")
            if row == 2:
                axes.set_xlabel("Re s [1/s]")
        place = figure.add_axes(
            (
                (x0 + width + 0.08) / total,
                bottom / figure_height,
                bar / total,
                (3.0 * height + 2.0 * between_y) / figure_height,
            )
        )
        colours = figure.colorbar(drawn, cax=place)
        ticks = [v for v in (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0) if low <= v <= high] or [low]
        colours.set_ticks(ticks, labels=[plain(v, 3) for v in ticks])
        colours.minorticks_off()
        colours.set_label(f"{locus.parameter} [1]", fontsize=LABEL_PT, labelpad=1.0)
        place.grid(False)
    ratio = plain(study.grid.x_over_r(study.converter.omega_n), 3)
    scr = plain(study.grid.scr(study.converter, study.scr_basis), 3)
    caption = (
        "How to read: eigenvalues of the full-order model, s = ln(z)/T_s, as the grid changes; left of zero is stable, "
        f"the height is the frequency. Left: over SCR at X/R {ratio}; right: over X/R at SCR {scr}; both at "
        f"{place_of_design(study)}. Grey rays: damping ratios; the black one is our gate. The lower half-plane "
        "mirrors the upper one. Modes gone within one sample are left out."
    )
    return NamedFigure(f"loci_{index + 1}", f"Eigenvalue loci of {a.spec.name}", caption, figure, PART)


def _distinct(s: NDArray[np.complex128], limits: tuple[float, float, float, float]) -> NDArray[np.intp]:
    """Indices of points that can be told apart on a panel."""
    column = np.round(400.0 * (s.real - limits[0]) / (limits[1] - limits[0]))
    row = np.round(300.0 * (s.imag - limits[2]) / (limits[3] - limits[2]))
    _, first = np.unique(column + 1j * row, return_index=True)
    return np.sort(first)


def _rays(axes: Any, limits: tuple[float, float, float, float], study: Study) -> None:
    """Lines of constant damping ratio, labelled where they leave the panel."""
    left, _, _, top = limits
    gate = study.stability.gates.damping_ratio
    axes.axvline(0.0, color="#333333", linewidth=0.7, zorder=2)
    if left >= 0.0:
        return
    placed: list[tuple[float, float]] = []
    # The gate's own ray has its label first; another label needs room beside it.
    for zeta in (gate, *(z for z in RAYS if abs(z - gate) > 0.03)):
        if not 0.0 < zeta < 1.0:
            continue
        slope = np.sqrt(1.0 - zeta * zeta) / zeta
        x = max(left, -top / slope)
        own = zeta == gate
        style = {"color": "#000000" if own else "#A8A8A8", "linewidth": 0.9 if own else 0.6, "zorder": 1.5}
        axes.plot([0.0, x], [0.0, -slope * x], **style)
        at_top = -slope * left >= top
        spot = ((x - left) / (limits[1] - left), -slope * x / top)
        if any(abs(spot[0] - u) < 0.085 and abs(spot[1] - v) < 0.12 for u, v in placed):
            continue
        placed.append(spot)
        axes.annotate(
            f"{zeta:g}",
            (x, -slope * x),
            xytext=(1.5, -1.5) if at_top else (2.0, 1.5),
            textcoords="offset points",
            ha="left",
            va="top" if at_top else "bottom",
            color="#333333",
            zorder=4,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.8},
        )


@look()
def _between_figure(result: StabilityResult, part: Any, name: str) -> NamedFigure:
    from matplotlib.lines import Line2D

    gates = result.study.stability.gates
    scale = DAMPING.scale(gates)
    left, bottom, between, bar = 0.5, 0.36, 0.16, 0.72
    width = min((PAGE_IN - left - bar - between * (len(part) - 1)) / len(part), 2.9)
    height = 0.66 * width
    total = left + len(part) * width + (len(part) - 1) * between + bar
    below = bottom + 0.24
    figure = new_figure(total, below + height + 0.22)
    unstable_any = False
    values = np.concatenate([a.between.least_damping[a.between.stable] for _, a in part])
    for k, (_, a) in enumerate(part):
        axes = add_axes(figure, left + k * (width + between), below, width, height)
        stable, grids = a.between.stable, a.between_grids
        unstable_any |= not bool(stable.all())
        axes.scatter(
            grids[stable, 0],
            grids[stable, 1],
            c=scale(a.between.least_damping[stable]),
            cmap=scale.colours(),
            vmin=0.0,
            vmax=1.0,
            s=11.0,
            linewidths=0.25,
            edgecolors="#555555",
            zorder=3,
        )
        axes.plot(
            grids[~stable, 0],
            grids[~stable, 1],
            marker="X",
            markersize=4.0,
            linestyle="",
            zorder=4,
            markerfacecolor=UNSTABLE["facecolor"],
            markeredgecolor="white",
            markeredgewidth=0.3,
        )
        if stable.any():
            worst = int(np.flatnonzero(stable)[np.argmin(a.between.least_damping[stable])])
            axes.plot(
                *grids[worst], marker="o", markersize=7.0, markerfacecolor="none", markeredgecolor="#000000", zorder=5
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(*(result.study.stability.scr[0] * 0.95, result.study.stability.scr[-1] / 0.95))
        axes.set_ylim(*(result.study.stability.x_over_r[0] * 0.93, result.study.stability.x_over_r[-1] / 0.93))
        for axis in (axes.xaxis, axes.yaxis):
            round_decades(axis, functools.partial(plain, digits=3))
        axes.set_title(symbols(f"{a.spec.name} ({a.spec.kind}), full order"))
        axes.set_xlabel(axis_labels(result.study)[0])
        if k == 0:
            axes.set_ylabel("X/R [1]")
        else:
            axes.tick_params(axis="y", which="both", labelleft=False)
    beyond = (bool((values < scale.low).any()), bool((values > scale.high).any()))
    colour_bar(figure, (total - bar + 0.12, below, 0.11, height), scale, of_model(DAMPING, "full_order").label, beyond)
    ring = {"marker": "o", "markersize": 7.0, "markerfacecolor": "none", "markeredgecolor": "#000000"}
    dead = {"marker": "X", "markersize": 4.5, "markerfacecolor": UNSTABLE["facecolor"], "markeredgecolor": "white"}
    entries = [Line2D([], [], linestyle="", label="least damped of the stable grids", **ring)]
    if unstable_any:
        entries.append(Line2D([], [], linestyle="", label="unstable", **dead))
    figure.legend(
        handles=entries, ncols=2, loc="lower left", bbox_to_anchor=(left / total, 0.03 / (below + height + 0.22))
    )
    caption = (
        "How to read: random grids, log-uniform over the axes of the maps, so mostly between their nodes; colour: the "
        f"{DEFINITIONS['damping_all_modes'].title}, full order, at {place_of_design(result.study)}. Grids that cannot "
        "be analysed are left out. The table below compares the worst of them with the worst node of the map."
    )
    return NamedFigure(name, "Random grids between the nodes of the maps", caption, figure, PART)


def hover_json(result: StabilityResult) -> str:
    """One JSON object by the key that a panel's id carries; safe inside a script element."""
    found: dict[str, Any] = {}
    for index, a in enumerate(result.assessments):
        found |= _maps(index, a)
        found |= _loci(result, index, a)
    text = json.dumps(found, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c")


def _maps(index: int, a: ControllerAssessment) -> dict[str, Any]:
    found = {}
    for field in (a.reduced, a.full_order):
        found[f"map.{index}.{field.model}"] = _map(field, _texts(field, a if field is a.reduced else None), (0, 1))
    found[f"map.{index}.gains"] = _map(a.reduced, _gain_texts(a.reduced), (0, 1))
    if a.stale is not None:
        found[f"map.{index}.stale"] = _map(a.stale, _texts(a.stale), (0, 1))
    if a.estimate_error is not None:
        texts = np.array(_texts(a.estimate_error), dtype=object).reshape(a.estimate_error.shape)
        for k in range(a.estimate_error.shape[0]):
            part = texts[k, 0].ravel().tolist()
            found[f"map.{index}.estimate_error.{k}"] = _map(a.estimate_error, part, (2, 3), log=False)
    return found


def _map(field: MarginMap, texts: list[str], axes: tuple[int, int], log: bool = True) -> dict[str, Any]:
    (x_name, x), (y_name, y) = (field.axes[k] for k in axes)
    return {
        "names": [x_name, y_name],
        "values": [_rounded(x), _rounded(y)],
        "edges": [_rounded(edges(x, log), 6), _rounded(edges(y, log), 6)],
        "log": log,
        "texts": texts,
        "per": len(texts) // (len(x) * len(y)),
    }


def _rounded(values: Array, digits: int = 4) -> list[float]:
    return [float(f"{v:.{digits}g}") for v in values]


def _texts(field: MarginMap, steps: ControllerAssessment | None = None) -> list[str]:
    """One line a cell: stable or not, margins, or the fault."""
    t, c = field.table, field.cells
    several = len(np.unique(c.P)) * len(np.unique(c.Q)) > 1
    columns = (
        np.stack(
            [
                t.least_damping,
                t.disk_output.value,
                t.disk_input.value,
                t.loop_P.gain_margin_db,
                t.loop_P.phase_margin_deg,
                t.loop_Q.gain_margin_db,
                t.loop_Q.phase_margin_deg,
                t.M_s.value,
            ],
            axis=1,
        )
        if len(t.stable)
        else np.empty((0, 8))
    )
    row_of = {int(flat): k for k, flat in enumerate(field.analysed)}
    lines = []
    for flat, fault in enumerate(field.faults):
        lead = f"P {c.P[flat] / 1e3:.3g} kW, Q {c.Q[flat] / 1e3:.3g} kvar: " if several else ""
        if c.outside[flat]:
            lead += f"{OUTSIDE} ({c.outside[flat]}): "
        k = row_of.get(flat)
        if k is None:
            lines.append(lead + (fault or "not analysed"))
            continue
        zeta, disk, at_input, gm_p, pm_p, gm_q, pm_q, M_s = columns[k]
        if not t.stable[k]:
            lines.append(typeset(f"{lead}unstable, ζ {zeta:.3g}"))
            continue
        text = (
            f"{lead}ζ {zeta:.3g}, α {disk:.3g} at the output and {at_input:.3g} at the input, "
            f"P loop {_g(gm_p)} dB {_g(pm_p)}°, Q loop {_g(gm_q)} dB {_g(pm_q)}°, M_s {M_s:.3g}"
        )
        if steps is not None:
            pair = (steps.step_P[k], steps.step_Q[k])
            times = [None if r is None else r.settling_time_s for r in pair]
            text += ", settles " + " / ".join("not" if s is None else f"{s:.3g} s" for s in times)
        lines.append(typeset(text))
    return lines


def _g(value: float) -> str:
    return "∞" if np.isinf(value) else f"{value:.3g}"


def _gain_texts(field: MarginMap) -> list[str]:
    found = field.cells.gains
    gains = {name: np.reshape(getattr(found, name), field.shape)[:, :, 0].ravel() for name in used_gains(found)}
    count = len(next(iter(gains.values())))
    return [
        typeset(", ".join(f"{name} {value[k]:.4g}" for name, value in gains.items()))
        if all(np.isfinite(value[k]) for value in gains.values())
        else (field.cells.faults[k * field.shape[2]] or "no gains")
        for k in range(count)
    ]


def _loci(result: StabilityResult, index: int, a: ControllerAssessment) -> dict[str, Any]:
    found = {}
    for which, locus in enumerate(a.loci):
        values, s = finite_points(locus)
        upper = s.imag >= -1e-9
        points = [
            [float(f"{v:.4g}"), float(f"{z.real:.5g}"), float(f"{z.imag:.5g}")]
            for v, z in zip(values[upper].tolist(), s[upper].tolist(), strict=True)
        ]
        found[f"locus.{index}.{which}"] = {"name": locus.parameter, "points": points}
        for view in VIEWS:
            limits = locus_limits(result.study, a, locus, view)
            found[f"locus.{index}.{which}.{view}"] = {"of": f"locus.{index}.{which}", "limits": list(limits)}
    return found
