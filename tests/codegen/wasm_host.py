"""A host of WebAssembly: it runs a compiled loop on copies of the same arrays as :class:`Loop` in this process."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import wasmtime

from vsgdesign.codegen.llvm_loop import INTEGERS, POINTERS
from vsgdesign.codegen.loop_call import Loop, Program
from vsgdesign.codegen.loop_spec import LoopSpec
from vsgdesign.codegen.wasm import FREE, MEMORY, PAGE, wasm_module

MOVED = "rows", "rings", "log", "done"
"""Arrays into which a loop writes."""


class Host:
    """An instance of a module, with its memory."""

    def __init__(self, module: bytes) -> None:
        self._store = wasmtime.Store()
        made = wasmtime.Instance(self._store, wasmtime.Module(self._store.engine, module), [])
        self._exports: Any = made.exports(self._store)
        self.names = list(self._exports)
        self.free: int = self._exports[FREE].value(self._store)
        self._memory = self._exports[MEMORY]

    def call(self, name: str, arguments: list[int], arrays: dict[str, np.ndarray]) -> int:
        """Calls a loop with arrays in place of the addresses of this process, by the names of POINTERS. The log may
        begin before its array, as far as its argument says."""
        places, at = {}, self.free + 8 * len(arguments)
        for key, array in arrays.items():
            at = -(-at // 64) * 64
            places[key], at = at, at + array.nbytes
        missing = at - self._memory.data_len(self._store)
        if missing > 0:
            self._memory.grow(self._store, -(-missing // PAGE))
        for key, array in arrays.items():
            self._memory.write(self._store, array.tobytes(), places[key])
        given = arguments[: len(INTEGERS)]
        for key, address in zip(POINTERS, arguments[len(INTEGERS) :], strict=True):
            array = arrays.get(key)
            given.append(0 if array is None else places[key] + (address - array.ctypes.data if key == "log" else 0))
        self._memory.write(self._store, np.array(given, dtype=np.int64).tobytes(), self.free)
        done: int = self._exports[name](self._store, self.free)
        for key in (key for key in MOVED if key in arrays):
            array = arrays[key]
            moved = self._memory.read(self._store, places[key], places[key] + array.nbytes)
            array[...] = np.frombuffer(moved, array.dtype).reshape(array.shape)
        return done


class WasmLoop(Loop):
    """A loop whose calls a host of WebAssembly answers."""

    def __init__(self, spec: LoopSpec, name: str = "loop", host: Host | None = None) -> None:
        super().__init__(spec, lambda *_: 0)
        self._name, self._host = name, Host(wasm_module({name: spec})) if host is None else host

    def __call__(self, begin: int, end: int, rows: Any, uniform: Any, **given: Any) -> int:
        if given.get("program") is None:
            none, start = np.zeros(0, np.int64), np.zeros(len(rows) + 1, np.int64)
            given["program"] = Program(start, none, none, none, none, none, np.zeros(0), start[1:].copy())
        program = given.pop("program")
        numbers = {name: given.pop(name, 0) for name in ("every", "origin", "log_begin")}
        own = {"rows": rows, "uniform": uniform} | {name: array for name, array in given.items() if array is not None}
        if numbers["every"] and "log" in own:  # the slots of this call
            first = max(begin - numbers["log_begin"], 0) // numbers["every"]
            own["log"] = own["log"][:, first : max(end - 1 - numbers["log_begin"], 0) // numbers["every"] + 1]
            numbers["log_begin"] += first * numbers["every"]
        whole = {name: np.ascontiguousarray(array) for name, array in own.items()}
        arguments = self._arguments(begin, end, *_in_order(whole), program=program, **numbers)
        if begin == end or not len(rows):
            return 0
        done = self._host.call(self._name, arguments, whole | {name: getattr(program, name) for name in POINTERS[-8:]})
        for name in (name for name in MOVED if name in own):
            own[name][...] = whole[name]
        return done

    def standing(self, rows: Any, uniform: Any, **given: Any) -> Any:
        """The same loop over arrays that stay where they are."""

        def advance(begin: int, end: int, fed: Any = None, groups: int | None = None) -> int:
            own = dict(given)
            if groups is not None and groups < len(rows):
                program = given.get("program")
                own |= {name: given[name][:groups] for name in ("rings", "ring_length", "log") if name in given}
                if program is not None:
                    own["program"] = replace(program, first=program.first[: groups + 1], done=program.done[:groups])
            return self(begin, end, rows[:groups], uniform, fed=None if fed is None else fed[:groups], **own)

        return advance


def _in_order(given: dict[str, Any]) -> list[Any]:
    names = "rows", "uniform", "cyclic", "cycle", "fed", "rings", "ring_length", "log"
    return [given.get(name) for name in names]


@cache
def wasm_loop(spec: LoopSpec, *_: object, **__: object) -> WasmLoop:
    """As :func:`vsgdesign.codegen.llvm.compiled_loop`, for WebAssembly."""
    return WasmLoop(spec)
