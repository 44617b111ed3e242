"""The body of a loop: one sample as a straight line, put together of the parts that the runs of a kind have."""

from __future__ import annotations

import functools
from typing import Any

from vsgdesign.codegen.blocks import Part, Writer, joined, with_outputs
from vsgdesign.codegen.expressions import Expression, Number
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.loop_spec import Product
from vsgdesign.equations.controller import ControllerState, GridWatch
from vsgdesign.equations.field import LockIn
from vsgdesign.simulation import circuit_sample, link_piece, sample, watched_sample
from vsgdesign.simulation.axes import PEAK, RISING, headed, switched_legs, two_axes
from vsgdesign.simulation.circuit_sample import CarrierPart, EdgeRow, PlantRow
from vsgdesign.simulation.run_kind import DISTURBANCE, FAULT, RELAY, SYNC, Kind, names_of
from vsgdesign.simulation.sample import with_ramp


def moves(kind: Kind, watched: tuple[str, ...] = ()) -> tuple[tuple[str, str], ...]:
    """What a sample moves: (input, output) of every number. ``watched``: the inputs of what is watched."""
    arrived = kind.reached
    after = {"state.theta": "next_theta", "state.V": "next_V"} if kind.field else {"state.theta": "kept_angle"}
    found = [(f"x.{name}", f"{arrived}.{name}") for name in kind.states]
    own = kind.names(ControllerState, "state")
    found += [(name, after.get(name, name.replace("state.", "following.", 1))) for name in own]
    found += [("limited", "limited_samples"), *((f"source.{part}", f"turned.{part}") for part in ("cosine", "sine"))]
    for wave in wave_names(kind):
        found += [(f"{wave}.phasor.{part}", f"{wave}.turned.{part}") for part in ("cosine", "sine")]
    if kind.bridge.delayed:
        found += [(f"pending.{axis}", f"said.v_b_{axis}") for axis in ("alpha", "beta")]
    if kind.sensors:
        found += [(name, name.replace("before.", "true.", 1)) for name in names_of(sample.Measurement, "before")]
    if kind.field:
        found += [(name, name.replace("lock.", "heard.", 1)) for name in names_of(LockIn, "lock")]
    if kind.ramped:
        found += [("ramp.V_pk", "ramp_after.V_pk"), ("ramp.drift", "ramp_after.drift")]
    found += kind.dc.moves if kind.dc is not None else []
    found += _seek_moves(kind)
    found += [(name, name.replace("sums.", "sums_after.", 1)) for name in sums_names(kind)]
    renamed = {"watch.delta": "next_delta"} if kind.field else {}
    found += [(name, renamed.get(name, name.replace("watch.", "watched.", 1))) for name in watched]
    if kind.waits:
        found.append(("k", "k_after"))
    return tuple(found)


def sums_names(kind: Kind) -> list[str]:
    """The sums of what is taken of every sample."""
    return names_of(watched_sample.Sums, "sums") if kind.taken else []


def _seek_moves(kind: Kind) -> list[tuple[str, str]]:
    """What is moved of a run that looks for instants."""
    pairs = {
        RELAY: (("own", "followed"), ("behind", "followed_behind")),
        SYNC: (("watch", "watched_grid"),),
    }
    found: list[tuple[str, str]] = [("seek.found", "found")] if kind.seeks else []
    for what in kind.seeks:
        for before, after in pairs.get(what, ()):
            head = f"seek.{before}_{what}"
            found += [(name, name.replace(head, after, 1)) for name in names_of(GridWatch, head)]
    return found + ([("seek.ready", "in_step_for")] if SYNC in kind.seeks else [])


def held(pairs: tuple[tuple[str, str], ...], kind: Kind) -> tuple[tuple[str, str], ...]:
    """What is moved of runs that stand still where an instant is found."""
    if not kind.seeks or kind.cut:
        return pairs
    return tuple((before, after if after == "found" else f"kept.{after}") for before, after in pairs)


