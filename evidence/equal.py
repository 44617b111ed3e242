"""What a version of the package computes, as files, and every difference between two versions.

``python evidence/equal.py write FOLDER`` runs the jobs of equal.toml with the package that is on the path, each in a
folder of its own. ``--quick`` takes the first part of them, which needs three minutes of one core. A finished job is
kept, so that the same command goes on where it was interrupted. ``compare A B`` prints one line for each difference
between two such folders: file, key, and both values. ``--largest`` prints the largest relative difference of each file
instead. Pages and figures (HTML, SVG, PNG, PDF) need only be there.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).resolve().parent
CALL = [sys.executable, "-m", "vsgdesign"]
DONE = "exits.json"
"""A finished job has this file: the exit code of each of its calls."""

NOT_COMPARED = {"provenance", "timing_s", "loop_s", "real_time_factor", "files", "hashes", "key"}
"""Keys of JSON documents that say when, where and by which version, at any depth; and keys that end in sha256. The
``key`` of a journal is a hash that holds the package's sources."""

ONLY_THERE = {".html", ".svg", ".png", ".pdf", ".md", ".log"}
IN_C = re.compile(r"sha256 [0-9a-f]+|vsgdesign [0-9][\w.]*")


class Difference(NamedTuple):
    """One value that is not the same. ``relative`` is nan where it is no number."""

    file: str
    key: str
    a: str
    b: str
    relative: float = math.nan

    def __str__(self) -> str:
        return f"{self.file}: {self.key}: {self.a[:120]} | {self.b[:120]}"


def main(folder: Path) -> None:
    """Runs every job for ``python -m evidence equal``."""
    write(folder / "equal", quick=False, only="*")


def write(folder: Path, *, quick: bool, only: str) -> None:
    """Runs the jobs whose name fits, and prints the processor time of each call."""
    jobs = tomllib.loads((HERE / "equal.toml").read_text(encoding="utf-8"))
    shutil.copytree(HERE.parent / "studies", folder / "studies", dirs_exist_ok=True)
    (folder / "files").mkdir(parents=True, exist_ok=True)
    for name, text in jobs["files"].items():
        (folder / "files" / name).write_text(text, encoding="utf-8")
    (folder / "files" / "record.csv").write_text(record(), encoding="utf-8")
    print("| job | processor time (s) | exit codes |\n| --- | --- | --- |")
    for name, calls in (jobs["quick"] if quick else jobs["quick"] | jobs["full"]).items():
        if fnmatch.fnmatch(name, only):
            seconds, exits = run(folder / name, calls)
            print(f"| {name} | {seconds} | {exits} |", flush=True)


def run(place: Path, calls: list[str]) -> tuple[str, str]:
    """One job. A call with --json leaves what it prints, and each call what it says, as N.json and N.log."""
    if (place / DONE).exists():
        return "kept", " ".join(map(str, json.loads((place / DONE).read_text())))
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    exits, times = [], [processor_time()]
    for number, call in enumerate(calls):
        done = subprocess.run([*CALL, *shlex.split(call)], cwd=place, capture_output=True, text=True, check=False)
        if "--json" in call and done.stdout:
            (place / f"{number}.json").write_text(done.stdout, encoding="utf-8")
        (place / f"{number}.log").write_text(f"{call}\n{done.stdout}\n{done.stderr}", encoding="utf-8")
        exits.append(done.returncode)
        times.append(processor_time())
    (place / DONE).write_text(json.dumps(exits), encoding="utf-8")
    return " ".join(f"{end - begin:.1f}" for begin, end in pairwise(times)), " ".join(map(str, exits))


def processor_time() -> float:
    """Of all finished children and of theirs, s."""
    used = os.times()
    return used.children_user + used.children_system


def record() -> str:
    """A record of mains voltage with a fifth harmonic, for the replay."""
    rows = ["t,a,b,c"]
    for k in range(6000):
        t_s = k / 5000.0
        angles = [2.0 * math.pi * (50.02 * t_s - phase / 3.0) for phase in range(3)]
        rows.append(f"{t_s:.4f}," + ",".join(f"{325.0 * math.cos(x) + 6.0 * math.cos(5.0 * x):.3f}" for x in angles))
    return "\n".join(rows) + "\n"


def compare(a: Path, b: Path, only: str = "*") -> Iterator[Difference]:
    """Every difference between the jobs that both folders have finished."""
    for job in sorted(path.parent.name for path in a.glob(f"*/{DONE}") if (b / path.parent.name / DONE).exists()):
        both = {str(one.relative_to(of)) for of in (a, b) for one in (of / job).rglob("*") if one.is_file()}
        for name in sorted(fnmatch.filter(both, only)):
            there = ["there" if (of / name).is_file() else "missing" for of in (a, b)]
            if "missing" in there:
                yield Difference(name, "the file", there[0], there[1])
            elif Path(name).suffix not in ONLY_THERE:
                yield from of_file(name, a / name, b / name)


