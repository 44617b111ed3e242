"""Takes the pictures of the explorer, in a headless Chromium.

    python docs/figures/draw_explorer.py [FOLDER]

writes ``explorer.png``, the whole page, and ``explorer_strip.png``, the map and the response in three states, beside
this file or into FOLDER. Pillow comes with Matplotlib.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.explore.browser.chromium import Page, chromium  # noqa: E402 - the repository is no installed package
from tests.explore.browser.explorer import ExplorerPage, explorer_of  # noqa: E402

STUDY = ROOT / "studies" / "structures" / "study.toml"
STIFF: dict[str, Any] = {"scr": 10.0, "x_over_r": 1.5}
HELD = {"scr": 2.0, "x_over_r": 1.5, "hold": STIFF}
SAG = {
    **HELD,
    "event": {"kind": "sag", "size": 0.3, "signal": "P", "length_s": 0.15, "to_scr": 1.5, "to_x_over_r": 1.0},
}
STRIP = (STIFF, HELD, SAG)
"""The gains follow the grid; they are held and the grid is dragged away; the same, and the voltage sags."""
COLOURS = 256


def main(folder: Path) -> None:
    """Both pictures."""
    with chromium() as browser, explorer_of(STUDY) as explorer, tempfile.TemporaryDirectory() as kept:
        opened = ExplorerPage(browser.page(), explorer.link(**HELD))
        shot = Path(kept) / "shot.png"
        opened.page.screenshot(shot)
        save(Image.open(shot), folder / "explorer.png")
        rows = []
        for state in STRIP:
            opened.open(explorer.link(**state))
            opened.page.screenshot(shot)
            with Image.open(shot) as image:
                rows.append(beside(image.convert("RGB"), opened.page))
    width, height = max(row.width for row in rows), sum(row.height for row in rows)
    strip = Image.new("RGB", (width, height), "white")
    top = 0
    for row in rows:
        strip.paste(row, (0, top))
        top += row.height
    save(strip, folder / "explorer_strip.png")


def beside(image: Image.Image, page: Page) -> Image.Image:
    """The panel of the map and that of the response, cut out of a picture of the window."""
    boxes = [page.box(selector) for selector in ("#grid-panel", "#response-panel")]
    parts = [image.crop((round(b.x) - 6, round(b.y), round(b.x + b.width) + 6, round(b.y + b.height))) for b in boxes]
    row = Image.new("RGB", (sum(part.width for part in parts), max(part.height for part in parts) + 12), "white")
    row.paste(parts[0], (0, 0))
    row.paste(parts[1], (parts[0].width, 0))
    return row


def save(image: Image.Image, path: Path) -> None:
    """With few colours, which is small."""
    image.convert("RGB").quantize(COLOURS).save(path, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
