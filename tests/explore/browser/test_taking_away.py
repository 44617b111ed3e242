"""What one takes away: the study as a file, the figures, the data; and that they say what the page shows."""

from __future__ import annotations

import csv
import io
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from tests.explore.browser.explorer import Explorer, ExplorerPage

MINUS = "−"


def test_figures_and_data_are_downloaded(explorer: Explorer, opened: ExplorerPage) -> None:
    page = opened.page
    page.click(opened.place(0.6, 0.4).point)
    opened.settle()
    for choice in ("svg", "png", "csv"):
        page.click("#downloads summary")
        page.click(f"#{choice}")
        page.downloaded(f"structures_explore.{choice}")
    svg = ElementTree.parse(page.downloaded("structures_explore.svg")).getroot()
    words = " ".join("".join(text.itertext()) for text in svg.iter("{http://www.w3.org/2000/svg}text"))
    assert all(name in words for name in ("published", "decoupled", "angle_damped", "SCR", "real part"))
    assert len(list(svg.iter("{http://www.w3.org/2000/svg}path"))) > 20
    with Image.open(page.downloaded("structures_explore.png")) as image:
        assert image.width >= 1200
        assert len(image.convert("RGB").getcolors(1 << 24) or []) > 50
    first, text = page.downloaded("structures_explore.csv").read_text(encoding="utf-8").split("\n", 1)
    assert first.startswith("# state: {")
    rows = list(csv.DictReader(io.StringIO(text)))
    state = explorer.state(**opened.changes())
    answer = explorer.session.answer("emt", state, lambda: False)
    assert answer is not None
    for k, one in enumerate(answer.header["controllers"]):
        taken = [row for row in rows if (row["figure"], row["controller"]) == ("EMT", one["name"])]
        P = [float(row["value"]) for row in taken if row["quantity"] == "P"]
        np.testing.assert_allclose(P, np.asarray(answer.arrays[f"{k}/P"], dtype="<f4"), rtol=1e-6)
