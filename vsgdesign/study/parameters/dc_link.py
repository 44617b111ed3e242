"""The [dc] section: the capacitor of the dc link and what feeds it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from vsgdesign.equations.dc_control import ClampSettings, DroopSettings
from vsgdesign.equations.dc_link import DcSettings, DcState
from vsgdesign.equations.dc_source_interface import DcRatings, DcSource, SourceLimits
from vsgdesign.equations.dc_sources import DC_SOURCES
from vsgdesign.equations.dc_sources.converter import UNLIMITED_J
from vsgdesign.equations.frames import SPACE_VECTOR_POWER, linear_modulation_limit, rms_to_peak
from vsgdesign.equations.integration import low_pass_share
from vsgdesign.errors import Fault, InfeasibleStudyError, StudyError
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.event_kinds import DC_QUANTITIES
from vsgdesign.study.parameters.fields import Field, Times, fields_of, number, values, word
from vsgdesign.study.parameters.reader import REQUIRED, TableReader

if TYPE_CHECKING:
    from vsgdesign.study.parameters.event import Event
    from vsgdesign.study.parameters.power_plant import PowerPlant
    from vsgdesign.study.parameters.study import Study

CONTROLS = NONE, POWER_CLAMP, VOLTAGE_DROOP = ("none", "power_clamp", "voltage_droop")
"""What a controller may do about its link: nothing, ask for no more power than the source can give, or turn with the
link's voltage."""

COMPENSATIONS = MEASURED, NOT_MEASURED = ("measured", "none")
"""By which voltage of the link the modulation divides: the measured one, or the nominal one."""

V_DC = Times(1.0, "`V_dc`")
"""Nominal voltage of the link."""


class _Link:
    """Fields of this section."""

    source: str = word(lambda: tuple(DC_SOURCES))
    """What feeds the link ([sources](theory/dc-side.md#sources))."""
    C: float = number("F", 1e-7, 100.0)
    """Capacitance of the link."""
    R_bleed: float = number("ohm", 0.1, 1e9, default=None, shown="none")
    """Resistor across it."""
    V_low: float = number("V", 0.05 * V_DC, 1.0 * V_DC, default=0.7 * V_DC)
    """Below, the bridge blocks, and the run is lost."""
    V_high: float = number("V", 1.0 * V_DC, 5.0 * V_DC, default=1.2 * V_DC)
    """Above, the bridge blocks, and the run is lost."""
    compensation: str = word(COMPENSATIONS, default=MEASURED)
    """By which voltage of the link the modulation divides: the measured one, or, with `none`, `V_dc`
    ([modulation](theory/dc-side.md#where-the-link-moves-the-bridge))."""


class _Control:
    """Fields of this section."""

    control: str = word(CONTROLS, default=CONTROLS[0])
    """What the controller does about its link ([controls](theory/dc-side.md#controls))."""


class _Clamp:
    """Fields of [dc.power_clamp]."""

    hold: float = number("s", 0.01, 1e4, default=5.0)
    """The limit of the power falls when the charge lasts for no more than this."""
    droop_time: float = number("s", 1e-3, 10.0, default=0.3)
    """Time constant of the frequency by which the P–f droop is limited. Its faster part goes on damping."""


class _Droop:
    """Fields of [dc.voltage_droop]."""

    share: float = number("1", 0.0, 1.0, default=0.05)
    """How far the frequency follows the voltage of the link: 0 is no droop, 1 the matching law, ω = ω_n v/V_dc, beside
    the power loops."""


def source_fields() -> tuple[Field, ...]:
    """The parameters of all sources, each as a table of the source's name."""
    return tuple(
        Field(
            kind="table",
            name=source.name,
            default=None,
            shown="defaults",
            of=parameter_fields(source),
            explained=f'Parameters of `source = "{source.name}"`.',
        )
        for source in DC_SOURCES.values()
    )


