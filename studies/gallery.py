"""Draws the small pictures of studies/README.md from the figures of finished runs.

    python studies/gallery.py out

reads ``out/STUDY/figures/active_power.png`` of every study that has been run, and writes
``docs/figures/gallery/STUDY.png``.
Pillow comes with Matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
STUDIES = ("published", "continuous", "published_averaged", "structures", "table", "laboratory", "utility")
WIDTH = 640


def main(runs: Path) -> None:
    """One picture for each study whose figure is there."""
    folder = ROOT / "docs" / "figures" / "gallery"
    folder.mkdir(parents=True, exist_ok=True)
    for study in STUDIES:
        figure = runs / study / "figures" / "active_power.png"
        if not figure.exists():
            print(f"{study}: no {figure}; run it first: vsgdesign run studies/{study}/study.toml")
            continue
        with Image.open(figure) as image:
            size = WIDTH, round(image.height * WIDTH / image.width)
            small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        small.quantize(160).save(folder / f"{study}.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"))
