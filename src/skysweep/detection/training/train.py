"""Training of the small detector: YOLOX (arXiv:2107.08430) with depth 0.33 and width 0.25, on a CPU.

The exported ONNX file keeps batch normalisation apart and every weight under its own name, so that it is at
once what missions run and what fine-tuning starts from. ONNX Runtime folds the normalisation when it loads.
"""

from __future__ import annotations

import contextlib
import copy
import json
import math
import sys
import time
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F32, F64, U8
from skysweep.detection.model_files import model_file
from skysweep.detection.network import PAD_GREY
from skysweep.detection.photos.pixels import read_picture
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage
from skysweep.detection.training.reading import read_dataset
from skysweep.detection.training.weights import OWN, Family, family_of, load_weights
from skysweep.errors import MissingExtraError, UserError
from skysweep.files.writing import make_folder, whole_files

SIDE_PX = 320
BATCH = 16
PEAK_LEARNING_RATE = 2e-3
FINE_TUNING_SHARE = 0.25  # of that rate
WEIGHT_DECAY = 1e-2
EMA_DECAY = 0.998
WARM_UP_STEPS = 50
VISIBLE_MIN = 0.35  # share of a box; a crop that leaves less removes the label
MIN_BOX_PX = 3.0
MOSAIC_SHARE = 0.6  # of the samples are made of four pictures, each cut out around a label


def train_detector(
    dataset: Path,
    out: Path,
    *,
    minutes: float = 15.0,
    init: Path | str | None = None,
    learning_rate: float | None = None,
    seed: int = 0,
    threads: int = 2,
    progress: Callable[[float, float], None] = lambda share, loss: None,
) -> Path:
    """Train on a labelled data set and write an ONNX model.

    Args:
        dataset: COCO or YOLO folder (see :func:`skysweep.detection.training.reading.read_dataset`).
        out: the ONNX file to write.
        minutes: how long to train; the learning rate falls to nearly zero by then.
        init: a model to fine-tune: one that this function wrote, "skysweep" for the shipped one, or a public
            YOLOX checkpoint (.pth, .onnx; nano, tiny, s). Its class head is kept for classes of the same
            name. None starts from random weights.
        learning_rate: its peak; by default ``PEAK_LEARNING_RATE``, and a quarter of it to fine-tune.
        seed: seeds initial weights, sampling and augmentation. Two runs still differ: the number of steps
            that fit into the time depends on the machine.
        threads: copies of the network that work in parallel, one CPU core each.
        progress: called after every step with the share of the time that is over and the smoothed loss.

    Returns:
        ``out``. Ctrl-C during the training ends it early.

    Raises:
        UserError: the data set is malformed or has no labels, ``init`` is no YOLOX model, or ``out`` cannot
            be written.
        MissingExtraError: PyTorch or YOLOX is not installed.
    """
    if out.suffix.lower() != ".onnx":
        raise UserError(f"--out {out}: is no name of an ONNX file; write a name such as detector.onnx")
    torch = _torch()
    data = read_dataset(dataset)
    if not any(len(image.boxes_xyxy) for image in data.images):
        raise UserError(f"{dataset}: no picture has a label; a detector needs something to learn")
    make_folder(out.parent)
    torch.manual_seed(seed)
    rng = np.random.default_rng([seed, 23])
    network = _network(len(data.class_names), OWN if init is None else family_of(model_file(init)))
    network.head.initialize_biases(1e-2)
    if init is not None:
        load_weights(network, model_file(init), data.class_names)
    peak = learning_rate or PEAK_LEARNING_RATE * (FINE_TUNING_SHARE if init is not None else 1.0)
    average, steps = _optimise(network, data, rng, peak, minutes * 60, threads, progress)
    network.load_state_dict(average)
    command = f"skysweep train DATASET --minutes {minutes:g} --seed {seed} --learning-rate {peak:g}"
    if init is not None:
        command += f" --init {Path(init).name}"
    described: dict[str, Any] = {"images": len(data.images)}
    if data.path.suffix == ".json":
        described.update(json.loads(data.path.read_text()).get("info", {}))
    metadata = {
        "names": json.dumps(dict(enumerate(data.class_names))),
        "layout": "YOLOX",
        "command": command,
        "dataset": json.dumps(described),
        "steps": str(steps),
        "license": "Apache-2.0",
    }
    with whole_files(out.parent) as unfinished:
        _export(network, unfinished / out.name, metadata)
    return out


