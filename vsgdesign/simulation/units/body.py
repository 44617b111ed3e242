"""The loop of a plant: at each instant the circuit arrives, then the converters that sample take their next step.

One sample of the loop is one instant of the plant's clock. Both axes of the circuit are alike, so one product of a
matrix with numbers of the state moves each of them: states of the circuit, bridge voltages that are held, and the
phasors of the sources.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import Part, Writer, abreast, joined, renamed, with_outputs
from vsgdesign.codegen.expressions import Expression, Number
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.loop_spec import LoopSpec, Product
from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.field import LockIn
from vsgdesign.simulation import circuit_sample, sample, watched_sample
from vsgdesign.simulation.axes import headed
from vsgdesign.simulation.bodies import applied_by, control, watch
from vsgdesign.simulation.circuit_sample import CarrierPart
from vsgdesign.simulation.loop import ALONE, Build, watched_names
from vsgdesign.simulation.run_kind import DISTURBANCE, STEP, Kind, names_of
from vsgdesign.simulation.sample import Measurement, Noise
from vsgdesign.simulation.units import carriers
from vsgdesign.simulation.units.carriers import OnCarrier
from vsgdesign.study.parameters.inverter_kinds import InverterKind

Array = NDArray[np.float64]

AXES = ("alpha", "beta")
SAID = ("P", "Q", "omega", "at_bridge")
"""What a unit said at its last sample."""

SAID_BY_OTHERS = ("P", "Q", "omega", "V", "theta", "limited", "at_bridge")
"""What another converter said at its last sample."""

ENDS = "ends"
"""Whether a cycle of a field estimator has ended at an instant: the loop ends there."""

ABREAST = 8
"""Most converters whose samples a plant in a loop with one lane takes at once."""

PHASORS = ("along", "across")
"""Of a source on an axis: its phasor there, and less its phasor a quarter turn before. On α (cos, sin), on β (sin,
−cos): then the same matrix moves both axes."""


class OtherKind(NamedTuple):
    """A converter that is no unit of ours."""

    kind: InverterKind
    delayed: bool


class PlantKind(NamedTuple):
    """What the loop of a plant depends on."""

    units: tuple[Kind, ...]
    states: tuple[str, ...]
    """Of the circuit, on each axis: i_s, v_c and i_g of each converter first."""
    sources: int
    sampling: tuple[tuple[int, ...], ...]
    """The converters that sample at each instant of the clock's period."""
    turns: int
    """Matrices: one for each instant, or one for all where they are equally far apart."""
    others: tuple[OtherKind, ...] = ()
    """Behind the units."""
    added: bool = False
    """Whether the grid's source has more than its fundamental, which is then fed."""
    common: bool = False
    """Whether all units share the field estimator of the first one, which hears the mean of those on line."""
    switched: bool = False
    """Whether dc links need the integrals of the converters' currents, because the circuit is switched in the run."""
    gaps: tuple[tuple[OnCarrier, ...], ...] = ()
    """Of units with switched bridges: where the gap after each instant lies on the carrier of each. ``sampling`` is
    then over the time after which the carriers repeat."""
    degree: int = 0
    """Of the responses to edges."""

    @property
    def converters(self) -> int:
        """How many there are."""
        return len(self.units) + len(self.others)

    def delayed(self, k: int) -> bool:
        """Whether the bridge voltage of a converter waits for a sample."""
        count = len(self.units)
        return self.units[k].bridge.delayed if k < count else self.others[k - count].delayed

    @property
    def arrives(self) -> str:
        """The head of the states at an instant."""
        return "arrived" if self.added else "now"

    @property
    def fed(self) -> tuple[str, ...]:
        """What is fed: increments of the states, α and β in turn, and a voltage of the source; the noise of sensors."""
        more = (*self.states, "v_g") if self.added else ()
        noise = (names_of(Noise, f"u{k}.noise") for k, unit in enumerate(self.units) if unit.sensors)
        return (*(f"more.{axis}.{name}" for name in more for axis in AXES), *itertools.chain.from_iterable(noise))

    @property
    def moved(self) -> tuple[str, ...]:
        """What a product moves on one axis."""
        return (*self.states, *(f"source{s}.{part}" for s in range(self.sources) for part in PHASORS))

    @property
    def factors(self) -> tuple[str, ...]:
        """What it is made of."""
        held = (f"held.{k}" for k in range(self.converters))
        powers = range(self.degree + 1) if self.gaps else ()
        edges = (f"edges{k}.{power}" for k in range(len(self.units)) for power in powers)
        return (*self.moved, *held, *edges)

    def switches(self, k: int) -> bool:
        """Whether a converter has a switched bridge."""
        return bool(self.gaps) and k < len(self.units)

    @property
    def cyclic(self) -> tuple[str, ...]:
        """Where a gap lies on the carriers."""
        units = range(len(self.units)) if self.gaps else ()
        return tuple(name for k in units for name in names_of(CarrierPart, f"u{k}.part"))

    @property
    def cycle(self) -> list[tuple[tuple[int, ...], tuple[str, ...]]]:
        """What distinguishes the instants, over the time after which they repeat: who samples, and where the gap
        behind it lies on the carriers."""
        slopes = [tuple(one.slope for one in some) for some in self.gaps]
        return list(zip(self.sampling, slopes or [()] * len(self.sampling), strict=True))

    @property
    def listens(self) -> bool:
        """Whether a unit has a field estimator."""
        return any(unit.field for unit in self.units)

    @property
    def terminals(self) -> tuple[str, ...]:
        """The voltages at the terminals of the units whose steps are watched, which a product gives, too."""
        return tuple(f"terminal{k}" for k, unit in enumerate(self.units) if unit.watch == STEP)

    @property
    def linked(self) -> tuple[int, ...]:
        """The units whose dc links need these integrals."""
        return tuple(k for k, unit in enumerate(self.units) if self.switched and unit.dc is not None)

    @property
    def results(self) -> tuple[str, ...]:
        """All that a product gives on one axis."""
        return (*self.moved, *self.terminals, *(f"charge{k}" for k in self.linked))

    @property
    def rings(self) -> tuple[tuple[str, str], ...]:
        """Powers that are read again some samples later: (input, output)."""
        of_units = ((f"u{k}.{one}", f"u{k}.{other}") for k, unit in enumerate(self.units) for one, other in unit.rings)
        return tuple(of_units)

    @property
    def matrix(self) -> tuple[str, ...]:
        """Every number of the matrices, column by column."""
        columns, rows = range(len(self.factors)), range(len(self.results))
        return tuple(f"m_{turn}_{row}_{k}" for turn in range(self.turns) for k in columns for row in rows)


