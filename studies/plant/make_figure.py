"""Draws the powers of the four units, from the folders of ``vsgdesign simulate`` of both study files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vsgdesign.report.drawing.style import PAGE_IN, add_axes, line_style, look, new_figure

RUNS = (
    ("plant_usual-simulation", "closed_form", "Gains for the grid alone"),
    ("plant-simulation", "table", "Table of the plant"),
)


def main(results: Path = Path("out"), file: Path = Path("docs/figures/plant_units.png")) -> None:
    """Two panels: every unit with either gains. Unit 4 is drawn first, so that the units that stay lie on top."""
    with look():
        figure = new_figure(PAGE_IN, 4.0)
        panel = None
        for (folder, controller, title), bottom in zip(RUNS, (2.15, 0.40), strict=True):
            panel = add_axes(figure, 0.50, bottom, 6.50, 1.45, sharex=panel, sharey=panel)
            for k in (4, 3, 2, 1):
                with np.load(results / folder / f"{controller}.unit{k}.npz") as series:
                    panel.plot(series["t_s"], series["P_pcc"] / 1e3, label=f"unit {k}", **line_style(k - 1))
            panel.set_title(title, loc="left")
            panel.set_ylabel("P (kW)")
            if bottom < 1.0:
                panel.set_xlabel("t (s)")
            else:
                panel.tick_params(labelbottom=False)
                lines, names = panel.get_legend_handles_labels()
                figure.legend(lines[::-1], names[::-1], ncols=4, loc="upper right", bbox_to_anchor=(0.98, 0.99))
        figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
