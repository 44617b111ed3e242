"""From a converter's datasheet to the text of a study, checked by the study's own reader before it is written."""

from __future__ import annotations

import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import check_new, write_new_text
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.study.datasheet import (
    Datasheet,
    Sheet,
    fit_series,
    read_impedance,
    read_sheet,
    resolve,
    study_text,
    with_impedance,
)
from vsgdesign.study.parameters import study_from_text


def checked_text(sheet: Sheet, origin: str, impedance: str | Path | None = None) -> tuple[Datasheet, str]:
    """The converter of a datasheet, and its study as text. ``impedance``: the file of the grid's measured impedance.
    Raises StudyError with the faults of the files, and with those that a study's reader finds in the text."""
    converter = resolve(sheet)
    if impedance is not None:
        fit = fit_series(read_impedance(impedance, converter.f_n), converter.f_n)
        converter = replace(resolve(with_impedance(sheet, fit)), measured=fit)
    text = study_text(converter, origin)
    study_from_text(text, sheet.source, inner_loops=lambda _: (InnerLoopGains(*[math.nan] * 4), math.nan))
    return converter, text


def new_study(sheet_file: str | Path, out: str | Path, impedance: str | Path | None = None) -> Datasheet:
    """Writes the study of a datasheet (.csv or .toml), and returns what was read and assumed. ``impedance``: the file
    of the grid's measured impedance. Raises ArtifactError for a file that exists, and StudyError."""
    path = check_new(out)
    converter, text = checked_text(read_sheet(str(sheet_file)), Path(sheet_file).name, impedance)
    write_new_text(path, text)
    return converter


def new_document(converter: Datasheet, path: str | Path) -> dict[str, Any]:
    """What was read, assumed and not used, in JSON's types."""
    fit = converter.measured
    measured = {} if fit is None else {"impedance": {"R": fit.R, "L": fit.L, "said": list(fit.sentences)}}
    return {
        "study": str(path),
        "title": converter.title,
        "assumed": [vars(item) for item in converter.assumptions],
        "read": converter.remarks,
        "notes": list(converter.notes),
        "not_used": list(converter.unused),
        **measured,
    }


def new_lines(converter: Datasheet, path: str | Path) -> list[str]:
    """The same in lines."""
    lines = [f"{path}: {converter.title}"]
    if converter.measured is not None:
        lines += ["measured impedance of the grid:", *(f"  {said}" for said in converter.measured.sentences)]
    if converter.remarks:
        lines += ["read:", *(f"  {field}: {text}" for field, text in converter.remarks.items())]
    if converter.assumptions:
        lines.append("assumed, because the datasheet does not give it:")
        lines += [f"  {assumption.field}: {assumption.text}" for assumption in converter.assumptions]
    lines += [f"note: {note}" for note in converter.notes]
    if converter.unused:
        lines.append("not used: " + ", ".join(converter.unused))
    return [*lines, f"next: vsgdesign run {shlex.quote(str(path))}"]