def log_names(kind: PlantKind) -> tuple[str, ...]:
    """What is logged at an instant: LOG_COLUMNS of each converter, then the other states of the circuit, then the dc
    links."""
    found: list[str] = []
    for k in range(kind.converters):
        found += [f"next.{axis}.{state}" for state in kind.states[3 * k : 3 * k + 3] for axis in AXES]
        found += [f"v_g.{axis}" for axis in AXES]
        found += [f"next.u{k}.last.{name}" for name in SAID[:3]]
        if k < len(kind.units):
            found += [f"u{k}.state.V", f"u{k}.state.theta", f"next.u{k}.limited"]
        else:
            found += [f"next.u{k}.last.{name}" for name in ("V", "theta", "limited")]
        found.append(f"next.u{k}.last.at_bridge")
    found += [f"next.{axis}.{state}" for state in kind.states[3 * kind.converters :] for axis in AXES]
    return (*found, *(name for k in range(len(kind.units)) for name in link_names(kind, k)))


def mean_names(kind: PlantKind) -> tuple[str, ...]:
    """What is logged of units that are watched and judged by the rest to which they come: the power of a step, the sums
    of both powers of anything else."""
    own = {STEP: ("u{}.power",), DISTURBANCE: ("next.u{}.watch.sum_P", "next.u{}.watch.sum_Q")}
    units = ((k, unit) for k, unit in enumerate(kind.units) if unit.own_rest)
    return tuple(name.format(k) for k, unit in units for name in own[unit.watch])


