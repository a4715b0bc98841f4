"""Reads pose, lens and time of a drone's picture from its EXIF and XMP.

Which names hold what, and which way their angles count:

- DJI (``drone-dji``), newer Autel (``drone``): GpsLatitude, GpsLongitude (by some misspelt GpsLongtitude),
  AbsoluteAltitude, RelativeAltitude above the take-off place, GimbalYawDegree, GimbalPitchDegree (-90:
  straight down), GimbalRollDegree, CalibratedFocalLength in pixels. https://exiftool.org/TagNames/DJI.html
- Parrot (``drone-parrot``): CameraYawDegree, CameraPitchDegree, CameraRollDegree, in north-east-down axes.
  https://developer.parrot.com/docs/groundsdk-tools/photo-metadata.html
- Older Autel, senseFly: Camera:Yaw, Camera:Pitch, Camera:Roll, with 0 straight down and 90 at the horizon.
  https://support.pix4d.com/hc/en-us/articles/205732309-EXIF-and-XMP-tag-information-read-by-Pix4D-Desktop
- Skydio (``drone-skydio``): Latitude, Longitude, AbsoluteAltitude and the structure CameraOrientationNED.
  https://support.skydio.com/hc/en-us/articles/4417425974683-Skydio-camera-and-metadata-overview
- Teledyne FLIR's Hadron, as on the Teal 2 (``exif``): CameraYaw, CameraPitch and CameraRoll count from the
  airframe, whose own are PlatformYaw, PlatformPitch and PlatformRoll; CameraHorizontalFOV in degrees.
  https://github.com/Theta-Limited/OpenAthenaAndroid/issues/159
- FLIR's Duo Pro R (``FLIR``): MAVRelativeAltitude, from the autopilot; 0 without one. Its angles, MAVYaw,
  MAVPitch and MAVRoll, are the aircraft's. Appendix B of https://www.manualslib.com/manual/1561119/Flir-Duo-Pro-R.html

EXIF (CIPA DC-008) has the place of every camera with a receiver, and the focal length as on 35 mm film, which
is meant along the diagonal (CIPA DCG-001).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from PIL import Image

from skysweep.detection.photos.taken import Taken
from skysweep.detection.photos.xmp import packet_of, properties
from skysweep.errors import UserError

_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
_EXIF_IFD, _GPS_IFD = 0x8769, 0x8825
_MAKE = 0x010F
_ORIENTATION, _ON_ITS_SIDE = 0x0112, (5, 6, 7, 8)
_TIME, _OFFSET, _SUBSECOND = 0x9003, 0x9011, 0x9291  # of the original
_FOCAL_35, _DIGITAL_ZOOM = 0xA405, 0xA404
_LOOKS_DOWN_AT_0 = ("autel", "sensefly", "sentera")  # makes whose Camera:Pitch is 0 straight down
_MM_PER_UNIT = {2: 25.4, 3: 10.0}  # of EXIF's focal plane resolution
_WIDEST_RAD, _NARROWEST_RAD = math.radians(150.0), math.radians(1.0)

Tags = Mapping[Any, Any]


def taken_of(path: Path) -> Taken:
    """What a picture's file says of its exposure. Raises UserError if it is no picture.

    Damaged or implausible values count as not there.
    """
    try:
        with Image.open(path) as picture:
            size_px, tags, gps, xmp = picture.size, *_tags(picture), _xmp(picture)
    except Exception as error:  # Pillow raises whatever its readers do on damaged files
        raise UserError(f"{path}: not a readable picture") from error
    return _pose(tags, gps, xmp).filled_from(_clock(tags, gps, xmp)).filled_from(_lens(tags, xmp, size_px))


def size_px_of(path: Path) -> tuple[int, int]:
    """A picture's width and height. Raises UserError if it is no picture."""
    try:
        with Image.open(path) as picture:
            return picture.size
    except Exception as error:  # as above
        raise UserError(f"{path}: not a readable picture") from error


