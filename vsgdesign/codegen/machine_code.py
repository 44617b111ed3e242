"""From LLVM's text to a function in this process. This module alone imports llvmlite."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsgdesign.codegen.kept_code import user_store


@dataclass(frozen=True)
class Target:
    """What machine code is made for: all that the printer and LLVM must know of it."""

    name: str
    cpu: str
    features: str = ""
    """As LLVM takes them: ``+simd128``."""
    lanes: int = 2
    """Numbers in a vector register."""
    needed: tuple[str, ...] = ()
    """What a processor must have to run it in this process."""
    triple: str = ""
    """Of another host; empty for this process."""


AVX512 = Target("avx512", "x86-64-v4", lanes=8, needed=("avx512f", "avx512dq", "avx512vl", "avx512bw", "avx512cd"))
AVX2 = Target("avx2", "x86-64-v3", lanes=4, needed=("avx2", "fma"))
SSE2 = Target("sse2", "x86-64")
WASM = Target("wasm", "generic", "+simd128", triple="wasm32-unknown-unknown")
"""WebAssembly with vectors: :func:`object_of` and :func:`assembly` make it."""

TARGETS = {target.name: target for target in (AVX512, AVX2, SSE2, WASM)}
"""The targets by name, the best of this process first."""

_lock = threading.Lock()
_engines: dict[tuple[str, str, str, bool], tuple[Any, int]] = {}
"""Compiled texts stay for as long as the process: a function's address is worth nothing without its engine."""


@dataclass(frozen=True)
class Host:
    """The processor of this machine."""

    cpu: str
    features: frozenset[str]
    x86: bool


@functools.cache
def host() -> Host:
    """The processor, as LLVM knows it."""
    from llvmlite import binding

    _start()
    found = binding.get_host_cpu_features()
    machine = binding.get_process_triple().split("-")[0]
    return Host(
        binding.get_host_cpu_name(),
        frozenset(name for name, there in found.items() if there),
        machine in ("x86_64", "amd64", "i686"),
    )


def target_named(name: str = "native") -> Target:
    """The target of a name; ``native`` is the best that this process can run, ``other`` where it is not an x86.

    Raises ValueError for an unknown name.
    """
    here = host()
    if name in TARGETS:
        return TARGETS[name]
    if name != "native":
        raise ValueError(f"target = {name!r}: give one of {', '.join(('native', *TARGETS))}.")
    if not here.x86:
        return Target("other", here.cpu, ",".join(f"+{feature}" for feature in sorted(here.features)))
    return next(one for one in TARGETS.values() if here.features.issuperset(one.needed))


def instruction_set(target: str = "native") -> str:
    """avx512, avx2, sse2 or other. Raises ValueError for a target that this process cannot run."""
    found, here = target_named(target), host()
    missing = [name for name in found.needed if name not in here.features]
    if found.triple or missing or (found.name in TARGETS and not here.x86):
        what = f"it lacks {', '.join(missing)}" if here.x86 and missing else "it is another machine"
        raise ValueError(f"target = {target!r}: this processor cannot run it, for {what}. Give native.")
    return found.name


def compiled(text: str, name: str, target: str = "native", quickly: bool = False) -> int:
    """The address of function ``name`` in a module of LLVM's text. The same text is compiled once a process.

    ``quickly``: for what runs rarely. Compiling takes a fifth of the time, and a run five times as long.
    """
    key = hashlib.sha256(text.encode()).hexdigest(), name, instruction_set(target), quickly
    with _lock:
        if key not in _engines:
            engine = _build(text, target, quickly)
            _engines[key] = engine, engine.get_function_address(name)
        return _engines[key][1]


def assembly(text: str, target: str = "native") -> str:
    """A target's instructions of a module, to be read or given to its own assembler."""
    module, machine = _parsed(text, target)
    return machine.emit_assembly(module)


def object_of(texts: Sequence[str], target: str, rare: Sequence[str] = ()) -> tuple[bytes, list[str]]:
    """The object file of modules of LLVM's text that belong together, and the names of its functions in their order.
    What is internal to a module may have the name of what is internal to another one. Those of ``rare`` are called
    rarely: they are compiled in less time, and are slower."""
    from llvmlite import binding

    # The object is made without effort: a host compiles it once more and gives out its registers itself.
    machine = _machine(target, 0)
    whole = binding.parse_assembly("")
    for text in texts:
        whole.link_in(_verified(text))
    # LLVM's passes pay for the same reason: a fifth faster in V8. Nothing is put side by side that the text does not
    # put there.
    tuning = binding.create_pipeline_tuning_options(speed_level=1)
    tuning.loop_vectorization = tuning.slp_vectorization = False
    passes = binding.create_pass_builder(machine, tuning)
    if texts:
        passes.getModulePassManager().run(whole, passes)
    for text in rare:
        whole.link_in(_verified(text))
    return machine.emit_object(whole), [one.name for one in whole.functions if not one.is_declaration]


@functools.cache
def _start() -> None:
    from llvmlite import binding

    with contextlib.suppress(RuntimeError):  # newer releases start by themselves
        binding.initialize()
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()


def _parsed(text: str, target: str, effort: int = 2) -> tuple[Any, Any]:
    machine = _machine(target, effort)
    return _verified(text), machine


def _machine(target: str, effort: int) -> Any:
    from llvmlite import binding

    _start()
    # Of an x86 its instruction set alone counts, not its make: then every machine that has it gives the same bits.
    wanted = target_named(target)
    if wanted.triple:
        binding.initialize_all_targets()
        binding.initialize_all_asmprinters()
        kind = binding.Target.from_triple(wanted.triple)
    else:
        kind = binding.Target.from_default_triple()
    return kind.create_target_machine(cpu=wanted.cpu, features=wanted.features, opt=effort, jit=not wanted.triple)


def _verified(text: str) -> Any:
    from llvmlite import binding

    module = binding.parse_assembly(text)
    module.verify()
    return module


def _build(text: str, target: str, quickly: bool) -> Any:
    from llvmlite import binding

    effort = 0 if quickly else 2
    # The object has the functions; the module is there because an engine needs one.
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), _machine(target, effort))
    engine.add_object_file(binding.ObjectFileRef.from_data(_object(text, target, effort)))
    engine.finalize_object()
    return engine


def _object(text: str, target: str, effort: int) -> bytes:
    """The object of a module for this process: that of an earlier process where text, target and compiler are the
    same."""
    kept = user_store()
    key = hashlib.sha256(b"\0".join((_maker(), repr((target_named(target), effort)).encode(), text.encode())))
    found = None if kept is None else kept.get(key.hexdigest())
    if found is None:
        # LLVM's passes over the text are left out: they move what is loaded in a sample out of the loop, where there
        # are not enough registers for it (measured: a fifth slower, and twice the time to compile).
        module, machine = _parsed(text, target, effort)
        found = machine.emit_object(module)
        if kept is not None:
            kept.put(key.hexdigest(), found)
    return found


@functools.cache
def _maker() -> bytes:
    """What makes machine code, besides its text: this module, LLVM and the system."""
    import llvmlite
    from llvmlite import binding

    of = llvmlite.__version__, binding.llvm_version_info, binding.get_process_triple()
    return hashlib.sha256(Path(__file__).read_bytes()).digest() + repr(of).encode()
