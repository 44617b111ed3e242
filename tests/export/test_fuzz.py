"""The exported C under sanitizers with any input at all. A million calls: ``python -m bench --only runtime``."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tests.compilers import require_compiler
from tests.export.exchange import written
from tests.export.fuzzing import build_control_fuzz, build_fuzz, distance_from_table, run_control_fuzz, run_fuzz
from tests.gain_tables import table
from vsgdesign.artifacts import read_table_file
from vsgdesign.equations.limiters import LIMITERS
from vsgdesign.errors import ArtifactError
from vsgdesign.export import export_c_files
from vsgdesign.export.compiled import run_compiler
from vsgdesign.runtime import load_scheduler


@pytest.fixture(autouse=True, scope="module")
def _sanitizers(tmp_path_factory: pytest.TempPathFactory) -> None:
    require_compiler()
    program = str(tmp_path_factory.mktemp("sanitizers") / "a")
    try:
        run_compiler(["gcc", "-fsanitize=address,undefined", "-x", "c", "-", "-o", program], "int main(void){}")
    except ArtifactError:
        pytest.skip("gcc has no sanitizers here")


@pytest.mark.parametrize(("double", "tolerance"), [(True, 1e-12), (False, 2e-6)])
def test_no_input_leads_out_of_the_box(double: bool, tolerance: float, folder: Path, tmp_path: Path) -> None:
    """Place and powers are in the box, and the gains are the table's there, by the schedule on arrays."""
    code, said, answers = run_fuzz(build_fuzz(folder, tmp_path, double=double), 20_000, seed=7)
    assert code == 0, said
    calls, fresh, moved = map(int, re.findall(r"\d+", said))
    assert calls == len(answers) == 20_000
    assert fresh > 2000
    assert moved > 2000
    designed = read_table_file(written(tmp_path)[0])
    assert distance_from_table(designed, answers) <= tolerance
    assert distance_from_table(table(), answers) > 0.01  # another table's gains are seen


@pytest.mark.parametrize(
    ("line", "instead", "seen"),
    [
        (
            "vsg_clip(goal, present / factor, present * factor)",
            "goal + 0 * present * factor",
            "a step above the rate",
        ),
        ("vsg_clip(scr, limits->scr_low, limits->scr_high)", "scr", "outside the certified box"),
        ("vsg_clip(P, limits->P_low, limits->P_high)", "P", "outside the certified box"),
        (" | VSG_FRESH", "", "a status that cannot be"),
    ],
)
def test_what_is_broken_is_seen(line: str, instead: str, seen: str, folder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    code = (broken / "vsg_laws.h").read_text(encoding="utf-8")
    assert line in code
    (broken / "vsg_laws.h").write_text(code.replace(line, instead), encoding="utf-8")
    failed, said, _ = run_fuzz(build_fuzz(broken, tmp_path, double=True), 20_000, seed=7)
    assert (failed, seen in said) == (1, True), said


@pytest.mark.parametrize(
    ("limiter", "double"), [("circular", True), ("projection", True), ("projection", False), ("balanced_power", True)]
)
def test_no_input_spoils_the_controller(limiter: str, double: bool, tmp_path: Path) -> None:
    """A million calls of each limiter: ``python -m evidence exported_c``."""
    table_file, _ = written(tmp_path)
    folder = export_c_files(table_file, tmp_path / "c", limiter=limiter).folder
    program = build_control_fuzz(folder, tmp_path, load_scheduler(table_file), LIMITERS[limiter], double=double)
    code, said = run_control_fuzz(program, 30_000, seed=3)
    assert code == 0, said
    calls, used, limited, retuned = map(int, re.findall(r"\d+", said))
    assert calls == 30_000
    # Most samples are good and taken. In open loop the integrators may leave their range until the next start.
    assert 0.7 * calls < used < calls
    assert 0.1 * calls < limited
    assert retuned > 100


@pytest.mark.parametrize(
    "broken_lines",
    [
        {
            "vsg_finite(size) && (vsg_plausible(": "(vsg_finite(size) <= 1) && (vsg_plausible(",
            "&c->settings) > VSG_C(0.5)));\n    uint16_t used": "&c->settings) <= VSG_C(1.0)));\n    uint16_t used",
            "vsg_bounded(&following) != 0U": "vsg_bounded(&following) <= 1U",
            "&c->settings) > VSG_C(0.5)));": "&c->settings) <= VSG_C(1.0)));",
        },
        {"if (used == 0U) {": "if (used == 2U) {"},
    ],
)
def test_a_guard_that_is_missing_is_seen(broken_lines: dict[str, str], tmp_path: Path) -> None:
    table_file, _ = written(tmp_path)
    broken = export_c_files(table_file, tmp_path / "c").folder
    code = (broken / "vsg_control.c").read_text(encoding="utf-8")
    for line, instead in broken_lines.items():
        assert line in code
        code = code.replace(line, instead)
    (broken / "vsg_control.c").write_text(code, encoding="utf-8")
    program = build_control_fuzz(broken, tmp_path, load_scheduler(table_file), LIMITERS["circular"], double=True)
    failed, said = run_control_fuzz(program, 30_000, seed=3)
    assert failed == 1, said
