"""The model of the statistical sensor: a small YAML file for one detector and one camera.

The score of a look at an object is the detector's confidence on the scale -log(-log c). It is normal: mean
and spread depend on the pixels on target; the FACTORS and the ground shift the mean. Scores above the
threshold are reported, so that one score explains detection rate and confidence (a Tobit model: Tobin,
Econometrica 26, 1958), apart from a share of unexplained lapses (Wichmann and Hill, Perception &
Psychophysics 63, 2001). Looks at one object have a part of their luck in common, of the score and of lapses,
and looks at one aspect of it another: from a like direction, equally large.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from skysweep.detection.model_files import existing_model_file, sha256_of
from skysweep.errors import UserError
from skysweep.files.models import validated
from skysweep.files.plain_yaml import MAX_YAML_BYTES, parse_fields
from skysweep.files.reading import read_text_limited
from skysweep.geometry.camera import Lens
from skysweep.scenarios.model import CameraKind, CameraModel, DetectorModel, Scenario
from skysweep.sensing.statistical.factors import (
    BLUR_MAX,
    CONTRAST_USUAL,
    LENS_OCTAVES,
    NAMES,
    TOO_SMALL,
    VIEW_MAX,
)
from skysweep.sensing.statistical.view import View

VERSION = 12  # 11 had no false reports of trees that an edge of the picture cuts
MAX_ENLARGED = 2.0  # times that a camera's pixels may be enlarged for the detector
_ROUNDING = 1.001
_VIEW_MAX_DEG = math.degrees(math.asin(math.sqrt(VIEW_MAX)))


def score_of(confidence: ArrayLike) -> NDArray[np.float64]:
    """Scores of confidences (0..1): the scale on which looks at one object are closest to normal."""
    return np.asarray(-np.log(-np.log(np.asarray(confidence, dtype=float))))


def confidence_of(score: ArrayLike) -> NDArray[np.float64]:
    """The inverse of ``score_of``."""
    return np.asarray(np.exp(-np.exp(-np.asarray(score, dtype=float))))


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class KindModel(_Part):
    """How one kind of object in one pose is reported as one class.

    The score's mean at some pixels is ``score`` there, plus ``grounds`` of the surface below (a rock may pass
    for a person on grass and not on snow), plus each of the FACTORS times its number here, plus ``lens`` for
    each octave of the focal length over the calibrated one: from farther away nothing leans out of the
    picture's middle.
    """

    kind: str
    pose: str
    reported_as: str
    score: list[float] = Field(description="Over the grid: mean from straight above, whole and sharp")
    spread: list[float] = Field(description="Over the grid: standard deviation")
    lapse: list[Annotated[float, Field(ge=0, lt=1)]] = Field(
        description="Over the grid: share of looks not reported whatever the score, in the open"
    )
    lapse_among: list[Annotated[float, Field(ge=0, lt=1)]] = Field(
        description="The same beside a crown, in the shade, or partly hidden"
    )
    view: float
    front: float
    front_near: float
    hidden: float
    cut: float
    edge_y: float
    beside: float
    shade: float
    blur: float
    contrast: float
    company: float
    lens: float
    grounds: dict[str, float] = Field(description="Added to the mean, by surface; the usual one adds 0")
    object_share: float = Field(ge=0, le=1, description="Of the variance: the object's own, in every look")
    aspect_share: float = Field(ge=0, le=1, description="Of the variance: common to looks at one aspect")
    fade_rad: float = Field(gt=0, description="Turn of the line of sight that leaves 1/e of an aspect's luck")
    lapse_object_share: float = Field(
        0, ge=0, le=1, description="Of the lapses: the object's own, in every look"
    )
    lapse_aspect_share: float = Field(
        0, ge=0, le=1, description="Of the lapses: common to looks at one aspect"
    )

    @property
    def factors(self) -> tuple[float, ...]:
        """In the order of FACTORS."""
        return tuple(getattr(self, name) for name in NAMES)

    @model_validator(mode="after")
    def _shares(self) -> KindModel:
        if self.object_share + self.aspect_share > 1:
            raise ValueError("object_share and aspect_share are more than 1 together")
        if self.lapse_object_share + self.lapse_aspect_share > 1:
            raise ValueError("lapse_object_share and lapse_aspect_share are more than 1 together")
        return self

    def scores(self, surface: str, lens_octaves: float) -> NDArray[np.float64]:
        """(G,) means of the score on that surface through that lens, before the FACTORS."""
        return np.array(self.score) + self.grounds.get(surface, 0.0) + self.lens * lens_octaves

    def lapses(self, is_among: bool) -> tuple[NDArray[np.float64], ...]:
        """(G,) chances of a lapse that is the object's own; else, of the aspect; else, of the look alone.

        ``is_among`` trees and buildings there are more than in the open.
        """
        lapse = np.array(self.lapse_among if is_among else self.lapse)
        own = self.lapse_object_share * lapse
        of_aspect = self.lapse_aspect_share * lapse / (1.0 - own)
        return own, of_aspect, 1.0 - (1.0 - lapse) / ((1.0 - own) * (1.0 - of_aspect))


class ContrastModel(_Part):
    """Difference in colour (CIE76) between objects of a kind and the ground: mean and spread by surface."""

    kind: str
    pose: str
    surfaces: dict[str, tuple[float, float]]


class BackgroundModel(_Part):
    """False reports, of places where nothing is."""

    reported_as: str
    altitude_agl_m: list[float] = Field(min_length=1)
    per_hectare: list[float] = Field(description="In one look, with confidences above the floor")
    surfaces: dict[str, float] = Field(description="Factor on per_hectare by what the ground is")
    per_tree: list[float] = Field(description="Of trees and bushes, in one look at one, at these altitudes")
    per_cut_tree: list[float] = Field(
        description="The same of one whose crown an edge of the picture cuts, with a box that it cuts"
    )
    score_scale: list[float] = Field(description="Mean of their score over the floor, at these altitudes")
    score_shape: float = Field(gt=0, description="Of the Weibull distribution of that; 1 is exponential")
    again: float = Field(gt=0, le=1, description="Chance that the next look reports it again")
    same_share: float = Field(ge=0, le=1, description="Of the score's variance: the same in every look")
    pixels: float = Field(gt=0)

    @model_validator(mode="after")
    def _tables_fit_altitudes(self) -> BackgroundModel:
        for name in ("per_hectare", "per_tree", "per_cut_tree", "score_scale"):
            if len(getattr(self, name)) != len(self.altitude_agl_m):
                raise ValueError(
                    f"{name} must have {len(self.altitude_agl_m)} entries, as altitude_agl_m has"
                )
        return self

    @property
    def unit_scale(self) -> float:
        """Scale of a Weibull distribution of this shape whose mean is 1."""
        return 1.0 / math.gamma(1.0 + 1.0 / self.score_shape)


class BoxModel(_Part):
    """Error of a box's centre on each axis: root of the sum of the squares."""

    pixels: float = Field(ge=0)
    of_object: float = Field(ge=0, description="Times the object's pixels")
    of_blur: float = Field(ge=0, description="Times the length of the motion blur")


