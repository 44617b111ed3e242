"""What a study begins from: the text that a datasheet becomes, what is asked of a network model, and everything that a
run would refuse, found without a simulation.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from vsgdesign.artifacts.files import check_new, write_new_text
from vsgdesign.artifacts.guarded_file import check_folder_target
from vsgdesign.artifacts.network_weights import read_network_weights
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.identification.interface import needs_network
from vsgdesign.simulation.lanes.beforehand import told_beforehand
from vsgdesign.simulation.scenario.checking import check_scenario
from vsgdesign.simulation.units.scenario import check_plant_run
from vsgdesign.simulation.units.timeline import plant_timeline
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
from vsgdesign.study.parameters import load_study, study_from_text
from vsgdesign.study.parameters.reader import UnitError, parse_quantity
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.estimators import recipe_of, trains
from vsgdesign.verbs.pipeline.grid import N_1, Asked
from vsgdesign.verbs.pipeline.one_unit import as_one_converter
from vsgdesign.verbs.pipeline.opening import KeptInnerLoops, check_named_files, check_possible, check_study
from vsgdesign.verbs.pipeline.run import export_tables


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


def check_file(
    study_file: str | Path, deep: bool = False, out: str | Path | None = None
) -> tuple[Study, str, list[str]]:
    """The study of a file, a sentence on its inner loops and, with ``deep``, what a run would warn of. Nothing is
    designed that is kept. Raises the errors of :func:`vsgdesign.verbs.pipeline.opening.check_study` and
    :func:`check_deep`."""
    study, inner_loops = check_study(study_file)
    check_named_files(study, str(study_file))
    check_possible(study)
    return study, inner_loops, check_deep(study_file, out)[1] if deep else []


def check_deep(study_file: str | Path, out: str | Path | None = None) -> tuple[Study, list[str]]:
    """The study of a file, and what a run of it would warn of.

    Inner loops that are not designed yet are designed, which takes seconds, and not kept. A gain table that is not
    built yet counts with the closed form of its structure, and a network that is not trained yet as the true grid.
    Raises the error with which :func:`vsgdesign.verbs.pipeline.run.run_study` would end before its first sample, or
    while it writes C.
    """
    study = load_study(study_file, KeptInnerLoops(Path(study_file), keep=False))
    check_named_files(study, str(study_file))
    check_folder_target(Path("out") / study.name if out is None else out, "vsgdesign run", study.input_files)
    study = as_one_converter(study)
    if study.plant is not None:
        return study, check_plant_run(
            _without_designs(study, untrained=False), Ready(tables=read_tables(plant_timeline(study).units[0]))
        )
    untrained, spec = trains(study), study.estimator
    if untrained and spec is not None:
        recipe_of(study, spec, None)
    network = (
        None if untrained or spec is None or spec.weights_file is None else read_network_weights(spec.weights_file)
    )
    ready = Ready(tables=read_tables(study), network=network)
    designed = _without_designs(study, untrained)
    said = [*told_beforehand(designed, ready, run=False), *check_scenario(designed, ready)]
    with TemporaryDirectory(prefix="vsgdesign-") as folder:
        export_tables(study, ready, Path(folder), warn=said.append)
    return study, said


def _without_designs(study: Study, untrained: bool) -> Study:
    """The study with the closed form in place of tables to be designed, and the truth in place of a network."""
    controllers = []
    for one in study.controllers:
        if one.schedule == "table" and one.table_file is None:
            one = replace(one, schedule="closed_form")
        if untrained and needs_network(one.estimate):
            one = replace(one, estimate="truth")
        controllers.append(one)
    return replace(study, controllers=tuple(controllers))
