"""The compiled loop of a run, put together from the kernel, a limiter and an observer."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from vsgdesign.equations.limiters import CIRCULAR, LimiterLaw
from vsgdesign.simulation.compiling import compile_function, compiled_law, is_packaged, source_stamp
from vsgdesign.simulation.kernel import Bridge, ControllerInputs, LogRows, Moving, PlantPieces, Span, run_stretch
from vsgdesign.simulation.observing import SILENT, ObserverLaw, Watch
from vsgdesign.simulation.sensors import SensorRows

acting: LimiterLaw = CIRCULAR.law
watching: ObserverLaw = SILENT
"""They stand for the limiter and the observer in the text of the loop below; the compiled loop has those that it was
asked for."""


@functools.cache
def compiled_loop(law: LimiterLaw, observer: ObserverLaw = SILENT) -> Callable[..., Any]:
    """The compiled inner loop with a limiter and an observer, from the disk cache where its sources are the package's
    and unchanged."""
    return _with_stamp(source_stamp(*law, *observer), law, observer)  # type: ignore[arg-type]


def _with_stamp(stamp: int, law: LimiterLaw, observer: ObserverLaw) -> Callable[..., Any]:
    def loop(
        span: Span,
        moving: Moving,
        given: ControllerInputs,
        bridge: Bridge,
        plant: PlantPieces,
        sensors: SensorRows | None,
        log: LogRows,
        watch: Watch,
    ) -> Any:
        if stamp < 0:  # never: it only makes the stamp part of the cache key
            span = Span(0, 0, 0)
        return run_stretch(span, moving, given, bridge, plant, sensors, log, watch, acting, watching)

    kept = is_packaged((*law, *observer))  # type: ignore[arg-type]
    laws = {"acting": compiled_law(law), "watching": compiled_law(observer)}
    return compile_function(loop, outermost=True, cache=kept, **laws)  # type: ignore[arg-type]
