"""What the page learns once of the study: its names, axes, curves that do not depend on the state, and the fields that
it may change, those of the state and those of the study with the limits of its reader.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.verification.counting import LIMIT_ROOM
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import StudyError
from vsgdesign.linear.stability.maps import reduced_cells
from vsgdesign.metrics.met import most_overshoot, most_settling_time
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.report.explore.dc_side import signals_of
from vsgdesign.report.explore.maps import figures_of, map_axes, map_cells, map_figures
from vsgdesign.report.explore.scene import events_of, shown_of
from vsgdesign.report.explore.state import (
    LABELS,
    StateError,
    defaults,
    fault,
    faults_of,
    limits_of,
    shown_units,
    state_of,
)
from vsgdesign.study.parameters.fields import Field, at, picked
from vsgdesign.study.parameters.loading import changed_with_same_inner_loops, field_at, plain_meaning
from vsgdesign.study.parameters.reader import Asked, UnitError, format_quantity, parse_quantity
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.study.parameters.targets import Gains

_MOST_CHOICES = 4
"""Values of a whole number that the page shows as a choice instead of a slider."""

POINT, ESTIMATE, DESIGN, LIMITS = "Grid and operating point", "Estimate", "Design", "Filters and limits"
DC_SIDE = "Dc side"


@dataclass(frozen=True, kw_only=True)
class StudyField:
    """A field of the study that the page may change."""

    path: str
    label: str
    unit: str
    """Unit in which it is shown."""
    scale: float
    """Shown value over the value in SI."""
    slider: tuple[float, float]
    """Ends of its slider, in the unit; the reader's limits may reach further."""
    step: float
    group: str
    used_by: Callable[[ControllerSpec], bool]
    """Whether it changes anything for a controller."""

    @property
    def of_study(self) -> Field:
        """The field as a study file has it, with its meaning."""
        return field_at(self.path)

    @property
    def choices(self) -> tuple[int, ...]:
        """The values of a whole number with few of them."""
        one = self.of_study
        few = one.kind == "whole number" and at(one.high, {}) - at(one.low, {}) < _MOST_CHOICES
        return tuple(range(int(at(one.low, {})), int(at(one.high, {})) + 1)) if few else ()


def _closed_form(spec: ControllerSpec) -> bool:
    """Whether the gains follow from the targets of the study: no table, and no gains that are given."""
    return spec.schedule != "table" and spec.gains is None


def _published(spec: ControllerSpec) -> bool:
    return _closed_form(spec) and STRUCTURES[spec.target.structure].uncoupled


def _placed(spec: ControllerSpec) -> bool:
    return _closed_form(spec) and not STRUCTURES[spec.target.structure].uncoupled


def _with_q(spec: ControllerSpec) -> bool:
    return _closed_form(spec) and any(one.name == "q" for one in STRUCTURES[spec.target.structure].free)


def _with_P_droop(spec: ControllerSpec) -> bool:
    return _closed_form(spec) and STRUCTURES[spec.target.structure].P_droop


def _with_Q_droop(spec: ControllerSpec) -> bool:
    return _closed_form(spec) and STRUCTURES[spec.target.structure].Q_droop


def _every(spec: ControllerSpec) -> bool:  # noqa: ARG001 - as the others
    return True


def _row(
    path: str,
    label: str,
    shown: tuple[str, float],
    slider: tuple[float, float, float],
    group: str,
    used_by: Callable[[ControllerSpec], bool],
) -> StudyField:
    return StudyField(
        path=path,
        label=label,
        unit=shown[0],
        scale=shown[1],
        slider=slider[:2],
        step=slider[2],
        group=group,
        used_by=used_by,
    )


_PER_CENT, _MS, _PU = ("%", 100.0), ("ms", 1e3), ("pu", 1.0)

