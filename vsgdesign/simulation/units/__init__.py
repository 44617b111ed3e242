"""Plants of several converters in the one EMT loop: from instant to instant, exact in between (:eq:`plant-gap`)."""

from vsgdesign.simulation.units.run import InverterRun, PlantRun, UnitRun, simulate_plant
from vsgdesign.simulation.units.timeline import PlantTimeline, plant_timeline

__all__ = ["InverterRun", "PlantRun", "PlantTimeline", "UnitRun", "plant_timeline", "simulate_plant"]
