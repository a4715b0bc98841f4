"""The sensor without pictures draws what its tables say, and nothing else."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from numba import types
from scipy.special import gamma
from scipy.stats import binom, kstest, norm, weibull_min

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraMotion, CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import CameraModel, DetectorModel, Light
from skysweep.sensing.exposures import Exposures
from skysweep.sensing.statistical.draws import draw_look, standard_normal
from skysweep.sensing.statistical.factors import FACTORS
from skysweep.sensing.statistical.model import (
    VERSION,
    BackgroundModel,
    BoxModel,
    CalibratedCamera,
    ContrastModel,
    Detecting,
    Experiment,
    KindModel,
    StatisticalModel,
    confidence_of,
    model_for,
    score_of,
)
from skysweep.sensing.statistical.sensor import StatisticalSensor
from skysweep.types import VehicleState
from skysweep.worlds.occlusion import Occluders
from skysweep.worlds.world import GroundCover, TerrainSurface, World, WorldObject, WorldTree

CAMERA = CameraModel(hfov_rad=1.2, latency_s=0.0)
LENS = CAMERA.lens
FLAT = TerrainSurface(np.zeros((2, 2)), (-200, -200, 200, 200), "grass")
GRID = [5.0, 10.0, 20.0, 200.0]
LOOKS = 4000
MINIMUM = 0.3


def table(kind="stop sign", reported_as="stop sign", pose="face-up", scores=(-3.0, -0.5, 1.0, 1.0), **other):
    fields = dict(
        view=0.0,
        front=0.0,
        front_near=0.0,
        hidden=0.0,
        cut=0.0,
        edge_y=0.0,
        beside=0.0,
        shade=0.0,
        blur=0.0,
        contrast=0.0,
        company=0.0,
        lens=0.0,
        grounds={},
        object_share=0.0,
        aspect_share=0.0,
        fade_rad=0.1,
    )
    return KindModel(
        kind=kind,
        pose=pose,
        reported_as=reported_as,
        score=list(scores),
        spread=[0.5] * 4,
        lapse=[other.get("lapse", 0.0)] * 4,
        lapse_among=[other.pop("lapse_among", other.pop("lapse", 0.0))] * 4,
        **(fields | other),
    )


def model(*kinds, background=(), contrasts=(), fade_scale=0.8):
    return StatisticalModel(
        version=VERSION,
        detector=Detecting(name="test", sha256="0" * 64),
        camera=CalibratedCamera(**CAMERA.model_dump(include=set(CalibratedCamera.model_fields))),
        experiment=Experiment(pictures=1, seed=0, looks=1, confidence_floor=0.1),
        pixels=GRID,
        fade_scale=fade_scale,
        box=BoxModel(pixels=0.5, of_object=0.04, of_blur=0.0),
        kinds=list(kinds),
        contrasts=list(contrasts),
        background=list(background),
    )


def sign(x=0.0, y=0.0, kind="stop sign", size=0.9):
    return WorldObject(kind, np.array([x, y, 0.0]), 0.0, size, "face-up", kind == "stop sign", 1000)


def nadir(z, x=0.0, y=0.0):
    return CameraPose(np.array([x, y, z]), rotation_camera_to_enu(np.pi / 2, -np.pi / 2))


def state(t, camera):
    return VehicleState(t, camera.position_enu_m, np.zeros(3), np.eye(3), camera, 1.0, 0.0, True)


def height_for(pixels, size=0.9):
    return float(LENS.focal_px * size / pixels)


STILL = CameraMotion(np.zeros(3), np.zeros(3))
FAST = CameraMotion(np.array([25.0, 0.0, 0.0]), np.zeros(3))


class Eye:
    """Is where ``pose`` says. Implements ``types.Truth``."""

    def __init__(self, pose, motion):
        self.true_camera_pose, self.true_camera_motion = pose, lambda: motion


def sensor_of(
    objects,
    tables,
    true,
    *,
    seed=0,
    trees=(),
    classes=("stop sign",),
    camera=CAMERA,
    minimum=MINIMUM,
    motion=STILL,
    surface=FLAT,
    light=None,
    tiles=1,
    smallest_m=0.0,
):
    world = World(surface, tuple(objects), tuple(trees), (), light or Light(), 0)
    eye = Eye(true if callable(true) else lambda: true, motion)
    detector = DetectorModel(tiles=tiles).model_copy(update={"confidence_min": minimum})
    exposures, size = Exposures(10.0, 0.0), {"smallest_m": smallest_m}
    return StatisticalSensor(world, camera, detector, eye, exposures, classes, seed, tables, **size)


def chance(mean, spread=0.5, minimum=MINIMUM):
    return norm.sf((score_of(minimum) - mean) / spread)


def looks(objects, tables, true, n=LOOKS, believed=None, **options):
    sensor = sensor_of(objects, tables, true, **options)
    shown = believed or (nadir(30.0) if callable(true) else true)
    return [sensor.sense(state(0.1 * k, shown)) for k in range(n)]


def assert_rate(found, n, probability):
    low, high = binom.ppf([1e-5, 1 - 1e-5], n, probability)
    assert low <= found <= high


def test_scores_are_confidences_on_another_scale():
    np.testing.assert_allclose(confidence_of(score_of([0.01, 0.25, 0.6, 0.99])), [0.01, 0.25, 0.6, 0.99])
    assert (np.diff(score_of(np.linspace(0.01, 0.99, 50))) > 0).all()


@pytest.mark.parametrize(
    ("pixels", "mean"), [(10.0, -0.5), (np.sqrt(50.0), -1.75), (np.sqrt(200.0), 0.25), (60.0, 1.0)]
)
def test_detections_are_as_frequent_as_the_scores_say(pixels, mean):
    found = looks([sign()], model(table()), nadir(height_for(pixels)))
    assert_rate(sum(map(len, found)), LOOKS, chance(mean))


def test_what_is_far_smaller_than_what_was_measured_is_not_seen():
    assert sum(map(len, looks([sign()], model(table(scores=(3.0,) * 4)), nadir(height_for(3.0)), 300))) == 0


def test_confidences_follow_the_scores():
    found = looks([sign()], model(table()), nadir(height_for(60.0)), minimum=0.01)
    scores = score_of(np.concatenate([d.confidences for d in found]))
    assert len(scores) == LOOKS
    assert kstest(scores, norm(1.0, 0.5).cdf).pvalue > 1e-3


def test_confidences_below_the_minimum_are_not_reported():
    found = looks([sign()], model(table()), nadir(height_for(60.0)), minimum=0.8)
    confidences = np.concatenate([d.confidences for d in found])
    assert confidences.min() >= 0.8
    assert_rate(len(confidences), LOOKS, chance(1.0, minimum=0.8))


def test_lapses_hit_whatever_the_score():
    found = looks([sign()], model(table(scores=(4.0,) * 4, lapse=0.2)), nadir(height_for(60.0)))
    assert_rate(sum(map(len, found)), LOOKS, 0.8)


@pytest.mark.parametrize(("own", "of_aspect"), [(0.0, 0.0), (0.5, 0.0), (0.3, 0.5), (0.0, 1.0)])
def test_lapses_are_of_the_object_of_the_aspect_or_of_the_look(own, of_aspect):
    """Of 60 signs, each seen from 16 heights in 4 looks that are 0.02 rad apart."""
    lapse = 0.25
    signs = [sign(2000.0 * k) for k in range(60)]
    heights_m = [height_for(30.0 if k % 2 else 150.0) for k in range(16)]
    views = iter(
        [
            nadir(z, s.position_enu_m[0] + 0.02 * z * (k - 1.5))
            for s in signs
            for z in heights_m
            for k in range(4)
        ]
    )
    shares = {"lapse_object_share": own, "lapse_aspect_share": of_aspect}
    tables = model(table(scores=(4.0,) * 4, lapse=lapse, fade_rad=0.1, **shares), fade_scale=0.3)
    wide = TerrainSurface(np.zeros((2, 2)), (-1000, -200, 130_000, 200), "grass")
    seen = np.array([len(d) for d in looks(signs, tables, lambda: next(views), 60 * 64, surface=wide)])
    missed = 1.0 - seen.reshape(60, 16, 4)
    assert missed.mean() == pytest.approx(lapse, abs=0.04 if own == 0.0 else 0.12)
    ever = missed.mean(axis=(1, 2))
    always = float((ever == 1.0).mean())
    assert always == pytest.approx(own * lapse, abs=0.1)
    others = missed[ever < 1.0]
    rest = 1.0 - (1.0 - lapse) / (1.0 - own * lapse)
    assert others.mean() == pytest.approx(rest, abs=0.04)
    of_those = of_aspect / (1.0 - own)
    again = others[:, :, 1:][others[:, :, :-1] == 1.0].mean()
    left = np.exp(-0.02 / 0.1)
    assert again == pytest.approx(rest + of_those * left * (1.0 - rest), abs=0.12)
    apart = np.corrcoef(others[:, :-1, 0].ravel(), others[:, 1:, 0].ravel())[0, 1]
    assert abs(apart) < 0.1


def test_a_flat_view_the_edge_blur_and_contrast_shift_the_score():
    level = (0.0,) * 4
    true = nadir(height_for(30.0))
    far = nadir(height_for(30.0), 6.0, 0.0)
    view = 36.0 / (36.0 + true.position_enu_m[2] ** 2)
    found = looks([sign()], model(table(scores=level, view=-3.0)), far)
    assert_rate(sum(map(len, found)), LOOKS, chance(-3.0 * view))
    for yaw_rad, shift in ((0.0, 2.0), (np.pi / 2, 0.0), (np.pi, -2.0)):
        turned = replace(sign(), yaw_rad=yaw_rad)
        found = looks([turned], model(table(scores=level, front=2.0)), far)
        assert_rate(sum(map(len, found)), LOOKS, chance(shift * np.sqrt(view)))
        found = looks([turned], model(table(scores=level, front_near=2.0)), far)
        assert_rate(
            sum(map(len, found)), LOOKS, chance(shift * np.log(30.0 / 8.0) / np.log(8.0) * np.sqrt(view))
        )
    blur = LENS.focal_px * CAMERA.exposure_s * 25.0 / true.position_enu_m[2] / 30.0
    found = looks([sign()], model(table(scores=level, blur=-4.0)), true, motion=FAST)
    assert_rate(sum(map(len, found)), LOOKS, chance(-4.0 * blur))
    contrast = ContrastModel(kind="stop sign", pose="face-up", surfaces={"grass": (50.0, 0.0)})
    tables = model(table(scores=level, contrast=0.7), contrasts=[contrast])
    assert_rate(sum(map(len, looks([sign()], tables, true))), LOOKS, chance(0.7))
    sand = replace(FLAT, surface="sand")
    assert_rate(sum(map(len, looks([sign()], tables, true, surface=sand))), LOOKS, chance(0.0))
    edge_x = 320.0 / LENS.focal_px * true.position_enu_m[2]
    found = looks([sign(edge_x)], model(table(scores=level, cut=-2.0, edge_y=3.0)), true)
    assert_rate(sum(map(len, found)), LOOKS, chance(-0.5))
    edge_y = 180.0 / LENS.focal_px * true.position_enu_m[2]
    found = looks([sign(0.0, edge_y)], model(table(scores=level, cut=-2.0, edge_y=1.0)), true)
    assert_rate(sum(map(len, found)), LOOKS, chance(-0.5 + 1.0 - 8.0 / 30.0))


def test_the_shadow_of_a_crown_shifts_the_score():
    """The sun stands in the south, 45 degrees high, and the crown is 6 m above its shadow's middle."""
    crown = WorldTree(np.array([0.0, -6.5, 0.0]), 9.0, 2.0, "broadleaf", 1)
    tables, true = model(table(scores=(1.0,) * 4, shade=-1.5)), nadir(height_for(30.0))
    south = Light(sun_elevation_deg=45.0, sun_heading_deg=180.0)
    for light, shift in (
        (south, -1.5),
        (Light(sun_heading_deg=0.0), 0.0),
        (Light(sun_elevation_deg=-5), 0.0),
    ):
        found = looks([sign()], tables, true, trees=(crown,), light=light)
        assert_rate(sum(map(len, found)), LOOKS, chance(1.0 + shift))


