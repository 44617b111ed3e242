"""Normal numbers that are drawn by machine code, against those of NumPy and against the normal distribution."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from vsgdesign.codegen.many_normals import ManyNormalStreams
from vsgdesign.codegen.normals import AREA, TAIL, NormalStream, layers

COUNT = 300_000
"""Some eighty of so many lie in the tail, and four thousand on the edge of a layer."""


def drawn(seed: int, count: int) -> np.ndarray:
    found = np.empty((count, 1))
    NormalStream(np.random.PCG64(seed)).put(found, np.ones(1))
    return found[:, 0]


@pytest.mark.parametrize("seed", [1, 2])
def test_the_numbers_of_a_seed_are_those_of_numpy(seed: int) -> None:
    """To the last digits: NumPy's layers are rounded from others, 2e-14 beside these."""
    ours, theirs = drawn(seed, COUNT), np.random.Generator(np.random.PCG64(seed)).standard_normal(COUNT)
    assert np.abs(theirs).max() > float(TAIL)
    assert np.abs(ours / theirs - 1.0).max() < 5e-14


def test_layers_have_the_same_area_and_end_at_the_top() -> None:
    """Marsaglia and Tsang: x_k (f(x_(k-1)) − f(x_k)) is the same for all, and the uppermost one closes at f = 1."""
    table, area = layers(), float(AREA)
    edges = table["width"] * 2.0**52
    strips = edges[1:] * (table["upper"][1:] - table["lower"][1:])
    assert np.abs(strips / area - 1.0).max() < 1e-12  # the difference of two densities near 1 leaves no more
    assert table["upper"][1] == 1.0
    assert table["inside"][1] == 0
    assert np.abs(table["inside"][2:] / 2.0**52 * edges[2:] - edges[1:-1]).max() < 1e-14
    tail = math.sqrt(math.pi / 2.0) * math.erfc(float(TAIL) / math.sqrt(2.0))
    assert area == pytest.approx(float(TAIL) * math.exp(-0.5 * float(TAIL) ** 2) + tail, rel=1e-13)


def test_numbers_lie_where_they_are_wanted() -> None:
    """Rows and columns anywhere, each times its scale; nothing else is touched."""
    numbers, scale = drawn(7, 60).reshape(20, 3), np.array([1.0, 2.0, 0.5])
    room = np.full((20, 5, 4), np.nan)
    stream = NormalStream(np.random.PCG64(7))
    for rows in (slice(0, 8), slice(8, 20)):  # it goes on where it was
        stream.put(room[rows, 1:4, 2], scale)
    assert room[:, 1:4, 2].tobytes() == (numbers * scale).tobytes()
    room[:, 1:4, 2] = np.nan
    assert np.isnan(room).all()
    stream = NormalStream(np.random.PCG64(7))
    stream.skip(41)
    last = np.empty((19, 1))
    stream.put(last, np.ones(1))
    assert last.tobytes() == numbers.reshape(-1)[41:].tobytes()
    stream.put(np.empty((0, 3)), scale)


@pytest.mark.parametrize(("lanes", "copies"), [(8, 2), (4, 1)])
def test_many_streams_are_those_of_one_after_the_other(lanes: int, copies: int) -> None:
    """Every lane in rows of its own, with its own scale; a lane that waits or has taken another stream keeps its
    numbers. So many of them lie on edges of layers and in the tail, too."""
    scale = np.random.default_rng(1).uniform(0.5, 2.0, (3, lanes))
    many, streams = ManyNormalStreams(scale, copies), [NormalStream(np.random.PCG64(k)) for k in range(lanes)]
    for lane, stream in enumerate(streams):
        many.take(lane, stream)
    out = np.full((4000, 5, lanes * copies), np.nan)
    many.first[:], many.until[:] = np.arange(lanes) * 7 % 5, 4000 - np.arange(lanes) * 11 % 6
    many.put(out[:, 1:4], 0, 1500)
    streams[1] = NormalStream(np.random.PCG64(99))
    many.take(1, streams[1])
    many.put(out[:, 1:4], 1500, 4000)
    for lane, stream in enumerate(streams):
        rows = slice(1500 if lane == 1 else many.first[lane], many.until[lane])
        wanted = np.empty((rows.stop - rows.start, 3))
        stream.put(wanted, np.ascontiguousarray(scale[:, lane]))
        for copy in range(copies):
            assert out[rows, 1:4, lane * copies + copy].tobytes() == wanted.tobytes(), (lane, copy)
    assert np.isnan(out[:, ::4]).all()
    for room, rows in ((out[:, 1:4, 1:], (0, 1)), (out, (0, 1)), (out[:, 1:4], (3, 4001))):
        with pytest.raises(ValueError, match="give"):
            many.put(room, *rows)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="give a PCG64"):
        NormalStream(np.random.SFC64(1))
    stream = NormalStream(np.random.PCG64(1))
    single: Any = np.empty((2, 3), dtype=np.float32)
    for room, scale in ((single, np.ones(3)), (np.empty((2, 3)), np.ones(2))):
        with pytest.raises(ValueError, match="give float64"):
            stream.put(room, scale)
