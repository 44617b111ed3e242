"""The dc side of a datasheet: what the source of the link gives and takes, and the capacitor."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vsgdesign.study.datasheet.rows import Rows
from vsgdesign.study.parameters.units import format_quantity

STORED_S = 0.01
"""What a capacitor that is not given stores, as a time at the rated power, s."""

_SECONDS_AN_HOUR = 3600.0


@dataclass(frozen=True, kw_only=True)
class DcSheet:
    """A source behind a dc–dc stage, in SI."""

    power: float
    """Largest power that it gives, W."""
    charge_power: float
    """Largest power that it takes, W."""
    C: float
    """Of the link, F."""
    energy: float | None
    """Usable energy, J; None: without a limit."""


def read_dc_side(rows: Rows, S: float, V_dc: float) -> DcSheet | None:
    """The dc side; None where the datasheet has no power of a source: the link is ideal. Its other rows are then listed
    as not used."""
    own = ("dc_charge_power", "dc_capacitor", "dc_energy")
    if "dc_power" not in rows.given:
        rows.unused += [rows.given[name].key for name in own if name in rows.given]
        return None
    power = _of(rows, "dc_power", ("W", "VA"), S)
    taken = 0.0
    if "dc_charge_power" in rows.given:
        taken = _of(rows, "dc_charge_power", ("W", "VA"), S)
    else:
        rows.assume("dc_charge_power", "none: the source takes no power from the grid")
    second = 2.0 * S / (V_dc * V_dc)  # what stores the rating for a second
    C = STORED_S * second
    if "dc_capacitor" in rows.given:
        C = _of(rows, "dc_capacitor", ("F",), second)
    elif math.isfinite(C):
        C = float(f"{C:.3g}")
        shown = format_quantity(C, "F")
        rows.assume(
            "dc_capacitor", f"{shown}, which stores {STORED_S * 1e3:g} ms of the rating; size finds the least one"
        )
    energy = None
    if "dc_energy" in rows.given:
        energy = _of(rows, "dc_energy", ("Wh", "J"), S)
    else:
        rows.assume("dc_energy", "without a limit")
    rows.assume("dc source", "behind a dc-dc stage that follows with 5 ms, and half full at the start")
    return DcSheet(power=power, charge_power=taken, C=C, energy=energy)


def _of(rows: Rows, name: str, bases: tuple[str, ...], scale: float) -> float:
    """A row in SI, within its limits times ``scale``; NaN where it is faulty."""
    amount = rows.amount(name, bases)
    if amount is None:
        return math.nan
    value = amount.value * (_SECONDS_AN_HOUR if amount.base == "Wh" else 1.0)
    return rows.within(name, value, {"Wh": "J", "VA": "W"}.get(amount.base, amount.base), scale)


__all__ = ["DcSheet", "read_dc_side"]
