"""A plant of equal units as one of them, for what knows one converter on a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.power_plant import behind_its_path, one_converter, with_fixed_gains
from vsgdesign.study.parameters.study import StudyOrigin
from vsgdesign.verbs.pipeline.study_tables import with_left_tables


def as_unit(study: Study, what: str) -> Study:
    """A plant of equal units at one node as one unit: x_t belongs to its filter, and its grids are those that it sees
    where all units on line move alike. Their differential mode is that of the same unit on a stiff node. Any other
    study is returned as it is. Raises InfeasibleStudyError for a plant with more than equal units and a grid; ``what``
    asks for it."""
    plant = study.plant
    if plant is None:
        return study
    if not plant.equal or plant.elements or plant.sources or plant.opened:
        raise InfeasibleStudyError(
            f"{what} knows equal units at one node that sample together, as [plant] describes them, with nothing but "
            "the grid there. vsgdesign simulate gives the modes of any plant."
        )
    if not study.network.plain or any(event.network is not None for event in study.events):
        raise InfeasibleStudyError(
            f"{what} knows the units of a plant and their grid alone: take load, fault and breaker out of [network] "
            "and of the events. vsgdesign simulate runs it with its modes."
        )
    return replace(plant_timeline(study).units[0], name=study.name)


def written_as_unit(study: Study, what: str) -> Study:
    """:func:`as_unit` with the document of this one converter, for what reads or writes studies of it: x_t in its
    filter, and N Z_g as its grid."""
    own, origin = as_unit(study, what), study.origin
    if study.plant is None or origin is None:
        return own
    document = _document_of_unit(own, origin)
    document.pop("verification", None)
    grid = {key: value for key, value in document["grid"].items() if key not in ("scr", "x_over_r")}
    asked = own.specification
    if asked is not None:
        seen = {"scr": list(asked.scr), "differential_decay": asked.differential_decay}
        document["specification"] = document["specification"] | seen
    document |= {
        "grid": grid | {"R_g": own.grid.R_g, "L_g": own.grid.L_g},
        "events": [event.document(own.converter) for event in own.events if event.changed or event.grid is not None],
    }
    return replace(own, origin=replace(origin, document=document))


def _document_of_unit(own: Study, origin: StudyOrigin) -> dict[str, Any]:
    """The document of a plant as that of one of its units, on the same grid and with the same events: x_t in its
    filter, and its dc link and set points."""
    document = {key: value for key, value in origin.document.items() if key not in ("plant", "network")}
    listed = origin.document.get("network", {}).get("units", [{}])  # equal units, of which the first one may have [dc]
    document |= {"dc": listed[0]["dc"]} if listed and "dc" in listed[0] else {}
    f, simulation = own.filter, {"P_ref": own.simulation.P_ref, "Q_ref": own.simulation.Q_ref}
    filter_ = {one.name: getattr(f, one.name) for one in fields(f) if one.name[-1] != "2" or f.L_2 > 0.0}
    filter_ |= {"kind": "LCL" if f.L_2 > 0.0 else "LC"}
    return document | {"filter": filter_, "simulation": document["simulation"] | simulation}


def with_tables_left(study: Study, say: Callable[[str], None] | None = None) -> Study:
    """A study with the gain tables of the same design that an earlier command has left below ``out``; those of a plant
    of equal units are made for one of them. Any other plant is returned as it is."""
    if study.plant is None:
        return with_left_tables(study, say=say)
    if not study.plant.equal:
        return study
    own = with_left_tables(replace(plant_timeline(study).units[0], name=study.name), say=say)
    return replace(study, controllers=own.controllers)


def alone(study: Study, what: str) -> Study:
    """A study for ``what``, which knows one converter on a grid. Raises InfeasibleStudyError for any other plant than
    :func:`as_one_converter`."""
    found = as_one_converter(study)
    one_converter(found, what)
    return found


def as_one_converter(study: Study) -> Study:
    """A plant of one unit with nothing but the grid at its node as one converter, with x_t in its filter and in its
    document; any other study as it is."""
    plant = study.plant
    if plant is None or len(plant.units) != 1 or plant.elements or plant.sources or plant.opened:
        return study
    if plant.inverters:
        return study
    unit = plant.units[0]
    if unit.case is not None or unit.offset or any(event.element is not None for event in study.events):
        return study
    if not study.network.plain or any(event.network is not None for event in study.events):
        return study  # load, fault and breaker are behind x_t

    simulation = replace(study.simulation, P_ref=unit.P_ref, Q_ref=unit.Q_ref)
    own = with_fixed_gains(replace(behind_its_path(study, unit), plant=None, simulation=simulation))
    if study.origin is None:
        return own
    return replace(own, origin=replace(study.origin, document=_document_of_unit(own, study.origin)))
