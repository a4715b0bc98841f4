"""Specs of sweeps: what they fly, and what is wrong with one said in a sentence."""

import json
import math
from pathlib import Path

import pytest

from skysweep.errors import UserError
from skysweep.experiments.sweep.spec import dump_spec, load_spec, matrix_of, parse_spec

SPEC = """
name: demo
scenarios:
  - clusters
  - {scenario: clusters, label: windy, set: {wind.mean_speed_mps: 8}}
strategies:
  - scan-check
  - {strategy: scan-only, parameters: {search.scan_altitude_agl_m: [20, 30]}}
parameters:
  search.n_c: [1, 5, .inf]
  search.scan_altitude_agl_m: [20, 30]
points:
  - {search.n_c: 2, search.d_c_m: 60}
seeds: 10
first_seed: 100
"""


def test_the_example_is_ten_thousand_missions():
    example = Path(__file__).parents[2] / "examples" / "when-to-check.yaml"
    assert len(matrix_of(load_spec(example))) == 3 * 17 * 197 > 10_000


def test_every_combination_flies_every_seed():
    matrix = matrix_of(parse_spec(SPEC, "spec.yaml"))
    table = matrix.table()
    assert len(matrix) == len(table) == 2 * (3 * 2 + 1 + 2) * 10
    assert table["scenario"].unique(maintain_order=True).to_list() == ["clusters", "clusters-windy"]
    assert table["seed"].unique().sort().to_list() == list(range(100, 110))
    assert table["config_hash"].n_unique() == len(table)
    assert table["job"].to_list() == list(range(len(table)))
    one_cell = table.filter(seed=100, scenario="clusters", strategy="scan-check")
    assert one_cell.select(r"^param\..*$").rows() == [
        *((n, h, math.inf) for n in (1.0, 5.0, math.inf) for h in (20.0, 30.0)),
        (2.0, 30.0, 60.0),
    ]
    for number in (0, 17, len(matrix) - 1):
        job, row = matrix.job(number), table.row(number, named=True)
        assert (job.label, job.seed, job.config_hash) == (row["scenario"], row["seed"], row["config_hash"])
        assert job.scenario.search.n_c == row["param.search.n_c"]
        assert job.scenario.wind.mean_speed_mps == (8 if job.label == "clusters-windy" else 2)


FILES = """
name: files
scenarios:
  - clusters
  - {scenario: clusters, label: own, set: {detector.statistical_model: mine.yaml, area: {file: area.geojson}}}
strategies:
  - {strategy: scan-check, points: [{search.plan: low.plan}, {detector.statistical_model: other.yaml}]}
  - scan-only
parameters: {detector.statistical_model: [mine.yaml, "null"], detector.model: [best.onnx, yolo26n-sar]}
seeds: 1
"""
CORNERS = [[22.2966, 60.449], [22.2996, 60.449], [22.2996, 60.4505], [22.2966, 60.4505], [22.2966, 60.449]]


