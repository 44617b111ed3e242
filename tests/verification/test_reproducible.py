"""Strict blocks run in processes whose libraries use the same kernels on every processor."""

from __future__ import annotations

import os
import platform

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from vsgdesign.execution.executors import environment, executor_of, reproducible_environment


def kernels() -> tuple[list[str], list[str]]:
    """Features that NumPy dispatches to in this process, and the kernels of its BLAS."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__  # type: ignore[attr-defined]

    np.linalg.inv(np.eye(2))
    used = [name for name in __cpu_dispatch__ if __cpu_features__.get(name)]
    return used, [str(one["architecture"]) for one in threadpool_info() if one["user_api"] == "blas"]


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="not an x86 processor")
def test_one_kernel_whatever_the_caller_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell")
    monkeypatch.setenv("NPY_ENABLE_CPU_FEATURES", "X")
    with executor_of(1, reproducible=True) as executor:
        assert executor is not None
        features, blas = executor.submit(kernels).result()
    assert features == []
    assert {name.lower() for name in blas} == {"nehalem"}
    assert os.environ["OPENBLAS_CORETYPE"] == "Haswell"
    assert os.environ["NPY_ENABLE_CPU_FEATURES"] == "X"


def test_the_environment_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    with environment({"OPENBLAS_CORETYPE": "Nehalem"}):
        assert os.environ["OPENBLAS_CORETYPE"] == "Nehalem"
    assert "OPENBLAS_CORETYPE" not in os.environ
    assert all(isinstance(value, str) for value in reproducible_environment().values())