def parameter_fields(source: DcSource) -> tuple[Field, ...]:
    """The parameters of a source as fields of its table."""
    found = []
    for one in source.parameters:
        several = one.name == "open_circuit"
        given: Any = one.default if isinstance(one.default, int | float) and not one.shown else None
        found.append(
            Field(
                kind="numbers" if several else "number",
                name=one.name,
                attribute=one.name,
                unit=one.unit,
                low=one.low,
                high=one.high,
                default=REQUIRED if one.default is None else () if several else given,
                shown=one.shown,
                increasing=False,
                explained=one.meaning[0].upper() + one.meaning[1:] + ".",
            )
        )
    return tuple(found)


_OF_CONTROLS: dict[str, type] = {POWER_CLAMP: _Clamp, VOLTAGE_DROOP: _Droop}
_CONTROL_TABLES = tuple(
    Field(
        kind="table",
        name=name,
        default=None,
        shown="defaults",
        of=fields_of(of),
        explained=f'Parameters of `control = "{name}"`.',
    )
    for name, of in _OF_CONTROLS.items()
)
DC = (*fields_of(_Link), *fields_of(_Control), *source_fields(), *_CONTROL_TABLES)
"""The fields of [dc]."""


@dataclass(frozen=True, kw_only=True)
class DcLink:
    """A dc link that is not ideal."""

    source: str
    """A name in ``equations.dc_sources.DC_SOURCES``."""
    C: float
    """F."""
    R_bleed: float | None
    """Ω."""
    V_low: float
    V_high: float
    """Voltages beyond which the bridge blocks, V."""
    given: tuple[tuple[str, Any], ...]
    """Every parameter of the source by name, in SI."""
    compensation: str = MEASURED
    """One of COMPENSATIONS."""
    control: str = NONE
    """One of CONTROLS."""
    hold: float = 5.0
    droop_time: float = 0.3
    """Of the clamp, s."""
    share: float = 0.0
    """Of the droop of the link's voltage."""
    blocks: bool = True
    """Whether a run ends beyond V_low … V_high. No study says so: one that goes on measures how much was beyond."""

    @property
    def droops(self) -> bool:
        """Whether the controller turns with the link's voltage."""
        return self.control == VOLTAGE_DROOP

    def droop(self, converter: Converter) -> DroopSettings:
        """The constants of this droop."""
        return DroopSettings(per_volt=self.share * converter.omega_n / converter.V_dc)

    @property
    def clamps(self) -> bool:
        """Whether the controller asks for no more power than the source can give."""
        return self.control == POWER_CLAMP

    @property
    def compensates(self) -> bool:
        """Whether the modulation divides by the measured voltage of the link."""
        return self.compensation == MEASURED

    @property
    def kind(self) -> DcSource:
        """The source."""
        return DC_SOURCES[self.source]

    @property
    def values(self) -> dict[str, Any]:
        """The source's parameters by name."""
        return dict(self.given)

    def after(self, changed: Mapping[str, float]) -> DcLink:
        """The link after events: what they set last, by the names of DC_QUANTITIES. A share that is left (``dc_power``)
        is one of this link's source."""
        values = self.values
        if "dc_power" in changed:
            values |= {name: changed["dc_power"] * values[name] for name in self.kind.lost}
        if "dc_charge" in changed:
            values["charge"] = changed["dc_charge"]
        if "irradiance" in changed:
            values["irradiance"] = changed["irradiance"]
        return replace(self, given=tuple(values.items()))

    def recharged(self, settings: DcSettings) -> Mapping[str, float]:
        """What the source remembers of its charge where an event has just set it, by the fields of its memory."""
        recharged = self.kind.recharged
        return {} if recharged is None else recharged(self.values["charge"], settings.source)

    def full(self, settings: DcSettings) -> tuple[str, float] | None:
        """The field of what the source remembers that has its charge, and its value of a full one. None: it has no
        charge, or one without a limit."""
        if self.kind.recharged is None:
            return None
        ((name, value),) = self.kind.recharged(1.0, settings.source).items()
        return None if value >= UNLIMITED_J else (name, float(value))

    def ratings(self, converter: Converter) -> DcRatings:
        """From which the source's constants follow."""
        bleed = math.inf if self.R_bleed is None else self.R_bleed
        limits = self.V_low, self.V_high, _needed(converter)
        return DcRatings(converter.T_s, converter.V_dc, self.C, bleed, converter.S_rated, *limits)

    def clamp(self, converter: Converter, filter_: Filter) -> ClampSettings:
        """The constants of the clamp. The current is at most its limit, or 1.5 times the rated one without a limit."""
        i_pk = (converter.current_limit_pu or 1.5) * converter.I_rated_pk
        bled = 0.0 if self.R_bleed is None else self.V_high**2 / self.R_bleed
        return ClampSettings(
            T_s=converter.T_s,
            own=SPACE_VECTOR_POWER * filter_.R_1 * i_pk * i_pk + bled,
            smoothing=low_pass_share(self.droop_time, converter.T_s),
            hold=self.hold,
        )

    def can_give(self, converter: Converter, filter_: Filter) -> SourceLimits:
        """What the source can give at the start, W."""
        settings, clamp = self.settings(converter, filter_), self.clamp(converter, filter_)
        memory = SimpleNamespace(**self.recharged(settings))
        found: SourceLimits = self.kind.law.can_give(memory, clamp.hold, settings.source)
        return found

    def settings(self, converter: Converter, filter_: Filter) -> DcSettings:
        """The constants of the link."""
        ratings = self.ratings(converter)
        return DcSettings(
            T_s=converter.T_s,
            over_C=1.0 / self.C,
            bleed=1.0 / ratings.R_bleed,
            V_dc=converter.V_dc,
            limit=linear_modulation_limit(1.0, converter.zero_sequence),
            R_1=filter_.R_1,
            over_L_1=1.0 / filter_.L_1,
            over_C_f=1.0 / filter_.C,
            R_c=filter_.R_c,
            source=self.kind.build(ratings, self.values),
        )

    def at_rest(self, p: float, converter: Converter, filter_: Filter) -> DcState:
        """The link while the bridge takes a power (W). Raises InfeasibleStudyError where the source cannot give it."""
        settings = self.settings(converter, filter_)
        try:
            v, memory = self.kind.rest(p, self.ratings(converter), settings.source, self.values)
        except ValueError as error:
            raise InfeasibleStudyError(
                f"dc: the bridge takes {p:.5g} W, and {error}. Ask for less power, or give a larger source."
            ) from error
        if not self.V_low <= v <= self.V_high:
            raise InfeasibleStudyError(
                f"dc: at {p:.5g} W the link rests at {v:.5g} V, and the bridge blocks below {self.V_low:.5g} V and "
                f"above {self.V_high:.5g} V. Ask for less power, or change the source."
            )
        return DcState(
            v=v, p=p, needs=0.0, spare=v, lowest=v, highest=v, least=p, most=p, given=0.0, taken=0.0, memory=memory
        )