def test_files_start_at_the_specs_folder_and_the_written_spec_flies_from_anywhere(tmp_path, monkeypatch):
    folder = tmp_path / "spec"
    folder.mkdir()
    (folder / "files.yaml").write_text(FILES)
    (folder / "mine.yaml").write_text("numbers")
    (folder / "area.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [CORNERS]}))
    monkeypatch.chdir(tmp_path)
    spec = load_spec("spec/files.yaml")
    flown = matrix_of(spec).table()
    found = {job.scenario.detector.statistical_model for job in matrix_of(spec).jobs()}
    assert found == {str(folder / "mine.yaml"), str(folder / "other.yaml"), None}
    assert {str(folder / "low.plan"), None} == {job.scenario.search.plan for job in matrix_of(spec).jobs()}
    assert set(flown["param.detector.model"]) == {str(folder / "best.onnx"), "yolo26n-sar", "skysweep"}
    monkeypatch.chdir(folder)
    assert matrix_of(load_spec("files.yaml")).table().equals(flown)
    monkeypatch.chdir("/")
    assert matrix_of(parse_spec(dump_spec(spec), "spec.yaml")).table().equals(flown)


def test_without_strategies_each_scenario_has_its_own():
    matrix = matrix_of(parse_spec("{name: a, scenarios: [clusters], seeds: [7, 3]}", "spec.yaml"))
    assert matrix.table().select("strategy", "seed").rows() == [("scan-check", 7), ("scan-check", 3)]


def test_combinations_that_come_out_the_same_are_one():
    values = "parameters: {search.n_c: [1, 1.0]}, points: [{search.n_c: 1}]"
    text = f"{{name: a, scenarios: [clusters], {values}, seeds: 1}}"
    assert len(matrix_of(parse_spec(text, "spec.yaml"))) == 1


def test_generators_are_changes_of_a_scenario():
    text = """
name: a
scenarios:
  - scenario: clusters
    set:
      targets: []
      generators: [{class: stop sign, pattern: uniform, count: 30, seed: null}]
seeds: 1
"""
    scenario = matrix_of(parse_spec(text, "spec.yaml")).job(0).scenario
    assert not scenario.targets
    assert scenario.generators[0].count == 30


def test_a_written_spec_comes_back_and_needs_no_other_file(tmp_path):
    (tmp_path / "mine.yaml").write_text("name: mine\narea: {polygon_enu_m: [[0, 0], [9, 0], [9, 9]]}\n")
    (tmp_path / "spec.yaml").write_text("{name: a, scenarios: [mine.yaml], seeds: 2}")
    spec = load_spec(tmp_path / "spec.yaml")
    (tmp_path / "mine.yaml").unlink()
    again = parse_spec(dump_spec(spec), "spec.yaml")
    assert again == spec
    assert matrix_of(again).job(1) == matrix_of(spec).job(1)


def test_a_description_keeps_unicodes_own_line_ends():
    text = '{name: a, description: "one\\u2028two\\x85three", scenarios: [clusters], seeds: 1}'
    spec = parse_spec(text, "spec.yaml")
    assert spec.description == "one\u2028two\x85three"
    assert parse_spec(dump_spec(spec), "spec.yaml") == spec


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("search.n_c: [", "n_c: [", ["n_c", "did you mean search.n_c"]),
        ("search.n_c: [", "search.nc: [", ["search.nc", "did you mean search.n_c"]),
        ("search.n_c: [", "search.scan_altitude: [", ["search.scan_altitude_agl_m"]),
        ("search.n_c: [", "h_C: [", ["did you mean search.check_altitude_agl_m"]),
        ("search.n_c: [", "search.strategy: [", ["search.strategy", "write it under strategies"]),
        ("search.n_c: [", "qwerty: [", ["qwerty", "no such parameter"]),
        ("[1, 5, .inf]", "[]", ["parameters.search.n_c", "is empty"]),
        ("[1, 5, .inf]", "7", ["parameters.search.n_c", "list"]),
        ("[1, 5, .inf]", "[[1]]", ["parameters.search.n_c[0]", "write a number"]),
        ("[1, 5, .inf]", "[-1]", ["clusters: search.n_c", "greater than 0"]),
        ("[1, 5, .inf]", "[.nan]", ["clusters: search.n_c", "nan"]),
        ("[1, 5, .inf]", "[1.5]", ["clusters: search.n_c", "whole number"]),
        ("[1, 5, .inf]", "[true]", ["clusters: search.n_c", "a number > 0"]),
        ("m: [20, 30]\npoints", "m: [2]\npoints", ["check_altitude_agl_m", "scan_altitude_agl_m (2)"]),
        ("search.d_c_m: 60", "search.d_m: 60", ["search.d_m", "search.d_c_m"]),
        ("- scan-check", "- scan-chek", ["strategies[0].strategy", "scan-chek", "scan-check"]),
        ("- clusters", "- cluster", ["cluster", "did you mean 'clusters'"]),
        ("label: windy, ", "", ["scenarios[1]", "label"]),
        ("label: windy", "lable: windy", ["scenarios[1].lable", "did you mean 'label'"]),
        ("wind.mean_speed_mps", "wind.mean_sped_mps", ["wind.mean_sped_mps", "mean_speed_mps"]),
        ("seeds: 10", "seeds: 0", ["seeds", "nothing to fly"]),
        ("seeds: 10", "seeds: []", ["seeds", "nothing to fly"]),
        ("seeds: 10", "seeds: [1, 1]", ["seeds", "twice"]),
        ("seeds: 10", "seeds: [-1]", ["seeds", "from 0"]),
        ("seeds: 10", "seeds: ten", ["seeds", "how many"]),
        ("seeds: 10", "seeds: true", ["seeds", "true", "how many"]),
        ("seeds: 10", "seeds: [3]", ["first_seed", "leave first_seed out"]),
        ("seeds: 10", "seed: 10", ["seed", "did you mean 'seeds'"]),
        ("seeds: 10\n", "", ["seeds", "missing"]),
        ("seeds: 10", "seeds: 10\nseeds: 20", ["seeds", "twice"]),
        ("seeds: 10", "seeds: 1000000", ["18,000,000 missions", "18 configurations"]),
        ("name: demo", "name: ''", ["name"]),
        ("name: demo", "name: ../demo", ["name", "../demo", "write letters, digits"]),
        ("- clusters", "- 42", ["scenarios[0]", "42", "write a name"]),
        ("name: demo", "name: [", ["not YAML", "line"]),
        ("name: demo", "sensor: radar\nname: demo", ["sensor", "radar", "statistical"]),
    ],
)
def test_what_is_wrong_is_one_sentence(old, new, said):
    assert old in SPEC
    with pytest.raises(UserError) as error:
        parse_spec(SPEC.replace(old, new, 1), "spec.yaml")
    sentence = str(error.value)
    assert sentence.startswith("spec.yaml: ")
    assert "\n" not in sentence
    for word in said:
        assert word in sentence


@pytest.mark.parametrize("text", ["", "[]", "just words", "scenarios: []\nname: a\nseeds: 1"])
def test_what_is_no_sweep_is_refused(text):
    with pytest.raises(UserError, match=r"spec\.yaml: "):
        parse_spec(text, "spec.yaml")


def test_no_such_file_no_text_no_folder(tmp_path):
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    for name, said in [("none.yaml", "no such file"), ("binary.yaml", "UTF-8"), ("", "folder or device")]:
        with pytest.raises(UserError, match=said):
            load_spec(tmp_path / name)


def test_a_parameter_of_numbers_and_words_is_told_in_words(tmp_path, monkeypatch):
    """One strategy may know it as a number, another as a word; the table could not be written."""
    (tmp_path / "gates.py").write_text(
        "from pydantic import BaseModel\n"
        "from skysweep.strategies.scan_check import ScanCheck\n"
        "class Gated(ScanCheck):\n"
        "    class Parameters(BaseModel):\n"
        "        gate: float | str = 0.5\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    spec = parse_spec(
        "{name: gates, scenarios: [clusters], strategies: ['gates:Gated'], seeds: 1, "
        "parameters: {search.parameters.gate: [0.25, auto]}}",
        "gates.yaml",
    )
    assert matrix_of(spec).table()["param.search.parameters.gate"].to_list() == ["0.25", "auto"]
