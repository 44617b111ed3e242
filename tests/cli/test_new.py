"""The verb `new`: from a file and on a terminal; nothing of the user's is overwritten, nothing is left behind."""

from __future__ import annotations

import fcntl
import json
import math
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
import tomllib
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.datasheet.sheets import write_all
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.study.parameters import case_names, load_study, study_from_text
from vsgdesign.study.parameters.inner_loops import InnerLoopSource
from vsgdesign.verbs.cli.program import main

NO_GAINS: InnerLoopSource = lambda _: (InnerLoopGains(*[math.nan] * 4), math.nan)  # noqa: E731


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["new", *arguments], prog_name="vsgdesign")
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_five_datasheets_become_valid_studies(tmp_path: Path) -> None:
    for name, path in write_all(tmp_path).items():
        out = tmp_path / f"{name}_study.toml"
        code, output = run("--from", str(path), "--out", str(out))
        assert code == 0, output
        assert f"next: vsgdesign run {out}" in output
        checked = CliRunner().invoke(main, ["validate", str(out)])
        assert checked.exit_code == 0, checked.output
        assert not list(tmp_path.glob(".*")), "nothing but the study is left"


def test_what_was_assumed_is_listed(tmp_path: Path) -> None:
    sheet = write_all(tmp_path)["medium_voltage"]
    _, output = run("--from", str(sheet), "--out", str(tmp_path / "a.toml"))
    assert "assumed, because the datasheet does not give it:\n" in output
    assert "  R_c: 0 ohm: nothing in series with C damps the filter\n" in output
    _, output = run("--from", str(sheet), "--out", str(tmp_path / "b.toml"), "--json")
    document = json.loads(output)
    assert {item["field"] for item in document["assumed"]} >= {"voltage", "R_c", "transformer"}
    assert document["study"] == str(tmp_path / "b.toml")


def test_a_measured_impedance_is_the_grid(tmp_path: Path) -> None:
    sheet, measured, out = tmp_path / "sheet.csv", tmp_path / "z.csv", tmp_path / "study.toml"
    rows = "rating,75,kVA\nvoltage,480 V L-L,\nfrequency,60,Hz\ndc_link,800,V\ncarrier,10,kHz\nL_1,0.4,mH\nC,20,uF\n"
    sheet.write_text(rows)
    measured.write_text("f,Z+_re,Z+_im\n50,0.1,0.25\n80,0.1,0.4\n500,0.1,9.0\n")
    asked = "--from", str(sheet), "--impedance", str(measured), "--out", str(out)
    code, output = run(*asked)
    assert code == 0, output
    assert "R = 0.1 ohm and L = 0.7958 mH at 60 Hz" in output
    assert "and not above: it was measured up to 500 Hz" in output
    # 480 V squared over 75 kVA and 0.1 + j0.3 ohm: the middle of the grids, which are a quarter to either side.
    grid = tomllib.loads(out.read_text(encoding="utf-8"))["grid"]
    assert grid["scr"] == pytest.approx(3.072 / math.hypot(0.1, 0.3), rel=0.01)
    assert grid["x_over_r"] == pytest.approx(3.0)
    out.unlink()
    sheet.write_text(rows + "scr,2 to 10,\n")
    code, output = run(*asked)
    assert (code, out.exists()) == (2, False)
    assert "grid_impedance" in output
    assert "Keep one of them" in output
    code, output = run("--from", str(sheet), "--impedance", str(tmp_path / "none.csv"), "--out", str(out))
    assert (code, out.exists()) == (2, False)
    assert "No such file" in output


def test_the_next_command_can_be_copied_into_a_shell(tmp_path: Path) -> None:
    folder = tmp_path / "my folder"
    folder.mkdir()
    sheet = next(iter(write_all(tmp_path).values()))
    code, output = run("--from", str(sheet), "--out", str(folder / "study.toml"))
    assert code == 0
    assert output.rstrip().endswith(f"next: vsgdesign run '{folder}/study.toml'")


