"""Plants of one kind side by side in one loop, and each unit of them as a part of converters that stand alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import StandingLoop, aligned_zeros, compiled_loop
from vsgdesign.simulation.batch import Log, Numbers
from vsgdesign.simulation.circuit_program import ProgramWriter
from vsgdesign.simulation.dc_beyond import Outside
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.part import LOOK_SAMPLES, Samples, padded
from vsgdesign.simulation.loop import side_by_side, watched_names
from vsgdesign.simulation.units.body import PlantKind, body_numbers, cyclic_values, spec_of_plant
from vsgdesign.simulation.units.program import PlantProgram, cross
from vsgdesign.simulation.units.start import uniform_of
from vsgdesign.simulation.units.timeline import PlantTimeline
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_KEPT = {"limited": 1, "late": 1, "limited_at_end": 1}


class PlantPart(Numbers):
    """Plants of one kind side by side, in descending order of their ends."""

    def __init__(
        self, study: Study, kind: PlantKind, some: Sequence[PlantTimeline], ends: Samples, events: int, first: int
    ) -> None:
        """``some``: those of the plants. ``first``: from which sample on powers are logged, where they are judged."""
        kept = _KEPT | dict.fromkeys(("first", "least", "most"), events)
        kept["watch"] = len(watched_names(kind.units[0]))
        kept |= {} if kind.units[0].dc is None else {"dc_lowest": 1, "dc_highest": 1}
        kept = {f"u{k}.{name}": count for k in range(len(kind.units)) for name, count in kept.items()}
        spec = spec_of_plant(kind, side_by_side(strict=True))
        super().__init__(spec, len(some), kept)
        self.study, self.kind, self.ends = study, kind, ends
        self.units: tuple[UnitOfPart, ...] = ()
        self.rings: Array | None = None
        self._loop = compiled_loop(spec)
        self._uniform = uniform_of(some[0], kind.units, [None] * len(kind.units), spec.uniform)
        self.writer = ProgramWriter()
        self._standing: dict[bool, StandingLoop] = {}
        self.cuts: dict[int, list[tuple[int, PlantProgram, tuple[Study, ...]]]] = {}
        """Of switched bridges: the plants in whose gaps before a sample events fall."""
        self.log: Log | None = None
        if spec.logged:
            groups, _, width = self.rows.shape
            rows = aligned_zeros((groups, self.end - first, len(spec.logged), width))
            self.log = Log(rows, spec.logged, begin=first)

    @property
    def end(self) -> int:
        """The sample up to which it has to run: one beyond its last, so that what is kept at an end is kept."""
        return int(self.ends[0]) + 1

    def at(self, lane: int) -> Any:
        """The numbers of one plant by their names."""
        return lambda name: self.view(name, lane)

    def run(self, begin: int, end: int) -> None:
        """Runs the samples from ``begin`` up to before ``end`` of every group that is not over."""
        if not self._standing:
            self._prepare()
        active, end = -(-int((self.ends + 1 > begin).sum()) // self.spec.width), min(end, self.end)
        logs = [] if self.log is None else [self.log.begin]
        looks = range(begin, end, LOOK_SAMPLES) if self.study.dc is not None else ()
        marks = sorted({begin, end, *looks, *(one for one in (*self.cuts, *logs) if begin < one < end)})
        for first, after in itertools.pairwise(marks) if active and end > begin else ():
            for lane, program, units in self.cuts.get(first, ()):
                cross(self.at(lane), self.kind, program, units, first)
            self._standing[bool(logs) and first >= logs[0]](first, after, None, active)
            for unit in self.units:
                unit.look()

    def _prepare(self) -> None:
        """The loops, without and with a log."""
        given: dict[str, Any] = {"program": self.writer.program(len(self.rows), self.spec.width)}
        if self.rings is not None:
            given |= {"rings": self.rings, "ring_length": self._ring_length}
        if self.kind.gaps:
            given |= {"cyclic": cyclic_values(self.kind), "cycle": np.array(body_numbers(self.kind), dtype=np.int64)}
        self._standing[False] = self._loop.standing(self.rows, self._uniform, **given)
        if self.log is not None:
            given |= {"log": self.log.rows, "every": 1, "log_begin": self.log.begin}
            self._standing[True] = self._loop.standing(self.rows, self._uniform, **given)

    def ring(self, cycle: int, present: Sequence[dict[str, Array]]) -> None:
        """What is read again a cycle later. ``present``: of each unit, by name."""
        groups, _, width = self.rows.shape
        names = [name for name, _ in self.spec.rings]
        if not names:
            return
        self.rings = aligned_zeros((groups, cycle, len(names), width))
        self._ring_length = np.full(groups, cycle, dtype=np.int64)
        for at, name in enumerate(names):
            unit, _, short = name.partition(".")
            self.rings[:, :, at] = padded(present[int(unit.removeprefix("u"))][short], groups, width)[:, None]


class UnitOfPart:
    """One unit of all plants of a part, as a part of converters that stand alone."""

    beside, guarded, mains = False, False, slice(None)

    def __init__(self, part: PlantPart, k: int, cases: LaneCases, index: Index, cycle: int) -> None:
        """``cases`` (n): this unit of each plant; ``index``: their places among all units of the batch."""
        self._part, self._k, self._head = part, k, f"u{k}."
        self.study, self.cases, self.index, self.ends, self.cycle = part.study, cases, index, part.ends, cycle
        self.place = self._named(part.place)
        self.kept = self._named(part.kept)
        self.cycle_at_end = np.full(len(cases), cycle, dtype=np.int64)
        self.outside = None if part.study.dc is None else Outside(part.study, self.place, len(cases))

    def look(self) -> None:
        """Looks at the dc links of this unit."""
        if self.outside is not None:
            self.outside.look(self.get)

    def _named(self, rows: dict[str, int]) -> dict[str, int]:
        return {name.removeprefix(self._head): row for name, row in rows.items() if name.startswith(self._head)}

    def __len__(self) -> int:
        return len(self.cases)

    @property
    def end(self) -> int:
        """That of the part."""
        return self._part.end

    def span(self, name: str) -> slice:
        """The rows of a record or of a number."""
        return self._part.span(self._head + name)

    def get(self, row: int | str) -> Array:
        """A row of every plant, (n,)."""
        return self._part.get(self.place[row] if isinstance(row, str) else row)

    def put(self, row: int | str, values: Any) -> None:
        """Sets a row of every plant, (n,), or m rows that are beside each other, (m, n)."""
        self._part.put(self.span(row).start if isinstance(row, str) else row, values)

    def watched(self, name: str) -> Array:
        """What was watched up to the end of every run, (n,)."""
        return self.get(self.kept["watch"] + self.place[f"watch.{name}"] - self.span("watch").start)

    @property
    def means(self) -> Log | None:
        """Where a rest of its own is judged, the means of the powers, or their sums."""
        return self._part.log

    def logged(self, columns: slice) -> Iterator[tuple[slice, Array]]:
        """The lanes of each group, with some columns of the unit's log (S, n, W)."""
        log, width = self._part.log, self._part.spec.width
        count = 0 if log is None else len(log.names) // len(self._part.kind.units)
        own = slice(self._k * count, (self._k + 1) * count)
        for k, rows in enumerate(() if log is None else log.rows):
            lanes = slice(k * width, min((k + 1) * width, len(self)))
            yield lanes, rows[:, own][:, columns, : lanes.stop - lanes.start]

    def run(self, begin: int, end: int) -> None:
        """Runs the whole part, once for all of its units."""
        if self._k == 0:
            self._part.run(begin, end)
