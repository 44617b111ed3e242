"""EMT simulation: the exact plant between sampling and switching instants, with the real controller."""

from vsgdesign.simulation.run import GainChange, Simulation, simulate

__all__ = ["GainChange", "Simulation", "simulate"]
