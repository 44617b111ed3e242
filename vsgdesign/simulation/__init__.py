"""EMT simulation: the exact plant between sampling and switching instants, with the real controller."""

from vsgdesign.identification import Probe
from vsgdesign.simulation.feeds import gain_feed
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange, gain_changes
from vsgdesign.simulation.online import FixedGains, HeldBack, MeasuredWindow, OnlineScheduler, Recorder
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.timeline import Timeline, build_timeline

__all__ = [
    "FieldScheduler",
    "FixedGains",
    "GainChange",
    "HeldBack",
    "MeasuredWindow",
    "OnlineScheduler",
    "Probe",
    "Recorder",
    "Simulation",
    "Timeline",
    "build_timeline",
    "gain_changes",
    "gain_feed",
    "simulate",
]
