"""What feeds the dc link: one source for each name, all behind one interface."""

from __future__ import annotations

from vsgdesign.equations.dc_source_interface import DcSource
from vsgdesign.equations.dc_sources.battery import BATTERY
from vsgdesign.equations.dc_sources.converter import CONVERTER
from vsgdesign.equations.dc_sources.photovoltaic import PHOTOVOLTAIC

DC_SOURCES: dict[str, DcSource] = {source.name: source for source in (BATTERY, CONVERTER, PHOTOVOLTAIC)}
"""Every source that a study may name, besides the ideal one."""

__all__ = ["BATTERY", "CONVERTER", "DC_SOURCES", "PHOTOVOLTAIC"]