@lru_cache(maxsize=1)
def _torch() -> Any:
    """PyTorch, with YOLOX made importable without torchvision, which it needs for evaluation only."""
    try:
        import torch

        with contextlib.suppress(ImportError):
            import torchvision  # noqa: F401
        if "torchvision" not in sys.modules:
            absent = types.ModuleType("torchvision")
            absent.ops = types.ModuleType("torchvision.ops")  # type: ignore[attr-defined]
            sys.modules.update({"torchvision": absent, "torchvision.ops": absent.ops})
        import yolox.models  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("training", "train") from error
    return torch


def _network(n_classes: int, family: Family) -> Any:
    torch = _torch()
    from yolox.models import YoloPafpn, YoloxHead, YoloxModule

    separable = {"depthwise": True} if family.depthwise else {}
    network = YoloxModule(
        YoloPafpn(family.depth, family.width, **separable), YoloxHead(n_classes, family.width, **separable)
    )
    network.head.use_l1 = True
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.eps, module.momentum = 1e-3, 0.03
    return network


def _optimise(
    network: Any,
    data: LabelledDataset,
    rng: np.random.Generator,
    peak_learning_rate: float,
    seconds: float,
    threads: int,
    progress: Callable[[float, float], None],
) -> tuple[dict[str, Any], int]:
    """Train for a time, or until Ctrl-C.

    Returns the exponential moving average of the weights and the number of steps.
    """
    torch = _torch()
    network.train().to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(network.parameters(), peak_learning_rate, weight_decay=WEIGHT_DECAY)
    average = {k: v.clone() for k, v in network.state_dict().items()}
    started, steps, loss_mean = time.monotonic(), 0, float("nan")
    threads = min(threads, BATCH)
    one_core_each = ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
    with one_core_each as pool, ThreadPoolExecutor(1) as loader:
        replicas = _Replicas(network, threads, pool)
        batches = _batches(data, rng)
        upcoming = loader.submit(next, batches)
        try:
            while (share := (time.monotonic() - started) / seconds) < 1.0 or steps == 0:
                for group in optimiser.param_groups:
                    warm_up = min(1.0, (steps + 1) / WARM_UP_STEPS)
                    cosine = 0.5 * (1 + math.cos(math.pi * min(share, 1.0)))
                    group["lr"] = peak_learning_rate * warm_up * (0.01 + 0.99 * cosine)
                pictures, labels = upcoming.result()
                upcoming = loader.submit(next, batches)
                loss = replicas.gradients(pictures, labels)
                torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
                optimiser.step()
                steps += 1
                _update_average(average, network, steps)
                loss_mean = loss if steps == 1 else 0.95 * loss_mean + 0.05 * loss
                progress(min(share, 1.0), loss_mean)
            progress(1.0, loss_mean)
        except KeyboardInterrupt:
            if steps == 0:
                raise
    return average, steps


class _Replicas:
    """One copy of the network per thread, all with the same weights; each takes a part of every batch.

    On a busy machine this is far faster than one network on many threads: the copies synchronise once a step
    instead of once an operation.
    """

    def __init__(self, network: Any, threads: int, pool: ThreadPoolExecutor) -> None:
        self._pool = pool
        self._copies = [network, *(copy.deepcopy(network) for _ in range(threads - 1))]
        for replica in self._copies[1:]:
            for own, shared in zip(replica.parameters(), network.parameters(), strict=True):
                own.data = shared.data

    def gradients(self, pictures: F32, labels: F32) -> float:
        """Leave the mean gradient in the first copy and return the mean loss."""
        parts = np.array_split(np.arange(len(pictures)), len(self._copies))
        jobs = [(c, pictures[part], labels[part]) for c, part in zip(self._copies, parts, strict=True)]
        losses = list(self._pool.map(lambda job: _backward(*job), jobs))
        for shared, *others in zip(*(c.parameters() for c in self._copies), strict=True):
            for other in others:
                shared.grad += other.grad
            shared.grad /= len(self._copies)
        return float(np.mean(losses))


