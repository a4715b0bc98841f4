"""An ONNX model of the YOLO family, run by ONNX Runtime: pixels in, decoded boxes out."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from skysweep.arrays import F32, U8
from skysweep.detection.coco import default_names
from skysweep.detection.yolo_outputs import Boxes, OutputLayout, PixelFormat, Probe, recognise
from skysweep.errors import UserError
from skysweep.files.reading import read_text_limited

PAD_GREY = 114
STRIDE = 32
PROBE_SIZE = (640, 640)
_MAX_NAMES_BYTES = 1_000_000
_NUMPY_TYPE = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}


class Network:
    """An open model: pixels in, decoded boxes out."""

    def __init__(self, session: ort.InferenceSession, path: Path) -> None:
        self._session, self._path = session, path
        first, *others = session.get_inputs() or [None]
        if first is None or len(first.shape) != 4 or first.type not in _NUMPY_TYPE:
            found = "missing" if first is None else f"{first.type} {first.shape}"
            raise UserError(
                f"{path}: the first input is {found}, not one picture; "
                "export the model with an input of shape (1, 3, height, width)"
            )
        self._input, self._dtype = first, _NUMPY_TYPE[first.type]
        self._channels_last = first.shape[3] == 3
        self._size_input = next((i for i in others if "size" in i.name), None)
        if (isinstance(first.shape[0], int) and first.shape[0] > 1) or len(others) > bool(self._size_input):
            raise UserError(
                f"{path}: export the model for one picture at a time (batch 1) and without other inputs"
            )
        sides = first.shape[1:3] if self._channels_last else first.shape[2:4]
        self._fixed_hw = tuple(sides) if all(isinstance(side, int) and side > 0 for side in sides) else None
        self.layout = self._recognise()
        self.class_names = self._names(self.layout.n_classes)

    def input_hw_for(self, picture_hw: tuple[int, int]) -> tuple[int, int]:
        """The input's (height, width): the model's own, else the picture's rounded up to whole strides."""
        if self._fixed_hw is not None:
            return self._fixed_hw
        height, width = (-(-side // STRIDE) * STRIDE for side in picture_hw)
        return height, width

    def __call__(self, canvas: U8) -> Boxes:
        """Boxes in the canvas' pixels."""
        return self.layout.decode(self._run(canvas, self.layout.pixels), canvas.shape[:2])

    def interrupt(self) -> None:
        """Break off a run in another thread, where it then raises."""
        self._options.terminate = True

    def _run(self, canvas: U8, pixels: PixelFormat) -> dict[str, F32]:
        picture = _pixels(canvas, pixels, self._dtype)
        if self._channels_last:
            picture = np.ascontiguousarray(picture.transpose(1, 2, 0))
        feed = {self._input.name: picture[None]}
        if self._size_input is not None:
            kind = np.int64 if self._size_input.type == "tensor(int64)" else np.float32
            feed[self._size_input.name] = np.array([canvas.shape[1::-1]], dtype=kind)
        self._options = ort.RunOptions()
        answers = self._session.run(None, feed, self._options)
        names = [output.name for output in self._session.get_outputs()]
        return {name: np.asarray(a, np.float32) for name, a in zip(names, answers, strict=True)}

    def _recognise(self) -> OutputLayout:
        input_hw = self._fixed_hw or PROBE_SIZE
        blank = np.full((*input_hw, 3), PAD_GREY, dtype=np.uint8)
        try:
            outputs = self._run(blank, PixelFormat())
        except Exception as error:  # ONNX Runtime raises its own types, all direct children of Exception
            raise UserError(f"{self._path}: the model does not run ({str(error).splitlines()[0]})") from error
        meta = self._session.get_modelmeta()
        names = self._named_in_file()
        hint = " ".join([self._path.stem, meta.graph_name, meta.producer_name, meta.description]).lower()
        layout = recognise(Probe(outputs, input_hw, len(names) if names else None, hint))
        if layout is None:
            shapes = ", ".join(f"{n} {v.shape}" for n, v in outputs.items())
            raise UserError(
                f"{self._path}: outputs {shapes} are none of the layouts known (YOLOv3 to v12, YOLOX, "
                "DETR, RT-DETR); export the model for detection"
            )
        return layout

    def _named_in_file(self) -> tuple[str, ...] | None:
        """Class names from the sidecar or the metadata, which hold a dict or list in Python or JSON."""
        sidecar = self._path.with_suffix(".names")
        if sidecar.is_file():
            lines = read_text_limited(sidecar, _MAX_NAMES_BYTES).splitlines()
            return tuple(line.strip() for line in lines if line.strip())
        text = self._session.get_modelmeta().custom_metadata_map.get("names")
        if text is None:
            return None
        try:
            names = ast.literal_eval(text)
            if isinstance(names, dict):
                names = [names[key] for key in sorted(names, key=int)]
        except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
            names = None
        if not isinstance(names, list | tuple):
            raise UserError(
                f"{self._path}: its metadata 'names' is no list of class names; write them one a line into "
                f"{sidecar.name} beside it"
            )
        return tuple(map(str, names))

    def _names(self, n_classes: int) -> tuple[str, ...]:
        names = self._named_in_file() or default_names(n_classes)
        if names is None or len(names) != n_classes:
            found = "names none" if names is None else f"names {len(names)}"
            raise UserError(
                f"{self._path}: the model has {n_classes} classes but {found}; write their names one a line "
                f"into {self._path.with_suffix('.names').name} beside it"
            )
        return names


def load_network(path: Path, threads: int) -> Network:
    """Open a model and recognise its layout from its answer to a blank picture. Raises UserError."""
    return Network(_open(path, threads), path)


def letterbox(picture: U8, input_hw: tuple[int, int], *, centred: bool) -> tuple[U8, float, int, int]:
    """The picture (H, W, 3) scaled to fit ``input_hw`` on grey, its scale, and the left and top padding."""
    height, width = picture.shape[:2]
    scale = min(input_hw[0] / height, input_hw[1] / width)
    new_h, new_w = round(height * scale), round(width * scale)
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
        np.subtract(plane * gain, offset, out=out, casting="same_kind")
    return wanted


def _open(path: Path, threads: int) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    wanted = ("CUDAExecutionProvider", "CPUExecutionProvider")
    providers = [p for p in wanted if p in ort.get_available_providers()]
    try:
        return ort.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # ONNX Runtime raises its own types, all direct children of Exception
        raise UserError(f"{path}: not a readable ONNX model; export or download it again") from error
