"""An ONNX model of the YOLO family, run by ONNX Runtime: pixels in, decoded boxes out."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path
from threading import Timer
from typing import Any

import cv2
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from skysweep.arrays import F32, U8
from skysweep.detection.coco import default_names
from skysweep.detection.layouts import (
    NORMALISED_MAX,
    Boxes,
    BoxUnit,
    OutputLayout,
    Outputs,
    PixelFormat,
    Probe,
    Size,
    Told,
    Unclear,
    refuse_logits,
    size_px,
    unit_of,
)
from skysweep.detection.tiling import STRIDE, FixedSides, fitting_scale, input_hw_for, takes_any_size
from skysweep.detection.yolo_outputs import recognise
from skysweep.errors import UserError
from skysweep.files.reading import read_text_limited

PAD_GREY = 114
PROBE_SIZE = (640, 640)
PICTURE_S = 60.0  # of wall time, for one picture
_MAX_NAMES_BYTES = 1_000_000
_SURE = 0.25  # confidence of a box that has to lie in the picture
_SILENT = 4  # what fails is said in one sentence
_MISSHAPEN = (ArithmeticError, LookupError, ValueError)  # of outputs that are not those of a layout
_NUMPY_TYPE = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}


class Network:
    """An open model: pixels in, decoded boxes out. Raises UserError if it cannot be understood."""

    def __init__(self, session: ort.InferenceSession, path: Path, told: Told) -> None:
        self._session, self._path = session, path
        inputs = session.get_inputs()
        given = self.picture_input = _picture_input(inputs, path)
        others = [i for i in inputs if i is not given]
        _refuse_no_numbers(session.get_outputs(), path)
        self._dtype = _NUMPY_TYPE[given.type]
        *batch, rows, columns, last = given.shape if len(given.shape) == 4 else [1, *given.shape]
        self._unbatched = len(given.shape) == 3
        self.channels_last = last == 3
        self._side_inputs = {i: kind for i in others if (kind := _side_input(i.name))}
        if (isinstance(batch[0], int) and batch[0] > 1) or len(others) > len(self._side_inputs):
            raise UserError(
                f"{path}: export the model for one picture at a time (batch 1) and without other inputs"
            )
        channels = last if self.channels_last else rows
        if isinstance(channels, int) and channels != 3:
            raise UserError(
                f"{path}: the input {given.name} takes pictures of {channels} channels; export the model for "
                "pictures of three"
            )
        sides = (rows, columns) if self.channels_last else (columns, last)
        self.fixed_hw: FixedSides = _fixed(sides[0]), _fixed(sides[1])
        self.stride = STRIDE if self._takes_odd_strides() else 2 * STRIDE
        input_hw = self.input_hw_for(PROBE_SIZE)
        outputs = self._run(np.full((*input_hw, 3), PAD_GREY, dtype=np.uint8), PixelFormat())
        self.layout = self._recognise(outputs, input_hw)
        self.class_names = self._names(self.layout)
        self.pixels = self._pixel_format(told)
        self.boxes = self._unit(self._decode(outputs, input_hw), told.boxes)
        if told.boxes and self.layout.boxes is None:
            raise UserError(
                f"{path}: the boxes of {self.layout.name} are computed in pixels; leave out detector.boxes"
            )

    def input_hw_for(self, picture_hw: tuple[int, int]) -> tuple[int, int]:
        """The input's (height, width) for pictures of this size, as ``tiling.input_hw_for``."""
        return input_hw_for(self.fixed_hw, picture_hw, self.stride)

    def __call__(self, canvas: U8) -> Boxes:
        """Boxes in the canvas' pixels. Raises UserError if the model fails on this picture."""
        input_hw = canvas.shape[:2]
        found = self._decode(self._run(canvas, self.pixels), input_hw)
        if (self.boxes or self._unit(found)) == "normalised":
            if np.any(found.xyxy_px[found.scores >= _SURE] > NORMALISED_MAX):
                raise UserError(
                    f"{self._path}: the model answers boxes that are pixels; leave out detector.boxes, or "
                    "write pixels"
                )
            found = replace(found, xyxy_px=found.xyxy_px * size_px(input_hw))
        return found

    def interrupt(self) -> None:
        """Break off a run in another thread, where it then raises."""
        self._options.terminate = True

    def _takes_odd_strides(self) -> bool:
        """Whether a side may be an odd multiple of the stride: not for YOLOv8-p6, whose last one is 64."""
        if not takes_any_size(self.fixed_hw):
            return True
        try:
            self._run(np.full((3 * STRIDE, 5 * STRIDE, 3), PAD_GREY, dtype=np.uint8), PixelFormat())
        except UserError:
            return False
        return True

    def _run(self, canvas: U8, pixels: PixelFormat) -> dict[str, F32]:
        picture = _pixels(canvas, pixels, self._dtype)
        if self.channels_last:
            picture = np.ascontiguousarray(picture.transpose(1, 2, 0))
        feed = {self.picture_input.name: picture if self._unbatched else picture[None]}
        height, width = canvas.shape[:2]
        values = {"size": [width, height], "im_shape": [height, width], "scale_factor": [1, 1]}
        for side_input, kind in self._side_inputs.items():
            number = np.int64 if side_input.type == "tensor(int64)" else np.float32
            feed[side_input.name] = np.array([values[kind]], dtype=number)
        self._options = options = ort.RunOptions()
        options.log_severity_level = _SILENT
        timer = Timer(PICTURE_S, setattr, [options, "terminate", True])
        timer.daemon = True
        timer.start()
        try:
            answers = self._session.run(None, feed, options)
        except Exception as error:  # ONNX Runtime raises its own types, all direct children of Exception
            if options.terminate:
                raise UserError(f"{self._path}: the model was stopped before it answered") from error
            if _is_memory(why := _first_line(error)):
                raise UserError(
                    f"{self._path}: the model needs too much memory; export a smaller one"
                ) from error
            raise UserError(f"{self._path}: the model does not run ({why})") from error
        finally:
            timer.cancel()
        names = [output.name for output in self._session.get_outputs()]
        return {name: np.asarray(a, np.float32) for name, a in zip(names, answers, strict=True)}

    def _decode(self, outputs: Outputs, input_hw: Size) -> Boxes:
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused later
                found = self.layout.decode(outputs, input_hw)
            refuse_logits(found.scores)
        except Unclear as error:
            raise UserError(f"{self._path}: the model {error}") from None
        except _MISSHAPEN as error:  # the shapes are not those of the blank picture
            shapes = _shapes(outputs)
            raise UserError(
                f"{self._path}: outputs {shapes} are not those of {self.layout.name}; export it again"
            ) from error
        return found

    def _unit(self, found: Boxes, told: BoxUnit | None = None) -> BoxUnit | None:
        usual = self.layout.boxes
        try:
            return unit_of(found, usual, told) if usual else "pixels"
        except Unclear as error:
            raise UserError(f"{self._path}: the model {error}") from None

    def _pixel_format(self, told: Told) -> PixelFormat:
        layout, of_bytes = self.layout, self._dtype == np.uint8
        missing = []
        if layout.pixels is None and told.pixels is None and not of_bytes:
            missing.append(
                "detector.pixels: 0..255, 0..1 or imagenet (0..1, less its mean, divided by its deviation)"
            )
        if layout.pixels is None and layout.bgr is None and told.channels is None:
            missing.append("detector.channels: rgb or bgr")
        if missing:
            raise UserError(
                f"{self._path}: the model ({layout.name}) does not say which pixels it takes; write "
                f"{' and '.join(missing)}"
            )
        if told.pixels not in (None, "0..255") and of_bytes:
            raise UserError(f"{self._path}: the input is of bytes; leave out detector.pixels")
        return (layout.pixels or PixelFormat(bgr=bool(layout.bgr))).told(told.pixels, told.channels)

    def _recognise(self, outputs: Outputs, input_hw: Size) -> OutputLayout:
        meta = self._session.get_modelmeta()
        names = self._named_in_file()
        hint = " ".join([self._path.stem, meta.graph_name, meta.producer_name, meta.description]).lower()
        probe = Probe(
            outputs,
            input_hw,
            names or (),
            hint,
            task=meta.custom_metadata_map.get("task", ""),
            told_size="size" in self._side_inputs.values(),
            anchors_px=read_anchors(self._path),
        )
        try:
            with np.errstate(all="ignore"):
                layout = recognise(probe)
        except Unclear as error:
            raise UserError(f"{self._path}: the model {error}") from None
        except _MISSHAPEN:
            layout = None
        if layout is None:
            raise UserError(
                f"{self._path}: outputs {_shapes(outputs)} are none of the layouts known (YOLOv3 to v12, "
                "YOLOX, DETR, RT-DETR and others); export the model for detection"
            )
        if probe.anchors_px and layout.anchors == "none":
            anchors = self._path.with_suffix(".anchors")
            raise UserError(f"{anchors}: {layout.name} takes no anchors; delete or rename this file")
        return layout

    def _named_in_file(self) -> tuple[str, ...] | None:
        """Class names from the sidecar or the metadata, which hold a dict or list in Python or JSON."""
        sidecar = self._path.with_suffix(".names")
        if sidecar.is_file():
            lines = [
                line.strip() for line in read_text_limited(sidecar, _MAX_NAMES_BYTES).rstrip().splitlines()
            ]
            if "" in lines:
                raise UserError(
                    f"{sidecar}: line {lines.index('') + 1} is empty; write a name in each line, the first "
                    "for label 0 ('none' for a label without a class)"
                )
            return tuple(lines)
        text = self._session.get_modelmeta().custom_metadata_map.get("names")
        if text is None:
            return None
        try:
            names = ast.literal_eval(text)
            if isinstance(names, dict):
                by_number = {int(number): name for number, name in names.items()}
                if sorted(by_number) != list(range(len(names))):
                    raise UserError(
                        f"{self._path}: the classes in its metadata 'names' are not numbered 0, 1, 2 and so "
                        f"on; write a name for each label, one a line, into {sidecar.name} beside it, the "
                        "first for label 0"
                    )
                names = [by_number[number] for number in range(len(names))]
        except (ValueError, TypeError, SyntaxError, OverflowError, MemoryError, RecursionError):
            names = None
        if not isinstance(names, list | tuple):
            raise UserError(
                f"{self._path}: its metadata 'names' is no list of class names; write them one a line into "
                f"{sidecar.name} beside it"
            )
        return tuple(map(str, names))

    def _names(self, layout: OutputLayout) -> tuple[str, ...]:
        names = self._named_in_file() or default_names(layout.n_classes)
        if names is None or len(names) != layout.n_classes:
            found = "names none" if names is None else f"names {len(names)}"
            raise UserError(
                f"{self._path}: its outputs read as {layout.name} of {layout.n_classes} classes but "
                f"{found}; if so, write their names one a line into {self._path.with_suffix('.names').name} "
                "beside it, else export the model for detection"
            )
        return names


