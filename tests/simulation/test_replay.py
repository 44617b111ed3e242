"""A recorded voltage as the source: files that are written here, what is read of them, and what is wrong with them."""

from __future__ import annotations

import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.parameters.documents import case_document, faults_of
from tests.simulation.studies import GAINS, lc_study
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import StudyError
from vsgdesign.simulation import GainChange, build_timeline, simulate
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.record import read_record
from vsgdesign.study.parameters.record_columns import RecordError
from vsgdesign.verbs.pipeline.survival import subjects_of

V = 110.0 * np.sqrt(2.0)
F_G = 50.13


def voltage(t_s: np.ndarray, phase: int = 0) -> np.ndarray:
    """A phase of a grid with a fifth and a seventh harmonic, V."""
    x = 2.0 * np.pi * (F_G * t_s - phase / 3.0) + 0.4
    return V * (np.cos(x) + 0.03 * np.cos(5.0 * x + 1.0) + 0.02 * np.cos(7.0 * x))


def phases(rate: float, duration: float) -> np.ndarray:
    t_s = np.arange(round(rate * duration)) / rate
    return np.array([voltage(t_s, k) for k in range(3)])


def study_with(path: Path, duration: str = "0.1 s", **fields: str) -> Study:
    lines = "".join(f"{name} = {value}\n" for name, value in {"scale": '"1 V"', **fields}.items())
    return lc_study(duration, f'[replay]\nfile = "{path}"\n{lines}')


def write_wav(path: Path, values: np.ndarray, rate: int, width: int = 2) -> None:
    """(n, channels) within ±1 as PCM."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(values.shape[1])
        file.setsampwidth(width)
        file.setframerate(rate)
        whole = np.round(values * (2.0 ** (8 * width - 1) - 1.0)).astype("<i4")
        if width == 1:
            file.writeframes((whole + 128).astype(np.uint8).tobytes())
        else:
            file.writeframes(whole[..., None].view(np.uint8)[..., :width].tobytes())


def written(folder: Path, kind: str, rate: float, duration: float = 0.5) -> tuple[Path, dict[str, str]]:
    """A file of each format with the three phases, and the fields that it needs."""
    values, path = phases(rate, duration), folder / f"grid.{kind}"
    if kind == "npz":
        np.savez(path, v=values.T, sampling_rate=rate)
        return path, {}
    if kind == "csv":
        times = np.arange(values.shape[1]) / rate
        np.savetxt(path, np.column_stack([times, *values]), delimiter=";", header="t_s;v_a;v_b;v_c", comments="")
        return path, {}
    write_wav(path, values.T / 200.0, round(rate), width=3)
    return path, {"scale": '"200 V"'}


@pytest.mark.parametrize("kind", ["csv", "npz", "wav"])
@pytest.mark.parametrize("rate", [1600.0, 12800.0, 20000.0, 48000.0])
def test_every_format_gives_the_voltage_at_every_sample(tmp_path: Path, kind: str, rate: float) -> None:
    """Against the waveform itself, wherever the sampling instants of both lie. The seventh harmonic at 1600 Hz is at
    0.44 of half the sampling rate. 24 bits of ±200 V and what a CSV rounds are far below the interpolation's error."""
    path, fields = written(tmp_path, kind, rate)
    study = study_with(path, **fields)
    replay = build_timeline(study).replay
    assert replay is not None
    t_s = replay.spec.origin + np.arange(2000) * 50e-6
    exact = sum(voltage(t_s, k) * np.exp(2j * np.pi * k / 3.0) for k in range(3)) * 2.0 / 3.0
    assert np.max(np.abs(replay.vectors(0, 2000) - exact)) < 1e-4 * V
    # The fundamental of the start, to what the harmonics leak through the window.
    source = build_timeline(study).source_at(0.0)
    assert source.omega / (2.0 * np.pi) == pytest.approx(F_G, abs=1e-4)
    assert source.V_g_rms == pytest.approx(110.0, rel=1e-4)
    began = 2.0 * np.pi * F_G * replay.spec.origin + 0.4
    assert np.angle(np.exp(1j * (replay.spec.phase - began))) == pytest.approx(0.0, abs=1e-4)


def test_one_phase_stands_for_three(tmp_path: Path) -> None:
    np.savez(tmp_path / "grid.npz", v=phases(12800.0, 0.5)[0], fs=12800.0)
    replay = build_timeline(study_with(tmp_path / "grid.npz")).replay
    assert replay is not None
    t_s = replay.spec.origin + np.arange(2000) * 50e-6
    exact = sum(voltage(t_s, k) * np.exp(2j * np.pi * k / 3.0) for k in range(3)) * 2.0 / 3.0
    assert np.max(np.abs(replay.vectors(0, 2000) - exact)) < 1e-3 * V  # a third of the fitted period


