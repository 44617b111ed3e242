"""What compiles the generated C in tests: a C compiler is required, since the C is what ships; others are wanted."""

from __future__ import annotations

import functools
import hashlib
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from vsgdesign.export.compiled import run_compiler


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


_INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"([^"]+)"', re.MULTILINE)


def digest_of(words: Sequence[str], files: Sequence[Path]) -> str:
    """Of words, and of the names and texts of files."""
    found = hashlib.sha256(repr(tuple(words)).encode())
    for path in files:
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


@functools.cache
def _objects() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="vsg-objects")


def objects_of(command: Sequence[str], sources: Sequence[Path], headers: Sequence[Path]) -> list[str]:
    """The object files of C sources. One whose text, headers and command are the same was compiled before in this
    process. ``headers``: the folders in which they are."""
    texts = [path for folder in headers for path in sorted(folder.glob("*.h"))]
    found = []
    for source in sources:
        made = Path(_objects().name) / f"{digest_of(command, [source, *_included(source, texts)])}.o"
        if not made.exists():
            run_compiler([*command, *(f"-I{folder}" for folder in headers), "-c", str(source), "-o", str(made)])
        found.append(str(made))
    return found


def _included(source: Path, headers: Sequence[Path]) -> list[Path]:
    """Those of the headers that a source includes, or that one of these does."""
    found: list[Path] = []
    waiting = [source]
    while waiting:
        names = set(_INCLUDE.findall(waiting.pop().read_text(encoding="utf-8")))
        new = [path for path in headers if path.name in names and path not in found]
        found += new
        waiting += new
    return found
