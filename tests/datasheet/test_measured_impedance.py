"""The impedance of a grid over frequency: R and L of known circuits, in both frames, and what they cannot say."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.errors import StudyError
from vsgdesign.study.datasheet.measured_impedance import fit_series, read_impedance

R, L, C = 0.2, 2e-3, 20e-6
F_N = 50.0
F = np.array([10.0, 20.0, 35.0, 45.0, 55.0, 80.0, 120.0, 250.0, 500.0, 900.0, 1500.0])

Circuit = Callable[[np.ndarray], np.ndarray]


def series(s: np.ndarray) -> np.ndarray:
    """R and L: an impedance for any complex frequency."""
    return R + s * L


def with_cable(s: np.ndarray) -> np.ndarray:
    """The same with a capacitance at the terminals."""
    return 1.0 / (1.0 / series(s) + s * C)


def sequences(path: Path, of: Circuit, unit: str = "", f: np.ndarray = F, separator: str = ",") -> Path:
    head = [f"f{unit}", "Z+_re", "Z+_im", "Z-_re", "Z-_im"]
    Z = of(2j * np.pi * f)
    rows = [[repr(float(x)) for x in (g, z.real, z.imag, z.real, z.imag)] for g, z in zip(f, Z, strict=True)]
    if separator == ";":
        rows = [[text.replace(".", ",") for text in row] for row in rows]
    path.write_text("\n".join(separator.join(row) for row in (head, *rows)), encoding="utf-8")
    return path


def dq(path: Path, of: Circuit, sign: float = 1.0) -> Path:
    """What a frame at F_N sees of a balanced circuit: (:eq:`two-axes`) with s ± jω_0 in place of s."""
    s, w = 2j * np.pi * F, 2.0 * np.pi * F_N
    up, down = of(s + 1j * w), of(s - 1j * w)
    along, across = 0.5 * (up + down), -0.5j * (up - down)
    head = ["f [Hz]", *(f"Z{name}_{part}" for name in ("dd", "dq", "qd", "qq") for part in ("abs", "deg"))]
    rows = [head]
    for k, g in enumerate(F):
        four = along[k], -sign * across[k], sign * across[k], along[k]
        rows.append([repr(float(g)), *(repr(float(x)) for z in four for x in (abs(z), math.degrees(np.angle(z))))])
    path.write_text("\n".join(",".join(row) for row in rows), encoding="utf-8")
    return path


@pytest.mark.parametrize("separator", [",", ";"])
def test_a_series_circuit_is_found_again(tmp_path: Path, separator: str) -> None:
    found = fit_series(read_impedance(sequences(tmp_path / "z.csv", series, " [Hz]", F, separator), F_N), F_N)
    assert (pytest.approx(R, rel=1e-12), pytest.approx(L, rel=1e-12)) == (found.R, found.L)
    assert found.error < 1e-12
    assert found.resonance_hz is None
    assert found.explained_hz == (10.0, 1500.0)
    assert len(found.sentences) == 1
    assert "R = 0.2 ohm and L = 2 mH at 50 Hz (X/R = 3.14)" in found.sentences[0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_rotating_frame_sees_the_same_circuit(tmp_path: Path, sign: float) -> None:
    """The fit of points on both sides of the nominal frequency, though no measurement in dq is at 0 Hz."""
    found = fit_series(read_impedance(dq(tmp_path / "z.csv", series, sign), F_N), F_N)
    assert (pytest.approx(R, rel=1e-9), pytest.approx(L, rel=1e-9)) == (found.R, found.L)
    assert ("lags" in " ".join(found.sentences)) == (sign < 0.0)


def test_a_resonance_is_said_where_the_circuit_has_it(tmp_path: Path) -> None:
    f = np.linspace(15.0, 2000.0, 800)
    found = fit_series(read_impedance(sequences(tmp_path / "z.csv", with_cable, "", f), F_N), F_N)
    expected = math.sqrt(1.0 / (L * C) - (R / L) ** 2) / (2.0 * np.pi)
    assert found.resonance_hz == pytest.approx(expected, rel=1e-3)
    # Z = sL/(1 - w^2 LC): 10 % of |Z| away where w^2 LC = 0.1, and R and L of the fit take a part of it.
    edge = math.sqrt(0.1 / (L * C)) / (2.0 * np.pi)
    assert 0.9 * edge < found.explained_hz[1] < 1.15 * edge
    assert f"resonance is at {found.resonance_hz:.4g} Hz" in " ".join(found.sentences)


def test_a_converter_close_by_is_said(tmp_path: Path) -> None:
    path = dq(tmp_path / "z.csv", series)
    lines = [line.split(",") for line in path.read_text().splitlines()]
    for line in lines[1:]:
        line[7] = repr(1.4 * float(line[7]))  # Zqq
    path.write_text("\n".join(",".join(line) for line in lines))
    assert "another converter close by" in " ".join(fit_series(read_impedance(path, F_N), F_N).sentences)
    text = "f,Z+_re,Z+_im,Zn_re,Zn_im\n40,0.2,0.5,0.2,0.7\n60,0.2,0.75,0.2,0.9\n"
    path.write_text(text)
    assert "Z- differs from Z+ by up to" in " ".join(read_impedance(path, F_N).notes)


GOOD = "f,Z+_re,Z+_im\n40,0.2,0.5\n60,0.2,0.75\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        (GOOD.replace("f,", "g,"), "no column of the frequency"),
        (GOOD.replace("Z+_im", "Z+_phase_of"), r"neither Z\+ nor Zdd"),
        ("f,Z+_re,Z+_im\n", "has a heading and no row"),
        (GOOD.replace("0.75", "x"), "row 3.*could not convert"),
        (GOOD.replace("0.75", "nan"), "row 3.*not finite"),
        (GOOD.replace("60,0.2,0.75", "60,0.2"), "row 3.*has 2 columns"),
        (GOOD.replace("60", "0"), "f = 0 Hz"),
        (GOOD.replace("0.2,0.75", "0,0"), "f = 60 Hz: an impedance is zero"),
        (GOOD.replace("60", "40"), "40 Hz stands there twice"),
        (GOOD.replace("60", "600").replace("40", "400"), "0 point between 20 and 125 Hz; it has 400 to 600 Hz"),
        (GOOD.replace("0.5", "-0.5").replace("0.75", "-0.75"), r"L = -1\.989 mH.*A grid has both above zero"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "z.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(StudyError, match=f"(?s){said}"):
        fit_series(read_impedance(path, F_N), F_N)


def test_a_folder_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    for path, said in ((tmp_path, "is a folder"), (tmp_path / "no.csv", "No such file")):
        with pytest.raises(StudyError, match=said):
            read_impedance(path, F_N)
