"""EMT speed: in the compiled loop, end to end, and against duration and log interval."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.timing import REPEATS, Row, figure, real_time_factor, repeat, scaled
from vsgdesign.codegen.llvm import LoopSpec, compiled_loop, flat_block
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import CIRCULAR, LIMITERS, GridEstimate, LimiterLaw
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.linear.operating_point.sampled import cold_start
from vsgdesign.simulation import GainChange, build_timeline, gain_changes, simulate
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Study, load_study, study_from_text

PUBLISHED = Path(__file__).resolve().parents[1] / "studies" / "published_averaged" / "study.toml"

LCL = """
base = "case:lab_12kva_lcl"
[converter]
f_sw = "{f_sw} kHz"
[simulation]
duration = "60 s"
log_interval = "{log} us"
P_ref = "4 kW"
Q_ref = "0 var"
[[controllers]]
name = "scheduled"
kind = "scheduled"
[[events]]
time = "10 s"
P_ref = "6 kW"
[[events]]
time = "30 s"
grid = {{ scr = 8 }}
"""

MOTULATOR = "motulator 0.18 native C, LCL + grid, 125 us"
DPSIM = "DPsim 1.4 SSN_GFM, 17 states, 50 us"
CHAIN = {
    "averaged": "latency of one control step (bench/README.md)",
    "pwm": "the same, and about six edge polynomials a carrier period",
}
OVERHEAD = "the loop; then plant matrices and the log's first touch"


def timed_simulate(study: Study, bridge: str, repeats: int = REPEATS) -> tuple[list[float], list[float]]:
    """Seconds in the compiled loop and of the whole call, for a study's last controller."""
    changes = gain_changes(study, study.controllers[-1], build_timeline(study))
    simulate(study, changes, bridge=bridge)  # compiles
    inside, whole = [], []
    for _ in range(repeats):
        begin = time.perf_counter()
        run = simulate(study, changes, bridge=bridge)
        whole.append(time.perf_counter() - begin)
        inside.append(run.loop_seconds)
    return inside, whole


def with_simulation(study: Study, **changes: float) -> Study:
    """The study for another duration (its events beyond the end dropped) or log interval."""
    simulation = replace(study.simulation, **changes)
    events = tuple(event for event in study.events if event.t_s < simulation.duration)
    return replace(study, simulation=simulation, events=events)


def published(bridge: str, anchors: tuple[float, float], targets: tuple[float, float]) -> list[Row]:
    """The published scenario with one bridge model: loop, end to end, and the scenario with its figures."""
    study = load_study(PUBLISHED)
    what = f"{bridge}, 5 kVA LC + grid, 60 s at 50 us, logged at 200 us"
    inside, whole = timed_simulate(study, bridge)
    steps = study.simulation.duration / study.converter.T_s
    everything = repeat(lambda: run_scenario(study, bridge=bridge))
    simulated = study.simulation.duration * len(study.controllers)
    loop, whole_call = (real_time_factor(seconds, study.simulation.duration) for seconds in (inside, whole))
    rows = [
        Row(bridge, f"{what}: loop", loop, "RT", anchors[0], MOTULATOR, targets[0], CHAIN[bridge]),
        Row(bridge, f"{what}: simulate()", whole_call, "RT", anchors[1], MOTULATOR, targets[1], OVERHEAD),
    ]
    if bridge == "averaged":
        rows.append(Row(bridge, f"{what}: simulate()", whole_call, "RT", 3.8, DPSIM, None, OVERHEAD))
    rows += [
        Row(
            bridge,
            f"{what}: run_scenario(), 2 controllers",
            real_time_factor(everything, simulated),
            "RT",
            limit="the loop; figures of every event and of every sample",
        ),
        Row(bridge, f"{what}: one control step", scaled(figure(inside), 1e9 / steps), "ns", limit=CHAIN[bridge]),
    ]
    return rows


def averaged() -> list[Row]:
    """The averaged bridge."""
    return published("averaged", (166.0, 37.0), (400.0, 150.0))


def pwm() -> list[Row]:
    """The switched bridge."""
    return published("pwm", (57.0, 14.0), (110.0, 60.0))


def lcl() -> list[Row]:
    """An LCL filter with one sample of delay: at its own step, and at the anchor's step and carrier."""
    rows = []
    for f_sw, T_s, log in ((10, 50, 200), (4, 125, 250)):
        study = study_from_text(LCL.format(f_sw=f_sw, log=log))
        for bridge, anchors in (("averaged", (166.0, 37.0)), ("pwm", (57.0, 14.0))):
            what = f"{bridge}, 12.5 kVA LCL + grid, 60 s at {T_s} us, logged at {log} us"
            whose = MOTULATOR if bridge == "averaged" else f"{MOTULATOR}, 4 kHz"
            inside, whole = timed_simulate(study, bridge)
            loop, whole_call = (real_time_factor(seconds, 60.0) for seconds in (inside, whole))
            rows.append(Row("lcl", f"{what}: loop", loop, "RT", anchors[0], whose, limit=CHAIN[bridge]))
            rows.append(Row("lcl", f"{what}: simulate()", whole_call, "RT", anchors[1], whose, limit=OVERHEAD))
    return rows


def field() -> list[Row]:
    """The field estimator in the loop: what a cycle of it costs, with its samples, its conclusion and the gains."""
    study = load_study(PUBLISHED)
    spec = replace(study.controllers[-1], estimate="field", update_period=None)
    study = replace(with_simulation(study, duration=10.0), controllers=(spec,))
    feed = FieldScheduler(study, spec)
    plain = repeat(lambda: simulate(study, [GainChange(0.0, feed.first())]))
    estimating = repeat(lambda: simulate(study, feed))
    longer = [1e6 * (long - short) / len(feed.rows) for long, short in zip(estimating, plain, strict=True)]
    seconds = real_time_factor(estimating, 10.0)
    what = "5 kVA LC + grid, 10 s at 50 us"
    return [
        Row(
            "field", f"{what}: simulate() with the field estimator", seconds, "RT", limit="arguments of a call a cycle"
        ),
        Row(
            "field",
            f"{what}: a cycle of it, all included",
            figure(longer),
            "us",
            limit="gains in Python; 65 ns a sample",
        ),
    ]


