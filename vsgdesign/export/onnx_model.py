"""The estimator as ONNX, its scaling inside: V and A in, Ω and H out. Needs the extra ``onnx``."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from vsgdesign import __version__
from vsgdesign.artifacts.network_weights import NetworkWeights, read_network_weights
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime.network import fold

PRODUCER = "vsgdesign"
OPSET = 17


def onnx_bytes(weights: NetworkWeights, *, double: bool = False) -> bytes:
    """A model with input ``window`` (N, length) in V and A, voltages first, and output ``grid`` (N, 2) in Ω and H
    (:eq:`fold-scaling`). Equal weights give equal bytes. Raises ArtifactError without the package."""
    try:
        from onnx import TensorProto, helper, numpy_helper
    except ImportError as error:
        raise ArtifactError('the package onnx is not installed. Install vsgdesign with the extra "onnx".') from error
    kind, number = (TensorProto.DOUBLE, np.float64) if double else (TensorProto.FLOAT, np.float32)
    W_1, b_1, W_2, b_2 = (array.astype(number) for array in fold(weights.network))
    constants = {"W_1": W_1.T.copy(), "b_1": b_1, "W_2": W_2.T.copy(), "b_2": b_2}
    nodes = [
        helper.make_node("MatMul", ["window", "W_1"], ["products"]),
        helper.make_node("Add", ["products", "b_1"], ["sums"]),
        helper.make_node("Tanh", ["sums"], ["hidden"]),
        helper.make_node("MatMul", ["hidden", "W_2"], ["mixed"]),
        helper.make_node("Add", ["mixed", "b_2"], ["grid"]),
    ]
    graph = helper.make_graph(
        nodes, "grid impedance",
        [helper.make_tensor_value_info("window", kind, ["N", weights.window.length])],
        [helper.make_tensor_value_info("grid", kind, ["N", 2])],
        [numpy_helper.from_array(values, name) for name, values in constants.items()],
    )  # fmt: skip
    model = helper.make_model(
        graph, producer_name=PRODUCER, producer_version=__version__, opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=9,
    )  # fmt: skip
    window = weights.window
    helper.set_model_props(model, {
        "channels": window.channels, "samples": str(window.samples), "sample_interval_s": repr(window.sample_interval),
        "synchronised": str(window.synchronised).lower(), "outputs": "R_g in ohm, L_g in henry",
        "trained_R_g": " ".join(map(repr, weights.trained_on["R_g"])),
        "trained_L_g": " ".join(map(repr, weights.trained_on["L_g"])), "weights_sha256": weights.hash,
    })  # fmt: skip
    return model.SerializeToString(deterministic=True)


def export_onnx(weights: str | Path, out: str | Path, *, double: bool = False) -> str:
    """A weights file as an ONNX file, whole or not at all; the sha256 of the weights comes back.

    Only an earlier export is replaced. Raises ArtifactError with what to do.
    """
    found, out = read_network_weights(weights), Path(out)
    try:
        if out.exists() and PRODUCER.encode() not in out.read_bytes()[:64]:
            raise ArtifactError(f'"{out}" is no exported network and is left untouched. Give another file.')
        content = onnx_bytes(found, double=double)
        handle, name = tempfile.mkstemp(prefix=f".{out.name}.", dir=out.parent)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
            os.chmod(name, 0o644)
            os.replace(name, out)
        finally:
            Path(name).unlink(missing_ok=True)
    except OSError as error:
        raise ArtifactError(f'cannot write "{out}": {error.strerror}. Give a file in a folder that exists.') from error
    return found.hash
