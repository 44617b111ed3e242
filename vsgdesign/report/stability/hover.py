"""What a pointer reads out of maps and loci, as JSON inside the page."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.linear.stability.cells import OUTSIDE
from vsgdesign.linear.stability.maps import MarginMap
from vsgdesign.report.drawing.look import edges
from vsgdesign.report.drawing.quantities import typeset
from vsgdesign.report.stability.maps import used_gains
from vsgdesign.report.stability.modes import VIEWS, finite_points, locus_limits
from vsgdesign.simulation.stability_result import StabilityResult

Array = NDArray[np.float64]


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
