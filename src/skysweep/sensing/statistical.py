"""A sensor without pictures: it draws detections from a model fitted to renders and the real detector.

The objects are projected through the true camera, detections are drawn from tables over pixels on target,
and the result carries the pose that the mission believes. Georeferencing therefore suffers in turns for the
same physical reasons as with pictures; only seeing is statistical.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.scenarios.world import World, WorldObject
from skysweep.sensing.occlusion import Occluders, pixels_on_target
from skysweep.sensing.schedule import Exposures
from skysweep.types import Detections, VehicleState

F64 = NDArray[np.float64]
_Box = tuple[F64, float, str]  # corners (4,) px, confidence, class

_EPS_S = 1e-6
_MIN_VISIBLE = 0.25


class KindModel(BaseModel):
    """How one kind of object is reported as one class, over the model's grid of pixels on target."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: str = Field(description="What is out there")
    pose: str = Field(description="How it lies or stands there")
    reported_as: str = Field(description="What the detector calls it")
    probability: list[float] = Field(description="Of a detection in one look")
    confidence_logit_mean: list[float]
    confidence_logit_std: list[float]
    object_logit_std: float = Field(
        ge=0, description="Some objects are seen better than others, in every look"
    )


class BackgroundModel(BaseModel):
    """Detections where nothing is."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    reported_as: str
    altitude_agl_m: list[float] = Field(min_length=1)
    rate_per_picture: list[float]
    confidence_logit_mean: float
    confidence_logit_std: float
    pixels: float


class StatisticalModel(BaseModel):
    """Everything the sensor draws from. Written by ``skysweep calibrate``, never by hand."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: int = 1
    detector: str
    pictures: int
    seed: int
    pixels: list[float] = Field(min_length=2, description="Grid of pixels on target, ascending")
    kinds: list[KindModel]
    background: list[BackgroundModel]
    centre_std_fraction: float = Field(ge=0, description="Of the object's pixels")
    centre_std_px: float = Field(ge=0)

    @model_validator(mode="after")
    def _tables_fit_grid(self) -> StatisticalModel:
        for kind in self.kinds:
            for table in (kind.probability, kind.confidence_logit_mean, kind.confidence_logit_std):
                if len(table) != len(self.pixels):
                    raise ValueError(f"kind '{kind.kind}': every list must have {len(self.pixels)} entries")
        return self

    @classmethod
    def load(cls, path: Path | None = None) -> StatisticalModel:
        """Read a model file; without a path the one that is shipped for the shipped detector."""
        source = path or resources.files("skysweep.sensing") / "statistical_default.yaml"
        try:
            return cls.model_validate(yaml.safe_load(source.read_text()))
        except ValidationError as error:
            first = error.errors()[0]
            reason = ": ".join([*(str(part) for part in first["loc"]), first["msg"]])
        except (OSError, yaml.YAMLError) as error:
            reason = str(error).splitlines()[0]
        raise UserError(f"{source}: not a sensor model ({reason}); write one with 'skysweep calibrate'")


