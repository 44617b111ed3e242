"""What a run moved beyond its dc link, and whether the source could have done more (:eq:`dc-beyond`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of, record_like, zero_record
from vsgdesign.equations.dc_control import cut_of
from vsgdesign.simulation.dc_start import blocked, dc_columns
from vsgdesign.simulation.run import Simulation
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOT_ASKED = 1e-3
"""Share of the rating by which a clamped reference may lie outside of what its source can give. In the sample after it
the charge is another one: at most by that of LARGEST_PU."""

LARGEST_PU = 5.0
"""Power of a source that no study has, pu."""

CLAMP_LOOKS = 4
"""In every so-many-th look at the links of a batch its clamps are looked at, and where a link leaves its limits."""

LOOKED_AT = 100
"""Rows of a run in which its clamp is looked at, up to the one in which its bridge would have blocked."""


STIFF_S = 1e4
"""For how long the capacitor of a stiff link could give the rating, s."""


def stiff(study: Study) -> Study:
    """The study with a capacitor so large that the voltage of its link does not move: source and control are the same,
    and nothing but energy is given to it. So are the links of the units of a plant. An ideal link stays one, and a
    study that is stiff is returned as it is."""
    c = study.converter
    C = 2.0 * STIFF_S * c.S_rated / c.V_dc**2
    return _with_links(study, lambda link: link if link.C >= C else replace(link, C=C))


def _with_links(study: Study, change: Callable[[DcLink], DcLink]) -> Study:
    """The study with its dc link, and those of the units of a plant, changed; itself where no link changes."""

    def changed(link: DcLink | None) -> DcLink | None:
        return None if link is None else change(link)

    plant = study.plant
    units = () if plant is None else tuple(replace(one, dc=changed(one.dc)) for one in plant.units)
    dc = changed(study.dc)
    if dc is study.dc and (plant is None or units == plant.units):
        return study
    return replace(study, dc=dc, plant=None if plant is None else replace(plant, units=units))


class AtSource(NamedTuple):
    """N links at an instant: arrays (N,)."""

    highest: Any
    """Largest voltage of the link so far, V."""
    p: Any
    """Power that the bridge took in the sample before, W."""
    memory: Any
    """What the source remembers."""
    constants: Any
    """The source's own."""
    wanted: Any
    """What reference and P–f droop ask for, as the clamp limits them, W; NaN without a clamp."""


def at_source(link: DcLink, column: Callable[[str], Array]) -> AtSource:
    """The links with the numbers of a loop by their names (``dc.p``, ``link.source.…``), (N,) each."""
    found: list[Any] = []
    for kind, head in zip(link.kind.records, ("dc.memory", "link.source"), strict=True):
        like = zero_record(kind)
        columns: Any = map(column, _names(like, head))
        found.append(record_like(like, columns))
    memory, constants = found
    p = column("dc.p")
    wanted = np.full(p.shape, np.nan)
    if link.clamps:
        faster = column("refs.omega_0") - column("clamp.omega")
        wanted = column("refs.P_ref") + column("clamp.cut") + column("power_gains.D_p") * faster
    return AtSource(column("dc.highest"), p, memory, constants, wanted)


def _names(record: Any, head: str) -> Iterator[str]:
    """Names of every number of a record."""
    for name, value in record._asdict().items():
        if isinstance(value, tuple):
            yield from _names(value, f"{head}.{name}")
        else:
            yield f"{head}.{name}"


def asks_too_much(study: Study, link: DcLink, at: AtSource) -> Mask:
    """Whether a clamp asks for more than the source can give or take (:eq:`dc-clamp`), (N,). Without one, what is asked
    for is within the limits of the source at the rests before and after the events."""
    if not link.clamps:
        return np.zeros(np.shape(at.p), dtype=bool)
    clamp = link.clamp(study.converter, study.filter)
    can = link.kind.law.can_give(at.memory, clamp.hold, at.constants)
    slack = study.converter.S_rated * (NOT_ASKED + LARGEST_PU * study.converter.T_s / clamp.hold)
    return np.asarray(np.abs(cut_of(at.wanted, can, clamp.own)) > slack)


class Outside:
    """The links of N lanes when they are first seen outside of their limits."""

    def __init__(self, study: Study, names: Iterable[str], count: int) -> None:
        """``names``: of the numbers of the loop."""
        asked = ("dc.", "link.", "clamp.", "refs.", "power_gains.D_p")
        self._study = study
        self._rows = {name: np.full(count, np.nan) for name in names if name.startswith(asked)}
        self._inside, self._too_much = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
        self._looks = 0

    def look(self, get: Callable[[str], Array]) -> None:
        """Keeps the numbers of the lanes whose links have just been found outside. ``get`` gives a number of every
        lane. Where a clamp has asked for too much before, they stay NaN."""
        link = self._study.dc
        if link is None:
            return
        gone = (get("dc.lowest") < link.V_low) | (get("dc.highest") > link.V_high)
        new, self._looks = gone & self._inside, self._looks + 1
        if link.clamps and (new.any() or self._looks % CLAMP_LOOKS == 0):  # it takes longer than the rest of a look
            self._too_much |= self._inside & asks_too_much(self._study, link, at_source(link, get))
        new &= ~self._too_much
        self._inside &= ~gone
        for name, values in self._rows.items() if new.any() else ():
            values[new] = get(name)[new]

    def at(self, some: Mask) -> AtSource | None:
        """Those of some lanes; None with ideal links."""
        link = self._study.dc
        return None if link is None else at_source(link, lambda name: self._rows[name][some])


