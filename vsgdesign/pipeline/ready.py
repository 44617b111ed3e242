"""The gain tables and the network that a study needs. They are read from files or made."""

from __future__ import annotations

from pathlib import Path

from vsgdesign.artifacts.ready import Ready
from vsgdesign.execution.progress import Progress
from vsgdesign.parameters.study import Study
from vsgdesign.pipeline.table import make_tables
from vsgdesign.pipeline.training import make_network


def make_ready(
    study: Study,
    out: str | Path | None = None,
    *,
    bridge: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Ready:
    """The gain tables and the network that a study's controllers ask for.

    Whatever the study names as a file is read. A table without a file is designed to the specification, and a network
    without a file is trained on windows with the ``bridge`` of the run (None means that of the study). ``out``,
    ``workers`` and errors are those of :func:`vsgdesign.pipeline.table.make_tables` and
    :func:`vsgdesign.pipeline.training.make_network`.
    """
    tables = make_tables(study, out, workers=workers, progress=progress)
    return Ready(tables=tables, network=make_network(study, bridge=bridge, progress=progress)[0])
