"""docs/scenarios.md says what the model says."""

import json
import runpy
from pathlib import Path

import pytest

from skysweep.scenarios.files import json_schema, list_scenarios, parse_scenario

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "scenarios.md").read_text("utf-8")
tool = runpy.run_path(str(ROOT / "tools" / "scenario_reference.py"))


def test_field_reference_is_up_to_date():
    assert tool["with_reference"](PAGE) == PAGE, "run  python tools/scenario_reference.py"


def test_field_reference_is_whole():
    sections = ["Scenario", *json_schema()["$defs"]]
    missing = [name for name in sections if f"### {name}\n" not in PAGE]
    assert missing == []


def test_every_shipped_scenario_is_on_the_page():
    assert [name for name in list_scenarios() if f"`{name}`" not in PAGE] == []


@pytest.mark.parametrize("example", [part.split("```")[0] for part in PAGE.split("```yaml\n")[1:]])
def test_every_example_on_the_page_is_a_valid_scenario(example, tmp_path):
    ring = [[22.07, 60.14], [22.073, 60.14], [22.073, 60.142], [22.07, 60.14]]
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    example = example.replace("my-area.kml", str(area))
    minimal = "name: example\narea: {polygon_enu_m: [[0, 0], [90, 0], [90, 90], [0, 90]]}\n"
    parse_scenario(example if "name:" in example else minimal + example, "docs/scenarios.md")
