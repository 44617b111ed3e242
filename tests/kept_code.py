"""What compilers have made of the same text before, and how equal figures look: kept beside the tests, for both workers
and for the next run.

The suite asks LLVM, C compilers and make for the same machine code again and again. Everything that it follows from is
in the name under which it is kept: the text and the headers that it may include, the options, the compiler and, for
LLVM, the module of the product that calls it. What fails is never kept. Nothing is kept where VSGDESIGN_NO_KEPT_CODE is
set.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parent / "__pycache__" / "kept_code"
LARGEST_BYTES = 200e6
"""What was not used for the longest time is deleted beyond."""

OTHER_FILES = (".c", ".h", ".s", ".ld", ".o", ".map")
"""Ends of the names of files from which a compiler makes something."""


MAKES_MORE = ("-fstack-usage", "--coverage", "-fprofile", "-ftest-coverage", "-save-temps", "-M")
"""Options with which a compiler makes other files, too."""


class Store:
    """Machine code and pictures by the hash of what they follow from."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, key: str) -> bytes | None:
        """What is kept under a name; None if nothing is."""
        place = self._folder / key
        try:
            found = place.read_bytes()
            os.utime(place)
        except OSError:
            return None
        return found

    def put(self, key: str, content: bytes) -> None:
        """Keeps it: completely or, where there is no room, not at all."""
        place = self._folder / f"{key}.{os.getpid()}"
        try:
            place.write_bytes(content)
            os.replace(place, self._folder / key)
        except OSError:
            place.unlink(missing_ok=True)

    def sweep(self) -> None:
        """Deletes what is too much, what was not used for the longest time first."""
        size = 0.0
        for place in sorted(self._folder.iterdir(), key=_last_used, reverse=True):
            with contextlib.suppress(OSError):  # another worker was faster
                size += place.stat().st_size
                if size > LARGEST_BYTES:
                    place.unlink()


def _last_used(place: Path) -> float:
    try:
        return place.stat().st_mtime
    except OSError:
        return 0.0


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


class KeptMachineCode:
    """Stands for the product's function that compiles a text of LLVM. On a miss it calls that function."""

    def __init__(self, store: Store) -> None:
        import llvmlite

        from vsgdesign.codegen import machine_code

        own = machine_code._build
        self._store, self._target_named = store, machine_code.target_named
        self._build: Any = own._build if isinstance(own, KeptMachineCode) else own
        self._own = Path(machine_code.__file__).read_bytes() + llvmlite.__version__.encode()

    def __call__(self, text: str, target: str, quickly: bool) -> Any:
        from llvmlite import binding

        asked = repr((self._target_named(target), quickly)).encode()
        key = hashlib.sha256(b"\0".join((self._own, asked, text.encode()))).hexdigest()
        found, create = self._store.get(key), binding.create_mcjit_compiler

        def remembering(module: Any, machine: Any) -> Any:
            engine = create(module, machine)
            engine.set_object_cache(lambda _, made: self._store.put(key, bytes(made)), lambda _: found)
            return engine

        with pytest.MonkeyPatch.context() as inside:
            inside.setattr(binding, "create_mcjit_compiler", remembering)
            # The object has the functions; the module is there because an engine needs one.
            return self._build(text if found is None else NOTHING, target, quickly)


NOTHING = "define void @none() {\n  ret void\n}\n"


def keep_machine_code(store: Store, patch: pytest.MonkeyPatch) -> None:
    """LLVM's machine code of a text is that of the last time, if text, target and the product's own module are."""
    from vsgdesign.codegen import machine_code

    patch.setattr(machine_code, "_build", KeptMachineCode(store))


def keep_compiled_c(store: Store, patch: pytest.MonkeyPatch) -> None:
    """What a C compiler or make makes for an export is that of the last time, if all files and options are."""
    from vsgdesign.export import compiled

    patch.setattr(compiled, "subprocess", KeptCompilers(store))
