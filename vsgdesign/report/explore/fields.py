"""The fields that the page may change: those of the state, and those of the study with the limits of its reader."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import StudyError
from vsgdesign.report.explore.state import LABELS, StateError, defaults, fault, faults_of, limits_of, shown_units
from vsgdesign.study.parameters.fields import Field, at, picked
from vsgdesign.study.parameters.loading import changed_with_same_inner_loops
from vsgdesign.study.parameters.reader import Asked
from vsgdesign.study.parameters.reference import field_at, plain_meaning
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.study.parameters.targets import Gains
from vsgdesign.study.parameters.units import UnitError, format_quantity, parse_quantity

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
