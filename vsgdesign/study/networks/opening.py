"""A network from its file: which library reads it, and what is said where this library is missing."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from vsgdesign.errors import Fault, InfeasibleStudyError, StudyError
from vsgdesign.study.networks.model import Network


def read_network(path: str | Path) -> Network:
    """The network of a file of pandapower (``.json``), or of anything that pypowsybl reads.

    Raises StudyError for a file that is not there or cannot be read, and InfeasibleStudyError where the library is
    missing.
    """
    path = Path(path)
    if not path.exists():
        raise StudyError(str(path), [Fault("network", "", "no such file", "Give the file of a network.")])
    if path.suffix.lower() == ".json":
        _require("pandapower", path)
        from vsgdesign.study.networks.pandapower_file import read_pandapower

        return read_pandapower(path)
    _require("pypowsybl", path)
    from vsgdesign.study.networks.powsybl_file import read_powsybl

    return read_powsybl(path)


def _require(library: str, path: Path) -> None:
    if importlib.util.find_spec(library) is None:
        raise InfeasibleStudyError(
            f'"{path}" is read by {library}, which is not installed: pip install "vsgdesign[networks]" brings it.'
        )
