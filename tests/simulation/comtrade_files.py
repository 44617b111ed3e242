"""Records in COMTRADE that are written by the words of the standard, and by nothing of the program."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

RATE = 4000


def channel(k: int, name: str, **changed: object) -> str:
    """The line of an analog channel: 0.01 kV for one count, on the primary side."""
    fields = {"n": k, "name": name, "ph": name[-1].upper(), "ccbm": "", "uu": "kV", "a": 0.01, "b": 0, "skew": 0}
    fields |= {"min": -32767, "max": 32767, "primary": 110, "secondary": 0.1, "PS": "P"}
    return ",".join(str(value) for value in (fields | changed).values())


def config(lines: Sequence[str], count: int, form: str, year: str = "1999", rates: Sequence[str] | None = None) -> str:
    """The .cfg of a record without status channels."""
    rates = [f"{RATE},{count}"] if rates is None else rates
    head = ["substation,recorder" + ("" if year == "1991" else f",{year}"), f"{len(lines)},{len(lines)}A,0D"]
    times = ["01/02/2024,10:11:12.000000"] * 2
    number = "0" if rates[0].startswith("0,") else str(len(rates))
    tail = {"1991": [], "1999": ["1"], "2013": ["1", "0,0", "B,3"]}[year]
    return "\r\n".join([*head, *lines, "50", number, *rates, *times, form, *tail]) + "\r\n"


def samples(counts: np.ndarray, form: str, first: int = 1) -> bytes:
    """The .dat of counts (n, channels)."""
    rows = []
    for k, row in enumerate(counts.tolist()):
        at = round(k * 1e6 / RATE)
        if form == "ASCII":
            rows.append(",".join(map(str, (first + k, at, *row))).encode() + b"\r\n")
        else:
            kind = {"BINARY": "h", "BINARY32": "i", "FLOAT32": "f"}[form]
            rows.append(struct.pack(f"<II{len(row)}{kind}", first + k, at, *row))
    return b"".join(rows)


def write(folder: Path, cfg: str, dat: bytes, name: str = "event") -> Path:
    """Both files; returns the .cfg."""
    (folder / f"{name}.cfg").write_bytes(cfg.encode())
    (folder / f"{name}.dat").write_bytes(dat)
    return folder / f"{name}.cfg"
