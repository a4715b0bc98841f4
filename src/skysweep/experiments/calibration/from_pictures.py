"""Fits the statistical sensor to labelled real pictures; what those cannot tell is the rendered fit's.

Pictures tell how often, and with what confidence, a class is reported over its pixels, and, where their
ground is known, how often nothing is reported as one. They do not tell an object's pose, side, shade or
ground, nor what two looks at one object have in common: every pose of a kind gets the measured curve, and the
rendered factors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.special import ndtr

from skysweep.arrays import F64
from skysweep.detection.model_files import existing_model_file, sha256_of
from skysweep.detection.photos.pixels import read_picture
from skysweep.detection.training.class_map import ours, refuse_unused
from skysweep.detection.training.labelled import LabelledDataset, LabelledImage
from skysweep.detection.training.matching import intersection_shares
from skysweep.detection.training.reading import with_our_classes
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.experiments.calibration.check import goodness, tell
from skysweep.experiments.calibration.figure import draw_fit
from skysweep.experiments.calibration.fit import (
    FLOOR_SCORE,
    GRID_PX,
    MIN_OBJECTS,
    MIN_REPORTS,
    ScoreCurve,
    factors_of,
    fit_background,
    fit_curves,
)
from skysweep.experiments.calibration.looks import (
    CLASSES,
    CONFIDENCE_FLOOR,
    HIT_RADIUS,
    HIT_RADIUS_MIN_PX,
    PIXELS,
    SUBJECTS,
    Background,
    ScoredLooks,
)
from skysweep.files.writing import whole_files
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import CameraModel, DetectorModel
from skysweep.sensing.statistical.model import BackgroundModel, KindModel, RealPictures, StatisticalModel
from skysweep.types import Frame

_EDGE_PX = 1.0  # a label this near to the picture's edge is cut, and left out
_MANY_LABELS = 10  # of a class: with too few reports for a curve they still tell how many there are
_LAPSE_MAX = 0.9999
_FEW = 0.5  # reports, added to a count too small to fit and to what renders let expect
ALWAYS_FROM_RENDERS = (
    "poses of a kind: every one has the measured curve",
    "view, front, hidden, cut, edges, blur, contrast and grounds",
    "the shares of object and pass, and again and same_share of the background",
    "look-alikes and other kinds, and reports as another class",
    "errors of boxes",
)
_NOWHERE = CameraPose(np.zeros(3), np.eye(3))
_SUBJECT = {kind: k for k, (kind, _) in reversed(list(enumerate(SUBJECTS)))}  # the first pose stands for all


def calibrate_on_pictures(
    detector: DetectorModel,
    data: LabelledDataset,
    rendered: StatisticalModel,
    out_yaml: Path,
    renames: Mapping[str, str] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StatisticalModel:
    """Measure a detector on labelled pictures; write the sensor model and its picture.

    The picture of the fit is beside ``out_yaml``, as ``.png``. Of ``detector`` count model, tiles, boxes and
    pixels. Names of classes become ours, as ``class_map.ours`` has them with ``renames``. ``rendered`` is the
    model that 'skysweep calibrate' fitted to renders for the same detector.
    Raises UserError when it is another's, the pictures tell too little, or the results cannot be written.
    """
    if sha256_of(existing_model_file(detector.model)) != rendered.detector.sha256:
        raise UserError(
            f"--rendered: the sensor model is of {rendered.detector.name}, not of {detector.model}; make one "
            f"with  skysweep calibrate --model {detector.model}  and give it as --rendered"
        )
    looks, background = look_at(detector, data, rendered, renames, progress)
    factors = factors_of(looks)
    known = [k for k in CLASSES if any(k == kind.kind == kind.reported_as for kind in rendered.kinds)]
    curves = {
        CLASSES[c]: curve
        for (subject, c), curve in fit_curves(looks, factors).items()
        if SUBJECTS[subject][0] == CLASSES[c] and CLASSES[c] in known
    }
    seldom = {k: n for k in known if k not in curves and (n := len(_confidences(looks, k))) >= _MANY_LABELS}
    if not curves and not seldom:
        raise UserError(
            f"{data.path}: of no class were {_MANY_LABELS} labels, or {MIN_REPORTS} reports of {MIN_OBJECTS} "
            "objects; give more pictures"
        )
    keys = [(_SUBJECT[kind], CLASSES.index(kind)) for kind in curves]
    measured = [f"score, spread and lapse of {kind}" for kind in curves]
    measured += [f"lapse of {kind}" for kind in seldom]
    labelled = {ours(name, renames or {}) for name in data.class_names}
    rates = [
        _background(background, c, rendered, is_labelled=CLASSES[c] in labelled) for c in range(len(CLASSES))
    ]
    measured += [f"background of {b.reported_as}" for b, is_own in rates if b is not None and is_own]
    counts = {kind: int((looks.subject == _SUBJECT[kind]).sum()) for kind in CLASSES}
    reported = {kind: int((_confidences(looks, kind) > 0.0).sum()) for kind in CLASSES}
    rendered_still = [
        f"score{'' if kind in seldom else ', spread and lapse'} of {kind} "
        f"({reported[kind]} of {counts[kind]} labels reported)"
        for kind in CLASSES
        if kind not in curves
    ]
    rendered_still += [
        f"background of {b.reported_as}" for b, is_own in rates if b is not None and not is_own
    ]
    told = tell(looks, factors, keys)
    fitted = rendered.model_copy(
        update={
            "kinds": [
                _seldom_reported(kind, rendered, looks)
                if kind.kind == kind.reported_as in seldom
                else _measured(kind, rendered, curves)
                for kind in rendered.kinds
            ],
            "background": [b for b, _ in rates if b is not None],
            "held_out": goodness(told),
            "pictures": RealPictures(
                pictures=len(data.images),
                labels={kind: n for kind, n in counts.items() if n},
                hectares=round(float(background.hectares.sum()), 2),
                measured=measured,
                from_renders=[*ALWAYS_FROM_RENDERS, *rendered_still],
            ),
        }
    )
    text = yaml.safe_dump(
        fitted.model_dump(exclude_none=True), sort_keys=False, default_flow_style=None, width=110
    )
    with whole_files(out_yaml.parent) as unfinished:
        header = "# Written by skysweep calibrate, from real pictures.\n"
        (unfinished / out_yaml.name).write_text(header + text, encoding="utf-8")
        draw_fit(looks, background, told, fitted, unfinished / out_yaml.with_suffix(".png").name)
    return fitted


def _confidences(looks: ScoredLooks, kind: str) -> F64:
    """With what each label of a kind is reported as what it is; 0: not at all."""
    return np.asarray(looks.confidences[looks.subject == _SUBJECT[kind], CLASSES.index(kind)])


def _measured(kind: KindModel, rendered: StatisticalModel, curves: dict[str, ScoreCurve]) -> KindModel:
    """A kind with the measured curve, where it is reported as what it is."""
    curve = curves.get(kind.kind)
    if curve is None or kind.reported_as != kind.kind:
        return kind
    at = np.log(rendered.pixels), np.log(GRID_PX)
    lapse = curve.lapse, 4
    tables = {"score": (curve.mean, 3), "spread": (curve.spread, 3), "lapse": lapse, "lapse_among": lapse}
    return kind.model_copy(
        update={name: np.interp(*at, table).round(n).tolist() for name, (table, n) in tables.items()}
    )


def _seldom_reported(kind: KindModel, rendered: StatisticalModel, looks: ScoredLooks) -> KindModel:
    """A kind with the rendered scores, and so many lapses that as many labels are reported as were."""
    mine = looks.where(looks.subject == _SUBJECT[kind.kind])
    score, spread, lapse = (
        np.interp(np.log(mine.pixels), np.log(rendered.pixels), table)
        for table in (kind.score, kind.spread, kind.lapse)
    )
    expected = float(((1.0 - lapse) * ndtr((score - FLOOR_SCORE) / spread)).sum())
    n = int((_confidences(looks, kind.kind) > 0.0).sum())
    times = min(1.0, (n + _FEW) / (expected + _FEW))
    return kind.model_copy(
        update={
            name: [min(round(1.0 - times * (1.0 - lapse), 4), _LAPSE_MAX) for lapse in getattr(kind, name)]
            for name in ("lapse", "lapse_among")
        }
    )


def _background(
    seen: Background, class_index: int, rendered: StatisticalModel, *, is_labelled: bool
) -> tuple[BackgroundModel | None, bool]:
    """False reports of a class, and whether the pictures tell their rate.

    They do not where the class is not labelled: its reports may be right. Too few to fit scale the rendered
    rate to what was counted. The ground of the pictures is not known, so a fitted rate is the same on every
    ground.
    """
    name = CLASSES[class_index]
    known = next((b for b in rendered.background if b.reported_as == name), None)
    if not len(seen.hectares) or not is_labelled:
        return known, False
    fitted = fit_background(seen, class_index)
    if fitted is None:
        if known is None:
            return None, False
        n = int((seen.class_index == class_index).sum())
        per_hectare = np.interp(np.log(seen.altitude_agl_m), np.log(known.altitude_agl_m), known.per_hectare)
        times = (n + _FEW) / (float((per_hectare * seen.hectares).sum()) + _FEW)
        scaled = [float(f"{times * rate:.3g}") for rate in known.per_hectare]
        return known.model_copy(update={"per_hectare": scaled}), True
    here = next(iter(fitted.surfaces.values()))  # all pictures count as of the first ground
    update: dict[str, object] = {
        "per_hectare": [float(f"{rate * here:.3g}") for rate in fitted.per_hectare],
        "surfaces": dict.fromkeys(fitted.surfaces, 1.0),
    }
    if known is not None:
        kept = ("per_tree", "per_cut_tree", "again", "same_share")
        update |= {name: getattr(known, name) for name in kept}
    return fitted.model_copy(update=update), True


def look_at(
    detector: DetectorModel,
    data: LabelledDataset,
    rendered: StatisticalModel,
    renames: Mapping[str, str] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[ScoredLooks, Background]:
    """Every whole label of one of our classes as a look, and the reports away from all labels.

    Pixels are those of the calibrated pictures. Raises UserError if the pictures, their labels or the model
    cannot be used.
    """
    renames = renames or {}
    looking = YoloDetector(
        detector.model,
        None,
        confidence_min=CONFIDENCE_FLOOR,
        tiles=detector.tiles,
        threads=2,
        boxes=detector.boxes,
        pixels=detector.pixels,
        channels=detector.channels,
    )
    refuse_unused(renames, [*data.class_names, *looking.class_names])
    data = with_our_classes(data, renames)
    _refuse_unlabelled(data)
    looks: list[tuple[int, float, F64, F64, F64]] = []  # picture, pixels, place, confidences, offsets
    subjects: list[int] = []
    grounds: list[tuple[int, float, float]] = []  # picture, altitude, hectares
    strays: list[tuple[int, int, float, float]] = []  # row of those, class, confidence, pixels
    for number, image in enumerate(data.images):
        picture = read_picture(image.path)
        height, width = picture.shape[:2]
        size = np.array([width, height] * 2, dtype=float)
        camera = CameraModel(width_px=width, height_px=height, hfov_rad=1.0)
        scale = rendered.view_of(camera, detector).scale
        found = looking.detect(Frame(0.0, picture, _NOWHERE, Lens(width, height, 1.0)))
        names = [ours(name, renames) for name in found.class_names]
        classes = np.array([CLASSES.index(n) if n in CLASSES else -1 for n in names], dtype=int)
        labels, boxes = image.boxes_xyxy * size, found.boxes_xyxy_px
        middles, places = (boxes[:, :2] + boxes[:, 2:]) / 2, (labels[:, :2] + labels[:, 2:]) / 2
        extents = (labels[:, 2:] - labels[:, :2]).max(axis=1, initial=0.0)
        reach = np.maximum(HIT_RADIUS * extents, HIT_RADIUS_MIN_PX / scale)
        gaps = np.linalg.norm(middles[:, None] - places[None], axis=2)
        confidences = np.zeros((len(labels), len(CLASSES)))
        offsets = np.full((len(labels), len(CLASSES), 2), np.nan)
        for k in np.argsort(-found.confidences, kind="stable").tolist():
            free = np.where((gaps[k] <= reach) & (confidences[:, classes[k]] == 0.0), gaps[k], np.inf)
            if classes[k] >= 0 and len(free) and np.isfinite(free.min()):
                nearest = int(free.argmin())
                confidences[nearest, classes[k]] = found.confidences[k]
                offsets[nearest, classes[k]] = scale * (middles[k] - places[nearest])
        whole = ((labels[:, :2] > _EDGE_PX) & (labels[:, 2:] < size[2:] - _EDGE_PX)).all(axis=1)
        for k, name in enumerate(image.class_names):
            if whole[k] and name in CLASSES and PIXELS[0] <= scale * extents[k] <= PIXELS[1]:
                subjects.append(_SUBJECT[name])
                looks.append((number, scale * extents[k], scale * places[k], confidences[k], offsets[k]))
        if image.ground_m2:
            metres = np.sqrt(image.ground_m2 / (width * height)) / scale  # of ground for a calibrated pixel
            grounds.append((number, metres * rendered.camera.lens.focal_px, image.ground_m2 / 1e4))
            away = (
                (gaps > 2.0 * reach[None]).all(axis=1) & (classes >= 0) & ~_excused(image, boxes, names, size)
            )
            for k in np.flatnonzero(away).tolist():
                extent = scale * float((boxes[k, 2:] - boxes[k, :2]).max())
                strays.append((len(grounds) - 1, int(classes[k]), float(found.confidences[k]), extent))
        progress(number + 1, len(data.images))
    return _looks(subjects, looks), _strays(grounds, strays)


def _refuse_unlabelled(data: LabelledDataset) -> None:
    """Raises UserError if no picture has a label of one of our classes, and names those that there are."""
    if not data.images:
        raise UserError(f"{data.path}: the data set has no pictures; write the path of one that has")
    found = dict.fromkeys(name for image in data.images for name in image.class_names)
    if not found:
        raise UserError(f"{data.path}: no picture has a label that counts; label what is in the pictures")
    if not found.keys() & set(CLASSES):
        raise UserError(
            f"{data.path}: its labels ({', '.join(found)}) are of none of {', '.join(CLASSES)}; give our "
            f"names with --class, such as --class '{next(iter(found))}={CLASSES[0]}'"
        )


def _excused(image: LabelledImage, boxes: F64, names: list[str], size: F64) -> NDArray[np.bool_]:
    """Which of the boxes (N, 4) lie in a crowd that counts for their class."""
    shares = (
        intersection_shares(box[None], image.crowds_of(name) * size)
        for box, name in zip(boxes, names, strict=True)
    )
    return np.array([bool((share > 0.5).any()) for share in shares], dtype=bool)


def _looks(subjects: list[int], looks: list[tuple[int, float, F64, F64, F64]]) -> ScoredLooks:
    """Looks of which nothing but their pixels is known: from above, whole and sharp, on the first ground."""
    n = len(looks)
    told = {
        "subject": np.array(subjects, dtype=int),
        "instance": np.arange(n),
        "world": np.array([look[0] for look in looks], dtype=int),
        "surface": np.zeros(n, dtype=int),
        "picture": 2 * np.arange(n),
        "pixels": np.array([look[1] for look in looks]),
        "sight": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "colour": np.full(n, np.nan),
        "confidences": np.array([look[3] for look in looks]).reshape(n, len(CLASSES)),
        "offsets_px": np.array([look[4] for look in looks]).reshape(n, len(CLASSES), 2),
    }
    return ScoredLooks(*(told.get(f.name, np.zeros(n)) for f in fields(ScoredLooks)))


def _strays(
    grounds: list[tuple[int, float, float]], strays: list[tuple[int, int, float, float]]
) -> Background:
    picture, altitude_agl_m, hectares = np.array(grounds, dtype=float).reshape(-1, 3).T
    row, class_index, confidences, pixels = np.array(strays, dtype=float).reshape(-1, 4).T
    n = len(picture)
    return Background(
        altitude_agl_m,
        hectares,
        picture.astype(int),
        np.zeros(n, dtype=int),
        np.zeros(n),
        np.zeros(n),
        row.astype(int),
        class_index.astype(int),
        confidences,
        pixels,
        np.full(len(row), np.nan),
        np.zeros(len(row), dtype=bool),
        np.zeros(len(row), dtype=bool),
    )
