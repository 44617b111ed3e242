"""The converter, its filter and its controllers as tables, and the current after jumps of the grid's phase: the same on
every page.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.frames import phase_to_ll
from vsgdesign.identification import estimator_kind
from vsgdesign.report.drawing.quantities import number, plain, plain_quantity
from vsgdesign.report.page.blocks import Block, Heading, Table, Where, words
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.network_fields import OPEN, Base, Said, network_words
from vsgdesign.study.parameters.study import ControllerSpec, Study


class HasStudy(Protocol):
    """Any result that knows its study and what was designed and trained for it."""

    @property
    def study(self) -> Study:
        """The study that it is a result of."""
        ...

    @property
    def ready(self) -> Ready:
        """Its gain tables and its network."""
        ...


def grid_label(result: HasStudy, grid: Grid) -> str:
    """SCR and X/R of a grid."""
    place = grid.place(result.study.converter, result.study.scr_basis)
    return f"SCR {plain(place.scr, 3)}, X/R {plain(place.x_over_r, 3)}"


def converter_table(result: HasStudy) -> Table:
    """Ratings, bridge, inner loops and measurement."""
    study, c, g = result.study, result.study.converter, result.study.inner_gains
    rows = (
        ("Rated power", plain_quantity(c.S_rated, "VA")),
        (
            "Rated voltage",
            f"{plain_quantity(c.V_rated_rms, 'V')} phase rms "
            f"({plain_quantity(phase_to_ll(c.V_rated_rms), 'V')} line to line)",
        ),
        ("Nominal frequency", f"{plain(c.omega_n / (2.0 * math.pi))} Hz"),
        ("Dc link", plain_quantity(c.V_dc, "V")),
        ("Carrier frequency", plain_quantity(c.f_sw, "Hz")),
        ("Sampling period", f"{plain_quantity(c.T_s, 's')} ({c.samples_per_carrier} per carrier period)"),
        ("Computation delay", "none" if c.delay_samples == 0 else f"{c.delay_samples} sample"),
        ("Modulation", "sine-triangle with min-max zero sequence" if c.zero_sequence else "sine-triangle"),
        *(("Current limit" + of, limit) for of, limit in _current_limits(study)),
        ("Voltage limits", f"{plain(c.V_min_pu)} to {plain(c.V_max_pu)} pu"),
        ("Voltage loop", f"K_pv = {number(g.K_pv)} A/V, K_iv = {number(g.K_iv)} A/(V·s)"),
        ("Current loop", f"K_pc = {number(g.K_pc)} V/A, K_ic = {number(g.K_ic)} V/(A·s)"),
        (
            "Transient impedance",
            "none"
            if g.R_t == g.X_t == 0.0
            else f"R {plain(g.R_t / c.Z_base)} pu, "
            f"X {plain(g.X_t / c.Z_base)} pu above {plain(study.omega_t / (2.0 * math.pi))} Hz",
        ),
        ("Current prediction", "none" if g.kappa == 0.0 else f"κ = {plain(g.kappa)} sampling periods"),
        ("Power filters", f"P {_time_constant(study.tau_P)}, Q {_time_constant(study.tau_Q)}{_notch(study)}"),
    )
    return Table("Converter", ("Quantity", "Value"), rows, texts=2)


def filter_table(result: HasStudy) -> Table:
    """Filter and grid at the start."""
    study, f = result.study, result.study.filter
    rows = [
        ("Converter-side inductor", f"{plain_quantity(f.L_1, 'H')}, {_ohm(f.R_1)}"),
        ("Capacitor", plain_quantity(f.C, "F")),
    ]
    if f.R_c:
        rows.append(("In series with it", _ohm(f.R_c)))
    if f.L_2:
        rows.append(("Grid-side inductor", f"{plain_quantity(f.L_2, 'H')}, {_ohm(f.R_2)}"))
    grid, source, at_start = study.grid, study.grid_source, build_timeline(study).source_at(0.0)
    rows += [
        ("Grid at the start", f"{grid_label(result, grid)} ({study.scr_basis} basis)"),
        ("", f"R_g = {_ohm(grid.R_g)}, L_g = {plain_quantity(grid.L_g, 'H')}"),
        (
            "Grid source at the start",
            f"{plain_quantity(at_start.V_g_rms, 'V')} phase rms, {plain(at_start.omega / (2.0 * math.pi), 5)} Hz",
        ),
    ]
    if source.components:
        rows.append(
            ("", "; ".join(f"order {plain(c.order)}: {plain(100.0 * c.amplitude_pu)} %" for c in source.components))
        )
    rows += [("At the PCC at the start" if k == 0 else "", said) for k, said in enumerate(network_in_words(study))]
    rows += [("Background of the grid" if k == 0 else "", said) for k, said in enumerate(background_in_words(study))]
    rows += [("Sensors" if k == 0 else "", said) for k, said in enumerate(sensors_in_words(study))]
    return Table("Filter and grid", ("Quantity", "Value"), tuple(rows), texts=2)


def network_in_words(study: Study) -> list[str]:
    """Load, fault and breaker at the start; nothing where there is nothing but the grid."""
    c, network = study.converter, study.network
    said = Said(network.load, network.fault, None if network.connected else OPEN)
    return [words.replace("breaker opens", "breaker open") for words in network_words(said, Base.of(c))]


def background_in_words(study: Study) -> list[str]:
    """What the study's background does, as it was drawn, or which record is played; nothing where there is none."""
    if study.replay is not None:
        one = study.replay
        return [
            f"recorded: {Path(one.file).name}, times {plain_quantity(one.scale, 'V')}, from {plain(one.begin)} s on",
            f"of the record: fundamental {plain(one.omega_g / (2.0 * math.pi), 5)} Hz, negative sequence "
            f"{_percent(one.seen.negative)}, offset {_percent(one.seen.offset)}, clipped {_percent(one.seen.clipped)}",
        ]
    spec = study.background
    if spec is None:
        return []
    lines = [
        f"{spec.level}, seed {spec.seed}: phase {_signed(math.degrees(spec.phase))}°, frequency "
        f"{_signed(spec.frequency_offset, 5)} Hz, voltage times {plain(spec.voltage_factor)}"
    ]
    moves = [
        (
            spec.frequency_wander,
            f"frequency by {plain_quantity(spec.frequency_wander, 'Hz')} in 1 s, "
            f"{plain_quantity(spec.frequency_deviation, 'Hz')} in the long run",
        ),
        (
            spec.voltage_wander,
            f"voltage by {_percent(spec.voltage_wander)} in 1 s, {_percent(spec.voltage_deviation)} in the long run",
        ),
        (spec.phasor_walk, f"phasor walks by {_percent(spec.phasor_walk)} in a cycle"),
        (spec.phase_noise, f"phase noise {plain_quantity(spec.phase_noise, 'rad')} in a cycle"),
        (spec.voltage_noise, f"voltage noise {_percent(spec.voltage_noise)} in a cycle"),
    ]
    if said := [words for value, words in moves if value > 0.0]:
        lines.append("wander, rms: " + "; ".join(said))
    steps = []
    if spec.voltage_steps_per_minute > 0.0:
        low, high = (_percent(value) for value in spec.voltage_step)
        steps.append(f"{plain(spec.voltage_steps_per_minute)} steps of the voltage per minute, {low} to {high}")
    if spec.phase_jumps_per_minute > 0.0:
        low, high = (f"{plain(math.degrees(value))}°" for value in spec.phase_jump)
        steps.append(f"{plain(spec.phase_jumps_per_minute)} jumps of the phase per minute, {low} to {high}")
    lines += ["; ".join(steps)] if steps else []
    if spec.components:
        lines.append("; ".join(f"order {plain(c.order)}: {_percent(c.amplitude_pu)}" for c in spec.components))
    beats = []
    if spec.modulation > 0.0:
        beats.append(f"modulated by {_percent(spec.modulation)} at {plain(spec.modulation_frequency)} Hz")
    if spec.interharmonic > 0.0:
        beats.append(f"a line of {_percent(spec.interharmonic)} at {plain(spec.interharmonic_frequency)} Hz")
    return lines + (["; ".join(beats)] if beats else [])


