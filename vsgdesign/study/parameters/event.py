"""What changes at one instant of a study.

An :class:`Event` says what changes: set points of the controller, the source, the grid, or what is connected to it.
Studies, suites of grid-code tests, verifications, survival cases and the explorer have the same events.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from vsgdesign.equations.power_loops import References
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.event_kinds import DC_QUANTITIES, EVENT_KINDS, EventKind
from vsgdesign.study.parameters.grid import Grid, Network, Place, Sag, SourceComponent, SynchroCheck
from vsgdesign.study.parameters.network_fields import (
    NOTHING_SAID,
    OPEN,
    Said,
    fault_document,
    fault_in_si,
    load_document,
    sag_document,
    synchro_check_document,
)

BASIS = "impedance"
"""Basis of every short-circuit ratio of an event per unit: then |Z| does not depend on X/R, and X/R may go down to
zero."""


@dataclass(frozen=True)
class Event:
    """The changes at one instant. None means that a quantity does not change.

    The quantities are in SI. With ``per_unit`` they serve every converter: they are those of a suite, as
    :attr:`vsgdesign.study.parameters.event_kinds.EventKind.of_suite` says, and :meth:`on` makes an event in SI of them.
    """

    t_s: float
    name: str = ""
    grid: Grid | None = None
    V_g_rms: float | None = None
    omega_g: float | None = None
    over: float = 0.0
    """Duration of a linear ramp of V_g_rms and omega_g, s. Zero means a step."""
    phase_jump: float = 0.0
    P_ref: float | None = None
    Q_ref: float | None = None
    omega_0: float | None = None
    V_n: float | None = None
    """With P_ref and Q_ref the set points of the power loops (:class:`vsgdesign.equations.power_loops.References`)."""
    dc_power: float | None = None
    """What is left of the source of the dc link, as a share of what the study gives it."""
    dc_charge: float | None = None
    """State of charge of this source."""
    irradiance: float | None = None
    """On its array, W/m²."""
    components: tuple[SourceComponent, ...] | None = None
    """The source's components from now on, in place of all earlier ones."""
    network: Network | None = None
    """Load, fault and breaker from now on, in place of all earlier ones."""
    synchro_check: SynchroCheck | None = None
    """From now on, the breaker waits to close (:func:`vsgdesign.simulation.search.reclosed`)."""
    synchronised_until: float | None = None
    """From now on until this time, s, the converter sets itself to the grid behind its open breaker. Infinite: it is
    not known yet when the breaker closes. None: it does not."""
    place: Place | None = None
    """The grid by its short-circuit ratio, of an event per unit: ``grid`` on any converter."""
    sag: Sag | str | None = None
    """A voltage sag from now on, or the word for its end. In a study it has become V_g_rms, phase_jump and components
    (:func:`vsgdesign.study.parameters.events.settled`)."""
    switched: Said = NOTHING_SAID
    """What is connected or taken away of load, fault and breaker. In a study it has become ``network``."""
    per_unit: bool = False
    element: str | None = None
    """What of a plant it changes, by its name: the set points or the breaker of a unit, the breaker of anything else,
    or a fault at a node; ``switched`` has the last two. None: the grid, its PCC, and the set points of all units."""

    @classmethod
    def of_pu(
        cls,
        t_s: float,
        *,
        scr: float | None = None,
        x_over_r: float | None = None,
        df_hz: float | None = None,
        over_s: float = 0.0,
        phase_deg: float = 0.0,
        **values: Any,
    ) -> Event:
        """An event per unit of any converter.

        ``scr`` and ``x_over_r``: of the grid, both or none. ``df_hz``: new frequency above nominal. ``values``: other
        quantities by their names in a suite (V_g_pu, P_pu, …), ``load``, ``fault`` and ``breaker`` with elements in pu
        or with the words of a study file, and fields of this class.
        """
        if (scr is None) != (x_over_r is None):
            raise ValueError("scr and x_over_r of an event: give both or none.")
        place = None if scr is None or x_over_r is None else Place(scr, x_over_r, BASIS)
        given = {kind.quantity: values.pop(kind.of_suite.name, kind.nothing) for kind in EVENT_KINDS.values()}
        given |= {"omega_g": df_hz, "phase_jump": math.radians(phase_deg)}
        switched = Said(*(values.pop(name, None) for name in Said._fields))
        return cls(t_s, place=place, over=over_s, switched=switched, per_unit=True, **given, **values)

    @property
    def df_hz(self) -> float | None:
        """New frequency above nominal, Hz, of an event per unit."""
        return self.omega_g

    @property
    def phase_deg(self) -> float:
        """The jump of the phase in degrees, to twelve digits: 30 is 30 again."""
        return float(f"{math.degrees(self.phase_jump):.12g}")

    @property
    def words_pu(self) -> str:
        """An event per unit in words, such as ``SCR 20, X/R 3, phase +30°``."""
        ramp = f" over {self.over:.3g} s" if self.over > 0.0 else ""
        parts = [] if self.place is None else [f"SCR {self.place.scr:.3g}, X/R {self.place.x_over_r:.3g}"]
        parts += [f"{self.element} is lost"] if self.element is not None and self.switched.breaker == OPEN else []
        parts += [f"{kind.of_suite.short(kind.value(self))}{ramp if kind.ramps else ''}" for kind in self.changed]
        return ", ".join(parts)

    @property
    def set_points(self) -> dict[str, float]:
        """The references that change, by their names in :class:`vsgdesign.equations.power_loops.References`."""
        given = {name: getattr(self, name) for name in References._fields}
        return {name: value for name, value in given.items() if value is not None}

    @property
    def of_dc(self) -> dict[str, float]:
        """What changes of the source of the dc link, by the names of :data:`DC_QUANTITIES`."""
        given = {name: getattr(self, name) for name in DC_QUANTITIES}
        return {name: value for name, value in given.items() if value is not None}

    @property
    def of_grid(self) -> bool:
        """Whether the grid or its source changes, and not only a reference."""
        changed = (self.grid, self.place, self.V_g_rms, self.omega_g, self.components, self.network, self.sag)
        return self.phase_jump != 0.0 or self.switched != NOTHING_SAID or any(value is not None for value in changed)

    @property
    def changed(self) -> tuple[EventKind, ...]:
        """The kinds of the quantities that change."""
        return tuple(kind for kind in EVENT_KINDS.values() if kind.value(self) is not None)

    @property
    def end_s(self) -> float:
        """When the changes are over, with their ramp, s."""
        return self.t_s + self.over

    def on(self, converter: Converter, later_s: float = 0.0) -> Event:
        """An event per unit in SI on a converter, ``later_s`` later."""
        values = {kind.quantity: kind.on(kind.value(self), converter) for kind in self.changed}
        load, fault, breaker = self.switched
        if load is not None and not isinstance(load, str):
            load = load.in_si(converter.Z_base, converter.omega_n)
        if fault is not None and not isinstance(fault, str):
            fault = fault_in_si(fault, converter.Z_base)
        grid = self.grid if self.place is None else self.place.grid(converter)
        later: dict[str, Any] = {"t_s": later_s + self.t_s, "grid": grid, "place": None}
        return replace(self, **values, **later, switched=Said(load, fault, breaker), per_unit=False)

    def document(self, converter: Converter, later_s: float = 0.0) -> dict[str, Any]:
        """The event as a table of a study's [[events]], ``later_s`` later. Numbers are written so that reading gives
        the same bits. ``network`` and ``synchronised_until`` are not written."""
        found: dict[str, Any] = {"time": later_s + self.t_s} | ({"name": self.name} if self.name else {})
        found |= {} if self.element is None else {"element": self.element}
        grid = self.grid if self.place is None else self.place.grid(converter)
        if grid is not None:
            found["grid"] = {"R_g": grid.R_g, "L_g": grid.L_g}
        of_source, others = [], []
        for kind in self.changed:
            (others if kind.of_controller else of_source).append(kind)
        found |= {kind.name: kind.written(self, converter) for kind in of_source if kind.ramps}
        if self.over > 0.0:
            found["over"] = self.over
        found |= {kind.name: kind.written(self, converter) for kind in (*of_source, *others) if not kind.ramps}
        return found | self._connected_document()

    def _connected_document(self) -> dict[str, Any]:
        """Sag, fault, load, breaker and synchro-check."""
        found: dict[str, Any] = {}
        load, fault, breaker = self.switched
        if self.sag is not None:
            found["sag"] = self.sag if isinstance(self.sag, str) else sag_document(self.sag)
        if fault is not None:
            found["fault"] = fault if isinstance(fault, str) else fault_document(fault, per_unit=self.per_unit)
        if load is not None:
            found["load"] = load if isinstance(load, str) else load_document(load, per_unit=self.per_unit)
        if breaker is not None:
            found["breaker"] = breaker
        if self.synchro_check is not None:
            found["synchro_check"] = synchro_check_document(self.synchro_check)
        return found
