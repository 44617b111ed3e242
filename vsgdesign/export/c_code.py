"""A scheduler as C99. Templates are filled with the numbers of the table and the network, completely or not at all."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign import __version__
from vsgdesign.artifacts.field_weights import read_field_weights
from vsgdesign.artifacts.files import plain, write_text
from vsgdesign.artifacts.guarded_file import check_folder_target, staged_folder, write_record
from vsgdesign.artifacts.table_text import full_order_sentence, proof_sentences
from vsgdesign.equations.field import FieldFeatures
from vsgdesign.equations.frames import rated_current_rms, rms_to_peak
from vsgdesign.equations.limiters import CIRCULAR
from vsgdesign.errors import ArtifactError
from vsgdesign.export.c_content import Origin, content_of, field_parts, network_of
from vsgdesign.export.field import ConverterConstants, converter_constants
from vsgdesign.export.laws import printed_math
from vsgdesign.export.unit_content import unit_content, unit_document
from vsgdesign.identification.field import FINDS_WITHIN, field_network
from vsgdesign.identification.neural import neural_estimator
from vsgdesign.runtime.guards import searching_settings, window_settings
from vsgdesign.runtime.scheduler import Scheduler, read_table_of, scheduler_of

if TYPE_CHECKING:
    import jinja2

    from vsgdesign.artifacts.gain_table import TableBase
    from vsgdesign.artifacts.network_weights import NetworkWeights
    from vsgdesign.export.unit import Unit
    from vsgdesign.study.parameters.study import Study

KIND = "vsgdesign export c"
SCHEMA = 1
MANIFEST = "manifest.json"

FILES = (
    "vsg.h",
    "vsg.c",
    "vsg_data.h",
    "vsg_data.c",
    "vsg_laws.h",
    "vsg_power.c",
    "vsg_control.c",
    "vsg_math.c",
    "vsg_selftest.c",
    "Makefile",
    "CMakeLists.txt",
    "INTEGRATION.md",
)

UNIT_FILES = ("vsg_unit.h", "vsg_unit.c")
"""What a folder of a study's controller has besides FILES: the converter with ports, which wrappers call."""

FIELD_FILES = ("vsg_field_laws.h", "vsg_field.c", "vsg_converter.c")
"""What a folder with the field estimator has besides FILES."""

ESTIMATORS = ("field", "field_network", "none")
"""What an export may be asked for besides a network."""


@dataclass(frozen=True)
class ExportedC:
    """The files that were written, and their origin."""

    folder: Path
    manifest: dict[str, Any]


def export_c_files(
    table: str | Path,
    out: str | Path,
    *,
    weights: str | Path | None = None,
    study: Study | None = None,
    v_limit: float | None = None,
    i_limit: float | None = None,
    grid_phase: bool = False,
    limiter: str | None = None,
    estimator: str | None = None,
    **changes: Any,
) -> ExportedC:
    """C from a table's and a network's file into the folder ``out``.

    ``v_limit`` (V) and ``i_limit`` (A) are the sensors' limits, four times the rated peaks where they are not given;
    ``study`` refuses a table that was not designed from it. ``limiter`` is how the exported controller limits its
    current, as studies name it; None is the study's own, and ``circular`` without a study. ``estimator`` is ``field``
    for the field estimator of the study's converter, ``field_network`` for the same with the network that the study
    names or the packaged one, and ``none`` for none; None is that of the first controller of the study that has
    ``estimate = "field"`` or ``"field_network"``. ``changes`` go to the
    settings as in :func:`vsgdesign.runtime.guards.settings_of`. Raises ArtifactError with what to do: a file that is
    damaged, newer or of another case, a folder with other files.
    """
    found = read_table_of(table, study)
    if weights is None:
        _check_no_sensors(v_limit, i_limit)
    if limiter is None:
        limiter = CIRCULAR.name if study is None else study.current_limiter
    converter = _converter_of(study, estimator, limiter)
    origin = Origin(
        table=found.name,
        table_sha256=found.sha256,
        study=found.study,
        study_hash=found.study_hash,
        certificate=proof_sentences(found),
        full_order=full_order_sentence(found.full_order),
        limiter=limiter,
    )
    network = None
    if weights is not None:
        from vsgdesign.artifacts.network_weights import read_network_weights

        trained = read_network_weights(weights)
        base, window = found.base, trained.window
        _check_same_converter(trained, base)
        peak_v = rms_to_peak(base.V_rated_rms)
        peak_i = rms_to_peak(rated_current_rms(base.S_rated, base.V_rated_rms))
        network = neural_estimator(
            trained,
            sample_interval=window.sample_interval,
            channels=window.channels,
            grid_phase=grid_phase,
            v_limit=float(np.float32(4.0 * peak_v if v_limit is None else v_limit)),
            i_limit=float(np.float32(4.0 * peak_i if i_limit is None else i_limit)),
        )
        changes = window_settings(window.period) | changes
        origin = replace(
            origin, weights_sha256=trained.hash, channels=window.channels, sample_interval=window.sample_interval
        )
    if converter is not None:
        changes = searching_settings(FINDS_WITHIN) | changes
    inputs = [path for path in (table, weights) if path is not None]
    return export_c(scheduler_of(found, network, **changes), origin, out, inputs=inputs, converter=converter)


