"""The sensor without pictures draws what its tables say, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstest, norm

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.scenarios.model import Light
from skysweep.scenarios.world import TerrainSurface, World, WorldObject, WorldTree
from skysweep.sensing.schedule import Exposures
from skysweep.sensing.statistical import BackgroundModel, KindModel, StatisticalModel, StatisticalSensor
from skysweep.types import VehicleState

LENS = Lens(640, 360, 1.2)
FLAT = TerrainSurface(np.zeros((2, 2)), (-200, -200, 200, 200), "grass")
GRID = [5.0, 10.0, 20.0, 200.0]
LOOKS = 4000


def table(kind="stop sign", reported_as="stop sign", pose="face-up", offset=0.0, p=(0.0, 0.3, 0.9, 0.9)):
    return KindModel(
        kind=kind,
        pose=pose,
        reported_as=reported_as,
        probability=list(p),
        confidence_logit_mean=[2.0] * 4,
        confidence_logit_std=[0.5] * 4,
        object_logit_std=offset,
    )


def model(*kinds, background=()):
    return StatisticalModel(
        detector="test",
        pictures=1,
        seed=0,
        pixels=GRID,
        kinds=list(kinds),
        background=list(background),
        centre_std_fraction=0.04,
        centre_std_px=0.5,
    )


def sign(x=0.0, y=0.0, kind="stop sign", size=0.9):
    return WorldObject(kind, np.array([x, y, 0.0]), 0.0, size, "face-up", kind == "stop sign", 1000)


def nadir(z, x=0.0, y=0.0):
    return CameraPose(np.array([x, y, z]), rotation_camera_to_enu(np.pi / 2, -np.pi / 2))


def state(t, camera):
    return VehicleState(t, camera.position_enu_m, np.zeros(3), np.eye(3), camera, 1.0, 0.0, True)


def height_for(pixels, size=0.9):
    return float(LENS.focal_px * size / pixels)


def sensor_of(
    objects, tables, true, *, seed=0, trees=(), classes=("stop sign",), latency_s=0.0, minimum=0.05
):
    world = World(FLAT, tuple(objects), tuple(trees), (), Light(), 0)
    return StatisticalSensor(
        world, LENS, lambda: true, Exposures(10.0, 0.0), latency_s, classes, minimum, seed, tables
    )


def looks(objects, tables, true, n=LOOKS, believed=None, **options):
    sensor = sensor_of(objects, tables, true, **options)
    return [sensor.sense(state(0.1 * k, believed or true)) for k in range(n)]


def assert_rate(found, n, probability):
    low, high = binom.ppf([1e-5, 1 - 1e-5], n, probability)
    assert low <= found <= high


@pytest.mark.parametrize(
    ("pixels", "probability"),
    [(10.0, 0.3), (np.sqrt(50.0), 0.15), (np.sqrt(200.0), 0.6), (60.0, 0.9), (3.0, 0.0)],
)
def test_detections_are_as_frequent_as_the_table_says(pixels, probability):
    found = looks([sign()], model(table()), nadir(height_for(pixels)))
    assert_rate(sum(map(len, found)), LOOKS, probability)


def test_confidences_follow_the_table():
    found = looks([sign()], model(table()), nadir(height_for(60.0)))
    logits = np.concatenate([np.log(d.confidences / (1 - d.confidences)) for d in found])
    assert kstest(logits, norm(2.0, 0.5).cdf).pvalue > 1e-3


def test_confidences_below_the_minimum_are_not_reported():
    found = looks([sign()], model(table()), nadir(height_for(60.0)), minimum=0.9)
    confidences = np.concatenate([d.confidences for d in found])
    assert confidences.min() >= 0.9
    assert_rate(len(confidences), LOOKS, 0.9 * norm.sf((np.log(9.0) - 2.0) / 0.5))


def test_some_objects_are_seen_better_than_others_in_every_look():
    signs = [sign(x, y) for x in range(-12, 13, 4) for y in range(-6, 7, 4)]
    true = nadir(height_for(12.0))
    counts = np.zeros((2, len(signs)))
    for row, offset in enumerate((0.0, 1.5)):
        tables = model(table(p=(0.5,) * 4, offset=offset))
        for detections in looks(signs, tables, true, n=400):
            middles = (detections.boxes_xyxy_px[:, :2] + detections.boxes_xyxy_px[:, 2:]) / 2
            places, _ = project(LENS, true, [s.position_enu_m for s in signs])
            gaps = np.linalg.norm(middles[:, None] - places, axis=2)
            np.add.at(counts[row], gaps.argmin(axis=1), 1)
    same, different = counts.var(axis=1) / (400 * 0.25)
    assert same < 2.0
    assert different > 20.0


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
        world = World(FLAT, (sign(),), (), (), Light(), 0)
        now = iter(views)
        sensor = StatisticalSensor(
            world, LENS, lambda: next(now), Exposures(10.0, 0.0), 0.0, ("stop sign",), 0.05, 0, model(table())
        )
        return [sensor.sense(state(0.1 * k, view)).confidences.tolist() for k, view in enumerate(views)][100:]

    assert late_looks(near) == late_looks(away)


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


def test_what_the_edge_cuts_off_is_seen_less():
    true = nadir(height_for(20.0))
    edge_x = (320.0 - 3.0) / LENS.focal_px * true.position_enu_m[2]
    whole = sum(map(len, looks([sign()], model(table()), true, 1000)))
    cut = sum(map(len, looks([sign(edge_x)], model(table()), true, 1000)))
    assert 0 < cut < 0.95 * whole


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
    sensor = sensor_of([sign()], model(table()), nadir(30.0), latency_s=0.25)
    results = [sensor.sense(state(0.1 * k, nadir(30.0))) for k in range(10)]
    assert results[:3] == [None, None, None]
    for k in range(3, 10):
        assert results[k].time_s == pytest.approx(0.1 * (k - 3))


def test_other_classes_are_not_looked_for():
    tables = model(table(), table("rock", "person"))
    found = looks([sign(), sign(3, 0, kind="rock")], tables, nadir(20.0), 300, classes=("person",))
    assert {n for d in found for n in d.class_names} == {"person"}


def test_poses_have_their_own_tables_and_others_fall_back():
    tables = model(table(), table(pose="standing", p=(0.0,) * 4))
    upright = replace(sign(), pose="standing")
    afloat = replace(sign(), pose="floating", size_m=2.25)
    assert sum(map(len, looks([upright], tables, nadir(20.0), 300))) == 0
    assert sum(map(len, looks([afloat], tables, nadir(20.0), 300))) > 100


def test_background_detections_come_at_their_rate():
    background = BackgroundModel(
        reported_as="stop sign",
        altitude_agl_m=[10.0, 30.0],
        rate_per_picture=[0.0, 0.2],
        confidence_logit_mean=1.0,
        confidence_logit_std=0.3,
        pixels=12.0,
    )
    tables = model(table(), background=[background])
    assert sum(map(len, looks([], tables, nadir(8.0), 500))) == 0
    assert_rate(sum(map(len, looks([], tables, nadir(20.0)))), LOOKS, 0.1)


def test_the_shipped_model_sees_signs_from_near_and_not_from_very_far():
    near = looks([sign()], None, nadir(height_for(100.0)), 200, minimum=0.25)
    far = looks([sign()], None, nadir(height_for(3.0)), 200, minimum=0.25)
    assert sum(map(len, near)) > 180
    assert sum(d.confidences.size for d in far) < 20


@pytest.mark.parametrize(
    ("text", "field"),
    [("pixels: [5, 10]", "detector"), ("{", "flow node"), ("- 1", "dictionary"), ("detector: 3", "detector")],
    ids=["part", "yaml", "list", "type"],
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


def test_tables_must_fit_the_grid():
    short = table().model_copy(update={"probability": [0.5]})
    with pytest.raises(ValueError, match="must have 4 entries"):
        StatisticalModel.model_validate(model(table()).model_dump() | {"kinds": [short.model_dump()]})