def sensors_in_words(study: Study) -> list[str]:
    """The study's sensors; nothing where they are ideal."""
    spec = study.sensors
    if spec is None or not spec.act:
        return []
    said = [f"noise {_percent(spec.noise)} rms"]
    said.append(f"{spec.bits} bits over ±{plain(spec.range_pu)} pu" if spec.bits else "not quantised")
    if spec.range_pu > 0.0 and not spec.bits:
        said.append(f"saturating at {plain(spec.range_pu)} pu")
    errors = [max(map(abs, values)) for values in (spec.gain_errors, spec.offset_errors)]
    said.append(f"gain errors up to {_percent(errors[0])}, offsets up to {_percent(errors[1])}")
    if spec.skew:
        late = "currents" if spec.skew > 0.0 else "voltages"
        said.append(f"{late} {plain_quantity(abs(spec.skew) / study.converter.omega_n, 's')} late")
    return [f"{spec.level}, seed {spec.seed}: " + "; ".join(said)]


def _percent(value: float) -> str:
    return f"{plain(100.0 * value, 3)} %"


def _signed(value: float, digits: int = 4) -> str:
    return ("+" if value > 0.0 else "") + plain(value, digits)


def _current_limits(study: Study) -> list[tuple[str, str]]:
    """The limit of the converter and of each controller that has its own: whose it is, and the limit in words."""
    limits = [("", limit_in_words(study))]
    own = {spec.name: study.with_limit_of(spec) for spec in study.controllers}
    return limits + [(f" of {name}", limit_in_words(with_it)) for name, with_it in own.items() if with_it is not study]


