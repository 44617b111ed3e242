"""What compiles the generated C in tests: a C compiler is required, since the C is what ships; others are wanted."""

from __future__ import annotations

import shutil

import pytest


def require_compiler(program: str = "gcc") -> None:
    """Fails the test where there is no C compiler, with what to do."""
    if shutil.which(program) is None:
        pytest.fail(
            f"{program} is not installed, and without it the generated C is not tested. Install a C compiler (Debian: "
            "apt-get install gcc libc6-dev), or run .ci/run, which does.",
            pytrace=False,
        )


def needs(program: str) -> pytest.MarkDecorator:
    """Skips where a program is not installed, with the reason. In continuous integration a skip is a failure."""
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


GCC_AND_CLANG = ["gcc", pytest.param("clang", marks=needs("clang"))]
"""For parametrize: gcc is required, clang is wanted."""