def controller() -> list[Row]:
    """The controller's step alone, compiled, fed back on itself so that steps cannot overlap."""
    study = load_study(PUBLISHED)
    gains = gain_changes(study, study.controllers[-1], build_timeline(study))[0].gains
    c = study.converter
    refs = References(2000.0, 1000.0, c.omega_n, c.V_rated_rms)
    settings = study.controller_settings()
    state = cold_start(study).controller._replace(P_f=2000.0, Q_f=1000.0)
    kinds = {ControllerState: {"limiter": type(state.limiter)}, ControllerSettings: {"limiter": type(settings.limiter)}}
    block = flat_block(_fed_back, fixed={"limiter": study.limiter.law}, kinds=kinds)
    moving = {"v_alpha": "v_alpha_next", "v_beta": "v_beta_next"}
    moving |= {f"state.{name}": f"following.{name}" for name in ("theta", "u_alpha", "u_beta", "i_f_d", "i_f_q")}
    held = tuple(name for name in block.inputs if name not in moving)
    loop = compiled_loop(LoopSpec((block,), tuple(moving.items()), constant=held, strict=True))
    grid = GridEstimate(R_g=study.grid.R_g, L_g=study.grid.L_g)
    given = numbers_of((state, (150.0, 0.0), grid, refs, gains, study.inner_gains, settings))
    values = dict(zip(block.inputs, given, strict=True))
    start = np.array([values[name] for name in loop.spec.rows])[None, :, None]
    count = 1_000_000

    def run() -> None:
        rows = start.copy()
        loop(0, count, rows, np.zeros(0))
        if not np.isfinite(rows).all():
            raise RuntimeError("the benchmark's controller diverged")

    seconds = scaled(figure(repeat(run)), 1e9 / count)
    return [
        Row(
            "controller",
            "controller_step() alone, 5 kVA LC",
            seconds,
            "ns",
            limit="a chain of 2 roots, 2 divisions and some 30 sums",
        )
    ]


def _fed_back(
    state: ControllerState,
    v_alpha: Any,
    v_beta: Any,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    limiter: LimiterLaw,
) -> Any:
    """The controller's step on a voltage that it moves a little: the chain of dependence is whole, and nothing runs
    away. Returns (following, v_alpha_next, v_beta_next)."""
    measured = Measurement(v_alpha, v_beta, 10.0, -5.0, 10.0, -5.0)
    moved, output = controller_step(state, measured, grid, refs, power_gains, inner_gains, settings, limiter)
    return moved, 150.0 + 1e-9 * output.v_b_alpha, 1e-9 * output.v_b_beta


def scaling() -> list[Row]:
    """Cost against duration (linear) and against the log interval."""
    study = load_study(PUBLISHED)
    _, shortest = timed_simulate(with_simulation(study, duration=1e-3), "averaged")
    rows = [
        Row(
            "scaling",
            "averaged, 5 kVA LC, 1 ms: simulate(), which is its set-up",
            scaled(figure(shortest), 1e3),
            "ms",
            limit="matrix exponentials of the plant, the steady state",
        ),
    ]
    for duration in (1.0, 10.0, 60.0):
        _, whole = timed_simulate(with_simulation(study, duration=duration), "averaged")
        per_second = scaled(figure(whole), 1e3 / duration)
        what = f"averaged, 5 kVA LC, {duration:g} s at 50 us, logged at 200 us: simulate() a simulated second"
        rows.append(Row("scaling", what, per_second, "ms", limit="linear beyond the set-up"))
    for interval in (50e-6, 200e-6, 2e-3):
        _, whole = timed_simulate(with_simulation(study, log_interval=interval), "averaged")
        what = f"averaged, 5 kVA LC, 60 s at 50 us, logged at {1e6 * interval:g} us: simulate()"
        rows.append(Row("scaling", what, scaled(figure(whole), 1e3), "ms", limit="the loop; 104 bytes a logged sample"))
    return rows


def limiters() -> list[Row]:
    """Every current limiter, present but not acting, against the circular one in turn."""
    study = with_simulation(load_study(PUBLISHED), duration=10.0)
    study = replace(study, converter=replace(study.converter, current_limit_pu=20.0))
    changes = gain_changes(study, study.controllers[-1], build_timeline(study))
    studies = {name: replace(study, current_limiter=name) for name in LIMITERS}
    times: dict[str, list[float]] = {name: [] for name in studies}
    for one in studies.values():
        simulate(one, changes, bridge="averaged")  # compiles
    for _ in range(3 * REPEATS):
        for name, one in studies.items():
            times[name].append(simulate(one, changes, bridge="averaged").loop_seconds)
    what = "averaged, 5 kVA LC, loop: time with a limiter that does not act over that with circular"
    rows = []
    for name in times:
        if name != CIRCULAR.name:
            ratios = [own / plain for own, plain in zip(times[name], times[CIRCULAR.name], strict=True)]
            rows.append(Row("limiters", f"{what}: {name}", figure(ratios), "×", target=1.0 / 0.75))
    return rows


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {
    "averaged": averaged,
    "pwm": pwm,
    "lcl": lcl,
    "field": field,
    "controller": controller,
    "scaling": scaling,
    "limiters": limiters,
}
