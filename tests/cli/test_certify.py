"""The certify verb: what it prints, its exit codes, and wrong input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import vsgdesign.certificate
import vsgdesign.certificate.swing
from vsgdesign.verbs.cli.program import main

STUDY = "studies/structures/study.toml"
REGION = ("--scr", "3", "20", "--x-over-r", "1", "20")
PROOFS = (
    (vsgdesign.certificate, "certify"),
    (vsgdesign.certificate, "with_steps"),
    (vsgdesign.certificate.swing, "large_signal"),
)


def certify(*options: str) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["certify", STUDY, "--boxes", "500", *options])
    return result.exit_code, result.output


@pytest.fixture(scope="module")
def proved() -> tuple[int, str, dict[str, Any]]:
    """Exit code and document of :data:`REGION`, and what was found for it, by the function that found it."""
    found: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        for module, name in PROOFS:
            real = getattr(module, name)
            patch.setattr(
                module,
                name,
                lambda *given, _real=real, _name=name, **more: found.setdefault(_name, _real(*given, **more)),
            )
        code, text = certify(*REGION, "--json")
    assert set(found) == {name for _, name in PROOFS}
    return code, text, found


def test_a_region_that_can_be_certified(
    proved: tuple[int, str, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In words. The proofs are those of the document."""
    for module, name in PROOFS:
        monkeypatch.setattr(module, name, lambda *_, _name=name, **__: proved[2][_name])
    code, text = certify(*REGION)
    assert code == 0
    assert text.startswith("angle_damped: Certified on a grid only, not gap-free (")
    assert "Over SCR 3 to 20, X/R 1 to 20, P −4.5 to 4.5 kW" in text
    # The published converter has no limit of its current.
    assert "The converter has no current limit, so no limit acts after any step." in text
    assert "it is certified that V stays between 0.7 and 1.3 pu after a step" in text
    head = next(line for line in text.splitlines() if "P_ref [kW]" in line)
    assert head.split("  ")[-1].strip() == "proof"
    assert text.count("\n     3 to ") == 3  # three loadings of the weakest grids


def test_a_counterexample_is_exit_code_1_and_names_the_cell() -> None:
    code, text = certify("--controller", "published", "--x-over-r", "0.3", "20", "--error", "0")
    assert code == 1
    # The base has a specification, and its grids are those that are judged where no others are named.
    assert text.startswith("published: Not certified over SCR 1.8 to 25, X/R 0.3 to 20")
    assert "the power loops are unstable at SCR" in text


def test_json(proved: tuple[int, str, dict[str, Any]]) -> None:
    code, text, _ = proved
    document = json.loads(text)
    assert code == 0
    assert document["certified"] is True
    assert document["decay"] > 1.0
    assert np.shape(document["P"]) == (1, 3, 3)
    assert document["proof"] in ("gap-free", "gridded")
    assert document["region"]["error"] == 0.2
    rows = document["steps"]["rows"]
    assert len(rows) == 9
    assert all(row["phase"] > 0.0 for row in rows)
    code, text = certify("--controller", "published", "--x-over-r", "0.3", "20", "--json")
    assert code == 1
    assert json.loads(text)["eigenvalue"]["real"] > 0.0


def test_wrong_options_are_all_named_at_once() -> None:
    code, text = certify("--controller", "x", "--error", "nan", "--scr", "5", "2", "--rate", "-1")
    assert code == 2
    for part in ("no such scheduled controller", "error = nan", "scr = 5 2", "rate = -1"):
        assert part in text
    assert all(line.endswith(".") for line in text.splitlines() if line.startswith("  - "))


LABORATORY = ("studies/laboratory/study.toml", "--model", "full", "--scr", "6", "12", "--x-over-r", "3", "3.2")
POWERS = ("--p-pu", "0.32", "0.64", "--q-pu", "0", "0.16", "--workers", "1")


def test_the_sampled_full_order_loop_is_proved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of the region, with half of the least decay that was found; nothing but the proof is left in the folder, and
    a second look confirms it."""
    study = Path(LABORATORY[0]).resolve()
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["certify", str(study), *LABORATORY[1:], *POWERS, "--proof", "a.proof", "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    assert found["model"] == "full"
    assert found["certified"] is True
    assert found["left"] == []
    assert found["proved"] == 1.0
    assert found["decay"] == pytest.approx(0.5 * found["slowest"]["decay"])
    assert found["states"] == 15
    assert found["boxes"] > 0
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["a.proof"]
    checked = CliRunner().invoke(main, ["table", "check", "--study", str(study), "--proof", "a.proof"])
    assert checked.exit_code == 0, checked.output
    assert "a.proof: confirmed" in checked.output


def test_a_proof_that_is_not_there_is_carried_and_one_without_its_study_refused(tmp_path: Path) -> None:
    asked = ["table", "check", "--proof", str(tmp_path / "a.proof")]
    result = CliRunner().invoke(main, [*asked, "--study", LABORATORY[0]])
    assert result.exit_code == 0
    assert result.output == f"{asked[-1]}: carried, not checked: full-order proof (its file is missing)\n"
    moved = CliRunner().invoke(main, ["certify", LABORATORY[0], "--model", "full", "--moving", "nan"])
    assert (moved.exit_code, "nan is not in the range" in moved.output) == (2, True)
    assert "--proof needs --study" in CliRunner().invoke(main, asked).output
    assert "give a TABLE.json, or the --proof" in CliRunner().invoke(main, ["table", "check"]).output


def test_more_than_the_loop_decays_is_refused() -> None:
    result = CliRunner().invoke(main, ["certify", *LABORATORY, *POWERS, "--decay", "50"])
    assert result.exit_code == 1
    assert "decay = 50 1/s does not hold in the sampled full-order model" in result.output


def test_the_full_order_proof_says_what_it_does_not_know() -> None:
    result = CliRunner().invoke(main, ["certify", *LABORATORY, *POWERS, "--rate", "1"])
    assert result.exit_code == 2
    assert "rate = 1: the proof of the full-order model is one of grids that rest" in result.output
