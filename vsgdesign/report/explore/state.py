"""What the explorer's page can change: the state of the page, read with every fault at once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import Fault, StudyError, VsgDesignError
from vsgdesign.study.parameters.controllers import read_power_gains
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS
from vsgdesign.study.parameters.reader import Asked, TableReader, UnitError, parse_quantity
from vsgdesign.study.parameters.study import Study

EVENTS = ("step", "grid", "phase", "sag", "ramp")
"""Events of the page: step of a reference, jump of the impedance, phase jump, voltage sag, ramp of the frequency. The
kinds that have a step of their own follow (:attr:`vsgdesign.study.parameters.event_kinds.EventKinds.explored`)."""

SIGNALS = ("P", "Q")

OWN = "own"
"""The name of the controller whose gains the user gives by hand."""

FIGURES = ("disk_margin_output", "damping_all_modes", "settling_s", "overshoot", "decay", "survived")
"""Names of the figures that a map can show."""
_OF_BEFORE = {"disk_margin": "disk_margin_output", "damping": "damping_all_modes"}
"""Names of figures in links of earlier versions."""


class StateError(VsgDesignError):
    """A state of the page is wrong. ``faults`` has a dictionary for each fault: field, value, limit, unit and text."""

    def __init__(self, faults: Iterable[Mapping[str, Any]]) -> None:
        self.faults = [dict(fault) for fault in faults]
        super().__init__("\n".join(fault["text"] for fault in self.faults))


def fault(name: str, value: Any, text: str, limit: str = "", unit: str = "") -> dict[str, Any]:
    """One fault, as the page gets it: ``limit`` in words, ``text`` the whole sentence."""
    shown = value if isinstance(value, str | int | float | bool) or value is None else str(value)
    if isinstance(shown, float) and not math.isfinite(shown):
        shown = str(shown)  # JSON has no word for it
    return {"field": name, "value": shown, "limit": limit, "unit": unit, "text": text}


def faults_of(error: StudyError) -> list[dict[str, Any]]:
    """The faults of the study's reader, as the page gets them."""
    return [fault(one.field, one.value, str(one)) for one in error.faults]


@dataclass(frozen=True)
class PlaceOfState:
    """A grid of the page: SCR on the study's basis, and X/R."""

    scr: float
    x_over_r: float


@dataclass(frozen=True, kw_only=True)
class EventOfState:
    """The fields of the page from which its event is made (:func:`vsgdesign.report.explore.scene.events_at`). Values
    that its kind does not need have no effect."""

    kind: str = "step"
    """One of EVENTS, or the name of a step of a kind."""
    size: float = 0.05
    """Of a step in per unit of S_rated, of a phase jump in degrees, of a sag the share of V_g that is lost, of a ramp
    the change of the frequency in Hz."""
    signal: str = "P"
    """The reference that a step changes: P or Q."""
    length_s: float = 0.15
    """Duration of a sag or of a ramp, s."""
    to_scr: float = 1.5
    to_x_over_r: float = 1.0
    """The grid after a jump."""


@dataclass(frozen=True, kw_only=True)
class State:
    """Everything that the page can change."""

    scr: float
    x_over_r: float
    P_pu: float
    Q_pu: float
    """Powers at the control point, in per unit of S_rated."""
    V_g_pu: float = 1.0
    """Voltage of the grid's source, in per unit of the rated voltage."""
    f_hz: float
    """Frequency of the grid's source, Hz."""
    error_R: float = 0.0
    error_X: float = 0.0
    """Relative errors of the estimates of R_g and of L_g."""
    hold: PlaceOfState | None = None
    """The grid whose gains are held, or None if the gains follow the grid."""
    figure: str = FIGURES[0]
    """The figure that the map shows."""
    map_of: str | None = None
    """The controller whose figure the map shows; None: the last one that is shown."""
    event: EventOfState = field(default_factory=EventOfState)
    silent_s: float = 0.0
    """How long no estimate comes after the event, s."""
    controllers: tuple[str, ...] = ()
    """Names of the controllers that are shown."""
    changes: tuple[tuple[str, float | str], ...] = ()
    """Changed fields of the study: path as in a study file, and value, a number in SI or a text with its unit."""
    own: PowerLoopGains | None = None
    """Gains given by hand, in SI."""

    def document(self) -> dict[str, Any]:
        """The state in JSON's types; :func:`state_of` reads it back."""
        found = asdict(self) | {"controllers": list(self.controllers), "changes": dict(self.changes)}
        found["own"] = None if self.own is None else self.own._asdict()
        return found


def names_of(study: Study) -> tuple[str, ...]:
    """Names of the controllers that can be shown: those of the study, then the user's own gains."""
    return tuple(dict.fromkeys([*(spec.name for spec in study.controllers), OWN]))