def _backward(network: Any, pictures: F32, labels: F32) -> float:
    torch = _torch()
    network.zero_grad()
    x = torch.from_numpy(pictures).to(memory_format=torch.channels_last)
    with torch.autocast("cpu", torch.bfloat16, enabled=_has_bfloat16()):
        features = network.backbone(x)
    loss = network.head([f.float() for f in features], torch.from_numpy(labels), x)[0]
    loss.backward()
    return float(loss.detach())


@lru_cache(maxsize=1)
def _has_bfloat16() -> bool:
    """Whether the processor computes in bfloat16; others emulate it, in four times the time of 32 bits."""
    return bool(_torch().ops.mkldnn._is_mkldnn_bf16_supported())


def _update_average(average: dict[str, Any], network: Any, steps: int) -> None:
    decay = min(EMA_DECAY, (1 + steps) / (10 + steps))
    with _torch().no_grad():
        for key, value in network.state_dict().items():
            if value.is_floating_point():
                average[key].mul_(decay).add_(value, alpha=1 - decay)
            else:
                average[key].copy_(value)


def _batches(data: LabelledDataset, rng: np.random.Generator) -> Iterator[tuple[F32, F32]]:
    """Endless batches: pictures (B, 3, S, S) BGR 0..255, labels (B, M, 5) class, centre, size in px."""
    ids = {name: i for i, name in enumerate(data.class_names)}
    labelled = [image for image in data.images if len(image.boxes_xyxy)]
    order = np.zeros(0, dtype=np.int64)
    while True:
        while len(order) < BATCH:
            order = np.concatenate([order, rng.permutation(len(data.images))])
        chosen, order = order[:BATCH], order[BATCH:]
        samples = [
            mosaic([labelled[j] for j in rng.integers(len(labelled), size=4)], ids, rng)
            if rng.random() < MOSAIC_SHARE
            else sample(data.images[i], ids, rng)
            for i in chosen
        ]
        labels = np.zeros((BATCH, max(1, *(len(rows) for _, rows in samples)), 5), dtype=np.float32)
        for row, (_, rows) in zip(labels, samples, strict=True):
            row[: len(rows)] = rows
        pictures = np.stack([p[..., ::-1].transpose(2, 0, 1) for p, _ in samples])
        yield np.ascontiguousarray(pictures, dtype=np.float32), labels


def sample(image: LabelledImage, ids: dict[str, int], rng: np.random.Generator) -> tuple[F32, F32]:
    """One augmented training sample: picture (S, S, 3) RGB and labels (N, 5) class, centre, size in pixels.

    A larger picture is scaled to between fitting and native resolution, then cropped, so that small things
    stay small. It is turned by quarters and mirrored: from above, every heading is equally likely.
    """
    picture, boxes, classes = _read(image, ids)
    longer = max(picture.shape[:2])
    scale = SIDE_PX / longer
    if longer > SIDE_PX:
        scale = float(np.exp(rng.uniform(np.log(scale), 0.0)))
    if scale != 1.0:
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        scaled = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=interpolation)
        picture = np.asarray(scaled, np.uint8)
    room = np.maximum(np.array(picture.shape[1::-1]) - SIDE_PX, 0)
    picture, boxes, classes = _crop(picture, boxes * scale, classes, rng.integers(room + 1), SIDE_PX)
    picture, boxes = _turn(picture, boxes, int(rng.integers(4)), bool(rng.integers(2)))
    return _recolour(picture, rng), _labels(classes, boxes)


