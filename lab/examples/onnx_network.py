"""A network trained outside of Tactus, from its training set to an ONNX file that its programs load.

usage: python3 onnx_network.py SET OUT.onnx [NEURONS]      (pip install onnx)

SET is a folder that `tactus-lab dataset` filled; shards are read as they lie there. What is fitted here, one layer of
random elu neurons and least squares after it, stands for anybody's own training: with PyTorch or MATLAB replace `fit`, and
write the file by torch.onnx.export or exportONNXNetwork. What Tactus asks of the file:

- one f32 input, a number a reading in the protocol's order: (v - v0) / max|v0|; one f32 output, a number a triangle of the
  region: the relative change of conductance. Other dimensions are 1 or left open.
- metadata properties tactus.survey and tactus.geometry, from the shards' header. Without them only the counts are checked.
"""

import json
import pathlib
import sys

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

NOISE = 2e-6 / 1e-3  # 2 uV at 1 mA, on baseline and frame, ohm


def read(folder):
    """Header, baseline, inputs (cases x readings) and targets (cases x triangles) of all shards."""
    manifests = [json.loads(path.read_text()) for path in sorted(pathlib.Path(folder).glob("*.json"))]
    inputs, targets = [], []
    for manifest in sorted(manifests, key=lambda manifest: manifest["first"]):
        header = manifest["header"]
        with open(pathlib.Path(folder) / manifest["file"], "rb") as shard:
            shard.readline()
            baseline = np.frombuffer(shard.read(8 * header["inputs"]), "<f8")
            for _ in range(manifest["cases"]):
                (changes,) = np.frombuffer(shard.read(4), "<u4")
                inputs.append(np.frombuffer(shard.read(4 * header["inputs"]), "<f4"))
                pairs = np.frombuffer(shard.read(8 * int(changes)), [("triangle", "<u4"), ("change", "<f4")])
                target = np.zeros(header["outputs"], np.float32)
                target[pairs["triangle"]] = pairs["change"]
                targets.append(target)
    return header, baseline, np.array(inputs), np.array(targets)


def fit(baseline, inputs, targets, neurons):
    """Mean and deviation of the inputs, and weights and biases of two layers."""
    random = np.random.default_rng(1)
    noisy = inputs + random.normal(0, NOISE * 2**0.5 / np.abs(baseline).max(), inputs.shape)
    mean, deviation = noisy.mean(0), noisy.std(0) + 1e-9
    count = inputs.shape[1]
    first = random.normal(0, count**-0.5, (count, neurons))
    shift = random.normal(0, 1, neurons)
    hidden = (noisy - mean) / deviation @ first + shift
    hidden = np.where(hidden > 0, hidden, np.expm1(np.minimum(hidden, 0)))
    hidden = np.hstack([hidden, np.ones((len(hidden), 1))])
    gram = hidden.T @ hidden
    gram += 1e-3 * np.trace(gram) / len(gram) * np.eye(len(gram))
    second = np.linalg.solve(gram, hidden.T @ targets)
    return mean, deviation, first, shift, second[:-1], second[-1]


def main():
    if len(sys.argv) not in (3, 4):
        sys.exit("usage: python3 onnx_network.py SET OUT.onnx [NEURONS]")
    header, baseline, inputs, targets = read(sys.argv[1])
    neurons = int(sys.argv[3]) if len(sys.argv) > 3 else min(400, len(inputs) // 2)
    names = ["mean", "deviation", "w1", "b1", "w2", "b2"]
    values = fit(baseline, inputs, targets, neurons)
    nodes = [
        helper.make_node("Sub", ["readings", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "deviation"], ["normalised"]),
        helper.make_node("Gemm", ["normalised", "w1", "b1"], ["linear"]),
        helper.make_node("Elu", ["linear"], ["hidden"]),
        helper.make_node("Gemm", ["hidden", "w2", "b2"], ["map"]),
    ]
    graph = helper.make_graph(
        nodes,
        "elsewhere",
        [helper.make_tensor_value_info("readings", TensorProto.FLOAT, ["batch", header["inputs"]])],
        [helper.make_tensor_value_info("map", TensorProto.FLOAT, ["batch", header["outputs"]])],
        [numpy_helper.from_array(value.astype(np.float32), name) for name, value in zip(names, values)],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"tactus.survey": header["survey"], "tactus.geometry": header["geometry"]})
    onnx.checker.check_model(model)
    onnx.save(model, sys.argv[2])
    print(f"{sys.argv[2]}: {len(inputs)} cases, {neurons} neurons")


main()
