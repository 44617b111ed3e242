"""Builds the web site: ``python -m website [--out DIR]``. A broken link or a warning is an error."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import Abort

from website.explorer import embed_explorers, write_explorer
from website.staging import ROOT, stage, stage_api


def main() -> int:
    """Stage, then build. Returns the exit code."""
    parser = argparse.ArgumentParser(description="Build the web site of the documents.")
    parser.add_argument("--out", type=Path, default=ROOT / "site", help="Folder for the site.  [default: site]")
    out = parser.parse_args().out.resolve()
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")

    staged = ROOT / "build" / "website"
    stage(staged, lambda text: convert(text, display="block"))
    embed_explorers(staged, write_explorer)
    api = stage_api(staged)
    config = load_config(str(ROOT / "website" / "mkdocs.yml"), site_dir=str(out), strict=True)
    config.nav[-1] = {"API": api}  # type: ignore[index]
    config.plugins.on_startup(command="build", dirty=False)
    try:
        build(config)
    except Abort as abort:
        print(abort, file=sys.stderr)
        return 1
    finally:
        config.plugins.on_shutdown()
    print(f"site: {out / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
