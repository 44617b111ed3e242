"""Draws what becomes of an island of three units of which one loses half of its source: with and without a clamp."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.simulation.test_dc_links_of_plants import lost
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, line_style, look, new_figure

FROM_S = 0.7


def main(file: Path = Path("docs/figures/dc_plant.png")) -> None:
    """Powers above, voltages of the links below."""
    with look(), tempfile.TemporaryDirectory() as folder:
        figure = new_figure(PAGE_IN, 3.9)
        panels: dict[str, object] = {}
        for column, control in enumerate(("power_clamp", "none")):
            units = lost(Path(folder), control).units
            shared = None
            for name, label, scale, bottom in (("P_pcc", "P (kW)", 1e3, 2.10), ("v_dc", "v_dc (V)", 1.0, 0.42)):
                left = 0.62 + 3.42 * column
                panel = add_axes(figure, left, bottom, 2.95, 1.30, sharex=shared, sharey=panels.get(name))
                shared, panels[name] = shared or panel, panels.get(name, panel)
                for k, (unit, said) in enumerate(
                    zip(units, ("first: dc–dc stage", "second: battery", "third: ideal link"), strict=True)
                ):
                    if name in unit.series:
                        late = unit.series["t_s"] >= FROM_S
                        t_s, values = unit.series["t_s"][late], unit.series[name][late] / scale
                        panel.plot(t_s, values, label=said, **line_style(k))
                if name == "P_pcc":
                    panel.set_title(f'control = "{control}"', loc="left")
                    panel.tick_params(labelbottom=False)
                else:
                    panel.set_xlabel("t (s)")
                if column == 0:
                    panel.set_ylabel(label)
                else:
                    panel.tick_params(labelleft=False)
                panel.margins(x=0.0)
                if column == 0 and name == "P_pcc":
                    lines, names = panel.get_legend_handles_labels()
                    figure.legend(lines, names, ncols=3, loc="upper right", bbox_to_anchor=(0.985, 0.995))
        figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