def upright_size_px_of(path: Path) -> tuple[int, int]:
    """Width and height of a picture turned as its EXIF says. Raises UserError if it is no picture."""
    try:
        with Image.open(path) as picture:
            width_px, height_px = picture.size
            turned = _tags(picture)[0].get(_ORIENTATION) in _ON_ITS_SIDE
    except Exception as error:  # as above
        raise UserError(f"{path}: not a readable picture") from error
    return (height_px, width_px) if turned else (width_px, height_px)


def _tags(picture: Image.Image) -> tuple[Tags, Tags]:
    """EXIF's tags, with those of the exposure, and those of the receiver; empty where they are damaged."""
    try:
        exif = picture.getexif()
        return {**exif, **exif.get_ifd(_EXIF_IFD)}, exif.get_ifd(_GPS_IFD)
    except Exception:  # as above; a picture with damaged EXIF may still be shown to a detector
        return {}, {}


def _xmp(picture: Image.Image) -> Mapping[str, str]:
    segments = [body for name, body in getattr(picture, "applist", []) if name == "APP1"]
    packets = [packet for segment in segments if (packet := packet_of(segment)) is not None]
    stored = picture.info.get("xmp") or picture.info.get("XML:com.adobe.xmp")
    if not packets and stored:
        packets = [stored.encode() if isinstance(stored, str) else bytes(stored)]
    found: dict[str, str] = {}
    for packet in packets:
        found = {**properties(packet), **found}
    return found


def _pose(tags: Tags, gps: Tags, xmp: Mapping[str, str]) -> Taken:
    latitude = _first(xmp, "GpsLatitude", "Latitude")
    longitude = _first(xmp, "GpsLongitude", "GpsLongtitude", "Longitude")
    if not _is_fix(latitude, longitude):
        latitude, longitude = _degrees(gps, 2, "S"), _degrees(gps, 4, "W")
    if not _is_fix(latitude, longitude):
        latitude = longitude = None
    altitude = _first(xmp, "AbsoluteAltitude")
    if altitude is None and (altitude := _number(gps.get(6))) is not None:
        altitude *= -1.0 if gps.get(5) in (1, b"\x01") else 1.0
    height = _first(xmp, "RelativeAltitude")
    if height is None:
        height = _positive(_first(xmp, "MAVRelativeAltitude"))
    heading, pitch, roll = _attitude(str(tags.get(_MAKE, "")).lower(), xmp)
    return Taken(
        latitude,
        longitude,
        altitude,
        height,
        _positive(_first(xmp, "Camera:AboveGroundAltitude")),
        heading,
        pitch,
        roll,
    )


def _is_fix(latitude: float | None, longitude: float | None) -> bool:
    """Whether they are a place; 0, 0 stands for no fix yet."""
    if latitude is None or longitude is None or (latitude, longitude) == (0.0, 0.0):
        return False
    return abs(latitude) <= 90.0 and abs(longitude) <= 180.0


def _attitude(make: str, xmp: Mapping[str, str]) -> tuple[float | None, float | None, float | None]:
    """Heading, pitch above the horizon and roll of the camera in degrees."""
    for yaw_name, pitch_name, roll_name in (
        ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree"),
        ("CameraYawDegree", "CameraPitchDegree", "CameraRollDegree"),
        ("CameraOrientationNED.Yaw", "CameraOrientationNED.Pitch", "CameraOrientationNED.Roll"),
    ):
        if (pitch := _first(xmp, pitch_name)) is not None:
            return _first(xmp, yaw_name), pitch, _first(xmp, roll_name)
    if (pitch := _sum(xmp, "CameraPitch", "PlatformPitch")) is not None:
        return _sum(xmp, "CameraYaw", "PlatformYaw"), pitch, _sum(xmp, "CameraRoll", "PlatformRoll")
    if make.startswith(_LOOKS_DOWN_AT_0) and (pitch := _first(xmp, "Camera:Pitch")) is not None:
        return _first(xmp, "Camera:Yaw"), pitch - 90.0, _first(xmp, "Camera:Roll")
    return None, None, None


