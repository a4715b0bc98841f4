"""The fit finds the numbers that looks were drawn from."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.special import gamma, ndtr
from scipy.stats import multivariate_normal

from skysweep.experiments.calibration.check import calibration_error, goodness, tell
from skysweep.experiments.calibration.fit import (
    ALTITUDES_M,
    GRID_PX,
    MISSION_CONFIDENCE_MIN,
    contrast_models,
    factors_of,
    fit_background,
    fit_box,
    fit_curve,
    fit_curves,
)
from skysweep.experiments.calibration.looks import (
    CLASSES,
    CONFIDENCE_FLOOR,
    PASS_LOOKS,
    SUBJECTS,
    SURFACES,
    Background,
    ScoredLooks,
)
from skysweep.experiments.calibration.shares import Shares, both_below, fit_shares, kind_model
from skysweep.sensing.statistical.factors import NAMES
from skysweep.sensing.statistical.luck import kept
from skysweep.sensing.statistical.model import confidence_of, score_of

SIGN, ROCK = SUBJECTS.index(("stop sign", "face-up")), SUBJECTS.index(("rock", "face-up"))
OWN = CLASSES.index("stop sign")
GRID = np.log(GRID_PX)
MEAN = np.interp(GRID, np.log([4, 12, 40]), [-1.5, 0.5, 1.8])
FACTORS = np.array(
    [-0.5, 0.4, 0.5, -1.0, 0.9, 0.3, -0.4, -0.6, -0.8, 0.3, -0.25, 0.2]
)  # the last of the lens
SPREAD, FADE_SCALE = 0.4, 0.8


def draw_looks(
    object_share=0.0,
    aspect_share=0.0,
    fade_rad=0.5,
    lapse=0.0,
    lapse_among=None,
    lapse_shares=(0.0, 0.0),
    n_objects=500,
    passes=6,
    seed=0,
    subject=SIGN,
):
    """Passes of successive looks from nearly one place; looks are the more alike, the less they differ.

    With ``lapse_among``, of those among trees, half of the objects are in the open; else none is.
    """
    rng = np.random.default_rng(seed)
    n_passes = n_objects * passes
    n = n_passes * PASS_LOOKS
    each = passes * PASS_LOOKS
    instance, number = np.repeat(np.arange(n_objects), each), np.tile(np.arange(PASS_LOOKS), n_passes)
    x = np.repeat(rng.uniform(GRID[0], GRID[-1], n_passes), PASS_LOOKS)
    x = (x + number * rng.normal(0.0, 0.1, n)).clip(GRID[0], GRID[-1])
    across = np.repeat(rng.uniform(-0.5, 0.5, (n_passes, 2)), PASS_LOOKS, axis=0)
    across += number[:, None] * rng.uniform(-0.3, 0.3, (n, 2))
    sight = np.column_stack([across, np.ones(n)])
    sight /= np.linalg.norm(sight, axis=1)[:, None]
    left, alike = np.zeros(n), np.empty(n)  # what is left of the look before
    for k in range(n_objects):
        mine = np.s_[k * each : (k + 1) * each]
        turned = np.linalg.norm(sight[mine, None] - sight[None, mine], axis=2)
        in_common = kept(turned, x[mine, None] - x[None, mine], fade_rad, FADE_SCALE)
        alike[mine] = np.linalg.cholesky(in_common) @ rng.normal(size=each)
        left[mine][1:] = np.diag(in_common, -1)
    z = (
        np.sqrt(object_share) * rng.normal(size=n_objects)[instance]
        + np.sqrt(aspect_share) * alike
        + np.sqrt(1 - object_share - aspect_share) * rng.normal(size=n)
    )
    view, hidden, cut, blur = (rng.uniform(0, most, n) for most in (0.5, 0.5, 0.75, 0.8))
    beside = rng.integers(0, 2, n_objects)[instance].astype(float)
    shade = rng.choice([0.0, 0.0, 0.5, 1.0], n_objects)[instance]
    lapses = np.full(n, lapse)
    if lapse_among is not None:
        is_among = np.random.default_rng([seed, 1]).random(n_objects)[instance] < 0.5
        hidden[~is_among] = beside[~is_among] = shade[~is_among] = 0.0
        lapses[is_among] = lapse_among
    edge_y, front = np.arange(n) % 2.0, np.sqrt(view) * np.cos(np.arange(n))
    at_edge_y = edge_y * np.maximum(1 - 8 / np.exp(x), 0)
    colour = rng.normal(30, 15, n_objects)[instance].clip(5, 80)
    contrast = (colour - 30) / 20
    others = np.floor(np.exp(rng.uniform(0.0, np.log(40.0), n))) - 1.0
    sides = view, front, front * np.clip((x - np.log(8)) / np.log(8), 0, 1)
    lens = np.where(rng.random(n_objects) < 0.3, rng.uniform(0.0, 3.0, n_objects), 0.0)[instance]
    seen_so = hidden, cut**2, at_edge_y, beside, shade, blur, contrast, np.log1p(others)
    factors = np.column_stack([*sides, *seen_so, lens])
    scores = np.interp(x, GRID, MEAN) + factors @ FACTORS + SPREAD * z
    draw = rng.random(n)
    if any(lapse_shares):
        of_aspect = rng.random(n)
        for k in range(1, n):
            if rng.random() < left[k]:
                of_aspect[k] = of_aspect[k - 1]
        whose, own = rng.random((2, n_objects))
        whose = whose[instance]
        draw = np.select(
            [whose < lapse_shares[0], whose < sum(lapse_shares)], [own[instance], of_aspect], draw
        )
    reported = (scores >= score_of(CONFIDENCE_FLOOR)) & (draw >= lapses)
    confidences = np.zeros((n, len(CLASSES)))
    confidences[reported, OWN] = confidence_of(scores[reported])
    offsets = np.full((n, len(CLASSES), 2), np.nan)
    spread = np.sqrt(0.5**2 + (0.04 * np.exp(x)) ** 2 + (0.2 * blur * np.exp(x)) ** 2)[:, None]
    offsets[reported, OWN] = (spread * rng.normal(size=(n, 2)))[reported]
    return ScoredLooks(
        subject=np.full(n, subject),
        instance=instance,
        world=instance // 10,
        surface=np.zeros(n, dtype=int),
        picture=np.repeat(np.arange(n_passes), PASS_LOOKS) * PASS_LOOKS + number,
        pixels=np.exp(x),
        sight=sight,
        lens_octaves=lens,
        view=view,
        front=front,
        hidden=hidden,
        cut=cut,
        edge_y=edge_y,
        beside=beside,
        shade=shade,
        blur_px=blur * np.exp(x),
        others=others,
        colour=colour,
        confidences=confidences,
        offsets_px=offsets,
    )


@pytest.fixture(scope="module")
def looks():
    return draw_looks(0.3, 0.4)


def test_mean_spread_and_factors_are_recovered(looks):
    factors = factors_of(looks)
    curve = fit_curves(looks, factors)[SIGN, OWN]
    np.testing.assert_allclose(curve.mean[1:], MEAN[1:], atol=0.25)
    assert curve.mean[0] == pytest.approx(MEAN[0], abs=0.5), "hardly ever reported"
    np.testing.assert_allclose(curve.shifts[: len(FACTORS)], FACTORS, atol=0.2)
    np.testing.assert_allclose(curve.spread, SPREAD, atol=0.08)
    assert curve.lapse[3:].max() < 0.05, "of smaller ones they are hardly told from low scores"
    for threshold in (MISSION_CONFIDENCE_MIN, 0.6):
        drawn = curve.chance(looks.pixels, factors, threshold)
        measured = looks.confidences[:, OWN] >= threshold
        assert abs(drawn.mean() - measured.mean()) < 0.02
        assert calibration_error(measured.astype(float), drawn) < 0.03


def test_what_a_ground_does_is_recovered():
    on_grass, on_snow = draw_looks(seed=1), draw_looks(seed=2)
    worse = np.where(on_snow.confidences > 0, score_of(np.clip(on_snow.confidences, 0.1, 0.999)) - 0.8, -9.0)
    seen = worse >= score_of(CONFIDENCE_FLOOR)
    on_snow = replace(
        on_snow,
        surface=on_snow.surface + SURFACES.index("snow"),
        instance=on_snow.instance + 1000,
        confidences=np.where(seen, confidence_of(worse), 0.0),
    )
    both = ScoredLooks(
        *(
            np.concatenate([getattr(part, f.name) for part in (on_grass, on_snow)])
            for f in fields(ScoredLooks)
        )
    )
    key, curve = next(iter(fit_curves(both, factors_of(both)).items()))
    model = kind_model(key, curve, Shares(0.0, 0.0, 1.0, 0.0, 0.0))
    assert model.grounds["grass"] - model.grounds["snow"] == pytest.approx(0.8, abs=0.1)


@pytest.mark.parametrize(("lapse", "lapse_among"), [(0.25, 0.25), (0.02, 0.2)])
def test_lapses_are_told_from_low_scores(lapse, lapse_among):
    looks = draw_looks(lapse=lapse, lapse_among=lapse_among)
    curve = fit_curves(looks, factors_of(looks))[SIGN, OWN]
    np.testing.assert_allclose(curve.lapse[6:], lapse, atol=0.06 if lapse > 0.1 else 0.015)
    np.testing.assert_allclose(curve.lapse_among[6:], lapse_among, atol=0.06)
    np.testing.assert_allclose(curve.mean[6:], MEAN[6:], atol=0.25)


@pytest.mark.parametrize(
    ("own", "of_aspect", "fade_rad"), [(0.0, 0.0, 0.5), (0.5, 0.0, 0.5), (0.0, 0.6, 0.2), (0.3, 0.5, 1.5)]
)
def test_what_looks_have_in_common_is_recovered(own, of_aspect, fade_rad):
    looks = draw_looks(own, of_aspect, fade_rad)
    factors = factors_of(looks)
    curves = fit_curves(looks, factors)
    shares, fade_scale = fit_shares(looks, factors, curves)
    found = shares[SIGN, OWN]
    assert found.of_object == pytest.approx(own, abs=0.15)
    for turned_rad, grown in ((0.1, 0.1), (0.3, 0.1), (0.7, 0.1), (0.1, 0.7), (0.1, -1.5), (0.7, 1.5)):
        true = own + of_aspect * kept(turned_rad, grown, fade_rad, FADE_SCALE)
        fitted = found.of_object + found.of_aspect * kept(turned_rad, grown, found.fade_rad, fade_scale)
        assert fitted == pytest.approx(true, abs=0.15), (turned_rad, grown)


@pytest.mark.parametrize(("own", "of_aspect"), [(0.0, 0.0), (0.7, 0.0), (0.1, 0.8), (0.5, 0.4)])
def test_whose_lapses_are_is_recovered(own, of_aspect):
    """Beside what the scores have in common. Some objects' lapses are all their own, some of an aspect."""
    looks = draw_looks(0.3, 0.4, lapse=0.2, lapse_shares=(own, of_aspect))
    factors = factors_of(looks)
    shares, _ = fit_shares(looks, factors, fit_curves(looks, factors))
    found = shares[SIGN, OWN]
    assert found.lapse_of_object == pytest.approx(own, abs=0.21)
    assert found.lapse_of_object + found.lapse_of_aspect == pytest.approx(own + of_aspect, abs=0.25)
    assert found.of_object == pytest.approx(0.3, abs=0.15)
    assert found.of_aspect == pytest.approx(0.4, abs=0.2)


