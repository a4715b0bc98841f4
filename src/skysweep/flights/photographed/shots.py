"""The pictures of a flight, from a folder or a video, each with how it was taken."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from skysweep.arrays import U8
from skysweep.detection.photos.exif import size_px_of, taken_of
from skysweep.detection.photos.pixels import read_picture
from skysweep.detection.photos.pose_table import PoseTable
from skysweep.detection.photos.taken import Taken
from skysweep.detection.training.labelled import PICTURE_SUFFIXES, pictures_below
from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens

_STEP_S = 1.0  # between pictures without a clock
_LEAST_STEP_S = 0.1  # between two pictures: their names tell tenths of a second
_FAR_KM = 20.0  # from most others: no picture of the same flight
_EARTH_KM = 6371.0  # its radius


class Shot(NamedTuple):
    """One exposure."""

    name: str
    path: Path  # of the picture, or of the video that it is a frame of
    taken: Taken
    size_px: tuple[int, int]
    time_s: float  # since the first one, ascending
    frame_s: float | None = None  # where it is in the video

    @property
    def lens(self) -> Lens:
        """The lens; the field of view is known."""
        assert self.taken.hfov_rad is not None
        return Lens(*self.size_px, self.taken.hfov_rad)


class Problem(NamedTuple):
    """A picture that was left out, and why."""

    name: str
    why: str


def shots_of(
    source: Path, table: PoseTable | None, hfov_rad: float | None, every_s: float, has_dem: bool
) -> tuple[list[Shot], list[Problem]]:
    """The usable exposures of a folder of pictures or a video in the order of their time, and the others.

    ``hfov_rad`` serves where nothing else tells the lens. With ``has_dem`` a height above sea level will do.
    Raises UserError if there is none that can be used, naming why the first cannot.
    """
    if source.is_dir():
        found, problems = _in_folder(source, table)
    elif source.is_file() and source.suffix.lower() not in PICTURE_SUFFIXES:
        found, problems = _in_video(source, table, every_s), []
    else:
        raise UserError(f"{source}: is neither a folder of pictures nor a video; write the path of one")
    usable: list[Shot] = []
    for shot in found:
        filled = shot._replace(taken=shot.taken.filled_from(Taken(hfov_rad=hfov_rad)))
        missing = _missing(filled, has_dem)
        if missing:
            problems.append(Problem(shot.name, missing))
        else:
            usable.append(filled)
    for keep_usual in (_of_one_size, _of_one_place):
        usable, others = keep_usual(usable)
        problems += others
    if not usable:
        first = f"{problems[0].name} {problems[0].why}" if problems else "there are none in it"
        raise UserError(f"{source}: no picture can be put on the map: {first}")
    return _in_time(usable), sorted(problems)


def _missing(shot: Shot, has_dem: bool) -> str:
    """In words, what keeps a picture from being put on the map; empty if nothing does."""
    taken = shot.taken
    if taken.latitude_deg is None or taken.longitude_deg is None:
        return "does not say where it was taken; give latitude_deg and longitude_deg with --poses"
    over_ground_m = taken.over_ground_m
    if over_ground_m is None and not (has_dem and taken.altitude_amsl_m is not None):
        return "does not say how high it was taken; give height_m with --poses, or --dem with altitude_amsl_m"
    if over_ground_m is not None and over_ground_m <= 0.0 and not has_dem:
        return f"was taken {over_ground_m:g} m above take-off, which is no height; give --dem or height_m"
    if taken.R_camera_to_enu is None:
        return "does not say where its camera looked; give heading_deg and pitch_deg with --poses"
    if taken.hfov_rad is None:
        return "does not say its lens; give --hfov-deg, or hfov_deg with --poses"
    if not shot.lens.seen_ground_m2(CameraPose(np.zeros(3), taken.R_camera_to_enu), 1.0):
        return (
            f"shows no ground, as its camera looks up (pitch_deg {taken.pitch_deg:g}; straight down is -90)"
        )
    return ""


def _in_folder(folder: Path, table: PoseTable | None) -> tuple[list[Shot], list[Problem]]:
    found, problems, paths = [], [], pictures_below(folder)
    told = [Taken()] * len(paths) if table is None else table.of_pictures(paths, folder)
    for path, row in zip(paths, told, strict=True):
        name = str(path.relative_to(folder))
        try:
            taken, size_px = row.filled_from(taken_of(path)), size_px_of(path)
        except UserError:
            problems.append(Problem(name, "is no readable picture"))
            continue
        found.append(Shot(name, path, taken, size_px, math.nan))
    return found, problems


def _in_video(path: Path, table: PoseTable | None, every_s: float) -> list[Shot]:
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # it warns of what is no video
    video = cv2.VideoCapture(str(path))
    try:
        width, height, rate, n = (
            float(video.get(prop))
            for prop in (
                cv2.CAP_PROP_FRAME_WIDTH,
                cv2.CAP_PROP_FRAME_HEIGHT,
                cv2.CAP_PROP_FPS,
                cv2.CAP_PROP_FRAME_COUNT,
            )
        )
    finally:
        video.release()
    if not (width > 0 and height > 0 and rate > 0 and n >= 1):
        raise UserError(f"{path}: is no readable video; give a folder of pictures or a video file")
    if table is None or not table.times_s:
        raise UserError(f"{path}: a video does not say where it was taken; give --poses with a column time_s")
    found = []
    for k in range(math.floor((n - 1) / rate / every_s) + 1):
        time_s = k * every_s
        taken = table.at(time_s)
        if taken is not None:
            name = f"{path.name}@{time_s:.2f}s"
            found.append(Shot(name, path, taken, (int(width), int(height)), math.nan, time_s))
    if not found:
        raise UserError(f"{path}: the poses are of other times than the video's; count time_s from its start")
    return found


def _of_one_size(found: list[Shot]) -> tuple[list[Shot], list[Problem]]:
    """Those of the commonest size: a folder may hold the pictures of a second camera, too."""
    sizes = [shot.size_px for shot in found]
    usual = max(dict.fromkeys(sizes), key=sizes.count, default=None)
    others = [
        Problem(s.name, f"is {s.size_px[0]} x {s.size_px[1]}, not as most; look at it in a run of its own")
        for s in found
        if s.size_px != usual
    ]
    return [s for s in found if s.size_px == usual], others


def _of_one_place(found: list[Shot]) -> tuple[list[Shot], list[Problem]]:
    """Those around the place with most others: a folder may hold pictures of an earlier flight, too."""
    if not found:
        return [], []
    lat, lon = np.radians([shot.taken.lat_lon_deg for shot in found]).T
    places_km = _EARTH_KM * np.column_stack(
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    )
    near = cKDTree(places_km).query_ball_point(places_km, _FAR_KM, return_length=True)
    away_km = np.linalg.norm(places_km - places_km[int(np.argmax(near))], axis=1).tolist()
    others = [
        Problem(s.name, f"was taken {away:.0f} km away from most; look at it in a run of its own")
        for s, away in zip(found, away_km, strict=True)
        if away > _FAR_KM
    ]
    return [s for s, away in zip(found, away_km, strict=True) if away <= _FAR_KM], others


def _in_time(found: list[Shot]) -> list[Shot]:
    """In the order of the camera's clock; of their names, where one has no clock."""
    clocks = [shot.taken.time_s for shot in found]
    if any(clock is None for clock in clocks):
        return [s._replace(time_s=k * _STEP_S) for k, s in enumerate(sorted(found, key=lambda s: s.name))]
    ordered = sorted(found, key=lambda s: (s.taken.time_s, s.name))
    first_s = ordered[0].taken.time_s or 0.0
    timed: list[Shot] = []
    for shot in ordered:
        since_s = (shot.taken.time_s or 0.0) - first_s
        after_s = timed[-1].time_s + _LEAST_STEP_S if timed else 0.0
        timed.append(shot._replace(time_s=round(max(since_s, after_s), 3)))
    return timed


class Reader:
    """Reads the pictures of shots, best in their order: a video is opened once."""

    def __init__(self) -> None:
        self._video: tuple[Path, cv2.VideoCapture] | None = None

    def read(self, shot: Shot) -> U8:
        """The picture (H, W, 3) RGB as the sensor saw it. Raises UserError as ``read_picture``."""
        image: Any
        if shot.frame_s is None:
            image = read_picture(shot.path, upright=False)
        else:
            if self._video is None or self._video[0] != shot.path:
                self.close()
                self._video = shot.path, cv2.VideoCapture(str(shot.path))
            video = self._video[1]
            video.set(cv2.CAP_PROP_POS_MSEC, 1000.0 * shot.frame_s)
            there, image = video.read()
            image = image[..., ::-1] if there else None
        if image is None or image.shape[1::-1] != shot.size_px:
            raise UserError(f"{shot.path}: is damaged")
        return np.ascontiguousarray(image, dtype=np.uint8)

    def close(self) -> None:
        """Close the video."""
        if self._video is not None:
            self._video[1].release()
            self._video = None