def _needed(converter: Converter) -> float:
    """Voltage of the link that the bridge needs for the rated voltage, V."""
    return rms_to_peak(converter.V_rated_rms) / linear_modulation_limit(1.0, converter.zero_sequence)


def read_dc(table: TableReader | None, converter: Converter) -> DcLink | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    own = values(_Link, table, {V_DC.of: converter.V_dc}) | values(_Control, table)
    for name, of in _OF_CONTROLS.items():
        child = table.child(name)
        if child is not None and own["control"] != name:
            table.fault(name, None, f'control = "{own["control"]}" does not read this table', "Remove it.")
        own |= values(of, child or TableReader({}, table.name(name), table.faults))
        if child is not None:
            child.finish()
    if own["control"] != VOLTAGE_DROOP:
        own["share"] = 0.0
    ratings = DcRatings(
        converter.T_s,
        converter.V_dc,
        own["C"] or math.nan,
        own["R_bleed"] or math.inf,
        converter.S_rated,
        V_needed=_needed(converter),
    )
    source, given = DC_SOURCES.get(own["source"]), {}
    if source is not None:
        given = _read_source(table, source, ratings)
    for name in DC_SOURCES:
        if name != own["source"] and table.has(name):
            problem = f'source = "{own["source"]}" does not read this table'
            table.fault(name, None, problem, f"Remove it, or give [dc.{own['source']}].")
            table.skip(name)
    table.finish()
    return DcLink(**own, given=tuple(given.items()))


