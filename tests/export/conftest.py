"""Exported folders and their compiled C, once a session; a machine without a compiler says so."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.export.exchange import exported, written
from vsgdesign.export import CompiledC, compile_c
from vsgdesign.runtime import Scheduler, load_scheduler

FIT = {"sample_interval": 200e-6}


def needs(program: str) -> pytest.MarkDecorator:
    """Skips where a program is not installed, with the reason."""
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("export"))


@pytest.fixture(scope="session", params=["double", "float"])
def compiled(request: pytest.FixtureRequest, folder: Path) -> CompiledC:
    return built(folder, request.param == "double")


@pytest.fixture
def scheduler(tmp_path: Path) -> Scheduler:
    """Of the same files as the exported C, with the sensors' limits of the export."""
    table_file, weights_file = written(tmp_path)
    return load_scheduler(table_file, weights_file, fit=FIT)


def built(folder: Path, double: bool) -> CompiledC:
    for program in ("cc",):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    pytest.importorskip("cffi")
    return compile_c(folder, double=double)