def defaults(study: Study, ready: Ready = NOTHING) -> dict[str, Any]:  # noqa: ARG001 - as the session calls it
    """The state with which the page begins: the study's grid, references and controllers."""
    c, at = study.converter, study.grid.place(study.converter, study.scr_basis)
    ratio = min(at.x_over_r, X_OVER_R_LIMITS[1])
    shown = tuple(spec.name for spec in study.controllers[:4])
    state = State(
        scr=at.scr,
        x_over_r=ratio,
        P_pu=study.simulation.P_ref / c.S_rated,
        Q_pu=study.simulation.Q_ref / c.S_rated,
        V_g_pu=study.grid_source.V_g_rms / c.V_rated_rms,
        f_hz=_digits(study.grid_source.omega_g / (2.0 * math.pi)),
        event=EventOfState(to_scr=max(SCR_LIMITS[0], at.scr * 0.6), to_x_over_r=ratio),
        controllers=shown,
    )
    return state.document()


LABELS = {
    "scr": "SCR",
    "x_over_r": "X/R",
    "P_pu": "P",
    "Q_pu": "Q",
    "V_g_pu": "Grid voltage",
    "f_hz": "Grid frequency",
    "error_R": "Error of R",
    "error_X": "Error of L",
    "silent_s": "Silent after the event",
    "event.size": "Size of the event",
    "event.length_s": "Duration of the event",
    "event.to_scr": "SCR after the jump",
    "event.to_x_over_r": "X/R after the jump",
    "hold.scr": "SCR of the held gains",
    "hold.x_over_r": "X/R of the held gains",
}
"""What the page calls the numbers of a state."""


def limits_of(study: Study) -> dict[str, tuple[float, float, str]]:
    """Least value, largest value and unit of every number of a state, by its name."""
    f_n = study.converter.omega_n / (2.0 * math.pi)
    return {
        "scr": (*SCR_LIMITS, ""),
        "x_over_r": (*X_OVER_R_LIMITS, ""),
        "P_pu": (-2.0, 2.0, "pu"),
        "Q_pu": (-2.0, 2.0, "pu"),
        "V_g_pu": (0.1, 2.0, "pu"),
        "f_hz": (_digits(0.8 * f_n), _digits(1.2 * f_n), "Hz"),
        "error_R": (-0.9, 10.0, ""),
        "error_X": (-0.9, 10.0, ""),
        "silent_s": (0.0, 36000.0, "s"),
    }


def shown_units(study: Study) -> dict[str, tuple[str, float]]:
    """The unit in which the page shows a number of a state, and the shown value over the kept one; for those that it
    shows in another unit than the state keeps them in."""
    kilo = study.converter.S_rated / 1e3
    return {
        "P_pu": ("kW", kilo),
        "Q_pu": ("kvar", kilo),
        "error_R": ("%", 100.0),
        "error_X": ("%", 100.0),
        "silent_s": ("ms", 1e3),
    }


def _digits(value: float) -> float:
    """A value to twelve digits: 60 instead of 59.99999999999999."""
    return float(f"{value:.12g}")


SIZES = {
    "step": (-2.0, 2.0, "pu"),
    "phase": (-180.0, 180.0, "deg"),
    "sag": (0.0, 0.95, "pu"),
    "ramp": (-10.0, 10.0, "Hz"),
}
"""Limits and unit of the size of an event, by its kind."""

LENGTHS_S = 1e-3, 1.5, "s"
"""Limits and unit of the duration of an event."""


def state_of(document: Any, study: Study) -> State:
    """The state of a document in JSON's types; a field that it leaves out keeps its default.

    Raises StateError with every fault. The values of changed fields are checked when the study is changed
    (:func:`vsgdesign.report.explore.fields.changed_study`).
    """
    reader = _Reader(document)
    standard = defaults(study)
    given = reader.filled(standard, "")
    shown = shown_units(study)
    values: dict[str, Any] = {
        name: reader.number(given, name, *limit, shown=shown.get(name)) for name, limit in limits_of(study).items()
    }
    hold = given["hold"]
    if hold is not None:
        values["hold"] = PlaceOfState(**reader.place(reader.table(hold, "hold"), "hold.", ("scr", "x_over_r")))
    given["figure"] = _OF_BEFORE.get(str(given["figure"]), given["figure"])
    values["figure"] = reader.choice(given, "figure", FIGURES)
    values["event"] = _event(reader, given["event"], standard["event"])
    known = names_of(study)
    shown = given["controllers"]
    if not isinstance(shown, list) or not all(isinstance(name, str) for name in shown):
        reader.say("controllers", shown, "must be a list of names", ", ".join(known))
        shown = []
    for name in shown:
        if name not in known:
            reader.say("controllers", name, "is no controller of the study", ", ".join(known))
    values["map_of"] = reader.choice(given, "map_of", (None, *known))
    changes = reader.table(given["changes"], "changes")
    for path, value in changes.items():
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            reader.say(path, value, "must be a number or a text with a unit")
    values["own"] = _own(reader, given["own"])
    if reader.faults:
        raise StateError(reader.faults)
    # In the order of the study, so that colours and rows stay where they are.
    of_study = [spec.name for spec in study.controllers]
    order = tuple(name for name in known if name in shown and (name in of_study or values["own"] is not None))
    return State(**values, controllers=order, changes=tuple(sorted(changes.items())))


