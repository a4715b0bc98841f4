"""Weights to start from: of a model of ours, or of a public YOLOX checkpoint.

Ours and PyTorch's checkpoints hold every weight under its name. The ONNX exports of YOLOX
(https://github.com/Megvii-BaseDetection/YOLOX) have the normalisation folded into their convolutions and
number most of them; they follow one another as the network calls its convolutions.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skysweep.arrays import F32
from skysweep.detection.coco import default_names
from skysweep.detection.model_files import MAX_MODEL_BYTES, sha256_of
from skysweep.errors import MissingExtraError, UserError

_EPS = 1e-3  # of YOLOX's batch normalisation
_STEM = "backbone.backbone.stem.conv.conv.weight"
_STEM_PER_WIDTH = 64  # filters of the first convolution, at width 1


class Family(NamedTuple):
    """A size of YOLOX."""

    depth: float
    width: float
    depthwise: bool


OWN = Family(0.33, 0.25, False)
_FAMILIES = (OWN, Family(0.33, 0.25, True), Family(0.33, 0.375, False), Family(0.33, 0.5, False))


@dataclass(frozen=True)
class _Held:
    """The content of a file: weights by name, or convolutions in their order; the classes by number."""

    by_name: Mapping[str, F32]
    convolutions: Sequence[tuple[F32, F32 | None]]  # weight and bias
    class_names: Mapping[int, str]

    @property
    def stem(self) -> F32:
        """The weight of the first convolution."""
        return self.by_name[_STEM] if _STEM in self.by_name else self.convolutions[0][0]

    @property
    def is_depthwise(self) -> bool:
        """Whether a convolution beside the stem has one channel a filter."""
        weights = [*self.by_name.values(), *(weight for weight, _ in self.convolutions)]
        return any(w.ndim == 4 and w.shape[1] == 1 and w.shape[2] > 1 for w in weights)


def family_of(path: Path) -> Family:
    """The size of the network in a file. Raises UserError where it is no YOLOX from nano to s."""
    held = _read(path)
    width = held.stem.shape[0] / _STEM_PER_WIDTH
    found = next((f for f in _FAMILIES if (f.width, f.depthwise) == (width, held.is_depthwise)), None)
    if found is None:
        raise UserError(
            f"{path}: is no YOLOX of a size that can be trained here; give a nano, tiny or s, or a model "
            "that 'skysweep train' wrote"
        )
    return found


def load_weights(network: Any, path: Path, class_names: Sequence[str]) -> None:
    """Copy a file's weights into a network of its family, those of the class head by class name.

    Raises UserError if they do not fit.
    """
    held, new = _read(path), network.state_dict()
    numbered = held.class_names.items()
    rows = [(i, k) for i, name in enumerate(class_names) for k, theirs in numbered if theirs == name]
    given = held.by_name or _named(network, held.convolutions, path)
    if not {key for key, value in new.items() if value.ndim == 4} <= set(given):
        raise _foreign(path)
    import torch

    for key, value in new.items():
        if key not in given:  # the exporter merges equal arrays, which only barely trained networks have
            continue
        weights = torch.from_numpy(np.array(given[key]))
        if key.startswith("head.cls_preds"):
            for to, origin in rows:
                value[to] = weights[origin]
        elif weights.shape == value.shape:
            value.copy_(weights)
        else:
            raise _foreign(path)
    network.load_state_dict(new)


def _named(network: Any, convolutions: Sequence[tuple[F32, F32 | None]], path: Path) -> dict[str, F32]:
    """Folded convolutions by the names of the network's; the normalisation after each does nothing."""
    import torch

    order: list[str] = []
    names = {module: name for name, module in network.named_modules() if isinstance(module, torch.nn.Conv2d)}
    hooks = [m.register_forward_hook(lambda module, *_: order.append(names[module])) for m in names]
    network.eval()
    with torch.no_grad():
        network(torch.zeros(1, 3, 64, 64))
    for hook in hooks:
        hook.remove()
    network.train()
    if len(order) != len(convolutions):
        raise _foreign(path)
    state, found = network.state_dict(), dict[str, F32]()
    for name, (weight, bias) in zip(order, convolutions, strict=True):
        is_class_head = name.startswith("head.cls_preds")
        if not is_class_head and tuple(state[f"{name}.weight"].shape) != weight.shape:
            raise _foreign(path)
        found[f"{name}.weight"] = weight
        normalised = f"{name.removesuffix('conv')}bn"
        if f"{name}.bias" in state:
            found[f"{name}.bias"] = np.zeros(len(weight), np.float32) if bias is None else bias
        elif f"{normalised}.weight" in state:
            n = len(weight)
            found[f"{normalised}.weight"] = np.ones(n, np.float32)
            found[f"{normalised}.bias"] = np.zeros(n, np.float32) if bias is None else bias
            found[f"{normalised}.running_mean"] = np.zeros(n, np.float32)
            found[f"{normalised}.running_var"] = np.full(n, 1.0 - _EPS, np.float32)
    return found


def _read(path: Path) -> _Held:
    if not path.is_file():
        raise UserError(
            f"{path}: there is no such model to fine-tune; write the path of an ONNX or .pth file"
        )
    if path.stat().st_size > MAX_MODEL_BYTES:
        raise UserError(f"{path}: is larger than {MAX_MODEL_BYTES / 1e9:g} GB; give a smaller model")
    return _read_once(path, sha256_of(path))


@lru_cache(maxsize=1)
def _read_once(path: Path, _sha256: str) -> _Held:
    try:
        held = _from_onnx(path) if path.suffix.lower() == ".onnx" else _from_pytorch(path)
    except ImportError as error:
        raise MissingExtraError("fine-tuning", "train") from error
    except Exception as error:  # the errors of protobuf and of pickles have no common base
        raise _foreign(path) from error
    if _STEM not in held.by_name and not held.convolutions:
        raise _foreign(path)
    return held


def _from_pytorch(path: Path) -> _Held:
    """A checkpoint as YOLOX writes it. Only tensors are unpickled, so that a file cannot run code."""
    import torch

    content = torch.load(path, map_location="cpu", weights_only=True)
    state = content.get("model", content)
    weights = {name: value.numpy() for name, value in state.items()}
    names = default_names(len(weights["head.cls_preds.0.weight"])) or ()
    return _Held(weights, (), dict(enumerate(names)))


def _from_onnx(path: Path) -> _Held:
    import onnx

    model = onnx.load(str(path))
    weights = {i.name: onnx.numpy_helper.to_array(i) for i in model.graph.initializer}
    told = {p.key: p.value for p in model.metadata_props}.get("names")
    if told is not None and _STEM in weights:
        return _Held(weights, (), {int(k): str(name) for k, name in json.loads(told).items()})
    convolutions = [
        (weights[node.input[1]], weights[node.input[2]] if len(node.input) > 2 else None)
        for node in model.graph.node
        if node.op_type == "Conv"
    ]
    n_classes = len(weights["head.cls_preds.0.weight"]) if "head.cls_preds.0.weight" in weights else 80
    names = default_names(n_classes) or ()
    return _Held({}, convolutions, dict(enumerate(names)))


def _foreign(path: Path) -> UserError:
    return UserError(
        f"{path}: neither a model that 'skysweep train' wrote nor a YOLOX checkpoint (nano to s); fine-tune "
        "one of those"
    )
