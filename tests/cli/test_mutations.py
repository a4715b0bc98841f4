"""Whatever a command is given: it works, or it says in one sentence why not, and leaves nothing behind."""

import math
import sys

import pytest
from mutations import (
    GEOJSON,
    SWEEP,
    Case,
    as_json,
    as_yaml,
    cases,
    detector_model,
    judged,
    judges,
    kmz,
    labelled_picture,
    made_inputs,
    scenario_fields,
    waypoint_plan,
)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks, limits and /proc of Linux")

SAMPLE = 60
NOWHERE = ("--connection", "nowhere://x", "--timeout", "1")


@pytest.fixture(scope="module")
def judge():
    with judges(1) as pool:
        yield lambda case: pool.submit(judged, case).result()


@pytest.fixture(scope="module")
def inputs():
    return made_inputs()


def refused(judge, command, files, *words, out_bytes=None):
    """It ends with code 2, one sentence with these words, and the folder as it was."""
    ended, faults = judge(Case("named", tuple(command), files, out_bytes))
    assert not faults, ended.errors
    assert ended.code == 2, ended.output
    for word in words:
        assert word in ended.errors


def accepted(judge, command, files):
    ended, faults = judge(Case("named", tuple(command), files))
    assert not faults, ended.errors
    assert ended.code == 0, ended.errors
    return ended


@pytest.mark.parametrize("method", [8, 12, 14], ids=["deflate", "bzip2", "lzma"])
def test_a_corrupt_kmz(judge, method):
    whole = kmz(method)
    accepted(judge, ("plan", "a.kmz"), {"a.kmz": whole})
    start = whole.index(b"doc.kml") + 7
    torn = whole[: start + 8] + bytes(b ^ 0xFF for b in whole[start + 8 : start + 40]) + whole[start + 40 :]
    refused(judge, ("plan", "a.kmz"), {"a.kmz": torn}, "a.kmz: is no readable KMZ")


@pytest.mark.parametrize(
    "name", ["my plan (1).plan", "mökki.plan", "_x.plan", "поле.plan", "n" * 90 + ".plan"]
)
def test_a_plan_flies_whatever_its_file_is_called(judge, inputs, name):
    refused(judge, ("fly", name, *NOWHERE), {name: as_json(inputs.plan)}, "nowhere://x")


def test_a_plan_of_waypoints_flies(judge, inputs):
    refused(judge, ("fly", "a.plan", *NOWHERE), {"a.plan": as_json(inputs.waypoints)}, "nowhere://x")


@pytest.mark.parametrize(
    ("home", "words"),
    [
        ((95, 22.1, 20), ["plannedHomePosition[0]", "90"]),
        ((60.2, 22.1, 9000), ["plannedHomePosition[2]", "8850"]),
        ((90, 0, 0), ["km from the area"]),
    ],
)
def test_a_plan_whose_home_is_no_place_to_fly_from(judge, inputs, home, words):
    for plan in (inputs.plan, inputs.waypoints):
        moved = plan | {"mission": plan["mission"] | {"plannedHomePosition": home}}
        refused(judge, ("fly", "a.plan", *NOWHERE), {"a.plan": as_json(moved)}, "a.plan", *words)


def test_a_waypoint_of_no_place_on_earth(judge):
    plan = as_json(waypoint_plan((95, 22.1, 30), (60.2, 22.1, 30)))
    refused(judge, ("fly", "a.plan", *NOWHERE), {"a.plan": plan}, "a.plan: mission.items[0]", "latitude 95")


def test_a_plan_at_the_pole(judge):
    plan = waypoint_plan((89.9999, 0, 30), (89.9999, 90, 30), (89.9999, 180, 30), home=(90, 0, 0))
    refused(judge, ("fly", "a.plan", *NOWHERE), {"a.plan": as_json(plan)}, "nowhere://x")
    ring = [[lon, 89.999] for lon in (-180, -90, 0, 90, 180)]
    refused(
        judge, ("plan", "a.json"), {"a.json": as_json({"type": "Polygon", "coordinates": [ring]})}, "a.json"
    )


def test_clusters_without_centres(judge):
    scenario = scenario_fields()
    scenario["generators"][0]["centres_enu_m"] = []
    refused(
        judge,
        ("scenarios", "validate", "m.yaml"),
        {"m.yaml": as_yaml(scenario)},
        "generators[0].centres_enu_m: is empty; write at least 1",
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seeds": 10**30}, ["seeds: is more than one sweep can hold"]),
        ({"seeds": 1e30}, ["seeds"]),
        ({"seeds": [1e30]}, ["seeds"]),
        ({"first_seed": 1e30}, ["first_seed"]),
        ({"seeds": "nested-here20000."}, ["m.yaml"]),
        ({"scenarios": "nested-here500."}, ["m.yaml"]),
        ({"parameters": {"search.n_c": "nested-here150."}}, ["m.yaml"]),
        ({"scenarios": ["~nobody/x.yaml"]}, ["m.yaml"]),
    ],
)
def test_a_sweep_that_nests_or_counts_too_far(judge, change, words):
    files = {"m.yaml": as_yaml(SWEEP | change), "mine.yaml": as_yaml(scenario_fields()), "file": b""}
    refused(judge, ("sweep", "m.yaml", "--out", "file/x"), files, *words)


