"""The published law with a fast V loop: how many steps of P settle in time, and what Q, droop and inertia pay."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evidence._tables import leave, table
from evidence.closed_form_steps import BOX, PUBLISHED, STEPS, steps_of, study_of
from vsgdesign.equations.structures import effective_inertia, steady_droops
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.lanes.cases import ACTIVE
from vsgdesign.simulation.lanes.results import JUDGED

CONVERTERS = ("12.5 kVA", "5 kVA", "1 MVA", PUBLISHED)
RATES = (4.0, 20.0, 40.0)
"""k_2 in 1/s; the first is about that of the published design."""

WITHIN_S, OVERSHOOT = 1.05, 0.02


def main(folder: Path) -> None:
    """Prints the share of steps of P that keep 1.05 s and 2 %, by converter and k_2, beside Q, droop and inertia."""
    rows, kept = [], []
    for name in CONVERTERS:
        for k_2 in RATES:
            study = study_of(name, 0.0, {"structure": "fast_voltage", "k_2": k_2}, BOX | {"scr": [1.8, 20.0]})
            cases, found, stable = steps_of(study, STEPS)
            judged, of_P = found.status >= JUDGED, cases.signal == ACTIVE
            kept_P = (found.settling_s <= WITHIN_S) & (found.overshoot <= OVERSHOOT)
            share = float(np.mean(kept_P[judged & of_P]))
            over_Q = np.percentile(100.0 * found.overshoot[judged & stable & ~of_P], [50.0, 95.0])
            c, law = study.converter, gain_law(study, study.controllers[0])
            gains = law(cases.R_g, cases.L_g, cases.P_ref, cases.Q_ref, np.full(len(cases), c.V_rated_rms))
            droop, _ = steady_droops(gains, c.S_rated, c.omega_n, c.V_rated_rms)
            H = effective_inertia(gains, c.S_rated, c.omega_n)
            droops, inertias = (np.nanpercentile(value, [5.0, 50.0, 95.0]) for value in (100.0 * droop, H))
            figures = (droops, inertias)
            rows.append(
                (
                    name,
                    f"{k_2:g}",
                    f"{int((judged & of_P).sum())}",
                    f"{int((judged & of_P & ~stable).sum())}",
                    f"{share:.3f}",
                    f"{over_Q[0]:.1f} / {over_Q[1]:.1f}",
                    *(" / ".join(f"{value:.2g}" for value in one) for one in figures),
                )
            )
            kept.append({"converter": name, "k_2": k_2, "within": share, "overshoot_Q_95_pct": float(over_Q[1])})
    head = (
        "converter",
        "k_2, 1/s",
        "steps of P",
        "unstable",
        "P within 1.05 s, 2 %",
        "overshoot of Q, 50 / 95 %, %",
        "P–f droop, 5 / 50 / 95 %, %",
        "H, 5 / 50 / 95 %, s",
    )
    leave(folder, "fast_voltage", kept, table(head, rows))