def limit_in_words(study: Study) -> str:
    """The current limit of a study and how it acts."""
    limit_pu = study.converter.current_limit_pu
    if limit_pu is None:
        return "none"
    values = study.limiter_values
    said = [
        f"{one.name} = {plain(values[one.name]) if one.unit == '1' else plain_quantity(values[one.name], one.unit)}"
        for one in study.limiter.parameters
    ]
    return "; ".join([f"{plain(limit_pu)} pu of the rated peak, {study.current_limiter}", *said])


def _time_constant(tau: float) -> str:
    return "unfiltered" if tau == 0.0 else plain_quantity(tau, "s")


def _notch(study: Study) -> str:
    frequency = 2.0 * study.converter.omega_n / (2.0 * math.pi)
    return f", behind a notch at {plain(frequency)} Hz" if study.has_notch else ""


def _ohm(value: float) -> str:
    return "0 Ω" if value == 0.0 else plain_quantity(value, "Ω")


def known_grid(spec: ControllerSpec) -> str:
    """What a scheduled controller knows of the grid."""
    if spec.estimate != "truth":
        return f"the estimate of the grid by {estimator_kind(spec.estimate).title}"
    known = spec.knowledge
    if known is None:
        return "the true grid impedance"
    said = f"R_g wrong by {100.0 * known.error_R:+.4g} % and L_g by {100.0 * known.error_X:+.4g} %"
    return said + (f", silent for {plain_quantity(known.silent_s, 's')} after each change" if known.silent_s else "")


def specs_table(result: HasStudy, specs: Sequence[ControllerSpec]) -> Table:
    """What controllers are and aim at."""
    rows = []
    for spec in specs:
        if spec.kind == "scheduled":
            period = result.ready.update_period(spec)
            every = "after every window" if period is None else f"every {plain_quantity(period, 's')}"
            if spec.estimate != "truth" and estimator_kind(spec.estimate).by_sample:
                every = "after every cycle of the estimator"
            how = f"rescheduled {every} from {known_grid(spec)}"
        elif spec.gains is not None:
            how = "given in the study"
        elif spec.design_grid is None and result.study.plant is not None:
            how = "closed form for the grid that the unit sees at first"
        else:
            how = f"closed form for {grid_label(result, spec.design_grid or result.study.grid)}"
        target = spec.target
        rows.append(
            (
                spec.name,
                how,
                f"{plain(target.settling_time)} s",
                plain(target.damping_ratio),
                plain(target.droop_ratio),
                plain_quantity(target.P, "W"),
                plain_quantity(target.Q, "var"),
            )
        )
    head = ("Controller", "Power-loop gains", "Target settling time", "ξ", "D_q/D", "Design P", "Design Q")
    return Table("Controllers", head, tuple(rows), texts=2)


def dc_link_text(source: str | None) -> str:
    """What feeds the bridge in the runs of a page. ``source``: of the study's [dc]; None: an ideal link."""
    if source is None:
        return "The dc link is ideal: its voltage does not move, whatever power is drawn."
    return (
        f"The dc link is a capacitor with the source {source}, and a run in which its voltage leaves its limits is "
        "lost. The bridge makes the commanded voltage exactly as long as the link allows it. After the bridge has "
        "blocked, nothing is simulated."
    )


_HEAD = ("jump", "by hand", "95 %", "largest", "runs", "95 %", "largest", "runs")