@functools.cache
def control(kind: Kind) -> Block:
    """From the circuit's state to the voltage that acts over the interval: sensors, probe, controller, delay."""
    own = headed(flat_block(sample.controlled, fixed={"limiter": kind.law}, kinds=kind.records))
    true = headed(flat_block(circuit_sample.measured_by), measurement=_true(kind))
    parts, chosen = [Part(true)], {}
    if kind.dc is not None:
        parts.append(kind.dc.limit())
        chosen |= {"settings.v_max_pk": "bridge_max"}
    if SYNC in kind.seeks:
        chosen |= {name: name.replace("state.", "chosen.", 1) for name in kind.names(ControllerState, "state")}
        parts += [*_source(kind), _set_to_grid(kind)]
    if kind.dc is not None and kind.dc.clamps:
        parts += kind.dc.asks(kind.records, chosen)
        chosen |= {"refs.P_ref": "clamped_P"}
    if kind.sensors:
        parts.append(Part(headed(flat_block(sample.sensed))))
    turns, angle = ([], "following.theta") if kind.dc is None else (kind.dc.drooped(), kind.dc.angle)
    if kind.field:
        commanded = {"state.theta": "commanded_theta", "state.V": "commanded_V"}
        before = {"theta": "state.theta", "V_rms": "state.V"}
        heard = {"theta": "commanded_theta", "acted": "said.limited"}
        after = {"theta": angle, "V_rms": "following.V"}
        parts += [
            Part(headed(flat_block(sample.probing)), before),
            Part(own, chosen | commanded),
            *turns,
            Part(headed(flat_block(sample.hearing)), heard),
            Part(headed(flat_block(sample.without_probe)), after),
        ]
    else:
        parts += [Part(own, chosen), *turns, Part(headed(flat_block(sample.kept_angle)), {"theta": angle})]
    parts += [] if SYNC in kind.seeks else _source(kind)
    return joined(*parts, *_relay(kind))


def _true(kind: Kind) -> str:
    """What the measurement without the errors of the sensors is called."""
    return "true" if kind.sensors else "measured"


def _source(kind: Kind) -> list[Part]:
    """The voltage of the source."""
    parts = [Part(headed(flat_block(sample.source_voltage_with if kind.added else sample.source_voltage)))]
    for wave in wave_names(kind):
        own = {f"source.{part}": f"{wave}.phasor.{part}" for part in ("cosine", "sine")}
        heads = {"v_g_alpha": f"{wave}.alpha", "v_g_beta": f"{wave}.beta"}
        parts.append(Part(headed(flat_block(sample.source_voltage), **heads), own | {"V_g": f"{wave}.V"}))
        parts += [Part(_sum(f"v_g_{axis}", f"{wave}.{axis}", "+", f"v_g_{axis}")) for axis in ("alpha", "beta")]
    return parts


def _set_to_grid(kind: Kind) -> Part:
    """A converter that sets itself to the grid behind its breaker."""
    called = {name: f"{_true(kind)}.{name.partition('.')[2]}" for name in names_of(sample.Measurement, "measured")}
    called |= {name: name.replace("watch.", "seek.watch_sync.", 1) for name in names_of(GridWatch, "watch")}
    called |= {name: f"seek.{name}" for name in names_of(sample.Setting, "setting")}
    block = headed(flat_block(sample.set_to_grid, kinds=kind.records))
    return Part(block, called | {"ready": "seek.ready", "T_s": "settings.T_s"})


def _relay(kind: Kind) -> list[Part]:
    """A relay that waits for both sides of a breaker."""
    if RELAY not in kind.seeks:
        return []
    called = {"T_s": "settings.T_s"} | {f"v_{axis}": f"{_true(kind)}.v_{axis}" for axis in ("alpha", "beta")}
    for side in ("own", "behind"):
        called |= {name: name.replace(side, f"seek.{side}_relay", 1) for name in names_of(GridWatch, side)}
    called |= {name: f"seek.{name}" for name in names_of(sample.Relay, "relay")}
    return [Part(headed(flat_block(sample.relay_sees)), called)]


