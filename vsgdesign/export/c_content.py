"""What the templates of the exported C are filled with: the numbers of a table, an estimator and a converter."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign import __version__
from vsgdesign.artifacts.table_text import certificate_sentence
from vsgdesign.equations.field.fusion import FIRST_GATE
from vsgdesign.equations.limiters import CIRCULAR, limiter_named
from vsgdesign.errors import ArtifactError
from vsgdesign.export.field import ConverterConstants, field_content
from vsgdesign.export.known_answers import (
    KnownSteps,
    known_answers,
    known_cycles,
    known_posteriors,
    known_powers,
    known_steps,
    known_windows,
)
from vsgdesign.export.laws import REASON_NAMES, laws_content
from vsgdesign.identification.field import FieldNetwork
from vsgdesign.identification.neural import NeuralEstimator
from vsgdesign.runtime.guards import REASONS
from vsgdesign.runtime.needed_sigma import needed_sigma
from vsgdesign.runtime.scheduler import Scheduler

if TYPE_CHECKING:
    from vsgdesign.runtime.updating import GainLookup

_BLOCK = 20
"""Samples that are summed before they join the whole: single precision keeps a digit more."""


@dataclass(frozen=True)
class Origin:
    """Names and hashes of the inputs from which a scheduler was made."""

    table: str
    table_sha256: str
    study: str
    study_hash: str
    certificate: str = certificate_sentence(None)
    """The proved properties of the box, in words."""
    full_order: str = ""
    """What is proved of the sampled full-order loop, in words; empty where nothing was tried."""
    weights_sha256: str | None = None
    channels: str = ""
    sample_interval: float = 0.0
    limiter: str = CIRCULAR.name
    """The current limiter of the exported controller, by its name in a study."""


def network_of(scheduler: Scheduler) -> NeuralEstimator | None:
    """The network of a scheduler, or None without an estimator. Raises ArtifactError for an estimator without C."""
    estimator = scheduler.estimator
    if estimator is None or isinstance(estimator, NeuralEstimator):
        return estimator
    raise ArtifactError(
        f"there is no C for the estimator {estimator.title} yet, only for a network: export the scheduler without an "
        "estimator and give it estimates (vsg_update_estimate)."
    )


def literal(value: float) -> str:
    """A number as an argument of VSG_C: the shortest decimal that brings back the same double."""
    if not math.isfinite(value):
        raise ArtifactError(f"{value} cannot be written as a constant of C; give finite limits.")
    return repr(float(value))


def content_of(scheduler: Scheduler, origin: Origin) -> dict[str, Any]:
    lookup, c, estimator = scheduler.lookup, scheduler.settings, network_of(scheduler)
    known = known_answers(scheduler)
    content: dict[str, Any] = {
        "headline": _comment(
            f"Table {origin.table} of study {origin.study}, sha256 {origin.table_sha256[:12]}: {lookup.structure}, law "
            f"{lookup.law}. {origin.full_order}"
        ),
        "version": __version__,
        "certificate": " ".join(origin.certificate.split()),
        "reasons": REASONS,
        "reason_names": REASON_NAMES,
        "tick_text": f"{c.tick * 1e6:.6g} us a tick",
        "update_text": f"{c.update_ticks * c.tick * 1e3:.6g} ms",
        "table_sha256": origin.table_sha256,
        "weights_sha256": origin.weights_sha256,
        "some_undesigned": not all(node is not None for row in lookup.nodes for node in row),
        "constants": list(_constants(scheduler)),
        "rows": {name: braces(list(getattr(lookup.table, name))) for name in ("scr", "r_over_x")},
        "nodes": braces([list(lookup.table.nodes[at : at + 6]) for at in range(0, len(lookup.table.nodes), 6)]),
        "node_count": len(lookup.table.nodes) // 6,
        "table": _members(lookup.table),
        "limits": _members(c.limits),
        "known": [
            {
                "ticks": one.ticks,
                "hold": int(one.hold),
                "told": one.told,
                "known": int(bool(one.covariance)),
                "covariance": braces(_numbers(one.covariance or (0.0, 0.0, 0.0))),
                "no_number": sum(math.isnan(x) << at for at, x in enumerate((*one.given, *one.covariance))),
                "status": one.status,
                "reason": one.reason,
                "given": braces(_numbers(one.given)),
                "answer": braces(one.answer),
                "size": braces(one.size),
            }
            for one in known
        ],
        "needed_sigma": needed_sigma(c, _x_over_r(lookup)).text,
        "figures": list(_figures(scheduler, origin).items()),
        "network": None,
    }
    content |= laws_content(lookup.structure, lookup.law, lookup.scr_basis, origin.limiter) | _steps(scheduler, origin)
    if estimator is not None:
        content |= _network(estimator, origin)
    return content


def _x_over_r(lookup: GainLookup) -> list[float]:
    """X/R of a table's nodes; none for a closed form, which is a table of one node."""
    return [1.0 / ratio for ratio in lookup.r_over_x] if len(lookup.r_over_x) > 1 else []