def test_two_correlated_normals_below():
    a, b, rho = np.array([-1.0, 0.3, 2.0]), np.array([0.5, -0.2, 1.0]), np.array([0.0, 0.5, 0.85])
    expected = [
        multivariate_normal([0, 0], [[1, r], [r, 1]]).cdf([x, y]) for x, y, r in zip(a, b, rho, strict=True)
    ]
    np.testing.assert_allclose(both_below(a, b, rho), expected, atol=2e-3)


def test_sizes_without_looks_keep_what_is_known_nearest(looks):
    small = looks.where(looks.pixels < 40)
    curve = fit_curve(small.pixels, factors_of(small), small.confidences[:, OWN])
    assert abs(curve.mean[-1] - curve.mean[7]) < 1.2


def test_what_is_never_reported_is_not_in_the_model(looks):
    few = looks.where(np.arange(400))
    rocks = replace(few, subject=np.full(400, ROCK), confidences=np.zeros((400, len(CLASSES))))
    rocks.confidences[:4, OWN] = 0.5
    both = ScoredLooks(*(np.concatenate([getattr(few, f), getattr(rocks, f)]) for f in ScoredLooks.__slots__))
    assert set(fit_curves(both, factors_of(both))) == {(SIGN, OWN)}


def test_kinds_are_written_as_they_were_fitted(looks):
    curves = fit_curves(looks, factors_of(looks))
    ((key, curve),) = curves.items()
    kind = kind_model(key, curve, Shares(0.3, 0.4, 0.7, 0.5, 0.2))
    assert (kind.kind, kind.pose, kind.reported_as) == ("stop sign", "face-up", "stop sign")
    np.testing.assert_allclose(kind.score, curves[SIGN, OWN].mean, atol=1e-3)
    assert (kind.object_share, kind.aspect_share, kind.fade_rad) == (0.3, 0.4, 0.7)
    assert (kind.lapse_object_share, kind.lapse_aspect_share) == (0.5, 0.2)
    assert kind.lens == pytest.approx(FACTORS[-1], abs=0.1)


