"""What cannot be flown is said without flying."""

import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.errors import UserError
from skysweep.flights.refusals import refuse_unflyable, unusable_sensors
from skysweep.scenarios.files import change_scenario, list_scenarios, load_scenario

FENCE = [[-400, -400], [400, -400], [400, 400], [-400, 400]]
BY_A_TREE = {"class": "rock", "pattern": "sparse", "count": 1, "near": "trees"}
ACROSS = [[-500, 30], [500, 30], [500, 40], [-500, 40]]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"vehicle.battery_wh": 2}, "vehicle.battery_wh: 2 Wh do not last to a place"),
        ({"generators": [BY_A_TREE]}, r"generators\[0\]\.near: there are no trees"),
        ({"search.strategy": "scan-only", "search.confirm_height_max_m": 10}, "confirm_height_max_m: is 10"),
        ({"wind.mean_speed_mps": 12}, r"wind: blows at \d\d\.\d m/s, above safety.wind_max_mps"),
        ({"search.plan": "no.plan"}, r"search.plan: no\.plan: there is no such file"),
        ({"geofence_enu_m": FENCE, "safety.no_fly_enu_m": [ACROSS]}, "no_fly_enu_m: the path's waypoint"),
    ],
)
def test_what_plan_or_run_refuse(changes, sentence):
    with pytest.raises(UserError, match=sentence):
        refuse_unflyable(change_scenario(load_scenario("clusters"), changes))


@pytest.mark.parametrize("name", list_scenarios())
def test_shipped_scenarios_can_be_flown(name):
    scenario = load_scenario(name)
    refuse_unflyable(scenario)
    assert list(unusable_sensors(scenario)) == []


def test_sensors_that_cannot_be_used_are_named():
    changes = {
        "camera.width_px": 8192,
        "camera.height_px": 4096,
        "detector.model": "no.onnx",
        "detector.statistical_model": "no.yaml",
    }
    large, model, fitted = unusable_sensors(change_scenario(load_scenario("clusters"), changes))
    assert large.startswith("camera.width_px: 8192 x 4096 pixels are more than can be rendered")
    assert model.startswith("detector.model: no.onnx: there is no such model file")
    assert fitted.startswith("detector.statistical_model: no.yaml: not a sensor model")


def test_validate_says_them(tmp_path):
    file = tmp_path / "mine.yaml"
    text = "name: mine\narea: {polygon_enu_m: [[0, 0], [90, 0], [90, 80]]}\ndetector: {model: no.onnx}\n"
    file.write_text(text)
    usable = CliRunner().invoke(app, ["scenarios", "validate", str(file)])
    assert usable.exit_code == 0
    assert "warning: detector.model: " in usable.output
    file.write_text(text + "vehicle: {battery_wh: 2}\n")
    refused = CliRunner().invoke(app, ["scenarios", "validate", str(file)])
    assert refused.exit_code == 2
    assert refused.output.startswith(f"error: {file}: vehicle.battery_wh: 2 Wh do not last to a place")
