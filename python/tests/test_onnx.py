"""Networks trained elsewhere, as ONNX files, run by the ONNX Runtime of the package onnxruntime."""

import importlib.util

import numpy as np
import pytest

from tactus_eit import Network


@pytest.fixture
def weights(forward):
    shape = len(forward.protocol), len(forward.mesh.region)
    return np.random.default_rng(3).normal(0.0, 0.01, shape).astype(np.float32)


def write(path, weights, **properties):
    """A linear network; every dimension but those of the weights is open."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    tensor, value = onnx.TensorProto.FLOAT, onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["readings", "weights"], ["map"])],
        "linear",
        [value("readings", tensor, ["batch", weights.shape[0]])],
        [value("map", tensor, ["batch", weights.shape[1]])],
        [onnx.numpy_helper.from_array(weights, "weights")],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
    onnx.helper.set_model_props(model, {f"tactus.{name}": text for name, text in properties.items()})
    onnx.save(model, path)
    return path


def test_maps_are_those_of_onnx_runtime(forward, baseline, frame, weights, tmp_path):
    path = write(tmp_path / "linear.onnx", weights, survey=forward.protocol.hash, geometry=forward.mesh.hash)
    model = Network(forward, path).fit(baseline)
    empty = model.baseline_
    change = ((frame - empty) / np.abs(empty).max()).astype(np.float32)
    import onnxruntime

    (expected,) = onnxruntime.InferenceSession(path).run(None, {"readings": change[None]})
    np.testing.assert_array_equal(model.predict(frame), expected[0])
    assert model.method_ == "onnx linear" and any("names this survey and geometry" in note for note in model.notes_)
    clipped = Network(forward, path, losses_only=True).fit(baseline).predict(frame)
    np.testing.assert_array_equal(clipped, np.clip(expected[0], -1.0, 0.0))


def test_networks_for_another_sheet_are_refused(forward, baseline, weights, tmp_path):
    with pytest.raises(ValueError, match="'readings'.*199.*208"):
        Network(forward, write(tmp_path / "short.onnx", weights[:199])).fit(baseline)
    with pytest.raises(ValueError, match="trained for survey 0123"):
        Network(forward, write(tmp_path / "other.onnx", weights, survey="0123")).fit(baseline)
    torn = tmp_path / "torn.onnx"
    torn.write_bytes(b"\x08\x08\x3a")
    with pytest.raises(ValueError, match="torn.onnx cannot be used"):
        Network(forward, torn).fit(baseline)


def test_missing_runtime_is_named(forward, baseline, tmp_path, monkeypatch):
    monkeypatch.delenv("ORT_DYLIB_PATH", raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    path = tmp_path / "some.onnx"
    path.write_bytes(b"")
    with pytest.raises(ImportError, match="some.onnx.*pip install onnxruntime.*ORT_DYLIB_PATH"):
        Network(forward, path).fit(baseline)
