"""How the ground moved between two pictures, against how it should have by the estimated poses.

The earlier picture is warped into the later one over the ground's plane. Phase correlation (Kuglin and Hines,
1975) finds the remaining shift, local correlation whether the two then show the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F32, F64
from skysweep.geometry.camera import CameraPose, Lens, rays_enu
from skysweep.types import U8, Frame

Mask = NDArray[np.bool_]

CELLS = (9, 16)  # rows and columns of the small picture
_WIDTH_PX = 160  # of it
_TEXTURED, _OVER_NOISE = 2.0, 2.0  # standard deviation in grey levels and over the noise's; less may be noise
_PEAKS = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6.0  # unit noise stays unit noise
_MAD = 1.4826  # to the standard deviation of a normal distribution
_ALIKE = 0.6  # local correlation of two pictures that show the same
_PATCH_PX = 15  # over which they are correlated
_COARSE_PX = 6.0  # slower changes of brightness are light, not texture
_FITS = 0.5  # share that is alike
_MANOEUVRES = (((-9.0, -6.0, -3.0, 3.0, 6.0, 9.0), (1.0,)), ((-1.5, 0.0, 1.5), (0.96, 1.04)))
# degrees and scales, in turn, by which heading, gimbal and height may lag
_FINE_PX, _MIDDLE_PX = 1.0, 2.5
_SHOWS, _SHOWS_SHARE = 1.0, 0.05  # grey levels of detail, and share of the picture with any
_OF_EDGES = 0.5  # median over root mean square of the finest: of edges on plain ground it is less
_MOVED_PX = 2.0
_SLANT = -0.3  # of a line of sight that meets nearby ground
_CENTRES = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])  # of OpenCV's pixels


@dataclass(frozen=True, slots=True)
class View:
    """A small picture's texture, and its estimated pose."""

    time_s: float
    texture: F32  # (h, w) grey levels without slow changes of brightness
    contrast: F32  # (h, w) its standard deviation around each pixel
    camera: CameraPose
    lens: Lens  # of the small picture
    sharpness: float  # finest over coarser detail, squared; inf: no detail
    noise: float  # grey levels, standard deviation; fine texture counts as well
    brightness: float  # its mean
    remembered: F32  # (h, w) contrast of the ground in sight, in this picture or one before


class GroundMotion(NamedTuple):
    """The comparison of two pictures. Velocities are of the camera, horizontal, ENU."""

    elapsed_s: float
    believed_mps: F64  # (2,)
    excess_mps: F64  # (2,) of what the pictures show over that
    overlap: float  # share of the later picture that the earlier one shows too
    textured: float  # share of the overlap where both have texture
    alike: float  # share of that where both show the same
    moved: Mask  # CELLS in both that should have moved
    followed: Mask  # CELLS with texture that moved with the rest
    same: Mask  # CELLS that show the same as before
    still: Mask  # those, and CELLS that show nothing where the ground has texture
    tells: Mask  # CELLS of which either would be known
    remembered: F32  # that of the later ``View``, with the earlier one's

    @property
    def believed_m(self) -> F64:
        """(2,) the estimated way."""
        return self.believed_mps * self.elapsed_s

    @property
    def excess_m(self) -> F64:
        """(2,) of what the pictures show over that."""
        return self.excess_mps * self.elapsed_s


def view_of(frame: Frame, grey: U8) -> View:
    """The view of a frame whose picture is ``grey`` (H, W)."""
    width, height = frame.lens.width_px, frame.lens.height_px
    lens = Lens(_WIDTH_PX, max(1, round(_WIDTH_PX * height / width)), frame.lens.hfov_rad)
    small = cv2.resize(grey, (lens.width_px, lens.height_px), interpolation=cv2.INTER_AREA).astype(np.float32)
    texture = small - cv2.GaussianBlur(small, (0, 0), _COARSE_PX)
    noise, contrast, brightness = _noise(grey, lens), _contrast(texture), float(small.mean())
    sharpness = _sharpness(texture, contrast, noise)
    return View(frame.time_s, texture, contrast, frame.camera, lens, sharpness, noise, brightness, contrast)


