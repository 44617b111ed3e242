"""From LLVM's text to a function in this process. This module alone imports llvmlite."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import threading
from dataclasses import dataclass
from typing import Any

TARGETS = ("native", "avx512", "avx2", "sse2")
_CPUS = {"avx512": "x86-64-v4", "avx2": "x86-64-v3", "sse2": "x86-64"}
_NEEDED = {"avx512": ("avx512f", "avx512dq", "avx512vl", "avx512bw", "avx512cd"), "avx2": ("avx2", "fma"), "sse2": ()}

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


def instruction_set(target: str = "native") -> str:
    """avx512, avx2 or sse2; ``native`` is the best that this processor has. ``other`` where it is not an x86."""
    if target not in TARGETS:
        raise ValueError(f"target = {target!r}: give one of {', '.join(TARGETS)}.")
    here = host()
    if target == "native":
        if not here.x86:
            return "other"
        return next(name for name in ("avx512", "avx2", "sse2") if here.features.issuperset(_NEEDED[name]))
    missing = [name for name in _NEEDED[target] if name not in here.features]
    if missing or not here.x86:
        what = f"it lacks {', '.join(missing)}" if here.x86 else "it is not an x86"
        raise ValueError(f"target = {target!r}: this processor cannot run it, for {what}. Give native.")
    return target


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
    """The processor's instructions of a module, to be read."""
    module, machine = _parsed(text, target)
    return machine.emit_assembly(module)


@functools.cache
def _start() -> None:
    from llvmlite import binding

    with contextlib.suppress(RuntimeError):  # newer releases start by themselves
        binding.initialize()
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()


def _parsed(text: str, target: str, effort: int = 2) -> tuple[Any, Any]:
    from llvmlite import binding

    _start()
    # Of an x86 its instruction set alone counts, not its make: then every machine that has it gives the same bits.
    known = instruction_set(target)
    cpu, features = host().cpu, ",".join(f"+{name}" for name in sorted(host().features))
    if known in _CPUS:
        cpu, features = _CPUS[known], ""
    machine = binding.Target.from_default_triple().create_target_machine(
        cpu=cpu, features=features, opt=effort, jit=True
    )
    module = binding.parse_assembly(text)
    module.verify()
    return module, machine


def _build(text: str, target: str, quickly: bool) -> Any:
    from llvmlite import binding

    # LLVM's passes over the text are left out: they move what is loaded in a sample out of the loop, where there are
    # not enough registers for it (measured: a fifth slower, and twice the time to compile).
    engine = binding.create_mcjit_compiler(*_parsed(text, target, 0 if quickly else 2))
    engine.finalize_object()
    return engine
