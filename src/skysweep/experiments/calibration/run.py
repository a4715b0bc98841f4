"""Fits the statistical sensor to renders and a real detector, and shows how well it fits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import yaml

from skysweep.detection.model_files import model_file, sha256_of
from skysweep.errors import UserError
from skysweep.experiments.calibration.check import goodness, tell
from skysweep.experiments.calibration.figure import draw_fit
from skysweep.experiments.calibration.fit import (
    GRID_PX,
    contrast_models,
    factors_of,
    fit_background,
    fit_box,
    fit_curves,
)
from skysweep.experiments.calibration.looks import CLASSES, CONFIDENCE_FLOOR, SUBJECTS, observe
from skysweep.experiments.calibration.shares import fit_shares, kind_model
from skysweep.files.writing import whole_files
from skysweep.scenarios.model import OWN_DETECTORS, CameraModel, DetectorModel
from skysweep.sensing.statistical.model import (
    VERSION,
    CalibratedCamera,
    Detecting,
    Experiment,
    StatisticalModel,
)


def calibrate(
    model: str,
    camera: CameraModel,
    out_yaml: Path,
    pictures: int = 4000,
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    add_to: StatisticalModel | None = None,
) -> StatisticalModel:
    """Measure a detector on rendered objects; write the sensor model and, as ``.png``, a picture of the fit.

    With ``add_to`` only the kinds and poses are measured that this model lacks, and it is written with them.
    The same arguments give the same file, whatever the number of workers. ``model`` is an ONNX file, or
    "skysweep" for the shipped one; ``camera`` gives lens and effects. ``progress`` is called with pictures
    done and total. Raises UserError when the detector cannot be used or the results cannot be written.
    """
    known = add_to.measured if add_to else set()
    if add_to:
        _refuse_to_add(add_to, model, camera, known)
    looks, background = observe(model, camera, pictures, seed, workers, progress, known)
    factors = factors_of(looks)
    curves = fit_curves(looks, factors)
    shares, fade_scale = fit_shares(looks, factors, curves)
    told = tell(looks, factors, list(curves))
    kinds = [kind_model(key, curve, shares[key]) for key, curve in curves.items()]
    name, n = model if model in OWN_DETECTORS.values() else Path(model).name, len(looks.pixels)
    fitted = StatisticalModel(
        version=VERSION,
        detector=Detecting(name=name, sha256=sha256_of(model_file(model))),
        camera=CalibratedCamera(**camera.model_dump(include=set(CalibratedCamera.model_fields))),
        experiment=Experiment(pictures=pictures, seed=seed, looks=n, confidence_floor=CONFIDENCE_FLOOR),
        pixels=list(GRID_PX),
        fade_scale=fade_scale,
        box=fit_box(looks),
        kinds=kinds,
        contrasts=contrast_models(looks),
        background=[b for c in range(len(CLASSES)) if (b := fit_background(background, c)) is not None],
        held_out=goodness(told),
    )
    if add_to:
        added = {"kinds": [*add_to.kinds, *kinds], "contrasts": [*add_to.contrasts, *fitted.contrasts]}
        fitted = add_to.model_copy(update=added)
    text = yaml.safe_dump(
        fitted.model_dump(exclude_none=True), sort_keys=False, default_flow_style=None, width=110
    )
    with whole_files(out_yaml.parent) as unfinished:
        header = "# Written by skysweep calibrate.\n"
        (unfinished / out_yaml.name).write_text(header + text, encoding="utf-8")
        draw_fit(looks, background, told, fitted, unfinished / out_yaml.with_suffix(".png").name)
    return fitted


def _refuse_to_add(
    add_to: StatisticalModel, model: str, camera: CameraModel, known: set[tuple[str, str]]
) -> None:
    if known.issuperset(SUBJECTS):
        raise UserError("--add-to: the sensor model has every kind and pose; there is nothing to add")
    differences = add_to.differences(camera, DetectorModel(model=model))
    if differences:
        raise UserError(f"--add-to: was made for another detector or camera ({'; '.join(differences)})")
