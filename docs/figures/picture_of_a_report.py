"""Takes the picture of a report's answer for docs/how-to/results.md. Run: python docs/figures/picture_of_a_report.py

The script runs studies/structures and opens its page in Chromium, which must be on the path.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
SIZE = (1120, 900)
"""Window in pixels: the answer, without the figure below it."""


def main() -> None:
    """Run, open, write the picture."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        sys.exit("error: Chromium is not on the path")
    with tempfile.TemporaryDirectory() as folder:
        study = ROOT / "studies" / "structures" / "study.toml"
        run = [sys.executable, "-m", "vsgdesign.cli", "run", str(study), "--out", f"{folder}/run"]
        subprocess.run(run, check=True, cwd=ROOT)
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--hide-scrollbars",
                f"--user-data-dir={folder}/browser",
                f"--window-size={SIZE[0]},{SIZE[1]}",
                f"--screenshot={FOLDER / 'report_answer.png'}",
                f"file://{folder}/run/report.html",
            ],
            check=True,
        )


if __name__ == "__main__":
    main()
