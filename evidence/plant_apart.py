"""What lies between two units: the decay that a closed form leaves there, over x_t and the transient reactance.

Four converters with the inner loops that are designed for one converter, with another transient reactance in the place
of theirs, and with those that are designed for units behind 3 %. The decay is that of ``vsgdesign inner``
(:func:`vsgdesign.design.inner.check_apart`): the slowest over SCR 1.5 to 80 of a unit, X/R 1 to 20 and three powers.
Beside it stands what this costs: the score of the usual requirements.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from evidence._tables import leave, table
from evidence.plant_cases import STUDIES
from vsgdesign.design.inner import GridBox, check_apart, design_inner_loops, score_inner_loops
from vsgdesign.equations.inner_loops import InnerLoopGains
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

OWN, FOR_UNITS = "designed for one", "designed for units"
TRIED: tuple[str | tuple[float, float], ...] = (OWN, (0.3, 5.5), (0.3, 12.0), (0.2, 20.0), FOR_UNITS)
"""Inner loops that are designed, or the X_t (pu) and corner (Hz) in the place of those of the first."""
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


def tried(study: Study, which: str | tuple[float, float]) -> tuple[InnerLoopGains, float]:
    """Inner gains (SI) with ω_t (rad/s)."""
    c = study.converter
    if which == FOR_UNITS:
        found = design_inner_loops(c, behind(study, X_T[1]), BOX, settling_time=T_S, decay_apart=DECAY)
        return found.gains, found.omega_t
    if isinstance(which, str):
        return study.inner_gains, study.omega_t
    return study.inner_gains._replace(X_t=which[0] * c.Z_base), 2.0 * math.pi * which[1]


def main(folder: Path) -> None:
    rows = []
    for name, source in CONVERTERS.items():
        study = study_of(source)
        c = study.converter
        for which in TRIED:
            gains, omega_t = tried(study, which)
            decays = [check_apart(c, behind(study, x_t), gains, omega_t, BOX, decay=DECAY)[1].value for x_t in X_T]
            score = score_inner_loops(c, behind(study, X_T[1]), gains, omega_t, BOX, settling_time=T_S)
            rows.append(
                {
                    "converter": name,
                    "X_t": gains.X_t / c.Z_base,
                    "corner_hz": omega_t / (2.0 * math.pi),
                    "which": which,
                    "gains": gains._asdict(),
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
            f"{one['X_t']:.2f} pu above {one['corner_hz']:.3g} Hz"
            + (f", {one['which']}" if isinstance(one["which"], str) else ""),
            *(f"{value:.1f} 1/s" for value in one["decay"]),
            f"{one['score']:.2f}",
        )
        for one in rows
    ]
    leave(folder, "plant_apart", rows, table(head, cells))
