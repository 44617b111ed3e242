"""Kinds of something by their names, to which a program may add its own: structures, events, inverters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Generic, Protocol, TypeVar

from vsgdesign.errors import UnknownNameError


class Named(Protocol):
    """What has a name."""

    @property
    def name(self) -> str: ...


Kind = TypeVar("Kind", bound=Named)


class Registry(Mapping[str, Kind], Generic[Kind]):
    """Kinds by name. Reading an unknown name raises UnknownNameError. Only :meth:`register` adds one."""

    what = "kind"
    """What they are in a sentence."""

    def __init__(self, kinds: Iterable[Kind]) -> None:
        self._by_name = {kind.name: kind for kind in kinds}
        self._first = tuple(self._by_name.values())

    def __getitem__(self, name: str) -> Kind:
        if name not in self._by_name:
            raise UnknownNameError(self.what, name, self._by_name)
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    @property
    def added(self) -> tuple[Kind, ...]:
        """The kinds that were registered later. Another process has to be told of these."""
        return tuple(kind for kind in self.values() if kind not in self._first)

    def register(self, kind: Kind) -> Callable[[], None]:
        """Makes a kind known to everything in this process that reads, designs or runs one. Returns a function that
        removes it again. Raises ValueError if another kind has its name."""
        if self._by_name.get(kind.name, kind) != kind:
            what = self.what.partition(" ")[0]
            raise ValueError(f"{self.what}: {kind.name!r} is already the name of another {what}. Choose another name.")
        self._by_name[kind.name] = kind

        def forget() -> None:
            self._by_name.pop(kind.name, None)

        return forget
