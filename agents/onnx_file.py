"""A policy as an ONNX graph, for run-times of other machines.

Inputs: ``observation`` (n, frames·size) float32, frames oldest first and those before an episode 0, as the environment
gives them; for each LSTM ``hidden_i`` and ``cell_i`` (n, outputs), for each GRU ``hidden_i``, 0 when an episode begins;
for a policy with a range
``trust`` (n, 1), −1 when one begins. Outputs: ``action`` (n, k) in −1 … 1, and ``next_hidden_i``, ``next_cell_i``,
``next_trust``. The normaliser is inside. With a normaliser ahead of the frame stack the graph takes frames that were
not normalised, 0 before the episode standing for "none".
"""

from pathlib import Path
from typing import Any

import numpy as np

from .network import FALL, REMEMBER, RISE, Network
from .policy import Policy

OPSET = 17
"""Of the operators; run-times since 2022 have it."""

LSTM = """
    joined_{i} = Concat <axis = 1> ({x}, hidden_{i})
    gates_{i} = Gemm <transB = 1> (joined_{i}, weight_{i}, bias_{i})
    gate_{i}_0, gate_{i}_1, gate_{i}_2, gate_{i}_3 = Split <axis = 1> (gates_{i})
    enter_{i} = Sigmoid (gate_{i}_0)
    forget_{i} = Sigmoid (gate_{i}_1)
    candidate_{i} = Tanh (gate_{i}_2)
    out_{i} = Sigmoid (gate_{i}_3)
    kept_{i} = Mul (forget_{i}, cell_{i})
    new_{i} = Mul (enter_{i}, candidate_{i})
    next_cell_{i} = Add (kept_{i}, new_{i})
    level_{i} = Tanh (next_cell_{i})
    next_hidden_{i} = Mul (out_{i}, level_{i})
"""
"""A layer with memory (:func:`network.run`), in ONNX' own words; ``x`` is what it takes."""

GRU = """
    joined_{i} = Concat <axis = 1> ({x}, hidden_{i})
    gates_{i} = Gemm <transB = 1> (joined_{i}, weight_{i}, bias_{i})
    gate_{i}_0, gate_{i}_1, gate_{i}_2, gate_{i}_3 = Split <axis = 1> (gates_{i})
    reset_{i} = Sigmoid (gate_{i}_0)
    update_{i} = Sigmoid (gate_{i}_1)
    past_{i} = Mul (reset_{i}, gate_{i}_3)
    sum_{i} = Add (gate_{i}_2, past_{i})
    candidate_{i} = Tanh (sum_{i})
    off_{i} = Sub (hidden_{i}, candidate_{i})
    kept_{i} = Mul (update_{i}, off_{i})
    next_hidden_{i} = Add (candidate_{i}, kept_{i})
"""
"""The same of a layer without cells."""

NORMALISED = """
    wide = Cast <to = 11> (observation)
    off = Sub (wide, mean)
    scaled = Div (off, scale)
    limited = Clip (scaled, least, most)
    normalised = Cast <to = 1> (limited)
"""
"""In double precision."""

TRUSTED = """
    x = Gather <axis = 1> (observation, which)
    under = Sub (low, x)
    over = Sub (x, high)
    farther = Max (under, over)
    margins = Div (farther, margin)
    farthest = ReduceMax <axes = [1], keepdims = 1> (margins)
    lost = Clip (farthest, none, highest)
    wanted = Sub (highest, lost)
    gap = Sub (wanted, trust)
    change = Clip (gap, fall, rise)
    moved = Add (trust, change)
    unknown = Less (trust, none)
    next_trust = Where (unknown, wanted, moved)
    action = Mul (wish, next_trust)
"""
"""The range that the policy was trained in (:func:`network.trusted`)."""

UNSEEN = """
    frames = Reshape (observation, each)
    sizes = Abs (frames)
    size = ReduceMax <axes = [2], keepdims = 1> (sizes)
    there = Greater (size, nothing)
    scaled_frames = Reshape (normalised, each)
    seen_frames = Where (there, scaled_frames, nothing)
    seen = Reshape (seen_frames, all)
"""
"""Frames before the episode were never normalised: they stay 0."""


def write(policy: Policy, path: Path) -> Path | None:
    """Writes the graph; None if the package onnx is not installed."""
    try:
        import onnx
    except ModuleNotFoundError:
        return None
    text, numbers = described(policy.network)
    model = onnx.parser.parse_model(text)
    model.graph.initializer.extend(onnx.numpy_helper.from_array(each, name) for name, each in numbers.items())
    document = policy.document
    about = {"environment": document.environment, "control": document.control, "weights_sha256": document.weights}
    onnx.helper.set_model_props(model, about)
    onnx.checker.check_model(model, full_check=True)
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(model.SerializeToString())
    part.replace(path)
    return path


def described(network: Network) -> tuple[str, dict[str, np.ndarray]]:
    """The graph in ONNX' own words, in the order of the signal, and its numbers by name."""
    n, x, text = network.normaliser, "observation", ""
    inputs, outputs = {x: network.size * network.frames}, {"action": network.actions}
    numbers: dict[str, Any] = {"lowest": np.float32(-1.0), "highest": np.float32(1.0)}
    if n is not None:
        repeat = 1 if network.normalises_frames else network.frames
        numbers |= {"mean": np.tile(n.mean, repeat), "scale": np.tile(n.scale, repeat)}
        numbers |= {"least": np.float64(-n.clip), "most": np.float64(n.clip)}
        text, x = NORMALISED, "normalised"
        if repeat > 1:
            numbers |= {"each": np.array([0, repeat, network.size]), "all": np.array([0, repeat * network.size])}
            numbers["nothing"] = np.float32(0.0)
            text, x = text + UNSEEN, "seen"
    for i, layer in enumerate(network.layers):
        numbers |= {f"weight_{i}": layer.weight, f"bias_{i}": layer.bias}
        if layer.kind in REMEMBER:
            kept = ("hidden", "cell") if layer.kind == "lstm" else ("hidden",)
            inputs |= {f"{name}_{i}": layer.outputs for name in kept}
            outputs |= {f"next_{name}_{i}": layer.outputs for name in kept}
            text, x = text + (LSTM if layer.kind == "lstm" else GRU).format(i=i, x=x), f"next_hidden_{i}"
        else:
            kind = {"none": "Identity", "tanh": "Tanh", "relu": "Relu"}[layer.activation]
            text += f"y_{i} = Gemm <transB = 1> ({x}, weight_{i}, bias_{i}) x_{i} = {kind} (y_{i})\n"
            x = f"x_{i}"
    wish = f"Tanh ({x})" if network.output == "tanh" else f"Clip ({x}, lowest, highest)"
    if network.known:
        known = network.known._asdict()
        newest = known.pop("which") + network.size * (network.frames - 1)
        numbers |= {"which": newest, **known, "none": np.float32(0.0), "fall": -FALL, "rise": RISE}
        inputs["trust"] = outputs["next_trust"] = 1
        text += f"wish = {wish}" + TRUSTED
    else:
        text += f"action = {wish}"
    given, made = (", ".join(f"float[n, {many}] {name}" for name, many in of.items()) for of in (inputs, outputs))
    head = f'<ir_version: 8, opset_import: ["": {OPSET}], producer_name: "kerfgym">'
    return f"{head} policy ({given}) => ({made}) {{ {text} }}", {k: np.array(v, order="C") for k, v in numbers.items()}