def test_company_shifts_the_score():
    """Of things in the same tile that are large enough to be seen."""
    true = nadir(height_for(30.0))
    tables = model(table(scores=(1.0,) * 4, company=-0.7), table("rock", scores=(-9.0,) * 4))
    for others, mean in ((0, 1.0), (1, 1.0 - 0.7 * np.log(2)), (4, 1.0 - 0.7 * np.log(5))):
        rocks = [sign(2.0 * k - 4.0, 2.0, kind="rock") for k in range(others)]
        rocks += [sign(-2.0, -2.0, "rock", 0.05), sign(40.0, 0.0, "rock")]
        assert_rate(sum(map(len, looks([sign(), *rocks], tables, true))), LOOKS, chance(mean))


def test_a_longer_lens_shifts_the_score_as_far_as_it_was_measured():
    """By each octave of its focal length; the object spans the same pixels, from farther away."""
    tables = model(table(scores=(0.5,) * 4, lens=-0.4))
    for octaves, shift in ((0.0, 0.0), (1.0, -0.4), (2.0, -0.8), (4.0, -1.2)):
        hfov_rad = 2.0 * math.atan(math.tan(CAMERA.hfov_rad / 2.0) * 2.0**-octaves)
        camera = CAMERA.model_copy(update={"hfov_rad": hfov_rad})
        true = nadir(height_for(30.0) * 2.0**octaves)
        assert_rate(sum(map(len, looks([sign()], tables, true, camera=camera))), LOOKS, chance(0.5 + shift))


