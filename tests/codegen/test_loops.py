"""What a loop has besides its samples, against a loop that Python runs: groups, bodies, rings, logs, programs."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.codegen.twins import twin
from tests.codegen.wasm_host import Host, WasmLoop
from vsgdesign.codegen import wasm
from vsgdesign.codegen.llvm import LoopSpec, Program, best_lanes, compiled_loop, empty_rows, flat_block
from vsgdesign.codegen.llvm_loop import loop_text
from vsgdesign.codegen.machine_code import assembly, host, instruction_set, object_of, target_named
from vsgdesign.codegen.wasm import STACK, wasm_module
from vsgdesign.equations.notation import Count, Numbers


class Moved(NamedTuple):
    x: Any
    y: Any


class Given(NamedTuple):
    slope: Any
    limit: Any


def rising(z: Moved, given: Given, share: Any, level: Any, pushed: Any, late: Any, k: Any) -> Any:
    """Returns (after, kept, enough)."""
    x = z.x + share * (given.slope - z.x) + 0.01 * pushed
    y = z.y + level * np.sin(x) - 1e-3 * late * k / (1.0 + share)
    kept = np.minimum(np.maximum(x * y, -given.limit), given.limit)
    return Moved(x, y), kept, np.where(y > 3.0, 1.0, 0.0)


def falling(z: Moved, given: Given, share: Any, level: Any, pushed: Any, late: Any, k: Any) -> Any:
    """Returns (after, kept, enough)."""
    x = z.y * given.slope / (1.0 + given.limit * given.limit) + pushed
    after = Moved(x, z.x - share * late + level if k > 3.0 else z.x)
    return after, np.sqrt(np.abs(z.x)) - given.limit, np.where(after.y > 3.0, 1.0, 0.0)


FUNCTIONS = rising, falling
SPEC = LoopSpec(
    bodies=tuple(flat_block(function) for function in FUNCTIONS),
    state=(("z.x", "after.x"), ("z.y", "after.y")),
    constant=("given.slope", "given.limit"),
    uniform=("share",),
    cyclic=("level",),
    fed=("pushed",),
    rings=(("late", "kept"),),
    logged=("kept", "z.y", "after.x"),
    index="k",
    lanes=2,
    vectors=2,
    strict=True,
)
GROUPS, END, EVERY, ORIGIN = 3, 60, 7, 5
LENGTHS = np.array([1, 4, 9])


class Run(NamedTuple):
    """Everything that a call is given and moves."""

    rows: np.ndarray
    cyclic: np.ndarray
    cycle: np.ndarray
    fed: np.ndarray
    rings: np.ndarray
    log: np.ndarray
    program: Program


def drawn(seed: int = 0) -> Run:
    rng = np.random.default_rng(seed)
    rows = empty_rows(SPEC, GROUPS)
    rows[:] = rng.uniform(0.1, 1.0, rows.shape)
    first = np.array([0, 6, 6, 13])
    count = first[-1]
    at = np.concatenate([np.sort(rng.integers(0, END, n)) for n in np.diff(first)])
    source = rng.integers(0, 20, count)
    source[::3] = -1 - rng.integers(0, 2, len(source[::3]))
    return Run(
        rows,
        rng.uniform(0.0, 1.0, (5, 1)),
        np.array([0, 1, 1, 0, 0]),
        rng.normal(0.0, 1.0, (GROUPS, END, 1, 4)),
        rng.normal(0.0, 1.0, (GROUPS, 9, 1, 4)),
        np.zeros((GROUPS, 20, 3, 4)),
        Program(
            first, at, rng.integers(0, 4, count), rng.integers(0, 3, count), rng.integers(0, 3, count) % 2 + 1,
            source, rng.uniform(0.0, 1.0, 30), first[:-1].copy(),
        ),
    )  # fmt: skip


def test_a_log_may_begin_later() -> None:
    whole, part = drawn(), drawn()
    call(compiled_loop(SPEC), whole, 0, END)
    call(compiled_loop(SPEC), part, 0, 4 * EVERY)
    late = part._replace(log=np.full_like(part.log[:, : part.log.shape[1] - 4], np.nan))
    call(compiled_loop(SPEC), late, 4 * EVERY, END, log_begin=4 * EVERY)
    slots = (END - 1) // EVERY + 1
    np.testing.assert_array_equal(late.log[:, : slots - 4], whole.log[:, 4:slots])
    assert np.isnan(late.log[:, slots - 4 :]).all()


def call(loop: Any, run: Run, begin: int, end: int, **more: int) -> int:
    return loop(
        begin, end, run.rows, np.array([0.3]), cyclic=run.cyclic, cycle=run.cycle, fed=run.fed[:, begin:end],
        rings=run.rings, ring_length=LENGTHS, log=run.log, every=EVERY, origin=ORIGIN, program=run.program, **more,
    )  # fmt: skip


def by_python(run: Run, stop: bool = False) -> int:
    """The same, a lane and a sample at a time."""
    bodies: list[Callable[..., Any]] = [twin(function) for function in FUNCTIONS]
    p, lanes = run.program, run.rows.shape[2]
    for g in range(len(run.rows)):
        for k in range(END):
            while p.done[g] < p.first[g + 1] and p.at[p.done[g]] <= k:
                at = p.done[g]
                n, lane, source = p.count[at], p.lane[at], p.source[at]
                rows = run.rows[g, :, lane]
                new = p.values[source : source + n] if source >= 0 else rows[-1 - source : -1 - source + n].copy()
                rows[p.row[at] : p.row[at] + n] = new
                p.done[g] += 1
            stopped = False
            slot = k % LENGTHS[g]
            for lane in range(lanes):
                x, y, slope, limit = run.rows[g, :, lane].tolist()
                level, pushed, late = run.cyclic[k % 5, 0], run.fed[g, k, 0, lane], run.rings[g, slot, 0, lane]
                given = float(level), float(pushed), float(late), float(k - ORIGIN)
                moved, kept, enough = bodies[run.cycle[k % 5]](Moved(x, y), Given(slope, limit), 0.3, *given)
                if k % EVERY == 0:
                    run.log[g, k // EVERY, :, lane] = kept, y, moved.x
                run.rows[g, :2, lane] = moved
                run.rings[g, slot, 0, lane] = kept
                stopped |= enough != 0.0
            if stop and stopped:
                return k + 1
    return END


def same(a: Run, b: Run) -> None:
    for name in ("rows", "rings", "log"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    np.testing.assert_array_equal(a.program.done, b.program.done)


@pytest.mark.parametrize("cuts", [(0, 60), (0, 1, 6, 7, 30, 31, 60)])
def test_everything_at_once(cuts: tuple[int, ...]) -> None:
    """The records of a program within one call or over several, at their samples."""
    ours, expected = drawn(), drawn()
    by_python(expected)
    loop = compiled_loop(SPEC)
    for begin, end in itertools.pairwise(cuts):
        assert call(loop, ours, begin, end) == end - begin
    same(ours, expected)
    assert (ours.program.done == ours.program.first[1:]).all()
    assert np.abs(ours.rows).max() > 1.0


@pytest.mark.parametrize("lanes", [1, 2, 4])
@pytest.mark.parametrize("target", ["sse2", "avx2", "avx512"])
def test_every_instruction_set_gives_the_same_bits(target: str, lanes: int) -> None:
    try:
        instruction_set(target)
    except ValueError:
        assert target not in ("sse2",) or not host().x86
        return
    ours, expected = drawn(), drawn()
    call(compiled_loop(SPEC), expected, 0, END)
    call(compiled_loop(dataclasses.replace(SPEC, lanes=lanes, vectors=4 // lanes), target), ours, 0, END)
    same(ours, expected)


def test_another_host_gives_the_same_bits() -> None:
    """WebAssembly, which this process cannot run."""
    ours, expected = drawn(), drawn()
    call(compiled_loop(SPEC), expected, 0, END)
    loop = WasmLoop(dataclasses.replace(SPEC, lanes=target_named("wasm").lanes, vectors=2))
    for begin, end in itertools.pairwise((0, 1, 6, 7, 30, 31, END)):
        assert call(loop, ours, begin, end) == end - begin
    same(ours, expected)
    assert "f64x2.mul" in assembly(loop_text(loop.spec), "wasm")  # both lanes at once
    with pytest.raises(ValueError, match="this processor cannot run it, for it is another machine"):
        instruction_set("wasm")


def test_several_loops_are_one_module() -> None:
    """Each with constants of its own, and with a stack that is not theirs."""
    rows = [(3.0, 1.0, 4.0), (1.0, 5.0, 9.0)]
    specs = {f"row_{at}": constants_spec(row) for at, row in enumerate(rows)}
    module = wasm_module(specs)
    host = Host(module)
    assert sorted(host.names) == ["free", "memory", "row_0", "row_1"]
    assert host.free >= 2 * 24 + STACK
    for name, row in zip(specs, rows, strict=True):
        loop = WasmLoop(specs[name], name, host)
        state = np.array([[[2.0, 0.0]], [[1.0, 1.0]]])
        loop(0, 1, state, np.zeros(0))
        np.testing.assert_array_equal(state.ravel(), [row[2], row[0], row[1], row[1]])


def constants_spec(row: tuple[float, ...]) -> LoopSpec:
    """A loop whose state becomes the number of a row that is known."""
    block = flat_block(picked, fixed={"table": Table(row)})
    return LoopSpec((block,), (("at", "picked"),), lanes=2, strict=True)


class Table(NamedTuple):
    row: Numbers


def picked(table: Table, at: Count) -> Any:
    return 1.0 * table.row[at]


@pytest.mark.parametrize("names", [(), ("memory",), ("free",), ("of table",), ("größe",)])
def test_names_that_a_module_cannot_have(names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="give at least one, each with a name of letters"):
        wasm_module(dict.fromkeys(names, SPEC))


def test_a_module_has_no_library() -> None:
    text = "declare double @sin(double)\ndefine double @f(double %x) {\n  %y = call double @sin(double %x)\n"
    data, functions = object_of([text + "  ret double %y\n}\n"], "wasm")
    with pytest.raises(ValueError, match="a loop for WebAssembly needs __linear_memory, sin: no library is there"):
        wasm._linked(data, {"f": functions.index("f")})


def test_a_loop_that_may_round_less_is_near() -> None:
    ours, expected = drawn(), drawn()
    call(compiled_loop(dataclasses.replace(SPEC, strict=False)), ours, 0, END)
    by_python(expected)
    np.testing.assert_allclose(ours.rows, expected.rows, rtol=1e-12)


def test_a_loop_stops_after_the_sample_that_says_so() -> None:
    spec = dataclasses.replace(SPEC, stop="enough")
    ours, expected = drawn(3), drawn(3)
    empty = np.zeros(0, np.int64)
    program = Program(np.array([0, 0]), empty, empty, empty, empty, empty, np.zeros(0), np.array([0]))
    one, other = (
        Run(run.rows[:1].copy(), run.cyclic, run.cycle, run.fed[:1], run.rings[:1], run.log[:1], program)
        for run in (ours, expected)
    )
    loop = compiled_loop(spec)
    done = loop(
        0, END, one.rows, np.array([0.3]), cyclic=one.cyclic, cycle=one.cycle, fed=one.fed, rings=one.rings,
        ring_length=LENGTHS[:1], log=one.log, every=EVERY, origin=ORIGIN,
    )  # fmt: skip
    assert 0 < done == by_python(other, stop=True) < END
    same(one, other)


@pytest.mark.parametrize(("lanes", "vectors"), [(2, 2), (1, 1)])
def test_each_lane_may_log_in_slots_of_its_own(lanes: int, vectors: int) -> None:
    """Slots that a block computes for each lane, against a log of all samples; what lies outside lands at the ends."""

    def counted(own: Any, pace: Any, first: Any) -> Any:
        """Returns (after, slot, value)."""
        return own + pace, own - first, own * own + pace

    width = lanes * vectors
    block = flat_block(counted)
    spec = LoopSpec(
        (block,), (("own", "after"),), ("pace",), ("first",), logged=("value", "own"), slot="slot",
        lanes=lanes, vectors=vectors, strict=True,
    )  # fmt: skip
    rows, log = empty_rows(spec, 2), np.full((2, width, 20, 2), np.nan)
    rows[:, 0], rows[:, 1] = np.arange(2 * width).reshape(2, width), [np.ones(width), np.arange(width) % 2]
    own, pace = rows[:, 0].copy(), rows[:, 1].copy()
    compiled_loop(spec)(0, 25, rows, np.array([4.0]), log=log, every=1)
    expected = np.full_like(log, np.nan)
    for k, group, lane in itertools.product(range(25), range(2), range(width)):
        now = own[group, lane] + k * pace[group, lane]
        expected[group, lane, int(np.clip(now - 4.0, 0, 19))] = now * now + pace[group, lane], now
    np.testing.assert_array_equal(log, expected)
    for wrong, said in ((log[:, :, :9], "not one behind the other"), (log.swapaxes(1, 2), "log has the shape")):
        with pytest.raises(ValueError, match=said):
            compiled_loop(spec)(0, 1, rows, np.array([4.0]), log=wrong, every=1)


def test_a_loop_that_is_compiled_quickly_has_the_same_bits() -> None:
    ours, expected = drawn(), drawn()
    call(compiled_loop(SPEC), expected, 0, END)
    call(compiled_loop(SPEC, quickly=True), ours, 0, END)
    same(ours, expected)


def test_rows_behind_those_of_the_loop_are_a_store() -> None:
    """A program copies into them what a lane was, and a call takes the first groups alone."""
    ours, expected = drawn(), drawn()
    rows = np.zeros((GROUPS, 6, 4))
    rows[:, :4] = ours.rows
    first, zero = np.array([0, 1, 1, 1]), np.zeros(1, np.int64)
    program = Program(first, np.array([30]), zero, zero + 4, zero + 2, zero - 1, np.zeros(0), first[:-1].copy())
    none = np.zeros(0, np.int64)
    start = np.zeros(GROUPS + 1, np.int64)
    loop, empty = compiled_loop(SPEC), Program(start, none, none, none, none, none, np.zeros(0), start[1:].copy())
    call(loop, ours._replace(rows=rows, program=program), 0, 30)
    assert not rows[:, 4:].any(), "A record at the end of a call belongs to the next one."
    call(loop, ours._replace(rows=rows, program=program), 30, END)
    call(loop, expected._replace(program=empty), 0, 30)
    np.testing.assert_array_equal(rows[0, 4:, 0], expected.rows[0, :2, 0])
    call(loop, expected._replace(program=empty), 30, END)
    np.testing.assert_array_equal(rows[:, :4], expected.rows)


def test_width_of_this_machine() -> None:
    assert best_lanes() == {"avx512": 8, "avx2": 4}.get(instruction_set(), 2)
    assert best_lanes("sse2") == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bodies": ()}, "bodies is empty"),
        ({"state": ()}, "input z.x has no place"),
        ({"state": (("z.x", "after.z"), ("z.y", "after.y"))}, "after.z is no output"),
        ({"uniform": ("share", "shade")}, "shade is no input"),
        ({"uniform": ("share", "z.x")}, "input z.x has 2 places"),
        ({"lanes": 3}, "lanes = 3: give 1, 2, 4 or 8"),
        ({"vectors": 0}, "vectors = 0: give 1 to 8"),
        ({"logged": ("share",)}, "logged share is neither"),
        ({"stop": "end"}, "end is no output"),
        ({"index": ""}, "input k has no place"),
    ],
)
def test_what_does_not_fit_together_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message.replace(".", r"\.")):
        compiled_loop(dataclasses.replace(SPEC, **change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rows": np.zeros((1, 4, 3))}, r"rows has the shape \(1, 4, 3\): give \(any, any, 4\)"),
        ({"rows": np.zeros((1, 3, 4))}, r"rows has the shape \(1, 3, 4\): give \(any, 4 or more, 4\)"),
        ({"rows": np.zeros((1, 4, 4), np.float32)}, "rows is of float32: give float64"),
        ({"rows": np.zeros((1, 8, 4))[:, ::2]}, "rows is not contiguous"),
        ({"uniform": np.array([np.nan])}, "uniform has NaN"),
        ({"fed": None}, r"fed is missing: give an array of shape \(1, any, 1, 4\)"),
        ({"fed": np.zeros((1, 5, 1, 4))}, "fed has 5 samples: give 10"),
        ({"cycle": np.array([0, 1, 2, 0, 0])}, "cycle names a body that is not there: give 0 to 1"),
        ({"cyclic": np.zeros((4, 1))}, r"cyclic has the shape \(4, 1\)"),
        ({"ring_length": np.array([10])}, "ring_length is beyond its ring of 9 samples"),
        ({"log": np.zeros((1, 2, 3, 4)), "every": 3}, "log has 2 slots: give 4"),
        ({"log": np.zeros((1, 2, 3, 4)), "begin": 4, "log_begin": 4}, "log has 2 slots: give 6"),
        ({"begin": 4, "log_begin": 5}, "log_begin = 5: give a multiple of 1 from 0 to 4"),
        ({"end": -1}, "samples 0 to -1"),
        ({"row": np.array([3])}, "record 0 of the program lies outside"),
        ({"first": np.array([0, 2])}, "first of the program does not lead"),
    ],
)
def test_what_a_loop_cannot_be_given_is_refused(change: dict[str, Any], message: str) -> None:
    zero = np.array([0])
    program = Program(np.array([0, 1]), np.array([2]), zero, zero, np.array([2]), zero, np.zeros(2), zero.copy())
    of_program = {name: change[name] for name in ("row", "first") if name in change}
    program, change = (
        dataclasses.replace(program, **of_program),
        {k: v for k, v in change.items() if k not in of_program},
    )
    given: dict[str, Any] = {
        "program": program,
        "begin": 0, "end": 10, "rows": np.zeros((1, 4, 4)), "uniform": np.zeros(1), "cyclic": np.zeros((5, 1)),
        "cycle": np.zeros(5, np.int64), "fed": np.zeros((1, 10, 1, 4)), "rings": np.zeros((1, 9, 1, 4)),
        "ring_length": np.array([9]), "log": np.zeros((1, 10, 3, 4)), "every": 1,
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        compiled_loop(SPEC)(**given | change)


def test_all_faults_at_once() -> None:
    with pytest.raises(ValueError, match=r"lanes = 5.*no place"):
        compiled_loop(dataclasses.replace(SPEC, lanes=5, uniform=()))


def test_a_target_that_is_none() -> None:
    with pytest.raises(ValueError, match="target = 'mmx': give one of native, avx512, avx2, sse2"):
        compiled_loop(SPEC, "mmx")
