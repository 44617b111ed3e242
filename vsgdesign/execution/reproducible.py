"""The environment of processes that are to compute the same bits on every machine of one kind of operating system."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

_ONE_KERNEL = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "MKL_CBWR": "COMPATIBLE",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    # Functions of the C library have variants with and without fused multiply-add. The second names are older ones.
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable,-FMA4_Usable",
}


def reproducible_environment() -> dict[str, str]:
    """Variables with which a new process uses the same kernels of NumPy, BLAS and the C library on every x86 processor.

    They must be set before it starts: these libraries choose their kernels while they are loaded. Empty for another
    architecture.
    """
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return {}
    from numpy._core._multiarray_umath import __cpu_dispatch__  # type: ignore[attr-defined]

    return {"NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__)} | _ONE_KERNEL


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Processes that start within the block have these variables; the ones of before are put back."""
    left_out = ("NPY_ENABLE_CPU_FEATURES",) if "NPY_DISABLE_CPU_FEATURES" in values else ()  # NumPy refuses both
    before = {name: os.environ.get(name) for name in (*values, *left_out)}
    os.environ.update(values)
    for name in left_out:
        os.environ.pop(name, None)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
