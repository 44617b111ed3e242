"""Draws the powers of the four units, from the folders of ``vsgdesign simulate`` of both study files."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

RUNS = (
    ("plant_usual-simulation", "closed_form", "gains for the grid alone"),
    ("plant-simulation", "table", "table of the plant"),
)


def main(results: Path = Path("out"), file: Path = Path("docs/figures/plant_units.png")) -> None:
    """Two panels: every unit with either gains."""
    figure, panels = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, sharey=True, layout="constrained")
    for panel, (folder, controller, title) in zip(panels, RUNS, strict=True):
        for k in range(1, 5):
            with np.load(results / folder / f"{controller}.unit{k}.npz") as series:
                panel.plot(series["t_s"], series["P_pcc"] / 1e3, lw=1.0, label=f"unit {k}")
        panel.set_title(title, fontsize=9, loc="left")
        panel.set_ylabel("P [kW]")
        panel.grid(alpha=0.3)
    panels[0].legend(ncols=4, fontsize=8, loc="upper left")
    panels[1].set_xlabel("t [s]")
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main()