def seek_names(kind: Kind) -> list[str]:
    """What a run that looks for instants has for itself: the current into a fault per state, on both axes, and for
    which phases, the relay's limits, and whether the converter sets itself to the grid."""
    found = []
    if FAULT in kind.seeks:
        found += [f"seek.current.{axis}_{state}" for axis in ("alpha", "beta") for state in kind.states]
        found += names_of(sample.Phases, "seek.phases")
    found += names_of(sample.Relay, "seek.relay") if RELAY in kind.seeks else []
    return found + (names_of(sample.Setting, "seek.setting") if SYNC in kind.seeks else [])


def _found(kind: Kind, moved: tuple[tuple[str, str], ...]) -> list[Part]:
    """Whether an instant is found in this sample (1: the run goes on after it, 2: it stands still), and what is kept of
    a run that stands still."""
    parts, line = [], Writer()
    if FAULT in kind.seeks:
        after = kind.reached
        current = Writer()
        for when, head in (("begin", "x"), ("end", after)):
            for axis in ("alpha", "beta"):
                factors = ((f"seek.current.{axis}_{state}", f"{head}.{state}") for state in kind.states)
                terms = [current.does("*", *map(current.input, pair)) for pair in factors]
                current.output(f"{when}_{axis}", current.sum_of(*terms))
        called = {name: f"seek.{name}" for name in names_of(sample.Phases, "phases")}
        parts += [
            Part(current.block()),
            Part(headed(flat_block(sample.passes_zero), passes_zero="crossed"), called),
        ]
    stops = {FAULT: "crossed", RELAY: "near", SYNC: "done"}
    still: Expression = Number(0.0)
    found: Expression = line.input("seek.found")
    for what in kind.seeks:
        flag: Expression = line.input(stops[what])
        if what != SYNC:
            still = line.does("max", still, flag)
            flag = line.does("*", Number(2.0), flag)
        found = line.does("max", found, flag)
    line.output("found", found)
    if kind.field and not kind.waits:
        line.output("ends", line.does("max", found, line.input("closed")))
    stands = line.does(">", still, Number(0.5))
    for before, after in moved:
        if after != "found":
            line.output(f"kept.{after}", line.does("select", stands, line.input(before), line.input(after)))
    return [*parts, Part(line.block())]


def wave_names(kind: Kind) -> list[str]:
    """Those of the source's components that turn in the loop."""
    return [f"wave_{number}" for number in range(kind.waves)]


WAVE_ROW = PlantRow._fields[PlantRow._fields.index("re1") :]
"""What a component of the source adds over an interval, and its turn."""


def _waves(kind: Kind) -> list[Part]:
    """What the source's components add to the states over an interval, and where they are at its end."""
    added, turned = flat_block(circuit_sample.moved_by_source), flat_block(circuit_sample.turned_source)
    parts = []
    for wave in wave_names(kind):
        own = {f"row.{name}": f"{wave}.row.{name}" for name in WAVE_ROW}
        own |= {f"source.{part}": f"{wave}.phasor.{part}" for part in ("cosine", "sine")}
        before = {f"x.{state}": f"moved.{state}" for state in kind.states}
        parts.append(Part(headed(added, plant_state="moved"), own | before))
        parts.append(Part(headed(turned, turned=f"{wave}.turned"), own))
    return parts


@functools.cache
def plant(kind: Kind, slope: str = "") -> Block:
    """From the voltage that acts to the circuit's state at the end of the interval, on a slope of the carrier."""
    applied = applied_by(kind)
    if kind.dc is None:
        return joined(*_circuit(kind, slope, applied))
    acting = {name: name.replace("applied", "acting") for name in applied}
    if not kind.coupled:
        moved = kind.dc.moved(kind.reached, applied)
        return joined(kind.dc.acts(applied), *_circuit(kind, slope, acting), moved)
    piece = _with_link(kind, slope, 0)
    return joined(kind.dc.acts(applied), kind.dc.holds(), Part(piece), kind.dc.ends(applied))


