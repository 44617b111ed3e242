"""A controller in QEMU for a second with a step and a jump of the grid, on both cores, and on this machine.

With the printed sine, cosine and angle the bits have to be equal, and with the C libraries of both toolchains the
figures have to be close. It needs gcc, arm-none-eabi-gcc and qemu-system-arm, and takes about a minute.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from evidence._tables import leave, table
from vsgdesign.export.processor import CORES, MATH, processor_in_the_loop
from vsgdesign.export.unit import unit_of
from vsgdesign.report.processor import LATER
from vsgdesign.study.parameters import study_from_text

STUDY = """
base = "case:lab_12kva_lcl"
grid = {{ scr_basis = "impedance", scr = 3, x_over_r = 5 }}
simulation = {{ duration = "1 s", P_ref = "4 kW", Q_ref = "0 var" }}
controllers = [{{ name = "{name}", structure = "angle_damped", {kind} }}]
events = [
    {{ time = "0.2 s", P_ref = "8 kW" }},
    {{ time = "0.5 s", grid = {{ scr = 1.5, x_over_r = 5 }} }},
]
"""

KINDS = {"fixed": 'kind = "fixed"', "field": 'kind = "scheduled", estimate = "field"'}


def main(folder: Path) -> None:
    rows: list[dict[str, Any]] = []
    for name, kind in KINDS.items():
        study = study_from_text(STUDY.format(name=name, kind=kind))
        unit = unit_of(study)
        rows += [processor_in_the_loop(unit, study, core=core, math=math).document() for core in CORES for math in MATH]
    cells = [
        [
            row["controller"],
            row["processor"],
            row["math"],
            f"{row['differing_samples']:,} of {row['samples']:,}",
            f"{max(row['largest_difference_of_rated'].values()):.1e}",
            f"{row['instructions']['mean']:,.1f}",
            f"{row['instructions']['largest']:,}",
        ]
        for row in rows
    ]
    head = ("controller", "core", "sine, cosine, angle", "samples with another bit", "largest difference of rated")
    leave(folder, "processor", rows, table((*head, "instructions, mean", "largest"), cells))
    for row in rows:
        worst = max(row["largest_difference_of_rated"].values())
        if (row["math"] == "printed" and row["differing_samples"]) or worst > LATER:
            raise RuntimeError(f"{row['controller']} on {row['processor']}, {row['math']}: {worst:.1e} of rated.")
