"""The ONNX file in onnxruntime against the network unfolded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.cli.small_studies import call
from tests.export.exchange import windows
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.errors import ArtifactError
from vsgdesign.export.onnx_model import export_onnx, onnx_bytes

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


@pytest.mark.parametrize("channels", ["phase_a", "dq"])
@pytest.mark.parametrize(("double", "tolerance"), [(True, 1e-12), (False, 2e-6)])
def test_onnxruntime_gives_the_networks_answer(channels: str, double: bool, tolerance: float, tmp_path: Path) -> None:
    """Of the trained range."""
    weights = random_weights(3, channels=channels)
    write_network_weights(weights, tmp_path / "w.json")
    export_onnx(tmp_path / "w.json", tmp_path / "w.onnx", double=double)
    onnx.checker.check_model(str(tmp_path / "w.onnx"), full_check=True)
    session = onnxruntime.InferenceSession(str(tmp_path / "w.onnx"), providers=["CPUExecutionProvider"])
    x = windows(50, 8)
    x = x.reshape(50, -1) if channels == "phase_a" else np.repeat(x, 2, axis=1).reshape(50, -1)
    (got,) = session.run(None, {"window": x.astype(np.float64 if double else np.float32)})
    size = np.array([weights.trained_on[name][1] - weights.trained_on[name][0] for name in ("R_g", "L_g")])
    assert np.all(np.abs(got - weights.network.evaluate(x)) <= tolerance * size)
    properties = {item.key: item.value for item in onnx.load(str(tmp_path / "w.onnx")).metadata_props}
    assert properties["weights_sha256"] == weights.hash
    assert properties["channels"] == channels


def test_equal_weights_give_equal_bytes() -> None:
    assert onnx_bytes(random_weights(3)) == onnx_bytes(random_weights(3)) != onnx_bytes(random_weights(4))


def test_the_verb_and_what_it_leaves_alone(tmp_path: Path) -> None:
    write_network_weights(random_weights(3), tmp_path / "w.json")
    for _ in range(2):  # the second replaces the first
        shown = call("export", "onnx", tmp_path / "w.json", "--out", tmp_path / "w.onnx")
        assert shown.exit_code == 0
    (tmp_path / "mine").write_text("notes", encoding="utf-8")
    refused = call("export", "onnx", tmp_path / "w.json", "--out", tmp_path / "mine")
    assert refused.exit_code == 2
    assert (tmp_path / "mine").read_text(encoding="utf-8") == "notes"
    changed = (tmp_path / "w.onnx").read_bytes().replace(b"vsgdesign", b"my_editor")
    (tmp_path / "w.onnx").write_bytes(changed)
    with pytest.raises(ArtifactError, match="is not an exported network as it was written"):
        export_onnx(tmp_path / "w.json", tmp_path / "w.onnx")
    assert (tmp_path / "w.onnx").read_bytes() == changed
    export_onnx(tmp_path / "w.json", tmp_path / "none" / "w.onnx")