def _check_no_sensors(v_limit: float | None, i_limit: float | None) -> None:
    """Limits of sensors belong to a network. Raises ArtifactError."""
    given = [f"{name} = {value:g}" for name, value in (("v_limit", v_limit), ("i_limit", i_limit)) if value is not None]
    if given:
        raise ArtifactError(
            f"{' and '.join(given)}: the samples of a network are held against it, and no network is exported. Give "
            "its weights, or leave it out."
        )


def _converter_of(study: Study | None, estimator: str | None, limiter: str) -> ConverterConstants | None:
    """The constants of the study's converter for a folder with the field estimator; None for one without."""
    if estimator is not None and estimator not in ESTIMATORS:
        raise ArtifactError(f'estimator = "{estimator}": unknown. Known: {", ".join(ESTIMATORS)}.')
    if estimator in ("field", "field_network") and study is None:
        raise ArtifactError(
            f"estimator = {estimator}: it is made for a converter and its filter, and no study says which. Give the "
            "study (--study STUDY.toml)."
        )
    if study is None or estimator == "none":
        return None
    if estimator is None:
        asked = (controller.estimate for controller in study.controllers)
        estimator = next((name for name in asked if name in ESTIMATORS), None)
    if estimator is None:
        return None
    if limiter != study.current_limiter:
        raise ArtifactError(
            f'limiter = "{limiter}": the study\'s converter has "{study.current_limiter}", and its constants are '
            "exported with the estimator. Leave the limiter out, or change current_limiter in the study."
        )
    if estimator == "field":
        return converter_constants(study)
    named = None if study.estimator is None else study.estimator.field_weights_file
    weights = read_field_weights(named)
    return converter_constants(study, field_network(weights, FieldFeatures._fields), weights.hash)


def _check_same_converter(trained: NetworkWeights, base: TableBase) -> None:
    """Refuses weights that were trained from a study of another converter. Such weights name their converter."""
    for name, unit in (("S_rated", "VA"), ("V_rated_rms", "V")):
        ours = float(getattr(base, name))
        theirs = trained.training.get("converter", {}).get(name, ours)
        if abs(theirs - ours) > 1e-6 * ours:
            raise ArtifactError(
                f"weights: they were trained for a converter of {name} = {theirs:g} {unit}, the table is for "
                f"{ours:g} {unit}. Train on the table's study."
            )


def export_c(
    scheduler: Scheduler,
    origin: Origin,
    out: str | Path,
    *,
    inputs: Iterable[str | Path] = (),
    converter: ConverterConstants | None = None,
    unit: Unit | None = None,
) -> ExportedC:
    """C of a scheduler into the folder ``out``, which appears when everything is written. With the constants of a
    ``converter`` it also has the field estimator, and with a ``unit`` the converter with ports.

    A folder from an earlier export is replaced as long as its files are as they were written, and none of the
    ``inputs`` is in it. Raises ArtifactError.
    """
    out, inputs = Path(out), tuple(inputs)
    check_folder_target(out, KIND, inputs, MANIFEST)  # before the work rather than after it
    texts = render(scheduler, origin, converter, unit)
    manifest = plain(manifest_of(scheduler, origin, converter, unit))
    with staged_folder(out, KIND, inputs=inputs, record=MANIFEST) as folder:
        for name, text in texts.items():
            write_text(folder / name, text)
        manifest = write_record(folder, manifest, KIND, MANIFEST)
    return ExportedC(out, manifest)


