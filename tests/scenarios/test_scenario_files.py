"""Scenario files: what is shipped, what round trips, and what every bad file is told."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

import skysweep
from skysweep.errors import UserError
from skysweep.experiments.benchmark.suite import load_suite
from skysweep.files.plain_yaml import MAX_YAML_BYTES
from skysweep.geometry.camera import Lens
from skysweep.scenarios.files import (
    change_scenario,
    dump_scenario,
    json_schema,
    list_scenarios,
    load_scenario,
    parse_scenario,
    write_scenario,
)
from skysweep.scenarios.model import Distractor, Scenario, Search
from skysweep.worlds.world import build_world

PAPER = ("clusters", "abundance", "sparse")
MINIMAL = "name: mine\narea: {polygon_enu_m: [[0, 0], [50, 0], [50, 50], [0, 50]]}\n"
MOVING = MINIMAL.replace("{", "{{").replace("}", "}}") + (
    "targets: [{{class: person, position_enu_m: [1, 1], motion: {}}}]"
)


def error_of(text: str) -> str:
    with pytest.raises(UserError) as caught:
        parse_scenario(text, "mine.yaml")
    message = str(caught.value)
    assert message.startswith("mine.yaml: ")
    assert "\n" not in message
    return message


def test_the_wished_scenarios_are_shipped():
    assert {*PAPER, "person-wilderness", "maritime", "buildings"} <= set(list_scenarios())


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_scenario_loads_by_its_name_and_builds_a_world(name):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.description
    world = build_world(scenario, seed=0)
    assert len(world.targets) >= 4
    assert any(not o.is_target for o in world.objects), "nothing there to be fooled by"


@pytest.mark.parametrize(
    "name", sorted({*list_scenarios()} - {"valley", "coast", "night"})
)  # of other cameras
def test_shipped_scenario_leaves_the_detector_unsure_at_scan_and_sure_at_check(name):
    scenario = load_scenario(name)
    assert 9 <= scenario.pixels_on_target(scenario.search.scan_altitude_agl_m) <= 16  # see the model card
    assert scenario.pixels_on_target(scenario.search.check_altitude_agl_m) >= 35


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_scenario_round_trips(name):
    scenario = load_scenario(name)
    assert parse_scenario(dump_scenario(scenario), "dump") == scenario


@pytest.mark.parametrize("name", ["valley", "coast"])
def test_a_4k_camera_leaves_no_doubt_of_pixels(name):
    scenario = load_scenario(name)
    assert scenario.pixels_on_target(scenario.search.scan_altitude_agl_m) >= 18
    assert scenario.pixels_on_target(scenario.search.check_altitude_agl_m) >= 50


@pytest.mark.parametrize(
    ("targets", "extent_m"),
    [
        ("[{class: person, position_enu_m: [1, 1], size_m: 1.5}]", 1.5),
        ("[{class: person, position_enu_m: [1, 1], pose: sitting, size_m: 1.8}]", 0.99),
        ("[{class: person, position_enu_m: [1, 1], pose: crouching, size_m: 1.8}]", 0.756),
        (
            "[{class: person, position_enu_m: [1, 1], pose: standing, size_m: 1.8}, "
            "{class: person, position_enu_m: [2, 2], pose: lying, size_m: 0.5}]",
            0.5,
        ),
        (
            "[]\ngenerators: [{class: person, pattern: uniform, count: 3, poses: [lying, floating], "
            "ages: [child, adult]}]",
            0.48,
        ),
    ],
)
def test_the_smallest_target_spans_what_its_pose_shows_from_above(targets, extent_m):
    scenario = parse_scenario(f"{MINIMAL}targets: {targets}\n", "poses.yaml")
    assert scenario.smallest_extent_m == pytest.approx(extent_m)
    lens = scenario.camera.lens
    assert scenario.pixels_on_target(20.0) == pytest.approx(float(lens.pixels_on_target(extent_m, 20.0)))


def test_only_a_person_is_dressed():
    targets = "[{class: boat, position_enu_m: [1, 1], clothing: red}]"
    with pytest.raises(UserError, match=r"clothing: only a person has one; delete it from the boat"):
        parse_scenario(f"{MINIMAL}targets: {targets}\n", "boat.yaml")


def test_paper_scenarios_differ_in_what_is_out_there_only():
    layout = {"name", "description", "targets", "distractors", "generators"}
    first, *others = [load_scenario(name).model_dump(exclude=layout) for name in PAPER]
    assert all(other == first for other in others)


def test_dump_writes_infinity_and_aliased_names_as_a_person_would():
    text = dump_scenario(load_scenario("sparse"))
    assert "d_c_m: .inf" in text
    assert "class: stop sign" in text
    assert "&" not in text


def test_write_scenario_leaves_nothing_half_written(tmp_path, monkeypatch):
    scenario = load_scenario("sparse")
    path = write_scenario(scenario, tmp_path / "mine.yaml")
    assert load_scenario(path) == scenario

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(UserError, match="No space left"):
        write_scenario(load_scenario("clusters"), path)
    assert load_scenario(path) == scenario
    assert list(tmp_path.iterdir()) == [path]


def test_write_scenario_into_a_missing_folder_names_it(tmp_path):
    with pytest.raises(UserError, match="cannot be written"):
        write_scenario(load_scenario("sparse"), tmp_path / "nowhere" / "mine.yaml")


def test_plan_and_model_paths_count_from_the_scenario_file(tmp_path, monkeypatch):
    path = tmp_path / "mine.yaml"
    path.write_text(MINIMAL + "search: {plan: area.plan}\ndetector: {model: best.onnx}\n")
    scenario = load_scenario(path)
    assert scenario.search.plan == str(tmp_path / "area.plan")
    assert scenario.detector.model == str(tmp_path / "best.onnx")
    monkeypatch.chdir(tmp_path)
    assert load_scenario("mine.yaml") == scenario


def test_search_can_be_changed_with_the_same_care():
    scenario = load_scenario("sparse")
    assert change_scenario(scenario, {"search.n_c": math.inf, "search.c_t": None}).search.n_c == math.inf
    with pytest.raises(UserError, match=r"sparse: search\.check_altitude_agl_m: is 50; write less than"):
        change_scenario(scenario, {"search.check_altitude_agl_m": 50})


def test_json_schema_is_strict_json_and_names_every_field():
    schema = json.loads(json.dumps(json_schema(), allow_nan=False))
    assert set(schema["properties"]) == set(Scenario.model_fields)
    assert "class" in schema["$defs"]["Target"]["properties"]
    assert schema["$defs"]["Search"]["properties"]["d_c_m"]["default"] == ".inf"


# --- what a bad field is told ---------------------------------------------------------------------------

BAD_FIELDS = {
    "self-intersecting area": (
        "name: a\narea: {polygon_enu_m: [[0, 0], [9, 9], [9, 0], [0, 9]]}",
        "area: the polygon is not simple (Self-intersection",
    ),
    "no corners": ("name: a\narea: {polygon_enu_m: []}", "area: write at least 3 corners"),
    "empty area": ("name: a\narea: {polygon_enu_m: [[0, 0], [5, 5], [9, 9]]}", "area: the polygon is empty"),
    "hole swallows area": (
        "name: a\narea: {polygon_enu_m: [[0, 0], [9, 0], [9, 9], [0, 9]], "
        "holes_enu_m: [[[0.01, 0.01], [8.99, 0.01], [8.99, 8.99], [0.01, 8.99]]]}",
        "area: the holes leave nothing to search",
    ),
    "hole without area": (
        "name: a\narea: {polygon_enu_m: [[0, 0], [9, 0], [9, 9]], holes_enu_m: [[[1, 1], [2, 2]]]}",
        "area: a hole has less than 3 corners",
    ),
    "enormous area": (
        "name: a\narea: {polygon_enu_m: [[0, 0], [1.0e+5, 0], [1.0e+5, 1.0e+5]]}",
        "area: 5000 km2 is more than one vehicle can search (25 km2)",
    ),
    "area in no unit": (
        "name: a\narea: {}",
        "write exactly one of polygon_enu_m, polygon_lat_lon_deg and file",
    ),
    "latitude and longitude swapped": (
        "name: a\narea: {polygon_lat_lon_deg: [[122.3, 37.1], [122.31, 37.1], [122.3, 37.2]]}",
        "area.polygon_lat_lon_deg[0][0]: is 122.3; write a number less than or equal to 90",
    ),
    "home elsewhere": (
        "name: a\narea: {polygon_lat_lon_deg: [[37.1, 122.3], [37.1, 122.31], [37.11, 122.31]]}",
        "km from the area; write home's latitude_deg, longitude_deg",
    ),
    "home outside fence": (
        MINIMAL + "geofence_enu_m: [[-1, -1], [51, -1], [51, 51], [-1, 51]]\nhome: {position_enu_m: [-9, 0]}",
        "home.position_enu_m: lies outside geofence_enu_m; move home or widen the fence",
    ),
    "area outside fence": (
        MINIMAL + "geofence_enu_m: [[-1, -1], [41, -1], [41, 51], [-1, 51]]",
        "geofence_enu_m: the search area reaches outside the fence",
    ),
    "NaN": (MINIMAL + "wind: {mean_speed_mps: .nan}", "wind.mean_speed_mps: is nan; write a"),
    "NaN corner": ("name: a\narea: {polygon_enu_m: [[0, 0], [9, .nan], [9, 9]]}", "area.polygon_enu_m[1][1]"),
    "NaN n_c": (MINIMAL + "search: {n_c: .nan}", "search.n_c: is nan; write a number greater than 0"),
    "infinity where none belongs": (
        MINIMAL + "vehicle: {cruise_speed_mps: .inf}",
        "vehicle.cruise_speed_mps: is inf; write a",
    ),
    "h_C above h_S": (
        MINIMAL + "search: {check_altitude_agl_m: 40}",
        "search.check_altitude_agl_m: is 40; write less than scan_altitude_agl_m (30)",
    ),
    "h_C equal to h_S": (
        MINIMAL + "search: {check_altitude_agl_m: 30, scan_altitude_agl_m: 30}",
        "search.check_altitude_agl_m: is 30; write less than scan_altitude_agl_m (30)",
    ),
    "unknown class": (
        MINIMAL + "targets: [{class: stop sgn, position_enu_m: [1, 2]}]",
        "targets[0].class: 'stop sgn' is not known; did you mean 'stop sign'? write one of stop sign, person",
    ),
    "unknown class of a union": (
        MINIMAL + "generators: [{class: cat, pattern: uniform, count: 3}]",
        "generators[0].class: 'cat' is not known; write one of stop sign, person, boat, red bucket",
    ),
    "unknown field": (MINIMAL + "serach: {}", "serach: there is no such field; did you mean 'search'?"),
    "unknown inner field": (
        MINIMAL + "camera: {gimbal: {max_rate: 3}}",
        "camera.gimbal.max_rate: there is no such field; did you mean 'max_rate_dps'?",
    ),
    "field of list item": (
        MINIMAL + "targets: [{kind_of: 3, class: person, position_enu_m: [1, 2]}]",
        "targets[0].kind_of: there is no such field; write one of class, position_enu_m",
    ),
    "missing area": ("name: a", "area: is missing; add it with fields such as polygon_enu_m"),
    "missing position": (
        MINIMAL + "targets: [{class: person}]",
        "targets[0].position_enu_m: is missing; add",
    ),
    "one coordinate": (
        MINIMAL + "targets: [{class: person, position_enu_m: [1]}]",
        "targets[0].position_enu_m: is too short; write two numbers",
    ),
    "three coordinates": (
        MINIMAL + "targets: [{class: person, position_enu_m: [1, 2, 3]}]",
        "targets[0].position_enu_m: has 3 values; write 2",
    ),
    "empty section": (MINIMAL + "search:", "search: is empty; write its fields indented below it"),
    "word for number": (
        MINIMAL + "wind: {mean_speed_mps: fast}",
        "wind.mean_speed_mps: is 'fast'; write a valid number",
    ),
    "mapping for list": (
        MINIMAL + "targets: {class: person}",
        "targets: is {'class': 'person'}; write a valid list",
    ),
    "word for a list of words": (
        MINIMAL + "generators: [{class: person, pattern: uniform, count: 3, clothing: pink}]",
        "generators[0].clothing: is 'pink'; write a list such as [bright], of bright, muted, black, blue, br",
    ),
    "unknown motion": (
        MOVING.format("{kind: walks}"),
        "targets[0].motion.kind: 'walks' is not known; did you mean 'walk'? write one of path, walk, drift",
    ),
    "motion of no kind": (
        MOVING.format("{speed_mps: 1}"),
        "targets[0].motion.kind: is missing; write one of path, walk, drift",
    ),
    "motion as a word": (
        MOVING.format("walk"),
        "targets[0].motion: is 'walk'; write kind (path, walk, drift) and its fields indented below it",
    ),
    "missing field of a motion": (
        MOVING.format("{kind: path}"),
        "targets[0].motion.waypoints_enu_m: is missing; add  waypoints_enu_m: ...",
    ),
    "unknown field of a motion": (
        MOVING.format("{kind: walk, sped_mps: 3}"),
        "targets[0].motion.sped_mps: there is no such field; did you mean 'speed_mps'?",
    ),
    "a path's point without brackets": (
        MOVING.format("{kind: path, waypoints_enu_m: [20, 30]}"),
        "targets[0].motion.waypoints_enu_m[0]: is 20; write a list of numbers, such as [12.5, 40]",
    ),
    "ragged heightmap": (
        MINIMAL + "terrain: {heightmap_m: [[1, 2], [3]]}",
        "terrain.heightmap_m: write at least 2 rows",
    ),
    "cluster elsewhere": (
        MINIMAL + "generators: [{class: person, pattern: clustered, count: 3, centres_enu_m: [[900, 3]]}]",
        "generators[0].centres_enu_m: [900, 3] lies outside the area; write centres inside it",
    ),
    "jungle": (
        "name: a\narea: {polygon_enu_m: [[0, 0], [4000, 0], [4000, 4000]]}\n"
        "forests: [{trees_per_hectare: 900}]",
        "forests[0].trees_per_hectare: makes 1527696 trees with all before it, more than can be drawn",
    ),
    "trees upside down": (
        MINIMAL + "forests: [{trees_per_hectare: 9, height_m: [9, 3]}]",
        "forests[0].height_m: is [9, 3]; write the smallest, then the largest",
    ),
    "forest without area": (
        MINIMAL + "forests: [{trees_per_hectare: 9, polygon_enu_m: [[0, 0], [3, 3]]}]",
        "forests[0].polygon_enu_m: write at least 3 corners",
    ),
    "flat house": (
        MINIMAL + "buildings: [{position_enu_m: [5, 5], size_m: [10, 0]}]",
        "buildings[0].size_m[1]: is 0; write a number greater than 0",
    ),
    "many forests": (
        MINIMAL + "forests: [" + "{trees_per_hectare: 2000}, " * 30 + "]",
        "forests[8].trees_per_hectare: makes 52020 trees with all before it, more than can be drawn (50000)",
    ),
    "many objects": (
        MINIMAL + "generators: [" + "{class: person, pattern: uniform, count: 2000}, " * 3 + "]",
        "generators: make 6000 objects with targets and distractors; write at most 5000 in all",
    ),
    "many houses": (
        MINIMAL + "buildings: [" + "{position_enu_m: [5, 5]}, " * 5001 + "]",
        "buildings: has 5001 values; write at most 5000",
    ),
    "many corners": (
        "name: a\narea: {polygon_enu_m: [" + "[0, 0], " * 10_001 + "]}",
        "area: has 10,001 corners; simplify it to 10,000 or fewer",
    ),
    "many corners not to fly over": (
        MINIMAL + "safety: {no_fly_enu_m: [[" + "[0, 0], " * 1001 + "]]}",
        "safety.no_fly_enu_m: has 1,001 corners, too many to find ways round; simplify it to 1,000 or fewer",
    ),
    "a picture in years": (
        MINIMAL + "camera: {rate_hz: 1.0e-300}",
        "camera.rate_hz: is 1e-300; write a number greater than or equal to 0.1",
    ),
    "many pictures under way": (
        MINIMAL + "camera: {width_px: 4000, height_px: 3000, latency_s: 5}\ndetector: {rate_hz: 10}",
        "camera.latency_s: 50 pictures wait for their answers, more than fit in memory",
    ),
    "a battery for months": (
        MINIMAL + "vehicle: {battery_wh: 5000, hover_power_w: 2}",
        "vehicle.battery_wh: 5000 Wh hover for 2500 h at hover_power_w (2 W); write less than lasts 48 h",
    ),
    "standing still": (
        MINIMAL + "search: {scan_speed_mps: 1.0e-300}",
        "search.scan_speed_mps: is 1e-300; write a number greater than or equal to 0.1",
    ),
    "a pose of persons": (
        MINIMAL + "targets: [{class: boat, position_enu_m: [1, 1], pose: sitting}]",
        "pose: sitting is of a person only; delete it from the boat",
    ),
    "centres of no clusters": (
        MINIMAL + "generators: [{class: person, pattern: uniform, count: 1, centres_enu_m: [[1, 1]]}]",
        "centres_enu_m: pattern uniform has none; write pattern: clustered",
    ),
    "checks below the lowest height": (
        MINIMAL + "safety: {altitude_min_agl_m: 7}",
        "search.check_altitude_agl_m: is 4; write at least safety.altitude_min_agl_m (7), or lower that",
    ),
    "a scan as high as the ceiling": (
        MINIMAL + "safety: {altitude_max_agl_m: 30, fence_tolerance_m: 0}",
        "search.scan_altitude_agl_m: is 30; write at most 29.2, or raise safety.altitude_max_agl_m or",
    ),
    "landing where the way home is not over": (
        MINIMAL + "safety: {battery_critical: 0.25, battery_low: 0.3}",
        "battery_critical: is 0.25; write at most landing_reserve (0.1), or raise that",
    ),
    "name with a slash": (
        "name: ../../x\n" + MINIMAL.split("\n", 1)[1],
        "name: '../../x' is not allowed; write letters",
    ),
    "several": (
        MINIMAL + "wind: {mean_speed_mps: 99}\nlight: {visibility_m: 1}\nsearch: {c_t: 2}",
        "wind.mean_speed_mps: is 99; write a number less than or equal to 25 (2 more like this)",
    ),
}


@pytest.mark.parametrize(("text", "expected"), BAD_FIELDS.values(), ids=BAD_FIELDS.keys())
def test_bad_field_is_named_with_what_to_write_instead(text, expected):
    assert expected in error_of(text)


# --- what a bad file is told ----------------------------------------------------------------------------

BAD_YAML = {
    "tag": (MINIMAL + "x: !!python/object/apply:os.system [ls]", "line 3: the YAML tag"),
    "own tag": (MINIMAL + "light: !sun {}", "line 3: the YAML tag !sun is not allowed"),
    "truncated in a list": (MINIMAL + "targets: [{class: person, pos", "line 4: not YAML"),
    "truncated in quotes": (MINIMAL + 'description: "two clus', "not YAML"),
    "tab": (MINIMAL + "wind:\n\tmean_speed_mps: 2", "line 4: not YAML"),
    "two documents": (MINIMAL + "---\n" + MINIMAL, "line 3: not YAML"),
    "duplicate key": (MINIMAL + "name: again", "line 3: 'name' is written twice; keep one"),
    "duplicate inner key": (
        MINIMAL + "wind:\n  gust_std_mps: 1\n  gust_std_mps: 2",
        "line 5: 'gust_std_mps' is",
    ),
    "number as key": (MINIMAL + "3: 4", "line 3: a field's name must be a word"),
    "list as key": (MINIMAL + "? [1, 2]\n: 3", "line 3: a field's name must be a word"),
    "a list": ("- 1\n- 2", "is a list, not a scenario"),
    "a word": ("clusters", "is a str, not a scenario"),
    "nothing": ("", "is empty, not a scenario"),
    "only a comment": ("# name: a", "is empty, not a scenario"),
    "control characters": ("name: \x00\x01", "not YAML"),
    "nesting": ("[" * 100_000, "line 1: lists are nested too deeply"),
}


@pytest.mark.parametrize(("text", "expected"), BAD_YAML.values(), ids=BAD_YAML.keys())
def test_bad_yaml_is_told_where(text, expected):
    assert expected in error_of(text)


def test_aliases_are_refused_before_they_grow():
    bomb = "a0: &a0 [x, x]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 30)
    )
    assert "line 2: the alias *a0 is not allowed" in error_of(bomb)


def test_missing_file_suggests_shipped_names():
    with pytest.raises(UserError, match=r"clustrs: there is no such scenario; did you mean 'clusters'\?"):
        load_scenario("clustrs")
    with pytest.raises(UserError, match=r"one of .*abundance, .*clusters, .*sparse"):
        load_scenario("no/where.yaml")


def test_folder_is_refused(tmp_path):
    with pytest.raises(UserError, match="is a folder or device"):
        load_scenario(tmp_path)


def test_device_is_refused():
    with pytest.raises(UserError, match="is a folder or device"):
        load_scenario("/dev/zero")


def test_binary_file_is_refused(tmp_path):
    path = tmp_path / "picture.yaml"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    with pytest.raises(UserError, match=r"picture\.yaml: is not a text file in UTF-8"):
        load_scenario(path)


def test_huge_file_is_refused_unread(tmp_path):
    path = tmp_path / "huge.yaml"
    with path.open("wb") as file:
        file.truncate(MAX_YAML_BYTES + 1)
    with pytest.raises(UserError, match="is larger than 5 MB"):
        load_scenario(path)


def test_overlong_path_is_one_sentence():
    with pytest.raises(UserError, match="cannot be read"):
        load_scenario("x" * 5000)


# --- properties -----------------------------------------------------------------------------------------

coordinate = st.floats(-200, 200, allow_nan=False)
point = st.tuples(coordinate, coordinate)
positive_or_infinite = st.one_of(st.floats(0.01, 1e6), st.just(math.inf))
text = st.text(st.characters(exclude_categories=("Cs",)), max_size=40)
target = st.fixed_dictionaries(
    {"class": st.sampled_from(["stop sign", "person", "boat"]), "position_enu_m": point},
    optional={
        "yaw_deg": st.floats(-720, 720),
        "size_m": st.none() | st.floats(0.06, 60),
        "pose": st.sampled_from(["face-up", "standing", "lying", "floating"]),
    },
)
generator = st.fixed_dictionaries(
    {
        "class": st.sampled_from(["person", "red bucket", "buoy"]),
        "pattern": st.sampled_from(["uniform", "clustered", "sparse"]),
        "count": st.integers(1, 1600),
    },
    optional={
        "seed": st.none() | st.integers(0, 2**31),
        "centres_enu_m": st.none() | st.just([[1.5, 0.5]]),
    },
).filter(lambda drawn: drawn["pattern"] == "clustered" or not drawn.get("centres_enu_m"))
scenario_data = st.fixed_dictionaries(
    {
        "name": st.from_regex(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,79}", fullmatch=True),
        "area": st.builds(
            lambda w, h: {"polygon_enu_m": [[0, 0], [w, 0], [w, h], [0, h]]},
            st.floats(2, 3000),
            st.floats(2, 3000),
        ),
    },
    optional={
        "description": text,
        "targets": st.lists(target, max_size=4),
        "generators": st.lists(generator, max_size=3),
        "forests": st.lists(st.fixed_dictionaries({"trees_per_hectare": st.floats(0.1, 20)}), max_size=2),
        "terrain": st.fixed_dictionaries({"heightmap_m": st.just([[0.5, 1e-17], [-3.25, 1e17]])}),
        "search": st.fixed_dictionaries(
            {}, optional={"n_c": st.integers(1, 1000) | st.just(math.inf), "d_c_m": positive_or_infinite}
        ),
    },
)


def assert_scenario_or_sentence(text: str) -> None:
    try:
        outcome: object = parse_scenario(text, "any.yaml")
    except UserError as error:
        outcome = str(error)
    assert isinstance(outcome, Scenario) or str(outcome).startswith("any.yaml: ")


@settings(max_examples=60)
@given(scenario_data)
@example(
    {"name": "a", "area": {"polygon_enu_m": [(0, 0), (9, 0), (9, 9)]}, "description": "a\x85 \u2028\n #: ä"}
)
def test_any_scenario_round_trips(data):
    scenario = Scenario.model_validate(data)
    assert parse_scenario(dump_scenario(scenario), "dump") == scenario


@settings(max_examples=100)
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | text,
        lambda s: (
            st.lists(s, max_size=3)
            | st.dictionaries(st.sampled_from([*Scenario.model_fields, "class", "other"]), s, max_size=5)
        ),
    )
)
def test_any_data_is_a_scenario_or_one_sentence(data):
    assert_scenario_or_sentence(yaml.safe_dump(data))


@settings(max_examples=100)
@given(st.data())
def test_any_damage_to_a_file_is_survived_or_told_in_one_sentence(data):
    whole = dump_scenario(load_scenario("sparse"))
    start = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(start, len(whole)))
    junk = data.draw(st.text(max_size=5))
    assert_scenario_or_sentence(whole[:start] + junk + whole[end:])


def test_shipped_folder_holds_scenarios_only():
    import skysweep.scenarios.files as files

    folder = Path(files.__file__).parent / "shipped"
    assert {p.suffix for p in folder.iterdir() if p.is_file()} == {".yaml"}
    assert {p.name for p in folder.iterdir() if p.is_dir()} <= set(list_scenarios()), "with their ground"


def test_a_distractor_lies_as_it_says_or_another_way_in_every_mission() -> None:
    said = Distractor.model_validate({"class": "red bucket", "position_enu_m": [10, 10], "yaw_deg": 30})
    scenario = load_scenario("clusters").model_copy(
        update={"distractors": (said, said.model_copy(update={"yaw_deg": None}))}
    )
    first, *others = (build_world(scenario, seed).objects[-2:] for seed in (0, 0, 1))
    assert [o.yaw_rad for o in first] == [o.yaw_rad for o in others[0]]
    assert first[0].yaw_rad == others[1][0].yaw_rad == pytest.approx(np.radians(30))
    assert first[1].yaw_rad != others[1][1].yaw_rad


def test_a_thermal_camera_has_defaults_of_its_own_and_a_visible_one_the_keys_of_before():
    thermal = parse_scenario(NIGHT, "night.yaml")
    assert thermal.camera.lens == Lens(640, 512, 0.554)
    assert thermal.detector.model == "skysweep-thermal"
    assert parse_scenario(dump_scenario(thermal), "dumped") == thermal
    visible = load_scenario("clusters").model_dump(by_alias=True)
    assert {"kind", "netd_k"}.isdisjoint(visible["camera"])
    assert set(visible["light"]) == {"sun_elevation_deg", "sun_heading_deg", "visibility_m"}
    wide = parse_scenario(NIGHT.replace("thermal}", "thermal, hfov_rad: 1.0}"), "night.yaml")
    assert wide.camera.lens == Lens(640, 512, 1.0)


NIGHT = """
name: night
area: {polygon_enu_m: [[0, 0], [100, 0], [100, 100]]}
camera: {kind: thermal}
light: {sun_elevation_deg: -20, air_temperature_c: 4}
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("thermal", "visible", "light.sun_elevation_deg: is -20; write 3 or more, or camera.kind: thermal"),
        ("thermal}", "thermal, noise_std: 5}", "noise_std: is not of a thermal camera; delete it"),
        (
            "thermal}",
            "thermal}\ndetector: {model: skysweep}",
            "skysweep does not know the pictures of a thermal",
        ),
        ("-20", "-91", "-90"),
    ],
)
def test_what_does_not_fit_a_kind_of_camera_is_refused(old, new, words):
    with pytest.raises(UserError, match=words):
        parse_scenario(NIGHT.replace(old, new), "night.yaml")