STUDY_FIELDS = (
    _row("dc.battery.charge", "State of charge", _PER_CENT, (0.0, 100.0, 1.0), DC_SIDE, _every),
    _row("dc.battery.i_max", "Largest current", ("A", 1.0), (1.0, 1e4, 1.0), DC_SIDE, _every),
    _row("dc.converter.charge", "State of charge", _PER_CENT, (0.0, 100.0, 1.0), DC_SIDE, _every),
    _row("dc.converter.p_max", "Largest power", ("kW", 1e-3), (0.1, 1e4, 0.1), DC_SIDE, _every),
    _row("dc.photovoltaic.irradiance", "Irradiance", ("W/m^2", 1.0), (1.0, 1200.0, 1.0), DC_SIDE, _every),
    _row("dc.C", "Capacitor", ("mF", 1e3), (0.01, 100.0, 0.01), DC_SIDE, _every),
    _row("power_loops.settling_time", "Target settling", ("s", 1.0), (0.2, 5.0, 0.05), DESIGN, _closed_form),
    _row("power_loops.damping_ratio", "Damping ratio ζ", ("", 1.0), (0.3, 2.0, 0.01), DESIGN, _published),
    _row("power_loops.droop_ratio", "Droop ratio q", ("", 1.0), (0.0, 1.0, 0.005), DESIGN, _with_q),
    _row("power_loops.k_1", "Angle polynomial k_1", ("1/s²", 1.0), (2.0, 400.0, 0.1), DESIGN, _placed),
    _row("power_loops.d_1", "Angle polynomial d_1", ("1/s", 1.0), (1.0, 60.0, 0.05), DESIGN, _placed),
    _row("power_loops.k_2", "Voltage pole k_2", ("1/s", 1.0), (0.5, 60.0, 0.05), DESIGN, _placed),
    _row("power_loops.P_droop", "P–f droop", _PER_CENT, (0.0, 20.0, 0.1), DESIGN, _with_P_droop),
    _row("power_loops.Q_droop", "Q–V droop", _PER_CENT, (0.0, 100.0, 0.5), DESIGN, _with_Q_droop),
    _row("power_loops.tau_P", "Filter of P", _MS, (0.0, 100.0, 0.5), LIMITS, _every),
    _row("power_loops.tau_Q", "Filter of Q", _MS, (0.0, 100.0, 0.5), LIMITS, _every),
    _row("converter.delay_samples", "Delay of the control", ("samples", 1.0), (0, 1, 1), LIMITS, _every),
    _row("converter.current_limit_pu", "Current limit", _PU, (1.0, 3.0, 0.05), LIMITS, _every),
)
"""Fields of a study that the page may change, in the order in which it shows them."""


def fields_of(study: Study) -> list[dict[str, Any]]:
    """All fields for the page: path, label, unit, least and largest value, slider, step, present value and group.

    Values are in the unit. ``scale`` is the shown value over that of the state (a path of a study file is sent as a
    text with its unit). ``low`` and ``high`` are the limits of the reader, ``slider`` the ends of the slider, and
    ``controllers`` the names of those for which the field changes anything. A value of None is a limit that there is
    not.
    """
    return [*_state_fields(study), *_study_fields(study)]


def gains_of() -> list[dict[str, Any]]:
    """The gains that can be given by hand, for the page: name, label, unit, least and largest value, in SI."""
    return [
        {
            "name": one.name,
            "label": one.name,
            "unit": one.unit,
            "low": one.low,
            "high": one.high,
            "meaning": plain_meaning(one),
        }
        for one in picked(Gains, *PowerLoopGains._fields)
    ]


def _state_fields(study: Study) -> list[dict[str, Any]]:
    limits, at, c = limits_of(study), defaults(study), study.converter
    shown = {name: (unit, 1.0) for name, (_, _, unit) in limits.items()} | shown_units(study)
    kilo = c.S_rated / 1e3
    f_n = at["f_hz"]
    rows = (
        ("scr", (1.0, 25.0), 0.01, POINT),
        ("x_over_r", (0.2, 25.0), 0.01, POINT),
        ("P_pu", (-1.1 * kilo, 1.1 * kilo), _round(kilo / 100.0), POINT),
        ("Q_pu", (-0.6 * kilo, 0.6 * kilo), _round(kilo / 100.0), POINT),
        ("V_g_pu", (0.8, 1.2), 0.005, POINT),
        ("f_hz", (round(f_n, 3) - 2.0, round(f_n, 3) + 2.0), 0.01, POINT),
        ("error_R", (-50.0, 50.0), 1.0, ESTIMATE),
        ("error_X", (-50.0, 50.0), 1.0, ESTIMATE),
        ("silent_s", (0.0, 2000.0), 10.0, ESTIMATE),
    )
    return [
        {
            "path": path,
            "label": LABELS[path],
            "unit": unit,
            "low": limits[path][0] * scale,
            "high": limits[path][1] * scale,
            "slider": list(slider),
            "step": step,
            "value": at[path] * scale,
            "scale": scale,
            "group": group,
        }
        for path, slider, step, group in rows
        for unit, scale in (shown[path],)
    ]


