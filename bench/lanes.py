"""Many runs side by side: the compiled loop of the lanes, its compilation, whole batches, and their cost in cases."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.timing import REPEATS, Row, figure
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import FAMILIES, cases_of, uniforms_of
from vsgdesign.codegen.kept_code import FOLDER
from vsgdesign.codegen.llvm import compiled_loop
from vsgdesign.codegen.machine_code import instruction_set
from vsgdesign.execution.executors import environment
from vsgdesign.simulation.lanes.cases import LaneCases, segments_of
from vsgdesign.simulation.lanes.part import Part
from vsgdesign.simulation.lanes.rests import rests_of
from vsgdesign.simulation.lanes.results import JUDGED, LaneResults
from vsgdesign.simulation.lanes.run import parts_of, run_lanes
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.loop import kind_of, loop_of, side_by_side, spec_of
from vsgdesign.simulation.run_kind import STEP
from vsgdesign.simulation.survival.cases import demand_of
from vsgdesign.study.parameters import Study, load_study

STUDIES = Path(__file__).resolve().parents[1] / "studies"
MOTULATOR = "motulator 0.18 native C, LCL + grid, 125 us, one run"
ROOTS = "arithmetic: 364 to 578 operations a lane and sample (bench/README.md)"
SAMPLES = 20_000
CASES = 256


def prepared(study: Study, family: str, bridge: str, strict: bool = False, target: str = "native") -> Part:
    """Lanes of one kind, at rest before their first sample."""
    spec = study.controllers[-1]
    own, cases = study.with_limit_of(spec), drawn(study, family, CASES)
    results, told, segments = LaneResults.of_none(CASES), telling(own, spec, NOTHING, cases), segments_of(cases)
    demand = demand_of(own.converter, spec.target.settling_time)
    rests, gains = rests_of(own, cases, segments, told, demand, results)
    good = np.flatnonzero(results.status == JUDGED)
    part = parts_of(own, cases, segments, rests, demand, good, bridge, strict, target=target)[0]
    for name, values in gains._asdict().items():
        part.put(f"power_gains.{name}", np.asarray(values)[part.index])
    for name, values in zip(("grid.R_g", "grid.L_g"), told.estimate(), strict=True):
        if name in part.place:
            part.put(name, values[part.index])
    return part


def drawn(study: Study, family: str, count: int) -> LaneCases:
    """Cases of one family, all drawn from the study's box."""
    return cases_of(study, study.controllers[-1], uniforms_of(1, 0, count), FAMILIES.index(family))[0]


def closed_form(name: str) -> Study:
    """A study with its last closed form as its only controller."""
    study = load_study(STUDIES / name / "study.toml")
    forms = [spec for spec in study.controllers if spec.kind == "scheduled" and spec.schedule == "closed_form"]
    return replace(study, controllers=(forms[-1],))


def without_limit(study: Study) -> Study:
    """The study without a current limit."""
    return replace(study, converter=replace(study.converter, current_limit_pu=None), current_limiter="circular")


