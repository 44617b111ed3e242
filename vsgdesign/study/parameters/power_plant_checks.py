"""What a plant and the rest of its study do not have together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from vsgdesign.identification.field import PAIRS
from vsgdesign.study.parameters.network import THREE_PHASE, Fault, Network
from vsgdesign.study.parameters.power_plant import PowerPlant
from vsgdesign.study.parameters.reader import TableReader

if TYPE_CHECKING:
    from vsgdesign.study.parameters.estimator import ProbeSpec
    from vsgdesign.study.parameters.event import Event
    from vsgdesign.study.parameters.scenario import SimulationSpec


def check_estimators(root: TableReader, plant: PowerPlant, probe: ProbeSpec | None) -> None:
    """Of a plant whose units have field estimators: each needs lines of its own for its probe."""
    without = [one.name for one in plant.units if one.pair == 0]
    if without:
        problem = (
            f"there are {len(PAIRS)} pairs of lines for the probes of {len(plant.units)} units: {', '.join(without)} "
            "would have none"
        )
        advice = 'Give four units at most, plant.estimators = "common", or estimate = "truth".'
        root.fault("plant.units", len(plant.units), problem, advice)
    if probe is not None and probe.pair != 1 and not plant.common_estimate:
        advice = "Leave it out, or give pair in [[network.units]]."
        root.fault("estimator.probe.pair", probe.pair, "each unit of a plant has a pair of its own", advice)


def check_plant(
    root: TableReader,
    plant: PowerPlant,
    network: Network,
    simulation: SimulationSpec,
    events: Sequence[Event],
) -> None:
    """What a run of a plant does not have."""
    if simulation.bridge == "pwm":
        root.fault("simulation.bridge", "pwm", "the bridges of a plant are averaged", 'Give bridge = "averaged".')
    faults = [network.fault, *(event.network.fault for event in events if event.network is not None)]
    faults += [one.switched.fault for one in events if isinstance(one.switched.fault, Fault)]
    for fault in (one for one in faults if one is not None):
        if fault.at > 0.0 or fault.kind != THREE_PHASE:
            problem = "a fault of a plant is three-phase and at a node"
            root.fault("network.fault", fault.kind, problem, "Leave at and phases out.")
    for k, event in enumerate(events):
        waits = event.synchro_check is not None and event.element is None
        if waits or event.synchronised_until is not None:
            problem = "the breaker of a plant's grid does not wait"
            root.fault(f"events[{k}]", None, problem, "Give synchro_check for the breaker of a unit alone.")
        if event.over > 0.0 and event.omega_g is not None and plant.sources:
            problem = f"the frequency is that of the sources {', '.join(one.name for one in plant.sources)}, too"
            advice = "Leave over out, or take these sources out of the network."
            root.fault(f"events[{k}].over", event.over, problem, advice)