def test_the_ground_shifts_the_score():
    tables, true = model(table(scores=(0.0,) * 4, grounds={"sand": -0.6})), nadir(height_for(30.0))
    for surface, shift in (("sand", -0.6), ("grass", 0.0)):
        found = looks([sign()], tables, true, surface=replace(FLAT, surface=surface))
        assert_rate(sum(map(len, found)), LOOKS, chance(shift))


def test_some_objects_are_seen_better_than_others_in_every_look():
    signs = [sign(x, y) for x in range(-12, 13, 4) for y in range(-6, 7, 4)]
    true = nadir(height_for(12.0))
    rates = np.zeros((2, len(signs)))
    for row, share in enumerate((0.0, 0.6)):
        tables = model(table(scores=(float(score_of(MINIMUM)),) * 4, object_share=share))
        for detections in looks(signs, tables, true, n=400):
            middles = (detections.boxes_xyxy_px[:, :2] + detections.boxes_xyxy_px[:, 2:]) / 2
            places, _ = project(LENS, true, [s.position_enu_m for s in signs])
            gaps = np.linalg.norm(middles[:, None] - places, axis=2)
            np.add.at(rates[row], gaps.argmin(axis=1), 1 / 400)
    same, different = rates.var(axis=1) / (0.25 / 400)
    assert same < 2.0
    assert different > 20.0
    offsets = norm.ppf(np.clip(rates[1], 1 / 800, 1 - 1 / 800)) * np.sqrt(0.4)
    assert 0.4 < offsets.var() < 0.9