def applied_by(kind: Kind) -> dict[str, str]:
    """Where the voltage is that was asked for."""
    waits = "pending." if kind.bridge.delayed else "said.v_b_"
    return {f"applied.{axis}": f"{waits}{axis}" for axis in ("alpha", "beta")}


def _with_link(kind: Kind, slope: str, number: int) -> Block:
    """An interval, or a piece of one, in which the voltage of the dc link moves that of the bridge."""
    held = kind.dc is not None and kind.dc.held
    now = {f"applied.{axis}": f"{'acting' if held else 'piece'}.{axis}" for axis in ("alpha", "beta")}
    now |= {"V_dc": "running.v"}
    called = {"running.v": "dc.v"} if number == 0 else {}
    legs, edges = switched_legs(slope, now, zero_sequence=kind.bridge.zero_sequence) if slope else ([], [])
    parts = [Part(link_piece.voltage_of_piece()), *_circuit(kind, slope, now), *legs]
    arrived = "arrived" if kind.added else "moved"
    found = joined(*parts, Part(link_piece.link_over_piece(kind, arrived, edges, number)))
    return joined(Part(found, called))


def _circuit(kind: Kind, slope: str, applied: dict[str, str]) -> list[Part]:
    """The circuit alone over an interval, with a dc link whose voltage does not move in it."""
    bridge, parts, row = kind.bridge, [], {}
    if kind.axes is not None:
        carried = bool(products(kind))
        both = two_axes(kind.axes, slope, applied, zero_sequence=bridge.zero_sequence, carried=carried)
        return [*both, *_added(kind)]
    if kind.ramped:
        parts.append(Part(headed(flat_block(with_ramp)), {"T_s": "settings.T_s"}))
        row = {name: name.replace("row.", "moved_row.", 1) for name in names_of(PlantRow, "row")}
    fixed: dict[str, Any] = {"zero_sequence": bridge.zero_sequence}
    if not slope:
        parts.append(Part(headed(flat_block(circuit_sample.averaged_plant)), applied | row))
    elif slope == PEAK:
        parts.append(Part(headed(flat_block(circuit_sample.peak_plant, fixed=fixed)), applied | row))
    else:
        fixed["rising"] = slope == RISING
        parts.append(Part(headed(flat_block(circuit_sample.switched_plant, fixed=fixed)), applied | row))
    return [*parts, *_waves(kind), *_added(kind)]


def products(kind: Kind) -> tuple[Product, ...]:
    """What a loop computes at the beginning of a sample: Φ x of a large circuit. An interval in pieces has a Φ for each
    of them, which is written out."""
    if kind.axes is None or not kind.axes.large or kind.cut:
        return ()
    matrix = tuple(name for name in row_names(kind) if name.startswith("row.p_"))
    results, factors = (tuple(f"{head}.{state}" for state in kind.states) for head in ("carried", "x"))
    return (Product(results, matrix, factors),)


def piece_names(kind: Kind, number: int) -> dict[str, str]:
    """What a later piece of an interval has for itself: the names of a whole interval, and those of the piece."""
    own = [*row_names(kind), *names_of(CarrierPart, "part"), *(f"more.{name}" for name in kind.states if kind.added)]
    own += [f"{wave}.row.{name}" for wave in wave_names(kind) for name in WAVE_ROW]
    return {name: f"piece_{number}.{name}" for name in own}