def energy_beyond(link: DcLink, at: AtSource, lowest: Array, highest: Array) -> Array:
    """The energy beyond the link's limits in runs that went on, J (N,): moved into it (positive), or drawn from it
    (negative). NaN where the source could have given or taken it (:eq:`dc-beyond`).

    ``at``: soon after the link left its limits. ``lowest``, ``highest``: its voltages over the whole run, V.
    """
    rose = np.asarray(at.highest > link.V_high)
    if link.kind.left is None:
        return np.full(rose.shape, np.nan)
    with np.errstate(all="ignore"):
        above = 0.5 * link.C * (highest**2 - link.V_high**2)
        below = 0.5 * link.C * (link.V_low**2 - lowest**2)
        left = link.kind.left(at.memory, np.where(rose, link.V_high, link.V_low), at.p, at.constants)
        held = np.where(rose, left.take < above, left.give < below)
    return np.where(held, np.where(rose, above, -below), np.nan)


def beyond_of_run(run: Simulation) -> float:
    """:func:`energy_beyond` of one run that went on beyond its limits; NaN where it did not leave them, and where its
    clamp had asked for too much."""
    study, rows = run.study, run.dc_log
    if study.dc is None or rows is None or not len(rows):
        return math.nan
    names, ends = dc_columns(study), replace(study.dc, blocks=True)
    low, high = (rows[:, names.index(name)] for name in ("lowest", "highest"))
    if blocked(ends, float(low[-1]), float(high[-1])) is None:
        return math.nan
    k = int(np.argmax((low < ends.V_low) | (high > ends.V_high)))
    first = int(np.searchsorted(run.t_s, max((t_s for t_s, _ in run.timeline.links), default=0.0))) + 1
    looked = np.unique(np.linspace(min(first, k), k, LOOKED_AT).astype(int)).tolist()
    if any(asks_too_much(study, study.dc, _at_row(run, row)).any() for row in looked):
        return math.nan
    return float(energy_beyond(study.dc, _at_row(run, k), low[-1:], high[-1:])[0])


def _at_row(run: Simulation, row: int) -> AtSource:
    """The link in a row of the log."""
    study, names, t_s = run.study, dc_columns(run.study), float(run.t_s[row])
    link = run.timeline.link_at(t_s)
    if run.dc_log is None or link is None:
        raise ValueError("the dc link is ideal.")
    refs = run.timeline.references_at(t_s)
    gains = [change.gains for change in run.gain_changes if change.t_s <= t_s or change.t_s == 0.0][-1]
    source: Any = link.settings(study.converter, study.filter).source
    known = dict(zip((f"dc.{name}" for name in names), run.dc_log[row].tolist(), strict=True))
    known |= {name.removeprefix("dc."): value for name, value in known.items() if name.startswith("dc.clamp.")}
    known |= dict(zip(_names(source, "link.source"), numbers_of(source), strict=True))
    known |= {"refs.omega_0": refs.omega_0, "refs.P_ref": refs.P_ref, "power_gains.D_p": gains.D_p}
    return at_source(link, lambda name: np.array([known[name]]))


def told_of_blocked(
    study: Study, run: Callable[[Study], Simulation | None], survives: Callable[[Study], bool]
) -> str | None:
    """What is told of a study whose bridge has blocked, where its source could do no more and the same events are
    survived on a :func:`stiff` link; None where this is not so. ``run``: the run of the study that is given, which goes
    on beyond its limits; None where there is none. ``survives``: whether a study is survived."""

    def runs(one: Study) -> dict[str, Simulation]:
        found = run(one)
        return {} if found is None else {"": found}

    return told_of_units(study, runs, survives).get("")


def told_of_units(
    study: Study, runs: Callable[[Study], Mapping[str, Simulation]], survives: Callable[[Study], bool]
) -> dict[str, str]:
    """:func:`told_of_blocked` of the units whose bridges have blocked, by their names: of all of them or of none.
    ``runs``: their runs in a plant; ``survives``: whether all units survive a study."""
    larger = stiff(study)
    if larger is study:
        return {}
    opened = runs(_with_links(study, lambda link: replace(link, blocks=False)))
    beyond = {name: beyond_of_run(one) for name, one in opened.items()}
    if not beyond or any(map(math.isnan, beyond.values())) or not survives(larger):
        return {}
    return {name: said_of_energy(energy) for name, energy in beyond.items()}


def said_of_energy(beyond: float) -> str:
    """What is told of events that move so much energy beyond a link, J (:func:`energy_beyond`)."""
    size = abs(beyond)
    energy = f"{size:.3g} J" if size < 1e3 else f"{1e-3 * size:.3g} kJ"
    if beyond > 0.0:
        what = f"the events move {energy} more into the dc link than its source and its capacitor can take"
    else:
        what = f"the events draw at least {energy} more from the dc link than its source and its capacitor can give"
    return f"not possible, because {what} ({SURVIVED_OTHERWISE})"


SURVIVED_OTHERWISE = "with a link whose voltage does not move, the same events are survived"
"""What is said besides the energy."""