class Detecting(_Part):
    """The calibrated detector."""

    name: str
    sha256: str = Field(description="Of the model file")


class CalibratedCamera(_Part):
    """The calibrated camera."""

    width_px: int
    height_px: int
    hfov_rad: float
    exposure_s: float
    noise_std: float | None = Field(None, description="Of a visible camera")
    jpeg_quality: int
    kind: str = Field("visible", description="visible or thermal")
    netd_k: float | None = Field(None, description="Of a thermal camera")

    @property
    def lens(self) -> Lens:
        """Its lens."""
        return Lens(self.width_px, self.height_px, self.hfov_rad)


class Experiment(_Part):
    """The rendered looks."""

    pictures: int
    seed: int
    looks: int
    confidence_floor: float = Field(description="Reports below it were ignored")


class Fit(_Part):
    """Held-out fit of one subset of the looks."""

    part: str
    looks: int
    measured: float = Field(description="Share reported")
    drawn: float = Field(description="Share predicted")


class HeldOut(_Part):
    """Goodness of fit, cross-validated over worlds, at one confidence threshold."""

    confidence: float
    folds: int
    brier: float = Field(description="Mean squared error of the predicted chance of a report")
    brier_of_rates: float = Field(description="The same if each kind's rate is predicted")
    deviance_explained: float = Field(description="Share of the deviance of those rates")
    calibration_error: float = Field(description="Mean difference of predicted and measured in ten bins")
    parts: list[Fit]


