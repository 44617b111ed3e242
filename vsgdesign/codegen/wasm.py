"""Compiled loops as one WebAssembly module, for a browser or any other host that is not this process.

LLVM makes an object of the loops' text, and an object is a module whose memory and whose stack pointer are left to a
linker. Nothing else is: a loop calls no library. So the module is the object with a memory and a stack of its own and
with names for its loops; relocations and other notes for a linker are left out.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterator, Mapping, Sequence

from vsgdesign.codegen.llvm_loop import loop_text
from vsgdesign.codegen.loop_spec import LoopSpec
from vsgdesign.codegen.machine_code import object_of

MEMORY, FREE = "memory", "free"
"""Exports besides the loops: the memory, and the address from which on it is free to be used."""

STACK = 1 << 18
"""Bytes. A loop keeps there what it computes once, which is some thousand numbers at most."""

PAGE = 1 << 16
"""Bytes of a page of WebAssembly's memory."""

_IMPORT, _MEMORY, _GLOBAL, _EXPORT, _DATA = 2, 5, 6, 7, 11
_ORDER = 1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 10, 11
"""The sections by number, in the order in which a module has them: the count of data comes before the code."""
_FUNCTION_KIND, _MEMORY_KIND, _GLOBAL_KIND = 0, 2, 3
_I32, _I32_CONST, _END = 0x7F, 0x41, 0x0B
_LEFT_TO_A_LINKER = [(b"__linear_memory", _MEMORY_KIND), (b"__stack_pointer", _GLOBAL_KIND)]
_ALIGNED = 64


def wasm_module(loops: Mapping[str, LoopSpec], rare: Collection[str] = ()) -> bytes:
    """A module that imports nothing and exports every loop by its name, :data:`MEMORY` and :data:`FREE`.

    A loop takes the address of its arguments (:data:`vsgdesign.codegen.llvm_loop.INTEGERS`, then ``POINTERS``, 64 bits
    each) and returns the number of samples that it has done, as in this process. A strict loop has the same bits.
    LLVM's passes are left out for loops of ``rare``: they are made in a fifth of the time, and a sample takes an eighth
    longer.
    The last modules are kept: pages of one study mostly ask for the same one.

    Raises ValueError where a specification does not fit together, a name is taken or a loop needs a library.
    """
    bad = [name for name in loops if name in (MEMORY, FREE) or not (name.isascii() and name.isidentifier())]
    if bad or not loops:
        raise ValueError(
            f"loops = {bad}: give at least one, each with a name of letters, digits and _, but not {MEMORY} or {FREE}."
        )
    return _module(tuple(loops.items()), frozenset(rare))


@functools.lru_cache(maxsize=8)
def _module(loops: tuple[tuple[str, LoopSpec], ...], rare: frozenset[str]) -> bytes:
    often, seldom = ([loop_text(spec, name) for name, spec in loops if (name in rare) == own] for own in (False, True))
    data, functions = object_of(often, "wasm", seldom)
    return _linked(data, {name: functions.index(name) for name, _ in loops})


def _linked(data: bytes, functions: Mapping[str, int]) -> bytes:
    """The object as a module in which these functions have names."""
    sections = dict(_sections(data))
    left = _imports(sections.pop(_IMPORT, b"\0"))
    if left not in (_LEFT_TO_A_LINKER, _LEFT_TO_A_LINKER[:1]):
        names = ", ".join(name.decode() for name, _ in left)
        raise ValueError(f"a loop for WebAssembly needs {names}: no library is there. Write it in vector_math.py.")
    stack = _rounded_up(_data_end(sections.get(_DATA, b"\0")) + STACK, _ALIGNED)
    sections[_MEMORY] = _vector([b"\0" + _leb(_rounded_up(stack, PAGE) // PAGE)])
    top = bytes([_I32_CONST]) + _signed(stack) + bytes([_END])
    # Global 0 is the stack pointer, as in the object; the other one says where the stack begins and all else ends.
    sections[_GLOBAL] = _vector([bytes([_I32, 1]) + top, bytes([_I32, 0]) + top])
    exports = [(name.encode(), _FUNCTION_KIND, at) for name, at in functions.items()]
    exports += [(MEMORY.encode(), _MEMORY_KIND, 0), (FREE.encode(), _GLOBAL_KIND, 1)]
    sections[_EXPORT] = _vector([_leb(len(name)) + name + bytes([kind]) + _leb(at) for name, kind, at in exports])
    found = data[:8]
    for kind in _ORDER:
        if kind in sections:
            found += bytes([kind]) + _leb(len(sections[kind])) + sections[kind]
    return found


def _sections(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Number and content of the sections that are no notes."""
    at = 8
    while at < len(data):
        kind, (length, start) = data[at], _unleb(data, at + 1)
        if kind:
            yield kind, data[start : start + length]
        at = start + length


def _imports(section: bytes) -> list[tuple[bytes, int]]:
    """Name and kind of what is imported."""
    count, at = _unleb(section, 0)
    found = []
    for _ in range(count):
        length, start = _unleb(section, at)  # of the name of a module
        length, start = _unleb(section, start + length)
        name, at = section[start : start + length], start + length
        kind = section[at]
        found.append((name, kind))
        if kind == _MEMORY_KIND:
            at = _unleb(section, at + 2)[1]
        elif kind == _GLOBAL_KIND:
            at += 3
        else:
            break  # what follows does not matter: it is refused
    return found


def _data_end(section: bytes) -> int:
    """Where the constants of the loops end."""
    count, at = _unleb(section, 0)
    end = 0
    for _ in range(count):
        begin, at = _unleb(section, at + 2)  # behind the kind and i32.const
        length, at = _unleb(section, at + 1)
        end, at = max(end, begin + length), at + length
    return end


def _vector(items: Sequence[bytes]) -> bytes:
    return _leb(len(items)) + b"".join(items)


def _rounded_up(number: int, unit: int) -> int:
    return -(-number // unit) * unit


def _leb(number: int) -> bytes:
    """A whole number that is not negative, seven bits a byte."""
    found = b""
    while True:
        low, number = number & 0x7F, number >> 7
        found += bytes([low | (0x80 if number else 0)])
        if not number:
            return found


def _signed(number: int) -> bytes:
    """The same where the last byte says the sign."""
    found = _leb(number)
    return found if found[-1] < 0x40 else found[:-1] + bytes([found[-1] | 0x80, 0])


def _unleb(data: bytes, at: int) -> tuple[int, int]:
    """The number at a place, and the place behind it."""
    number = shift = 0
    while True:
        byte = data[at]
        number, shift, at = number | (byte & 0x7F) << shift, shift + 7, at + 1
        if byte < 0x80:
            return number, at