@pytest.mark.parametrize(
    ("step_px", "lag", "grown"),
    [(5.0, 1, 1.0), (10.0, 1, 1.0), (10.0, 5, 1.0), (250.0, 1, 1.0), (5.0, 1, 1.5), (5.0, 2, 1.5)],
)
def test_looks_are_alike_the_less_the_more_the_line_of_sight_turned_and_the_object_grew(step_px, lag, grown):
    """Successive scores have the correlation aspect_share * exp(-turned / fade_rad - |grown| / fade_scale).

    Even looks are from lower down, so that the object has ``grown``; what faded does not come back.
    """
    z = height_for(30.0)
    to_and_fro = (np.abs((np.arange(LOOKS) * step_px) % 500.0 - 250.0) - 125.0) / LENS.focal_px
    views = iter([nadir(at, x * at) for k, x in enumerate(to_and_fro) for at in [z / grown ** (k % 2)]])
    tables = model(table(scores=(0.0,) * 4, aspect_share=0.6, fade_rad=0.1), fade_scale=0.8)
    found = looks([sign()], tables, lambda: next(views), minimum=0.001)
    scores = np.array([score_of(d.confidences[0]) if len(d) else np.nan for d in found])
    pairs = np.column_stack([scores[:-lag], scores[lag:]])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    turned_rad = step_px / LENS.focal_px / (1.0 + to_and_fro**2)
    expected = 0.6 * np.mean(np.exp(-lag * turned_rad / 0.1)) * grown ** (-lag / 0.8)
    assert len(pairs) > 0.99 * (LOOKS - lag)
    assert np.corrcoef(pairs.T)[0, 1] == pytest.approx(expected, abs=0.08)


def test_boxes_scatter_around_the_object_as_the_model_says():
    true = nadir(height_for(40.0), 3.0, -2.0)
    boxes = np.concatenate([d.boxes_xyxy_px for d in looks([sign()], model(table()), true)])
    errors = (boxes[:, :2] + boxes[:, 2:]) / 2 - project(LENS, true, [[0.0, 0.0, 0.0]])[0]
    spread = np.hypot(0.5, 0.04 * 40.0)
    assert kstest(errors.ravel(), norm(0.0, spread).cdf).pvalue > 1e-3
    np.testing.assert_allclose(boxes[:, 2:] - boxes[:, :2], 40.0, rtol=1e-6)


def test_the_same_seed_gives_the_same_detections_and_another_others():
    def everything(seed):
        return np.concatenate(
            [d.boxes_xyxy_px for d in looks([sign()], model(table()), nadir(30.0), 200, seed=seed)]
        )

    np.testing.assert_array_equal(everything(1), everything(1))
    assert not np.array_equal(everything(1)[:20], everything(2)[:20])


def test_what_was_in_view_does_not_change_later_draws():
    near, away = nadir(height_for(15.0)), nadir(30.0, 100.0, 100.0)

    def late_looks(first):
        views = [first] * 100 + [near] * 200
        now = iter(views)
        sensor = sensor_of([sign()], model(table()), lambda: next(now))
        return [sensor.sense(state(0.1 * k, view)).confidences.tolist() for k, view in enumerate(views)][100:]

    assert late_looks(near) == late_looks(away)


def test_what_else_is_there_does_not_change_the_draws_of_an_object():
    alone = looks([sign()], model(table()), nadir(20.0), 200)
    among = looks([sign(), sign(300.0), sign(-300.0)], model(table()), nadir(20.0), 200)
    assert [d.confidences.tolist() for d in alone] == [d.confidences.tolist() for d in among]


def test_compiled_code_is_handed_plain_arrays_and_numbers():
    """Numba's cache on disk would break without a word when a class among its argument types is renamed."""
    looks([sign()], model(table()), nadir(20.0), 1)
    assert {type(t) for types_of in draw_look.signatures for t in types_of} == {
        types.Array,
        types.Float,
        types.Integer,
    }


def test_a_world_with_nothing_to_report_gives_empty_looks():
    assert sum(map(len, looks([sign(kind="rock")], model(table()), nadir(20.0), 10))) == 0


def test_draws_are_normal_and_unrelated():
    draws = np.array([[standard_normal(7, look, row, 0) for row in range(40)] for look in range(500)])
    assert kstest(draws.ravel(), norm.cdf).pvalue > 1e-3
    for other in (draws[1:, :], draws[:-1, ::-1]):
        assert abs(np.corrcoef(draws[: len(other)].ravel(), other.ravel())[0, 1]) < 0.03


def test_nothing_reaches_outside_the_picture():
    signs = [sign(x, y) for x in np.linspace(-25, 25, 60) for y in (-11.0, 0.0, 11.0)]
    for detections in looks(signs, model(table()), nadir(30.0), 100):
        assert (detections.boxes_xyxy_px >= 0).all()
        assert (detections.boxes_xyxy_px[:, [0, 2]] <= 640).all()
        assert (detections.boxes_xyxy_px[:, [1, 3]] <= 360).all()
        assert (detections.boxes_xyxy_px[:, 2:] > detections.boxes_xyxy_px[:, :2]).all()


def test_what_is_out_of_view_or_behind_is_not_seen():
    up = CameraPose(np.array([0, 0, 5.0]), rotation_camera_to_enu(0.0, np.pi / 2))
    assert sum(map(len, looks([sign(60.0, 0.0)], model(table()), nadir(30.0), 300))) == 0
    assert sum(map(len, looks([sign()], model(table()), up, 300))) == 0


def test_hidden_objects_are_not_seen():
    tree = WorldTree(np.zeros(3), 8.0, 2.5, "broadleaf", 0)
    assert sum(map(len, looks([sign()], model(table()), nadir(30.0), 300, trees=[tree]))) == 0
    assert sum(map(len, looks([sign(8.0, 3.0)], model(table()), nadir(25.0), 300, trees=[tree]))) > 100


