"""A network from its file, and its impedance at a bus from its Y matrix: with everything in, with elements out, and
over frequency.

Sources are short circuits behind their impedances, converters are open, and a load is left out or an impedance. At
another frequency a reactance goes with it and a capacitance against it, and resistances stay as they are.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import Fault, InfeasibleStudyError, StudyError
from vsgdesign.study.networks.model import Branch, Network


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


Array = NDArray[np.float64]

STRONG, WEAK = 0, 1
"""Which of the two impedances of its sources a network has."""


def admittance(network: Network, *, source: int = WEAK, order: float = 1.0, loads: bool = False) -> Any:
    """The Y matrix in per unit (:eq:`network-admittance`), sparse, at ``order`` times the nominal frequency."""
    from scipy.sparse import coo_array

    rows: list[int] = []
    columns: list[int] = []
    values: list[complex] = []

    def add(i: int, j: int, y: complex) -> None:
        rows.append(i)
        columns.append(j)
        values.append(y)

    for branch in network.branches:
        (i, j), (y_ii, y_ij, y_ji, y_jj) = branch.ends, _two_port(branch, order)
        for row, column, y in ((i, i, y_ii), (i, j, y_ij), (j, i, y_ji), (j, j, y_jj)):
            add(row, column, y)
    for shunt in network.shunts:
        add(shunt.bus, shunt.bus, _shunt(shunt.y, order))
    for one in network.sources:
        if one.z is not None:
            z = one.z[source]
            add(one.bus, one.bus, 1.0 / complex(z.real, z.imag * order))
    for load in network.loads if loads else ():
        add(load.bus, load.bus, _shunt(load.s.conjugate(), order))
    n = len(network.buses)
    return coo_array((values, (rows, columns)), shape=(n, n)).tocsc()


def _two_port(branch: Branch, order: float) -> tuple[complex, complex, complex, complex]:
    y, t = 1.0 / complex(branch.r, branch.x * order), branch.ratio
    y_1, y_2 = (_shunt(one, order) for one in (branch.y_1, branch.y_2))
    return (y + y_1) / abs(t) ** 2, -y / t.conjugate(), -y / t, y + y_2


def _shunt(y: complex, order: float) -> complex:
    """g + jb at another frequency: a capacitance where b is positive, else an inductance."""
    return complex(y.real, y.imag * order if y.imag > 0.0 else y.imag / order)


def column_at(network: Network, bus: int, **what: Any) -> NDArray[np.complex128]:
    """The column of Z = Y⁻¹ of a bus in per unit, (buses,): the voltages at a current of 1 into it
    (:eq:`network-impedance`). Only buses that are connected with it may be in the network."""
    from scipy.sparse.linalg import splu

    Y = admittance(network, **what)
    injected = np.zeros(Y.shape[0], dtype=complex)
    injected[bus] = 1.0
    return splu(Y).solve(injected)


def has_capacitance(network: Network) -> bool:
    """Whether a line or a shunt of the network has a capacitance, so that there is a resonance to look for."""
    shunts = [shunt.y for shunt in network.shunts]
    return any(y.imag > 0.0 for branch in network.branches for y in (branch.y_1, branch.y_2)) or any(
        y.imag > 0.0 for y in shunts
    )


def over_frequency(network: Network, bus: int, orders: Array, **what: Any) -> NDArray[np.complex128]:
    """The impedance at a bus in per unit at multiples of the nominal frequency, (orders,)."""
    return np.array([column_at(network, bus, order=float(order), **what)[bus] for order in orders])


def first_resonance(network: Network, bus: int, orders: Array, z: NDArray[np.complex128], **what: Any) -> float | None:
    """The lowest multiple of the nominal frequency at which the reactance falls through zero, which is the parallel
    resonance of |Z|; None where there is none up to the last of ``orders``."""
    from scipy.optimize import brentq

    falls = np.flatnonzero((z.imag[:-1] > 0.0) & (z.imag[1:] <= 0.0))
    if not len(falls):
        return None
    low, high = float(orders[falls[0]]), float(orders[falls[0] + 1])
    return float(brentq(lambda order: column_at(network, bus, order=order, **what)[bus].imag, low, high, xtol=1e-9))