def test_the_night_is_a_field_scale_search_with_a_thermal_camera():
    night = load_scenario("night")
    assert night.camera.kind == "thermal"
    assert 0.9e6 < night.area_enu_m.area < 1.1e6
    assert night.pixels_on_target(night.search.scan_altitude_agl_m) > 10
    assert len(build_world(night, 0).targets) == 4


def test_another_kind_of_camera_has_what_is_usual_for_it() -> None:
    wide = change_scenario(load_scenario("clusters"), {"camera.kind": "thermal", "camera.hfov_rad": 1.0})
    assert wide.camera.lens == Lens(640, 512, 1.0)
    assert wide.detector.model == "skysweep-thermal"
    back = change_scenario(wide, {"camera.kind": "visible"})
    assert (back.camera.height_px, back.camera.hfov_rad, back.detector.model) == (360, 1.0, "skysweep")
    with_objects = Scenario(name="mine", area=wide.area, camera=wide.camera)
    assert with_objects.detector.model == "skysweep-thermal"


# --- changes of whole sections --------------------------------------------------------------------------


def test_a_section_changes_the_fields_that_it_names():
    scenario = load_scenario("person-wilderness")
    assert change_scenario(scenario, {"search": {"n_c": 3}}) == change_scenario(scenario, {"search.n_c": 3})
    assert change_scenario(scenario, {"camera": {"gimbal": {"lag_s": 0.1}}}) == change_scenario(
        scenario, {"camera.gimbal.lag_s": 0.1}
    )
    thermal = change_scenario(load_scenario("sparse"), {"camera": {"kind": "thermal"}})
    assert thermal == change_scenario(load_scenario("sparse"), {"camera.kind": "thermal"})
    with pytest.raises(UserError, match=r"search\.nc: there is no such field; did you mean 'n_c'"):
        change_scenario(scenario, {"search": {"nc": 3}})