def test_the_believed_pose_is_handed_on_and_the_true_one_is_drawn_from():
    true, believed = nadir(30.0), nadir(31.0, 200.0, 0.0)
    found = looks([sign()], model(table()), true, 200, believed=believed)
    assert sum(map(len, found)) > 50
    assert all(d.camera is believed for d in found)
    middles = np.concatenate([(d.boxes_xyxy_px[:, :2] + d.boxes_xyxy_px[:, 2:]) / 2 for d in found])
    np.testing.assert_allclose(middles.mean(axis=0), [320, 180], atol=1.0)


def test_results_come_after_the_latency_with_the_time_of_exposure():
    camera = CAMERA.model_copy(update={"latency_s": 0.25})
    sensor = sensor_of([sign()], model(table()), nadir(30.0), camera=camera)
    results = [sensor.sense(state(0.1 * k, nadir(30.0))) for k in range(10)]
    assert results[:3] == [None, None, None]
    for k in range(3, 10):
        assert results[k].time_s == pytest.approx(0.1 * (k - 3))


def test_other_classes_are_not_looked_for():
    tables = model(table(), table("rock", "person"))
    found = looks([sign(), sign(3, 0, kind="rock")], tables, nadir(20.0), 300, classes=("person",))
    assert {n for d in found for n in d.class_names} == {"person"}


def test_poses_have_their_own_tables_and_others_fall_back():
    tables = model(table(), table(pose="standing", scores=(-4.0,) * 4))
    upright = replace(sign(), pose="standing")
    afloat = replace(sign(), pose="floating", size_m=2.25)
    assert sum(map(len, looks([upright], tables, nadir(20.0), 300))) == 0
    assert sum(map(len, looks([afloat], tables, nadir(20.0), 300))) > 100


def background(**other):
    fields = dict(
        reported_as="stop sign",
        altitude_agl_m=[8.0, 32.0],
        per_hectare=[0.001, 40.0],
        surfaces={"grass": 1.0, "water": 0.1},
        per_tree=[0.0, 0.0],
        per_cut_tree=[0.0, 0.0],
        score_scale=[0.5, 0.5],
        score_shape=1.0,
        again=0.5,
        same_share=0.5,
        pixels=12.0,
    )
    return BackgroundModel(**(fields | other))


def moving(altitude_m, n):
    """All over the world, so that many places come into view."""
    rng = np.random.default_rng(3)
    return iter([nadir(altitude_m, *rng.uniform(-150, 150, 2)) for _ in range(n)])


def test_background_reports_come_at_their_rate_a_hectare():
    hectares = np.prod(LENS.footprint_m(31.9)) / 1e4
    views = moving(31.9, LOOKS)
    found = looks([], model(table(), background=[background()]), lambda: next(views), minimum=0.101)
    assert sum(map(len, found)) / LOOKS / hectares == pytest.approx(40.0, rel=0.15)
    views = moving(8.0, 1000)
    low = looks([], model(table(), background=[background()]), lambda: next(views), 1000, minimum=0.101)
    assert sum(map(len, low)) <= 2


def test_background_depends_on_the_ground():
    tables = model(table(), background=[background()])

    def reports(surface):
        views = moving(31.9, 1000)
        return sum(map(len, looks([], tables, lambda: next(views), 1000, minimum=0.101, surface=surface)))

    grass, wet = reports(FLAT), reports(replace(FLAT, surface="water"))
    assert wet / grass == pytest.approx(0.1, rel=0.4)


def test_background_reports_come_at_their_rate_a_tree():
    """In one picture that shows all three, at any height of theirs."""
    trees = [WorldTree(np.array([4.0 * k, 0.0, 0.0]), 6.0, 1.5, "conifer", 0) for k in range(3)]
    tables = model(table(), background=[background(per_hectare=[0.0, 0.0], per_tree=[0.0, 0.6])])
    found = [
        sum(map(len, looks([], tables, nadir(31.9), 50, minimum=0.101, seed=seed, trees=trees))) / 50
        for seed in range(200)
    ]
    assert np.mean(found) == pytest.approx(3 * 0.6, rel=0.2)
    assert not any(map(len, looks([], tables, nadir(31.9), 200, minimum=0.101)))
    assert not any(map(len, looks([], tables, nadir(8.0), 200, minimum=0.101, trees=trees)))


def test_background_reports_of_trees_that_an_edge_cuts_come_at_their_rate_at_that_edge():
    """One crown of four is cut by the right edge of the picture, one by the upper edge."""
    east_m, north_m = np.array(LENS.footprint_m(31.4)) / 2.0
    places = [(east_m + 0.3, 3.0), (2.0, north_m - 0.3), (0.0, 0.0), (east_m + 4.0, 0.0)]
    trees = [WorldTree(np.array([*place, 0.0]), 1.0, 1.5, "broadleaf", 0) for place in places]
    tables = model(table(), background=[background(per_hectare=[0.0, 0.0], per_cut_tree=[0.0, 0.6])])
    found = [
        d.boxes_xyxy_px
        for seed in range(200)
        for d in looks([], tables, nadir(31.9), 50, minimum=0.101, seed=seed, trees=trees)
    ]
    boxes = np.concatenate(found)
    at_right, at_top = boxes[:, 2] == 640.0, boxes[:, 1] == 0.0
    assert at_right.sum() / len(found) == pytest.approx(0.6, rel=0.25)
    assert at_top.sum() / len(found) == pytest.approx(0.6, rel=0.25)
    assert (at_right | at_top).all()
    assert not any(map(len, looks([], tables, nadir(8.0), 200, minimum=0.101, trees=trees)))


