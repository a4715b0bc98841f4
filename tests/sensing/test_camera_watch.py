"""What the camera watch doubts and what it does not, in flights over a plain with a pattern."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.camera_watch import MEMORY_LOOKS, CameraWatch
from skysweep.types import Frame
from skysweep.worlds.obstacles import known_obstacles

LENS = Lens(320, 180, 1.2)
PERIOD_S = 0.4
PLAIN_ROOF = Path(__file__).parent / "data" / "plain-roof"
UP = np.array([0.0, 0.0, 1.0])


def flat(surface):
    area = {"polygon_enu_m": [[0, 0], [90, 0], [90, 90], [0, 90]]}
    fields = {"name": "flat", "area": area, "terrain": {"surface": surface}}
    return known_obstacles(Scenario.model_validate(fields))


FLAT = flat("grass")
M_PER_PX, HALF_M = 0.125, 128.0


def pattern(seed=0):
    """A ground from 128 m west and south to 128 m east and north, with detail of all sizes."""
    rng = np.random.default_rng(seed)
    side = int(2 * HALF_M / M_PER_PX)
    ground = np.full((side, side), 110.0, np.float32)
    for octave in range(7):
        rough = rng.normal(size=(side >> octave, side >> octave)).astype(np.float32)
        ground += 9.0 * cv2.resize(rough, (side, side), interpolation=cv2.INTER_CUBIC)
    return ground


GROUND = pattern()


def pose_at(x_m, y_m, z_m=30.0, heading_rad=0.0):
    """A camera that looks straight down, the top of its picture to the heading."""
    s, c = math.sin(heading_rad), math.cos(heading_rad)
    return CameraPose(np.array([x_m, y_m, z_m]), np.array([[c, -s, 0.0], [-s, -c, 0.0], [0.0, 0.0, -1.0]]))


def picture(pose, rng, ground=GROUND, noise=2.0):
    R, (x, y, z) = pose.R_camera_to_enu.T, pose.position_enu_m
    to_pixel = LENS.K @ np.column_stack([R[:, 0], R[:, 1], R @ np.array([-x, -y, -z])])
    to_metres = np.array([[M_PER_PX, 0.0, -HALF_M], [0.0, M_PER_PX, -HALF_M], [0.0, 0.0, 1.0]])
    seen = cv2.warpPerspective(ground, to_pixel @ to_metres, (LENS.width_px, LENS.height_px))
    noisy = seen + rng.normal(0.0, noise, seen.shape)
    return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def there_and_back(n=100, speed_mps=5.0):
    """Poses of a leg north, a stop, and a leg back."""
    v = np.concatenate([np.full(n // 2 - 5, 1.0), np.linspace(1, -1, 10), np.full(n - n // 2 - 5, -1.0)])
    y = -60.0 + np.cumsum(v) * speed_mps * PERIOD_S
    return [pose_at(3.0, y_m) for y_m in y.tolist()]


def doubts(believed, images, watch=None, tilts_rad=None):
    """What the watch says of each picture."""
    watch = watch or CameraWatch(FLAT)
    frames = [
        Frame(k * PERIOD_S, image, pose, LENS)
        for k, (pose, image) in enumerate(zip(believed, images, strict=True))
    ]
    tilts_rad = np.zeros(len(frames)) if tilts_rad is None else tilts_rad
    ups = np.column_stack([np.sin(tilts_rad), np.zeros(len(frames)), np.cos(tilts_rad)])
    return [watch.judge(frame, up) for frame, up in zip(frames, ups, strict=True)]


def pictures(poses, seed=1):
    rng = np.random.default_rng(seed)
    return [picture(pose, rng) for pose in poses]


@pytest.fixture(scope="module")
def whole():
    """Poses and pictures of a flight in which all is well."""
    poses = there_and_back()
    return poses, pictures(poses)


def first(found):
    """Index of the first doubt."""
    return next(k for k, doubt in enumerate(found) if doubt is not None)


def whys(found):
    return {doubt.why for doubt in found if doubt is not None}


def test_nothing_is_doubted_of_a_sound_camera(whole):
    assert doubts(*whole) == [None] * len(whole[0])


def test_a_thermal_camera_is_not_judged_by_motion_but_by_each_picture(whole):
    poses, images = whole
    upside_down = [image[::-1, ::-1] for image in images]
    assert any(doubts(poses, upside_down))
    assert not any(doubts(poses, upside_down, CameraWatch(FLAT, "thermal")))
    black = [np.zeros_like(image) for image in images]
    assert whys(doubts(poses, black, CameraWatch(FLAT, "thermal"))) == {"shows black"}


def test_what_gnss_and_gimbal_get_wrong_is_no_reason():
    """A slow error of 0.3 m, attitudes that are a degree off for a look or two."""
    poses = there_and_back()
    rng = np.random.default_rng(5)
    slow_m = np.cumsum(rng.normal(0.0, 0.03, (len(poses), 2)), axis=0)
    off_m = slow_m + 0.4 * rng.normal(size=slow_m.shape) * (np.arange(len(poses)) % 10 == 0)[:, None]
    believed = [pose_at(*(p.position_enu_m[:2] + e).tolist()) for p, e in zip(poses, off_m, strict=True)]
    assert whys(doubts(believed, pictures(poses))) == set()


def test_an_attitude_that_lags_and_is_right_again_is_no_reason():
    """In a hard manoeuvre, as from a scan into a check: away in two looks, back in one, twice."""
    poses = there_and_back()
    off_m = np.zeros(len(poses))
    off_m[[20, 21, 30, 31]] = 1.0, 2.0, 1.0, 2.0
    believed = [
        pose_at(p.position_enu_m[0] + e, p.position_enu_m[1]) for p, e in zip(poses, off_m, strict=True)
    ]
    assert whys(doubts(believed, pictures(poses))) == set()


def test_a_lag_up_high_is_no_reason_further_down():
    """The same angle is less on the ground there: a descent that begins in a hard manoeuvre."""
    down_m = np.concatenate([np.zeros(20), np.linspace(0.0, 16.0, 12), np.full(20, 16.0)])
    poses = [pose_at(3.0, -40.0 + 1.2 * k, 30.0 - d_m) for k, d_m in enumerate(down_m.tolist())]
    off_m = np.zeros(len(poses))
    off_m[20] = 4.8
    believed = [
        pose_at(p.position_enu_m[0] + e, *p.position_enu_m[1:]) for p, e in zip(poses, off_m, strict=True)
    ]
    assert whys(doubts(believed, pictures(poses))) == set()


def wood(height_m):
    trees = [
        {"position_enu_m": [x, y], "height_m": height_m, "crown_radius_m": 1.0}
        for x in range(0, 91, 10)
        for y in range(0, 91, 10)
    ]
    area = {"polygon_enu_m": [[0, 0], [90, 0], [90, 90], [0, 90]]}
    return known_obstacles(Scenario.model_validate({"name": "wood", "area": area, "trees": trees}))


def test_crowns_that_pass_faster_before_a_turn_are_no_reason():
    """On the way north trees fill the picture, on the way east the ground does."""
    steps = np.arange(8)
    poses = [pose_at(20.0, 20.0 + 2.0 * k) for k in steps.tolist()]
    poses += [pose_at(22.0 + 2.0 * k, 34.0) for k in steps.tolist()]
    tops_m = np.interp(np.arange(len(poses)), [6, 9], [12.0, 0.0])
    seen = [pose_at(*p.position_enu_m[:2], 30.0 - top_m) for p, top_m in zip(poses, tops_m, strict=True)]
    assert whys(doubts(poses, pictures(seen), CameraWatch(wood(12.0)))) == set()
    assert whys(doubts(poses, pictures(seen), CameraWatch(FLAT))) != set()


@pytest.mark.parametrize(("step_m", "doubted"), [(0.5, True), (3.0, False)])
def test_crowns_that_are_passed_within_a_look_are_not_compared(step_m, doubted):
    """They are so near that the next picture shows others."""
    poses = [pose_at(20.0 + step_m * (k % 2), 40.0, 8.0) for k in range(60)]
    elsewhere = [pose_at(*xy, 8.0) for xy in np.random.default_rng(2).uniform(-110, 110, (60, 2)).tolist()]
    assert any(doubts(poses, pictures(elsewhere), CameraWatch(wood(4.5)))) == doubted


@pytest.mark.parametrize(("obstacles", "doubted"), [(wood(4.5), False), (FLAT, True)])
def test_low_over_trees_one_comparison_is_no_reason(obstacles, doubted):
    poses = [pose_at(20.0 + 0.5 * k, 40.0, 8.0) for k in range(60)]
    images = pictures(poses[:30]) + pictures([pose_at(p.position_enu_m[0], -60.0, 8.0) for p in poses[30:]])
    assert any(doubts(poses, images, CameraWatch(obstacles))) == doubted


@pytest.mark.parametrize(("tilting", "doubted"), [((), True), ((29,), True), ((30,), False), ((31,), False)])
def test_in_a_hard_manoeuvre_one_comparison_is_no_reason(tilting, doubted):
    """From picture 31 on another place is shown; the vehicle tilts at a picture and stays tilted."""
    poses = [pose_at(20.0 + 0.5 * k, 40.0, 8.0) for k in range(60)]
    images = pictures(poses[:31]) + pictures([pose_at(p.position_enu_m[0], -60.0, 8.0) for p in poses[31:]])
    tilts_rad = np.array([0.4 * any(t <= k for t in tilting) for k in range(60)])
    assert any(doubts(poses, images, tilts_rad=tilts_rad)) == doubted


@pytest.mark.parametrize(
    ("surface", "tilt_rad", "doubted"), [("water", 0.4, False), ("water", 0.0, True), ("grass", 0.4, True)]
)
def test_one_jump_is_no_reason_over_waves_in_a_hard_manoeuvre(surface, tilt_rad, doubted):
    """In which they pass for one; the pictures from 30 on show what lies 7 m beside."""
    poses = [pose_at(20.0, -30.0 + k, 30.0) for k in range(60)]
    shown = [pose_at(20.0 + 7.0 * (k >= 30), -30.0 + k, 30.0) for k in range(60)]
    tilts_rad = np.array([tilt_rad * (k >= 30) for k in range(60)])
    assert any(doubts(poses, pictures(shown), CameraWatch(flat(surface)), tilts_rad)) == doubted


@pytest.mark.parametrize("ground", [0.0, 0.02])
def test_without_texture_nothing_is_told(ground):
    """As on open water in fog."""
    rng = np.random.default_rng(3)
    smooth = 110.0 + ground * (GROUND - 110.0)
    stuck = [picture(pose_at(0.0, 0.0), rng, smooth) for _ in range(40)]
    assert whys(doubts(there_and_back(40), stuck)) == set()


@pytest.mark.parametrize("jpeg_quality", [100, 90])
def test_noise_is_no_texture(jpeg_quality):
    """As over snow at dusk, where the camera turns up its gain."""
    rng = np.random.default_rng(3)
    poses = there_and_back(40)
    noisy = [picture(pose, rng, 0.02 * (GROUND - 110.0) + 110.0, noise=9.0) for pose in poses]
    packed = [cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])[1] for image in noisy]
    assert whys(doubts(poses, [cv2.imdecode(image, cv2.IMREAD_COLOR) for image in packed])) == set()


@pytest.mark.parametrize("noise", [2.0, 9.0])
def test_what_shows_nothing_does_not_count_as_sharp(whole, noise):
    """As where open water or snow ends."""
    poses, sound = whole
    rng = np.random.default_rng(3)
    smooth = [picture(pose, rng, np.full_like(GROUND, 110.0), noise) for pose in poses[:40]]
    assert whys(doubts(poses, [*smooth, *sound[40:]])) == set()


def test_texture_is_seen_under_noise(whole):
    """What noise does not hide is compared, and found false."""
    poses, _ = whole
    rng = np.random.default_rng(3)
    noisy = [picture(pose, rng, noise=9.0) for pose in poses]
    assert whys(doubts(poses, [*noisy[:40], *whole[1][40:]])) == set()
    found = doubts(poses, [*noisy[:20], *(image[::-1, ::-1] for image in noisy[20:])])
    assert first(found) == 20
    assert None not in found[20:]


def plain_stripe(left_m, right_m):
    """The ground with a stripe to the north that shows nothing: it stays in the same part of the picture."""
    ground = GROUND.copy()
    ground[:, int((HALF_M + left_m) / M_PER_PX) : int((HALF_M + right_m) / M_PER_PX)] = 110.0
    return ground


@pytest.mark.parametrize("noise", [0.5, 2.0, 9.0])
def test_a_road_is_no_dirt(noise):
    rng = np.random.default_rng(3)
    poses, road = there_and_back(40), plain_stripe(-2.0, 8.0)
    assert whys(doubts(poses, [picture(pose, rng, road, noise) for pose in poses])) == set()


@pytest.mark.parametrize("speed_mps", [1.5, 5.0])
def test_a_roof_or_a_field_that_fills_half_of_the_picture_is_neither_dirt_nor_out_of_focus(speed_mps):
    rng = np.random.default_rng(3)
    poses, field = there_and_back(60, speed_mps), plain_stripe(2.0, 40.0)
    sharp = [picture(pose, rng, field, noise=0.5) for pose in poses]
    assert whys(doubts(poses, sharp)) == set()
    blurred = [cv2.GaussianBlur(image, (0, 0), 4.0) for image in sharp[20:]]
    assert [d and d.why for d in doubts(poses, [*sharp[:20], *blurred])][20:] == ["is out of focus"] * 40


@pytest.mark.parametrize("ground", [np.full_like(GROUND, 110.0), GROUND])
def test_a_picture_of_noise_is_no_look(whole, ground):
    poses, sound = whole
    rng = np.random.default_rng(3)
    noisy = [picture(pose, rng, ground, noise=25.0) for pose in poses[20:30]]
    found = doubts(poses, [*sound[:20], *noisy, *sound[30:]])
    assert [d.why if d else None for d in found] == [None] * 20 + ["shows little but noise"] * 10 + [
        None
    ] * 70


@pytest.mark.parametrize(("level", "why"), [(3.0, "shows black"), (252.0, "shows white")])
@pytest.mark.parametrize("noise", [5.0, 15.0, 40.0])
def test_black_and_white_are_told_through_noise(level, why, noise):
    rng = np.random.default_rng(3)
    blind = picture(pose_at(0.0, 0.0), rng, np.full_like(GROUND, level), noise)
    assert whys(doubts([pose_at(0.0, 0.0)], [blind])) == {why}


@pytest.mark.parametrize(
    ("image", "why"),
    [
        (np.zeros((180, 320, 3), np.uint8), "shows black"),
        (np.full((180, 320, 3), 255, np.uint8), "shows white"),
    ],
)
def test_black_and_white_are_doubted_at_once_and_only_while_they_last(whole, image, why):
    poses, sound = whole
    found = doubts(poses, [*sound[:20], *[image] * 10, *sound[30:]])
    assert [d.why if d else None for d in found] == [None] * 20 + [why] * 10 + [None] * 70


def test_a_picture_that_comes_twice_is_no_look(whole):
    poses, sound = whole
    halved = [sound[k - k % 2] for k in range(len(sound))]
    found = doubts(poses, halved)
    assert all((d is not None) == (k % 2 == 1) for k, d in enumerate(found))
    assert whys(found) == {"shows the same picture again"}


def test_after_a_long_standstill_pictures_may_be_late(whole):
    """Until they are seen to follow a change of the velocity."""
    poses, sound = whole
    found = doubts(poses, [*sound[:10], *[sound[9]] * 10, *sound[20:]])
    assert found[20].why == "stood still and may be late now"
    assert found[40] is not None
    assert found[60:] == [None] * 40
    late = doubts(poses, [*sound[:10], *[sound[9]] * 10, *sound[15:-5]])
    assert None not in late[10:]


def test_a_short_standstill_is_over_when_the_ground_is_where_it_should_be(whole):
    poses, sound = whole
    found = doubts(poses, [*sound[:10], *[sound[9]] * 4, *sound[14:]])
    assert None not in found[10:14]
    assert found[14:] == [None] * 86


@pytest.mark.parametrize("looks", [5, 8])
def test_pictures_two_seconds_late_are_doubted_at_once_and_for_good(whole, looks):
    poses, sound = whole
    found = doubts(poses, [*sound[:20], *sound[20 - looks : -looks]])
    assert first(found) == 20
    assert None not in found[20:]


def test_upside_down(whole):
    poses, sound = whole
    found = doubts(poses, [*sound[:20], *(image[::-1, ::-1] for image in sound[20:])])
    assert first(found) == 20
    assert None not in found[20:]


def test_another_cameras_pictures(whole):
    poses, sound = whole
    other = pictures([pose_at(-40.0 + 1.2 * k, 50.0) for k in range(80)])
    found = doubts(poses, [*sound[:20], *other])
    assert first(found) == 20
    assert None not in found[20:]


def sees(found, since, looks=12):
    """The first doubt, which names two velocities and came soon."""
    k = first(found)
    assert since < k <= since + looks
    assert found[k].since_s <= k * PERIOD_S
    assert "sees the ground pass at" in found[k].why
    assert None not in found[k:]
    return found[k].why


def test_twenty_metres_too_low():
    believed = there_and_back()
    true = [pose_at(*p.position_enu_m[:2], 10.0) for p in believed]
    assert "at 14.8 m/s to 0 degrees, not at 5.0 m/s to 0 degrees" in sees(
        doubts(believed, pictures(true)), 0
    )


def test_a_drifting_position():
    believed = there_and_back()
    true = [
        pose_at(p.position_enu_m[0] + 0.5 * PERIOD_S * max(0, k - 20), p.position_enu_m[1])
        for k, p in enumerate(believed)
    ]
    sees(doubts(believed, pictures(true)), 20, looks=20)


def test_a_compass_that_is_15_degrees_off():
    believed = there_and_back()
    true = [pose_at(*p.position_enu_m[:2], heading_rad=math.radians(15.0)) for p in believed]
    sees(doubts(believed, pictures(true)), 0)


@pytest.mark.parametrize("off_deg", [-6.0, 6.0])
def test_a_compass_that_is_6_degrees_off_is_never_trusted_in_between(off_deg):
    """Turning back slowly, the ground passes nearly as believed."""
    believed = 2 * there_and_back()
    true = [pose_at(*p.position_enu_m[:2], heading_rad=math.radians(off_deg)) for p in believed]
    sees(doubts(believed, pictures(true)), 0, looks=25)


def test_a_compass_that_is_right_again_is_trusted_again():
    believed = 2 * there_and_back()
    off_rad = math.radians(10.0)
    true = [pose_at(*p.position_enu_m[:2], heading_rad=off_rad * (k < 30)) for k, p in enumerate(believed)]
    found = doubts(believed, pictures(true))
    assert 0 < first(found) <= 25
    assert None not in found[first(found) : 40]
    assert found[120:] == [None] * 80


def soiled(images, seed=4):
    """What a camera shows with a grey blot on its lens."""
    ys, xs = np.mgrid[:180, :320]
    clear = np.clip((np.hypot(xs - 110, ys - 70) - 45) / 15, 0, 1)[..., None]
    rng = np.random.default_rng(seed)
    return [
        np.clip(clear * image + (1 - clear) * (60 + rng.normal(0, 2, image.shape)), 0, 255).astype(np.uint8)
        for image in images
    ]


def test_dirt_on_the_lens(whole):
    poses, sound = whole
    found = doubts(poses, [*sound[:20], *soiled(sound[20:])])
    assert 20 < first(found) <= 32
    assert found[first(found)].since_s <= 21 * PERIOD_S
    assert found[first(found)].why.startswith("has something on its lens")
    assert None not in found[first(found) :]


def test_a_part_that_goes_blank_stays_doubted_though_nothing_new_comes_below_it(whole):
    poses, sound = whole
    dead = [image.copy() for image in sound[20:]]
    for image in dead:
        image[:, :80] = 60
    found = doubts(poses, [*sound[:20], *dead])
    assert first(found) <= 32
    assert None not in found[first(found) :]
    again = doubts(poses, [*sound[:20], *dead[:20], *sound[40:]])
    assert again[60:] == [None] * 40


def test_a_plain_roof_that_grows_while_the_vehicle_descends_is_no_dirt():
    """Pictures of a flight in `valley`: it covers texture faster than the ground below comes nearer."""
    valley, watch = load_scenario("valley"), CameraWatch(known_obstacles(load_scenario("valley")))
    poses = json.loads((PLAIN_ROOF / "poses.json").read_text())
    assert len(poses) == 12
    for pose in poses:
        image = cv2.imread(str(PLAIN_ROOF / f"{pose['time_s']}.jpg"))
        lens = Lens(image.shape[1], image.shape[0], valley.camera.hfov_rad)
        camera = CameraPose(np.array(pose["position_enu_m"]), np.array(pose["R_camera_to_enu"]).reshape(3, 3))
        assert watch.judge(Frame(pose["time_s"], image, camera, lens), UP) is None


def test_a_border_between_fields_is_not_out_of_focus():
    """It alone shows detail, after ground full of it."""
    poses, ground, rng = there_and_back(80), GROUND.copy(), np.random.default_rng(3)
    row = int(HALF_M / M_PER_PX)
    ground[row - 320 : row + 160] = 110.0
    ground[row - 80 : row + 160] = 150.0
    assert whys(doubts(poses, [picture(pose, rng, ground, noise=0.5) for pose in poses])) == set()


def test_dirt_shows_where_the_ground_has_texture():
    """Beside a field that shows nothing; and while the vehicle flies slowly."""
    rng = np.random.default_rng(3)
    poses, field = there_and_back(80, speed_mps=2.0), plain_stripe(3.0, 40.0)
    found = doubts(poses, soiled([picture(pose, rng, field) for pose in poses]))
    assert first(found) <= 15
    assert found[first(found)].why.startswith("has something on its lens")


def test_out_of_focus(whole):
    poses, sound = whole
    rng = np.random.default_rng(4)
    blurred = [
        np.clip(cv2.GaussianBlur(image, (0, 0), 4.0) + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
        for image in sound[20:40]
    ]
    found = doubts(poses, [*sound[:20], *blurred, *sound[40:]])
    assert [d.why if d else None for d in found] == [None] * 20 + ["is out of focus"] * 20 + [None] * 60


def upside_down_for_a_while(poses, sound):
    return [*sound[:60], *(image[::-1, ::-1] for image in sound[60:75]), *sound[75:]]


def turned_for_a_while(poses, sound):
    turned = pictures([pose_at(*p.position_enu_m[:2], heading_rad=0.2) for p in poses[60:80]])
    return [*sound[:60], *turned, *sound[80:]]


@pytest.mark.parametrize("goes_wrong", [upside_down_for_a_while, turned_for_a_while])
def test_what_was_long_ago_makes_no_difference(whole, goes_wrong):
    """So that a mission that goes on has to see the last pictures only."""
    poses, sound = whole
    images = goes_wrong(poses, sound)
    found = doubts(poses, images)
    begun = first(found) - MEMORY_LOOKS
    again = [CameraWatch(FLAT)]
    later = [
        again[0].judge(Frame(k * PERIOD_S, images[k], poses[k], LENS), UP) for k in range(begun, len(images))
    ]
    assert later == found[begun:]