def _study_fields(study: Study) -> list[dict[str, Any]]:
    if study.origin is None:
        return []  # it was built from its parts, and there is no document to change
    asked = quantities_of(study)
    found = []
    for one in STUDY_FIELDS:
        names = [
            spec.name for k, spec in enumerate(study.controllers) if one.used_by(spec) and not _own(asked, k, one.path)
        ]
        if one.path not in asked or not names:
            continue
        quantity = asked[one.path]
        value = quantity.value
        row = {
            "path": one.path,
            "label": one.label,
            "unit": one.unit,
            "low": quantity.low * one.scale,
            "high": quantity.high * one.scale,
            "slider": [max(one.slider[0], quantity.low * one.scale), min(one.slider[1], quantity.high * one.scale)],
            "step": one.step,
            "value": None if value is None else value * one.scale,
            "group": one.group,
            "controllers": names,
            "meaning": plain_meaning(one.of_study),
        }
        found.append(row | ({"kind": "choice", "choices": list(one.choices)} if one.choices else {}))
    return found


def _own(asked: Mapping[str, Asked], k: int, path: str) -> bool:
    """Whether a controller has its own value of a field, so that the section's has no effect on it."""
    own = asked.get(f"controllers[{k}].{path.partition('.')[2]}")
    return own is not None and own.given


def _round(value: float) -> float:
    """The power of ten next below."""
    return 10.0 ** math.floor(math.log10(value))


def quantities_of(study: Study) -> dict[str, Asked]:
    """Every quantity that the reader reads in a study's document, with its limits and its present value."""
    asked: dict[str, Asked] = {}
    changed_with_same_inner_loops(study, {}, asked)
    return asked


def changed_study(study: Study, changes: Mapping[str, float | str] | tuple[tuple[str, float | str], ...]) -> Study:
    """The study with changed fields: paths of STUDY_FIELDS, with numbers in SI or texts with a unit.

    The reader of studies checks them all. The gains of the inner loops stay as they are. Raises StateError with every
    fault.
    """
    changes = dict(changes)
    if not changes:
        return study
    known = {one.path: one for one in STUDY_FIELDS}
    faults = [
        fault(path, value, f"{path} is not a field that can be changed here.", ", ".join(known))
        for path, value in changes.items()
        if path not in known
    ]
    sections: dict[str, Any] = {}
    for path, value in changes.items():
        if path in known:
            *tables, name = path.split(".")
            section: dict[str, Any] = sections
            for table in tables:
                section = section.setdefault(table, {})
            section[name] = _whole(value) if known[path].choices else value
    asked: dict[str, Asked] = {}
    changed = study
    try:
        changed = changed_with_same_inner_loops(study, sections, asked)
    except StudyError as error:
        faults += [_with_limit(one, asked, known) for one in faults_of(error)]
    if faults:
        raise StateError(faults)
    return changed


def _whole(value: float | str) -> Any:
    """A whole number where the page sent one with its unit or with a decimal point; else as it was, for the reader."""
    try:
        number = parse_quantity(str(value).removesuffix("samples"), "1")
    except UnitError:
        return value
    return int(number) if number == int(number) else value


def _with_limit(one: dict[str, Any], asked: Mapping[str, Asked], known: Mapping[str, StudyField]) -> dict[str, Any]:
    """A fault of the reader with the limits of its field."""
    quantity = asked.get(one["field"])
    if quantity is None:
        return one
    if one["field"] not in known:
        low, high = (format_quantity(value, quantity.unit) for value in (quantity.low, quantity.high))
        return one | {"limit": f"{low} to {high}", "unit": quantity.unit}
    shown = known[one["field"]]
    low, high = (f"{shown.scale * value:g}" for value in (quantity.low, quantity.high))
    unit = f" {shown.unit}".rstrip()
    text = f"{shown.label} must be a number between {low} and {high}{unit}, not {str(one['value']).strip(chr(34))}."
    return one | {"limit": f"{low} to {high}{unit}", "unit": shown.unit, "text": text}


NEAR_RAD_S = 100.0
"""Modes up to this distance from the origin decide the window of the s-plane: slower than the inner loops."""
MOST = 0.85
"""Share of these modes that the window shows: the fastest of a grid may be far away from the others."""
ROOM = 1.4
"""The window is wider than the modes need by this factor: they move where a target changes or gains are held."""


