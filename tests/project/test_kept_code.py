"""What compilers made before is taken only for the same text, headers and options, and has the same bits."""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests import kept_code
from tests.compilers import require_compiler
from tests.kept_code import KeptCompilers, Store, keep_machine_code
from vsgdesign.codegen import machine_code


class Counted:
    """Runs programs, and counts them."""

    def __init__(self) -> None:
        self.count = 0

    def run(self, *arguments: Any, **options: Any) -> Any:
        self.count += 1
        return subprocess.run(*arguments, **options)


def test_a_c_compiler_runs_once_for_the_same_files(tmp_path: Path) -> None:
    require_compiler("gcc")
    counted = Counted()
    kept = KeptCompilers(Store(tmp_path / "kept"), counted)

    def compiled(
        folder: str, header: str, *flags: str, source: str = '#include "a.h"\nint f(void) { return A; }\n'
    ) -> bytes:
        place = tmp_path / folder
        place.mkdir(exist_ok=True)
        (place / "a.c").write_text(source)
        (place / "a.h").write_text(header)
        command = ["gcc", *flags, f"-I{place}", "-c", str(place / "a.c"), "-o", str(place / "a.o")]
        done = kept.run(command, capture_output=True, encoding="utf-8", check=False)
        return (place / "a.o").read_bytes() if done.returncode == 0 else done.stderr.encode()

    first = compiled("one", "#define A 1\n")
    assert compiled("one", "#define A 1\n") == compiled("other", "#define A 1\n") == first
    assert counted.count == 1
    assert compiled("one", "#define A 2\n") != first
    assert compiled("one", "#define A 1\n", "-O2") != first
    assert counted.count == 3
    for _ in range(2):  # what fails fails again, and what warns warns again
        assert b"error" in compiled("one", "", source="int f(void) { return B; }")
    compiled("one", "", "-Wall", source="static int f;\n")
    compiled("one", "", "-Wall", source="static int f;\n")
    assert counted.count == 7
    for count in (8, 9):  # what makes another file beside it makes it each time
        (tmp_path / "one" / "a.su").unlink(missing_ok=True)
        compiled("one", "#define A 1\n", "-fstack-usage")
        assert (counted.count, (tmp_path / "one" / "a.su").is_file()) == (count, True)


def test_what_is_too_much_goes_by_its_last_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_code, "LARGEST_BYTES", 250)
    store = Store(tmp_path)
    for k, name in enumerate("abc"):
        store.put(name, bytes(100))
        os.utime(tmp_path / name, (k, k))
    assert store.get("a") == bytes(100)
    store.sweep()
    assert (store.get("a"), store.get("b"), store.get("c")) == (bytes(100), None, bytes(100))


TEXT = "define i64 @f() {{\n  ret i64 {}\n}}\n"


def test_llvm_compiles_once_for_the_same_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    texts, parsed = [], machine_code._parsed

    def told(text: str, *rest: Any) -> Any:
        texts.append(text)
        return parsed(text, *rest)

    monkeypatch.setattr(machine_code, "_parsed", told)
    keep_machine_code(Store(tmp_path / "kept"), monkeypatch)
    engines = [machine_code._build(TEXT.format(number), "native", True) for number in (7, 7, 8)]
    answers = [ctypes.CFUNCTYPE(ctypes.c_int64)(one.get_function_address("f"))() for one in engines]
    assert answers == [7, 7, 8]
    assert [text for text in texts if "@f" in text] == [TEXT.format(7), TEXT.format(8)]
