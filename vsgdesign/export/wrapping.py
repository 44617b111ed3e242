"""What the wrappers of an exported controller share: legal names, plain units, compilers, and their folders."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from vsgdesign import __version__
from vsgdesign.artifacts.files import plain, write_text
from vsgdesign.artifacts.guarded_file import check_folder_target, staged_folder, write_record
from vsgdesign.codegen.described import ascii_text
from vsgdesign.errors import ArtifactError
from vsgdesign.export.c_code import MANIFEST, render_unit
from vsgdesign.export.compiled import run_compiler
from vsgdesign.export.port_records import VARIANTS, PortList
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import WORDS, lists_of, unit_hash

SCHEMA = 1
LINUX, WINDOWS, WINDOWS_32 = "gcc", "x86_64-w64-mingw32-gcc", "i686-w64-mingw32-gcc"
"""Compilers of the libraries for Linux, and for Windows in 64 and 32 bits."""

FLAGS = ("-std=c99", "-ffp-contract=off", "-Wall", "-Wextra")
"""Without contraction two compilers give the same bits."""

DOUBLE = ("-DVSG_DOUBLE",)
"""The numbers of a wrapper are doubles."""

NOT_COMPILED = {
    LINUX: "There is no gcc here: the library for Linux is left out. Install gcc, or compile the sources.",
    WINDOWS_32: "There is no mingw for 32 bits here: this library is left out. Install gcc-mingw-w64-i686 for it.",
    WINDOWS: "There is no mingw here: the library for Windows is left out. Install gcc-mingw-w64-x86-64, or compile "
    "the sources.",
}


@dataclass(frozen=True)
class Exported:
    """The files of a wrapper, their record, and what is to be said of them."""

    folder: Path
    manifest: dict[str, Any]
    said: tuple[str, ...] = ()


@dataclass(frozen=True)
class Wrapped:
    """One variant of a controller, as the templates of a wrapper take it."""

    unit: Unit
    variant: str
    ports: PortList
    name: str
    """What the other tool calls it."""
    said: tuple[str, ...]

    @property
    def word(self) -> str:
        """What its functions are called in C."""
        return WORDS[self.variant]


def wrapped(unit: Unit, variant: str, *, longest: int = 50) -> Wrapped:
    """A variant of a controller with a name that is legal everywhere. Raises ArtifactError for an unknown variant."""
    if variant not in VARIANTS:
        raise ArtifactError(f'variant = "{variant}": unknown. Known: {", ".join(VARIANTS)}.')
    wanted = f"{unit.origin.study}_{unit.controller}" + ("_reference" if variant == "reference" else "")
    name = legal_name(wanted, longest)
    said = (f'"{wanted}" is called {name}: the other tool allows no other characters.',) if name != wanted else ()
    return Wrapped(unit, variant, lists_of(unit)[variant], name, said)


def legal_name(text: str, longest: int = 50) -> str:
    """A text as a name of C, which begins with a letter and has at most so many characters."""
    name = re.sub(r"\W", "_", ascii_text(text), flags=re.ASCII)
    name = name if name[:1].isalpha() else f"c_{name}"
    if len(name) > longest:
        digest = hashlib.sha256(text.encode()).hexdigest()[:6]
        name = f"{name[: longest - 7]}_{digest}"
    return name


def meaning_of(port: Any) -> str:
    """What a port is, with what its unit is a value of, in ASCII."""
    extra = port.unit.removeprefix(re.sub(r" (phase rms|rms|peak|\(rms\))$", "", port.unit)).strip()
    return ascii_text(f"{port.meaning} ({extra})" if extra else port.meaning)


def sources_of(unit: Unit, builder: Builder) -> dict[str, str]:
    """The exported C of a controller, without the self-test; rendered once for each ``builder``."""
    texts = builder.texts(unit)
    return {name: text for name, text in texts.items() if name.endswith((".c", ".h")) and "selftest" not in name}


_OF_FILE = re.compile(r"^static (?:inline )?(?:const )?\w+ \*?(vsg_\w+)", re.MULTILINE)


def in_one_file(sources: Mapping[str, str], folder: str = "") -> str:
    """Lines that include every C file of an export into one: what two of them call alike is told apart."""
    names = [name for name in sorted(sources) if name.endswith(".c")]
    own = {name: set(_OF_FILE.findall(sources[name])) for name in names}
    headers = {name for text in sources.values() for name in _OF_FILE.findall(text)}
    shared = {word for word in headers if sum(word in words for words in own.values()) > 1}
    of_header = {name: set(_OF_FILE.findall(text)) for name, text in sources.items() if name.endswith(".h")}
    twice = {word for word in headers if sum(word in words for words in of_header.values()) > 1}
    for header, words in of_header.items():
        users = [name for name in names if f'#include "{header}"' in sources[name]]
        if len(users) == 1:
            own[users[0]] |= words & twice
    shared |= {
        word
        for words in own.values()
        for word in words
        if any(word in _OF_FILE.findall(text) for name, text in sources.items() if name.endswith(".h"))
    }
    lines = []
    for k, name in enumerate(names):
        told = sorted(own[name] & shared)
        lines += [f"#define {word} {word}_{k}" for word in told]
        lines += [f'#include "{folder}{name}"']
        lines += [f"#undef {word}" for word in told]
    return "\n".join(lines)


def made_for(one: Wrapped) -> dict[str, Any]:
    """What the record of a wrapper says of its origin."""
    unit, origin = one.unit, one.unit.origin
    return {
        "schema": SCHEMA,
        "study": {"name": origin.study, "hash": origin.study_hash},
        "controller": unit.controller,
        "variant": one.variant,
        "name": one.name,
        "table": {"name": origin.table, "sha256": origin.table_sha256, "certificate": origin.certificate},
        "generator": {"vsgdesign": __version__},
        "sha256_of_controller": unit_hash(unit, lists_of(unit)),
        "T_s": unit.T_s,
        "delay_samples": unit.delay_samples,
        "notes": list(unit.notes),
        "ports": one.ports.document()["ports"],
    }


def write_wrapper(
    kind: str,
    one: Wrapped,
    out: str | Path,
    files: Mapping[str, str | bytes],
    *,
    inputs: Iterable[str | Path] = (),
    more: Mapping[str, Any] | None = None,
    said: Sequence[str] = (),
) -> Exported:
    """Writes the files of a wrapper into a folder, with a record of them. Raises ArtifactError."""
    out, verb = Path(out), f"vsgdesign export {kind}"
    with staged_folder(out, verb, inputs=tuple(inputs), record=MANIFEST) as folder:
        for name, content in files.items():
            place = folder / name
            place.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, str):
                write_text(place, content)
            else:
                place.write_bytes(content)
        manifest = write_record(folder, plain(made_for(one) | dict(more or {})), verb, MANIFEST)
    return Exported(out, manifest, (*one.said, *said))


def check_target(kind: str, out: str | Path, inputs: Iterable[str | Path]) -> None:
    """Refuses a folder that may not be replaced, before the work. Raises ArtifactError."""
    check_folder_target(Path(out), f"vsgdesign export {kind}", tuple(inputs), MANIFEST)


@contextlib.contextmanager
def begun(
    kind: str,
    unit: Unit,
    out: str | Path,
    variant: str,
    inputs: tuple[str | Path, ...],
    builder: Builder | None,
    *,
    longest: int = 50,
) -> Iterator[tuple[Wrapped, Builder]]:
    """The variant of a controller and what compiles it: ``builder``, or one that ends with the block.

    Raises ArtifactError before the work: a folder with other files, an unknown variant.
    """
    check_target(kind, out, inputs)
    one = wrapped(unit, variant, longest=longest)
    with Builder() if builder is None else contextlib.nullcontext(builder) as used:
        yield one, used


class Builder:
    """Compiles wrappers around exported controllers, each controller once for each compiler. ``defined``: what every
    file is compiled with."""

    def __init__(self, optimise: str = "-O2", defined: Sequence[str] = DOUBLE) -> None:
        self._flags = [optimise, *defined]
        self._folder = tempfile.TemporaryDirectory(prefix="vsg")
        self._objects: dict[tuple[str, str], list[str]] = {}
        self._texts: dict[str, dict[str, str]] = {}

    def __enter__(self) -> Builder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._folder.cleanup()

    def texts(self, unit: Unit) -> dict[str, str]:
        """The exported C of a controller, by the names of the files."""
        key = unit_hash(unit, lists_of(unit))
        if key not in self._texts:
            self._texts[key] = render_unit(unit)
        return self._texts[key]

    def library(
        self, unit: Unit, sources: Mapping[str, str], compiler: str, exports: str, flags: Sequence[str] = ()
    ) -> bytes | None:
        """A shared library of a controller with further files; None where the compiler is not installed.

        ``exports`` is a pattern of the names that are seen outside: two controllers in one process must not find each
        other's. Raises ArtifactError with the message of a compiler that fails.
        """
        if shutil.which(compiler) is None:
            return None
        texts = self.texts(unit)
        folder = self._place(texts)
        key = (str(folder), compiler)
        if key not in self._objects:
            names = [name for name in texts if name.endswith(".c") and name != "vsg_selftest.c"]
            self._objects[key] = _compiled(compiler, folder, names, self._flags, folder)
        own = Path(tempfile.mkdtemp(dir=self._folder.name))
        for name, text in sources.items():
            (own / name).write_text(text, encoding="utf-8")
        made = _compiled(
            compiler, own, [n for n in sources if n.endswith(".c")], [*self._flags, f"-I{folder}", *flags], own
        )
        out = own / "library.bin"
        seen = own / "exports.map"
        seen.write_text(f"{{ global: {exports}; local: *; }};\n", encoding="ascii")
        end = ["-static-libgcc"] if "mingw" in compiler else [f"-Wl,--version-script={seen}", "-lm"]
        run_compiler([compiler, "-shared", "-s", *made, *self._objects[key], "-o", str(out), *end])
        return out.read_bytes()

    def libraries(
        self, one: Wrapped, sources: Mapping[str, str], places: Mapping[str, str], exports: str
    ) -> tuple[dict[str, bytes], list[str]]:
        """The libraries by their places, which ``places`` has by compiler, and what is to be said of compilers that are
        not installed."""
        made = {compiler: self.library(one.unit, sources, compiler, exports) for compiler in places}
        there = {places[compiler].format(name=one.name): code for compiler, code in made.items() if code is not None}
        return there, [NOT_COMPILED[compiler] for compiler, code in made.items() if code is None]

    def _place(self, texts: Mapping[str, str]) -> Path:
        digest = hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()[:16]
        folder = Path(self._folder.name) / digest
        if not folder.is_dir():
            folder.mkdir()
            for name, text in texts.items():
                (folder / name).write_text(text, encoding="utf-8")
        return folder


def _compiled(compiler: str, folder: Path, names: Sequence[str], flags: Sequence[str], out: Path) -> list[str]:
    """Objects of C files, several at a time."""
    position = {LINUX: ["-fPIC"], WINDOWS_32: ["-msse2", "-mfpmath=sse"]}.get(compiler, [])
    made = [str(out / f"{name}.{compiler}.o") for name in names]
    commands = [
        [compiler, *FLAGS, *position, *flags, f"-I{folder}", "-c", str(folder / name), "-o", place]
        for name, place in zip(names, made, strict=True)
    ]
    with ThreadPoolExecutor(max_workers=max(os.cpu_count() or 1, 1)) as pool:
        list(pool.map(run_compiler, commands))
    return made
