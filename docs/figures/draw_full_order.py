"""Draws f along the circle at random grids, powers and errors of three studies: a cloud that does not touch zero."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from evidence.full_order import CASES
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import region_of
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.recheck.inner import Inner, arcs_of, cells_of
from vsgdesign.certificate.recheck.loops import Loops, boxes_of, f_of, jacobians, made_of
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, look, new_figure
from vsgdesign.study.parameters import load_study

GRIDS, FREQUENCIES = 300, 180


def cloud(name: str, rng: np.random.Generator) -> tuple[Any, Any]:
    """f and its frequency in rad/s at random points that count."""
    file, controller, region, alpha = CASES[name]
    study = load_study(file)
    spec, _ = region_of(study, controller, None, None)
    system, _ = prepared(study, spec, region, NOTHING, None, None)
    own, limits = study.with_limit_of(spec), system.static
    loops = Loops(
        study=own,
        inner=Inner.of(own),
        region=region,
        schedule=system.schedule,
        table=None,
        current=limits.current,
        bridge_voltage=limits.bridge_voltage,
        alpha=alpha,
        divisor=max(4.0, 3.0 * alpha),
    )
    scr, ratio = (np.exp(rng.uniform(*np.log(axis), GRIDS)) for axis in (region.scr, region.x_over_r))
    e = rng.uniform(-region.error, region.error, (GRIDS, 2))
    V = rng.uniform(0.9, 1.1, GRIDS) * study.converter.V_rated_rms
    size = study.converter.Z_base / scr / (np.sin(np.arctan(ratio)) if loops.inner.by_reactance else 1.0)
    p, q = (rng.uniform(*power, GRIDS) * size / V**2 for power in (region.P, region.Q))
    at = np.column_stack([1.0 / scr, np.arctan(ratio), e, p, q])
    index = np.arange(GRIDS)
    with np.errstate(all="ignore"):
        cells = cells_of(loops.inner, at[:, :2], at[:, :2])
        boxes = boxes_of(loops, cells, index, at, at, np.zeros((GRIDS, 4)))
        good = np.all([condition.centre <= 0.0 for condition in boxes.conditions], axis=0)
        omega = np.concatenate([[0.0], np.geomspace(0.3, np.pi / loops.inner.T, FREQUENCIES - 1)])
        which = np.repeat(index[good], FREQUENCIES)
        every = np.tile(omega, int(good.sum()))
        arcs = arcs_of(loops.inner, cells, which, every, every, alpha)
        f = np.full(len(every), np.nan, dtype=complex)
        for may, J in jacobians(loops, boxes):
            lanes = np.flatnonzero(may[which])
            f[lanes] = f_of(loops, arcs, lanes, boxes, made_of(loops, boxes, J), which[lanes]).centre
    return f, every


def main(file: Path = Path("docs/figures/full_order_cloud.png")) -> None:
    """One panel for each study."""
    rng = np.random.default_rng(3)
    with look():
        figure = new_figure(PAGE_IN, 2.6)
        for k, name in enumerate(CASES):
            f, omega = cloud(name, rng)
            panel = add_axes(figure, 0.62 + 2.20 * k, 0.42, 1.72, 1.45)
            colours = np.log10(np.maximum(omega, 0.3))
            shown = panel.scatter(
                f.real, f.imag, c=colours, s=0.8, cmap="cividis", rasterized=True, vmin=-0.5, vmax=4.0
            )
            panel.plot(0.0, 0.0, "x", color="black")
            panel.set_title(f"{name}\nleast |f| {np.nanmin(np.abs(f)):.2f}", loc="left")
            panel.set_xlabel("Re f")
            panel.set_aspect("equal", adjustable="datalim")
            if k == 0:
                panel.set_ylabel("Im f")
        bar = figure.colorbar(
            shown, cax=add_axes(figure, 5.0, 2.47, 1.7, 0.06), orientation="horizontal", ticks=[0, 2, 4]
        )
        bar.ax.set_xticklabels(["1", "100", "10⁴ rad/s"])
        figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
