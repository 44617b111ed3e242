"""Which model the verdicts are about: base values, hashes, versions, and where the model ends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from vsgdesign.report.drawing.quantities import plain, plain_quantity
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.converter import dc_link_text

Document = Mapping[str, Any]

VALIDITY = (
    "The verdicts are about a simulation of the converter and its controller, not about hardware. Each run is an EMT "
    "simulation with sampling, delay, limits and the nonlinear power loops; nothing in it is linearised.",
    "Active and reactive power are those at the filter's capacitor, as the controller measures them.",
    "The converter and the grid have three wires. There is no zero sequence, and a fault to ground has no current "
    "through the ground.",
    "The grid is one resistance and one inductance behind an ideal source, with the load and the faults that a test "
    "names. Saturation of transformers, protection relays and other converters are not there.",
    "Every number that is asked for has a source and a confidence. “read” was read in its source, “secondary” is told "
    "by another document, “ours” was chosen by this project, and “user” by the user of the suite. The last two are "
    "no requirements of a grid code.",
    "A pass says that this one test was kept from one operating point. It says nothing about tests that were not run.",
)

_MEASURED = "The power and the energy that storage would have to give are measured"
_AVERAGED = "The bridge is averaged over a sampling period: it has no switching ripple and no dead time."
_SWITCHED = "The bridge is switched ideally: it has no dead time and no voltage drop."

_FILTER = (
    ("L_1_h", "L_1", "H"), ("R_1_ohm", "R_1", "Ω"), ("C_f", "C", "F"), ("R_c_ohm", "R_c", "Ω"),
    ("L_2_h", "L_2", "H"), ("R_2_ohm", "R_2", "Ω"),
)  # fmt: skip


def validity(document: Document) -> tuple[str, ...]:
    """Sentences that say where the model ends."""
    converter = document.get("converter") or {}
    bridge, source = converter.get("bridge"), converter.get("dc_source")
    link = f"{dc_link_text(source)} {_MEASURED}{', and they limit nothing' if source is None else ''}."
    said = [{"averaged": _AVERAGED}.get(bridge, _SWITCHED)] if bridge else []
    return (*VALIDITY[:1], *said, *VALIDITY[1:3], link, *VALIDITY[3:], *document.get("notes", ()))


def identity_tables(document: Document) -> list[Table]:
    """The converter's base values, and the hashes of everything that the verdicts depend on."""
    tables = []
    if document.get("converter"):
        tables.append(Table("Converter", ("Quantity", "Value"), tuple(_converter(document["converter"])), texts=2))
    tables.append(Table("Hashes and versions", ("What", "SHA-256 or version"), tuple(_hashes(document)), texts=2))
    return tables


def _converter(c: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield "Rated power S_rated", plain_quantity(c["S_rated_va"], "VA")
    yield "Rated voltage", f"{plain_quantity(c['V_rated_ll_rms_v'], 'V')} line to line, rms"
    yield "Nominal frequency", f"{plain(c['f_n_hz'])} Hz"
    yield "Base impedance Z_base", plain_quantity(c["Z_base_ohm"], "Ω")
    yield "Rated current", f"{plain_quantity(c['I_rated_pk_a'], 'A')} peak"
    yield "Dc link", plain_quantity(c["V_dc_v"], "V")
    carrier, sampling = plain_quantity(c["f_sw_hz"], "Hz"), plain_quantity(c["T_s_s"], "s")
    delay = f"delay {c['delay_samples']} sample" if c["delay_samples"] else "no delay"
    yield "Bridge", f"{c['bridge']}, carrier {carrier}, sampled every {sampling}, {delay}"
    parts = [f"{symbol} {plain_quantity(c['filter'][key], unit)}" for key, symbol, unit in _FILTER if c["filter"][key]]
    yield "Filter", ", ".join(parts)
    basis, of_study = c["scr_basis"], c["scr_basis_of_study"]
    yield "Basis of the SCR", basis if of_study == basis else f"{basis}; {of_study} in the study and its explorer"
    for one in c["limits"]:
        limit = one["current_limit_pu"]
        said = "none" if limit is None else f"{plain(limit)} pu of the rated peak, {one['limiter']}"
        yield f"Current limit of {one['controller']}", said


def _hashes(document: Document) -> Iterator[tuple[str, str]]:
    hashes = dict(document.get("hashes") or {})
    yield (
        f"Study {document['study']['name']}",
        hashes.pop("study", None) or document["study"].get("hash") or "not known",
    )
    for name, title in (("tables", "Gain table"), ("package", "This package"), ("c", "Exported C")):
        yield from _hash(title, hashes.pop(name, None))
    for name, value in hashes.items():
        yield from _hash(name, value)
    for name, value in (document.get("provenance") or {}).items():
        yield str(name), str(value)


def _hash(title: str, value: Any) -> Iterator[tuple[str, str]]:
    """A hash, or one for each name; a missing one is said."""
    if isinstance(value, Mapping):
        for name, one in value.items():
            yield f"{title}: {name}", str(one or "none: there is no gain table")
    elif value:
        yield title, str(value)
    else:
        yield title, "none"


def sources_table(sources: Any) -> Table:
    """Every source with its edition and how far it is known."""
    rows = tuple(
        (f"[{k}]", one["document"], one["edition"], one["confidence"], one.get("note", ""))
        for k, one in enumerate(sources, start=1)
    )
    return Table("Sources", ("", "Document", "Edition", "Confidence", "Note"), rows, texts=5, row_anchor="source")
