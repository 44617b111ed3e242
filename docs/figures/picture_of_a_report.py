"""Takes the pictures of pages' answers for docs/how-to/results.md and docs/how-to/comply.md.

Run: python docs/figures/picture_of_a_report.py [NAME …]

The script runs studies/structures and sends the controllers of studies/gridcode through all suites, which takes some
minutes. It opens the pages in Chromium, which must be on the path.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
PICTURES = {
    "report_answer": (("run", "structures"), (1120, 900)),
    "compliance_page": (("comply", "gridcode"), (1120, 1344)),
    "survival_maps": (("comply", "gridcode"), (1120, 1310)),
}
"""By name: verb and study, and the window in pixels: the answer, without what is below it."""

ALONE = {"survival_maps": "h1, #filter, main > *:not(figure.maps) { display: none !important }"}
"""What a style hides, so that a part of the page stands alone."""


def main() -> None:
    """Run, open, write the pictures, or those that are named. Pictures of the same run share it."""
    names = sys.argv[1:] or list(PICTURES)
    for verb, study in dict.fromkeys(PICTURES[name][0] for name in names):
        with tempfile.TemporaryDirectory() as folder:
            file = ROOT / "studies" / study / "study.toml"
            run = [sys.executable, "-m", "vsgdesign", verb, str(file), "--out", f"{folder}/run"]
            subprocess.run(run, check=True, cwd=ROOT)
            for name in names:
                if PICTURES[name][0] == (verb, study):
                    take(Path(folder) / "run" / "report.html", name)


def take(page: Path, name: str) -> None:
    """The picture of a page."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        sys.exit("error: Chromium is not on the path")
    width, height = PICTURES[name][1]
    if name in ALONE:
        text = page.read_text(encoding="utf-8").replace("</head>", f"<style>{ALONE[name]}</style></head>", 1)
        page = page.with_name(f"{name}.html")
        page.write_text(text, encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--hide-scrollbars",
                "--blink-settings=preferredColorScheme=1",
                f"--user-data-dir={folder}",
                f"--window-size={width},{height}",
                f"--screenshot={FOLDER / f'{name}.png'}",
                f"file://{page}",
            ],
            check=True,
        )


if __name__ == "__main__":
    main()
