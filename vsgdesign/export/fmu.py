"""A controller of a study as a functional mock-up unit: FMI 3.0 or 2.0, co-simulation, with sources and binaries; and a
reference run of it: inputs that turn as a grid does, with a step and a dip, and what comes out.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import io
import re
import tempfile
import uuid
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from vsgdesign import __version__
from vsgdesign.equations.frames import clarke, clarke_inverse
from vsgdesign.errors import ArtifactError
from vsgdesign.export.c_code import filled
from vsgdesign.export.port_records import TUNABLE, Port, plain_unit
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import lists_of, unit_hash
from vsgdesign.export.wrapping import (
    LINUX,
    WINDOWS,
    Builder,
    Exported,
    Wrapped,
    begun,
    meaning_of,
    sources_of,
    write_wrapper,
)

VERSIONS = ("3", "2")
"""FMI 3.0 and FMI 2.0."""

HEADERS = {
    "3": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
    "2": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
}
PLACES = {
    "3": {LINUX: "x86_64-linux/{name}.so", WINDOWS: "x86_64-windows/{name}.dll"},
    "2": {LINUX: "linux64/{name}.so", WINDOWS: "win64/{name}.dll"},
}

UNITS = {
    "V": 'kg="1" m="2" s="-3" A="-1"',
    "A": 'A="1"',
    "W": 'kg="1" m="2" s="-3"',
    "var": 'kg="1" m="2" s="-3"',
    "rad": 'rad="1"',
    "rad/s": 'rad="1" s="-1"',
    "Ohm": 'kg="1" m="2" s="-3" A="-2"',
    "H": 'kg="1" m="2" s="-2" A="-2"',
}
"""Units of ports in those of SI."""

_FUNCTION = re.compile(r"typedef\s+([\w ]+?\*?)\s*(fmi[23]\w+)TYPE\s*\(([^;]*)\)\s*;", re.DOTALL)


def export_fmu(
    unit: Unit,
    out: str | Path,
    *,
    variant: str = "controller",
    version: str = "3",
    inputs: Iterable[str | Path] = (),
    builder: Builder | None = None,
) -> Exported:
    """Writes NAME.fmu into the folder ``out``, with the binaries for which there is a compiler.

    ``version`` is that of FMI, "3" or "2". Raises ArtifactError: a folder with other files, an unknown variant.
    """
    if version not in VERSIONS:
        raise ArtifactError(f'fmi = "{version}": unknown. Known: {", ".join(VERSIONS)}.')
    inputs = tuple(inputs)
    with begun("fmu", unit, out, variant, inputs, builder) as (one, used):
        return _written(one, version, out, inputs, used)


def _written(one: Wrapped, version: str, out: str | Path, inputs: tuple[str | Path, ...], builder: Builder) -> Exported:
    content = content_of_fmu(one, version)
    own = {"fmu_core.h": filled("fmu_core.h", content), f"fmi{version}.c": filled(f"fmi{version}.c", content)}
    headers = {name: header(name) for name in HEADERS[version]}
    core = sources_of(one.unit, builder)
    core["vsg.h"] = core["vsg.h"].replace("#ifdef VSG_DOUBLE", f"{_DOUBLE}#ifdef VSG_DOUBLE", 1)
    files: dict[str, str | bytes] = {f"sources/{name}": text for name, text in (core | own | headers).items()}
    libraries, said = builder.libraries(one, own | headers, PLACES[version], f"fmi{version}*")
    files |= {f"binaries/{place}": library for place, library in libraries.items()}
    compiled = sorted(name for name in core if name.endswith(".c"))
    sources = [f"fmi{version}.c", *compiled]
    if version == "2":
        files["modelDescription.xml"] = description_2(one, sources)
    else:
        files["modelDescription.xml"] = description_3(one)
        files["sources/buildDescription.xml"] = _build_description(one.name, sources)
    files["documentation/index.html"] = _page(one)
    files["documentation/licenses/fmi-headers.txt"] = _licence(headers)
    if (reference := reference_csv(one, builder)) is not None:
        place = "extra/org.fmi-standard.fmi-ls-ref"
        files |= {f"{place}/{one.name}_{what}.csv": text for what, text in zip(("in", "out"), reference, strict=True)}
        files[f"{place}/fmi-ls-manifest.xml"] = _reference_manifest(one.name)
    else:
        said.append("Without gcc there is no reference output in the FMU.")
    return write_wrapper(
        "fmu",
        one,
        out,
        {f"{one.name}.fmu": _zipped(files)},
        inputs=inputs,
        more={"fmi": version, "in_file": sorted(files)},
        said=said,
    )


@dataclass(frozen=True)
class Reference:
    """A port with its value reference."""

    number: int
    port: Port


def references(one: Wrapped) -> list[Reference]:
    """Inputs, outputs and parameters with their value references; 0 is the time."""
    ports = [*one.ports.inputs, *one.ports.outputs, *one.ports.parameters]
    return [Reference(number, port) for number, port in enumerate(ports, 1)]


def token_of(one: Wrapped) -> str:
    """The GUID of a controller, out of the hash of its table, settings and constants."""
    digest = hashlib.sha256(f"{unit_hash(one.unit, lists_of(one.unit))}{one.variant}".encode()).digest()
    return f"{{{uuid.UUID(bytes=digest[:16])}}}"


def content_of_fmu(one: Wrapped, version: str) -> dict[str, Any]:
    """What the templates of both versions are filled with."""
    first_output = 1 + len(one.ports.inputs)
    first_parameter = first_output + len(one.ports.outputs)
    number = int(hashlib.sha256(token_of(one).encode()).hexdigest()[:8], 16)
    return {
        "name": one.name,
        "version": __version__,
        "word": one.word,
        "token": token_of(one),
        "T_s": repr(one.unit.T_s),
        "first_output": first_output,
        "first_parameter": first_parameter,
        "end": first_parameter + len(one.ports.parameters),
        "tunable": [f"{int(port.kind == TUNABLE)}U" for port in one.ports.parameters],
        "state_version": f"{number}.0",
        "stubs": stubs(version),
    }


@functools.cache
def header(name: str) -> str:
    """A header of the standard, by the Modelica Association under the 2-Clause BSD Licence."""
    place = resources.files("vsgdesign.export") / "templates" / "fmi" / name
    return place.read_text(encoding="utf-8")


@functools.cache
def stubs(version: str) -> list[dict[str, Any]]:
    """The functions of the standard that a template does not have, with the arguments of the header."""
    template = (resources.files("vsgdesign.export") / "templates" / f"fmi{version}.c.j2").read_text(encoding="utf-8")
    declared = re.sub(r"/\*.*?\*/", " ", header(f"fmi{version}FunctionTypes.h"), flags=re.DOTALL)
    found = []
    for result, name, arguments in _FUNCTION.findall(declared):
        if re.search(rf"\b{name}\(", template):
            continue
        arguments = " ".join(arguments.split())
        names = [re.sub(r"\[\]$", "", part.strip()).split()[-1].lstrip("*") for part in arguments.split(",")]
        answer = {f"fmi{version}Status": f"fmi{version}Error", "void": ""}.get(result.strip(), "NULL")
        found.append({"result": result.strip(), "name": name, "arguments": arguments, "names": names, "answer": answer})
    return found


def _attributes(port: Port) -> str:
    """Unit and limits."""
    unit, low, high = plain_unit(port.unit), port.low, port.high
    text = f" unit={quoteattr(unit)}" if unit else ""
    text += f' min="{low!r}"' if low > -1e300 else ""
    return text + (f' max="{high!r}"' if high < 1e300 else "")


def _variable(port: Port) -> tuple[str, str, str]:
    """Causality, variability, and start value as an attribute; outputs have none."""
    if port.kind in ("input", "output"):
        return port.kind, "discrete", f' start="{port.start!r}"' if port.kind == "input" else ""
    return "parameter", port.kind, f' start="{port.start!r}"'


def _about(one: Wrapped) -> str:
    """What the description says of the controller and of its timing."""
    u = one.unit
    what = f"Controller {u.controller} of study {u.origin.study}, sampled every {u.T_s!r} s."
    if one.variant == "reference":
        return f"{what} Power loops alone: voltage and angle out; no inner loops and no current limit."
    if u.delay_samples:
        return f"{what} The bridge voltage after a step acts from its end on: the sample of delay is in it."
    return (
        f"{what} The bridge voltage after a step belongs to this same step (delay 0): let the importer calculate this "
        "unit before the circuit, or it acts one sample too late."
    )


def description_3(one: Wrapped) -> str:
    """modelDescription.xml of FMI 3.0."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(one.name)} instantiationToken="{token_of(one)}" '
        f'description={quoteattr(_about(one))} generationTool="vsgdesign {__version__}">',
        f'  <CoSimulation modelIdentifier="{one.name}" canHandleVariableCommunicationStepSize="true" '
        f'canGetAndSetFMUState="true" canSerializeFMUState="true" fixedInternalStepSize="{one.unit.T_s!r}"/>',
        "  <UnitDefinitions>",
        *(f'    <Unit name="{name}"><BaseUnit {base}/></Unit>' for name, base in _units(one)),
        "  </UnitDefinitions>",
        '  <LogCategories><Category name="logStatusError"/></LogCategories>',
        f'  <DefaultExperiment startTime="0" stopTime="0.1" stepSize="{one.unit.T_s!r}"/>',
        "  <ModelVariables>",
        '    <Float64 name="time" valueReference="0" causality="independent" variability="continuous" '
        'description="Time"/>',
    ]
    for ref in references(one):
        causality, variability, start = _variable(ref.port)
        lines.append(
            f'    <Float64 name="{ref.port.name}" valueReference="{ref.number}" causality="{causality}" '
            f'variability="{variability}" description={quoteattr(meaning_of(ref.port))}{_attributes(ref.port)}{start}/>'
        )
    outputs = [ref.number for ref in references(one) if ref.port.kind == "output"]
    lines += ["  </ModelVariables>", "  <ModelStructure>"]
    lines += [f'    <Output valueReference="{number}"/>' for number in outputs]
    lines += [f'    <InitialUnknown valueReference="{number}"/>' for number in outputs]
    return "\n".join([*lines, "  </ModelStructure>", "</fmiModelDescription>", ""])