def _noise(grey: U8, small: Lens) -> float:
    """The standard deviation of the noise in the small picture of ``grey``.

    By the Laplacian of Immerkaer (1996) at twice the small size, where texture is weaker than noise and JPEG
    has kept the noise; the median ignores edges.
    """
    twice = cv2.resize(grey, (2 * small.width_px, 2 * small.height_px), interpolation=cv2.INTER_AREA)
    peaks = cv2.filter2D(twice, cv2.CV_32F, _PEAKS)[::2, ::2]
    return 0.5 * _MAD * float(np.median(np.abs(peaks)))


def _sharpness(texture: F32, contrast: F32, noise: float) -> float:
    """Of what shows detail: a roof or a meadow is no less sharp for showing none. inf: single edges only."""
    shows = contrast >= max(_SHOWS, _OVER_NOISE * noise)
    if shows.mean() < _SHOWS_SHARE:
        return math.inf
    coarser = np.abs(cv2.GaussianBlur(texture, (0, 0), _MIDDLE_PX))[shows]
    finest = np.abs(texture - cv2.GaussianBlur(texture, (0, 0), _FINE_PX))[shows]
    if np.median(finest) < _OF_EDGES * math.sqrt(float(np.mean(finest * finest))):
        return math.inf
    return float(np.median(finest) / np.median(coarser)) ** 2


def looks_down(lens: Lens, camera: CameraPose) -> bool:
    """Whether all of a picture shows nearby ground."""
    return bool(rays_enu(lens, camera, lens.corners_px)[:, 2].max() < _SLANT)


def motion(before: View, now: View, ground_m: float) -> GroundMotion:
    """Compare two views of one camera that ``looks_down``, over ground at ``ground_m`` ENU."""
    lens, (rows, columns) = now.lens, CELLS
    width, height = lens.width_px, lens.height_px
    onto_now = _ground_to_pixel(lens, now.camera, ground_m)
    warp = onto_now @ np.linalg.inv(_ground_to_pixel(lens, before.camera, ground_m))
    overlap = _warped(before.texture, warp)[1]
    fit = max(_shifted(before, now, warp), _fit(before, now, warp), key=_alike)
    for turns_deg, scales in _MANOEUVRES if fit.alike < _FITS else ():
        tried = [_turned(lens, turn, scale) @ fit.warp for turn in turns_deg for scale in scales]
        fit = max(fit, *(_shifted(before, now, turned) for turned in tried), key=_alike)
    same = _correlation(before.texture, now.texture, before.contrast, now.contrast) >= _ALIKE
    same &= np.maximum(before.contrast, now.contrast) >= _TEXTURED
    remembered = _warped(before.remembered, fit.warp)[0]
    hidden = (remembered >= _textured(before, now)) & (now.contrast < _TEXTURED)

    def cells(mask: Mask) -> Mask:
        return cv2.resize(mask.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA) >= 0.5

    elapsed_s = now.time_s - before.time_s
    middle = np.array([width / 2, height / 2, 1.0])
    off = _on_ground(onto_now, fit.warp @ np.linalg.solve(warp, middle)) - _on_ground(onto_now, middle)
    ys, xs = (np.mgrid[:rows, :columns] + 0.5) * np.array([height / rows, width / columns])[:, None, None]
    was = np.linalg.inv(fit.warp) @ np.stack([xs, ys, np.ones_like(xs)]).reshape(3, -1)
    moved_px = np.hypot(was[0] / was[2] - xs.ravel(), was[1] / was[2] - ys.ravel()).reshape(rows, columns)
    return GroundMotion(
        elapsed_s,
        (now.camera.position_enu_m - before.camera.position_enu_m)[:2] / elapsed_s,
        -off / elapsed_s,
        float(overlap.mean()),
        fit.textured,
        fit.alike,
        cells(fit.inside) & (moved_px >= _MOVED_PX),
        cells(fit.followed),
        cells(same),
        cells(same | hidden),
        cells(same | hidden | (now.contrast >= _TEXTURED)),
        np.maximum(now.contrast, remembered),
    )