def study_info(study: Study, ready: Ready, colours: Mapping[str, str]) -> dict[str, Any]:
    """The document of ``GET study``."""
    scr, x_over_r = map_axes(study)
    promises = {figure.name: (figure.promise, figure.scale) for figure in map_figures(study)}
    gates = {name: None if value is None else value / scale for name, (value, scale) in promises.items()}
    return {
        "study": {"name": study.name, "title": study.title, "file": Path(study.files[0]).name if study.files else ""},
        "controllers": [
            {"name": spec.name, "colour": colours[spec.name], "structure": spec.target.structure, "own": False}
            for spec in study.controllers
        ],
        "fields": fields_of(study),
        "gains": gains_of(),
        "figures": figures_of(study),
        "events": events_of(),
        "defaults": defaults(study),
        "map": {"scr": list(scr), "x_over_r": list(x_over_r)},
        "nodes": _nodes(study, ready),
        "static_limit": None,  # it moves with the powers: an array of the map's answer has it
        "certificate": _certificate(ready),
        "gates": gates | {"band": SETTLING_BAND, "current_limit_pu": study.converter.current_limit_pu},
        "most": most_allowed(gates, study.converter.current_limit_pu),
        "modes": modes_window(study, ready),
        "S_rated": study.converter.S_rated,
        "signals": signals_of(study),
    }


def most_allowed(gates: Mapping[str, float | None], current_limit_pu: float | None) -> dict[str, float]:
    """The largest values that keep the gates of times, overshoots and currents, SI: those of the page of a run."""
    rules = {"settling_s": most_settling_time, "overshoot": most_overshoot}
    found = {name: float(rule(gate)) for name, rule in rules.items() if (gate := gates[name]) is not None}
    return found if current_limit_pu is None else found | {"current_limit_pu": LIMIT_ROOM * current_limit_pu}


def modes_window(study: Study, ready: Ready) -> dict[str, list[float]]:
    """Ends of Re s and of Im s, 1/s, that show the slow modes of all controllers on a few of the study's grids.

    They are the modes of the reduced model. The window belongs to the study, so that modes move in it and not with it.
    """
    state = state_of(defaults(study), study)
    spec = study.specification
    ends = map_axes(study) if spec is None else [(min(values), max(values)) for values in (spec.scr, spec.x_over_r)]
    scr, x_over_r = (np.geomspace(low, high, 4) for low, high in ends)
    found: list[NDArray[np.complex128]] = [np.empty(0, dtype=complex)]
    for one in shown_of(study, ready, state):
        if one.law is not None:
            cells = map_cells(one, state, scr, x_over_r)
            if cells.good.any():
                found.append(np.linalg.eigvals(reduced_cells(one.study, cells).A).astype(complex).ravel())
    s = np.concatenate(found)
    s = s[np.abs(s) < NEAR_RAD_S]
    if len(s) == 0:
        return {"re": [-NEAR_RAD_S, 0.1 * NEAR_RAD_S], "im": [-NEAR_RAD_S, NEAR_RAD_S]}
    left, top = (_rounded_up(ROOM * float(np.quantile(v, MOST))) for v in (np.maximum(-s.real, 0.0), np.abs(s.imag)))
    top = max(top, 0.75 * left)
    return {"re": [-left, 0.2 * left], "im": [-top, top]}


def _rounded_up(value: float) -> float:
    """The next of 1, 1.5, 2, 3, 5, 7 or 10 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(value, 1.0)))
    return float(next(m * power for m in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0) if m * power >= value * (1.0 - 1e-9)))


def _nodes(study: Study, ready: Ready) -> dict[str, Any] | None:
    """Nodes of the last table inside the static limits, and whether each keeps the specification."""
    tables = [ready.tables[spec.name] for spec in study.controllers if spec.name in ready.tables]
    if not tables:
        return None
    table, status = tables[-1], np.asarray(tables[-1].status)
    rows, columns = np.nonzero(status != "outside")
    return {
        "scr": table.scr[rows].tolist(),
        "x_over_r": table.x_over_r[columns].tolist(),
        "kept": (status[rows, columns] == "met").astype(int).tolist(),
    }


def _certificate(ready: Ready) -> dict[str, Any] | None:
    """The certified rectangle of the last table that has one, as a closed polygon."""
    certificates = [table.certificate for table in ready.tables.values()]
    regions = [one.region for one in certificates if one is not None and one.certified]
    if not regions or regions[-1].scr is None or regions[-1].x_over_r is None:
        return None
    (low, high), (left, right) = regions[-1].scr, regions[-1].x_over_r
    return {"scr": [low, high, high, low, low], "x_over_r": [left, left, right, right, left]}
