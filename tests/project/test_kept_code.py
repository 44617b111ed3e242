"""What compilers made before is taken only for the same text, headers and options, and has the same bits."""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.compilers import require_compiler
from tests.kept_code import KeptCompilers
from vsgdesign.codegen import kept_code, machine_code
from vsgdesign.codegen.kept_code import FOLDER, Store, user_store


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
    store, (a, b, c) = Store(tmp_path), (letter * 64 for letter in "abc")
    for name in ("table.json", "0" * 63, "0" * 64 + ".bak"):  # the variable may name a folder with the user's own files
        (tmp_path / name).write_bytes(bytes(1000))
        os.utime(tmp_path / name, (0, 0))
    for k, name in enumerate((a, b, c)):
        store.put(name, bytes(100 - 32))  # and the hash
        os.utime(tmp_path / name, (k, k))
    assert store.get(a) == bytes(68)
    store.sweep()
    assert (store.get(a), store.get(b), store.get(c)) == (bytes(68), None, bytes(68))
    assert {one.name for one in tmp_path.iterdir()} == {a, c, "table.json", "0" * 63, "0" * 64 + ".bak"}


TEXT = "define i64 @f() {{\n  ret i64 {}\n}}\n"


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The texts that are compiled, in their order."""
    texts, own = [], machine_code._parsed

    def told(text: str, *rest: Any) -> Any:
        texts.append(text)
        return own(text, *rest)

    monkeypatch.setattr(machine_code, "_parsed", told)
    return texts


def answer(number: int, quickly: bool = True) -> int:
    """What a process that begins gets of a function: none of this one's engines is asked."""
    engine = machine_code._build(TEXT.format(number), "native", quickly)
    return int(ctypes.CFUNCTYPE(ctypes.c_int64)(engine.get_function_address("f"))())


def test_llvm_compiles_once_for_the_same_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parsed: list[str]
) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path / "kept"))
    assert [answer(7), answer(7), answer(8)] == [7, 7, 8]
    assert parsed == [TEXT.format(7), TEXT.format(8)]
    assert answer(7, quickly=False) == 7  # it is made with effort, and has a name of its own
    assert len(parsed) == 3


def test_what_is_damaged_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parsed: list[str]) -> None:
    """Half of an object, or another one, would end the process."""
    monkeypatch.setenv(FOLDER, str(tmp_path))
    assert answer(7) == 7
    (place,) = tmp_path.iterdir()
    whole = place.read_bytes()
    for content in (whole[:-40], whole[:50] + b"x" + whole[51:], b""):
        place.write_bytes(content)
        assert answer(7) == 7
        assert place.read_bytes() == whole
    assert len(parsed) == 4


def test_nothing_is_kept_where_nothing_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parsed: list[str]
) -> None:
    (tmp_path / "file").write_text("of the user")
    for folder in ("", str(tmp_path / "file"), str(tmp_path / "file" / "below")):
        monkeypatch.setenv(FOLDER, folder)
        assert user_store() is None
        assert answer(7) == 7
    assert len(parsed) == 3
    assert (tmp_path / "file").read_text() == "of the user"


def test_the_usual_folder_is_where_the_system_has_such_things(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(FOLDER)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    store = user_store()
    assert store is not None
    store.put("a", b"1")
    assert (tmp_path / "vsgdesign" / "machine-code" / "a").is_file()