@pytest.mark.parametrize("shape", [1.0, 1.5])
def test_background_scores_above_the_floor_have_their_mean_and_shape(shape):
    views = moving(31.9, LOOKS)
    tables = model(table(), background=[background(score_shape=shape)])
    found = looks([], tables, lambda: next(views), minimum=0.101)
    scores = score_of(np.concatenate([d.confidences for d in found])) - score_of(0.1)
    assert scores.mean() == pytest.approx(0.5, rel=0.15)
    strong = weibull_min(shape, scale=0.5 / gamma(1 + 1 / shape)).sf(1.0)
    assert (scores > 1.0).mean() == pytest.approx(strong, rel=0.3)


def test_background_reports_stay_where_they_are_and_come_again():
    tables = model(table(), background=[background(per_hectare=[40.0, 40.0], again=0.7)])
    found = looks([], tables, nadir(31.9), 400, minimum=0.101)
    places = np.concatenate([(d.boxes_xyxy_px[:, :2] + d.boxes_xyxy_px[:, 2:]) / 2 for d in found])
    known, counts = np.unique(places.round(3), axis=0, return_counts=True)
    assert len(known) < 30
    assert np.median(counts) / 400 == pytest.approx(0.7, abs=0.1)


@pytest.mark.parametrize("surface", ["grass", "water"])
def test_the_shipped_model_sees_signs_from_near_and_not_from_very_far(surface):
    ground, shipped = replace(FLAT, surface=surface), StatisticalModel.load()
    near = looks([sign()], shipped, nadir(height_for(60.0)), 200, minimum=0.25, surface=ground)
    far = looks([sign()], shipped, nadir(height_for(3.0)), 200, minimum=0.25, surface=ground)
    assert sum(map(len, near)) > 150
    assert sum(d.confidences.size for d in far) < 20


@pytest.mark.parametrize("name", ["clusters", "person-wilderness", "maritime", "buildings"])
def test_the_shipped_model_is_for_the_shipped_scenarios(name):
    assert model_for(load_scenario(name)) == StatisticalModel.load()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"camera.exposure_s": 0.1, "search.scan_speed_mps": 10.0},
            "camera.exposure_s is 0.1, in which the camera moves 1 m at search.scan_speed_mps, farther than "
            "the 0.9 m of the smallest target",
        ),
        ({"camera.noise_std": 6}, "camera.noise_std is 6 grey levels a pixel that the detector sees, not 2"),
        (
            {"camera.jpeg_quality": 40},
            "camera.jpeg_quality is 40, 6.2 times as coarse for the detector as 90",
        ),
        (
            {"detector.tiles": 3},
            "detector.tiles is 3, which enlarges the camera's pixels 2.59 times, more than 2",
        ),
        ({"detector.confidence_min": 0.05}, "confidence_min is 0.05, below 0.1"),
        ({"detector.model": __file__}, "not skysweep"),
    ],
)
def test_another_camera_or_detector_is_refused_with_what_differs(change, words):
    scenario = change_scenario(load_scenario("clusters"), change)
    with pytest.raises(UserError, match="the shipped sensor model: was made for another") as error:
        model_for(scenario)
    assert words in str(error.value)
    assert "skysweep calibrate" in str(error.value)


def test_a_missing_detector_is_not_called_another_one():
    with pytest.raises(UserError, match=r"^gone\.onnx: there is no such model file"):
        model_for(change_scenario(load_scenario("clusters"), {"detector.model": "gone.onnx"}))


@pytest.mark.parametrize(
    "change",
    [
        {"camera.hfov_rad": 0.9},
        {"camera.rate_hz": 5},
        {"camera.latency_s": 0.5},
        {"detector.rate_hz": 10},
        {"camera.width_px": 3840, "camera.height_px": 2160},
        {"camera.width_px": 1280, "camera.height_px": 720, "detector.tiles": 2},
        {"camera.exposure_s": 0.01, "camera.noise_std": 1.0, "camera.jpeg_quality": 95},
    ],
)
def test_what_the_model_holds_for_is_not_refused(change):
    model_for(change_scenario(load_scenario("clusters"), change))


def test_targets_that_the_detector_never_reports_are_refused():
    with pytest.raises(UserError) as error:
        model_for(change_scenario(load_scenario("clusters"), {"camera.kind": "thermal"}))
    assert str(error.value) == (
        "targets: skysweep-thermal reports person, not stop sign, by the shipped sensor model; "
        "write targets that it reports, or another detector.model or camera.kind"
    )


def test_a_scenario_may_name_a_model_of_its_own_beside_it(tmp_path):
    own = StatisticalModel.load().model_copy(update={"fade_scale": 77.0})
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(own.model_dump()))
    text = (
        "detector: {statistical_model: mine.yaml}\narea: {polygon_enu_m: [[0, 0], [9, 0], [9, 9]]}\nname: a\n"
    )
    (tmp_path / "a.yaml").write_text(text)
    assert model_for(load_scenario(tmp_path / "a.yaml")).fade_scale == 77.0
    other = change_scenario(load_scenario(tmp_path / "a.yaml"), {"camera.noise_std": 9})
    with pytest.raises(
        UserError, match=r"mine\.yaml: was made for another .*noise_std is 9 grey levels .*, not 2"
    ):
        model_for(other)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("pixels: [5, 10]", "version"),
        ("{", "not YAML"),
        ("- 1", "is a list"),
        (f"{{version: {VERSION}, detector: 3}}", "detector"),
        ("version: 1", f"is of version 1, this package reads {VERSION}"),
    ],
    ids=["part", "yaml", "list", "type", "version"],
)
def test_a_broken_model_file_is_one_clear_sentence(tmp_path, text, field):
    path = tmp_path / "sensor.yaml"
    path.write_text(text)
    with pytest.raises(
        UserError, match=rf"sensor\.yaml: not a sensor model .*{field}.*'skysweep calibrate'$"
    ):
        StatisticalModel.load(path)


