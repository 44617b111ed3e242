"""What lies between two units: the decay that the closed form leaves there, over x_t and the transient reactance.

Four converters with their designed inner loops, and with a transient reactance of 0.3 pu in the place of theirs. The
decay is that of ``vsgdesign inner`` (:func:`vsgdesign.design.inner.check_apart`): the slowest over SCR 1.5 to 80 of a
unit, X/R 1 to 20 and three powers. Beside it stands what this costs: the score of the usual requirements.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from evidence._tables import leave, table
from evidence.plant_cases import STUDIES
from vsgdesign.design.inner import GridBox, check_apart, score_inner_loops
from vsgdesign.study.parameters import load_study, study_from_text
from vsgdesign.study.parameters.converter import Filter
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.opening import KeptInnerLoops

CONVERTERS = {
    "12.5 kVA, LCL": STUDIES / "survival" / "laboratory.toml",
    "5 kVA, LC": STUDIES / "survival" / "study.toml",
    "50 kVA, LC": "case:sized_50kva_208v_60hz",
    "1 MVA, LCL": STUDIES / "survival" / "utility.toml",
}
X_T = (0.02, 0.03, 0.045, 0.06)
"""Of a unit, pu, with R of a fifth of it."""

CORNERS_HZ = (None, 5.5, 12.0)
"""None: the transient impedance of the design."""
X_TRANSIENT = 0.3
BOX = GridBox((1.5, 80.0), (1.0, 20.0))
T_S, DECAY = 1.3, 3.0

TEXT = """
base = "{}"
simulation = {{ duration = 1, P_ref = "0 W", Q_ref = "0 var" }}
controllers = [{{ name = "closed_form", kind = "scheduled" }}]
"""


def study_of(source: str | Path) -> Study:
    """A converter with its inner loops, which are designed where the source leaves them open."""
    if isinstance(source, Path):
        return load_study(source)
    return study_from_text(TEXT.format(source), inner_loops=KeptInnerLoops(Path("plant_apart.toml"), keep=False))


def behind(study: Study, x_t: float) -> Filter:
    """Its filter with a transformer of x_t pu."""
    f, Z_base = study.filter, study.converter.Z_base
    return replace(f, L_2=f.L_2 + x_t * Z_base / study.converter.omega_n, R_2=f.R_2 + 0.2 * x_t * Z_base)


def main(folder: Path) -> None:
    rows = []
    for name, source in CONVERTERS.items():
        study = study_of(source)
        c, own = study.converter, study.inner_gains
        for corner in CORNERS_HZ:
            gains = own if corner is None else own._replace(X_t=X_TRANSIENT * c.Z_base)
            omega_t = study.omega_t if corner is None else 2.0 * math.pi * corner
            decays = [
                check_apart(c, behind(study, x_t), gains, omega_t, BOX, settling_time=T_S, decay=DECAY)[1].value
                for x_t in X_T
            ]
            score = score_inner_loops(c, behind(study, X_T[1]), gains, omega_t, BOX, settling_time=T_S)
            rows.append(
                {
                    "converter": name,
                    "X_t": gains.X_t / c.Z_base,
                    "corner_hz": omega_t / (2.0 * math.pi),
                    "designed": corner is None,
                    "decay": decays,
                    "score": score.t,
                    "limiting": score.limiting.name,
                }
            )
    head = (
        "converter", "transient reactance", *(f"x_t {x_t:g} pu" for x_t in X_T), "score of the usual requirements",
    )  # fmt: skip
    cells = [
        (
            one["converter"],
            f"{one['X_t']:.2f} pu above {one['corner_hz']:.3g} Hz" + (", designed" if one["designed"] else ""),
            *(f"{value:.1f} 1/s" for value in one["decay"]),
            f"{one['score']:.2f}",
        )
        for one in rows
    ]
    leave(folder, "plant_apart", rows, table(head, cells))
