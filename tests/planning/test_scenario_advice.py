"""Warnings: each shows up for its cause, and none for what is shipped."""

import pytest

from skysweep.planning.advice import localisation_std_m, warnings_for
from skysweep.scenarios.files import list_scenarios, load_scenario, parse_scenario
from skysweep.scenarios.model import MAX_BATTERIES

WELL = """
name: mine
area: {polygon_enu_m: [[0, 0], [100, 0], [100, 100], [0, 100]]}
camera: {hfov_rad: 1.2}
targets: [{class: stop sign, position_enu_m: [50, 50], size_m: 0.9}]
"""


def warnings_of(**sections: str) -> list[str]:
    text = "".join(line + "\n" for line in WELL.splitlines() if line.split(":")[0] not in sections)
    return warnings_for(parse_scenario(text + "".join(f"{k}: {v}\n" for k, v in sections.items()), "mine"))


def test_a_scan_faster_than_the_simulated_vehicle_flies_is_said():
    said = warnings_of(search="{scan_speed_mps: 15}")
    assert any("is 15, and the simulated vehicle flies at most at 12 m/s" in warning for warning in said)


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_scenarios_give_none_but_for_checks_among_trees_and_houses(name):
    shares = {"person-wilderness": "12%", "buildings": "41%"}
    warnings = warnings_for(load_scenario(name))
    assert len(warnings) == (name in shares)
    for warning in warnings:
        assert (
            f"in {shares[name]} of the area trees or buildings are nearer than 2 m to a check at 6 m"
            in warning
        )


@pytest.mark.parametrize(("elevation_deg", "heading_deg"), [(45, 150), (45, 10), (80, 180)])
def test_a_sun_that_cannot_be_at_this_latitude_is_said_of_a_thermal_camera(elevation_deg, heading_deg):
    light = f"{{sun_elevation_deg: {elevation_deg}, sun_heading_deg: {heading_deg}}}"
    said = [w for w in warnings_of(light=light, camera="{kind: thermal}") if "the sun never stands" in w]
    assert bool(said) == ((elevation_deg, heading_deg) != (45, 150))
    assert not any("the sun never stands" in w for w in warnings_of(light=light))


def test_too_high_for_the_camera_tells_the_pixels_and_the_altitude_that_gives_twelve():
    (warning,) = warnings_of(search="{scan_altitude_agl_m: 60}")
    assert "spans only 7.0 pixels from 60 m; scan from 35.1 m for 12 pixels" in warning
    assert warnings_of(search="{scan_altitude_agl_m: 35.1}") == []