def test_a_missing_model_file_is_named(tmp_path):
    with pytest.raises(UserError, match=r"gone\.yaml"):
        StatisticalModel.load(tmp_path / "gone.yaml")


@pytest.mark.parametrize("table_of", ["per_hectare", "per_tree", "score_scale"])
def test_background_tables_must_fit_the_altitudes(table_of):
    with pytest.raises(ValueError, match=f"{table_of} must have 2 entries, as altitude_agl_m has"):
        background(**{table_of: [0.1]})


def test_tables_must_fit_the_grid():
    short = table().model_copy(update={"spread": [0.5]})
    with pytest.raises(ValueError, match="must have 4 entries"):
        StatisticalModel.model_validate(model(table()).model_dump() | {"kinds": [short.model_dump()]})


def test_what_the_edge_cuts_in_half_is_reported_where_it_shows_and_what_is_beyond_is_not():
    true, pixels = nadir(height_for(60.0)), 60.0
    metres = true.position_enu_m[2] / LENS.focal_px
    kinds = model(table(scores=(9.0,) * 4))
    for beyond_px, seen in ((0.2 * pixels, True), (0.3 * pixels, False), (0.6 * pixels, False)):
        found = looks([sign((LENS.width_px / 2 + beyond_px) * metres)], kinds, true, 20)
        assert sum(map(len, found)) == (20 if seen else 0)
        for detections in found if seen else ():
            left, _, right, _ = detections.boxes_xyxy_px[0]
            assert LENS.width_px - 0.5 * pixels < left < right <= LENS.width_px


def test_only_crowns_that_are_nearer_than_the_object_is_large_are_beside_it():
    for gap_m, beside in ((0.5, True), (2.0, False)):
        tree = WorldTree(np.array([2.5 + gap_m, 0.0, 0.0]), 8.0, 2.5, "broadleaf", 0)
        world = World(FLAT, (), (tree,), (), Light(), 0)
        assert Occluders(world).is_beside_a_crown(np.zeros(3), 0.9) is beside


def test_the_docs_say_of_every_factor_what_the_code_says():
    page = (Path(__file__).parents[2] / "docs" / "statistical-sensor.md").read_text()
    for factor in FACTORS:
        assert f"| `{factor.name}` | times: {factor.says}" in page


def test_a_wide_picture_from_low_altitude_is_drawn_as_one_of_half_the_size():
    """From 6 m 0.9 m span 140 pixels of the wide picture."""
    wide = CameraModel(width_px=1280, height_px=720, hfov_rad=1.2, latency_s=0.0)
    tables, things = model(table(scores=(0.0,) * 4)), [sign(1.0, 1.0)]
    above = nadir(6.0)
    small = looks(things, tables, above, 200)
    halved = looks(things, tables, above, 200, camera=wide, smallest_m=0.9)
    whole = looks(things, tables, above, 200, camera=wide)
    assert sum(map(len, small)) == sum(map(len, halved)) > 50
    for a, b in zip(small, halved, strict=True):
        np.testing.assert_allclose(2.0 * a.boxes_xyxy_px, b.boxes_xyxy_px, rtol=1e-9)
        np.testing.assert_array_equal(a.confidences, b.confidences)
    assert any(
        not np.allclose(a.boxes_xyxy_px, b.boxes_xyxy_px)
        for a, b in zip(whole, halved, strict=True)
        if len(a) == len(b) > 0
    )


TILED = CameraModel(width_px=1280, height_px=720, hfov_rad=1.2, latency_s=0.0)  # two tiles of 712 x 400


def tiled_looks(x_px, tables, n=LOOKS, rock_px=None, **options):
    """Passings of one look at a sign of 20 detector's pixels, at a column of the picture, by 2 x 2 tiles."""
    view = tables.view_of(TILED, DetectorModel(tiles=2))
    z = view.focal_px * 0.9 / 20.0
    things = [sign((x_px - 640.0) / TILED.lens.focal_px * z)]
    if rock_px is not None:
        things.append(sign((rock_px - 640.0) / TILED.lens.focal_px * z, kind="rock"))
    options = {"camera": TILED, "tiles": 2} | options
    there, away, near = (CameraPose(np.array([0.0, y, z]), LOOKS_NORTH) for y in (0.2 * z, 200.0, 0.201 * z))
    turns = itertools.cycle([there, away, near, away])
    return looks(things, tables, lambda: next(turns), 2 * n, **options)[::2]


LOOKS_NORTH = rotation_camera_to_enu(np.pi / 2, -np.pi / 2)


def test_a_thing_in_one_tile_is_looked_at_once():
    found = tiled_looks(300.0, model(table(scores=(0.0,) * 4)))
    assert_rate(sum(map(len, found)), LOOKS, chance(0.0))


