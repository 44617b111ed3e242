"""Reads the output of PSCAD: NAME.inf with the names of the channels, and NAME_01.out, … with ten channels each."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vsgdesign.study.given_files import RECORD_BYTES, TABLE_BYTES, read_given
from vsgdesign.study.parameters.record_columns import Array, Columns, RecordError, says_volts, unfit_unit, volts_of

_OF_A_FILE = 10
"""Channels in one .out."""

_NUMBERED = re.compile(r"(.+)_(\d+)")
_ENTRY = re.compile(r"^\s*PGB\(\s*(\d+)\s*\)(.*)$", re.MULTILINE)
_FIELD = re.compile(r'(\w+)="([^"]*)"')


class Channel(NamedTuple):
    """A channel as the .inf describes it."""

    name: str
    unit: str


def pscad_files(path: str) -> tuple[str, ...]:
    """The files of an output, of which one is given: of a .inf all .out; of an .out itself, with the .inf if there is
    one. Raises RecordError."""
    place = Path(path)
    if place.suffix.lower() == ".inf":
        outs = sorted(one for one in place.parent.glob(f"{_escaped(place.stem)}_*") if _number(one, place.stem))
        if not outs:
            advice = "Put them into the folder of the .inf. Of a COMTRADE record give the .cfg."
            raise RecordError(("file", f'there is no "{place.stem}_01.out" beside it, which has its samples', advice))
        return (path, *map(str, outs))
    numbered = _NUMBERED.fullmatch(place.stem)
    likely = [place.with_name(f"{numbered.group(1)}{kind}") for kind in (".inf", ".INF")] if numbered else []
    beside = next((one for one in likely if one.exists()), None)
    return (path,) if beside is None else (str(beside), path)


def read_pscad(path: str) -> Columns:
    """The channels of an output, in V where the .inf says a unit of voltages. Raises RecordError and OSError."""
    files = pscad_files(path)
    outs = [one for one in files if Path(one).suffix.lower() == ".out"]
    known = _channels(files[0]) if len(outs) < len(files) else {}
    times: Array | None = None
    found: dict[int, Array] = {}
    for place in outs:
        numbered = _NUMBERED.fullmatch(Path(place).stem)
        first = _OF_A_FILE * (int(numbered.group(2)) - 1) if numbered else 0
        rows = _rows(place)
        if times is not None and (len(times) != len(rows) or not np.array_equal(times, rows[:, 0])):
            problem = f'"{Path(place).name}" has other times than "{Path(outs[0]).name}"'
            raise RecordError(("file", problem, "Take the files of one run."))
        times = rows[:, 0]
        found |= {first + k: rows[:, k].copy() for k in range(1, rows.shape[1])}
    missing = sorted(set(known) - set(found)) if len(outs) < len(files) and Path(path).suffix.lower() == ".inf" else []
    if missing:
        name = f"{Path(path).stem}_{math.ceil(missing[0] / _OF_A_FILE):02d}.out"
        problem = f'the channel "{known[missing[0]].name}" of its .inf is missing in its .out files'
        raise RecordError(("file", problem, f'Put "{name}" beside it, with all channels of the run.'))
    return _named(found, known, times)


def _named(found: dict[int, Array], known: dict[int, Channel], times: Array | None) -> Columns:
    values, unfit, voltages = {}, {}, []
    for number, column in sorted(found.items()):
        channel = known.get(number)
        if channel is None:
            values[str(number)] = column
            continue
        volts = volts_of(channel.unit)
        values[channel.name] = column if volts is None else volts * column
        if volts is None:
            unfit[channel.name] = unfit_unit(channel.name, channel.unit)
        elif says_volts(channel.unit):
            voltages.append(channel.name)
    return Columns(values, None, times, tuple(voltages) if known else None, unfit)


def _channels(path: str) -> dict[int, Channel]:
    """The channels of a .inf by their number. A name that several groups have is GROUP/NAME."""
    text = read_given(path, TABLE_BYTES).decode("utf-8", errors="replace")
    entries = {int(one.group(1)): dict(_FIELD.findall(one.group(2))) for one in _ENTRY.finditer(text)}
    if not entries:
        problem = f'"{Path(path).name}" has no line that begins with PGB(1)'
        raise RecordError(("file", problem, "Give the .inf of PSCAD. Of a COMTRADE record give the .cfg."))
    plain = [fields.get("Desc", "") for fields in entries.values()]
    found: dict[int, Channel] = {}
    for number, fields in entries.items():
        name = fields.get("Desc", "")
        name = f"{fields.get('Group', '')}/{name}" if plain.count(name) > 1 else name
        taken = {channel.name for channel in found.values()}
        found[number] = Channel(f"{name}#{number}" if name in taken or not name else name, fields.get("Units", ""))
    return found


def _rows(path: str) -> Array:
    """The rows of an .out, of which the first line may be a title."""
    text = read_given(path, RECORD_BYTES).decode("latin-1").splitlines()
    lines = [line for line in text[1:] if line.strip()]
    if text and _are_numbers(text[0]):
        lines.insert(0, text[0])
    try:
        rows = np.loadtxt(lines, ndmin=2) if lines else np.zeros((0, 0))
    except ValueError:
        bad = next((line for line in lines if not _are_numbers(line)), lines[0])
        problem = f'"{Path(path).name}" cannot be read as numbers in columns: line {text.index(bad) + 1}'
        raise RecordError(("file", problem, "Give the text output of PSCAD; of .psout export it as text.")) from None
    if rows.shape[0] < 2 or rows.shape[1] < 2:
        problem = f'"{Path(path).name}" has fewer than two rows of a time and a channel'
        raise RecordError(("file", problem, "Give the text output of PSCAD."))
    return rows


def _are_numbers(line: str) -> bool:
    try:
        return bool([float(cell) for cell in line.split()])
    except ValueError:
        return False


def _number(path: Path, stem: str) -> bool:
    numbered = _NUMBERED.fullmatch(path.stem)
    return path.suffix.lower() == ".out" and numbered is not None and numbered.group(1) == stem


def _escaped(stem: str) -> str:
    return re.sub(r"([*?\[])", r"[\1]", stem)
