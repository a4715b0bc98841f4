"""The fit finds the tables that looks were drawn from."""

import numpy as np
import pytest
from scipy.special import expit, logit
from scipy.stats import norm

from skysweep.experiments.sensor_figure import draw_fit, drawn_rates
from skysweep.experiments.sensor_fit import (
    GRID_PX,
    MISSION_CONFIDENCE_MIN,
    fit_curve,
    fit_sensor,
    node_weights,
)
from skysweep.experiments.sensor_looks import CLASSES, CONFIDENCE_FLOOR, SUBJECTS, Empties, Looks

SIGN = SUBJECTS.index(("stop sign", "face-up"))
GRID = np.log(GRID_PX)
PROBABILITY = np.interp(GRID, np.log([5, 9, 18, 40]), [0.05, 0.5, 0.95, 0.999])
MEAN = np.interp(GRID, np.log([5, 12, 40]), [-0.8, 0.6, 2.5])


def no_empties():
    nothing = np.zeros(0)
    return Empties(np.array([10.0]), nothing.astype(int), nothing.astype(int), nothing, nothing)


def draw_looks(offset_std, n_objects=700, looks_each=12, std=0.6, seed=0):
    """Looks at signs as the sensor draws them, and the shares that it reports over all objects."""
    rng = np.random.default_rng(seed)
    n = n_objects * looks_each
    instance = np.arange(n) % n_objects
    offset = rng.normal(0, offset_std, n_objects)[instance]
    x = rng.uniform(GRID[0], GRID[-1], n)
    p = expit(logit(np.interp(x, GRID, PROBABILITY)) + offset)
    logits = np.interp(x, GRID, MEAN) + std * rng.normal(size=n) + offset
    reported = (rng.random(n) < p) & (expit(logits) >= CONFIDENCE_FLOOR)
    confidences = np.zeros((n, len(CLASSES)))
    confidences[reported, CLASSES.index("stop sign")] = expit(logits[reported])
    offsets = np.full((n, len(CLASSES), 2), np.nan)
    spread = np.hypot(0.5, 0.04 * np.exp(x))[:, None]
    offsets[reported, CLASSES.index("stop sign")] = (spread * rng.normal(size=(n, 2)))[reported]
    return Looks(np.full(n, SIGN), instance, np.exp(x), confidences, offsets)


@pytest.mark.parametrize("offset_std", [0.0, 0.5, 1.0])
def test_tables_and_offsets_are_recovered(offset_std):
    looks = draw_looks(offset_std)
    (kind,) = fit_sensor(looks, no_empties(), "synthetic", 1, 0).kinds
    assert (kind.kind, kind.pose, kind.reported_as) == ("stop sign", "face-up", "stop sign")
    assert abs(kind.object_logit_std - offset_std) < 0.25
    np.testing.assert_allclose(kind.confidence_logit_mean[3:], MEAN[3:], atol=0.2)
    np.testing.assert_allclose(kind.confidence_logit_std[3:], 0.6, atol=0.2)
    weights = node_weights(looks.pixels)
    measured = weights @ (looks.confidences[:, 0] >= MISSION_CONFIDENCE_MIN) / weights.sum(axis=1)
    np.testing.assert_allclose(drawn_rates(kind), measured, atol=0.04)


def test_centre_errors_are_told_apart_by_size():
    model = fit_sensor(draw_looks(0.3), no_empties(), "synthetic", 1, 0)
    assert abs(model.centre_std_px - 0.5) < 0.1
    assert abs(model.centre_std_fraction - 0.04) < 0.005


def test_what_is_never_reported_is_not_in_the_model():
    looks = draw_looks(0.3, n_objects=50)
    model = fit_sensor(looks, no_empties(), "synthetic", 1, 0)
    assert {k.reported_as for k in model.kinds} == {"stop sign"}
    assert model.background == []


def test_background_rates_follow_altitude():
    rng = np.random.default_rng(1)
    altitudes = np.exp(rng.uniform(np.log(3), np.log(100), 6000))
    picture = np.flatnonzero(rng.random(6000) < np.where(altitudes > 25, 0.2, 0.0))
    n = len(picture)
    empties = Empties(altitudes, picture, np.full(n, 1), expit(rng.normal(-0.5, 0.4, n)), np.full(n, 9.0))
    (background,) = fit_sensor(draw_looks(0.3, 50), empties, "synthetic", 1, 0).background
    assert background.reported_as == CLASSES[1]
    assert background.rate_per_picture[0] == 0.0
    assert abs(background.rate_per_picture[-1] - 0.2) < 0.05
    assert abs(background.confidence_logit_mean + 0.5) < 0.1
    assert abs(background.confidence_logit_std - 0.4) < 0.1
    assert background.pixels == 9.0


def test_background_below_the_threshold_is_none():
    empties = Empties(
        np.array([9.0, 30.0]), np.array([0, 0]), np.array([1, 1]), np.array([0.12, 0.2]), np.ones(2)
    )
    assert fit_sensor(draw_looks(0.3, 50), empties, "synthetic", 1, 0).background == []


def test_kinds_without_looks_at_some_sizes_keep_the_nearest_value():
    looks = draw_looks(0.3)
    small = looks.pixels < 40
    part = Looks(*(getattr(looks, f)[small] for f in Looks.__slots__))
    (kind,) = fit_sensor(part, no_empties(), "synthetic", 1, 0).kinds
    assert kind.probability[-1] == kind.probability[-2]


def test_the_picture_of_the_fit_is_drawn(tmp_path):
    looks = draw_looks(0.3, n_objects=50)
    draw_fit(looks, fit_sensor(looks, no_empties(), "synthetic", 1, 0), tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 20_000


def test_weak_responses_do_not_become_reports():
    """Many responses just above the floor: the fitted tail over the missions' threshold must stay as thin."""
    rates = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        pixels = np.exp(rng.uniform(GRID[0], GRID[-1], 400))
        logits = rng.normal(-2.6, 0.5, 400)
        reported = (rng.random(400) < 0.5) & (expit(logits) >= CONFIDENCE_FLOOR)
        curve = fit_curve(pixels, np.where(reported, expit(logits), 0.0))
        rates.append(curve.probability * norm.sf((logit(MISSION_CONFIDENCE_MIN) - curve.mean) / curve.std))
    truth = 0.5 * norm.sf((logit(MISSION_CONFIDENCE_MIN) + 2.6) / 0.5)
    assert np.mean(rates) < truth + 0.002
