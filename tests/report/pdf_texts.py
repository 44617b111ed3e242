"""What a reader of a PDF finds in it: its objects, and the texts that can be copied out of it."""

from __future__ import annotations

import re
import zlib


def objects_of(content: bytes) -> dict[int, bytes]:
    """The objects of a file, found by its table of places; streams are unpacked."""
    begin = int(content.rsplit(b"startxref", 1)[1].split()[0])
    table = content[begin:].split(b"trailer", 1)[0].splitlines()
    assert table[0] == b"xref"
    found = {}
    for number, line in enumerate(table[3:], start=1):
        place = int(line.split()[0])
        head, body = content[place:].split(b" obj\n", 1)
        assert head == b"%d 0" % number
        body = body.split(b"\nendobj", 1)[0]
        if b"\nstream\n" in body:
            length = int(re.search(rb"/Length (\d+)", body).group(1))  # type: ignore[union-attr]
            packed = body.split(b"\nstream\n", 1)[1]
            assert packed[length:] == b"\nendstream"
            head, whole = body.split(b"\nstream\n", 1)[0], packed[:length]
            body = head + b"\n" + (zlib.decompress(whole) if b"/FlateDecode" in head else whole)
        found[number] = body
    return found


def maps_of(objects: dict[int, bytes]) -> dict[bytes, dict[int, str]]:
    """The character of each code, by the names of the fonts."""
    maps: dict[bytes, dict[int, str]] = {}
    for body in objects.values():
        for name, number in re.findall(rb"/(F\d) (\d+) 0 R", body):
            to_unicode = int(re.search(rb"/ToUnicode (\d+)", objects[int(number)]).group(1))  # type: ignore[union-attr]
            pairs = re.findall(rb"^<(\w{4})> <(\w+)>$", objects[to_unicode], re.MULTILINE)
            maps[name] = {int(code, 16): bytes.fromhex(text.decode()).decode("utf-16-be") for code, text in pairs}
    return maps


def texts_of(content: bytes) -> list[str]:
    """What a reader of the file copies out of it: the texts of all pages, by the maps from codes to characters."""
    objects = objects_of(content)
    maps, found = maps_of(objects), []
    for body in objects.values():
        font = b""
        for name, shown in re.findall(rb"/(F\d) [\d.]+ Tf|\(((?:[^\\)]|\\.)*)\) Tj", body, re.DOTALL):
            if name:
                font = name
                continue
            codes = re.sub(rb"\\(.)", lambda one: one[1].replace(b"r", b"\r"), shown, flags=re.DOTALL)
            found.append(
                "".join(maps[font].get(int.from_bytes(codes[k : k + 2]), "?") for k in range(0, len(codes), 2))
            )
    return found