def _members(record: Any) -> list[tuple[str, str]]:
    """The members of a record of constants and their values; those of rows of numbers are made of the rows."""
    return [
        (name, f"{value}UL" if isinstance(value, int) else f"VSG_C({literal(value)})")
        for name, value in record._asdict().items()
        if not isinstance(value, tuple)
    ]


def _constants(scheduler: Scheduler) -> Iterable[tuple[str, str]]:
    lookup, estimator = scheduler.lookup, network_of(scheduler)
    yield "ROWS", f"{len(lookup.scr)}U"
    yield "COLUMNS", f"{len(lookup.r_over_x)}U"
    if estimator is not None:
        yield "HIDDEN", f"{len(estimator.b_1)}U"
        yield "BLOCK", f"{_BLOCK}U"
        (R_low, L_low), (R_high, L_high) = estimator.least, estimator.largest
        for name, value in (
            ("TRAINED_R_LOW", R_low),
            ("TRAINED_R_HIGH", R_high),
            ("TRAINED_L_LOW", L_low),
            ("TRAINED_L_HIGH", L_high),
            ("V_LIMIT", estimator.v_limit),
            ("I_LIMIT", estimator.i_limit),
        ):
            yield name, f"VSG_C({literal(value)})"


def _steps(scheduler: Scheduler, origin: Origin) -> dict[str, Any]:
    """Known answers of the whole controller."""
    known = known_steps(scheduler.lookup, scheduler.settings, limiter_named(origin.limiter))
    pairs = zip(known.measured, known.outputs, strict=True)
    return {
        "steps": [{"measured": initialiser(measured), "output": initialiser(output)} for measured, output in pairs],
        "step_refs": initialiser(known.refs),
        "step_gains": f"{{{', '.join(map(initialiser, known.gains))}}}",
        "step_inner_gains": initialiser(known.inner_gains),
        "step_grid": initialiser(known.grid),
        "step_settings": initialiser(known.settings),
        "step_size": initialiser(known.size),
        "step_fields": known.size._fields,
        "powers": _powers(known),
    }


def _powers(steps: KnownSteps) -> dict[str, Any]:
    """Known answers of the power loops alone."""
    known = known_powers(steps)
    rows = zip(known.powers, known.voltages, strict=True)
    return {
        "rows": [
            {
                "given": braces(_numbers(powers)),
                "used": int(not any(map(math.isnan, powers))),
                "no_number": sum(math.isnan(x) << at for at, x in enumerate(powers)),
                "answer": braces(voltage),
            }
            for powers, voltage in rows
        ],
        "T_s": literal(known.T_s),
        "smoothing": literal(known.smoothing),
        "notch": ", ".join(f"VSG_C({literal(value)})" for value in known.notch),
        "size": braces((steps.refs.omega_0, steps.refs.V_n, 1.0)),
    }


def _numbers(values: tuple[float, ...]) -> tuple[float, ...]:
    """With 0 in the place of NaN, which C makes from its bits."""
    return tuple(0.0 if math.isnan(value) else value for value in values)


def field_parts(converter: ConverterConstants) -> dict[str, Any]:
    """The field estimator, with known answers."""
    known, network = known_cycles(converter.field_settings), converter.network
    return field_content(network is not None) | {
        "network": None if network is None else _field_network(network),
        "settings": initialiser(converter.field_settings),
        "period_text": f"{converter.field_settings.T_s * 1e6:.6g} us",
        "inner_gains": initialiser(converter.inner_gains),
        "references": initialiser(converter.references),
        "controller_settings": initialiser(converter.controller_settings),
        "known": [
            {
                "R_g": literal(one.R_g),
                "L_g": literal(one.L_g),
                "sigma": literal(one.sigma),
                "valid": int(one.valid),
                "spoilt": int(one.spoilt),
            }
            for one in known.answers
        ],
        "known_plant": {name: literal(value) for name, value in known.plant._asdict().items()},
    }


def _field_network(network: FieldNetwork) -> dict[str, Any]:
    """The layers and the gate of the network behind the field estimator, with known answers."""
    inputs, outputs = known_posteriors(network)
    return {
        "inputs": network.W_1.shape[1],
        "first": len(network.b_1),
        "second": len(network.b_2),
        "weights": {
            name: braces(getattr(network, name).tolist()) for name in ("W_1", "b_1", "W_2", "b_2", "W_3", "b_3")
        },
        "radii": braces(list(network.radii)),
        "gate": initialiser(network.gate),
        "first_gate": initialiser(FIRST_GATE),
        "known_inputs": braces(inputs.tolist()),
        "known_outputs": braces(outputs.tolist()),
        "known": len(inputs),
    }