def test_columns_begin_and_scale(tmp_path: Path) -> None:
    values = phases(12800.0, 0.6)
    np.savetxt(tmp_path / "grid.csv", np.column_stack([np.zeros(values.shape[1]), *(values / 7.0)]), delimiter=",")
    chosen = {"columns": "[2, 3, 4]", "sampling_rate": '"12.8 kHz"', "begin": '"0.2 s"', "scale": '"rated"'}
    replay = build_timeline(study_with(tmp_path / "grid.csv", **chosen)).replay
    assert replay is not None
    assert replay.spec.scale == pytest.approx(7.0, rel=1e-4)
    assert replay.spec.V_g_rms == 110.0
    t_s = replay.spec.origin + np.arange(2000) * 50e-6
    exact = sum(voltage(t_s, k) * np.exp(2j * np.pi * k / 3.0) for k in range(3)) * 2.0 / 3.0
    assert np.max(np.abs(replay.vectors(0, 2000) - exact)) < 3e-4 * V
    assert replay.spec.origin > 0.2


def test_a_run_logs_the_record_and_its_phase(tmp_path: Path) -> None:
    """The phase follows a jump within the cycle around it; P rests at its reference, and the run repeats."""
    rate, duration = 20000.0, 1.0
    t_s = np.arange(round(rate * duration)) / rate
    x = 2.0 * np.pi * F_G * t_s + np.where(t_s > 0.5, 0.1, 0.0)
    np.savez(tmp_path / "g.npz", v=V * np.array([np.cos(x - 2.0 * np.pi * k / 3.0) for k in range(3)]).T, fs=rate)
    study = study_with(tmp_path / "g.npz", "0.9 s")
    run = simulate(study, [GainChange(0.0, GAINS)], bridge="averaged")
    v_g = run.column("v_g_alpha") + 1j * run.column("v_g_beta")
    replay = run.timeline.replay
    assert replay is not None
    np.testing.assert_allclose(v_g, replay.vectors(0, len(v_g)), rtol=0.0, atol=1e-9)
    off = np.angle(v_g * np.exp(-1j * run.timeline.source_phase(run.t_s)))
    jump = 0.5 - replay.spec.origin
    away = np.abs(run.t_s - jump) > 0.012
    assert np.max(np.abs(off[away])) < 1e-4
    assert np.max(np.abs(off)) > 0.04
    assert np.mean(run.column("P")[6000:9000]) == pytest.approx(run.column("P")[0], rel=0.01)
    again = simulate(study, [GainChange(0.0, GAINS)], bridge="averaged")
    assert again.log.tobytes() == run.log.tobytes()


def test_sixty_hertz(tmp_path: Path) -> None:
    t_s = np.arange(20000) / 15360.0
    values = 400.0 * np.cos(2.0 * np.pi * (59.9 * t_s[:, None] - np.arange(3) / 3.0))
    np.savez(tmp_path / "g.npz", v=values, fs=15360.0)
    study = study_from_text(f"""
base = "case:utility_1mva_60hz"
[simulation]
duration = "0.2 s"
P_ref = "100 kW"
Q_ref = 0
[[controllers]]
name = "fixed"
kind = "fixed"
[replay]
file = "{tmp_path / "g.npz"}"
scale = "rated"
""")
    source = build_timeline(study).source_at(0.0)
    assert source.omega / (2.0 * np.pi) == pytest.approx(59.9, abs=1e-4)
    assert source.V_g_rms == study.converter.V_rated_rms
    assert study.has_components
    # Designs are for the nominal source, so that a table serves with any record.
    assert study.grid_source == study.undisturbed.grid_source
    assert study.grid_source.omega_g == study.converter.omega_n


def short_document() -> dict[str, Any]:
    document = case_document()
    return document | {"events": [], "simulation": document["simulation"] | {"duration": "1 s"}}


def said(**fields: Any) -> str:
    return "\n".join(map(str, faults_of(short_document() | {"replay": fields})))


