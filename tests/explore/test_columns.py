"""Columns of numbers of a page: what is packed is what is read."""

from __future__ import annotations

import numpy as np
import pytest

from vsgdesign.report.explore.lattice import BITS, Columns, rounded

COUNT, WIDTH = 31, 7


def read(columns: Columns) -> list[np.ndarray | float]:
    """The columns, number by number: as page/columns.js reads them."""
    document, data = columns.document(), columns.packed()
    kinds = document["kinds"]
    same = iter(np.frombuffer(data, "<f8", kinds.count("s")).tolist())
    at = 8 * kinds.count("s")

    def words(planes: int, left: bool) -> list[int]:
        nonlocal at
        found = []
        for j in range(COUNT):
            value = sum(data[at + k * COUNT + j] << (8 * k) for k in range(planes))
            if left:
                value = value >> 1 if value % 2 == 0 else -((value + 1) >> 1)
                before = [found[j - lag] if j >= lag else 0 for lag in (1, WIDTH, WIDTH + 1)]
                value = (value + before[0] + before[1] - before[2]) % 2 ** (8 * planes)
            found.append(value)
        at += planes * COUNT
        return found

    found: dict[int, np.ndarray | float] = {k: next(same) for k, kind in enumerate(kinds) if kind == "s"}
    for kind in "efdw":
        for k in (k for k, own in enumerate(kinds) if own == kind):
            if kind == "e":
                low, high = words(4, False), words(4, True)
                found[k] = np.array([a | b << 32 for a, b in zip(low, high, strict=True)], "<u8").view("<f8")
            else:
                whole = np.array(words({"f": 4}.get(kind, 3), True), "<u8") << document["dropped"][kind]
                found[k] = whole.astype("<u4") if kind == "w" else whole.astype("<u4").view("<f4")
    assert at == len(data)
    return [found[k] for k in range(len(kinds))]


def test_every_kind_comes_back() -> None:
    rng = np.random.default_rng(5)
    noise, path, whole = rng.normal(size=COUNT), np.cumsum(rng.normal(size=COUNT)), rng.integers(0, 2**24, COUNT)
    some = np.where(path > 0.0, path, np.nan)
    columns = Columns(COUNT, WIDTH)
    places = [
        columns.exact(noise),
        columns.figure(path),
        columns.shape(some),
        columns.whole(whole),
        columns.exact(path),
    ]
    assert columns.exact(np.full(COUNT, 0.1)) == 5
    assert columns.exact(path) == places[4]  # equal columns are one
    found = read(columns)
    np.testing.assert_array_equal(found[0], noise)
    np.testing.assert_array_equal(found[4], path)
    np.testing.assert_array_equal(found[3], whole)
    np.testing.assert_allclose(found[1], path, rtol=2.0 ** -(BITS["figure"] + 1))
    np.testing.assert_allclose(found[2], some, rtol=2.0 ** -(BITS["shape"] + 1))
    assert found[5] == 0.1


def test_a_column_has_a_number_for_every_cell() -> None:
    with pytest.raises(ValueError, match="a column has 31 numbers"):
        Columns(COUNT, WIDTH).exact(np.zeros(COUNT - 1))


def test_rounding_keeps_what_is_not_finite() -> None:
    values = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, np.pi, -1e-30, 3.4e38])
    found = rounded(values, 11)
    np.testing.assert_array_equal(found[:6], values[:6].astype(np.float32))
    np.testing.assert_allclose(found[6:], values[6:], rtol=2.0**-12)
