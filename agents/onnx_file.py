"""A policy as an ONNX graph, for run-times of other machines.

Inputs: ``observation`` (n, frames·size) float32, frames oldest first and those before an episode 0, as the environment
gives them; for each LSTM ``hidden_i`` and ``cell_i`` (n, outputs), 0 when an episode begins. Outputs: ``action`` (n, k)
in −1 … 1, and ``next_hidden_i``, ``next_cell_i``. The normaliser is inside. With a normaliser ahead of the frame stack
the graph takes frames that were not normalised, 0 before the episode standing for "none".
"""

from pathlib import Path
from typing import Any

import numpy as np

from .network import Network
from .policy import Policy

OPSET = 17
"""Of the operators; run-times since 2022 have it."""


def write(policy: Policy, path: Path) -> Path | None:
    """Writes the graph; None if the package onnx is not installed."""
    try:
        import onnx
    except ModuleNotFoundError:
        return None
    graph = _Graph(policy.network)
    model = onnx.helper.make_model(
        onnx.helper.make_graph(graph.nodes, "policy", graph.inputs, graph.outputs, graph.constants),
        opset_imports=[onnx.helper.make_opsetid("", OPSET)], producer_name="kerfgym", ir_version=8,
    )  # fmt: skip
    document = policy.document
    about = {"environment": document.environment, "control": document.control, "weights_sha256": document.weights}
    onnx.helper.set_model_props(model, about)
    onnx.checker.check_model(model, full_check=True)
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(model.SerializeToString())
    part.replace(path)
    return path


class _Graph:
    """The nodes of a network, in the order of the signal."""

    def __init__(self, network: Network) -> None:
        import onnx

        self._onnx = onnx
        self.nodes: list[Any] = []
        self.inputs: list[Any] = []
        self.outputs: list[Any] = []
        self.constants: list[Any] = []
        self._count = 0
        x = self._normalised(network, self._input("observation", network.size * network.frames))
        for i, layer in enumerate(network.layers):
            if layer.kind == "lstm":
                hidden, cell = self._input(f"hidden_{i}", layer.outputs), self._input(f"cell_{i}", layer.outputs)
                joined = self._node("Concat", x, hidden, axis=1)
                gates = self._linear(layer.weight, layer.bias, joined)
                enter, forget, candidate, out = (self._slice(gates, k, layer.outputs) for k in range(4))
                kept = self._node("Mul", self._node("Sigmoid", forget), cell)
                new = self._node("Mul", self._node("Sigmoid", enter), self._node("Tanh", candidate))
                cell = self._node("Add", kept, new)
                x = self._node("Mul", self._node("Sigmoid", out), self._node("Tanh", cell))
                self._output(f"next_hidden_{i}", x, layer.outputs)
                self._output(f"next_cell_{i}", cell, layer.outputs)
            else:
                x = self._linear(layer.weight, layer.bias, x)
                if layer.activation != "none":
                    x = self._node({"tanh": "Tanh", "relu": "Relu"}[layer.activation], x)
        one = [self._constant(np.float32(v)) for v in (-1.0, 1.0)]
        x = self._node("Tanh", x) if network.output == "tanh" else self._node("Clip", x, *one)
        self._output("action", x, network.actions)

    def _normalised(self, network: Network, x: str) -> str:
        n = network.normaliser
        if n is None:
            return x
        repeat = 1 if network.normalises_frames else network.frames
        mean, scale = self._constant(np.tile(n.mean, repeat)), self._constant(np.tile(n.scale, repeat))
        wide = self._node("Cast", x, to=self._onnx.TensorProto.DOUBLE)
        scaled = self._node("Div", self._node("Sub", wide, mean), scale)
        limits = [self._constant(np.float64(v)) for v in (-n.clip, n.clip)]
        y = self._node("Cast", self._node("Clip", scaled, *limits), to=self._onnx.TensorProto.FLOAT)
        if network.frames == 1 or network.normalises_frames:
            return y
        # Frames before the episode were never normalised: they stay 0.
        shape = self._constant(np.array([0, network.frames, network.size], np.int64))
        back = self._constant(np.array([0, network.frames * network.size], np.int64))
        size = self._node("ReduceMax", self._node("Abs", self._node("Reshape", x, shape)), axes=[2], keepdims=1)
        there = self._node("Greater", size, self._constant(np.float32(0.0)))
        none = self._constant(np.float32(0.0))
        return self._node("Reshape", self._node("Where", there, self._node("Reshape", y, shape), none), back)

    def _linear(self, weight: np.ndarray, bias: np.ndarray, x: str) -> str:
        return self._node("Gemm", x, self._constant(weight), self._constant(bias), transB=1)

    def _slice(self, x: str, k: int, size: int) -> str:
        ends = [self._constant(np.array([v], np.int64)) for v in (k * size, (k + 1) * size, 1)]
        return self._node("Slice", x, *ends)

    def _name(self) -> str:
        self._count += 1
        return f"x{self._count}"

    def _node(self, kind: str, *inputs: str, **attributes: Any) -> str:
        name = self._name()
        self.nodes.append(self._onnx.helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def _constant(self, array: Any) -> str:
        name = self._name()
        self.constants.append(self._onnx.numpy_helper.from_array(np.array(array, order="C"), name))
        return name

    def _tensor(self, name: str, width: int) -> Any:
        return self._onnx.helper.make_tensor_value_info(name, self._onnx.TensorProto.FLOAT, ["n", width])

    def _input(self, name: str, width: int) -> str:
        self.inputs.append(self._tensor(name, width))
        return name

    def _output(self, name: str, x: str, width: int) -> None:
        self.nodes.append(self._onnx.helper.make_node("Identity", [x], [name]))
        self.outputs.append(self._tensor(name, width))