class StatisticalSensor:
    """Draws detections instead of rendering pictures. Implements ``types.Sensor``.

    ``truth`` gives the true camera pose of this moment; ``classes`` are those that the mission searches for.
    """

    def __init__(
        self,
        world: World,
        lens: Lens,
        truth: Callable[[], CameraPose],
        exposures: Exposures,
        latency_s: float,
        classes: Sequence[str],
        confidence_min: float,
        seed: int,
        model: StatisticalModel | None = None,
    ) -> None:
        self._model = model or StatisticalModel.load()
        self._world, self._lens, self._truth = world, lens, truth
        self._occluders = Occluders(world)
        self._exposures, self._latency_s = exposures, latency_s
        self._size_px = np.array([lens.width_px, lens.height_px], dtype=float)
        self._confidence_min = confidence_min
        self._rng = np.random.default_rng([seed, 23])
        self._pending: deque[Detections] = deque()
        self._background = [b for b in self._model.background if b.reported_as in classes]
        self._log_pixels = np.log(self._model.pixels)
        self._tabulate(classes)

    def _tabulate(self, classes: Sequence[str]) -> None:
        """One row for every object and every class that it can be reported as."""
        wanted = [kind for kind in self._model.kinds if kind.reported_as in classes]
        rows = [(i, kind) for i, thing in enumerate(self._world.objects) for kind in _kinds_of(thing, wanted)]
        offsets = self._rng.normal(size=len(self._world.objects))
        self._objects = np.array([i for i, _ in rows], dtype=int)
        self._positions = np.array([self._world.objects[i].position_enu_m for i, _ in rows]).reshape(-1, 3)
        self._names = [kind.reported_as for _, kind in rows]
        self._tables = np.array(
            [[k.probability, k.confidence_logit_mean, k.confidence_logit_std] for _, k in rows]
        ).reshape(len(rows), 3, len(self._model.pixels))
        self._offsets = np.array([offsets[i] * kind.object_logit_std for i, kind in rows])

    def sense(self, state: VehicleState) -> Detections | None:
        """Draw a look if one is due; return the oldest result whose time has come."""
        exposed = self._exposures.due(state)
        if exposed is not None:
            self._pending.append(self._look(exposed))
        if self._pending and state.time_s >= self._pending[0].time_s + self._latency_s - _EPS_S:
            return self._pending.popleft()
        return None

    def close(self) -> None:
        """Nothing is held open."""

    def _look(self, state: VehicleState) -> Detections:
        """One picture's worth of draws. The number of draws does not depend on what is in view."""
        true_pose = self._truth()
        n = len(self._objects)
        chance = self._rng.random(n)
        noise = self._rng.normal(size=(n, 3))
        background = self._rng.random(len(self._background)), self._rng.normal(size=len(self._background))
        corner = self._rng.random((len(self._background), 2))

        centres, depths = project(self._lens, true_pose, self._positions)
        in_view = (depths > 0.1) & (centres >= 0).all(axis=1) & (centres <= self._size_px).all(axis=1)
        seen = np.flatnonzero(in_view)
        found = self._background_boxes(true_pose, background, corner)
        if len(seen):
            found = self._object_boxes(true_pose, seen, centres, depths, chance, noise) + found
        return Detections(
            state.time_s,
            np.array([box for box, _, _ in found]).reshape(-1, 4),
            np.array([confidence for _, confidence, _ in found]),
            tuple(name for _, _, name in found),
            state.camera,
            self._lens,
        )

    def _object_boxes(
        self,
        true_pose: CameraPose,
        seen: NDArray[np.int64],
        centres: F64,
        depths: F64,
        chance: F64,
        noise: F64,
    ) -> list[_Box]:
        pixels = np.array([self._pixels(true_pose, row, centres[row], depths[row]) for row in seen])
        probability, mean, std = self._interpolate(seen, pixels)
        offsets = self._offsets[seen]
        confidences = _sigmoid(mean + std * noise[seen, 2] + offsets)
        found = (chance[seen] < _shift(probability, offsets)) & (confidences >= self._confidence_min)
        spread = np.hypot(self._model.centre_std_px, self._model.centre_std_fraction * pixels)
        middles = centres[seen] + noise[seen, :2] * spread[:, None]
        return [
            (self._box(middles[k], pixels[k]), float(confidences[k]), self._names[seen[k]])
            for k in np.flatnonzero(found)
        ]

    def _pixels(self, true_pose: CameraPose, row: int, centre_px: F64, depth_m: float) -> float:
        """Pixels on target, fewer for what is partly hidden or cut off by the picture's edge."""
        thing = self._world.objects[self._objects[row]]
        camera = true_pose.position_enu_m
        whole = pixels_on_target(self._lens, thing, camera, depth_m)
        share = self._occluders.visible_fraction(camera, thing) * self._share_inside(centre_px, whole)
        return whole * float(np.sqrt(share)) if share >= _MIN_VISIBLE else 0.0

    def _share_inside(self, centre_px: F64, extent_px: float) -> float:
        """Share of a square around ``centre_px`` that lies in the picture."""
        half = extent_px / 2
        inside = np.minimum(centre_px + half, self._size_px) - np.maximum(centre_px - half, 0.0)
        return float(inside[0] * inside[1]) / extent_px**2

    def _box(self, middle_px: F64, extent_px: float) -> F64:
        """A square box (4,), cut off at the picture's edge."""
        half = max(extent_px, 1.0) / 2
        low, high = np.maximum(middle_px - half, 0.0), np.minimum(middle_px + half, self._size_px)
        return np.concatenate([np.minimum(low, self._size_px), np.maximum(high, 0.0)])

    def _interpolate(self, rows: NDArray[np.int64], pixels: F64) -> tuple[F64, F64, F64]:
        """Probability, mean and standard deviation of the confidence logit at these pixels on target."""
        x = np.log(np.maximum(pixels, 1e-3))
        grid = self._log_pixels
        left = np.clip(np.searchsorted(grid, x) - 1, 0, len(grid) - 2)
        share = np.clip((x - grid[left]) / (grid[left + 1] - grid[left]), 0.0, 1.0)[:, None]
        tables = self._tables[rows]
        index = np.arange(len(rows))
        values = tables[index, :, left] * (1 - share) + tables[index, :, left + 1] * share
        too_small = pixels < self._model.pixels[0] * 0.8
        return np.where(too_small, 0.0, values[:, 0]), values[:, 1], values[:, 2]

    def _background_boxes(self, true_pose: CameraPose, draws: tuple[F64, F64], corner: F64) -> list[_Box]:
        if not self._background:
            return []
        ground = self._world.terrain.height_m(true_pose.position_enu_m[None, :2])[0]
        altitude = float(true_pose.position_enu_m[2] - ground)
        found = []
        for k, model in enumerate(self._background):
            rate = float(np.interp(altitude, model.altitude_agl_m, model.rate_per_picture))
            logit = model.confidence_logit_mean + model.confidence_logit_std * draws[1][k]
            confidence = float(_sigmoid(logit))
            if draws[0][k] < rate and confidence >= self._confidence_min:
                found.append(
                    (self._box(corner[k] * self._size_px, model.pixels), confidence, model.reported_as)
                )
        return found


def _kinds_of(thing: WorldObject, kinds: list[KindModel]) -> list[KindModel]:
    """The models of this kind in this pose, or in any where the pose was not measured."""
    of_kind = [k for k in kinds if k.kind == thing.kind]
    same_pose = [k for k in of_kind if k.pose == thing.pose]
    return same_pose or [k for k in of_kind if k.pose == of_kind[0].pose]


def _sigmoid(x: F64 | float) -> F64:
    return np.asarray(1.0 / (1.0 + np.exp(-np.asarray(x, dtype=float))))


def _shift(probability: F64, offset_logit: F64) -> F64:
    """Probabilities moved by an offset in logits; 0 and 1 stay what they are."""
    odds = probability / np.maximum(1.0 - probability, 1e-9) * np.exp(offset_logit)
    return np.asarray(odds / (1.0 + odds))