def _network(estimator: NeuralEstimator, origin: Origin) -> dict[str, Any]:
    half = estimator.components * estimator.samples
    steps, windows = known_windows(estimator)
    (R_low, L_low), (R_high, L_high) = estimator.least, estimator.largest
    components = {"phase_a": "phase A", "alpha_beta": "alpha, then beta", "dq": "d, then q"}
    return {
        "network": {
            "samples": estimator.samples,
            "components": estimator.components,
            "channels": components.get(origin.channels, origin.channels),
            "interval_text": f"{origin.sample_interval * 1e6:.6g} us",
            "w1_v": braces(estimator.W_1[:, :half].T.tolist()),
            "w1_i": braces(estimator.W_1[:, half:].T.tolist()),
            "b1": braces(estimator.b_1.tolist()),
            "w2": braces(estimator.W_2.tolist()),
            "b2": braces(estimator.b_2.tolist()),
        },
        "v_step": literal(steps[0]),
        "i_step": literal(steps[1]),
        "windows": windows,
        "windows_text": braces([[R, L] for R, L, _ in windows]),
        "window_reasons": braces([f"{reason}U" for _, _, reason in windows]),
        "R_size": literal(R_high - R_low),
        "L_size": literal(L_high - L_low),
    }


def _figures(scheduler: Scheduler, origin: Origin) -> Mapping[str, str]:
    lookup, c, estimator = scheduler.lookup, scheduler.settings, network_of(scheduler)
    x_low, x_high = 1.0 / c.r_over_x[1], 1.0 / c.r_over_x[0]
    figures = {
        "rated power, nominal voltage": f"{lookup.S_rated:g} VA, {lookup.V_n_rms:g} V phase rms",
        "nominal frequency": f"{lookup.omega / (2.0 * np.pi):g} Hz",
        "grid-side inductor of the filter": f"{lookup.L_2 * 1e3:g} mH, {lookup.R_2:g} Ohm",
        "box of SCR, X/R": f"{c.scr[0]:.4g} to {c.scr[1]:.4g} ({lookup.scr_basis}), {x_low:.4g} to {x_high:.4g}",
        "box of P, Q, V": f"{c.P[0]:g} to {c.P[1]:g} W, {c.Q[0]:g} to {c.Q[1]:g} var, {c.V_rms[0]:.4g} to "
        f"{c.V_rms[1]:.4g} V",
        "plausible R_g, L_g": f"{c.R_g[0]:.4g} to {c.R_g[1]:.4g} Ohm, {c.L_g[0] * 1e3:.4g} to {c.L_g[1] * 1e3:.4g} mH",
        "rate of SCR and R/X": f"{c.rate:g} 1/s",
        "update period": f"{c.update_ticks * c.tick * 1e3:.4g} ms",
        "to the safe place": f"after {c.stale_ticks * c.tick:.4g} s of doubt, or {c.lost_ticks * c.tick:.4g} s without "
        "an estimate",
        "safe place": f"SCR {c.safe_scr:.4g}, R/X {c.safe_r_over_x:.4g}",
        "confirmed jump, hysteresis": f"{c.jump:.3g} for {c.confirm} windows, {c.hysteresis:.3g}",
    }
    if estimator is not None:
        (R_low, L_low), (R_high, L_high) = estimator.least, estimator.largest
        figures |= {
            "network believed for": f"R_g {R_low:.4g} to {R_high:.4g} Ohm, L_g {L_low * 1e3:.4g} to "
            f"{L_high * 1e3:.4g} mH",
            "sensors' limits": f"{estimator.v_limit:.4g} V, {estimator.i_limit:.4g} A",
            "window": f"{estimator.samples} samples of {origin.channels}, {origin.sample_interval * 1e6:g} us apart",
        }
    return figures


def braces(values: Any) -> str:
    """Nested lists of numbers as an initialiser."""
    if isinstance(values, list | tuple):
        joined = ", ".join(braces(value) for value in values)
        deep = bool(values) and isinstance(values[0], list | tuple)
        return "{\n" + joined.replace("}, {", "},\n{") + "\n}" if deep else "{" + joined + "}"
    return values if isinstance(values, str) else f"VSG_C({literal(values)})"


def initialiser(record: Any) -> str:
    """A NamedTuple of numbers as the initialiser of its C struct: gains, set points or settings of the controller."""
    values = [initialiser(value) if isinstance(value, tuple) else f"VSG_C({literal(value)})" for value in record]
    return f"{{{', '.join(value for value in values if value != '{}')}}}"


def _comment(text: str) -> str:
    """A text that cannot end a comment, or be anything but one line of ASCII."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").encode("ascii", "replace").decode().split())