def export_unit_c(unit: Unit, out: str | Path, *, inputs: Iterable[str | Path] = ()) -> ExportedC:
    """C of a study's controller with its ports into the folder ``out``, as :func:`export_c`. Raises ArtifactError."""
    converter = unit.constants if unit.has_field else None
    return export_c(unit.scheduler, unit.origin, out, inputs=inputs, converter=converter, unit=unit)


def render_unit(unit: Unit) -> dict[str, str]:
    """The texts of :func:`export_unit_c` by the names of their files."""
    return render(unit.scheduler, unit.origin, unit.constants if unit.has_field else None, unit)


def manifest_of(
    scheduler: Scheduler, origin: Origin, converter: ConverterConstants | None, unit: Unit | None = None
) -> dict[str, Any]:
    """What the record of an exported folder says besides its files: the hashes of everything that it was made from."""
    estimator = network_of(scheduler)
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "table": {"name": origin.table, "sha256": origin.table_sha256, "certificate": origin.certificate},
        "study": {"name": origin.study, "hash": origin.study_hash},
        "weights": None if estimator is None else {"sha256": origin.weights_sha256},
        "generator": {"vsgdesign": __version__, "sha256": generator_hash()},
        "limiter": origin.limiter,
        "settings": asdict(scheduler.settings),
        "network": None
        if estimator is None
        else {
            "shape": [2 * estimator.samples * estimator.components, len(estimator.b_1), 2],
            "v_limit": estimator.v_limit,
            "i_limit": estimator.i_limit,
        },
        "field": None
        if converter is None
        else {"settings": converter.field_settings._asdict(), "network_sha256": converter.network_sha256},
    }
    return found if unit is None else found | {"unit": unit_document(unit)}


def render(
    scheduler: Scheduler, origin: Origin, converter: ConverterConstants | None = None, unit: Unit | None = None
) -> dict[str, str]:
    """Every file's text by name."""
    content = content_of(scheduler, origin) | {"field": None if converter is None else field_parts(converter)}
    content |= {"unit": None if unit is None else unit_content(unit), "printed_math": printed_math()}
    names = (*FILES, *(() if converter is None else FIELD_FILES), *(() if unit is None else UNIT_FILES))
    return {name: filled(name, content) for name in names}


def filled(name: str, content: Mapping[str, Any]) -> str:
    """A template with its content."""
    return _environment().get_template(f"{name}.j2").render(content)


@functools.cache
def _environment() -> jinja2.Environment:
    """What reads the templates, each of which it compiles once a process."""
    import jinja2

    def read(name: str) -> str:
        return (resources.files("vsgdesign.export") / "templates" / name).read_text(encoding="utf-8")

    return jinja2.Environment(
        loader=jinja2.FunctionLoader(read),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )


_MODULES = (
    *("c_code.py", "c_content.py", "field.py", "known_answers.py", "laws.py"),
    *("port_records.py", "ports.py", "unit.py", "unit_content.py"),
)


def generator_hash() -> str:
    """SHA-256 of the templates and of the modules that fill them; the equations are in the files' own hashes."""
    digest = hashlib.sha256()
    room = resources.files("vsgdesign.export")
    for name in sorted(f"{name}.j2" for name in (*FILES, *FIELD_FILES, *UNIT_FILES)):
        digest.update((room / "templates" / name).read_bytes())
    for name in _MODULES:
        digest.update((room / name).read_bytes())
    printer = resources.files("vsgdesign.codegen")
    for name in sorted(file.name for file in printer.iterdir() if file.name.endswith(".py")):
        digest.update((printer / name).read_bytes())
    return digest.hexdigest()