def description_2(one: Wrapped, sources: list[str]) -> str:
    """modelDescription.xml of FMI 2.0."""
    files = "".join(f'<File name="{name}"/>' for name in sources)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(one.name)} guid="{token_of(one)}" '
        f'description={quoteattr(_about(one))} generationTool="vsgdesign {__version__}" '
        'variableNamingConvention="flat">',
        f'  <CoSimulation modelIdentifier="{one.name}" canHandleVariableCommunicationStepSize="true" '
        'canGetAndSetFMUstate="true" canSerializeFMUstate="true" canNotUseMemoryManagementFunctions="true">',
        f"    <SourceFiles>{files}</SourceFiles>",
        "  </CoSimulation>",
        "  <UnitDefinitions>",
        *(f'    <Unit name="{name}"><BaseUnit {base}/></Unit>' for name, base in _units(one)),
        "  </UnitDefinitions>",
        '  <LogCategories><Category name="logStatusError"/></LogCategories>',
        f'  <DefaultExperiment startTime="0" stopTime="0.1" stepSize="{one.unit.T_s!r}"/>',
        "  <ModelVariables>",
    ]
    for ref in references(one):
        causality, variability, start = _variable(ref.port)
        initial = ' initial="calculated"' if causality == "output" else ""
        lines.append(
            f'    <ScalarVariable name="{ref.port.name}" valueReference="{ref.number}" causality="{causality}" '
            f'variability="{variability}"{initial} description={quoteattr(meaning_of(ref.port))}>'
            f"<Real{_attributes(ref.port)}{start}/></ScalarVariable>"
        )
    positions = [k for k, ref in enumerate(references(one), 1) if ref.port.kind == "output"]
    unknowns = "".join(f'<Unknown index="{k}"/>' for k in positions)
    lines += ["  </ModelVariables>", "  <ModelStructure>", f"    <Outputs>{unknowns}</Outputs>"]
    lines += [f"    <InitialUnknowns>{unknowns}</InitialUnknowns>", "  </ModelStructure>", "</fmiModelDescription>", ""]
    return "\n".join(lines)