CASES = {
    "check too high": (
        {"search": "{check_altitude_agl_m: 20}"},
        "check_altitude_agl_m: the smallest target spans only 21.0 pixels",
    ),
    "check too low": ({"search": "{check_altitude_agl_m: 2}"}, "check_altitude_agl_m: from 2 m the picture"),
    "too few looks": ({"detector": "{rate_hz: 0.2}"}, "detector.rate_hz: the vehicle flies 25.0 m between"),
    "too big for check": (
        {"targets": "[{class: boat, position_enu_m: [5, 5], size_m: 9}]"},
        "a target of 9 m does not fit in the 5.5 m wide picture from 4 m; check from 13 m",
    ),
    "no targets": ({"targets": "[]"}, "targets: there are none"),
    "target outside": (
        {"targets": "[{class: stop sign, position_enu_m: [50, 120], size_m: 0.9}]"},
        "targets[0]: lies outside the area at [50, 120]",
    ),
    "target in a building": (
        {"buildings": "[{position_enu_m: [50.4, 50], size_m: [1.4, 1.8], yaw_deg: 90}]"},
        "targets[0]: lies inside a building",
    ),
    "building too high": (
        {"buildings": "[{position_enu_m: [-20, 10], height_m: 28}]"},
        "a building may reach 32 m, above the scan at 30 m; scan from 37 m",
    ),
    "forest too high": (
        {
            "forests": "[{trees_per_hectare: 5, height_m: [20, 31], "
            "polygon_enu_m: [[-50, 0], [-10, 0], [-10, 40]]}]"
        },
        "a forest may reach 31 m, above the scan at 30 m",
    ),
    "tree too near to the scan": (
        {"trees": "[{position_enu_m: [-20, 10], height_m: 29}]"},
        "a tree may reach 29 m, nearer than safety.clearance_m (2 m) to the scan at 30 m; scan from 34 m",
    ),
    "check among trees": (
        {"trees": "[{position_enu_m: [50, 50], height_m: 9, crown_radius_m: 10}]"},
        "safety.clearance_m: in 5% of the area trees or buildings are nearer than 2 m to a check at 4 m",
    ),
    "home below a tree": (
        {"trees": "[{position_enu_m: [-4, 0], height_m: 9, crown_radius_m: 2.5}]"},
        "home.position_enu_m: trees or buildings are nearer than safety.clearance_m (2 m) to take-off",
    ),
    "haze": (
        {"light": "{visibility_m: 100}"},
        "light.visibility_m: from 30 m haze leaves 31% of the contrast",
    ),
    "ground that does not count from home's": (
        {"terrain": "{heightmap_m: [[100, 100], [100, 100]]}"},
        "terrain.heightmap_m: is 100 m at home, and heights count from home.altitude_amsl_m",
    ),
    "a vehicle that sustains more than the simulated one": (
        {"safety": "{air_speed_max_mps: 18}"},
        "safety.air_speed_max_mps: is 18; the simulated vehicle sustains 9.8 m/s",
    ),
    "a camera that looks ahead": (
        {"camera": "{hfov_rad: 1.2, gimbal: {pitch_deg: -60}}"},
        "camera.gimbal.pitch_deg: at -60 the camera does not look straight down, as the plan assumes",
    ),
    "a wind that blows it off its transects": (
        {"wind": "{mean_speed_mps: 6}"},
        "search.scan_speed_mps: 5 m/s against a wind of 6 m/s is more than the vehicle sustains "
        "(safety.air_speed_max_mps: 9.8), and it is blown off its transects; write 3.8 or less",
    ),
    "gusts": (
        {"wind": "{mean_speed_mps: 8, gust_std_mps: 2}"},
        "wind.mean_speed_mps: with gusts it blows at 12 m/s",
    ),
    "storm": (
        {"wind": "{mean_speed_mps: 12}"},
        "wind.mean_speed_mps: is 12, above safety.wind_max_mps (9): nothing takes off",
    ),
}


@pytest.mark.parametrize(("sections", "expected"), CASES.values(), ids=CASES.keys())
def test_each_cause_has_its_warning(sections, expected):
    (warning,) = warnings_of(**sections)
    assert expected in warning


def test_trees_that_a_check_is_high_above_are_nothing_to_warn_of():
    low = "[{position_enu_m: [50, 50], height_m: 1.9, crown_radius_m: 10}]"
    assert warnings_of(trees=low) == []
    assert len(warnings_of(trees=low.replace("1.9", "2.1"))) == 1
    assert len(warnings_of(trees=low, safety="{clearance_m: 3}")) == 1


def test_generated_targets_count_as_targets():
    generators = "[{class: stop sign, pattern: uniform, count: 3, size_m: 0.9}]"
    assert warnings_of(targets="[]", generators=generators) == []


def test_localisation_error_grows_with_height_and_speed():
    scenario = load_scenario("sparse")
    assert localisation_std_m(scenario, 60) > localisation_std_m(scenario, 30) > 0.3
    assert localisation_std_m(scenario.with_search(scan_speed_mps=10), 30) > localisation_std_m(scenario, 30)