def mosaic(images: Sequence[LabelledImage], ids: dict[str, int], rng: np.random.Generator) -> tuple[F32, F32]:
    """Like :func:`sample`, from four pictures with labels, so that a step sees many more targets."""
    half = SIDE_PX // 2
    canvas = np.full((SIDE_PX, SIDE_PX, 3), PAD_GREY, dtype=np.float32)
    rows = []
    for image, (top, left) in zip(images, ((0, 0), (0, half), (half, 0), (half, half)), strict=True):
        picture, boxes, classes = _read(image, ids)
        centre = boxes[rng.integers(len(boxes))].reshape(2, 2).mean(axis=0)
        centre += rng.uniform(-half / 2, half / 2, 2)
        room = np.maximum(np.array(picture.shape[1::-1]) - half, 0)
        corner = np.clip(np.rint(centre - half / 2), 0, room).astype(int)
        picture, boxes, classes = _crop(picture, boxes, classes, corner, half)
        picture, boxes = _turn(picture, boxes, int(rng.integers(4)), bool(rng.integers(2)))
        canvas[top : top + half, left : left + half] = _recolour(picture, rng)
        rows.append(_labels(classes, boxes + np.array([left, top] * 2)))
    return canvas, np.concatenate(rows)


def _read(image: LabelledImage, ids: dict[str, int]) -> tuple[U8, F64, F64]:
    """Picture (H, W, 3), boxes (N, 4) in pixels and class numbers (N,)."""
    picture = read_picture(image.path)
    boxes = image.boxes_xyxy * np.array([picture.shape[1], picture.shape[0]] * 2)
    return picture, boxes, np.array([ids[name] for name in image.class_names], dtype=float)


def _labels(classes: F64, boxes: F64) -> F32:
    centres, sizes = (boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]
    return np.column_stack([classes, centres, sizes]).astype(np.float32)


def _crop(picture: U8, boxes: F64, classes: F64, corner: NDArray[Any], side_px: int) -> tuple[U8, F64, F64]:
    """A padded square of a picture with its upper left corner at (x, y), and the boxes it still shows."""
    left, top = (int(c) for c in corner)
    canvas = np.full((side_px, side_px, 3), PAD_GREY, dtype=np.uint8)
    part = picture[top : top + side_px, left : left + side_px]
    canvas[: part.shape[0], : part.shape[1]] = part
    moved = boxes - np.array([left, top] * 2)
    cut = np.clip(moved, 0, side_px)
    visible, whole = (np.maximum((b[:, 2:] - b[:, :2]).prod(axis=1), 1e-9) for b in (cut, moved))
    is_large = (cut[:, 2:] - cut[:, :2]).max(axis=1, initial=0) >= MIN_BOX_PX
    keep = (visible / whole >= VISIBLE_MIN) & is_large
    return canvas, cut[keep], classes[keep]


def _turn(picture: U8, boxes: F64, quarters: int, mirror: bool) -> tuple[U8, F64]:
    """Square picture and boxes turned counter-clockwise by quarters, then mirrored left to right."""
    side = picture.shape[0]
    x0, y0, x1, y1 = boxes.T
    for _ in range(quarters):
        x0, y0, x1, y1 = y0, side - x1, y1, side - x0
    picture = np.rot90(picture, quarters)
    if mirror:
        picture, x0, x1 = picture[:, ::-1], side - x1, side - x0
    return picture, np.column_stack([x0, y0, x1, y1])


def _recolour(picture: U8, rng: np.random.Generator) -> F32:
    """Contrast, brightness, colour balance and noise."""
    p = picture.astype(np.float32)
    p = (p - 128) * np.float32(rng.uniform(0.75, 1.25)) + 128 + np.float32(rng.uniform(-30, 30))
    p *= rng.uniform(0.9, 1.1, 3).astype(np.float32)
    p += rng.standard_normal(p.shape, dtype=np.float32) * np.float32(rng.uniform(0, 5))
    return np.clip(p, 0, 255)


def _export(network: Any, path: Path, metadata: dict[str, str]) -> None:
    """Write the network with decoded boxes (1, N, 5 + C) and free height and width (multiples of 32)."""
    import onnx

    torch = _torch()
    network.eval().to(memory_format=torch.contiguous_format)
    network.head.decode_in_inference = True
    torch.onnx.export(
        network,
        (torch.zeros(1, 3, 384, 640),),
        str(path),
        input_names=["images"],
        output_names=["output"],
        dynamic_axes={"images": {2: "height", 3: "width"}, "output": {1: "cells"}},
        opset_version=17,
        dynamo=False,
        training=torch.onnx.TrainingMode.PRESERVE,
        do_constant_folding=False,
    )
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, metadata)
    onnx.save(model, str(path))