@pytest.mark.parametrize(
    "names", ["5", "'abc'", "{'a': 'b'}", "{None: 1, 2: 3}", "[" * 3000, "{1, 2, 3}", "["]
)
def test_metadata_that_is_no_list_of_names(judge, names):
    files = {**labelled_picture(), "m.onnx": detector_model(names)}
    refused(
        judge,
        ("detect", "evaluate", "data", "--model", "m.onnx"),
        files,
        "is no list of class names",
        "m.names",
    )
    accepted(
        judge,
        ("detect", "evaluate", "data", "--model", "m.onnx"),
        files | {"m.names": "person\nbåt\nstop sign\n".encode()},
    )


def test_names_that_are_no_text(judge):
    files = {**labelled_picture(), "m.onnx": detector_model(), "m.names": b"\xff\xfe\x00"}
    refused(judge, ("detect", "evaluate", "data", "--model", "m.onnx"), files, "m.names: is not a text file")


WRITERS = {
    "plan": ("plan", "clusters", "--out"),
    "run": ("run", "mine.yaml", "--sensor", "statistical", "--out"),
    "compare": ("compare", "paper", "--seeds", "1", "--sensor", "statistical", "--out"),
    "world": ("world", "export", "mine.yaml", "--out"),
    "dataset": ("dataset",),
    "report": ("report", "run", "--out"),
    "sweep": ("sweep", "s.yaml", "--out"),
    "sweep report": ("report", "sweep", "--out"),
    "tune": ("tune", "mine.yaml", "--out"),
    "validate": ("calibrate", "validate", "--out"),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_results_that_cannot_be_written_there(judge, inputs, writer):
    files = inputs.good | inputs.swept
    for place in ("file/x", "x" * 256, "ftp://127.0.0.1:1/x", "zip://x", "/proc/x"):
        refused(judge, (*WRITERS[writer], place), files, place[:4])


@pytest.mark.parametrize("writer", ["plan", "world", "report", "sweep report"])
def test_results_that_do_not_fit_on_the_disk(judge, inputs, writer):
    files = inputs.good | inputs.swept
    refused(judge, (*WRITERS[writer], "new/out"), files, "cannot be made or written to", out_bytes=9000)


def test_a_folder_called_like_markup(judge, inputs):
    for command in (("plan", "clusters", "--out", "x[/y]"), ("report", "run", "--out", "x[/y]")):
        assert "x[/y]" in accepted(judge, command, inputs.good).output
    there = {name.replace("run/", "x[/y]/", 1): content for name, content in inputs.broken_off.items()}
    accepted(judge, ("resume", "x[/y]"), there)
    there = {name.replace("sweep/", "x[/y]/", 1): content for name, content in inputs.swept.items()}
    accepted(judge, ("report", "x[/y]"), there)
    accepted(judge, ("world", "export", "mine.yaml", "--out", "x[/y]"), inputs.good)


@pytest.mark.parametrize(
    "command",
    [
        ("scenarios", "validate", "\x1b[31m.yaml"),
        ("run", "\x1b]0;title\x07"),
        ("plan", "clusters", "--out", "file/\x1b[2J"),
        ("run", "mine.yaml", "--set", "\x1b[31m=1"),
        ("run", "mine.yaml", "--camera", "\x1b[31m"),
        ("report", "\x9b31m"),
        ("plan", "--\x1b[31m"),
        ("\x1b[31m",),
    ],
)
def test_messages_do_not_steer_the_terminal(judge, inputs, command):
    refused(judge, command, inputs.good)


def test_values_of_the_command_line_that_yaml_cannot_read(judge, inputs):
    for value in ("2001-13-45", "[" * 5000, "9" * 5000, "!!python/object:os.system x", "{[]: 1}"):
        refused(judge, ("run", "mine.yaml", "--set", f"search.n_c={value}"), inputs.good, "--set")


def test_numbers_of_json_that_are_none(judge):
    for number in (math.nan, math.inf, 1e300):
        tree = as_json(GEOJSON).replace(b"22.1003", str(number).encode())
        refused(judge, ("plan", "a.geojson"), {"a.geojson": tree}, "a.geojson")


def test_inputs_broken_at_random(judge, inputs):
    wrong = []
    for case in cases(inputs, SAMPLE, seed=1):
        ended, faults = judge(case)
        if faults:
            wrong.append((case.kind, case.command, faults, ended.errors[-300:]))
    assert not wrong
