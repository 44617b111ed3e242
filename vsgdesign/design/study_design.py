"""What is known of a study's controllers before a simulation: power flow, and closed forms and tables on its grids."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.design.closed_form import ClosedFormDesign, design_closed_form, distinct_grids
from vsgdesign.design.power_flow import PowerFlow, power_flow
from vsgdesign.study.parameters.study import Study


@dataclass(frozen=True)
class StudyDesign:
    """What is known of a study's controllers before a simulation."""

    study: Study
    ready: Ready
    """The gain tables that are there."""
    flows: tuple[PowerFlow, ...]
    designs: tuple[ClosedFormDesign, ...]
    """Of every controller that has gains, on every grid of the scenario."""
    missing: tuple[str, ...]
    """One sentence on each controller whose gain table is not there."""

    def document(self) -> dict[str, Any]:
        """Everything, in JSON's types."""
        return {
            "study": self.study.name,
            "hash": self.study.hash,
            "power_flow": [flow.document() for flow in self.flows],
            "designs": [
                asdict(d) | {"gains": d.gains.named(), "inertia_s": d.inertia_s, "droop_W_per_Hz": d.droop_W_per_Hz}
                for d in self.designs
            ],
            "missing": list(self.missing),
        }


def design_study(study: Study) -> StudyDesign:
    """The power flow of every controller, and its gains on every grid of the scenario. Raises InfeasibleStudyError."""
    ready = Ready(tables=read_tables(study))
    known = [spec for spec in study.controllers if spec.schedule != "table" or spec.name in ready.tables]
    missing = [
        f"{spec.name}: its gain table is not built yet. vsgdesign run builds it, vsgdesign table build keeps it."
        for spec in study.controllers
        if spec not in known
    ]
    if study.dc is not None and study.dc.droops:
        missing.append(
            "A droop of the link's voltage has no closed form: the gains are made as for an ideal link. margins and "
            "simulate have this voltage as a state."
        )
    flows = [power_flow(study, spec, ready) for spec in study.controllers]
    designs = [design_closed_form(study, spec, grid, ready) for spec in known for grid in distinct_grids(study)]
    return StudyDesign(study, ready, tuple(flows), tuple(designs), tuple(missing))
