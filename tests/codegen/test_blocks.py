"""Blocks put together: the same numbers as one after the other, in plain Python and as machine code."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.codegen.plain_blocks import Plain
from vsgdesign.codegen.blocks import Part, Writer, abreast, joined, renamed, with_outputs
from vsgdesign.codegen.expressions import Number
from vsgdesign.codegen.llvm import LoopSpec, aligned_zeros, compiled_loop, flat_block
from vsgdesign.codegen.loop_spec import Product
from vsgdesign.equations.frames import clarke_inverse, rotate


def length(turned_x: Any, y: Any) -> Any:
    """Returns (size, angle)."""
    return np.sqrt(turned_x * turned_x + y * y), np.arctan2(y, turned_x)


def test_an_input_is_the_output_of_its_name() -> None:
    """``turned_x`` comes from the block before; y is asked for under another name; x, cosine and sine come in."""
    both = joined(Part(flat_block(rotate)), Part(flat_block(length), {"y": "turned_y"}))
    assert both.inputs == ("x", "y", "cosine", "sine")
    values = {"x": 3.0, "y": 4.0, "cosine": 0.6, "sine": 0.8}
    found = Plain(both)(values)
    assert found["size"] == pytest.approx(5.0, rel=1e-15)
    assert (found["turned_x"], found["turned_y"]) == rotate(3.0, 4.0, 0.6, 0.8)
    assert found["angle"] == pytest.approx(np.arctan2(found["turned_y"], found["turned_x"]), rel=3e-16)


def test_equal_operations_are_shared_and_others_left_out() -> None:
    once = flat_block(clarke_inverse)
    twice = joined(Part(once), Part(once))
    assert len(twice.lets) == len(once.lets)
    alone = with_outputs(twice, (twice.outputs[0][0],))
    assert len(alone.lets) < len(once.lets)
    assert [name for name, _ in alone.outputs] == [twice.outputs[0][0]]


def test_plain_python_has_the_bits_of_a_strict_loop() -> None:
    both = joined(Part(flat_block(rotate)), Part(flat_block(length), {"y": "turned_y"}))
    spec = LoopSpec((both,), (("x", "angle"), ("y", "size")), ("cosine", "sine"), logged=("size", "angle"), strict=True)
    rows, log = np.array([0.3, -0.7, 0.8, 0.61])[None, :, None].copy(), np.empty((1, 50, 2, 1))
    here = dict(zip(spec.rows, rows.ravel().tolist(), strict=True))
    compiled_loop(spec)(0, 50, rows, np.zeros(0), log=log, every=1)
    for k in range(50):
        found = Plain(both)(here)
        assert [found["size"], found["angle"]] == log[0, k, :, 0].tolist()
        here |= {"x": found["angle"], "y": found["size"]}


def test_a_standing_loop_does_what_a_call_does() -> None:
    line = Writer()
    line.output("next", line.sum_of(line.input("x"), line.input("fed"), Number(1.0)))
    loop = compiled_loop(LoopSpec((line.block(),), (("x", "next"),), fed=("fed",), logged=("x",), strict=True))
    fed = np.arange(12.0).reshape(1, 12, 1, 1)
    one, other = np.zeros((1, 1, 1)), np.zeros((1, 1, 1))
    logs = np.zeros((2, 1, 6, 1, 1))
    loop(0, 12, one, np.zeros(0), fed=fed, log=logs[0], every=2)
    standing = loop.standing(other, np.zeros(0), log=logs[1], every=2)
    parts = ((0, 5), (5, 5), (5, 12))
    assert [standing(begin, end, fed[:, begin:end].copy()) for begin, end in parts] == [5, 0, 7]
    assert one.tobytes() == other.tobytes()
    assert logs[0].tobytes() == logs[1].tobytes()
    with pytest.raises(ValueError, match=r"log has 6 slots: give 7"):
        standing(12, 13, fed[:, :1].copy())
    with pytest.raises(ValueError, match=r"fed is missing"):
        standing(0, 1)
    with pytest.raises(ValueError, match=r"begin"):
        standing(3, 2, fed[:, :1].copy())


def test_a_limit_without_end_is_a_number() -> None:
    """A sensor that never saturates has an infinite limit; only what is no number is refused."""
    line = Writer()
    line.output("next", line.does("min", line.input("x"), line.input("limit")))
    loop = compiled_loop(LoopSpec((line.block(),), (("x", "next"),), uniform=("limit",), strict=True))
    rows = np.ones((1, 1, 1))
    assert loop(0, 3, rows, np.array([np.inf])) == 3
    assert rows[0, 0, 0] == 1.0
    with pytest.raises(ValueError, match="uniform has NaN"):
        loop(0, 3, rows, np.array([np.nan]))


def within(theta: Any, least: Any, most: Any) -> Any:
    """An angle drawn back by a turn, its extremes, and one of them. Returns (drawn, smallest, largest, chosen)."""
    drawn = theta - 6.25 * (theta > 6.25) + 6.25 * (theta < -6.25)
    late = 1.0 * (theta > 6.25)
    return drawn, np.minimum(least, theta), np.maximum(most, theta), np.where(1.0 - late > 0.5, least, most)


def test_what_is_done_with_one_of_two_numbers_is_done_before_the_choice() -> None:
    block = flat_block(within)
    assert [value.name for _, value in block.lets if value.name == "*"] == []  # type: ignore[union-attr]
    assert sum(value.name == ">" for _, value in block.lets) == 1  # type: ignore[union-attr]
    for theta in (-7.0, -6.25, 0.3, 6.25, 6.5, math.nan):
        expected = [float(value) for value in within(theta, -1.0, 2.0)]
        found = list(Plain(block)({"theta": theta, "least": -1.0, "most": 2.0}).values())
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("strict", [True, False])
def test_nan_stays_through_extremes(strict: bool) -> None:
    """An extreme may begin at infinity."""
    outputs = [name for name, _ in flat_block(within).outputs]
    block = with_outputs(flat_block(within), tuple(outputs[1:3]))
    state = (("least", outputs[1]), ("most", outputs[2]))
    loop = compiled_loop(LoopSpec((block,), state=state, constant=("theta",), lanes=4, strict=strict))
    inf, nan = math.inf, math.nan
    rows = aligned_zeros((1, 3, 4))
    rows[0] = [[inf, inf, nan, 1.0], [-inf, -inf, nan, 1.0], [2.0, nan, 3.0, 3.0]]
    loop(0, 1, rows, np.zeros(0))
    np.testing.assert_array_equal(rows[0, :2], [[2.0, nan, nan, 1.0], [2.0, nan, nan, 3.0]])
    assert rows.ctypes.data % 64 == 0


def turned(x: Any, y: Any, speed: Any, share: Any, least: Any) -> Any:
    """Returns (next_x, next_y)."""
    angle = np.arctan2(y, x) + speed * share
    size = np.hypot(x, y)
    size = least if size < least else size / (1.0 + share)
    return size * np.cos(angle), size * np.sin(angle)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_several_at_once_have_the_bits_of_one_after_the_other(count: int) -> None:
    """``share`` is the same for all of them, ``speed`` a number of each, and x and y are those of the sample before."""
    names = [lambda name, k=k: name if name in ("share", "least") else f"u{k}.{name}" for k in range(count)]
    block, units = flat_block(turned), range(count)
    both = abreast(block, names, 8), joined(*(Part(renamed(block, name)) for name in names))
    state = tuple((f"u{k}.{one}", f"u{k}.next_{one}") for k in units for one in ("x", "y"))
    given = np.random.default_rng(7).uniform(-2.0, 2.0, 3 * count)
    logs = np.empty((2, 1, 40, 2 * count, 1))
    for own, log in zip(both, logs, strict=True):
        spec = LoopSpec(
            (own,), state, (*(f"u{k}.speed" for k in units),), ("share", "least"),
            logged=tuple(name for name, _ in state), strict=True,
        )  # fmt: skip
        compiled_loop(spec)(0, 40, given[None, :, None].copy(), np.array([0.13, 0.7]), log=log, every=1)
    assert logs[0].tobytes() == logs[1].tobytes()
    assert np.ptp(logs[0, 0, -1, :, 0]) > 0.5
    with pytest.raises(ValueError, match="for several at once, in 2 lanes: give one lane"):
        LoopSpec((both[0],), state, tuple(f"u{k}.speed" for k in units), ("share", "least"), lanes=2).check()


@pytest.mark.parametrize(("rows", "lanes"), [(1, 1), (5, 1), (11, 1), (19, 1), (11, 4)])
def test_products_of_one_matrix_are_sums_in_order(rows: int, lanes: int) -> None:
    draws = np.random.default_rng(rows)
    matrix, factors = draws.normal(size=(3, rows, lanes)), draws.normal(size=(2, 3, lanes))
    line = Writer()
    results = [tuple(f"{head}.{row}" for row in range(rows)) for head in "ab"]
    own = [tuple(f"{head}{k}" for k in range(3)) for head in "xy"]
    for name in (*own[0], *own[1]):
        line.output(f"next.{name}", line.input(name))
    for name in (one for some in results for one in some):
        line.output(f"said.{name}", line.input(name))
    places = tuple(f"m{k}" for k in range(3 * rows))
    spec = LoopSpec(
        (line.block(),),
        tuple((name, f"next.{name}") for some in own for name in some),
        places,
        products=tuple(Product(some, places, given) for some, given in zip(results, own, strict=True)),
        logged=tuple(f"said.{name}" for some in results for name in some),
        lanes=lanes,
        strict=True,
    )
    log = np.empty((1, 1, 2 * rows, lanes))
    given = np.concatenate([factors.reshape(6, lanes), matrix.reshape(-1, lanes)])
    compiled_loop(spec)(0, 1, given[None].copy(), np.zeros(0), log=log, every=1)
    for which in range(2):
        found = np.zeros((rows, lanes))
        for k in range(3):
            found = found + matrix[k] * factors[which, k]
        assert found.tobytes() == log[0, 0, which * rows : (which + 1) * rows].tobytes()
