"""Time series survive the disk, and a damaged file is said to be one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts import read_npz, write_csv, write_npz
from vsgdesign.artifacts.time_series import UNITS
from vsgdesign.errors import ArtifactError

DT = 2e-4


def all_series(samples: int = 101, begin: float = 0.0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    series = {name: 1e3 * rng.standard_normal(samples) for name in UNITS}
    return series | {"t_s": begin + DT * np.arange(samples)}


def test_npz_round_trip(tmp_path: Path) -> None:
    series = all_series()
    write_npz(tmp_path / "x.npz", series)
    back = read_npz(tmp_path / "x.npz")
    assert list(back) == list(series)
    np.testing.assert_array_equal(back["t_s"], series["t_s"])  # time is kept whole
    for name, values in series.items():
        assert back[name].dtype == np.float64
        np.testing.assert_allclose(back[name], values, rtol=6e-8, atol=0.0)  # single precision: 2⁻²⁴


def test_npz_is_single_precision_but_for_time(tmp_path: Path) -> None:
    write_npz(tmp_path / "x.npz", all_series())
    with np.load(tmp_path / "x.npz", allow_pickle=False) as raw:
        kinds = {name: raw[name].dtype for name in raw.files}
    assert kinds.pop("t_s") == np.float64
    assert set(kinds.values()) == {np.dtype(np.float32)}


def read_csv(path: Path) -> tuple[list[str], np.ndarray]:
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    return header.split(","), np.array([[float(cell) for cell in row.split(",")] for row in rows])


def test_csv_names_every_unit(tmp_path: Path) -> None:
    series = all_series()
    write_csv(tmp_path / "x.csv", series, DT)
    header, _ = read_csv(tmp_path / "x.csv")
    assert header == [f"{name} [{UNITS[name]}]" for name in series]
    assert {"t_s [s]", "v_pcc_a [V]", "P_pcc [W]", "Q_pcc [var]", "L_g [H]", "omega [rad/s]"} <= set(header)


def test_csv_round_trip(tmp_path: Path) -> None:
    series = all_series()
    write_csv(tmp_path / "x.csv", series, DT)
    _, table = read_csv(tmp_path / "x.csv")
    for k, (name, values) in enumerate(series.items()):
        tolerance = 1e-11 if name == "t_s" else 5e-7  # twelve digits and seven
        np.testing.assert_allclose(table[:, k], values, rtol=tolerance, atol=0.0)


@pytest.mark.parametrize(("interval", "step"), [(0.0, 1), (1e-5, 1), (DT, 1), (2e-3, 10), (5e-4, 2), (1.0, 5000)])
def test_csv_is_thinned(tmp_path: Path, interval: float, step: int) -> None:
    series = all_series()
    write_csv(tmp_path / "x.csv", series, interval)
    _, table = read_csv(tmp_path / "x.csv")
    np.testing.assert_allclose(table[:, 0], series["t_s"][::step], rtol=1e-11, atol=0.0)
    column = list(series).index("P_pcc")
    np.testing.assert_allclose(table[:, column], series["P_pcc"][::step], rtol=5e-7, atol=0.0)


def test_csv_tells_samples_apart_late_in_a_long_run(tmp_path: Path) -> None:
    """Seven digits would put 3600.0002 s on 3600 s."""
    series = {"t_s": 3600.0 + 5e-5 * np.arange(50, dtype=np.float64)}
    write_csv(tmp_path / "x.csv", series, 0.0)
    _, table = read_csv(tmp_path / "x.csv")
    np.testing.assert_allclose(np.diff(table[:, 0]), 5e-5, rtol=1e-6)


def test_csv_of_one_sample(tmp_path: Path) -> None:
    write_csv(tmp_path / "x.csv", all_series(1), 0.002)
    _, table = read_csv(tmp_path / "x.csv")
    assert table.shape == (1, len(UNITS))


@pytest.mark.parametrize("content", [b"", b"not a time series", b"PK\x03\x04", b"\x93NUMPY", b"\x80\x04]\x94."])
def test_what_is_no_npz(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(ArtifactError, match=r"x\.npz\" is not a readable time series"):
        read_npz(tmp_path / "x.npz")


def test_no_file_a_folder_and_a_lone_array(tmp_path: Path) -> None:
    np.save(tmp_path / "lone.npy", np.arange(3.0))
    for path in (tmp_path / "missing.npz", tmp_path, tmp_path / "lone.npy"):
        with pytest.raises(ArtifactError, match="not a readable time series"):
            read_npz(path)


def test_pickled_objects_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", t_s=np.array([{"code": "runs"}], dtype=object))
    with pytest.raises(ArtifactError):
        read_npz(tmp_path / "x.npz")


def test_no_damage_gives_wrong_numbers_or_another_error(tmp_path: Path) -> None:
    """Cut short, or with one to three bytes changed: refused, or (bytes that mean nothing) read unharmed.

    Every value is covered by a checksum; a damaged directory may at most rename a series.
    """
    series = {"t_s": DT * np.arange(20), "P_pcc": np.linspace(1.0, 2.0, 20)}
    write_npz(tmp_path / "x.npz", series)
    whole = (tmp_path / "x.npz").read_bytes()
    rng = np.random.default_rng(5)
    damaged = tmp_path / "damaged.npz"
    refused = 0
    for attempt in range(600):
        content = bytearray(whole)
        if attempt % 3 == 0:
            content = content[: rng.integers(0, len(whole))]
        else:
            for where in rng.integers(0, len(whole), rng.integers(1, 4)):
                content[where] ^= 1 << rng.integers(0, 8)
        damaged.write_bytes(content)
        try:
            back = read_npz(damaged)
        except ArtifactError:
            refused += 1
            continue
        for values in back.values():
            good = [
                np.array_equal(values, original.astype(kind))
                for kind in (float, np.float32)
                for original in series.values()
            ]
            assert any(good)
    assert refused > 300


def test_a_series_that_stands_still_is_written_as_any_other(tmp_path: Path) -> None:
    """With signs of zero, and what is no number."""
    n = 60
    held = np.repeat([-0.0, 0.0, 3.5], n // 3)
    series = {"t_s": DT * np.arange(n), "R_g": held, "omega": np.where(np.arange(n) < 40, np.nan, np.inf)}
    write_csv(tmp_path / "x.csv", series, DT)
    rows = [line.split(",") for line in (tmp_path / "x.csv").read_text(encoding="utf-8").splitlines()[1:]]
    assert [row[1] for row in rows] == ["-0"] * 20 + ["0"] * 20 + ["3.5"] * 20
    assert [row[2] for row in rows] == ["nan"] * 40 + ["inf"] * 20