def _read_source(table: TableReader, source: DcSource, ratings: DcRatings) -> dict[str, Any]:
    child = table.child(source.name) or TableReader({}, table.name(source.name), table.faults)
    written = values(parameter_fields(source), child)
    child.finish()
    if table.faults:
        return {}
    found = source.values(
        ratings, {name: value for name, value in written.items() if value is not None and value != ()}
    )
    for name, problem in (source.check(ratings, found) if source.check else {}).items():
        child.fault(name, written.get(name), problem, "")
    return found


def _check_in_plant(root: TableReader, where: str, dc: DcLink | None) -> None:
    """What the dc link of a unit of a plant does not have. ``where``: it is."""
    if dc is not None and not dc.compensates:
        problem = "the units of a plant compensate the voltage of their links"
        root.fault(f"{where}.compensation", dc.compensation, problem, f'Give compensation = "{MEASURED}".')
    if dc is not None and dc.droops:
        problem = "the units of a plant do not turn with the voltages of their links"
        root.fault(f"{where}.control", dc.control, problem, f'Give control = "{NONE}" or "{POWER_CLAMP}".')


def not_of(dc: DcLink | None, quantity: str) -> str | None:
    """Why no event changes a quantity of DC_QUANTITIES in a study with this link; None: one may."""
    if dc is None:
        return "the dc link is ideal: the study has no [dc]"
    names = {one.name for one in dc.kind.parameters}  # also where their values have faults
    known = {"dc_power": bool(dc.kind.lost), "dc_charge": "charge" in names, "irradiance": "irradiance" in names}
    return None if known[quantity] else f'source = "{dc.source}" has no {quantity.removeprefix("dc_")}'


def check_links(
    root: TableReader,
    dc: DcLink | None,
    plant: PowerPlant | None,
    events: Iterable[Event],
    families: Mapping[str, Any],
) -> None:
    """What the link of the study does not have in a plant, and events and families of [verification] that change a
    source which is not there. An event without a unit is one of every unit with such a source."""
    links = {"": dc}
    if plant is not None:
        _check_in_plant(root, "dc", dc)
        for one in (one for one in plant.units if one.dc != dc):
            _check_in_plant(root, f'network.units["{one.name}"].dc', one.dc)
        links = {one.name: one.dc for one in plant.units}

    def none_has(quantity: str, unit: str | None = None) -> str | None:
        asked = list(links.values()) if unit not in links else [links[unit]]
        why = [not_of(one, quantity) for one in asked]
        return None if None in why else why[0]

    for event in events:
        for quantity, value in event.of_dc.items():
            if (why := none_has(quantity, event.element)) is not None:
                when = "" if math.isnan(event.t_s) else f" at {event.t_s:g} s"  # a faulty time has its own fault
                root.fault(f"events.{quantity}", f"{value:g}{when}", why, "Take it away, or change [dc].")
    for quantity in DC_QUANTITIES:
        weight = families[quantity].weight if quantity in families else None
        if weight and (why := none_has(quantity)) is not None:
            root.fault(f"verification.{quantity}.weight", f"{weight:g}", why, "Set it to 0, or change [dc].")


def without_voltage_droop(study: Study, what: str) -> None:
    """Refuses a study whose frequency follows its link. ``what``: what does not know the link's voltage."""
    if study.dc is not None and study.dc.droops:
        problem = f"{what} knows no voltage of the link, on which the frequency depends"
        advice = 'Set control = "none" or "power_clamp"; margins, simulate and verify have this voltage as a state.'
        raise StudyError(study.name, [Fault("dc.control", f'"{VOLTAGE_DROOP}"', problem, advice)])


__all__ = [
    "DC",
    "DcLink",
    "check_links",
    "not_of",
    "read_dc",
    "without_voltage_droop",
]