def test_a_file_is_never_overwritten(tmp_path: Path) -> None:
    sheet = write_all(tmp_path)["small"]
    study = tmp_path / "study.toml"
    study.write_text("mine")
    (tmp_path / "link.toml").symlink_to(tmp_path / "nowhere.toml")
    for out, said in (
        ("study.toml", "already exists"),
        ("link.toml", "already exists"),
        (".", "is a folder"),
        ("absent/study.toml", "there is no folder"),
        ("a" * 300, "File name too long"),
        ("study.toml/study.toml", "there is no folder"),
        ("/proc/study.toml", "cannot write"),
    ):
        code, output = run("--from", str(sheet), "--out", str(tmp_path / out))
        assert code == 2
        assert said in output
        assert len(output.strip().splitlines()) == 1
    assert study.read_text() == "mine"


def test_a_faulty_datasheet_writes_nothing(tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("rating,250 mVA\nvoltage,480 kV\nL1,1 H\nspeed,3\n", encoding="utf-8")
    code, output = run("--from", str(sheet), "--out", str(tmp_path / "study.toml"))
    assert code == 2
    assert "Did you mean 250 VA?" in output
    assert "Did you mean 480 V?" in output
    assert "speed, line 4: unknown field" in output
    assert os.listdir(tmp_path) == ["sheet.csv"]


def test_what_the_study_reader_finds_is_told_before_anything_is_written(tmp_path: Path) -> None:
    """A filter that rings above half the sampling frequency on the strongest grid alone."""
    sheet = tmp_path / "sheet.toml"
    sheet.write_text(
        'rating = "100 kVA"\nvoltage = "400 V L-L"\nfrequency = 50\ndc_link = 750\ncarrier = "3 kHz"\nsampling = 1\n'
        'L_1 = "0.4 mH"\nC = "40 uF star"\nscr = "1.5 to 60"\nx_over_r = "0.3 to 20"\n'
    )
    code, output = run("--from", str(sheet), "--out", str(tmp_path / "study.toml"))
    assert code == 2
    assert "above half the sampling frequency" in output
    assert os.listdir(tmp_path) == ["sheet.toml"]


@pytest.mark.parametrize("given", [(), ("mine.csv",)])
def test_what_to_type_where_no_file_is_given(given: tuple[str, ...], tmp_path: Path) -> None:
    """Without a terminal, and with a file that belongs to no option: every way to a study, and every converter."""
    code, output = run(*given, "--out", str(tmp_path / "study.toml"))
    assert code == 2
    assert f"  vsgdesign new --from {given[0] if given else 'FILE.csv'}\n" in output
    assert "  vsgdesign new --from case:NAME\n" in output
    assert all(name in output for name in case_names())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", case_names())
def test_a_converter_of_the_package_becomes_a_study(name: str, tmp_path: Path) -> None:
    """It is that of the case, whose file the study's reader takes by itself."""
    out = tmp_path / "study.toml"
    code, output = run("--from", f"case:{name}", "--out", str(out))
    assert code == 0, output
    controllers = "[[controllers]]\nname = 'a'\nkind = 'fixed'\n[simulation]\nduration = 1\nP_ref = 0\nQ_ref = 0\n"
    case = study_from_text(f'base = "case:{name}"\n{controllers}', inner_loops=NO_GAINS)
    found = load_study(out, inner_loops=NO_GAINS)
    for part in ("converter", "filter"):
        ours, theirs = (asdict(getattr(one, part)) for one in (found, case))
        for field in ours.keys() - {"current_limiter", "V_max_pu"}:  # no datasheet says these
            # One case has no current limit; a datasheet without one gets the limit that is assumed.
            wanted = 1.2 if theirs[field] is None else theirs[field]
            assert ours[field] == pytest.approx(wanted, rel=1e-3), field


def test_a_case_that_is_not_there(tmp_path: Path) -> None:
    code, output = run("--from", "case:lab_12kva", "--out", str(tmp_path / "study.toml"))
    assert (code, "Did you mean case:lab_12kva_lcl?" in output) == (2, True)
    assert not list(tmp_path.iterdir())


def _own_terminal() -> None:
    """Standard input becomes the terminal of the new session, and its Ctrl-C is heard whoever runs the tests."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Terminal:
    """The command on a pseudo-terminal."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.master, slave = pty.openpty()
        command = [sys.executable, "-m", "vsgdesign.verbs.cli.program", "new", *arguments]
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=_own_terminal,
        )
        os.close(slave)
        self.seen = ""

    def expect(self, text: str) -> None:
        """Read until a text comes, from behind the last one that came."""
        assert self.comes(text, 90.0), f"{text!r} did not come; seen:\n{self.seen}"

    def comes(self, text: str, seconds: float) -> bool:
        """Whether a text comes in this time. What comes before it is read, and it too."""
        until = time.monotonic() + seconds
        while text not in self.seen:
            if time.monotonic() > until:
                return False
            if select.select([self.master], [], [], 0.2)[0]:
                try:
                    self.seen += os.read(self.master, 4096).decode()
                except OSError:  # the other side is closed
                    assert text in self.seen, self.seen
        self.seen = self.seen.partition(text)[2]
        return True

    def press(self, key: bytes, text: str) -> None:
        """Press a key until a text comes: Python loses a signal that comes between its last check and the read, and a
        busy machine may be there for long."""
        for _ in range(6):
            time.sleep(0.3)  # until it reads, as a rule
            os.write(self.master, key)
            if self.comes(text, 5.0):
                return
        self.expect(text)

    def answer(self, text: str) -> None:
        os.write(self.master, f"{text}\n".encode())

    def close(self) -> int:
        code = self.process.wait(timeout=90)
        os.close(self.master)
        return code


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = Path(__file__).resolve().parents[2]
    monkeypatch.setenv("PYTHONPATH", str(root))
    return tmp_path


