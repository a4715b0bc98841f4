"""Frames to a file: MP4 (H.264) through PyAV, GIF and animated WebP through Pillow."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

from PIL import Image

from skysweep.arrays import U8
from skysweep.errors import MissingExtraError, UserError

SUFFIXES = (".mp4", ".gif", ".webp")

_COLOURS = "colorprim=bt709:transfer=iec61966-2-1:colormatrix=smpte170m"  # sRGB, converted as in BT.601
_QUALITY = {"crf": "24", "preset": "veryfast", "x264-params": _COLOURS}
_WEBP_QUALITY = 55
_GIF_UNIT_MS = 10  # of its durations
_GIF_MOST_FPS = 50  # browsers show a frame of one unit for ten


def refuse_unwritable(path: Path, fps: int) -> None:
    """Raises UserError for another suffix, a folder, or a GIF that is too fast.

    Raises MissingExtraError for an MP4 without PyAV.
    """
    if path.suffix not in SUFFIXES:
        raise UserError(f"--out {path}: is no video file; end it with {', '.join(SUFFIXES)}")
    if path.is_dir():
        raise UserError(f"--out {path}: is a folder; write another name")
    if path.suffix == ".gif" and fps > _GIF_MOST_FPS:
        raise UserError(f"--fps {fps}: is too fast for a GIF; write at most {_GIF_MOST_FPS}")
    if path.suffix == ".mp4":
        _av()


def encode(frames: Iterable[U8], n_frames: int, path: Path, fps: int, width_px: int, height_px: int) -> None:
    """Write frames (H, W, 3) RGB in the format of the path's suffix."""
    if path.suffix == ".mp4":
        _encode_mp4(frames, path, fps, width_px, height_px)
        return
    images: Iterator[Image.Image] = (Image.fromarray(frame) for frame in frames)
    how: dict[str, Any] = {"quality": _WEBP_QUALITY, "method": 4}
    unit_ms = 1
    if path.suffix == ".gif":
        images, unit_ms, how = map(_few_colours, images), _GIF_UNIT_MS, {}
    begins_ms = [unit_ms * round(1000 * k / (fps * unit_ms)) for k in range(n_frames + 1)]
    durations_ms = [end - begin for begin, end in pairwise(begins_ms)]
    next(images).save(path, save_all=True, append_images=images, duration=durations_ms, loop=0, **how)


def _few_colours(image: Image.Image) -> Image.Image:
    """The picture in 256 colours of its own. An octree keeps rare ones, such as those of thin lines."""
    return image.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def _encode_mp4(frames: Iterable[U8], path: Path, fps: int, width_px: int, height_px: int) -> None:
    """As browsers play it: 4:2:0, the index in front."""
    av = _av()
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as file:
        stream = file.add_stream("libx264", rate=Fraction(fps), options=_QUALITY)
        stream.width, stream.height, stream.pix_fmt = width_px, height_px, "yuv420p"
        for image in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def _av() -> Any:
    try:
        import av
    except ImportError:
        raise MissingExtraError("An MP4", "video") from None
    return av