def _units(one: Wrapped) -> list[tuple[str, str]]:
    used = {plain_unit(port.unit) for port in one.ports.ports} - {""}
    return [(name, UNITS[name]) for name in sorted(used)]


def _build_description(name: str, sources: list[str]) -> str:
    files = "".join(f'\n      <SourceFile name="{source}"/>' for source in sources)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{name}">
    <SourceFileSet language="C99">{files}
      <PreprocessorDefinition name="VSG_DOUBLE" value="1"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


_DOUBLE = "#ifndef VSG_DOUBLE\n#define VSG_DOUBLE 1\n#endif\n"
"""An importer of FMI 2 has no other way to know that the numbers are doubles."""


def _reference_manifest(name: str) -> str:
    """The layered standard that names reference results is 1.0.0-alpha.1."""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref"
  fmi-ls:fmi-ls-version="1.0.0-alpha.1" fmi-ls:fmi-ls-description="Input and output of a reference run">
  <Related source="{name}_in.csv" role="stimuli" type="text/csv"/>
  <Related source="{name}_out.csv" role="result" type="text/csv"/>
</fmiReferences>
"""


def _page(one: Wrapped) -> str:
    rows = "\n".join(
        f"<tr><td>{port.name}</td><td>{port.kind}</td><td>{plain_unit(port.unit)}</td><td>{meaning_of(port)}</td></tr>"
        for port in one.ports.ports
    )
    notes = "".join(f"<p>{note}</p>" for note in one.unit.notes)
    origin = one.unit.origin
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{one.name}</title></head><body>
<h1>{one.name}</h1>
<p>{_about(one)}</p>{notes}
<p>Table {origin.table}, SHA-256 {origin.table_sha256}. {origin.certificate}</p>
<p>Made by vsgdesign {__version__}. Never loaded in a commercial tool by its authors; tested with FMPy.</p>
<table><tr><th>name</th><th>kind</th><th>unit</th><th>meaning</th></tr>
{rows}
</table></body></html>
"""