def test_colours_that_were_not_measured_are_the_usual_on_that_ground(looks):
    colour = np.where(np.arange(len(looks.pixels)) % 2, np.nan, 50.0)
    factors = factors_of(replace(looks, colour=colour))
    np.testing.assert_allclose(factors[:, NAMES.index("contrast")], 1.0)
    (model,) = contrast_models(looks)
    mean, std = model.surfaces[SURFACES[0]]
    assert abs(mean - 30) < 3
    assert abs(std - 15) < 3


def test_held_out_looks_are_told_well_by_the_truth_and_badly_by_chance(looks):
    told = tell(looks, factors_of(looks), [(SIGN, OWN)])
    assert len(told.subject) == len(looks.pixels)
    assert told.is_own.all()
    first, second = goodness(told)
    assert (first.confidence, second.confidence) == (MISSION_CONFIDENCE_MIN, 0.6)
    assert first.brier < 0.7 * first.brier_of_rates
    assert first.deviance_explained > 0.3
    assert first.calibration_error < 0.04
    assert all(abs(p.measured - p.drawn) < 0.12 for p in first.parts if p.looks > 200)
    shuffled = np.random.default_rng(0).permutation(len(told.chance))
    (worse, _) = goodness(replace(told, chance=told.chance[shuffled]))
    assert worse.deviance_explained < 0


