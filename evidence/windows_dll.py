"""The Windows library of `export dll` under Wine against the Linux library: on recorded inputs, and in closed loop.

It needs gcc, gcc-mingw-w64-x86-64 and wine64 (Debian), and says so where one is missing. The first start of Wine makes
a folder of several hundred megabytes in the temporary folder of this run, and takes some seconds.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from evidence._tables import leave, table
from tests.export.cigre_host import Dll, Hosted
from tests.export.unit_loop import FIXED, run_loop, study_with, unit_with
from vsgdesign.export import export_dll
from vsgdesign.export.wrapping import LINUX, WINDOWS

HOST = Path(__file__).resolve().parents[1] / "tests" / "export" / "wine_host.c"
KINDS = {"fixed": FIXED, "scheduled": 'kind = "scheduled"', "field": 'kind = "scheduled", estimate = "field"'}
RECORDED, LOOP = 1e-12, 1e-11
"""Of rated: what the two libraries may differ by."""


def wine() -> str | None:
    """Where Wine is: Debian's package wine64 puts it beside the path."""
    return shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine")


def environment_of(prefix: Path) -> dict[str, str]:
    """With a folder for Wine."""
    return os.environ | {"WINEPREFIX": str(prefix), "WINEDEBUG": "-all"}


class Windows:
    """The Windows library in a process of Wine."""

    def __init__(self, program: Path, library: Path, T_s: float, prefix: Path) -> None:
        pipe, off = subprocess.PIPE, subprocess.DEVNULL
        command = [str(wine()), str(program), library.name, repr(T_s)]
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=off, cwd=library.parent, env=environment_of(prefix)
        )
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("Wine has no pipes.")
        self._to, self._back = self._process.stdin, self._process.stdout
        self.inputs, self.outputs = map(int, np.frombuffer(self._read(2)))

    def _read(self, count: int) -> bytes:
        found = self._back.read(8 * count)
        if len(found) < 8 * count:
            raise RuntimeError("Wine gave no answer.")
        return found

    def step(self, given: np.ndarray) -> np.ndarray:
        self._to.write(np.asarray(given, dtype=float).tobytes())
        self._to.flush()
        return np.frombuffer(self._read(self.outputs))

    def close(self) -> None:
        self._process.communicate()


def main(folder: Path) -> None:
    missing = [name for name in (LINUX, WINDOWS) if shutil.which(name) is None] + ([] if wine() else ["wine64"])
    if missing:
        leave(folder, "windows_dll", {"missing": missing}, [f"Not measured: there is no {', '.join(missing)}."])
        return
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        try:
            rows = _measured(Path(name))
        finally:  # Wine goes on for some seconds, and writes
            server = shutil.which("wineserver64", path="/usr/lib/wine") or "wineserver"
            subprocess.run([server, "-k", "-w"], env=environment_of(Path(name) / "prefix"), check=False)
    cells = [[row["controller"], str(row["delay"]), f"{row['recorded']:.1e}", f"{row['loop']:.1e}"] for row in rows]
    leave(folder, "windows_dll", rows, table(("controller", "delay", "recorded inputs", "closed loop"), cells))
    if any(row["recorded"] > RECORDED or row["loop"] > LOOP for row in rows):
        raise RuntimeError(f"The libraries differ by more than {RECORDED:g} or {LOOP:g} of rated.")


def _measured(place: Path) -> list[dict[str, Any]]:
    program = place / "host.exe"
    subprocess.run([WINDOWS, "-O1", str(HOST), "-o", str(program)], check=True)
    rows = []
    for delay in (0, 1):
        for name, controller in KINDS.items():
            study, unit = study_with(delay, controller), unit_with(delay, controller)
            out = export_dll(unit, place / f"{name}-{delay}").folder
            library = next(path for path in out.glob("*.dll") if not path.stem.endswith("_32"))
            own, given = Hosted(Dll(next(out.glob("*.so"))), start=0.0), []

            def recording(
                inputs: np.ndarray, own: Hosted = own, given: list[np.ndarray] = given, T_s: float = unit.T_s
            ) -> np.ndarray:
                given.append(inputs.copy())
                return own.sample(inputs, own.k * T_s)

            expected = run_loop(study, unit, recording, acts_now=True)
            sizes = np.maximum(np.max(np.abs(expected.outputs), axis=0), 1e-300)
            other = Windows(program, library, unit.T_s, place / "prefix")
            told = np.array([other.step(inputs) for inputs in given])
            other.close()
            other = Windows(program, library, unit.T_s, place / "prefix")
            loop = run_loop(study, unit, other.step, acts_now=True)
            other.close()
            rows.append(
                {
                    "controller": name,
                    "delay": delay,
                    "recorded": float(np.max(np.abs(told - expected.outputs) / sizes)),
                    "loop": float(np.max(np.abs(loop.figures - expected.figures))),
                }
            )
    return rows