def load_network(path: Path, threads: int, told: Told) -> Network:
    """Open a model and recognise its layout from its answer to a blank picture. Raises UserError."""
    return Network(_open(path, threads), path, told)


def read_anchors(model_path: Path) -> tuple[float, ...]:
    """The numbers of the file named like the model with ``.anchors``, if there is one. Raises UserError."""
    path = model_path.with_suffix(".anchors")
    if not path.is_file():
        return ()
    words = read_text_limited(path, _MAX_NAMES_BYTES).replace(",", " ").split()
    try:
        values = tuple(map(float, words))
    except ValueError:
        values = ()
    if not values or not all(0 < v < math.inf for v in values):
        raise UserError(f"{path}: write only the anchors' widths and heights in pixels, as numbers above 0")
    return values


def _picture_input(inputs: list[ort.NodeArg], path: Path) -> ort.NodeArg:
    """The first input of three or four axes. Raises UserError if it is missing or takes other numbers."""
    given = next((i for i in inputs if i.shape and len(i.shape) in (3, 4)), None)
    if given is None:
        found = f"the first input is {inputs[0].type} {inputs[0].shape}" if inputs else "the input is missing"
        raise UserError(
            f"{path}: {found}, not one picture; export the model with an input of shape (1, 3, height, width)"
        )
    if given.type not in _NUMPY_TYPE:
        raise UserError(
            f"{path}: the input {given.name} is {given.type}; export the model with one of "
            f"{', '.join(_NUMPY_TYPE)}"
        )
    return given


