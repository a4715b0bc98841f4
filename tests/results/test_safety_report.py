"""What the report of a mission says about safety."""

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.results.metrics import compute_summary
from skysweep.results.reporting.wording import safety_words
from skysweep.results.run_folder import Run
from skysweep.results.run_report import write_run_report
from skysweep.scenarios.model import Scenario


def test_refused_checks_and_unchecked_places_are_in_the_report(tmp_path):
    scenario = Scenario.model_validate(
        {
            "name": "small",
            "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
            "home": {"position_enu_m": [-5, -5]},
            "targets": [{"class": "stop sign", "position_enu_m": [45, 12], "size_m": 0.9}],
            "camera": {"hfov_rad": 1.2},
            "safety": {"no_fly_enu_m": [[[40, 7], [50, 7], [50, 17], [40, 17]]]},
        }
    )
    journal = MemoryJournal()
    fly(build_mission(scenario, 0, Rig("statistical")), journal)
    run = Run(scenario, tuple(journal.lines))
    (tmp_path / "map.png").write_bytes(b"")
    text = write_run_report(run, compute_summary(run), tmp_path).read_text("utf-8")
    (refused,) = [line for line in journal.lines if line["kind"] == "safety"]
    assert f"A check is refused: {refused['sentence']}" in text
    (left,) = [line for line in journal.lines if line["kind"] == "unchecked"]
    latitude, longitude, _ = scenario.frame.geodetic_from_enu([left["p"]])[0]
    assert f"<td>{latitude:.7f}</td><td>{longitude:.7f}</td>" in text
    assert "All transects flown, all reachable candidates checked" in text


def run_among_trees(*records):
    tree = {"position_enu_m": [30, 20], "height_m": 12, "crown_radius_m": 3}
    scenario = Scenario.model_validate(
        {
            "name": "wood",
            "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
            "trees": [tree],
            "targets": [{"class": "stop sign", "position_enu_m": [45, 12]}],
        }
    )
    states = [
        {"t": t, "kind": "state", "p": [x, 20, 6], "mode": "CHECK"} for t, x in ((0, 0), (1, 20), (2, 25.5))
    ]
    start = {"t": 0, "kind": "start", "seed": 0}
    return Run(scenario, (start, *states, *records))


def test_what_the_simulator_saw_of_obstacles_is_in_summary_and_report(tmp_path):
    seen = {"t": 3, "kind": "clearance", "collisions": 2, "min_clearance_m": 0.1}
    run = run_among_trees(seen)
    summary = compute_summary(run)
    assert (summary["collisions"], summary["min_clearance_m"]) == (2, 0.1)
    (tmp_path / "map.png").write_bytes(b"")
    text = write_run_report(run, summary, tmp_path).read_text("utf-8")
    assert "The vehicle ran into 2 obstacles." in text
    assert "nearest to an obstacle" in text


def test_without_a_simulator_the_clearance_is_that_of_the_believed_track(tmp_path):
    summary = compute_summary(run_among_trees())
    assert (summary["collisions"], summary["min_clearance_m"]) == (0, 1.5)


def test_candidates_outside_the_area_are_one_line_of_what_happened(tmp_path):
    left = [
        {"t": 3, "kind": "unchecked", "candidate": k, "p": [99, 9, 0], "reason": "outside the area"}
        for k in (4, 5)
    ]
    run = run_among_trees(*left)
    (tmp_path / "map.png").write_bytes(b"")
    text = write_run_report(run, compute_summary(run), tmp_path).read_text("utf-8")
    assert "2 candidates left unchecked" in text
    assert text.count("<td>It lies outside the area that is searched.</td>") == 2


def test_every_action_has_its_words():
    line = {"kind": "safety", "cause": "wind", "sentence": "The wind blows at 12 m/s."}
    told = {
        safety_words(line | {"action": a}) for a in ("CONTINUE", "REFUSE_CHECK", "HOLD", "RETURN", "LAND")
    }
    assert len(told) == 5
    assert "The vehicle holds: The wind blows at 12 m/s." in told
    assert "Note: The wind blows at 12 m/s." in told, "it does not say that a held mission goes on"
    blind = {"kind": "unsearched", "length_m": 41.7, "again": True}
    assert safety_words(blind) == "42 m of the scan turned out to be flown blind; they are scanned again."
    assert "not scanned again" in safety_words(blind | {"again": False})
