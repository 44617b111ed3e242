"""Where a dc link starts, and what a run says of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.dc_control import ClampSettings, ClampState, DroopSettings, clamped_rest
from vsgdesign.equations.dc_link import DcSettings, DcState
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.linear.operating_point.dc_rest import power_of_plant
from vsgdesign.simulation.dc_parts import dc_kind
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.reader import format_quantity
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


class DcStart(NamedTuple):
    """The numbers of a link before the first sample, by their names in a loop."""

    link: DcSettings
    dc: DcState
    clamp: ClampState
    clamp_of: ClampSettings
    droop_of: DroopSettings


def dc_at_start(study: Study, plant: Array, omega: float) -> DcStart:
    """The link at the start of a run, whose source has this frequency (rad/s). ``plant`` (6,): i_s, v_c and i_g as
    (α, β), peak.

    Raises InfeasibleStudyError where what feeds the link cannot give the power."""
    if study.dc is None:
        raise ValueError("the dc link is ideal.")
    p = float(power_of_plant(study, plant))
    of = study.converter, study.filter
    clamp, droop = study.dc.clamp(*of), study.dc.droop(study.converter)
    return DcStart(study.dc.settings(*of), study.dc.at_rest(p, *of), clamp_at_rest(omega), clamp, droop)


def clamp_at_rest(omega: float) -> ClampState:
    """Nothing has been counted yet."""
    return ClampState(omega=omega, cut=0.0, most=0.0, missing=0.0, acted=0.0)


def dc_changed(study: Study, link: DcLink, changed: Mapping[str, float]) -> Iterator[tuple[str, Array]]:
    """What a loop gets where events have changed the source: (name of the first number, numbers). ``link``: with all
    changes up to now; ``changed``: those of this instant, by the names of DC_QUANTITIES."""
    settings = link.settings(study.converter, study.filter)
    yield "link", np.array(numbers_of(settings))
    if "dc_charge" in changed:
        for name, value in link.recharged(settings).items():
            yield f"dc.memory.{name}", np.array([value])


def dc_columns(study: Study) -> tuple[str, ...]:
    """What ``dc_log`` of a run has: the numbers of :class:`vsgdesign.equations.dc_link.DcState`, and where the
    controller clamps its power, those of :class:`vsgdesign.equations.dc_control.ClampState`."""
    kind = dc_kind(study.dc)
    return () if kind is None else tuple(name.removeprefix("dc.") for name in kind.logged)


BLOCKS_AT = "the bridge blocks at {:.4g} s"
"""What is said of a bridge that blocks: its time in the run, s."""


def blocked(link: DcLink, lowest: float, highest: float) -> str | None:
    """Why the bridge blocks whose link was so low and so high, V; None: it does not."""
    if not link.blocks:
        return None
    if lowest < link.V_low:
        return f"the dc link fell below V_low = {link.V_low:.5g} V"
    if highest > link.V_high:
        return f"the dc link rose above V_high = {link.V_high:.5g} V"
    return None


def rows_before_block(study: Study, rows: Array) -> int:
    """How many rows of ``dc_log`` come before the bridge blocks."""
    if study.dc is None or not study.dc.blocks:
        return len(rows)
    names = dc_columns(study)
    low, high = (rows[:, names.index(name)] for name in ("lowest", "highest"))
    bad = (low < study.dc.V_low) | (high > study.dc.V_high)
    return int(np.argmax(bad)) if bad.any() else len(rows)


def dc_series(study: Study, rows: Array) -> dict[str, Array]:
    """Named quantities of ``dc_log``: ``v_dc`` (V), ``P_dc`` (mean power of the bridge in the sample before each row,
    W), the energies that the source has given and the bridge has taken since the start (``E_source``, ``E_bridge``, J),
    what the source remembers, such as ``dc_charge``, and by how much the controller changed P_ref (``P_cut``, W)."""
    named = {"v": "v_dc", "p": "P_dc", "given": "E_source", "taken": "E_bridge", "clamp.cut": "P_cut"}
    found = {}
    for name, values in zip(dc_columns(study), rows.T, strict=True):
        if name in named:
            found[named[name]] = values.copy()
        elif name.startswith("memory."):
            found[f"dc_{name.removeprefix('memory.').replace('.', '_')}"] = values.copy()
    return found


class MovedRest(NamedTuple):
    """Where a clamped converter rests while its charge moves, W."""

    P: Array
    """With the charge of each row of ``dc_log``."""
    P_start: float
    """With the charge of the link that is given."""


def moved_rest(study: Study, link: DcLink | None, rows: Array) -> MovedRest | None:
    """Where a clamped converter rests with the charge that it has in each row of ``dc_log``, and with that of ``link``.
    None where the clamp does not act at the end."""
    if link is None or not link.clamps or not len(rows):
        return None
    columns = dict(zip(dc_columns(study), rows.T, strict=True))
    end, of = float(columns["clamp.cut"][-1]), (study.converter, study.filter)
    if end == 0.0:
        return None
    memory = {name.removeprefix("memory."): values for name, values in columns.items() if name.startswith("memory.")}
    clamp = link.clamp(*of)
    limits = link.kind.law.can_give(SimpleNamespace(**memory), clamp.hold, link.settings(*of).source)
    low, high = (np.broadcast_to(one, len(rows)) for one in limits)
    wanted = float(low[-1] if end > 0.0 else high[-1] - clamp.own) - end
    moved: Array = clamped_rest(wanted, SourceLimits(low, high), clamp.own)
    return MovedRest(moved, float(clamped_rest(wanted, link.can_give(*of), clamp.own)))


@dataclass(frozen=True)
class DcFigures:
    """What a run asked of its dc link, of every sample up to its end, or to the one before the bridge blocks."""

    lowest_v: float
    highest_v: float
    """Voltages of the link, V."""
    spare_v: float
    """By how much the link had more voltage than the bridge needed, at least, V; below zero where the bridge was at its
    limit."""
    least_p_w: float
    most_p_w: float
    """Mean powers of the bridge in a sample, W."""
    given_j: float
    """Energy that the source has given from the start to the end, J."""
    end: dict[str, float]
    """The link's voltage (``v_dc``, V) and what its source remembers at the end."""
    cut_most_w: float | None = None
    cut_j: float | None = None
    cut_s: float | None = None
    """By how much the controller changed P_ref to what the source can give: at most, W, its integral, J, and for how
    long, s. None: it does not."""

    @property
    def cut_words(self) -> str:
        """The same in words; empty where nothing was cut."""
        if not self.cut_s or self.cut_most_w is None or self.cut_j is None:
            return ""
        most, energy = (
            format_quantity(float(f"{value:.3g}"), unit) for value, unit in ((self.cut_most_w, "W"), (self.cut_j, "J"))
        )
        return f"up to {most} of what was asked for was missing, {energy} in {self.cut_s:.3g} s"


def dc_figures(study: Study, row: Array | None) -> DcFigures | None:
    """The figures of a run from the last row that counts of ``dc_log``; None where the link is ideal."""
    if study.dc is None or row is None or not len(row):
        return None
    last = dict(zip(dc_columns(study), row.tolist(), strict=True))
    end = {name: float(values[0]) for name, values in dc_series(study, row[None]).items() if name not in _SUMS}
    return DcFigures(
        lowest_v=last["lowest"],
        highest_v=last["highest"],
        spare_v=last["spare"],
        least_p_w=last["least"],
        most_p_w=last["most"],
        given_j=last["given"],
        end=end,
        cut_most_w=last.get("clamp.most"),
        cut_j=last.get("clamp.missing"),
        cut_s=last.get("clamp.acted"),
    )


_SUMS = ("P_dc", "E_source", "E_bridge", "P_cut")