def test_a_plan_that_takes_more_batteries_says_how_far_they_last_and_what_would_do():
    vehicle = {"battery_wh": 8, "cruise_speed_mps": 10}
    (warning,) = warnings_of(vehicle=vehicle)
    assert warning.startswith("vehicle.batteries: 1 battery lasts for ")
    needed = int(warning.split("write vehicle.batteries: ")[1].split(",")[0])
    assert warnings_of(vehicle=vehicle | {"batteries": needed}) == []
    (short,) = warnings_of(vehicle=vehicle | {"batteries": needed - 1}) if needed > 2 else [warning]
    assert f"takes {needed}" in short
    for field, value in (cure.split(": ") for cure in warning.split("write ")[1].split(", or ")[1:]):
        assert warnings_of(vehicle=vehicle, search={field.removeprefix("search."): float(value)}) == []


def test_no_cure_for_batteries_asks_for_what_the_vehicle_or_a_scenario_cannot():
    windy = {"vehicle": "{battery_wh: 12, cruise_speed_mps: 10}", "wind": "{mean_speed_mps: 4}"}
    (said,) = [w for w in warnings_of(**windy, search="{scan_speed_mps: 3}") if "vehicle.batteries" in w]
    assert said.endswith("search.scan_speed_mps: 5.8")
    assert not [w for w in warnings_of(**windy, search="{scan_speed_mps: 5.8}") if "speed" in w]
    slow = {"area": "{polygon_enu_m: [[0, 0], [900, 0], [900, 900], [0, 900]]}"}
    (said,) = [w for w in warnings_of(**slow, search="{scan_speed_mps: 0.1}") if "vehicle.batteries" in w]
    assert int(said.split("the whole plan takes ")[1].split()[0]) > MAX_BATTERIES
    assert "write vehicle.batteries" not in said


def test_a_mast_beyond_the_ground_that_is_known_is_said():
    hills, mast = "{hills_height_m: 30}", "{radio_mast_enu_m: [900, 50, 10]}"
    (said,) = [w for w in warnings_of(safety=mast, terrain=hills) if "radio_mast" in w]
    assert "safety.radio_mast_enu_m: stands 740 m beyond the ground that is known" in said
    assert not [w for w in warnings_of(safety=mast) if "radio_mast" in w]
    assert not [w for w in warnings_of(safety=mast.replace("900", "90"), terrain=hills) if "mast" in w]


def test_a_strategy_that_covers_from_lower_needs_more_batteries():
    scenario = parse_scenario(WELL + "vehicle: {battery_wh: 20}\n", "mine")
    assert warnings_for(scenario) == []
    (warning,) = warnings_for(scenario, scenario.search.check_altitude_agl_m)
    assert warning.startswith("vehicle.batteries: 1 battery lasts for ")
    assert "scan_altitude" not in warning


STRIP = "[[40, -30], [60, -30], [60, 130], [40, 130]]"


def test_a_path_through_a_no_fly_area_is_said():
    (said,) = [w for w in warnings_of(safety=f"{{no_fly_enu_m: [{STRIP}]}}") if "no_fly" in w]
    assert "m through it; a mission flies round, and the ground there is not seen" in said
    beside = "[[140, 0], [160, 0], [160, 50], [140, 50]]"
    assert not [w for w in warnings_of(safety=f"{{no_fly_enu_m: [{beside}]}}") if "no_fly" in w]


def test_a_way_round_beyond_the_ground_that_is_known_is_said():
    far = STRIP.replace("130", "500")
    hills = "{hills_height_m: 30}"
    said = [w for w in warnings_of(safety=f"{{no_fly_enu_m: [{far}]}}", terrain=hills) if "beyond" in w]
    assert len(said) == 1
    assert "safety.no_fly_enu_m: leads up to 340 m beyond the ground that is known" in said[0]
    assert not [w for w in warnings_of(safety=f"{{no_fly_enu_m: [{far}]}}") if "beyond" in w]
    assert not [w for w in warnings_of(safety=f"{{no_fly_enu_m: [{STRIP}]}}", terrain=hills) if "beyond" in w]