def test_what_is_wrong_with_a_file(tmp_path: Path) -> None:
    good, rate = phases(12800.0, 2.0), 12800.0
    path = tmp_path / "grid.npz"

    def about(values: np.ndarray, expected: str, rate: float | None = rate, **fields: Any) -> None:
        named = {"v": values.T} if rate is None else {"v": values.T, "fs": np.array(rate)}
        np.savez(path, allow_pickle=False, **named)
        text = said(file=str(path), **{"scale": "1 V", **fields})
        assert expected in text, text

    about(good[:, :1000], "the record is 0.078125 s long, and")
    holed = good.copy()
    holed[1, 700:720] = np.nan
    about(holed, "20 of 25600 samples are missing or no numbers (the first is sample 701)")
    about(good, "replay.scale", scale="1 mV")
    about(good, "of the rated voltage. Give V for one unit of the file", scale="1 mV")
    about(good, "replay.sampling_rate: missing", rate=None)
    about(good, "the file says 12800 Hz", sampling_rate="10 kHz")
    about(good, "its fundamental is at 25.06 Hz, and the converter's f_n is 50 Hz", rate=None, sampling_rate="6.4 kHz")
    about(good[:, ::64], "is fewer than six samples in a cycle", rate=200.0)
    about(good[:2], "the file has 2 columns, not one or three phases")
    about(good, 'there is no column "u". The file has v_1, v_2, v_3', columns=["v_1", "v_2", "u"])
    about(good, "must be a list of 1 or 3 names or numbers", columns=["v_1", "v_2"])
    about(good, "unknown field. Did you mean columns", colums=[1])


def test_files_that_are_none(tmp_path: Path) -> None:
    assert "cannot be read: No such file or directory" in said(file=str(tmp_path / "none.csv"))
    cases = {
        "a.csv": ("time,v\n0,1\n1e-3,one\n", "cannot be read as numbers in columns"),
        "b.csv": ("time,v\n0,1\n1e-3,2\n2e-3,3\n9e-3,4\n1e-2,5\n", "1 gap in its times, the first after 0.002 s"),
        "c.csv": ("time,v\n0,1\n0,2\n0,3\n", "its times do not increase"),
        "d.csv": ("# nothing\n", "cannot be read as numbers in columns: it is empty"),
        "h.csv": ("time,v\n", "cannot be read as numbers in columns: it has no rows"),
        "e.wav": ("RIFF no", "cannot be read as WAV"),
        "f.npz": ("PK no", "cannot be read as npz"),
        "g.mat": ("", '".mat" is no format of a record. Known: .csv'),
    }
    for name, (text, expected) in cases.items():
        (tmp_path / name).write_text(text)
        found = said(file=str(tmp_path / name))
        assert expected in found, (name, found)
    text = said()
    assert "replay.file: missing" in text
    assert 'replay.scale: missing. Give V for one unit of the file, or "rated".' in text


def test_all_faults_of_a_file_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time,u,v\n0,1,1\n1e-3,,1\n2e-3,1,1\n9e-3,1,1\n")
    with pytest.raises(RecordError) as error:
        read_record(str(tmp_path / "a.csv"), ("u", "w", "v"), None)
    assert [field for field, _, _ in error.value.faults] == ["columns", "file", "file"]


def test_a_survival_set_needs_a_source_that_it_can_change(tmp_path: Path) -> None:
    path, _ = written(tmp_path, "npz", 12800.0)
    with pytest.raises(StudyError, match="a recorded source cannot sag or jump"):
        subjects_of(study_with(path), Ready())


def test_nothing_else_may_say_what_the_source_does(tmp_path: Path) -> None:
    path, _ = written(tmp_path, "npz", 12800.0, 2.0)
    document = short_document() | {"replay": {"file": str(path), "scale": "1 V"}, "background": {}}
    document["grid"] = document["grid"] | {"V_g_pu": 1.0}
    document["events"] = [{"time": "0.1 s", "phase_jump": "5 deg"}, {"time": "0.2 s", "grid": {"scr": 5}}]
    text = "\n".join(map(str, faults_of(document)))
    assert text.count("there is a recorded source, [replay]") == 3
    for field in ("background", "grid.V_g_pu", "events[0].phase_jump"):
        assert field in text


@pytest.mark.parametrize("width", [1, 2, 4])
def test_widths_of_wav(tmp_path: Path, width: int) -> None:
    values = np.array([[0.5, -0.25], [-1.0 + 2.0**-7, 0.0], [0.75, -0.5]])
    write_wav(tmp_path / "w.wav", values, 8000, width)
    read = read_record(str(tmp_path / "w.wav"), ("1",), None)
    assert read.rate == 8000.0
    np.testing.assert_allclose(read.values[:, 0], values[:, 0], atol=2.0 ** (1 - 8 * width) * 1.01)
