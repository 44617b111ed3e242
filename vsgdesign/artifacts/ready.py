"""The tables and the network that were designed, read or trained for a study. The study itself holds only its
inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.gain_table import GainTable, base_differences, base_of
from vsgdesign.artifacts.gain_table_file import read_table_file
from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.errors import ArtifactError, InfeasibleStudyError

if TYPE_CHECKING:  # reading a table reads no study files
    from vsgdesign.study.parameters.study import ControllerSpec, Study


@dataclass(frozen=True, kw_only=True)
class Ready:
    """The gain tables and the network that a study's controllers run with.

    :func:`vsgdesign.verbs.pipeline.making.make_ready` reads what the study names as files, and designs and trains what
    it leaves open. A study whose controllers are all fixed, or scheduled in closed form from the
    true grid, needs nothing of it (:data:`NOTHING`).
    """

    tables: Mapping[str, GainTable] = field(default_factory=dict)
    """Gain tables by the name of their controller."""
    network: NetworkWeights | None = None
    """The network of every controller with ``estimate = "neural"``."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "tables", MappingProxyType(dict(self.tables)))

    def __reduce__(self) -> tuple[Callable[..., Ready], tuple[Any, ...]]:
        """As it goes to other processes, which take no read-only mapping."""
        return _ready, (dict(self.tables), self.network)

    def with_table(self, controller: str, table: GainTable) -> Ready:
        """The same with the gain table of one controller, by its name."""
        return replace(self, tables={**self.tables, controller: table})

    def table(self, spec: ControllerSpec) -> GainTable | None:
        """The controller's gain table, or None if its gains do not come from a table.

        Raises InfeasibleStudyError if it needs a table that is missing.
        """
        if spec.schedule != "table":
            return None
        if spec.name not in self.tables:
            raise InfeasibleStudyError(
                f"controller {spec.name}: its gain table is missing. vsgdesign run builds it; vsgdesign table build "
                'writes it to a file, and table = "FILE.json" in the study uses it. In Python, make_ready(study) '
                "builds or reads it; pass its result on as ready."
            )
        return self.tables[spec.name]

    def network_of(self, spec: ControllerSpec) -> NetworkWeights:
        """The network of a controller's estimator. Raises InfeasibleStudyError if it is missing."""
        if self.network is None:
            raise InfeasibleStudyError(
                f"controller {spec.name}: the network of its estimator is missing. vsgdesign run trains it; "
                'vsgdesign estimator train writes it to a file, and weights = "FILE.json" in [estimator] uses it. In '
                "Python, make_ready(study) trains or reads it; pass its result on as ready."
            )
        return self.network

    def update_period(self, spec: ControllerSpec) -> float | None:
        """Time between two updates of a controller, s. The window of its network sets it where the study does not; None
        while that network is not here."""
        if spec.update_period is not None or self.network is None:
            return spec.update_period
        return self.network.window.period


def _ready(tables: dict[str, GainTable], network: NetworkWeights | None) -> Ready:
    return Ready(tables=tables, network=network)


NOTHING = Ready()
"""For a study whose controllers need no table and no network."""


def read_tables(study: Study) -> dict[str, GainTable]:
    """The gain tables that a study names as files, by controller. Raises as :func:`read_named_table`."""
    found = ((spec.name, read_named_table(study, spec)) for spec in study.controllers)
    return {name: table for name, table in found if table is not None}


def read_named_table(study: Study, spec: ControllerSpec) -> GainTable | None:
    """The gain table that a controller names as a file; None where it names none.

    Raises ArtifactError for a file that is damaged, or is no table for the study's converter, filter and grid voltage.
    """
    if spec.schedule != "table" or spec.table_file is None:
        return None
    table = read_table_file(spec.table_file)
    differences = base_differences(table.base, base_of(study, table.base.scr_basis), "the study")
    if differences:
        raise ArtifactError(
            f'controller {spec.name}: "{spec.table_file}" is a table of study {table.study}, made for another '
            f"converter, filter or grid voltage ({'; '.join(differences)}). Build one for this study: vsgdesign table "
            "build."
        )
    return table