class RealPictures(_Part):
    """The labelled real pictures that a part of the model was fitted to, and what that part is."""

    pictures: int
    labels: dict[str, int] = Field(description="Looks at each kind")
    hectares: float = Field(description="Of ground in the pictures of which it is known")
    measured: list[str] = Field(description="What is from them")
    from_renders: list[str] = Field(description="What they cannot tell, and is the rendered fit's")


class PartOfScenario(_Part):
    """Reports in pictures of one scenario: of a kind of thing, or where nothing is."""

    part: str
    reported_as: str
    looks: int = Field(description="At things of this kind; of nothing the pictures")
    measured: int
    before: float = Field(description="Drawn by the model that was adapted")
    now: float = Field(description="Predicted from the other half of the worlds")


class OfScenario(_Part):
    """The scenario that a model was adapted to."""

    name: str
    pictures: int
    seed: int
    parts: list[PartOfScenario]


class StatisticalModel(_Part):
    """The whole model. Written by ``skysweep calibrate``, never by hand."""

    version: int
    detector: Detecting
    camera: CalibratedCamera
    experiment: Experiment
    pixels: list[float] = Field(min_length=2, description="Grid of pixels on target, ascending")
    fade_scale: float = Field(gt=0, description="Growth, a log, that leaves 1/e of an aspect's luck")
    box: BoxModel
    kinds: list[KindModel]
    contrasts: list[ContrastModel]
    background: list[BackgroundModel]
    held_out: list[HeldOut] = []
    pictures: RealPictures | None = Field(None, description="Where real pictures were fitted, too")
    scenario: OfScenario | None = Field(None, description="Where it was adapted to one scenario")

    @model_validator(mode="before")
    @classmethod
    def _known_version(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("version", VERSION) != VERSION:
            raise ValueError(f"is of version {data['version']}, this package reads {VERSION}")
        return data

    @model_validator(mode="after")
    def _tables_fit_grid(self) -> StatisticalModel:
        for kind in self.kinds:
            for table in (kind.score, kind.spread, kind.lapse, kind.lapse_among):
                if len(table) != len(self.pixels):
                    raise ValueError(f"kind '{kind.kind}': every list must have {len(self.pixels)} entries")
        return self

    @classmethod
    def load(cls, path: Path | None = None, kind: CameraKind = "visible") -> StatisticalModel:
        """Read a model file; without a path, that of the shipped detector for this kind of camera.

        Raises UserError if the file is missing or invalid.
        """
        source = path or own_sensor_path(kind)
        try:
            status = source.stat()
            return _read(source, status.st_mtime_ns, status.st_size)
        except OSError as error:
            reason = str(error.strerror)
        except UserError as error:
            reason = str(error).removeprefix(f"{source}: ")
        raise UserError(f"{source}: not a sensor model ({reason}); write one with 'skysweep calibrate'")

    @property
    def reported_classes(self) -> tuple[str, ...]:
        """The classes of which the detector reported an object as what it is."""
        return tuple(sorted({k.kind for k in self.kinds if k.kind == k.reported_as}))

    @property
    def measured(self) -> set[tuple[str, str]]:
        """The kinds and poses that were looked at, whether or not they were ever reported."""
        return {(k.kind, k.pose) for k in self.kinds} | {(c.kind, c.pose) for c in self.contrasts}

    def stand_ins(self, subjects: Iterable[tuple[str, str]]) -> str:
        """In words, what is drawn for kinds and poses that were not looked at; empty if all were."""
        told = []
        for kind, pose in sorted(set(subjects) - self.measured):
            pose_instead = next((k.pose for k in self.kinds if k.kind == kind), None)
            instead = "is never reported" if pose_instead is None else f"is drawn as {pose_instead}"
            told.append(f"a {kind} ({pose}) {instead}")
        return "; ".join(told)

    def searched(self, name: str, poses: Sequence[str]) -> list[KindModel]:
        """The kinds that a searched class may be: in its poses, or in all where none of those was measured.

        Raises UserError where the model does not know the class.
        """
        kinds = [kind for kind in self.kinds if kind.kind == kind.reported_as == name]
        if not kinds:
            raise UserError(
                f"the search needs a sensor model of '{name}'; write one with 'skysweep calibrate'"
            )
        return [kind for kind in kinds if kind.pose in poses] or kinds

    def contrast(self, kind: str, pose: str, surface: str) -> tuple[float, float]:
        """Mean and standard deviation of the difference in colour to the ground; usual if not measured."""
        table = next((c for c in self.contrasts if (c.kind, c.pose) == (kind, pose)), None)
        return table.surfaces.get(surface, (CONTRAST_USUAL, 0.0)) if table else (CONTRAST_USUAL, 0.0)

    def view_of(self, camera: CameraModel, detector: DetectorModel, smallest_m: float = 0.0) -> View:
        """How the detector sees a camera's pictures.

        ``smallest_m`` is the size of the smallest target: pictures in which it is too large are halved; with
        0 none is. Raises UserError if the detector's file cannot be read.
        """
        return View.of(camera, detector, self.camera.lens, smallest_m)

    def lens_octaves(self, view: View) -> float:
        """Of the focal length of a camera so seen over the calibrated one, as far as that was measured."""
        return float(np.clip(math.log2(view.focal_px / self.camera.lens.focal_px), *LENS_OCTAVES))

    def differences(self, camera: CameraModel, detector: DetectorModel) -> list[str]:
        """What this camera or detector has worse than the calibrated one, or other; one phrase each.

        Resolution, field of view, tiles, exposure, rate, latency and gimbal may differ, as pixels on target,
        view angle, blur and edges are in the model. Noise and JPEG may differ where the pixels that the
        detector sees, each a mean of several of the camera's, have no more of them than the calibrated ones.
        """
        if camera.kind != self.camera.kind:
            return [f"camera.kind is {camera.kind}, not {self.camera.kind}"]
        found = []
        if (other := _other_detector(self.detector, detector.model)) is not None:
            return [other]
        if detector.confidence_min < self.experiment.confidence_floor:
            floor = self.experiment.confidence_floor
            found.append(f"detector.confidence_min is {detector.confidence_min:g}, below {floor:g}")
        view = self.view_of(camera, detector)
        if view.enlarged > MAX_ENLARGED:
            found.append(
                f"detector.tiles is {detector.tiles}, which enlarges the camera's pixels {view.enlarged:.3g} "
                f"times, more than {MAX_ENLARGED:g}"
            )
        least = min(view.scale, 1.0)
        known_std = self.camera.noise_std
        if known_std is not None and (noise := camera.noise_std * least) > known_std * _ROUNDING:
            found.append(
                f"camera.noise_std is {noise:.3g} grey levels a pixel that the detector sees, not "
                f"{known_std:g}"
            )
        known_k = self.camera.netd_k
        if known_k is not None and (netd_k := camera.netd_k * least) > known_k * _ROUNDING:
            found.append(f"camera.netd_k is {netd_k:.3g} K a pixel that the detector sees, not {known_k:g}")
        coarse, known = _jpeg_step(camera.jpeg_quality) * least, _jpeg_step(self.camera.jpeg_quality)
        if coarse > known * _ROUNDING:
            found.append(
                f"camera.jpeg_quality is {camera.jpeg_quality:g}, {coarse / known:.2g} times as coarse for "
                f"the detector as {self.camera.jpeg_quality:g}"
            )
        return found

    @property
    def holds_for(self) -> str:
        """The calibrated range in words."""
        return (
            f"{self.pixels[0]:g} to {self.pixels[-1]:g} pixels on target, as the detector sees them, up "
            f"to {_VIEW_MAX_DEG:.0f} degrees off the vertical and blurred by up to the target's length"
        )

    def beyond_calibration(self, scenario: Scenario) -> str:
        """A sentence if the model was not calibrated for this search; empty if it was.

        Beyond its tables the model repeats their ends.
        """
        search, smallest_m = scenario.search, scenario.smallest_extent_m
        view = self.view_of(scenario.camera, scenario.detector, scenario.smallest_size_m)
        h_s, h_c = search.scan_altitude_agl_m, search.check_altitude_agl_m
        in_scan, in_check = (view.at(h).pixels_on_target(smallest_m, h) for h in (h_s, h_c))
        cm = [100.0 * h / self.camera.lens.focal_px for b in self.background for h in b.altitude_agl_m]
        asked = [("pixels on target", in_scan, self.pixels)]
        asked += [("pixels on target in a check", max(in_check, self.pixels[0]), self.pixels)]
        for where, height_m in (("", h_s), (" in a check", h_c)) if cm else ():
            asked.append((f"cm of ground a pixel{where}", 100.0 * height_m / view.at(height_m).focal_px, cm))
        off_deg = 90.0 + math.degrees(scenario.camera.gimbal.pitch_rad)
        asked += [("degrees off the vertical", off_deg, [0.0, _VIEW_MAX_DEG])]
        beyond = " and ".join(
            f"for {min(known):.3g} to {max(known):.3g} {unit}, not {value:.3g}"
            for unit, value, known in asked
            if not min(known) <= value <= max(known) * _ROUNDING
        )
        return beyond and (
            f"The sensor model was calibrated {beyond}: what it says there is a guess, and it reports "
            f"nothing of fewer than {TOO_SMALL * self.pixels[0]:.3g} pixels; write another altitude of "
            "search, or another camera."
        )


def own_sensor_path(kind: CameraKind) -> Path:
    """The file of the shipped sensor model for a kind of camera."""
    return Path(str(resources.files("skysweep.sensing.statistical") / f"{kind}.yaml"))


def model_for(scenario: Scenario, instead: str = "fly with --sensor imaging") -> StatisticalModel:
    """The model that a scenario names, or the shipped one.

    Raises UserError if it was made for another detector or camera, or knows no reports of a searched class;
    ``instead`` is how to do without it.
    """
    path = scenario.detector.statistical_model
    model = StatisticalModel.load(Path(path) if path else None, scenario.camera.kind)
    differences = model.differences(scenario.camera, scenario.detector)
    if blurred := _blurred(scenario):
        differences.append(blurred)
    if differences:
        raise UserError(
            f"{path or 'the shipped sensor model'}: was made for another detector or camera "
            f"({'; '.join(differences)}); make one with 'skysweep calibrate' and write its path as "
            f"detector.statistical_model, or {instead}"
        )
    known = model.reported_classes
    if unknown := [name for name in scenario.target_classes if name not in known]:
        raise UserError(
            f"targets: {model.detector.name} reports {' and '.join(known) or 'nothing'}, not "
            f"{' or '.join(unknown)}, by {path or 'the shipped sensor model'}; write targets that it "
            "reports, or another detector.model or camera.kind"
        )
    return model


def _blurred(scenario: Scenario) -> str:
    """In words, that the smallest target is blurred more than any that was measured; empty if it is not."""
    exposure_s, speed_mps = scenario.camera.exposure_s, scenario.search.scan_speed_mps
    smallest_m = scenario.smallest_extent_m
    if exposure_s * speed_mps <= BLUR_MAX * smallest_m:
        return ""
    return (
        f"camera.exposure_s is {exposure_s:g}, in which the camera moves {exposure_s * speed_mps:.2g} m at "
        f"search.scan_speed_mps, farther than the {smallest_m:g} m of the smallest target"
    )


def _jpeg_step(quality: int) -> float:
    """Relative size of the steps to which JPEG rounds (Independent JPEG Group's libjpeg)."""
    return 5000.0 / quality if quality < 50 else max(200.0 - 2.0 * quality, 1.0)


@lru_cache(maxsize=8)
def _read(source: Path, _changed_ns: int, _size: int) -> StatisticalModel:
    text = read_text_limited(source, MAX_YAML_BYTES)
    fields = parse_fields(text, str(source), "sensor model", "detector, camera, kinds")
    return validated(StatisticalModel, fields, str(source))


def _other_detector(made_for: Detecting, model: str) -> str | None:
    if sha256_of(existing_model_file(model)) == made_for.sha256:
        return None
    if model == made_for.name:
        return f"detector.model '{model}' has changed since"
    return f"detector.model is '{model}', not {made_for.name}"
