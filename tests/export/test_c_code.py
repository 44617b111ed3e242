"""The exported folder: what is in it, that it compiles everywhere, and what is refused."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from tests.artifacts.networks import random_weights
from tests.cli.small_studies import as_json, call
from tests.compilers import GCC_AND_CLANG, needs, require_compiler
from tests.export.exchange import KINDS, exported, self_test_of, written
from tests.export.footprint import COMPILER, measure_footprint
from vsgdesign.artifacts import read_table_file
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.errors import ArtifactError
from vsgdesign.export import compile_c, export_c_files
from vsgdesign.export.c_code import FILES, MANIFEST
from vsgdesign.export.c_content import REASON_NAMES
from vsgdesign.export.compiled import STRICT, run_compiler
from vsgdesign.runtime.guards import REASONS
from vsgdesign.study.parameters import load_study


def test_the_manifest_says_what_it_was_made_from(folder: Path, tmp_path: Path) -> None:
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    table_file, weights_file = written(tmp_path)
    assert manifest["kind"] == "vsgdesign export c"
    assert manifest["table"]["sha256"] == read_table_file(table_file).sha256
    assert manifest["weights"]["sha256"] == json.loads(weights_file.read_text(encoding="utf-8"))["sha256"]
    assert sorted(path.name for path in folder.iterdir()) == sorted([*FILES, MANIFEST])
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert manifest["table"]["sha256"] in (folder / "vsg_data.c").read_text(encoding="utf-8")
    assert len(REASON_NAMES) == len(REASONS)


def test_the_same_inputs_give_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    again = exported(tmp_path)
    for path in folder.iterdir():
        assert path.read_bytes() == (again / path.name).read_bytes(), path.name


def test_for_processors_without_bytes_and_without_a_heap(folder: Path) -> None:
    text = "".join((folder / name).read_text(encoding="utf-8") for name in FILES if name.endswith((".c", ".h")))
    assert text.isascii()
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert not re.search(
        r"\b(u?int8_t|malloc|calloc|free|static\s+(?!const|vsg|uint16_t\s+vsg|void)\w+\s+\w+\s*[;=])", code
    )
    for name in re.findall(r"^(?:const )?\w+\s+\**(\w+)\(", code, re.MULTILINE):
        assert name.startswith("vsg_"), name


@pytest.fixture(scope="module", params=KINDS, ids="-".join)
def sources(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The C files of a kind of table."""
    return [str(path) for path in exported(tmp_path_factory.mktemp("kind"), *request.param).glob("*.c")]


@pytest.mark.parametrize("compiler", GCC_AND_CLANG)
@pytest.mark.parametrize("flags", [[], ["-DVSG_DOUBLE"]], ids=["float", "double"])
def test_compiles_without_a_warning(compiler: str, flags: list[str], sources: list[str]) -> None:
    if compiler == "gcc":
        require_compiler()
    run_compiler([compiler, *STRICT, "-Wpedantic", "-Wshadow", "-O2", *flags, "-fsyntax-only", *sources])


@needs("arm-none-eabi-gcc")
@pytest.mark.parametrize(
    ("limiter", "flash_limit", "numbers", "stack_limit"),
    [("circular", 2560, 17 + 7 + 8 + 8 + 2 + 4 + 16, 208), ("projection", 5120, 66 + 3 + 15, 352)],
)
def test_fits_a_small_controller(
    limiter: str, flash_limit: int, numbers: int, stack_limit: int, tmp_path: Path
) -> None:
    """200–8–2 and 12 × 10 cells: 18 kB of flash, 1.5 kB of RAM beside the window, and the whole controller.

    1.2 kB of the flash are logf and expf, with which an uncertain estimate is followed in part."""
    assert COMPILER == "arm-none-eabi-gcc"
    table_file, weights_file = written(tmp_path)
    footprint = measure_footprint(
        export_c_files(table_file, tmp_path / "c", weights=weights_file, limiter=limiter).folder
    )
    assert 4000 < footprint.flash <= 18 * 1024
    assert 100 < footprint.ram + footprint.stack <= 1536
    assert footprint.window == 2 * 100 * 4 + 4
    flash, ram, stack = footprint.control
    # 150 are the compensated sums, 200 the notches, 600 the guard; of projection 400 the gate, 460 the way back, 240
    # the voltage of the bridge.
    assert 800 < flash <= flash_limit
    assert ram == 4 * numbers
    assert 0 < stack <= stack_limit


