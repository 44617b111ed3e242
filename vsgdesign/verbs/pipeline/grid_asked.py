"""What is asked of a network, from texts with units or numbers in SI, with all faults at once."""

from __future__ import annotations

from collections.abc import Mapping

from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.networks.model import Given
from vsgdesign.study.parameters.units import UnitError, parse_quantity
from vsgdesign.verbs.pipeline.grid import N_1, Asked

Quantity = float | str
Pair = tuple[Quantity | None, Quantity | None]


def asked_of(
    *,
    bus: str,
    S: Quantity,
    outages: str = N_1,
    source: Pair = (None, None),
    machine: Pair = (None, None),
    named: Mapping[str, tuple[Quantity, Quantity] | None] | None = None,
    loads: bool = False,
    frequency: Quantity | None = None,
) -> Asked:
    """Checks everything that is asked. ``source``: short-circuit power and X/R of each slack bus; ``machine``:
    sub-transient reactance in pu and X/R of each machine; ``named``: short-circuit power and X/R by name. Raises
    StudyError with every fault."""
    faults: list[Fault] = []

    def positive(field: str, value: Quantity, dimension: str) -> float:
        try:
            number = parse_quantity(value, dimension)
            if number > 0.0:
                return number
            problem = "must be positive"
        except UnitError as error:
            problem = str(error)
        faults.append(Fault(field, f'"{value}"', problem))
        return 1.0

    def pair(fields: tuple[str, str], values: Pair, dimension: str) -> tuple[float, float] | None:
        given = [value for value in values if value is not None]
        if len(given) == 1:
            missing = fields[values.index(None)]
            faults.append(Fault(missing, "", "is missing", f"Give {fields[0]} and {fields[1]} together."))
        if len(given) < 2:
            return None
        return positive(fields[0], given[0], dimension), positive(fields[1], given[1], "1")

    def of_name(name: str, told: tuple[Quantity, Quantity] | None) -> tuple[float, float] | None:
        if told is None:
            return None
        return positive(f"source {name}", told[0], "VA"), positive(f"source {name}, X/R", told[1], "1")

    asked = Asked(
        bus=bus,
        S=positive("s", S, "VA"),
        outages=outages,
        given=Given(
            source=pair(("source-s", "source-x-over-r"), source, "VA"),
            machine=pair(("machine-x", "machine-x-over-r"), machine, "1"),
            named=tuple((name, of_name(name, told)) for name, told in (named or {}).items()),
        ),
        loads=loads,
        f_n=None if frequency is None else positive("frequency", frequency, "Hz"),
    )
    if faults:
        raise StudyError("grid", faults)
    return asked
