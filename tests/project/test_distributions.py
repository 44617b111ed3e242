"""What is installed: one version everywhere, and a runtime that needs NumPy alone."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import vsgdesign
from tests.export.conftest import FIT
from tests.export.exchange import written
from vsgdesign.runtime import load_scheduler

ROOT = Path(__file__).resolve().parents[2]
RUNTIME = tomllib.loads((ROOT / "packages" / "runtime" / "pyproject.toml").read_text(encoding="utf-8"))

BUILD = "from setuptools import build_meta; import sys; build_meta.build_wheel(sys.argv[1])"
UPDATES = """
import json, sys
sys.path[:0] = sys.argv[1:3]
from vsgdesign.runtime import load_scheduler
scheduler = load_scheduler(sys.argv[3], sys.argv[4], fit=json.loads(sys.argv[5]))
answer = scheduler.update_estimate(0.4, 1.2e-3, 3000.0, 500.0, 112.0)
rooms = sorted({".".join(name.split(".")[:2]) for name in sys.modules if name.startswith("vsgdesign")})
file = sys.modules["vsgdesign"].__file__
print(json.dumps({"gains": list(answer.gains), "why": answer.why, "file": file, "rooms": rooms}))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The runtime's wheel, built of a copy, so that nothing is left in this folder."""
    copy = tmp_path_factory.mktemp("sources")
    shutil.copytree(ROOT / "packages", copy / "packages", ignore=shutil.ignore_patterns("build"))
    shutil.copytree(ROOT / "vsgdesign", copy / "vsgdesign", ignore=shutil.ignore_patterns("__pycache__"))
    built = copy / "dist"
    command = [sys.executable, "-c", BUILD, str(built)]
    done = subprocess.run(command, cwd=copy / "packages" / "runtime", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = built.glob("*.whl")
    return found


def test_the_runtime_works_with_numpy_alone(wheel: Path, tmp_path: Path) -> None:
    """Unpacked beside NumPy and nothing else, it reads a table and weights and answers like the whole package."""
    here, numpy_alone = tmp_path / "here", tmp_path / "numpy_alone"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(here)
    numpy_alone.mkdir()
    site = Path(np.__file__).parents[1]
    for folder in site.glob("numpy*"):
        (numpy_alone / folder.name).symlink_to(folder)
    table_file, weights_file = written(tmp_path)
    files = [str(path) for path in (here, numpy_alone, table_file, weights_file)]
    command = [sys.executable, "-I", "-S", "-c", UPDATES, *files, json.dumps(FIT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert Path(said["file"]).is_relative_to(here)
    whole = load_scheduler(table_file, weights_file, fit=FIT).update_estimate(0.4, 1.2e-3, 3000.0, 500.0, 112.0)
    assert said["gains"] == list(whole.gains)
    assert said["why"] == whole.why
    shipped = set(RUNTIME["tool"]["setuptools"]["packages"]) | {"vsgdesign.equations.frames", "vsgdesign.errors"}
    assert set(said["rooms"]) <= shipped


def test_the_runtime_asks_for_numpy_alone(wheel: Path) -> None:
    """As the whole package asks for it, and under the same version."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith("METADATA")]
        lines = archive.read(name).decode().splitlines()
        modules = [name for name in archive.namelist() if name.startswith("vsgdesign/") and name.endswith(".py")]
        assert "vsgdesign/artifacts/weights/field.json" in archive.namelist()
    folders = {name.rpartition("/")[0] for name in modules}
    asked = [line.partition(": ")[2] for line in lines if line.startswith("Requires-Dist")]
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert asked == [line for line in whole["dependencies"] if line.startswith("numpy")]
    assert f"Version: {vsgdesign.__version__}" in lines
    assert whole["requires-python"] == RUNTIME["project"]["requires-python"]
    assert folders == {name.replace(".", "/") for name in RUNTIME["tool"]["setuptools"]["packages"]}


def test_the_package_says_that_it_is_typed(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        assert "vsgdesign/py.typed" in archive.namelist()
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "py.typed" in whole["tool"]["setuptools"]["package-data"]["vsgdesign"]


def test_the_citation_names_this_version() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (\S+)$", text, re.MULTILINE) == [vsgdesign.__version__]


def test_the_readme_is_short() -> None:
    """It is read before anything is installed: what is longer belongs on a page of docs."""
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 140
