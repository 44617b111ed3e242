"""Windows has not what Unix alone has: no import and no use of it without asking first."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OURS = ("vsgdesign", "bench", "evidence", "website", "studies", "packages")
MODULES = re.compile(r"\b(curses|fcntl|grp|posix|pty|pwd|readline|resource|syslog|termios|tty)\b")
NAMES = re.compile(
    r"os\.(O_(CLOEXEC|NOFOLLOW|DIRECTORY|NONBLOCK)|fork(pty)?|killpg|set(sid|pgid|pgrp|priority)|getpgid|getsid|gete?[ug]id"
    r"|mkfifo|mknod|nice|uname|wait3|wait4|fchmod|fchown|l?chown|openpty|sched_\w+|sysconf|posix_spawn|getloadavg|statvfs)"
    r"|signal\.(SIG(KILL|HUP|ALRM|USR1|USR2|STOP|CONT|QUIT|CHLD|PIPE)|alarm|setitimer|pthread_\w+|sigwait|pause)"
)
"""What the standard library documents as available on Unix alone, of the modules that Windows has."""
ASKS = re.compile(r"hasattr|os\.name|sys\.platform|ImportError")


def unguarded(tree: ast.AST) -> Iterator[str]:
    """Every import and every name of Unix alone outside of an ``if`` or a ``try`` that asks for it."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [one.name for one in node.names]
            yield from (name for name in names if MODULES.match(name))
        elif isinstance(node, ast.Attribute) and NAMES.fullmatch(ast.unparse(node)):
            yield ast.unparse(node)
        asks = node.test if isinstance(node, ast.If | ast.IfExp) else getattr(node, "handlers", None)
        text = " ".join(map(ast.unparse, asks if isinstance(asks, list) else [asks] if asks else []))
        if not ASKS.search(text):
            yield from unguarded(node)


def test_nothing_needs_unix() -> None:
    """Before: the locks of results, and the seconds of evidence/equal.py."""
    paths = [path for folder in OURS for path in (ROOT / folder).rglob("*.py")]
    assert len(paths) > 500
    texts = {path: path.read_text(encoding="utf-8") for path in paths}
    hint = re.compile(rf"{MODULES.pattern}|{NAMES.pattern}")
    found = {str(path): [*unguarded(ast.parse(text))] for path, text in texts.items() if hint.search(text)}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("import fcntl", ["fcntl"]),
        ("def f():\n    from resource import getrusage", ["resource"]),
        ("try:\n    import fcntl\nexcept ImportError:\n    fcntl = None", []),
        ("flags = os.O_RDWR | os.O_CLOEXEC", ["os.O_CLOEXEC"]),
        ("if hasattr(os, 'nice'):\n    os.nice(5)\nos.fork()", ["os.fork"]),
        ("try:\n    signal.pthread_sigmask(0, ())\nfinally:\n    pass", ["signal.pthread_sigmask"]),
    ],
)
def test_the_search_finds_them(text: str, names: list[str]) -> None:
    assert [*unguarded(ast.parse(text))] == names
