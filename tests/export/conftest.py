"""Exported folders and their compiled C, once a session. A C compiler is required: see tests/compilers.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.compilers import digest_of, require_compiler
from tests.export.exchange import exported, written
from vsgdesign.export import CompiledC, compile_c
from vsgdesign.runtime import Scheduler, load_scheduler

_BUILT: dict[str, CompiledC] = {}
"""By the text of the C and how it was compiled: several tests export the same table."""

FIT: dict[str, Any] = {"sample_interval": 200e-6}


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("export"))


@pytest.fixture(scope="session", params=["double", "float"])
def compiled(request: pytest.FixtureRequest, folder: Path) -> CompiledC:
    return built(folder, request.param == "double", "-O2")


@pytest.fixture
def scheduler(tmp_path: Path) -> Scheduler:
    """Of the same files as the exported C, with the sensors' limits of the export."""
    table_file, weights_file = written(tmp_path)
    return load_scheduler(table_file, weights_file, fit=FIT)


def built(folder: Path, double: bool, flag: str = "-O0") -> CompiledC:
    """Compiled in half the time that optimising takes. What ships is single precision, optimised: so are every kind of
    table, the folder of all tests, the field estimator and the start of a converter."""
    require_compiler("cc")
    key = digest_of([flag, str(double)], sorted(folder.glob("*.[ch]")))
    if key not in _BUILT:
        _BUILT[key] = compile_c(folder, double=double, flags=(flag,))
    return CompiledC(_BUILT[key].ffi, _BUILT[key].library, double)
