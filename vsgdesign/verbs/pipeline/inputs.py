"""What a study begins from: the text that a datasheet becomes, and what is asked of a network model."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import check_new, write_new_text
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
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
from vsgdesign.study.networks.model import Given
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.units import UnitError, parse_quantity
from vsgdesign.verbs.pipeline.grid import N_1, Asked


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


Quantity = float | str
Pair = tuple[Quantity | None, Quantity | None]


def asked_of(
    *,
    bus: str,
    S: Quantity,
    outages: str = N_1,
    source: Pair = (None, None),
    machine: Pair = (None, None),
    named: Mapping[str, tuple[Quantity, Quantity] | None] | None = None,
    loads: bool = False,
    frequency: Quantity | None = None,
) -> Asked:
    """Checks everything that is asked. ``source``: short-circuit power and X/R of each slack bus; ``machine``:
    sub-transient reactance in pu and X/R of each machine; ``named``: short-circuit power and X/R by name. Raises
    StudyError with every fault."""
    faults: list[Fault] = []

    def positive(field: str, value: Quantity, dimension: str) -> float:
        try:
            number = parse_quantity(value, dimension)
            if number > 0.0:
                return number
            problem = "must be positive"
        except UnitError as error:
            problem = str(error)
        faults.append(Fault(field, f'"{value}"', problem))
        return 1.0

    def pair(fields: tuple[str, str], values: Pair, dimension: str) -> tuple[float, float] | None:
        given = [value for value in values if value is not None]
        if len(given) == 1:
            missing = fields[values.index(None)]
            faults.append(Fault(missing, "", "is missing", f"Give {fields[0]} and {fields[1]} together."))
        if len(given) < 2:
            return None
        return positive(fields[0], given[0], dimension), positive(fields[1], given[1], "1")

    def of_name(name: str, told: tuple[Quantity, Quantity] | None) -> tuple[float, float] | None:
        if told is None:
            return None
        return positive(f"source {name}", told[0], "VA"), positive(f"source {name}, X/R", told[1], "1")

    asked = Asked(
        bus=bus,
        S=positive("s", S, "VA"),
        outages=outages,
        given=Given(
            source=pair(("source-s", "source-x-over-r"), source, "VA"),
            machine=pair(("machine-x", "machine-x-over-r"), machine, "1"),
            named=tuple((name, of_name(name, told)) for name, told in (named or {}).items()),
        ),
        loads=loads,
        f_n=None if frequency is None else positive("frequency", frequency, "Hz"),
    )
    if faults:
        raise StudyError("grid", faults)
    return asked
