"""A machine without a C compiler is told so by a failure, not by a skip."""

from __future__ import annotations

import re

import pytest

from tests.compilers import require_compiler


def test_no_compiler_is_a_failure_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(pytest.fail.Exception, match=re.escape("Install a C compiler (Debian: apt-get install gcc")):
        require_compiler()