def _plant_in_pieces(kind: Kind) -> Block:
    """The circuit over an interval in pieces. What the source adds is for its phasor at the beginning of the whole
    interval, and so is its turn."""
    arrived, still = kind.reached, kind._replace(ramped=False)
    wanted, before = [], {f"x.{name}": f"{arrived}.{name}" for name in kind.states}
    if kind.coupled:
        wanted = [f"ran.{name}" for name in link_piece.RAN]
        before |= {f"running.{name}": f"ran.{name}" for name in link_piece.RAN}
        found = joined(Part(_with_link(kind, kind.cut[0], 0)))
    else:
        found = joined(Part(plant(kind, kind.cut[0])))
    for number, slope in enumerate(kind.cut[1:], 1):
        piece = _with_link(still, slope, number) if kind.coupled else plant(still, slope)
        own = with_outputs(piece, (*(f"{arrived}.{name}" for name in kind.states), *wanted))
        found = joined(Part(found), Part(own, piece_names(kind, number) | before))
    if kind.dc is None or not kind.coupled:
        return found
    applied = applied_by(kind)
    return joined(kind.dc.acts(applied), kind.dc.holds(), Part(found), kind.dc.ends(applied))


def row_names(kind: Kind) -> list[str]:
    """The numbers of the circuit over an interval, and of its responses to edges of a switched bridge."""
    more = link_piece.names_of_circuit(kind) if kind.coupled else []
    if kind.axes is None:
        return [*names_of(PlantRow, "row"), *(names_of(EdgeRow, "edge") if kind.edged else []), *more]
    axes, rows = kind.axes, range(kind.axes.states)
    pairs = [(row, axis) for row in rows for axis in axes.on(row)]
    if axes.large:  # column by column
        found = [f"row.p_{row}_{k}" for k in rows for row in rows]
    else:
        found = [f"row.p_{row}_{k}" for row in rows for k in rows if k % 2 in axes.on(row)]
    found += [f"row.b_{row}_{axis}" for row, axis in pairs]
    found += [f"row.s_{row}_{axis}" for row in rows for axis in range(2)]
    found += ["row.turn_cos", "row.turn_sin"]
    if kind.edged:
        found += [f"edge.c{k}_{row}_{axis}" for k in range(axes.degree + 1) for row, axis in pairs]
    return found + more


def _added(kind: Kind) -> list[Part]:
    """What the source's other components add to the states over the interval."""
    if not kind.added:
        return []
    line = Writer()
    for state in kind.states:
        line.output(f"arrived.{state}", line.does("+", line.input(f"moved.{state}"), line.input(f"more.{state}")))
    return [Part(line.block())]


@functools.cache
def watch(kind: Kind) -> Block | None:
    """What is watched of a sample; None: nothing."""
    if not kind.watch:
        return None
    if kind.watch != DISTURBANCE:
        own = flat_block(watched_sample.watched_step)
        if not kind.second_inductor and kind.sensors:  # the PCC is the capacitor node
            at_node = Part(headed(flat_block(watched_sample.power_at_node), P="P_pcc", Q="Q_pcc"))
            return joined(at_node, Part(headed(own)))
        if not kind.second_inductor:
            return joined(Part(headed(own), {"P_pcc": "said.P", "Q_pcc": "said.Q"}))
        if kind.network:
            return joined(*_power_with_network(kind), Part(headed(own)))
        at_pcc = flat_block(watched_sample.power_at_pcc)
        return joined(Part(headed(at_pcc, P="P_pcc", Q="Q_pcc"), {"circuit.R_c": "R_c"}), Part(headed(own)))
    own = flat_block(watched_sample.watched_disturbance, fixed={} if kind.ramped or kind.moved else {"extra": 0.0})
    angle = "following.theta" if kind.dc is None else kind.dc.angle
    called = {"P": "said.P", "Q": "said.Q", "theta": "state.theta", "next_theta": angle}
    clamp = kind.dc.rests({"wanted": "of.P_rest"}) if kind.dc is not None and kind.dc.clamps else []
    called |= {"of.P_rest": "P_rest_now", "of.Q_rest": "Q_rest_now"} if clamp else {}
    if not kind.field:
        return joined(*clamp, Part(headed(own), called))
    # The angle that is watched is that of the commanded voltage, as a log has it.
    called |= {"theta": "commanded_theta", "watch.delta": "commanded_delta"}
    return joined(
        *clamp,
        Part(_sum("watch.delta", "added_theta", "+", "commanded_delta")),
        Part(headed(own), called),
        Part(_sum("watched.delta", "added_theta", "-", "next_delta")),
    )