def of_file(name: str, a: Path, b: Path) -> Iterator[Difference]:
    """Differences of two files of the same name."""
    if a.suffix == ".json":
        first, second = (json.loads(one.read_text(encoding="utf-8")) for one in (a, b))
        yield from of_documents(name, "", first, second)
    elif a.suffix == ".npz":
        with np.load(a) as first, np.load(b) as second:
            for key in sorted({*first, *second}):
                x, y = (one[key] if key in one else np.zeros(0) for one in (first, second))
                yield from of_arrays(name, key, x, y)
    elif a.read_bytes() != b.read_bytes():
        lines = [IN_C.sub("", one.read_text(encoding="utf-8", errors="replace")).splitlines() for one in (a, b)]
        differ = [k for k, (x, y) in enumerate(zip(*lines, strict=False)) if x != y]
        differ += range(min(map(len, lines)), max(map(len, lines)))
        if differ:
            first, second = (some[differ[0]] if differ[0] < len(some) else "" for some in lines)
            yield Difference(name, f"line {differ[0] + 1} and {len(differ) - 1} more", first, second)


def of_documents(name: str, key: str, a: Any, b: Any) -> Iterator[Difference]:
    """Differences of two JSON documents, depth first."""
    if isinstance(a, dict) and isinstance(b, dict):
        for one in sorted({*a, *b}):
            if one not in NOT_COMPARED and not one.endswith("sha256"):
                yield from of_documents(name, f"{key}.{one}", a.get(one, "missing"), b.get(one, "missing"))
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from of_documents(name, f"{key}[{k}]", x, y)
    elif a != b or type(a) is not type(b):
        relative = math.nan
        if isinstance(a, int | float) and isinstance(b, int | float):
            relative = abs(a - b) / max(abs(a), abs(b), 1e-300)
        yield Difference(name, key, json.dumps(a), json.dumps(b), relative)


def of_arrays(name: str, key: str, a: np.ndarray, b: np.ndarray) -> Iterator[Difference]:
    """Whether two arrays are the same to the bit. A relative difference is one of the array's largest value."""
    if a.dtype == np.uint8 and b.dtype == np.uint8:
        yield from of_documents(name, key, json.loads(bytes(a)), json.loads(bytes(b)))
    elif a.dtype != b.dtype or a.shape != b.shape:
        yield Difference(name, key, f"{a.dtype} {a.shape}", f"{b.dtype} {b.shape}")
    elif a.tobytes() != b.tobytes():
        x, y = a.ravel(), b.ravel()
        differ = np.flatnonzero(x.view(f"V{x.itemsize}") != y.view(f"V{y.itemsize}"))
        far = np.abs(x[differ].astype(float) - y[differ].astype(float))
        relative = float(far.max()) / max(float(np.nanmax(np.abs(x.astype(float)))), 1e-300)
        where = f"{key}[{differ[0]}], {len(differ)} of {x.size} differ, at most {relative:.1e}"
        yield Difference(name, where, str(x[differ[0]]), str(y[differ[0]]), relative)


def largest(differences: list[Difference]) -> Iterator[str]:
    """One line for each file: its largest relative difference, and how many things that are no numbers differ."""
    for name in dict.fromkeys(one.file for one in differences):
        mine = [one for one in differences if one.file == name]
        numbers = [one for one in mine if math.isfinite(one.relative)]
        worst = max(numbers, key=lambda one: one.relative, default=None)
        said = f"{worst.relative:.1e} at {worst.key}" if worst else "no number differs"
        yield f"{name}: {said}; {len(mine) - len(numbers)} other differences"


def command_line() -> int:
    """``write`` or ``compare``. Exit code 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    writing, comparing = verbs.add_parser("write"), verbs.add_parser("compare")
    writing.add_argument("folder", type=Path)
    writing.add_argument("--quick", action="store_true", help="only the jobs that three minutes are enough for")
    writing.add_argument("--only", default="*", help="jobs whose name fits this pattern")
    comparing.add_argument("folders", type=Path, nargs=2)
    comparing.add_argument("--only", default="*", help="files whose path fits this pattern")
    comparing.add_argument("--largest", action="store_true", help="the largest relative difference of each file")
    asked = parser.parse_args()
    if asked.verb == "write":
        write(asked.folder, quick=asked.quick, only=asked.only)
        return 0
    differences = list(compare(asked.folders[0], asked.folders[1], asked.only))
    for line in largest(differences) if asked.largest else differences:
        print(line)
    print(f"{len(differences)} differences", file=sys.stderr)
    return int(bool(differences))


if __name__ == "__main__":
    sys.exit(command_line())