def test_a_study_from_answers(here: Path) -> None:
    terminal = Terminal(here, "--out", "mine.toml")
    for question, text in (
        ("Rated power", "banana"), ("is not a number", ""), ("Rated power", ""), ("It must be given", ""),
        ("Rated power", "80 kW"), ("Power factor", "0,8"), ("Rated voltage", "480 kV"),
        ("Did you mean 480 V?", ""), ("Rated voltage", "480 V L-L"), ("frequency", "60"), ("PWM", "SPWM"),
        ("Dc-link", "700 V"), ("makes at most", ""), ("Dc-link", "back"), ("PWM", "SVM"), ("Dc-link", "850"),
        ("Carrier", "10 kHz"), ("Samples per carrier", ""), ("delay", ""), ("Current limit", "150 A"),
        ("rms or peak", ""), ("Current limit", "150 A rms"), ("L_1", "0,5 mH"), ("resistance", ""),
        ("capacitor C", "20 uF"), ("star or delta", "delta"), ("series with each", ""), ("L_2", "0.2 mH"),
        ("transformer", ""), ("resistance", ""), ("Short-circuit ratios", "200 kVA to 2 MVA"), ("X/R", ""),
        ("dc source", ""), ("called", "Bench"), ("from", ""),
    ):  # fmt: skip
        terminal.expect(question)
        if text or question not in (
            "is not a number",
            "It must be given",
            "Did you mean 480 V?",
            "makes at most",
            "rms or peak",
        ):
            terminal.answer(text)
    terminal.expect("next: vsgdesign run mine.toml")
    assert terminal.close() == 0
    text = (here / "mine.toml").read_text(encoding="utf-8")
    for line in (
        'S_rated = "100 kVA"',
        'C = "60 uF"',
        'V_dc = "850 V"',
        'L_1 = "500 uH"',
        'title = "Bench"',
        "scr = [2, ",
    ):
        assert line in text
    assert os.listdir(here) == ["mine.toml"]


@pytest.mark.parametrize("key", [b"\x03", b"\x04"], ids=["Ctrl-C", "Ctrl-D"])
def test_ctrl_c_at_a_prompt_leaves_nothing(here: Path, key: bytes) -> None:
    terminal = Terminal(here)
    terminal.expect("Rated power")
    terminal.answer("5 kVA")
    terminal.expect("Rated voltage")
    terminal.press(key, "interrupted: nothing was written")
    assert terminal.close() == 130
    assert os.listdir(here) == []


def test_a_termination_leaves_nothing(here: Path) -> None:
    terminal = Terminal(here)
    terminal.expect("Rated power")
    for _ in range(6):  # as keys are pressed
        time.sleep(0.3)
        terminal.process.send_signal(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            terminal.process.wait(timeout=5.0)
            break
    assert terminal.close() != 0
    assert os.listdir(here) == []