def pcc_names(kind: Kind) -> list[str]:
    """The voltage at the PCC of a circuit with a network per state and per voltage of the source, on each axis."""
    if not kind.network or kind.axes is None:
        return []
    axes = kind.axes
    found = [f"pcc.x_{axis}_{k}" for axis in range(2) for k in range(axes.states) if k % 2 in axes.on(axis)]
    return found + [f"pcc.g_{axis}_{k}" for axis in range(2) for k in axes.on(axis)]


def _power_with_network(kind: Kind) -> list[Part]:
    """The powers at the PCC where more than a grid is connected (:eq:`network-pcc`)."""
    line = Writer()
    sources = "v_g_alpha", "v_g_beta"
    for axis, name in enumerate(("alpha", "beta")):
        terms = []
        for factor in (one for one in pcc_names(kind) if one.startswith((f"pcc.x_{axis}", f"pcc.g_{axis}"))):
            k = int(factor.rpartition("_")[2])
            of = sources[k] if factor.startswith("pcc.g") else f"x.{kind.states[k]}"
            terms.append(line.does("*", line.input(factor), line.input(of)))
        line.output(f"v_pcc.{name}", line.sum_of(*terms))
    at_pcc = {f"true.v_{axis}": f"v_pcc.{axis}" for axis in ("alpha", "beta")}
    at_pcc |= {f"true.i_g_{axis}": f"x.i_g_{axis}" for axis in ("alpha", "beta")}
    power = headed(flat_block(watched_sample.power_at_node), P="P_pcc", Q="Q_pcc")
    return [Part(line.block()), Part(power, at_pcc)]


@functools.cache
def bodies(kind: Kind, outputs: tuple[str, ...], moved: tuple[tuple[str, str], ...] = ()) -> tuple[Block, ...]:
    """One body for every place on the carrier that a sample may have, or the one of an averaged bridge.

    ``moved``: (input, output) of everything that stays as it is in a run that stands still.
    """
    seen = watch(kind)
    ends = [] if seen is None else [Part(seen)]
    if kind.taken:
        ends.append(Part(headed(flat_block(watched_sample.taken))))
    if kind.waits:
        ends.append(Part(_standing_still(moved, kind.together)))
    if kind.seeks:
        ends += [Part(_nothing_found())] if kind.cut else _found(kind, moved)
    slopes = tuple(dict.fromkeys(kind.bridge.slopes)) or ("",)
    plants = [_plant_in_pieces(kind)] if kind.cut else [plant(kind, slope) for slope in slopes]
    return tuple(with_outputs(joined(Part(control(kind)), Part(one), *ends), outputs) for one in plants)


def _nothing_found() -> Block:
    """Of a sample that is computed apart: what is found in it has been seen."""
    line = Writer()
    line.output("found", line.does("*", Number(0.0), line.input("seek.found")))
    return line.block()


def _standing_still(moved: tuple[tuple[str, str], ...], together: bool) -> Block:
    line = Writer()
    k = line.input("k")
    following = line.does("+", k, Number(1.0))
    line.output("slot", line.does("-", k, line.input("log_begin")))
    if together:
        line.output("k_after", following)
        return line.block()
    still = line.does(">", line.input("lock.closed"), Number(0.5))
    for before, after in (*moved, ("k", "")):
        reached = line.input(after) if after else following
        line.output(after or "k_after", line.does("select", still, line.input(before), reached))
    return line.block()


def _sum(one: str, other: str, operation: str, name: str) -> Block:
    line = Writer()
    line.output(name, line.does(operation, line.input(one), line.input(other)))
    return line.block()