def _refuse_no_numbers(outputs: list[ort.NodeArg], path: Path) -> None:
    for output in outputs:
        if not output.type.startswith("tensor(") or output.type == "tensor(string)":
            raise UserError(
                f"{path}: the output {output.name} is {output.type}, no array of numbers; export the model "
                "for detection"
            )


def _side_input(name: str) -> str | None:
    """What an input beside the picture is told, by its name; None if unknown."""
    return next((kind for kind in ("scale_factor", "im_shape", "size") if kind in name), None)


def _fixed(side: object) -> int | None:
    return side if isinstance(side, int) and side > 0 else None


def _is_memory(why: str) -> bool:
    return any(word in why.lower() for word in ("bad_alloc", "bfcarena", "allocate memory"))


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)


def _shapes(outputs: Outputs) -> str:
    return ", ".join(f"{n} {v.shape}" for n, v in outputs.items())


def letterbox(picture: U8, input_hw: tuple[int, int], *, centred: bool) -> tuple[U8, float, int, int]:
    """The picture (H, W, 3) scaled to fit ``input_hw`` on grey, its scale, and the left and top padding."""
    height, width = picture.shape[:2]
    scale = fitting_scale((height, width), input_hw)
    new_h, new_w = (max(1, round(side * scale)) for side in (height, width))
    if (new_h, new_w) != (height, width):
        shrinks = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        picture = np.asarray(cv2.resize(picture, (new_w, new_h), interpolation=shrinks), dtype=np.uint8)
    top, left = ((input_hw[0] - new_h) // 2, (input_hw[1] - new_w) // 2) if centred else (0, 0)
    canvas = np.full((*input_hw, 3), PAD_GREY, dtype=np.uint8)
    canvas[top : top + new_h, left : left + new_w] = picture
    return canvas, scale, left, top


def _pixels(canvas: U8, pixels: PixelFormat, dtype: type) -> NDArray[Any]:
    """A model's input (3, H, W), made plane by plane because that is several times as fast."""
    planes = cv2.split(canvas)[:: -1 if pixels.bgr else 1]
    if dtype == np.uint8:
        return np.stack(planes)
    wanted = np.empty((3, *canvas.shape[:2]), dtype)
    mean, std = np.array(pixels.mean, np.float32), np.array(pixels.std, np.float32)
    gains = np.float32(pixels.scale) / std
    for plane, gain, offset, out in zip(planes, gains, mean / std, wanted, strict=True):
        np.multiply(plane, gain, out=out, casting="same_kind")
        if offset:
            np.subtract(out, offset, out=out, casting="same_kind")
    return wanted


def _open(path: Path, threads: int) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = _SILENT
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    wanted = ("CUDAExecutionProvider", "CPUExecutionProvider")
    providers = [p for p in wanted if p in ort.get_available_providers()]
    try:
        return ort.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # ONNX Runtime raises its own types, all direct children of Exception
        why = _first_line(error).rpartition("failed:")[2].strip()
        if _is_memory(why):
            raise UserError(f"{path}: the model needs too much memory; export a smaller one") from error
        raise UserError(
            f"{path}: not an ONNX model that can be opened here ({why}); export or download it again"
        ) from error