def nanoseconds(part: Part) -> list[float]:
    """CPU time of a lane and sample, ns: the loop alone."""
    values = []
    for repeat in range(REPEATS):
        begin = time.process_time()
        part.run(repeat * SAMPLES // REPEATS, (repeat + 1) * SAMPLES // REPEATS)
        count = part.rows.shape[0] * part.rows.shape[2] * (SAMPLES / REPEATS)
        values.append((time.process_time() - begin) / count * 1e9)
    return values


def loop() -> list[Row]:
    """The loop of the lanes with everything that it watches, on one core."""
    rows = []
    plain, limited = without_limit(closed_form("table")), closed_form("survival")
    kinds = (
        ("averaged, no limit", plain, "step", "averaged", False, 4500.0),
        ("averaged, projection limiter", limited, "grid", "averaged", False, 3500.0),
        ("averaged, projection limiter, strict", limited, "grid", "averaged", True, None),
        ("averaged, ramps of the source", limited, "ramp", "averaged", False, None),
        ("switched", plain, "step", "pwm", False, 2400.0),
        ("switched, projection limiter", limited, "step", "pwm", False, None),
    )
    for what, study, family, bridge, strict, target in kinds:
        part = prepared(study, family, bridge, strict)
        values = nanoseconds(part)
        T_ns = study.converter.T_s * 1e9
        name = f"{what}, {part.spec.width} lanes, {T_ns / 1e3:.0f} us, {instruction_set('native')}, one core"
        anchor = 166.0 if bridge == "averaged" else 57.0
        factor = figure([T_ns / value for value in values])
        rows.append(Row("lanes", f"{name}: loop", factor, "RT", anchor, MOTULATOR, target, ROOTS))
        rows.append(Row("lanes", f"{name}: one lane and sample", figure(values), "ns", limit=ROOTS))
    return rows


def instruction_sets() -> list[Row]:
    """The averaged loop compiled for older processors."""
    rows, plain, limited = [], without_limit(closed_form("table")), closed_form("survival")
    kinds = (("no limit", plain, "step", {"avx2": 3500.0}), ("projection limiter", limited, "grid", {}))
    for (what, study, family, asked), target in itertools.product(kinds, ("avx2", "sse2")):
        part = prepared(study, family, "averaged", target=target)
        name = f"averaged, {what}, {part.spec.width} lanes, compiled for {target}, one core: loop"
        factor = figure([study.converter.T_s * 1e9 / value for value in nanoseconds(part)])
        rows.append(Row("lanes", name, factor, "RT", 166.0, MOTULATOR, asked.get(target), ROOTS))
    return rows


def compilation() -> list[Row]:
    """Both bridges' loops of the lanes from nothing, in this process: what earlier ones have kept is not looked at."""
    study, values = without_limit(closed_form("table")), []
    for _ in range(3):
        for cached in (loop_of, spec_of, compiled_loop):
            cached.cache_clear()
        begin = time.process_time()
        with environment({FOLDER: ""}):
            for switched in (False, True):
                loop_of(kind_of(study, switched=switched)._replace(watch=STEP), (), side_by_side(strict=False))
        values.append(time.process_time() - begin)
    return [Row("lanes", "compile the lanes' loops, both bridges", figure(values), "s", limit="LLVM")]


def cases() -> list[Row]:
    """Whole batches: rests, program, gains, loop, verdicts; and how the cost grows."""
    rows, study = [], closed_form("survival")
    spec = study.controllers[-1]
    for family, count in (("step", 512), ("step", 2048), ("grid", 2048)):
        some = drawn(study, family, count)
        run_lanes(study, spec, NOTHING, some.take(np.arange(16)))
        values = []
        for _ in range(3):
            begin = time.process_time()
            run_lanes(study, spec, NOTHING, some)
            values.append((time.process_time() - begin) / count * 1e3)
        what = f"{count} cases of {'2' if family == 'step' else '2.7'} s, {family}, projection limiter: one case"
        rows.append(Row("lanes", what, figure(values), "ms", limit="the loop takes 70 to 85 %"))
    return [*rows, *field_cases()]


def field_cases(count: int = 128) -> list[Row]:
    """Steps of a controller that finds its grid with the field estimator, each with a background and sensors of its own
    and beside the same run without the step."""
    study = load_study(STUDIES / "field" / "study.toml")
    spec = next(one for one in study.controllers if one.name == "FIELD")
    some, values = drawn(replace(study, controllers=(spec,)), "step", count), []
    for _ in range(3):
        begin = time.process_time()
        run_lanes(study, spec, NOTHING, some)
        values.append((time.process_time() - begin) / count * 1e3)
    what = f"{count} steps with field estimator, background, sensors and twins: one case"
    return [Row("lanes", what, figure(values[1:]), "ms", limit="a quarter is the loop; random numbers, the source")]


BENCHMARKS = {"lanes": loop, "lanes-sets": instruction_sets, "lanes-compile": compilation, "lanes-cases": cases}