def link_names(kind: PlantKind, k: int) -> list[str]:
    """What is logged of the dc link of a unit: as it was at its last sample. None where it is ideal."""
    dc = kind.units[k].dc
    if dc is None:
        return []
    return [*(f"next.u{k}.{name}" for name in dc.state), *(f"u{k}.{name}" for name in dc.clamp)]


@functools.lru_cache(maxsize=64)
def spec_of_plant(kind: PlantKind, build: Build = ALONE) -> LoopSpec:
    """The loop of a plant, strict: every operation rounds by itself. Of one that is watched nothing but means is
    logged."""
    moved = _moved(kind)
    logged = mean_names(kind) if any(unit.watch for unit in kind.units) else log_names(kind)
    stop = ENDS if kind.listens else ""
    outputs = (*(output for _, output in moved), *(name for name in logged if name not in dict(moved)))
    outputs += tuple(output for _, output in kind.rings)
    outputs += (stop,) if stop else ()
    most = ABREAST if build.lanes * build.vectors == 1 else 1
    bodies = tuple(with_outputs(_body(kind, *one, moved, most), outputs) for one in dict.fromkeys(kind.cycle))
    placed = {name for name, _ in moved} | {name for axis in AXES for name in _results(kind, axis)} | set(kind.fed)
    placed |= {"k", *(name for name, _ in kind.rings), *kind.cyclic}
    inputs = dict.fromkeys(name for one in bodies for name in one.inputs)
    rest = [name for name in inputs if name not in placed and ".watch." not in name]  # what is not watched is not read
    of_all = (".settings.", ".inner_gains.", ".R_c", ".field.", ".V_rated_rms", ".V_dc", ".allowed")
    of_links = [f"u{k}.{name}" for k, one in enumerate(kind.units) if one.dc is not None for name in one.dc.settings]
    links = [name for name in of_links if name in inputs]  # in the order of their records
    rest = [name for name in rest if name not in links]
    shared = {name for name in rest if any(one in name for one in of_all)}
    return LoopSpec(
        bodies=bodies,
        state=tuple(moved),
        constant=(*kind.matrix, *(name for name in rest if name not in shared), *links),
        uniform=tuple(name for name in rest if name in shared),
        products=tuple(
            Product(_results(kind, axis), kind.matrix, tuple(f"{axis}.{name}" for name in kind.factors), kind.turns)
            for axis in AXES
        ),
        cyclic=kind.cyclic,
        fed=kind.fed,
        rings=kind.rings,
        logged=logged,
        index="k" if "k" in inputs else "",
        stop=stop,
        lanes=build.lanes,
        vectors=build.vectors,
        strict=True,
    )


def cyclic_values(kind: PlantKind) -> Array:
    """What depends on an instant's place in the time after which they repeat: ``kind.cyclic``, (instants, n)."""
    return np.array([[number for one in some for number in one.part] for some in kind.gaps])


def body_numbers(kind: PlantKind) -> list[int]:
    """The number of the body for each instant of the clock's period."""
    distinct = list(dict.fromkeys(kind.cycle))
    return [distinct.index(one) for one in kind.cycle]


def _results(kind: PlantKind, axis: str) -> tuple[str, ...]:
    return tuple(f"now.{axis}.{name}" for name in kind.results)


def _moved(kind: PlantKind) -> list[tuple[str, str]]:
    """(input, output) of everything that an instant moves; what is moved on an axis lies side by side."""
    found = [f"{axis}.{name}" for axis in AXES for name in kind.factors]
    for k, unit in enumerate(kind.units):
        own = [*unit.names(ControllerState, "state"), "limited", *(f"last.{name}" for name in SAID)]
        own += [f"pending.{axis}" for axis in AXES] if unit.bridge.delayed else []
        own += names_of(Measurement, "before") if unit.sensors else []
        own += names_of(LockIn, "lock") if unit.field and (k == 0 or not kind.common) else []
        own += watched_names(unit)
        own += [*unit.dc.logged, *unit.dc.kept] if unit.dc is not None else []
        own += [f"charge.{axis}" for axis in AXES] if k in kind.linked else []
        own += [f"acts.{axis}" for axis in AXES] if kind.switches(k) else []
        found += [f"u{k}.{name}" for name in own]
    for k, other in enumerate(kind.others, len(kind.units)):
        own = [*names_of(other.kind.state, "state"), *(f"last.{name}" for name in SAID_BY_OTHERS)]
        own += [f"pending.{axis}" for axis in AXES] if other.delayed else []
        found += [f"u{k}.{name}" for name in own]
    return [(name, f"next.{name}") for name in found]


