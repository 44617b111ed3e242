"""What is looked at in a recorded voltage: the waves are written here, and each fault is known."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from tests.simulation.test_replay import V, phases, said, study_with, write_wav
from vsgdesign.study.parameters.record import read_record
from vsgdesign.study.parameters.record_columns import RecordError
from vsgdesign.study.parameters.replay import PER_CYCLE, look_at

RATE = 12800.0


def spoilt(kind: str) -> np.ndarray:
    """Three phases of a sound voltage, of which one thing is wrong."""
    values = phases(RATE, 2.0)
    if kind == "equal":
        return np.stack([values[0]] * 3)
    if kind == "order":
        return values[[0, 2, 1]]
    if kind == "missing":
        values[2] = 0.0
    if kind == "inverted":
        values[1] = -values[1]
    if kind == "unbalanced":
        values[0] *= 0.7
    if kind == "offset":
        values[1] += 0.12 * V
    if kind == "clipped":
        values = np.clip(values, -0.9 * V, 0.9 * V)
    if kind == "nothing":
        values[:] = 3.0
    return values


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("equal", "its three phases are the same. Choose three different columns"),
        ("order", "its phases are in the order a, c, b. Exchange the second and the third"),
        ("missing", "phase 3 of its columns has no fundamental"),
        ("inverted", "phase 2 of its columns has the wrong sign"),
        ("unbalanced", "its negative sequence is 11.1 % of the positive one, and the limit is 10 %"),
        ("offset", "its mean is 12 % of the fundamental, and the limit is 10 %"),
        ("clipped", "it is clipped: "),
        ("nothing", "there is no voltage"),
    ],
)
@pytest.mark.parametrize("scale", ["1 V", "rated"])
def test_what_is_wrong_with_the_voltage_is_said(tmp_path: Path, kind: str, says: str, scale: str) -> None:
    """Three equal columns ended in a ZeroDivisionError, and all others were played without a word."""
    np.savez(tmp_path / "g.npz", v=spoilt(kind).T, fs=RATE)
    text = said(file=str(tmp_path / "g.npz"), scale=scale)
    assert "replay.file" in text
    assert says in text


def test_several_faults_are_said_at_once(tmp_path: Path) -> None:
    values = np.clip(spoilt("order") + 0.2 * V, -0.9 * V, 0.9 * V)
    np.savez(tmp_path / "g.npz", v=values.T, fs=RATE)
    text = said(file=str(tmp_path / "g.npz"), scale="1 V")
    assert ("order a, c, b" in text, "its mean is" in text, "it is clipped" in text) == (True, True, True)


def test_sixty_hertz_in_a_study_of_fifty(tmp_path: Path) -> None:
    t_s = np.arange(round(2.0 * RATE)) / RATE
    np.savez(tmp_path / "g.npz", v=V * np.cos(2.0 * np.pi * (60.0 * t_s[:, None] - np.arange(3) / 3.0)), fs=RATE)
    text = said(file=str(tmp_path / "g.npz"), scale="1 V")
    assert "its fundamental is at 60" in text
    assert "and the converter's f_n is 50 Hz" in text


@pytest.mark.parametrize(("negative", "offset"), [(0.0, 0.0), (0.03, 0.02), (0.09, -0.08)])
@pytest.mark.parametrize("hz", [48.0, 50.0, 50.13, 52.4])
def test_the_figures_are_those_of_the_wave(negative: float, offset: float, hz: float) -> None:
    """Against the numbers that the wave is made of, with a fifth harmonic in it."""
    t_s = np.arange(10 * PER_CYCLE) / (50.0 * PER_CYCLE)
    turn = 2.0 * np.pi * hz * t_s[:, None] + 0.7
    third = 2.0 * np.pi * np.arange(3) / 3.0
    wave = np.cos(turn - third) + negative * np.cos(turn + third + 0.4) + 0.05 * np.cos(5.0 * turn) + offset
    seen, wrong = look_at(wave, wave, 50.0)
    assert not wrong
    assert seen.hz == pytest.approx(hz, abs=0.02)
    assert seen.negative == pytest.approx(negative, abs=2e-3)
    assert seen.offset == pytest.approx(abs(offset), rel=negative + 0.02, abs=2e-3)
    assert seen.clipped == 0.0


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
@pytest.mark.parametrize("full_scale", [0.5, 1.0])
def test_few_bits_are_no_clipping(bits: int, full_scale: float) -> None:
    """A full sine of 8 bits has 2.8 % of its samples at its extreme, because its steps are coarse."""
    t_s = np.arange(30_000) / 16_000.0
    size = 2.0 ** (bits - 1) - 1.0
    wave = np.round(size * full_scale * np.cos(2.0 * np.pi * 50.03 * t_s))[:, None]
    every, count = 16_000 // (50 * PER_CYCLE), 10 * PER_CYCLE
    assert look_at(wave[::every][:count], wave, 50.0)[0].clipped == 0.0
    clipped = np.clip(wave, -0.9 * size * full_scale, 0.9 * size * full_scale)
    share = np.arccos(0.9) / np.pi
    assert look_at(clipped[::every][:count], clipped, 50.0)[0].clipped == pytest.approx(share, rel=0.05)


@pytest.mark.parametrize(("bits", "extensible"), [(32, False), (64, False), (32, True)])
def test_a_wav_of_floats(tmp_path: Path, bits: int, extensible: bool) -> None:
    values = np.array([[0.5, -0.25], [-1.5, 1e-30], [0.75, -0.5]])
    write_float_wav(tmp_path / "f.wav", values, 8000, bits, extensible)
    read = read_record(str(tmp_path / "f.wav"), ("1",), None)
    assert read.rate == 8000.0
    np.testing.assert_allclose(read.values[:, 0], values[:, 0], rtol=1e-7)


def write_float_wav(path: Path, values: np.ndarray, rate: int, bits: int, extensible: bool) -> None:
    """The file after the published layout of RIFF, written without any library."""
    data = values.astype(f"<f{bits // 8}").tobytes()
    align = values.shape[1] * bits // 8
    form = struct.pack("<HHIIHH", 0xFFFE if extensible else 3, values.shape[1], rate, rate * align, align, bits)
    if extensible:
        form += struct.pack("<HHIH", 22, bits, 0, 3) + bytes.fromhex("000000001000800000aa00389b71")
    chunks = b"".join(
        name + struct.pack("<I", len(one)) + one + b"\0" * (len(one) % 2)
        for name, one in ((b"fmt ", form), (b"LIST", b"odd"), (b"data", data))
    )
    path.write_bytes(b"RIFF" + struct.pack("<I", 4 + len(chunks)) + b"WAVE" + chunks)


@pytest.mark.parametrize(
    ("length", "says"),
    [
        (0, "its header is cut after 0 bytes"),
        (7, "its header is cut after 7 bytes"),
        (12, "its header is cut: it ends before the format"),
        (30, "its header is cut: 10 of the 16 bytes of a part are there"),
        (40, "its header is cut: it ends before the samples"),
    ],
)
def test_a_wav_with_a_cut_header_says_so(tmp_path: Path, length: int, says: str) -> None:
    """It was refused without a reason."""
    write_wav(tmp_path / "w.wav", np.zeros((100, 1)), 8000)
    (tmp_path / "w.wav").write_bytes((tmp_path / "w.wav").read_bytes()[:length])
    with pytest.raises(RecordError, match=f"cannot be read as WAV: {says}"):
        read_record(str(tmp_path / "w.wav"), None, None)


def test_a_wav_of_another_kind_says_which(tmp_path: Path) -> None:
    write_wav(tmp_path / "w.wav", np.zeros((100, 1)), 8000)
    raw = bytearray((tmp_path / "w.wav").read_bytes())
    raw[20] = 2
    (tmp_path / "w.wav").write_bytes(raw)
    with pytest.raises(RecordError, match="1 channels, 8000 Hz, samples of kind 2 with 16 bits") as caught:
        read_record(str(tmp_path / "w.wav"), None, None)
    assert "floats of 32 or 64" in caught.value.faults[0][2]


@pytest.mark.parametrize("damage", ["npy", "flipped", "members"])
def test_an_archive_that_is_damaged(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "g.npz"
    np.savez_compressed(path, v=np.arange(4000.0) % 17.0)
    if damage == "npy":
        with path.open("wb") as stream:
            np.save(stream, np.zeros(3))
    elif damage == "flipped":
        raw = bytearray(path.read_bytes())
        raw[60:90] = bytes(255 - one for one in raw[60:90])
        path.write_bytes(raw)
    else:
        path.write_bytes(b"PK\x05\x06" + bytes(18))
    with pytest.raises(RecordError):
        read_record(str(path), None, 1000.0)


def test_the_page_tells_what_was_seen(tmp_path: Path) -> None:
    np.savez(tmp_path / "g.npz", v=phases(RATE, 0.5).T, fs=RATE)
    replay = study_with(tmp_path / "g.npz").replay
    assert replay is not None
    told = replay.document()
    assert told["negative_sequence"] == pytest.approx(0.0, abs=1e-3)
    assert told["offset"] == pytest.approx(0.0, abs=1e-3)
    assert told["clipped"] == 0.0
