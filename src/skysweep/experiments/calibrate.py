"""Fits the statistical sensor to renders and a real detector, and shows how well it fits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import yaml

from skysweep.experiments.sensor_figure import draw_fit
from skysweep.experiments.sensor_fit import fit_sensor
from skysweep.experiments.sensor_looks import observe
from skysweep.scenarios.model import CameraModel
from skysweep.sensing.detector import OWN_MODEL
from skysweep.sensing.statistical import StatisticalModel


def calibrate(
    model_path: str,
    camera: CameraModel,
    out_yaml: Path,
    pictures: int = 3000,
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StatisticalModel:
    """Measure a detector on rendered objects, write the sensor model and beside it a picture of the fit.

    The same arguments give the same file, whatever the number of workers.

    Args:
        model_path: an ONNX file, or "skysweep" for the model that the package ships.
        camera: lens and effects to measure with.
        out_yaml: where to write the model; the picture has the same name and the suffix ``.png``.
        pictures: how many to render; a few thousand make the tables smooth.
        seed: of worlds and views.
        workers: processes; default: one a core.
        progress: called with pictures done and total.

    Raises:
        UserError: the detector's file cannot be used.
    """
    looks, empties = observe(model_path, camera, pictures, seed, workers, progress)
    name = OWN_MODEL if model_path == OWN_MODEL else Path(model_path).name
    model = fit_sensor(looks, empties, name, pictures, seed)
    out_yaml.parent.mkdir(parents=True, exist_ok=True)
    out_yaml.write_text(
        "# Written by skysweep calibrate.\n"
        + yaml.safe_dump(model.model_dump(), sort_keys=False, default_flow_style=None, width=110)
    )
    draw_fit(looks, model, out_yaml.with_suffix(".png"))
    return model