def test_a_thing_whole_in_two_tiles_is_looked_at_twice_and_reported_once():
    found = tiled_looks(640.0, model(table(scores=(0.0,) * 4)))
    assert max(map(len, found)) == 1
    assert_rate(sum(map(len, found)), LOOKS, 1.0 - (1.0 - chance(0.0)) ** 2)


def test_what_two_tiles_share_of_its_luck_is_not_drawn_twice():
    alike = tiled_looks(640.0, model(table(scores=(0.0,) * 4, aspect_share=1.0, fade_rad=1e-6)))
    assert_rate(sum(map(len, alike)), LOOKS, chance(0.0))


def test_only_what_is_in_the_same_tile_is_company():
    tables = model(table(scores=(1.0,) * 4, company=-1.0), table("rock", scores=(-9.0,) * 4))
    for rock_px, mean in ((300.0, 1.0 - np.log(2)), (1100.0, 1.0)):
        assert_rate(sum(map(len, tiled_looks(200.0, tables, rock_px=rock_px))), LOOKS, chance(mean))


def test_a_thing_that_a_tile_cuts_may_be_reported_as_two():
    """Half of it lies beyond the first tile's edge at 712; the second tile holds all of it."""
    found = tiled_looks(712.0, model(table(scores=(4.0,) * 4)), 200, minimum=0.3)
    assert {len(d) for d in found} <= {1, 2}
    left, right = np.array([d.boxes_xyxy_px[:, 2] - d.boxes_xyxy_px[:, 0] for d in found if len(d) == 2]).T
    assert np.median(np.maximum(left, right) / np.minimum(left, right)) == pytest.approx(2.0, abs=0.3)
    one = tiled_looks(712.0, model(table(scores=(4.0,) * 4, cut=-40.0)), 200)
    assert {len(d) for d in one} == {1}


def test_boxes_are_in_the_pixels_of_the_camera():
    true = CameraPose(np.array([0.0, 0.0, 25.0]), LOOKS_NORTH)
    tables = model(table(scores=(4.0,) * 4))
    found = looks([sign(4.0, 3.0)], tables, true, 200, camera=TILED, tiles=2)
    boxes = np.concatenate([d.boxes_xyxy_px for d in found])
    place = project(TILED.lens, true, [[4.0, 3.0, 0.0]])[0][0]
    assert np.median((boxes[:, :2] + boxes[:, 2:]) / 2, axis=0) == pytest.approx(place, abs=0.3)
    assert np.median(boxes[:, 2] - boxes[:, 0]) == pytest.approx(TILED.lens.focal_px * 0.9 / 25.0, rel=0.05)


def test_what_is_out_of_view_changes_nothing_however_much_there_is():
    rng = np.random.default_rng(3)
    far = [sign(*(200.0 + 300.0 * rng.random(2))) for _ in range(500)]
    views = [nadir(20.0, 0.1 * k) for k in range(50)]

    def seen(objects):
        it = iter(views)
        found = looks(objects, model(table(aspect_share=0.5)), lambda: next(it), len(views))
        return [d.confidences.tolist() for d in found]

    assert seen([sign(2.0)]) == seen([sign(2.0), *far])


def test_the_ground_hides_what_lies_behind_a_hill():
    heights = np.zeros((101, 101))
    heights[:, 55] = 30.0  # at 10 m east
    ridge = TerrainSurface(heights, (-100, -100, 100, 100), "grass")
    eye = CameraPose(np.array([0.0, 0.0, 32.0]), rotation_camera_to_enu(0.0, -1.2))
    tables = model(table(scores=(3.0,) * 4))
    for x, found in ((5.0, 1.0), (18.0, 0.0)):
        hilly = looks([sign(x)], tables, eye, 50, surface=ridge)
        assert np.mean([len(d) for d in hilly]) == pytest.approx(found, abs=0.05)
        assert np.mean([len(d) for d in looks([sign(x)], tables, eye, 50)]) > 0.9


def test_each_object_counts_on_the_ground_below_it():
    tables, true = model(table(scores=(0.0,) * 4, grounds={"sand": -0.6})), nadir(height_for(30.0))
    cover = GroundCover(np.array([[0, 1]], dtype=np.uint8), (-200, -200, 200, 200), ("sand", "grass"))
    for x, shift in ((-3.0, -0.6), (3.0, 0.0)):
        found = looks([sign(x)], tables, true, surface=replace(FLAT, cover=cover))
        assert_rate(sum(map(len, found)), LOOKS, chance(shift))


def test_what_stands_among_trees_lapses_as_often_as_was_measured_there():
    tables = model(table(scores=(4.0,) * 4, lapse=0.0, lapse_among=0.3))
    high = nadir(height_for(60.0))
    tree = WorldTree(np.array([2.0, 0.0, 0.0]), 3.0, 1.4, "bush", 0)
    at_night = Light(sun_elevation_deg=-10.0)
    alone = looks([sign()], tables, high, light=at_night)
    beside = looks([sign()], tables, high, light=at_night, trees=[tree])
    assert sum(map(len, alone)) == LOOKS
    assert_rate(sum(map(len, beside)), LOOKS, 0.7)
    measured = StatisticalModel.load()
    assert all(k.lapse_among[4] > 1.5 * k.lapse[4] for k in measured.kinds if k.kind == k.reported_as)
