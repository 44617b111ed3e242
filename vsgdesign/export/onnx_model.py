"""The estimator as ONNX with its scaling: it takes V and A and gives Ω and H. It needs the extra ``onnx``."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign import __version__
from vsgdesign.artifacts.files import check_file_target, staged_file
from vsgdesign.artifacts.network_weights import NetworkWeights, read_network_weights
from vsgdesign.errors import ArtifactError
from vsgdesign.identification.neural import fold

PRODUCER = "vsgdesign"
OPSET = 17
_SEAL = "sha256"
_WHAT = "an exported network"


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
        nodes,
        "grid impedance",
        [helper.make_tensor_value_info("window", kind, ["N", weights.window.length])],
        [helper.make_tensor_value_info("grid", kind, ["N", 2])],
        [numpy_helper.from_array(values, name) for name, values in constants.items()],
    )
    model = helper.make_model(
        graph,
        producer_name=PRODUCER,
        producer_version=__version__,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=9,
    )
    window = weights.window
    helper.set_model_props(
        model,
        {
            "channels": window.channels,
            "samples": str(window.samples),
            "sample_interval_s": repr(window.sample_interval),
            "synchronised": str(window.synchronised).lower(),
            "outputs": "R_g in ohm, L_g in henry",
            "trained_R_g": " ".join(map(repr, weights.trained_on["R_g"])),
            "trained_L_g": " ".join(map(repr, weights.trained_on["L_g"])),
            "weights_sha256": weights.hash,
        },
    )
    return _sealed(model)


def export_onnx(weights: str | Path, out: str | Path, *, double: bool = False) -> str:
    """A weights file as an ONNX file, whole or not at all; the sha256 of the weights comes back.

    Only an unchanged earlier export is replaced. Raises ArtifactError with what to do.
    """
    found = read_network_weights(weights)
    check_file_target(out, _WHAT, _is_unchanged)
    content = onnx_bytes(found, double=double)
    with staged_file(out, _WHAT, _is_unchanged) as place:
        place.write_bytes(content)
    return found.hash


def _sealed(model: Any) -> bytes:
    """The bytes of the model, with the hash that they had before it was added."""
    digest = hashlib.sha256(model.SerializeToString(deterministic=True)).hexdigest()
    model.metadata_props.add(key=_SEAL, value=digest)
    return model.SerializeToString(deterministic=True)


def _is_unchanged(path: Path) -> bool:
    """Whether vsgdesign wrote the file and nobody has changed it since."""
    import onnx

    try:
        data = path.read_bytes()
        model = onnx.load_model_from_string(data)
        said = model.metadata_props.pop()
        return said.key == _SEAL and _sealed(model) == data and said.value == model.metadata_props[-1].value
    except Exception:  # noqa: BLE001  the parser's own classes of errors are many
        return False