def _body(
    kind: PlantKind,
    sampling: Sequence[int],
    slopes: Sequence[str],
    moved: list[tuple[str, str]],
    most: int,
) -> Block:
    """One instant at which some converters sample, ``most`` of them at once, with what switched bridges do after it."""
    parts = [Part(_arrived(kind))] if kind.added else []
    parts += [Part(_charged(kind))] if kind.linked else []
    parts += _samples(kind, sampling, most)
    parts += _heard_in_common(kind) if kind.common else []
    after: dict[str, str] = {}
    for axis in AXES:
        after |= {f"{axis}.{name}": f"now.{axis}.{name}" for name in kind.moved}
        after |= {f"{axis}.{name}": f"{kind.arrives}.{axis}.{name}" for name in kind.states}
        after |= {f"u{k}.charge.{axis}": f"u{k}.charge_now.{axis}" for k in kind.linked}
    for k in sampling:
        after |= _following(kind, k)
    if slopes:
        parts += _switched(kind, slopes, after, most)
        for k, axis in itertools.product(range(len(kind.units)), AXES):
            after[f"{axis}.held.{k}"] = f"u{k}.first.{axis}"
            after |= {f"{axis}.edges{k}.{j}": f"u{k}.power.{j}.{axis}" for j in range(kind.degree + 1)}
    line = Writer()
    for name, _ in moved:
        line.input(name)
    for axis in AXES:
        for name in kind.moved:
            line.input(f"now.{axis}.{name}")
        v_g = line.does("*", line.input("V_g"), line.input(f"now.{axis}.source0.along"))
        line.output(f"v_g.{axis}", line.does("+", v_g, line.input(f"more.{axis}.v_g")) if kind.added else v_g)
    for name, output in moved:
        line.output(output, line.input(after.get(name, name)))
    if kind.listens:
        ended: Expression = line.does("*", Number(0.0), line.input("V_g"))
        for k in (k for k in sampling if k < len(kind.units) and kind.units[k].field):
            ended = line.does("max", ended, line.input("common.closed" if kind.common else f"u{k}.closed"))
        line.output(ENDS, ended)
    return joined(*parts, Part(line.block()))


def _arrived(kind: PlantKind) -> Block:
    """The circuit's states with what is fed."""
    line = Writer()
    for axis in AXES:
        for name in kind.states:
            own = line.does("+", line.input(f"now.{axis}.{name}"), line.input(f"more.{axis}.{name}"))
            line.output(f"arrived.{axis}.{name}", own)
    return line.block()


def _charged(kind: PlantKind) -> Block:
    """The integrals of the converters' currents since the samples of their units."""
    line = Writer()
    for k in kind.linked:
        for axis in AXES:
            own = line.does("+", line.input(f"u{k}.charge.{axis}"), line.input(f"now.{axis}.charge{k}"))
            line.output(f"u{k}.charge_now.{axis}", own)
            line.output(f"u{k}.uncharged.{axis}", line.does("*", Number(0.0), own))
    return line.block()


def _samples(kind: PlantKind, sampling: Sequence[int], most: int) -> list[Part]:
    """The samples of converters."""
    alike: dict[Hashable, list[int]] = {}
    for k in sampling:
        count = len(kind.units)
        alike.setdefault(kind.units[k] if k < count else (kind.others[k - count],), []).append(k)
    some = ((_sampled(kind, own[0]), [functools.partial(_called, kind, k) for k in own]) for own in alike.values())
    return [part for block, names in some for part in _at_once(block, names, most)]


