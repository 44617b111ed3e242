"""Comments of the generated C, at the lengths where one line becomes two."""

from __future__ import annotations

import pytest

from vsgdesign.codegen.described import WIDTH, block_comment


@pytest.mark.parametrize("indent", ["", "    "])
def test_a_comment_of_any_length_is_closed_and_within_the_width(indent: str):
    for length in range(WIDTH - 16, WIDTH + 4):
        text = ("word " * WIDTH)[: length - 1] + "x"
        lines = block_comment(text, indent)
        assert max(map(len, lines)) <= WIDTH
        assert lines[0].startswith(f"{indent}/* ")
        assert lines[-1].endswith("*/")
        assert " ".join(" ".join(lines).replace("/*", "").replace("*/", "").replace("*", "").split()) == text
