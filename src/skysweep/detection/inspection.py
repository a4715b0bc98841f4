"""What was understood of a model, and its boxes drawn into a picture."""

from __future__ import annotations

from pathlib import Path

import cv2

from skysweep.arrays import U8
from skysweep.detection.network import Network
from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.types import Detections

_LINE_RGB = (255, 0, 0)


def describe(network: Network) -> dict[str, str]:
    """What goes into a model and how its outputs are read, by name."""
    layout, pixels, given = network.layout, network.pixels, network.picture_input
    channels = "BGR" if pixels.bgr else "RGB"
    if given.type == "tensor(uint8)":
        values = "0..255"
    else:
        values = f"0..{255 * pixels.scale:g}"
        if any(pixels.mean) or set(pixels.std) != {1.0}:
            values += f", less {pixels.mean}, divided by {pixels.std}"
    height, width = ("any" if side is None else str(side) for side in network.fixed_hw)
    return {
        "input": f"{given.name} {given.shape}, {given.type}",
        "channels": f"{channels}, {'last' if network.channels_last else 'first'}",
        "size": f"{height} high, {width} wide (any: a multiple of 32)",
        "pixels": values,
        "outputs": layout.name,
        "boxes": network.boxes or f"{layout.boxes}, verified on each picture",
        "anchors": layout.anchors,
        "NMS inside": "yes" if layout.suppressed else "no",
        "classes": f"{len(network.class_names)}: {', '.join(network.class_names)}",
    }


def save_drawn(path_png: Path, picture: U8, found: Detections) -> None:
    """Write the picture (H, W, 3) RGB with every box, its class and confidence. Raises UserError, OSError."""
    if path_png.suffix.lower() != ".png":
        raise UserError(f"{path_png}: is no .png; write a file name that ends in .png")
    canvas = picture.copy()
    labels = zip(found.boxes_xyxy_px.round().astype(int), found.class_names, found.confidences, strict=True)
    for corners, name, confidence in labels:
        left, top, right, bottom = map(int, corners)
        cv2.rectangle(canvas, (left, top), (right, bottom), _LINE_RGB, 2)
        words, place = f"{name} {confidence:.2f}", (left, max(12, top - 4))
        cv2.putText(canvas, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _LINE_RGB, 1, cv2.LINE_AA)
    _, png = cv2.imencode(".png", canvas[..., ::-1])
    with whole_files(path_png.parent) as unfinished:
        (unfinished / path_png.name).write_bytes(png.tobytes())