def _licence(headers: dict[str, str]) -> str:
    text = next(iter(headers.values()))
    start = text.index("Copyright")
    return text[start : text.index("*/", start)]


def _zipped(files: dict[str, str | bytes]) -> bytes:
    """The files of an FMU as one, the same bytes for the same content."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            content = files[name]
            archive.writestr(entry, content if isinstance(content, bytes) else content.encode())
    return whole.getvalue()


SAMPLES = 400
"""Of a reference run: at the start at rest, then a step of a set point, and a dip of the voltage."""


def reference_inputs(one: Wrapped) -> np.ndarray:
    """Inputs of every sample, (SAMPLES, inputs). The plant is not part of it: what is measured is given."""
    ports, unit = one.ports.inputs, one.unit
    rows = np.tile([port.start for port in ports], (SAMPLES, 1))
    at = {port.name: k for k, port in enumerate(ports)}
    turn = np.exp(1j * unit.omega_n * unit.T_s * np.arange(SAMPLES))
    turn[SAMPLES // 2 :] *= 0.7
    for name in ("v", "i_s", "i_g", "v_grid"):
        if f"{name}_a" in at:
            k = at[f"{name}_a"]
            vector = complex(*clarke(*rows[0, k : k + 3])) * turn
            rows[:, k : k + 3] = np.column_stack(clarke_inverse(vector.real, vector.imag))
    if "P" in at:
        rows[:, at["P"]] *= np.abs(turn)
    rows[SAMPLES // 4 :, at["P_ref"]] += 0.1 * unit.S_rated
    return rows


def reference_csv(one: Wrapped, builder: Builder) -> tuple[str, str] | None:
    """Inputs and outputs of the reference run as CSV; None without a compiler. The outputs of a row are those of the
    sample that took its inputs, and stand one sample later, as a co-simulation gives them."""
    library = builder.library(one.unit, {}, LINUX, "vsg_*")
    if library is None:
        return None
    given = reference_inputs(one)
    outputs = run_library(library, one, given)
    T_s = one.unit.T_s
    first = np.array([port.start for port in one.ports.outputs])
    told = np.vstack([first, outputs])
    return (
        _csv([port.name for port in one.ports.inputs], given, T_s),
        _csv([port.name for port in one.ports.outputs], told, T_s),
    )


def run_library(library: bytes, one: Wrapped, given: np.ndarray) -> np.ndarray:
    """What the functions of a variant in a compiled library answer to a series of inputs."""
    with tempfile.TemporaryDirectory(prefix="vsg") as folder:
        place = Path(folder) / "library.so"
        place.write_bytes(library)
        loaded = ctypes.CDLL(str(place))
        state = ctypes.create_string_buffer(1 << 16)
        parameters = np.array([port.start for port in one.ports.parameters])
        outputs = np.empty((len(given), len(one.ports.outputs)))
        getattr(loaded, f"vsg_{one.word}_begin")(state, _pointer(parameters))
        step = getattr(loaded, f"vsg_{one.word}_step")
        for row, out in zip(np.ascontiguousarray(given), outputs, strict=True):
            step(state, _pointer(row), _pointer(parameters), _pointer(out))
    return outputs


def _pointer(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _csv(names: list[str], rows: np.ndarray, T_s: float) -> str:
    lines = [",".join(["time", *names])]
    for k, row in enumerate(rows):
        lines.append(",".join([repr(k * T_s), *map(repr, map(float, row))]))
    return "\n".join([*lines, ""])