def test_errors_of_boxes_are_told_apart_by_size_and_blur():
    looks = draw_looks(n_objects=1500)
    box = fit_box(replace(looks, hidden=np.zeros(len(looks.pixels)), cut=np.zeros(len(looks.pixels))))
    assert box.of_object == pytest.approx(0.04, abs=0.03)
    assert box.pixels < 1.5
    assert box.of_blur > 0.05


@pytest.mark.parametrize("shape", [1.0, 1.6])
def test_background_rates_and_scores_follow_altitude(shape):
    rng = np.random.default_rng(1)
    altitudes = np.exp(rng.uniform(np.log(3), np.log(100), 4000))
    hectares = altitudes**2 * 1e-4
    surface = rng.integers(0, 2, 4000)
    counts = rng.poisson(hectares * np.where(altitudes > 20, 0.5, 5.0) * np.where(surface == 0, 0.2, 1.0))
    trees, cut_trees = rng.poisson(20.0 * hectares), rng.poisson(5.0 * hectares)
    on_trees = rng.poisson(trees * np.where(altitudes > 20, 0.01, 0.1))
    on_cut = rng.poisson(cut_trees * 0.05)
    sums = [counts.sum(), on_trees.sum(), on_cut.sum()]
    of_tree, is_cut = np.repeat([False, True, True], sums), np.repeat([False, False, True], sums)
    of_report = np.repeat(np.tile(np.arange(4000), 3), [*counts, *on_trees, *on_cut])
    n = len(of_report)
    scores = score_of(CONFIDENCE_FLOOR) + 0.6 * rng.weibull(shape, n) / gamma(1 + 1 / shape)
    seen = Background(
        altitude_agl_m=altitudes,
        hectares=hectares,
        world=np.arange(4000) // 40,
        surface=surface,
        trees=trees.astype(float),
        cut_trees=cut_trees.astype(float),
        picture_of_report=of_report,
        class_index=np.full(n, 1),
        confidences=confidence_of(scores),
        pixels=np.full(n, 9.0),
        again=np.where(rng.random(n) < 0.6, confidence_of(scores), 0.0),
        of_tree=of_tree,
        is_cut=is_cut,
    )
    fitted = fit_background(seen, 1)
    assert fitted.reported_as == CLASSES[1]
    of_other = np.array(fitted.per_hectare) * fitted.surfaces[SURFACES[1]]
    assert of_other[-1] == pytest.approx(0.5, rel=0.25)
    assert of_other[1] > 2.0
    assert fitted.surfaces[SURFACES[0]] / fitted.surfaces[SURFACES[1]] == pytest.approx(0.2, rel=0.3)
    assert fitted.per_tree[-1] == pytest.approx(0.01, rel=0.4)
    assert fitted.per_tree[1] > 0.03
    assert fitted.per_cut_tree[2:] == pytest.approx([0.05] * 4, rel=0.4)
    assert fitted.score_scale == pytest.approx([0.6] * len(ALTITUDES_M), abs=0.15)
    assert fitted.score_shape == pytest.approx(shape, abs=0.15)
    assert fitted.again == pytest.approx(0.6, abs=0.05)
    assert fitted.same_share > 0.9
    assert fitted.pixels == 9.0
    assert fit_background(seen, 0) is None


def test_the_score_is_what_a_threshold_cuts():
    looks = draw_looks()
    curve = fit_curves(looks, factors_of(looks))[SIGN, OWN]
    at = np.array([14.0])
    mean, spread, lapse = curve.at(at, np.zeros((1, len(FACTORS) + len(SURFACES))))
    expected = (1 - lapse) * ndtr((mean - score_of(0.4)) / spread)
    np.testing.assert_allclose(curve.chance(at, np.zeros((1, len(FACTORS) + len(SURFACES))), 0.4), expected)
