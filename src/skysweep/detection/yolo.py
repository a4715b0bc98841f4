"""The YOLO detector: any model of the family in an ONNX file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from skysweep.arrays import F64, I64, U8
from skysweep.detection.answers import refuse_nonsense
from skysweep.detection.layouts import Boxes, BoxUnit, Channels, OutputLayout, PixelRange, Told
from skysweep.detection.model_files import OWN_MODEL, existing_model_file
from skysweep.detection.model_trial import try_out
from skysweep.detection.network import letterbox, load_network
from skysweep.detection.tiling import cut_copies, tiles_px
from skysweep.errors import UserError
from skysweep.types import Detections, Frame


class YoloDetector:
    """Finds objects in pictures with an ONNX model of the YOLO family.

    The output layout is recognised, not configured (see :mod:`skysweep.detection.yolo_outputs`). Class names
    come from a text file beside the model (``model.names``, one name a line) or else from its metadata; a
    model with 80 or 91 classes may leave both out and gets COCO's names.

    Args:
        model_path: an ONNX file, or "skysweep" for the model that the package ships.
        classes: names to keep; None keeps all.
        confidence_min: detections below are dropped, 0..1.
        iou_max: if two boxes of one class overlap more, the weaker one is dropped, 0..1.
        tiles: split each picture into ``tiles`` x ``tiles`` overlapping parts, each scaled to the model's
            input, so that small things span almost ``tiles`` times as many pixels (at ``tiles**2`` times the
            cost). A model that takes any size gets each part as large as it gets a whole picture.
        threads: CPU threads of the network. They do not spin while waiting, so that rendering can overlap.
        boxes: what the model's boxes are measured in,
        pixels: what values it takes, and
        channels: in which order, where the model leaves that open; None: as its family's exports do.

    Raises:
        UserError: the file is missing or broken, takes too much time or memory (see
            :mod:`skysweep.detection.model_trial`), its layout or class names are unknown, or it lacks one of
            ``classes``.

    Example:
        >>> detector = YoloDetector("skysweep", classes=["person"])
        >>> detector.class_names
        ('person',)
    """

    def __init__(
        self,
        model_path: Path | str = OWN_MODEL,
        classes: Sequence[str] | None = None,
        *,
        confidence_min: float = 0.25,
        iou_max: float = 0.5,
        tiles: int = 1,
        threads: int = 1,
        boxes: BoxUnit | None = None,
        pixels: PixelRange | None = None,
        channels: Channels | None = None,
    ) -> None:
        self._path = existing_model_file(model_path)
        told = Told(boxes, pixels, channels)
        try_out(self._path, told)
        self._confidence_min, self._iou_max, self._tiles = confidence_min, iou_max, tiles
        self.network = load_network(self._path, threads, told)
        self.model_class_names = self.network.class_names
        self.class_names = tuple(classes) if classes is not None else self.model_class_names
        for name in self.class_names:
            if name not in self.model_class_names:
                known = ", ".join(self.model_class_names)
                raise UserError(f"{self._path}: the model has no class {name!r}; it has {known}")
        self._wanted = np.isin(self.model_class_names, self.class_names)

    @property
    def layout(self) -> OutputLayout:
        """The output layout that was recognised."""
        return self.network.layout

    def detect(self, frame: Frame) -> Detections:
        """Boxes in the frame's pixels, most confident first, with the frame's pose and lens.

        Raises UserError if the model's answer is invalid.
        """
        input_hw = self.network.input_hw_for(frame.image.shape[:2])
        height, width = frame.image.shape[:2]
        tiles = tiles_px(width, height, self._tiles)
        found = [
            self._look(frame.image[top:bottom, left:right], left, top, input_hw)
            for left, top, right, bottom in tiles
        ]
        boxes = np.concatenate([b.xyxy_px for b in found]).astype(np.float64)
        scores = np.concatenate([b.scores for b in found]).astype(np.float64)
        classes = np.concatenate([b.classes for b in found])
        if len(tiles) > 1:
            of_tile = np.repeat(np.arange(len(tiles)), [len(b.scores) for b in found])
            whole = ~cut_copies(boxes, classes, of_tile, tiles, (width, height))
            boxes, scores, classes = boxes[whole], scores[whole], classes[whole]
        keep = _suppress(boxes, scores, classes, self._confidence_min, self._iou_max)
        return Detections(
            time_s=frame.time_s,
            boxes_xyxy_px=boxes[keep],
            confidences=np.clip(scores[keep], 0.0, 1.0),
            class_names=tuple(self.model_class_names[i] for i in classes[keep]),
            camera=frame.camera,
            lens=frame.lens,
        )

    def interrupt(self) -> None:
        """Break off a look in another thread, where it then raises."""
        self.network.interrupt()

    def _look(self, picture: U8, left_px: int, top_px: int, input_hw: tuple[int, int]) -> Boxes:
        """Boxes of wanted classes above the threshold in one tile, in pixels of the whole picture."""
        canvas, scale, pad_x, pad_y = letterbox(picture, input_hw, centred=not self.network.pixels.bgr)
        boxes = self.network(canvas)
        keep = ~(boxes.scores < self._confidence_min)  # keeps NaN, which is refused below
        try:
            refuse_nonsense(boxes.xyxy_px[keep], boxes.scores[keep])
            keep[keep] = self._wanted[_known(boxes.classes[keep], len(self._wanted))]
        except ValueError as error:
            raise UserError(f"{self._path}: the model answers nonsense ({error}); export it again") from None
        height, width = picture.shape[:2]
        corners = (boxes.xyxy_px[keep] - np.array([pad_x, pad_y] * 2)) / scale
        corners = np.clip(corners, 0, [width, height, width, height]) + [left_px, top_px] * 2
        real = np.all(corners[:, 2:] - corners[:, :2] > 0.5, axis=1)
        return Boxes(corners[real], boxes.scores[keep][real], boxes.classes[keep][real])


def _known(classes: I64, n_classes: int) -> I64:
    unknown = classes[(classes < 0) | (classes >= n_classes)]
    if len(unknown):
        raise ValueError(f"class number {unknown[0]}, and it has {n_classes} classes")
    return classes


def _suppress(
    boxes: F64,
    scores: F64,
    classes: I64,
    confidence_min: float,
    iou_max: float,
) -> I64:
    """Indices that survive non-maximum suppression by class, most confident first."""
    if len(boxes) == 0:
        return np.zeros(0, dtype=np.int64)
    corner_and_size = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)
    given = corner_and_size.tolist(), scores.tolist(), classes.tolist()
    kept = np.asarray(cv2.dnn.NMSBoxesBatched(*given, confidence_min, iou_max), dtype=np.int64).ravel()
    return kept[np.argsort(-scores[kept], kind="stable")]