class _Fit(NamedTuple):
    warp: F64  # of the earlier picture
    textured: float
    alike: float
    inside: Mask
    followed: Mask


def _fit(before: View, now: View, warp: F64) -> _Fit:
    """How well the earlier picture, warped, fits the later one."""
    seen, inside = _warped(before.texture, warp)
    contrast = _contrast(seen)
    textured = (np.minimum(contrast, now.contrast) >= _textured(before, now)) & inside
    followed = textured & (_correlation(seen, now.texture, contrast, now.contrast) >= _ALIKE)
    n_textured = int(np.count_nonzero(textured))
    return _Fit(
        warp,
        n_textured / max(int(np.count_nonzero(inside)), 1),
        int(np.count_nonzero(followed)) / max(n_textured, 1),
        inside,
        followed,
    )


def _textured(before: View, now: View) -> float:
    """The least contrast of texture: with half of it noise, two views still correlate by 0.75."""
    return max(_TEXTURED, _OVER_NOISE * max(before.noise, now.noise))


def _alike(fit: _Fit) -> float:
    return fit.alike


def _shifted(before: View, now: View, warp: F64) -> _Fit:
    """The best fit of the earlier picture, warped and then shifted."""
    expected, overlap = _warped(before.texture, warp)
    (dx, dy), _ = cv2.phaseCorrelate(expected, now.texture * overlap, _window(now.lens))
    return _fit(before, now, np.array([[1.0, 0.0, dx], [0.0, 1.0, dy], [0.0, 0.0, 1.0]]) @ warp)


def _turned(lens: Lens, turn_deg: float, scale: float) -> F64:
    """(3, 3): a turn around the middle of the picture, and a scale."""
    middle = lens.width_px / 2, lens.height_px / 2
    return np.vstack([cv2.getRotationMatrix2D(middle, turn_deg, scale), [0.0, 0.0, 1.0]])


def _ground_to_pixel(lens: Lens, camera: CameraPose, ground_m: float) -> F64:
    """(3, 3): east, north, 1 on a plane at ``ground_m`` to homogeneous pixels."""
    R, (x, y, z) = camera.R_camera_to_enu.T, camera.position_enu_m.tolist()
    return np.asarray(lens.K @ np.column_stack([R[:, 0], R[:, 1], R @ np.array([-x, -y, ground_m - z])]))


def _on_ground(ground_to_pixel: F64, pixel: F64) -> F64:
    """East and north of a homogeneous pixel."""
    x, y, w = np.linalg.solve(ground_to_pixel, pixel)
    return np.array([x / w, y / w])


def _warped(texture: F32, warp: F64) -> tuple[F32, Mask]:
    """The warped texture, 0 outside, and where it is inside."""
    height, width = texture.shape
    by = _CENTRES @ warp @ np.linalg.inv(_CENTRES)
    there = cv2.warpPerspective(np.ones_like(texture), by, (width, height)) > 0.999
    return np.asarray(cv2.warpPerspective(texture, by, (width, height)) * there, np.float32), there


def _contrast(texture: F32) -> F32:
    mean = _mean(texture)
    return np.asarray(np.sqrt(np.maximum(_mean(texture * texture) - mean * mean, 0.0)), np.float32)


def _correlation(a: F32, b: F32, contrast_a: F32, contrast_b: F32) -> F32:
    covariance = _mean(a * b) - _mean(a) * _mean(b)
    return np.asarray(covariance / np.maximum(contrast_a * contrast_b, 1e-3), np.float32)


def _mean(a: F32) -> F32:
    return np.asarray(cv2.boxFilter(a, -1, (_PATCH_PX, _PATCH_PX)), np.float32)


@lru_cache
def _window(lens: Lens) -> F32:
    return np.asarray(cv2.createHanningWindow((lens.width_px, lens.height_px), cv2.CV_32F), np.float32)
