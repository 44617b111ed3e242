"""Every way to be wrong: its exit code, what it says, and that it leaves nothing behind."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.small_studies import SMALL, call, failure, study_file

VERBS = ("run", "simulate", "design", "validate")


@pytest.mark.parametrize("verb", VERBS)
def test_no_such_file(verb: str, tmp_path: Path) -> None:
    message = failure(2, verb, tmp_path / "missing.toml")
    assert "missing.toml" in message
    assert "there is no such file. Give the path of a .toml study file." in message


@pytest.mark.parametrize("verb", VERBS)
def test_a_folder(verb: str, tmp_path: Path) -> None:
    assert "is a folder, not a study file" in failure(2, verb, tmp_path)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"duration = ", "cannot be read as TOML"),
        (b'{ "json": true }', "this is JSON. Write it as TOML"),
        (b"a = 1\na = 2\n", "cannot be read as TOML"),
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        (b"", "missing table"),
        (b'base = "case:nobody2025"\n', 'no such case. Known: "case:'),
        (b'base = "small.toml"\n', "bases, each based on the next (a circle?)"),
        (b'base = "elsewhere.toml"\n', "there is no such file"),
    ],
)
def test_not_a_study(content: bytes, problem: str, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_bytes(content)
    assert problem in failure(2, "simulate", tmp_path / "small.toml", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("duration", '"300 ohm"', 'simulation.duration = "300 ohm": expected a number in s'),
        ("duration", '"-1 s"', "simulation.duration"),
        ("duration", "nan", "simulation.duration = nan: must be a finite number"),
        ("duration", "inf", "must be a finite number"),
        ("duration", "true", "expected a number in s"),
        ("P_ref", '"2 MW"', 'P_ref = "2 MW": outside -10 kW to 10 kW (read as 2 MW). Check the unit'),
        ("P_ref", '"2 kvar"', 'P_ref = "2 kvar": expected a number in W'),
        ("time", '"7 s"', "Events must lie within simulation.duration."),
        ("kind", '"adaptive"', 'kind = "adaptive": must be one of "fixed", "scheduled"'),
        ("name", '"../../escape"', "name"),
    ],
)
def test_a_wrong_value_is_named_with_its_limit(field: str, value: str, said: str, tmp_path: Path) -> None:
    message = failure(2, "validate", study_file(tmp_path, **{field: value}))
    assert said in message
    assert str(tmp_path / "small.toml") in message


def test_a_missing_key(tmp_path: Path) -> None:
    text = SMALL.replace('P_ref = "2 kW"\n', "", 1)
    message = failure(2, "simulate", study_file(tmp_path, text), "--out", tmp_path / "out")
    assert "simulation.P_ref: missing. Give a quantity in W" in message


def test_an_unknown_key_gets_the_nearest_known_one(tmp_path: Path) -> None:
    message = failure(2, "validate", study_file(tmp_path, SMALL.replace("duration =", "durration =")))
    assert "simulation.durration: unknown field. Did you mean duration?" in message


def test_all_faults_at_once(tmp_path: Path) -> None:
    text = SMALL.replace('kind = "scheduled"', 'kind = "scheduled"\ncolour = "red"')
    study = study_file(tmp_path, text, duration="nan", P_ref='"2 A"', name='"fixed"')
    message = failure(2, "simulate", study, "--out", tmp_path / "out")
    for said in ("simulation.duration", "simulation.P_ref", "events[0].P_ref", "colour", "used twice"):
        assert said in message
    count = re.search(r": (\d+) faults\n", message)
    assert count is not None
    assert int(count.group(1)) == message.count("\n  - ")

    result = call("validate", study, "--json")
    assert result.exit_code == 2
    document = json.loads(result.stdout)
    assert document["valid"] is False
    assert len(document["faults"]) == int(count.group(1))
    for fault in document["faults"]:
        assert set(fault) == {"field", "value", "problem", "advice"}
        assert fault["field"]
        assert fault["problem"]


def test_a_grid_that_cannot_carry_the_power(tmp_path: Path) -> None:
    """Exit code 1, when, by how much, and what to change."""
    text = SMALL.replace("grid = { scr = 8 }", "grid = { scr = 0.3, x_over_r = 3 }")
    out = tmp_path / "out"
    message = failure(1, "simulate", study_file(tmp_path, text), "--out", out)
    assert "from 0.2 s on: no operating point: P = 2.5 kW, Q = 1 kvar cannot cross |Z| = " in message
    less = re.search(r"At this Q .* P .*?([\d.]+) kW, ([\d.]+) kW", message)
    assert less is not None
    assert float(less.group(1)) + float(less.group(2)) == pytest.approx(2.5, abs=2e-3)  # four digits each
    scale = re.search(
        r"scale P and Q to ([\d.]+) % .* reduce \|Z\| to [\d.]+ Ω \(raise the SCR ([\d.]+) times\)", message
    )
    assert scale is not None
    assert float(scale.group(1)) / 100.0 * float(scale.group(2)) == pytest.approx(1.0, rel=1e-2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.toml"]

    # And that advice is right: a little less of both runs, a little more does not.
    share = float(scale.group(1)) / 100.0
    for factor, code in ((0.99, 0), (1.01, 1)):
        P, Q = (f'"{factor * share * power} k{unit}"' for power, unit in ((2.5, "W"), (1.0, "var")))
        # Given gains without a droop of Q: a closed-form design has a design point of its own.
        given = 'kind = "fixed"\ngains = { K_ip = 0.002, D_p = 4000, K_iq = 0.05, D_q = 0 }'
        kept = text.replace('kind = "fixed"', given).replace(
            '[[controllers]]\nname = "scheduled"\nkind = "scheduled"', ""
        )
        study = study_file(tmp_path, kept, P_ref=P, Q_ref=Q)
        result = call("simulate", study, "--out", out)
        assert result.exit_code == code, result.output


@pytest.mark.parametrize("verb", ["simulate", "design"])
def test_a_grid_that_cannot_carry_the_design_point(verb: str, tmp_path: Path) -> None:
    text = SMALL.replace("grid = { scr = 8 }", "grid = { scr = 0.3, x_over_r = 3 }")
    study = study_file(tmp_path, text, P_ref='"0.1 kW"', Q_ref='"0 var"')
    where = ["--out", tmp_path / "out"] if verb == "simulate" else []
    message = failure(1, verb, study, *where)
    assert re.search(r"controller \w+.*no .*\d %", message)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.toml"]


def test_out_on_a_foreign_folder(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    message = failure(2, "simulate", study_file(tmp_path), "--out", tmp_path / "thesis")
    assert (
        "holds chapter.tex, and no results.json that says which verb wrote it, and is left untouched. Give" in message
    )
    assert [path.name for path in (tmp_path / "thesis").iterdir()] == ["chapter.tex"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.toml", "thesis"]


def test_out_on_a_file(tmp_path: Path) -> None:
    study = study_file(tmp_path)
    before = study.read_bytes()
    assert "is a file; give a folder for the results." in failure(2, "simulate", study, "--out", study)
    assert study.read_bytes() == before


def test_out_below_a_file(tmp_path: Path) -> None:
    study = study_file(tmp_path)
    assert "is not a folder" in failure(2, "simulate", study, "--out", study / "out")


def test_a_simulation_that_diverges_keeps_what_it_has_and_says_so(tmp_path: Path) -> None:
    """Inner loops as fast as the sampling: the numbers run away, which is the study's doing, not a crash."""
    fast = '[inner_loops]\ncurrent_response_time = "20 us"\nvoltage_response_time = "20 us"\n'
    study = study_file(tmp_path, SMALL.replace("[simulation]", fast + "[simulation]", 1))
    result = call("simulate", study, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "Traceback" not in result.stderr
    assert "fixed: the simulation diverged at " in result.stderr
    assert "slow them down" in result.stderr
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    for controller in results["controllers"].values():
        assert controller["outcome"]["status"] == "diverged"
        assert 0.0 < controller["outcome"]["t_s"] < 0.1
        assert "slow them down" in controller["outcome"]["reason"]
        assert {event["status"] for event in controller["events"]} == {"diverged"}
        assert {event["peak_current_pu"] for event in controller["events"]} == {None}
