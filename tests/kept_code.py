"""What compilers have made of the same text before, and how equal figures look: kept beside the tests, for both workers
and for the next run.

The suite asks C compilers and make for the same machine code again and again. Everything that it follows from is in the
name under which it is kept: the text and the headers that it may include, the options and the compiler. What fails is
never kept. Nothing is kept where VSGDESIGN_NO_KEPT_CODE is set. What LLVM makes is kept by the product itself.
"""

from __future__ import annotations

import functools
import hashlib
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from vsgdesign.codegen.kept_code import Store

FOLDER = Path(__file__).parent / "__pycache__" / "kept_code"
OTHER_FILES = (".c", ".h", ".s", ".ld", ".o", ".map")
"""Ends of the names of files from which a compiler makes something."""


MAKES_MORE = ("-fstack-usage", "--coverage", "-fprofile", "-ftest-coverage", "-save-temps", "-M")
"""Options with which a compiler makes other files, too."""


class KeptCompilers:
    """Stands for :mod:`subprocess` in a module that runs compilers."""

    def __init__(self, store: Store, used: Any = subprocess) -> None:
        self._store, self._used = store, used

    def __getattr__(self, name: str) -> Any:
        return getattr(self._used, name)

    def run(self, command: Sequence[Any], **options: Any) -> Any:
        """As subprocess.run. The file that the command makes is taken from what is kept, if it is."""
        words = [str(word) for word in command]
        made = _made_by(words)
        if made is None or options.get("input") is not None or shutil.which(words[0]) is None:
            return self._used.run(command, **options)
        key = _key(words, made)
        kept = self._store.get(key)
        if kept is not None:
            made.write_bytes(kept)
            made.chmod(0o755)
            return subprocess.CompletedProcess(command, 0, "", "")
        before = {*made.parent.iterdir()}
        done = self._used.run(command, **options)
        alone = made.is_file() and {*made.parent.iterdir()} - before <= {made}  # no figures of the stack beside it
        if done.returncode == 0 and alone and not done.stdout and not done.stderr:
            self._store.put(key, made.read_bytes())
        return done


def _made_by(words: Sequence[str]) -> Path | None:
    """The file alone that a compiler is asked for with -o, or make for a processor with -C; None for other commands."""
    if any(word.startswith(MAKES_MORE) for word in words):
        return None
    if "-o" in words[:-1]:
        return Path(words[words.index("-o") + 1])
    if words[0] == "make" and "-C" in words and words[-1].endswith(".elf"):
        return Path(words[words.index("-C") + 1]) / words[-1]
    return None


def _key(words: Sequence[str], made: Path) -> str:
    """Hash of a command with the contents of all files that it may read, wherever they are."""
    digest = hashlib.sha256(b"alone" + _version(words[0]))
    folders = set()
    for word in words:
        start, place = ("-I", word[2:]) if word.startswith("-I") else ("", word)
        if word.startswith("-Wl,") and "=" in word:  # a script of the linker
            start, _, place = word.rpartition("=")
        path = Path(place)
        if path == made:
            digest.update(b"made")
        elif path.is_dir():
            digest.update(start.encode())
            folders.add(path)
        elif path.is_file() and path.suffix in OTHER_FILES:
            digest.update(f"{start}{path.name}\0".encode() + path.read_bytes())
            folders.add(path.parent)
        else:
            digest.update(word.replace(str(made.parent), "").encode() + b"\0")
    ends = (*OTHER_FILES, "") if words[0] == "make" else (".h",)
    for folder in folders:
        for path in sorted(folder.rglob("*") if words[0] == "make" else folder.glob("*.h")):
            if path.is_file() and path.suffix in ends:
                digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


@functools.cache
def _version(program: str) -> bytes:
    """What a program says of itself; with make, what the compiler of the firmware says, too."""
    programs = ["make", "arm-none-eabi-gcc"] if program == "make" else [program]
    there = filter(shutil.which, programs)
    return b"".join(subprocess.run([one, "--version"], capture_output=True, check=False).stdout for one in there)


def keep_compiled_c(store: Store, patch: pytest.MonkeyPatch) -> None:
    """What a C compiler or make makes for an export is that of the last time, if all files and options are."""
    from vsgdesign.export import compiled

    patch.setattr(compiled, "subprocess", KeptCompilers(store))