def sizes_of_steps() -> dict[str, tuple[float, float, str]]:
    """As :data:`SIZES`, of the kinds that have a step of their own."""
    return {name: (-step.most, step.most, step.unit) for name, (_, step) in EVENT_KINDS.explored.items()}


def _event(reader: _Reader, given: Any, standard: dict[str, Any]) -> EventOfState:
    table = standard | reader.table(given, "event", tuple(standard))
    steps = sizes_of_steps()
    kind = reader.choice(table, "kind", (*EVENTS, *steps), "event.")
    low, high, unit = (SIZES | steps).get(kind, (-math.inf, math.inf, ""))
    return EventOfState(
        kind=kind,
        size=reader.number(table, "size", low, high, unit, "event."),
        signal=reader.choice(table, "signal", SIGNALS, "event."),
        length_s=reader.number(table, "length_s", *LENGTHS_S, "event."),
        **reader.place(table, "event.", ("to_scr", "to_x_over_r")),
    )


def gains_read(given: dict[str, Any], faults: list[Fault], asked: dict[str, Asked]) -> PowerLoopGains:
    """Gains given by hand, read as those of a study's fixed controller; gains that are left out are zero."""
    return read_power_gains(TableReader({"D_p": 0.0, "D_q": 0.0} | given, "own", faults, asked))


def _own(reader: _Reader, given: Any) -> PowerLoopGains | None:
    if given is None:
        return None
    table = reader.table(given, "own", PowerLoopGains._fields)
    found: list[Fault] = []
    asked: dict[str, Asked] = {}
    gains = gains_read(table, found, asked)
    for path in dict.fromkeys(one.field for one in found):
        name, limit = path.removeprefix("own."), asked[path]
        words = f"{limit.low:g} to {limit.high:g}"
        text = f"{name} must be a number between {limit.low:g} and {limit.high:g} {limit.unit}"
        raw = table.get(name)
        shown = "empty" if raw is None or raw == "" else str(raw)[:40]
        reader.faults.append(fault(path, raw, f"{text}, not {shown}.", words, limit.unit))
    return gains


class _Reader:
    """Reads a document field by field and collects what is wrong with it."""

    def __init__(self, document: Any) -> None:
        self.faults: list[dict[str, Any]] = []
        self._document = document

    def say(self, name: str, value: Any, problem: str, limit: str = "", unit: str = "") -> None:
        shown = f'"{value}"' if isinstance(value, str) else str(value)
        self.faults.append(fault(name, value, f"{name} = {shown[:80]}: {problem}.", limit, unit))

    def filled(self, standard: dict[str, Any], name: str) -> dict[str, Any]:
        """The document on top of the standard one."""
        return standard | self.table(self._document, name, tuple(standard))

    def table(self, value: Any, name: str, known: tuple[str, ...] = ()) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.say(name or "state", value, "must be an object")
            return {}
        unknown = [key for key in value if known and key not in known]
        for key in unknown:
            path = f"{name}.{key}" if name else str(key)
            self.say(path, value[key], f"is not known here. Known: {', '.join(known)}")
        return {key: item for key, item in value.items() if key not in unknown}

    def number(
        self,
        table: dict[str, Any],
        name: str,
        low: float,
        high: float,
        unit: str = "",
        prefix: str = "",
        shown: tuple[str, float] | None = None,
    ) -> float:
        """A number within its limits. A fault names them in the unit in which it is ``shown`` (with its factor)."""
        raw, path = table.get(name), prefix + name
        try:
            value = parse_quantity(raw, "1")
        except UnitError:
            value = math.nan
        if not low <= value <= high:
            unit, factor = shown or (unit, 1.0)
            ends, said = (factor * low, factor * high), "empty" if raw is None or raw == "" else str(raw)[:40]
            if math.isfinite(value):
                said = f"{factor * value:.6g}"
            text = f"{LABELS.get(path, path)} must be a number between {ends[0]:.6g} and {ends[1]:.6g}"
            text += f" {unit}".rstrip()
            self.faults.append(fault(path, raw, f"{text}, not {said}.", f"{ends[0]:.6g} to {ends[1]:.6g}", unit))
            return math.nan
        return value

    def place(self, table: dict[str, Any], prefix: str, names: tuple[str, str]) -> dict[str, float]:
        limits = (SCR_LIMITS, X_OVER_R_LIMITS)
        return {
            name: self.number(table, name, *limit, prefix=prefix) for name, limit in zip(names, limits, strict=True)
        }

    def choice(self, table: dict[str, Any], name: str, known: tuple[Any, ...], prefix: str = "") -> Any:
        value = table.get(name)
        if not isinstance(value, str | None) or value not in known:
            words = ", ".join("null" if one is None else one for one in known)
            self.say(prefix + name, value, f"must be one of {words}", words)
            return known[0]
        return value