def phase_jump_blocks(document: dict[str, Any] | None, *, numbered: bool = False) -> list[Block]:
    """Heading, answer and table; nothing where no controller limits its current."""
    if document is None:
        return []
    return [
        Heading("Current after a phase jump", numbered=numbered),
        words(*phase_jump_text(document), on=Where.BOTH),
        _table(document),
    ]


def phase_jump_text(document: dict[str, Any]) -> list[str]:
    """The peak against the limit, its cause, and what would lower it, each in one sentence."""
    limit, warned = document["limit_pu"], document["warned"]
    if warned is None:
        return [_no_warning(document)]
    peak, where = warned["p95_pu"], f"A phase jump of {plain(warned['angle_deg'])}° at SCR {plain(warned['scr'])}"
    if peak is None:
        return [f"{where} makes the simulation diverge in more than 5 % of the cases. The inner loops must be mended."]
    lines = [
        f"{where} makes a current of up to {number(peak)} pu in 95 % of the cases (largest "
        f"{number(warned['largest_pu'])} pu), where the limit is {plain(limit)} pu. A trip level below this would act."
    ]
    free = document["all_voltage_pu"]
    if free is not None and free < peak:
        lines.append(
            f"The bridge has {number(document['V_max_pu'])} pu of voltage, while grid and capacitor ring above it. "
            f"With three times the dc voltage the peak would be {number(free)} pu: the missing voltage makes "
            f"{number(peak - free)} pu of the peak, and the delay of the current loop makes the rest above the limit."
        )
    else:
        lines.append("The bridge has enough voltage. The current flows before the sampled current loop can act.")
    helps = [one for one in document["remedies"] if one["helps"]]
    idle = [one for one in document["remedies"] if one["told"] and not one["helps"]]
    untold = [one["change"] for one in document["remedies"] if not one["told"]]
    if helps:
        lines.append(f"What helps, with inner loops designed for it: {_listed(helps)}.")
    if idle:
        lines.append(f"Little is gained, or no more, with inner loops designed for it, by: {_listed(idle)}.")
    if untold:
        lines.append(
            f"Nothing is told of: {'; '.join(untold)}. A short search finds no inner loops that keep all that is asked "
            "of them there, and the current depends on their design. vsgdesign inner --remedies designs them fully."
        )
    return lines


def _no_warning(document: dict[str, Any]) -> str:
    most = [one["p95_pu"] for one in document["peaks"] if one["p95_pu"] is not None]
    if not most:
        return "No phase jump could be simulated: there is no operating point before or after any of them."
    largest, limit = document["peaks"][-1]["angle_deg"], plain(document["limit_pu"])
    return (
        f"After phase jumps of up to {plain(largest)}° the current stays near its limit of {limit} pu: in 95 % of the "
        f"cases it is at most {number(max(most))} pu."
    )


def _listed(remedies: list[dict[str, Any]]) -> str:
    return "; ".join(f"{one['change']} ({_left(one)})" for one in remedies)


def _left(remedy: dict[str, Any]) -> str:
    """The peak that a remedy leaves, and whether its inner loops keep what is asked of them."""
    said = "more than 5 % diverge" if remedy["p95_pu"] is None else f"{number(remedy['p95_pu'])} pu"
    return said if remedy["score"] >= 1.0 else f"{said}, with a score of the inner loops of {number(remedy['score'])}"


def _table(document: dict[str, Any]) -> Table:
    peaks, scrs = document["peaks"], sorted({one["scr"] for one in document["peaks"]})
    angles = sorted({one["angle_deg"] for one in peaks})
    of = {(one["angle_deg"], one["scr"]): one for one in peaks}
    rows = []
    for angle in angles:
        row = [f"{plain(angle)}°", number(of[angle, scrs[0]]["bound_pu"])]
        for scr in scrs:
            one = of[angle, scr]
            row += [number(one["p95_pu"]), number(one["largest_pu"]), str(one["runs"])]
        rows.append(tuple(row))
    notes = (
        "Currents in pu of the rated peak, from EMT with an averaged bridge. The jumps have both signs, X/R from 2 to "
        "20, SCR within 10 %, and powers of up to 0.9 pu. The power loops are those of the closed form and are told "
        "the grid 20 ms late. By hand: the limit, and what the voltage of the jump drives through the converter-side "
        "inductance until the bridge answers.",
    )
    groups = (("", 2), *((f"SCR {plain(scr)}", 3) for scr in scrs))
    return Table(
        "Largest converter currents after a phase jump", _HEAD, tuple(rows), groups=groups, notes=notes, on=Where.BOTH
    )