@pytest.mark.parametrize("compiler", GCC_AND_CLANG)
@pytest.mark.parametrize("option", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_options_that_remove_the_guards_are_an_error_in_every_file(option: str, compiler: str, folder: Path) -> None:
    for source in sorted(folder.glob("*.[ch]")):
        with pytest.raises(
            ArtifactError, match=f"Compile without {'-ffinite' if 'finite' in option else '-ffast'}-math"
        ):
            run_compiler([compiler, "-std=c99", "-w", option, "-fsyntax-only", "-x", "c", str(source)])


@pytest.mark.parametrize("compiler", GCC_AND_CLANG)
def test_the_self_test_sees_guards_that_a_compiler_removed(compiler: str, folder: Path, tmp_path: Path) -> None:
    """As a compiler does that says nothing of such an option."""
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    assert self_test_of(copy, compiler, "-O1", "-ffast-math", "-U__FAST_MATH__", "-U__FINITE_MATH_ONLY__") != 0


GUARDS = [
    ("vsg_power.c", "used = vsg_bounded_sum(VSG_ABS(P) + VSG_ABS(Q))", "used = 1U"),
    ("vsg_power.c", "taken = vsg_usable(gains)", "taken = 1U"),
    (
        "vsg_control.c",
        "(vsg_finite(size) && (vsg_plausible(measured, &c->settings) > VSG_C(0.5)))",
        "(size == size || 1)",
    ),
    ("vsg_control.c", "(vsg_usable(gains) != 0U)", "(gains != 0)"),
    ("vsg_control.c", "number = vsg_bounded_sum(VSG_ABS(v_alpha) + VSG_ABS(v_beta))", "number = 1U"),
    ("vsg.c", "!vsg_finite(v_peak) || !vsg_finite(i_peak)", "v_peak < i_peak - i_peak"),
    ("vsg_laws.h", "return (bits & exponent) != exponent", "return (bits & exponent) == (bits & exponent)"),
]
"""What refuses NaN in each part: file, guard, and the same file without it."""


def test_a_nan_is_among_the_known_answers_of_every_part(folder: Path, tmp_path: Path) -> None:
    require_compiler()
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    assert self_test_of(copy) == 0
    for name, guard, without in GUARDS:
        sound = (copy / name).read_text(encoding="utf-8")
        assert sound.count(guard) == 1, (name, guard)
        (copy / name).write_text(sound.replace(guard, without), encoding="utf-8")
        assert self_test_of(copy) != 0, (name, guard)
        (copy / name).write_text(sound, encoding="utf-8")


@needs("make")
@pytest.mark.parametrize("real", ["float", "double"])
def test_its_own_makefile_runs_the_self_test(real: str, folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    command = ["make", "-C", str(copy), f"REAL={real}", "test"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # Flags of one's own take none of the folder's away, and nothing of the other precision is left.
    other = {"float": "double", "double": "float"}[real]
    quickly = [*command, f"REAL={other}", "CFLAGS=-O0"]
    done = subprocess.run(quickly, capture_output=True, text=True, check=False)
    built = [line for line in done.stdout.splitlines() if " -c vsg" in line]
    assert len(built) == len(list(copy.glob("vsg*.c")))
    for line in built:
        assert ("-DVSG_DOUBLE" in line) == (other == "double")
        assert "-O0" in line
        assert "-Werror" in line
    assert subprocess.run([*command, "REAL=half"], capture_output=True, check=False).returncode != 0
    # A wrong constant is found: the first node's first parameter. Its file alone is compiled again.
    data = (copy / "vsg_data.c").read_text(encoding="utf-8")
    bent = re.sub(r"(vsg_axis_scr\[VSG_ROWS\] = \{.*)VSG_C\(20\.0\)", r"\1VSG_C(20.1)", data)
    assert bent != data
    (copy / "vsg_data.c").write_text(bent, encoding="utf-8")
    done = subprocess.run(quickly, capture_output=True, text=True, check=False)
    assert [line.split()[-3] for line in done.stdout.splitlines() if " -c vsg" in line] == ["vsg_data.c"]
    assert done.returncode != 0
    assert "Error" in done.stderr


@needs("cmake")
def test_cmake_builds_it(folder: Path, tmp_path: Path) -> None:
    for command in (["cmake", "-S", str(folder), "-B", str(tmp_path)], ["cmake", "--build", str(tmp_path)]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    assert list(tmp_path.glob("*vsg.*"))


def test_without_a_network_there_is_none(tmp_path: Path) -> None:
    table_file, _ = written(tmp_path)
    made = export_c_files(table_file, tmp_path / "c")
    assert made.manifest["weights"] is None
    assert "vsg_push" not in (tmp_path / "c" / "vsg.h").read_text(encoding="utf-8")
    require_compiler("cc")
    assert compile_c(tmp_path / "c").selftest() == 0


def test_the_integration_page_has_one_update_period(folder: Path, tmp_path: Path) -> None:
    """With a network, an update comes with every window: not the nominal 20 ms beside windows of another length."""
    _, weights_file = written(tmp_path)
    window = json.loads(weights_file.read_text(encoding="utf-8"))["window"]
    period_ms = window["samples"] * window["sample_interval"] * 1e3
    page = (folder / "INTEGRATION.md").read_text(encoding="utf-8")
    assert f"| update period | {period_ms:.4g} ms |" in page
    settings = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["settings"]
    assert settings["update_ticks"] * settings["tick"] * 1e3 == pytest.approx(period_ms, rel=1e-6)


def test_folders_with_other_files_are_left_alone(tmp_path: Path) -> None:
    table_file, _ = written(tmp_path)
    out = tmp_path / "c"
    export_c_files(table_file, out)
    export_c_files(table_file, out)  # its own, unchanged: replaced
    (out / "main.c").write_text("int main(void);", encoding="utf-8")
    with pytest.raises(ArtifactError, match=r'holds main\.c, which "vsgdesign export c" did not write'):
        export_c_files(table_file, out)
    (out / "main.c").unlink()
    (out / "vsg.c").write_text("/* tuned by hand */", encoding="utf-8")
    with pytest.raises(ArtifactError, match=r"holds vsg\.c, which was changed since"):
        export_c_files(table_file, out)
    assert (out / "vsg.c").read_text(encoding="utf-8") == "/* tuned by hand */"
    other = tmp_path / "other"
    other.mkdir()
    (other / MANIFEST).write_text('{"kind": "something else", "files": {"a": "b"}}', encoding="utf-8")
    with pytest.raises(ArtifactError, match=r"manifest\.json that was changed"):
        export_c_files(table_file, other)


def test_damaged_newer_and_foreign_files_are_refused(tmp_path: Path) -> None:
    table_file, weights_file = written(tmp_path)
    text = table_file.read_text(encoding="utf-8")
    out = tmp_path / "c"
    for bad, named in (
        (text[: len(text) // 2], "cut short"),
        (text.replace("15.8", "15.9", 1), "sha256"),
        (re.sub(r'"schema": \d+', '"schema": 99', text, count=1), "schema 99"),
    ):
        (tmp_path / "bad.json").write_text(bad, encoding="utf-8")
        with pytest.raises(ArtifactError, match=named):
            export_c_files(tmp_path / "bad.json", out)
    with pytest.raises(ArtifactError, match="not a gain table"):
        export_c_files(weights_file, out)
    with pytest.raises(ArtifactError, match="was not designed from this study"):
        export_c_files(table_file, out, study=load_study("studies/laboratory/study.toml"))
    (tmp_path / "cut.json").write_text(weights_file.read_text(encoding="utf-8")[:500], encoding="utf-8")
    with pytest.raises(ArtifactError):
        export_c_files(table_file, out, weights=tmp_path / "cut.json")
    synchronised = tmp_path / "synchronised.json"
    write_network_weights(random_weights(synchronised=True), synchronised)
    with pytest.raises(ArtifactError, match="grid_phase"):
        export_c_files(table_file, out, weights=synchronised)
    foreign = tmp_path / "foreign.json"
    write_network_weights(replace(random_weights(), training={"converter": {"S_rated": 1e6}}), foreign)
    with pytest.raises(ArtifactError, match=r"S_rated = 1e\+06 VA, the table is for 5000 VA"):
        export_c_files(table_file, out, weights=foreign)
    assert not out.exists()


def test_names_cannot_end_a_comment(tmp_path: Path) -> None:
    table_file, _ = written(tmp_path, name="*/ int évil; /*\n#error")
    export_c_files(table_file, tmp_path / "c")
    require_compiler()
    run_compiler(["gcc", *STRICT, "-fsyntax-only", *(str(path) for path in (tmp_path / "c").glob("*.c"))])


def test_the_verb(tmp_path: Path) -> None:
    table_file, weights_file = written(tmp_path)
    out = tmp_path / "c"
    document = as_json("export", "c", table_file, "--weights", weights_file, "--out", out, "--rate", "2")
    assert document["settings"]["rate"] == 2.0
    assert document["network"]["shape"] == [200, 8, 2]
    shown = call("export", "c", table_file, "--out", out)
    assert shown.exit_code == 0
    assert "12 files" in shown.stdout
    (out / "mine.txt").write_text("x", encoding="utf-8")
    refused = call("export", "c", table_file, "--out", out)
    assert refused.exit_code == 2
    assert "left untouched" in refused.stderr


def test_no_compiler_is_said(folder: Path) -> None:
    with pytest.raises(ArtifactError, match="is not installed"):
        compile_c(folder, compiler="no-such-compiler")
