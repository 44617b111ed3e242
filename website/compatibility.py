"""The page of what was run: ``python -m website.compatibility [--passed COMMAND]``.

With ``--passed``, which continuous integration gives after COMMAND has passed, this system with its versions is added
to the records. Then docs/compatibility.md is written from them.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import subprocess
import sys
import time
import tomllib
from importlib import metadata
from typing import Any

from website.staging import ROOT

PAGE = ROOT / "docs" / "compatibility.md"
RECORDS = ROOT / "website" / "compatibility.json"
HEAD = """\
# Compatibility: what was run

Each column is a system on which the command in it has passed, with the versions that were installed. Nothing else is
claimed{missing}. Continuous integration writes the page (`python -m website.compatibility --passed "make test lint"`)
and replaces the column of the same system and Python. "Asked for" is the least version that the package accepts.
"""


def asked() -> dict[str, str]:
    """The least version of Python and of each library, of which the package asks for."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [one for name in ("cluster", "onnx", "train") for one in project["optional-dependencies"][name]]
    pairs = [re.fullmatch(r"([\w-]+)>=([\d.]+)", one) for one in (*project["dependencies"], *extras)]
    return {"python": project["requires-python"].removeprefix(">=")} | {one[1]: one[2] for one in pairs if one}


def here(command: str) -> dict[str, Any]:
    """The record of this system, on which a command has passed."""
    git = ["git", "show", "-s", "--abbrev=8", "--format=%h"]
    commit = subprocess.run(git, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    known = {one.metadata["Name"].lower().replace("_", "-"): one.version for one in metadata.distributions()}
    versions = {name: known[name] for name in asked() if name in known}
    return {
        "system": f"{platform.system().replace('Darwin', 'macOS')} {platform.machine()}",
        "passed": command,
        "commit": commit,
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "versions": {"python": platform.python_version()} | versions,
    }


def system(record: dict[str, Any]) -> tuple[str, str]:
    """What a record is replaced by: a newer one of the same system and minor version of Python."""
    return record["system"], record["versions"]["python"].rpartition(".")[0]


def records() -> list[dict[str, Any]]:
    """All records, by system."""
    return sorted(json.loads(RECORDS.read_text(encoding="utf-8")), key=system)


def rendered(kept: list[dict[str, Any]]) -> str:
    """The text of the page."""
    rows = [["", "asked for", *(one["system"] for one in kept)], ["---"] * (2 + len(kept))]
    rows += [[name, "", *(one[name] for one in kept)] for name in ("passed", "commit", "date")]
    rows += [[name, f"≥ {least}", *(one["versions"].get(name, "–") for one in kept)] for name, least in asked().items()]
    missing = [name for name in ("Windows", "macOS") if not any(one["system"].startswith(name) for one in kept)]
    head = HEAD.replace("{missing}", f"; {' and '.join(missing)} have not been run" if missing else "")
    return head + "\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def main() -> None:
    """Add, then write."""
    parser = argparse.ArgumentParser(prog="python -m website.compatibility")
    parser.add_argument("--passed", metavar="COMMAND", help="what has passed on this system")
    command = parser.parse_args().passed
    if command:
        new = here(command)
        kept = [*(one for one in records() if system(one) != system(new)), new]
        RECORDS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8", newline="\n")
    PAGE.write_text(rendered(records()), encoding="utf-8", newline="\n")
    sys.stdout.write(f"{PAGE}\n")


if __name__ == "__main__":
    main()