def _switched(kind: PlantKind, slopes: Sequence[str], after: Mapping[str, str], most: int) -> list[Part]:
    """The legs of the units over the gap after an instant. ``after``: where the voltages that act are."""
    alike: dict[tuple[str, bool], list[int]] = {}
    for k, slope in enumerate(slopes):
        alike.setdefault((slope, kind.units[k].bridge.zero_sequence), []).append(k)

    def called(k: int, name: str) -> str:
        return after.get(f"u{k}.{name}", f"u{k}.{name}")

    parts = []
    for (slope, zero_sequence), own in alike.items():
        block = carriers.legs(slope, kind.degree, zero_sequence=zero_sequence)
        parts += _at_once(block, [functools.partial(called, k) for k in own], most)
    return parts


def _at_once(block: Block, names: Sequence[Callable[[str], str]], most: int) -> Iterator[Part]:
    """The block for several converters, as many as ``most`` of them at once."""
    for first in range(0, len(names), most):
        some = names[first : first + most]
        width = 1 << (len(some) - 1).bit_length()
        yield Part(abreast(block, some, width) if width > 1 else renamed(block, some[0]))


def _sampled(kind: PlantKind, k: int) -> Block:
    """The sample of a converter, with what is watched of it."""
    if k < len(kind.units):
        own = kind.units[k]
        seen = _watched_step() if own.watch == STEP else watch(own)
        block = control(own) if seen is None else joined(Part(control(own)), Part(seen))
        return block if own.dc is None else own.dc.at_sample(block, applied_by(own), switched=kind.switched)
    own = flat_block(kind.others[k - len(kind.units)].kind.sample)
    measured = headed(flat_block(circuit_sample.measured_by), measurement="measured")
    return joined(Part(measured), Part(headed(own, following="following", said="said")))


def _heard_in_common(kind: PlantKind) -> list[Part]:
    """The one estimator of all units hears the means of the units on line (:eq:`plant-common-estimate`)."""
    parts, line = [], Writer()
    measured = [f"{name}_{axis}" for name in ("v", "i_s", "i_g") for axis in AXES]
    of_units = range(len(kind.units))
    for k in of_units:
        called = {"theta": f"u{k}.commanded_theta", "u_d": f"u{k}.u_d", "u_q": f"u{k}.u_q"}
        sent = headed(flat_block(sample.sent_at), turned_x=f"u{k}.sent_alpha", turned_y=f"u{k}.sent_beta")
        parts.append(Part(sent, called))
    for name in (*(f"measured.{one}" for one in measured), *(f"sent_{axis}" for axis in AXES)):
        terms = (line.does("*", line.input(f"share.{k}"), line.input(f"u{k}.{name}")) for k in of_units)
        line.output(f"common.{name}", line.sum_of(*terms))
    acted = [line.does("*", line.input(f"share.{k}"), line.input(f"u{k}.said.limited")) for k in of_units]
    any_acted = line.does(">", line.sum_of(*acted), Number(0.0))
    line.output("common.acted", line.does("select", any_acted, Number(1.0), Number(0.0)))
    heard = headed(flat_block(sample.taken_in), heard="common.heard", closed="common.closed")
    called = {name: name.replace("lock.", "u0.lock.", 1) for name in names_of(LockIn, "lock")}
    called |= {name: f"common.{name}" for name in (*(f"measured.{one}" for one in measured), "acted")}
    called |= {f"sent_{axis}": f"common.sent_{axis}" for axis in AXES}
    called |= {name: name.replace("field.", "u0.field.", 1) for name in heard.inputs if name.startswith("field.")}
    return [*parts, Part(line.block()), Part(heard, called)]


def _watched_step() -> Block:
    """What is watched of a step: the power at the terminals, whose voltage a product gives."""
    at_terminals = {f"true.v_{axis}": f"terminal.{axis}" for axis in AXES}
    at_terminals |= {f"true.i_g_{axis}": f"x.i_g_{axis}" for axis in AXES}
    power = headed(flat_block(watched_sample.power_at_node), P="P_pcc", Q="Q_pcc")
    return joined(Part(power, at_terminals), Part(headed(flat_block(watched_sample.watched_step))))