def _lens(tags: Tags, xmp: Mapping[str, str], size_px: tuple[int, int]) -> Taken:
    """The horizontal field of view: calibrated, as on 35 mm film, or from the size of the sensor's pixels."""
    width_px, height_px = size_px
    focal_px = _first(xmp, "CalibratedFocalLength")
    centre_px = _first(xmp, "CalibratedOpticalCenterX")
    if focal_px and centre_px:  # of the sensor's pixels, which the picture may have fewer of
        focal_px *= width_px / (2.0 * centre_px)
    if not focal_px and (film_mm := _number(tags.get(_FOCAL_35))):
        focal_px = film_mm / _FILM_DIAGONAL_MM * math.hypot(width_px, height_px)
    if not focal_px:
        focal_mm, per_unit = _number(tags.get(0x920A)), _number(tags.get(0xA20E))
        sensor_px, unit_mm = _number(tags.get(0xA002)) or width_px, _MM_PER_UNIT.get(tags.get(0xA210, 2))
        if focal_mm and per_unit and unit_mm and per_unit > 100.0:  # 72 is that of a screen
            focal_px = focal_mm * per_unit / unit_mm * width_px / sensor_px
    hfov_deg = _first(xmp, "CameraHorizontalFOV")
    if hfov_deg is not None:
        hfov_rad = math.radians(hfov_deg)
    elif (_number(tags.get(_DIGITAL_ZOOM)) or 1.0) > 1.0:
        return Taken()  # makes differ in whether their focal lengths count it
    elif focal_px and focal_px > 0.0:
        hfov_rad = 2.0 * math.atan(width_px / (2.0 * focal_px))
    else:
        return Taken()
    return Taken(hfov_rad=hfov_rad) if _NARROWEST_RAD <= hfov_rad <= _WIDEST_RAD else Taken()


def _clock(tags: Tags, gps: Tags, xmp: Mapping[str, str]) -> Taken:
    """The time of the exposure, and as UTC where a zone or a receiver tells it."""
    try:
        taken = datetime.strptime(str(tags[_TIME]).strip("\x00 "), "%Y:%m:%d %H:%M:%S")
    except (KeyError, ValueError):
        return Taken()
    share = _number(f"0.{str(tags.get(_SUBSECOND, '0')).strip()}") or 0.0
    seconds = taken.replace(tzinfo=timezone.utc).timestamp() + share
    for told in (xmp.get("UTCAtExposure"), f"{taken.isoformat()}{tags.get(_OFFSET, '')}", _stamp(gps)):
        try:
            utc = datetime.fromisoformat(str(told).replace("Z", "+00:00"))
        except ValueError:
            continue
        if utc.tzinfo is not None:
            return Taken(time_s=seconds, utc=utc.astimezone(timezone.utc))
        if told == xmp.get("UTCAtExposure"):
            return Taken(time_s=seconds, utc=utc.replace(tzinfo=timezone.utc))
    return Taken(time_s=seconds)


def _stamp(gps: Tags) -> str:
    """EXIF's date and time of the receiver, in ISO 8601."""
    try:
        hours, minutes, seconds = (float(part) for part in gps[7])
        return f"{str(gps[29]).replace(':', '-')}T{hours:02.0f}:{minutes:02.0f}:{int(seconds):02d}+00:00"
    except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError):
        return ""


def _degrees(gps: Tags, at: int, negative: str) -> float | None:
    """EXIF's degrees, minutes and seconds; the reference is in the tag before."""
    try:
        parts = [float(part) for part in gps[at]]
    except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    value = sum(part / 60.0**k for k, part in enumerate(parts))
    sign = -1.0 if str(gps.get(at - 1, "")).strip("\x00 ").upper() == negative else 1.0
    return sign * value if math.isfinite(value) else None


def _first(xmp: Mapping[str, str], *names: str) -> float | None:
    return next((v for name in names if (v := _number(xmp.get(name))) is not None), None)


def _sum(xmp: Mapping[str, str], *names: str) -> float | None:
    numbers = [_number(xmp.get(name)) for name in names]
    return None if None in numbers else sum(number for number in numbers if number is not None)


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0.0 else None


def _number(value: Any) -> float | None:
    """A finite number, also where XMP writes it as a fraction; None if it is none."""
    try:
        above, _, below = value.partition("/") if isinstance(value, str) else (value, "", "")
        number = float(above) / float(below or 1.0)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) else None
