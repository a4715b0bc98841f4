"""Raw grids of the anchored YOLOs: v3, v4, v5 and v7, before their boxes are computed.

Shapes tell neither the version, by which the boxes are computed, nor the anchors. Names in the file may tell
the version. The anchors are those trained on COCO for a model of COCO's 80 classes; others are read from a
file beside the model. Heads of YOLOv8 and later, which have no anchors, are refused.

Sources: YOLOv3 (arXiv:1804.02767), YOLOv4 (arXiv:2004.10934), YOLOv5 (Ultralytics) and YOLOv7
(arXiv:2207.02696).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial

import numpy as np

from skysweep.arrays import F32
from skysweep.detection.cell_layouts import objectness_rows
from skysweep.detection.coco import COCO_80
from skysweep.detection.layouts import (
    Boxes,
    OutputLayout,
    Outputs,
    Probe,
    Size,
    Unclear,
    sigmoid,
)

# Anchor boxes (width, height) in pixels for each stride, trained on COCO.
_YOLO3 = {
    8: ((10, 13), (16, 30), (33, 23)),
    16: ((30, 61), (62, 45), (59, 119)),
    32: ((116, 90), (156, 198), (373, 326)),
}
_YOLO4 = {
    8: ((12, 16), (19, 36), (40, 28)),
    16: ((36, 75), (76, 55), (72, 146)),
    32: ((142, 110), (192, 243), (459, 401)),
}
_YOLO3_TINY = {16: ((10, 14), (23, 27), (37, 58)), 32: ((81, 82), (135, 169), (344, 319))}
_YOLO4_TINY = {16: ((23, 27), (37, 58), (81, 82)), 32: ((81, 82), (135, 169), (344, 319))}
_YOLO4_SCALE_XY = {8: 1.2, 16: 1.1, 32: 1.05}
_VERSION = re.compile(r"yolo(?:[-_ ]?v[-_ ]?)?(\d+)")
_SCALED_YOLO4 = re.compile(r"yolo[-_ ]?v?4.*?(?:csp(?!darknet)|(?<![a-z])p[567](?!\d)|x[-_]?mish)")
_BOX_CHANNELS = 64  # of YOLOv8 and later: 16 bins for each side


@dataclass(frozen=True, slots=True)
class _Grid:
    """One raw head: which output, its stride, and the axes that bring it to (3, h, w, 5 + C)."""

    output: str
    stride: int
    columns: int
    axes: str  # "chw": (1, 3 * k, h, w); "hwc": (1, h, w, 3 * k); "ahwk": (1, 3, h, w, k); "hwak"

    def cells(self, outputs: Outputs) -> F32:
        a: F32 = np.asarray(outputs[self.output][0])
        match self.axes:
            case "chw":
                return a.reshape(3, self.columns, *a.shape[1:]).transpose(0, 2, 3, 1)
            case "hwc":
                return a.reshape(*a.shape[:2], 3, self.columns).transpose(2, 0, 1, 3)
            case "hwak":
                return a.transpose(2, 0, 1, 3)
        return a


def _as_grid(name: str, shape: tuple[int, ...], input_hw: Size) -> _Grid | None:
    for axes in ("chw", "hwc") if len(shape) == 4 else ("ahwk", "hwak") if len(shape) == 5 else ():
        h, w = {"chw": shape[2:4], "hwc": shape[1:3], "ahwk": shape[2:4], "hwak": shape[1:3]}[axes]
        k, rest = divmod(shape[1] if axes == "chw" else shape[-1], 3) if len(shape) == 4 else (shape[-1], 0)
        anchors = {"ahwk": shape[1], "hwak": shape[3] if len(shape) == 5 else 3}.get(axes, 3)
        stride = input_hw[0] // h if h else 0
        if rest == 0 and k > 5 and anchors == 3 and stride in (8, 16, 32) and input_hw[1] // stride == w:
            return _Grid(name, stride, k, axes)
    return None


def raw_grids(probe: Probe) -> OutputLayout | None:
    """Two or three raw heads of three anchors: YOLOv3, v4, v5 and v7.

    Only v5 and v7 have the axes (1, 3, h, w, 5 + C), only v4 has (1, h, w, 3, 5 + C). Raises Unclear if the
    version or the anchors remain unknown, or the grids are those of other heads.
    """
    _refuse_heads_without_anchors(probe)
    found = [_as_grid(n, v.shape, probe.input_hw) for n, v in probe.outputs.items()]
    grids = sorted((g for g in found if g is not None), key=lambda g: g.stride)
    if len(grids) != len(probe.outputs) or len({g.columns for g in grids}) != 1:
        return None
    if tuple(g.stride for g in grids) not in ((8, 16, 32), (16, 32)):
        return None
    n_classes = grids[0].columns - 5
    if probe.n_names is None and n_classes != len(COCO_80) and grids[0].axes in ("chw", "hwc"):
        raise Unclear(
            "answers raw grids, which may be of several versions of YOLO, and names no classes; write their "
            "names one a line into a file of its name ending in .names, or export it with decoded boxes"
        )
    if probe.n_names not in (None, n_classes):
        raise Unclear(
            f"answers raw grids that read as those of {n_classes} classes, and {probe.n_names} are named; "
            "write their names one a line into a file of its name ending in .names, or export it with "
            "decoded boxes"
        )
    if all(_within_one(grid.cells(probe.outputs)[..., 4:]) for grid in grids):
        raise Unclear(
            "answers raw grids that have been through a sigmoid; export it without, or with decoded boxes"
        )
    version = _version(probe, grids[0].axes)
    anchors_px, source = _anchors_of(probe, grids, version, n_classes)
    decode = partial(_decode_grids, grids, version, anchors_px)
    return OutputLayout(f"YOLOv{version} grids", n_classes, decode, boxes=None, anchors=source)


def _refuse_heads_without_anchors(probe: Probe) -> None:
    n_classes = probe.n_names or len(COCO_80)
    channels = _BOX_CHANNELS + n_classes
    shapes = [v.shape for v in probe.outputs.values()]
    if shapes and all(len(shape) == 4 and channels in (shape[1], shape[3]) for shape in shapes):
        raise Unclear(
            f"answers raw heads of {_BOX_CHANNELS} + {n_classes} channels, as YOLOv8 and later have before "
            "their boxes are computed; export it with decoded boxes"
        )


def _within_one(values: F32) -> bool:
    return bool(np.all((values >= 0) & (values <= 1)))


def _version(probe: Probe, axes: str) -> int:
    if _SCALED_YOLO4.search(probe.hint):
        raise Unclear(
            "is a scaled YOLOv4 (csp, p5, p6, x-mish) by its name, whose raw grids are not supported; export "
            "it with decoded boxes"
        )
    possible = {"ahwk": {5, 7}, "hwak": {4}}.get(axes, {3, 4, 5, 7})
    named = {int(v) for v in _VERSION.findall(probe.hint)} & possible
    if len(named) == 1:
        return named.pop()
    if len(possible) == 1:
        return possible.pop()
    if axes == "ahwk" and probe.anchors_px:
        return 5  # v7 is computed in the same way
    *others, last = (f"v{v}" for v in sorted(possible))
    raise Unclear(
        f"answers raw grids, which may be those of YOLO{', '.join(others)} or {last}; name the version in "
        f"the file's name (as in my-yolo{last}.onnx), or export it with decoded boxes"
    )


def _anchors_of(probe: Probe, grids: list[_Grid], version: int, n_classes: int) -> tuple[dict[int, F32], str]:
    """Anchors (3, 2), width and height in pixels, by stride, and where they come from."""
    two, n_values = len(grids) == 2, 6 * len(grids)
    if probe.anchors_px:
        if len(probe.anchors_px) != n_values:
            raise Unclear(
                f"answers {len(grids)} raw grids, and the file of anchors beside it holds "
                f"{len(probe.anchors_px)} numbers; write {n_values}: width and height in pixels of three "
                "anchors a grid, smallest first"
            )
        values = np.array(probe.anchors_px, np.float32).reshape(-1, 3, 2)
        areas = values.prod(axis=2).mean(axis=1)
        if np.any(np.diff(areas) <= 0) or values[-1].max() < grids[-1].stride:
            raise Unclear(
                "answers raw grids, and the anchors in the file beside it do not grow from grid to grid up "
                f"to at least a cell of the coarsest ({grids[-1].stride} pixels); write width and height of "
                "three anchors a grid in pixels, not in cells, smallest first"
            )
        return {g.stride: v for g, v in zip(grids, values, strict=True)}, "from the file beside the model"
    if n_classes != len(COCO_80) or len({*probe.names} & {*COCO_80}) < len({*probe.names}) / 2:
        raise Unclear(
            "answers raw grids but does not hold their anchors; write them (width and height in pixels, "
            "smallest first) into a file of its name ending in .anchors, or export it with decoded boxes"
        )
    tiny = "tiny" in probe.hint
    tables = {3: _YOLO3, 4: _YOLO4, 5: _YOLO3, 7: _YOLO3 if tiny else _YOLO4}
    if two:
        tables = {3: _YOLO3_TINY, 4: _YOLO4_TINY}
    if version not in tables or (tiny and not two and version in (3, 4)):
        raise Unclear(
            f"answers {len(grids)} raw grids of YOLOv{version}{' tiny' * tiny}, whose anchors are not known; "
            "write them (width and height in pixels, smallest first) into a file of its name ending in "
            ".anchors, or export it with decoded boxes"
        )
    anchors_px = {s: np.array(a, np.float32) for s, a in tables[version].items()}
    return anchors_px, f"those of YOLOv{version} for COCO"


def _decode_grids(
    grids: list[_Grid], version: int, anchors_px: dict[int, F32], outputs: Outputs, _: Size
) -> Boxes:
    parts = []
    for grid in grids:
        t = grid.cells(outputs)
        ys, xs = np.mgrid[: t.shape[1], : t.shape[2]]
        cell = np.stack([xs, ys], axis=-1)
        anchor = anchors_px[grid.stride][:, None, None]
        if version in (5, 7):
            centre = sigmoid(t[..., :2]) * 2 - 0.5 + cell
            size = (sigmoid(t[..., 2:4]) * 2) ** 2 * anchor
        else:
            scale = _YOLO4_SCALE_XY[grid.stride] if version == 4 and len(grids) == 3 else 1.0
            centre = sigmoid(t[..., :2]) * scale - (scale - 1) / 2 + cell
            size = np.exp(t[..., 2:4]) * anchor
        parts.append(np.concatenate([centre * grid.stride, size, sigmoid(t[..., 4:])], axis=-1))
    rows = np.concatenate([p.reshape(-1, p.shape[-1]) for p in parts])
    return objectness_rows(rows.astype(np.float32))