def _called(kind: PlantKind, unit: int, name: str) -> str:
    """What a number of a converter's controller is called in the loop of the plant."""
    if name.startswith("x."):
        states = [f"{state}_{axis}" for state in ("i_s", "v_c", "i_g") for axis in AXES]
        at = states.index(name.removeprefix("x."))
        return f"{kind.arrives}.{AXES[at % 2]}.{kind.states[3 * unit + at // 2]}"
    shared = {"source.cosine": "now.alpha.source0.along", "source.sine": "now.beta.source0.along", "V_g": "V_g"}
    if kind.common and name.startswith(("lock.", "field.", "allowed")):
        return f"u0.{name}"
    shared |= {"k": "k"} | {f"held.{axis}": f"{axis}.held.{unit}" for axis in AXES}
    shared |= {f"terminal.{axis}": f"now.{axis}.terminal{unit}" for axis in AXES}
    return shared.get(name, f"u{unit}.{name}")


def _following(kind: PlantKind, k: int) -> dict[str, str]:
    """Where the numbers of a converter that samples come from."""
    found = {}
    if k < len(kind.units):
        found |= _following_of_unit(kind.units[k], k)
        if kind.common:
            found |= {name: name.replace(f"u{k}.lock", "common.heard", 1) for name in found if ".lock." in name}
    else:
        state = kind.others[k - len(kind.units)].kind.state
        found |= {
            f"u{k}.{name}": f"u{k}.{name.replace('state.', 'following.', 1)}" for name in names_of(state, "state")
        }
        found |= {f"u{k}.last.{name}": f"u{k}.said.{name}" for name in SAID_BY_OTHERS}
    for axis in AXES:
        asked, acts = f"u{k}.said.v_b_{axis}", f"u{k}.acts.{axis}" if kind.switches(k) else f"{axis}.held.{k}"
        if kind.delayed(k):
            found |= {acts: f"u{k}.pending.{axis}", f"u{k}.pending.{axis}": asked}
        else:
            found[acts] = asked
    if k < len(kind.units):
        found |= _following_of_link(kind, k)
    return found


def _following_of_link(kind: PlantKind, k: int) -> dict[str, str]:
    """Where the numbers of its dc link come from, and what the link leaves of the voltage of its bridge."""
    unit = kind.units[k]
    if unit.dc is None:
        return {}
    found = {name: name.replace("dc.", "dc_now.", 1) for name in unit.dc.state}
    found |= {name: name.replace("clamp.", "clamp_after.", 1) for name in unit.dc.clamp} | {"begun": "begun_after"}
    applied = applied_by(unit)
    found |= {f"asked.{axis}": applied[f"applied.{axis}"] for axis in AXES}
    found |= {f"charge.{axis}": f"uncharged.{axis}" for axis in AXES if k in kind.linked}
    found = {f"u{k}.{name}": f"u{k}.{after}" for name, after in found.items()}
    states = (name for name in unit.dc.kept if name.startswith("began."))
    found |= {f"u{k}.{name}": _called(kind, k, name.replace("began.", "x.", 1)) for name in states}
    return found | {f"{axis}.held.{k}": f"u{k}.acting.{axis}" for axis in AXES}


def _following_of_unit(unit: Kind, k: int) -> dict[str, str]:
    """Where the numbers of its controller, its sensors and its estimator come from."""
    found = {}
    special = {"state.theta": "next_theta", "state.V": "next_V"} if unit.field else {"state.theta": "kept_angle"}
    for name in unit.names(ControllerState, "state"):
        found[f"u{k}.{name}"] = f"u{k}.{special.get(name, name.replace('state.', 'following.', 1))}"
    for present, record, before, now in (
        (unit.sensors, Measurement, "before", "true"),
        (unit.field, LockIn, "lock", "heard"),
    ):
        own = names_of(record, before) if present else []
        found |= {f"u{k}.{name}": f"u{k}.{name.replace(before, now, 1)}" for name in own}
    found |= {f"u{k}.{name}": f"u{k}.{name.replace('watch.', 'watched.', 1)}" for name in watched_names(unit)}
    found[f"u{k}.limited"] = f"u{k}.limited_samples"
    found |= {f"u{k}.last.{name}": f"u{k}.said.{name}" for name in SAID[:3]}
    found[f"u{k}.last.at_bridge"] = f"u{k}.at_bridge"
    return found
