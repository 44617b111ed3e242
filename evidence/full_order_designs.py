"""The proof of the sampled full-order loop over designs that it was not made for: every packaged case with its own
inner gains and the closed form, and how near the reduced model is to it.

``VSGDESIGN_PROOF_SECONDS`` (600) is the time of one process for the proof of a case. Interrupted work goes on from the
cases that are finished.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import vsgdesign as vd
from evidence._kept_runs import kept_runs
from evidence._tables import leave, table
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import Region, prove_full_order
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.points import at_rest, decays_at
from vsgdesign.certificate.region import System, random_points
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.metrics.modes import participation_factors, to_continuous
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

CASES = (
    *("hoang2025_5kva", "lab_12kva_lcl", "utility_1mva_60hz", "sized_125kva_480v_60hz", "sized_50kva_208v_60hz"),
    *("sized_100kva_no_delay", "sized_1kva_208v_60hz", "motulator_10kva_lcl", "sized_30kva_sic"),
    *(
        "sized_500kva_storage",
        "sized_5mva_3300v",
        "simplus_100kva",
        "yang2020_1mva",
        "darco2015_2750kva",
        "sized_250kva_480v_60hz",
    ),
    *("microgrid_gym_3kva_60hz", "pogaku2007_10kva", "article_10kva_lc_4khz"),
)
SCR, X_OVER_R, DECAY, POINTS = (2.0, 20.0), (0.5, 20.0), 0.5, 10_000

_CIRCUIT, _INNER = ("i_s", "v_c", "i_g", "pending"), ("xi_", "i_f")


def main(folder: Path) -> None:
    """Proves the loop of each case, and compares both models at points."""
    rows = kept_runs(case, list(CASES), folder / "full_order_designs.jsonl", "designs")
    head = ("case", "f_n, delay", "least decay found", "proved at", "of the volume", "boxes", "CPU s", "left")
    lines = table(head, [_proof(row) for row in rows])
    head = (
        "case",
        "both stable",
        "only the reduced",
        "neither",
        "reduced, full at the slowest",
        "its mode",
        "who takes part",
    )
    lines += ["", *table(head, [_near(row) for row in rows])]
    leave(folder, "full_order_designs", rows, lines)


def case(name: str) -> dict[str, Any]:
    """The proof of one case over the region, and both models at random points of it."""
    study: Study = vd.load(f"case:{name}").with_controllers(vd.controller("own"))
    study = replace(study, scr_basis="impedance")
    spec, S = study.controllers[-1], study.converter.S_rated
    region = Region(SCR, X_OVER_R, (-0.9 * S, 0.9 * S), (-0.4 * S, 0.4 * S), 0.2)
    begin = time.process_time()
    seconds = float(os.environ.get("VSGDESIGN_PROOF_SECONDS", "600"))
    try:
        found = prove_full_order(study, spec, region, decay=DECAY, workers=1, seconds=seconds)
    except InfeasibleStudyError:  # a point decays more slowly: half of the least decay
        found = prove_full_order(study, spec, region, workers=1, seconds=seconds)
    cpu = time.process_time() - begin
    system, _ = prepared(study, spec, region, NOTHING, None, None)
    worst = found.slowest
    place = [1.0 / worst.scr, np.arctan(worst.x_over_r), worst.P, worst.Q, worst.error_R, worst.error_L]
    return {
        "case": name,
        "f_n": study.converter.omega_n / (2.0 * np.pi),
        "delay": study.converter.delay_samples,
        "structure": getattr(spec.target, "structure", ""),
        "least": worst.decay,
        "decay": found.decay,
        "proved": found.proved,
        "boxes": found.boxes,
        "cpu_s": round(cpu, 1),
        "left": [part.__dict__ for part in found.left[:5]],
        "near": compared(study.with_limit_of(spec), system, region, np.array(place)),
    }


def compared(study: Study, system: System, region: Region, worst: Any) -> dict[str, Any]:
    """At random points within the static limits: the decays of both models, and the slowest mode of the full one where
    the two differ most in what they say; else at the ``worst`` place that a search found."""
    points = random_points(region, POINTS, np.random.default_rng(11))
    points, A = system.matrices(points, partial=True)
    reduced = -np.linalg.eigvals(A).real.max(axis=1)
    full = decays_at(study, system, points)
    known = np.isfinite(full)
    points, reduced, full = points[known], reduced[known], full[known]
    of_worst, A_worst = system.matrices(worst[None], partial=True)
    points, full = np.concatenate([points, of_worst]), np.append(full, decays_at(study, system, of_worst))
    reduced = np.append(reduced, -np.linalg.eigvals(A_worst).real.max(axis=1))
    stable, of_reduced = full > 0.0, reduced > 0.0
    k = int(np.argmin(full))
    return {
        "points": len(points),
        "both": float((stable & of_reduced).mean()),
        "only_reduced": float((~stable & of_reduced).mean()),
        "only_full": float((stable & ~of_reduced).mean()),
        "neither": float((~stable & ~of_reduced).mean()),
        "reduced": float(reduced[k]),
        "full": float(full[k]),
        **mode_at(study, system, points[k : k + 1]),
    }


def mode_at(study: Study, system: System, point: Any) -> dict[str, Any]:
    """The slowest mode of the full-order model at a point (1, 6), and which shares circuit, inner loops and power loops
    take in it."""
    rest, source = at_rest(study, system, point), study.grid_source
    gains = PowerLoopGains(*(float(value[0]) for value in rest.gains))
    grid = Grid(float(rest.R_g[0]), float(rest.L_g[0]))
    P, Q = (float(value) for value in point[0, 2:4])
    cell = Cell(grid, gains, P, Q, omega_0=source.omega_g, V_n=float(rest.V_rms[0]))
    model = linearise_full_order(study, [cell])
    values, shares = participation_factors(model.A[0])
    k = int(np.argmax(np.abs(values)))
    s = complex(to_continuous(values, model.T_s)[k])
    of = {"circuit": 0.0, "inner loops": 0.0, "power loops": 0.0}
    for name, own in zip(model.states, shares[:, k], strict=True):
        part = "circuit" if name.startswith(_CIRCUIT) else "inner loops" if name.startswith(_INNER) else "power loops"
        of[part] += float(own)
    return {
        "s": [s.real, abs(s.imag)],
        "takes_part": of,
        "at": [1.0 / point[0, 0], float(np.tan(point[0, 1])), P, Q, float(point[0, 4]), float(point[0, 5])],
    }


def _proof(row: dict[str, Any]) -> list[str]:
    return [row["case"], f"{row['f_n']:.0f} Hz, {row['delay']}", *proof_columns(row)]


def proof_columns(row: dict[str, Any]) -> list[str]:
    """Least decay, what is proved, boxes, time and what is left of a design."""
    unstable = row["least"] <= 0.0
    left = "; ".join(
        "SCR {:.3g} to {:.3g}, X/R {:.2g} to {:.2g}: ".format(*part["scr"], *part["x_over_r"]) + f"{part['reason']}"
        for part in row["left"][:1]
    )
    return [
        f"{row['least']:.3g} 1/s",
        "–" if unstable else f"{row['decay']:.3g} 1/s",
        "unstable" if unstable else "all" if not row["left"] else f"{100.0 * row['proved']:.4g} %",
        f"{row['boxes']:,}",
        f"{row['cpu_s']:.0f}",
        "" if unstable else left,
    ]


def _near(row: dict[str, Any]) -> list[str]:
    near = row["near"]
    scr, ratio, P, Q, e_R, e_L = near["at"]
    parts = sorted(near["takes_part"].items(), key=lambda item: -item[1])
    return [
        row["case"],
        *(f"{100.0 * near[name]:.4g} %" for name in ("both", "only_reduced", "only_full", "neither")),
        f"{near['reduced']:.3g}, {near['full']:.3g} 1/s",
        f"{near['s'][0]:+.3g} ± {near['s'][1]:.3g}j 1/s at SCR {scr:.3g}, X/R {ratio:.2g}, "
        f"P {P / 1e3:.4g} kW, Q {Q / 1e3:.4g} kvar, errors {100.0 * e_R:+.0f}, {100.0 * e_L:+.0f} %",
        ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in parts if share > 0.05),
    ]