def test_area_lists_and_models_change_as_a_whole():
    hole = {"area.holes_enu_m": [[[20, 5], [40, 5], [40, 15]]]}
    scenario = change_scenario(load_scenario("sparse"), hole)
    corners = [[0, 0], [50, 0], [50, 50]]
    assert change_scenario(scenario, {"area": {"polygon_enu_m": corners}}).area.holes_enu_m == []
    assert change_scenario(scenario, hole | {"area": {"polygon_enu_m": corners}}).area.holes_enu_m != []
    target = {"class": "stop sign", "position_enu_m": [5, 5]}
    assert len(change_scenario(scenario, {"targets": [target]}).targets) == 1
    planned = change_scenario(scenario, {"search.plan": "area.plan", "search.n_c": 7})
    assert change_scenario(planned, {"search": Search(d_c_m=30)}).search == Search(d_c_m=30)


def test_no_change_is_dropped():
    scenario = load_scenario("sparse")
    changed = change_scenario(scenario, {"search.d_c_m": 30, "search": {"n_c": 3}}).search
    assert (changed.n_c, changed.d_c_m) == (3, 30)
    assert change_scenario(scenario, {"search": {"d_c_m": 30}, "search.n_c": 3}).search == changed
    with pytest.raises(UserError, match=r"sparse: search\.n_c: is written twice; keep one"):
        change_scenario(scenario, {"search.n_c": 3, "search": {"n_c": 5}})


def test_null_is_written_as_none():
    planned = change_scenario(load_scenario("sparse"), {"search.plan": "area.plan"})
    assert skysweep.change_scenario(planned, {"search.plan": None}).search.plan is None
    assert change_scenario(planned, {"search": {"plan": None}}).search.plan is None
    with pytest.raises(UserError, match=r"search\.n_c: "):
        skysweep.change_scenario(planned, {"search.n_c": None})


@pytest.mark.parametrize("family", load_suite().families, ids=lambda family: family.label)
def test_a_benchmark_scenario_is_the_same_whether_a_section_is_changed_or_replaced(family):
    fields = load_scenario(family.scenario).model_dump(by_alias=True)
    whole = {key: value for key, value in family.changes.items() if isinstance(value, dict)}
    dotted = {key: value for key, value in family.changes.items() if key not in whole}
    assert family.base() == change_scenario(Scenario.model_validate(fields | whole), dotted)
