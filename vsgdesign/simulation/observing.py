"""What may act beside the controller in every sample of the compiled loop: it adds a probe, and it listens.

As a limiter does, an observer enters the loop as a law: functions that are known when the loop is compiled. The loop of
a run without an observer is compiled with :data:`SILENT`, whose functions do nothing, so it pays nothing for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller_data import Nothing

Array = NDArray[np.float64]


class Watch(NamedTuple):
    """What an observer keeps between two calls of the loop: the numbers of its memory, in place, and its constants."""

    memory: Any
    constants: Any


class Sent(NamedTuple):
    """A probe as it is sent in one sample: what it adds to V (rms V) and to θ (rad), and its d and q components,
    relative to the rated voltage."""

    V: Any
    theta: Any
    d: Any
    q: Any


class ObserverLaw(NamedTuple):
    """The functions of an observer.

    ``begin(watch)`` gives its memory and its constants at the beginning of a call of the loop, ``keep(watch, memory)``
    puts the memory back at its end. In every sample ``probe(memory, V, constants)`` gives what is :class:`Sent`; V is
    the voltage integrator (rms V). After the controller's sample, ``listen(memory, measured, theta, sent, limited,
    constants)`` gives the next memory; θ (rad) includes what the probe added, and ``limited`` is 1 if the limiter
    acted. The loop stops after a sample for which ``closed(memory)`` is not 0.
    """

    begin: Callable[..., Any]
    probe: Callable[..., Any]
    listen: Callable[..., Any]
    closed: Callable[..., Any]
    keep: Callable[..., Any]


def _begin(watch: Watch) -> Any:  # noqa: ARG001
    return Nothing(), Nothing()


def _probe(memory: Nothing, V: Any, constants: Nothing) -> Sent:  # noqa: ARG001
    return Sent(V=0.0, theta=0.0, d=0.0, q=0.0)


def _listen(
    memory: Nothing,
    measured: Any,  # noqa: ARG001
    theta: Any,  # noqa: ARG001
    sent: Sent,  # noqa: ARG001
    limited: Any,  # noqa: ARG001
    constants: Nothing,  # noqa: ARG001
) -> Nothing:
    return memory


def _closed(memory: Nothing) -> int:  # noqa: ARG001
    return 0


def _keep(watch: Watch, memory: Nothing) -> None:
    pass


SILENT = ObserverLaw(_begin, _probe, _listen, _closed, _keep)
"""No observer."""

NO_WATCH = Watch(np.zeros(0), np.zeros(0))


def zero_record(kind: Any) -> Any:
    """A record of a NamedTuple class with zeros for its numbers. Fields that are records are found by their
    annotation."""
    hints = get_type_hints(kind)
    return kind(*(_zero(hints[name]) for name in kind._fields))


def _zero(annotation: Any) -> Any:
    if get_origin(annotation) is tuple:
        return tuple(_zero(one) for one in get_args(annotation))
    return zero_record(annotation) if hasattr(annotation, "_fields") else 0.0


def flat(record: Any) -> list[float]:
    """Every number of a record, in order, those of records inside it in their place."""
    return [x for value in record for x in (flat(value) if isinstance(value, tuple) else (float(value),))]


def pack(values: Array, record: Any) -> None:
    """Writes every number of a record into ``values`` (n,). In compiled code this is one store for each."""
    values[:] = flat(record)


def unpack(values: Array, like: Any) -> Any:
    """The record of the kind of ``like`` with the numbers of ``values`` (n,): the opposite of :func:`pack`."""
    return _filled(like, iter(values.tolist()))


def _filled(like: Any, numbers: Any) -> Any:
    parts = [_filled(value, numbers) if isinstance(value, tuple) else next(numbers) for value in like]
    return type(like)(*parts) if hasattr(like, "_fields") else tuple(parts)
