from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from results_data import NADIR, event, state, tiny_records, write_run

from skysweep.results.metrics import compute_summary, match, seen_area, travelled_m, whole_summary
from skysweep.results.run_folder import Run, load_flown, load_run
from skysweep.scenarios.model import Scenario


def test_summary_of_the_tiny_mission(tiny_run):
    s = compute_summary(tiny_run, scan_only_time_s=45.0, wall_time_s=8.0)
    assert s["scenario"] == "tiny"
    assert (s["n_c"], s["d_c_m"]) == (1, "inf")
    assert s["mission_time_s"] == 60
    assert s["return_time_s"] == 20
    assert s["total_time_s"] == 80
    assert s["scan_only_time_s"] == 45
    assert (s["n_targets"], s["n_confirmed"]) == (3, 2)
    assert s["recall"] == pytest.approx(2 / 3)
    assert s["time_to_confirm_s"] == [16, 40, None]
    assert s["pos_curve"] == [[0, 0], [16, 1 / 3], [40, 2 / 3], [60, 2 / 3]]
    assert (s["n_scanned"], s["n_checks"], s["n_checked"]) == (3, 3, 5)
    assert s["false_scans"] == 3  # 2 (second candidate), 4 (duplicate), 5 (bucket)
    assert s["false_positives"] == 2
    assert s["duplicates"] == 1
    assert s["wrong_rejections"] == 0
    assert s["median_localisation_error_m"] == pytest.approx(0.75)
    # up 10; down 8 and 5 east; up 8; 15 east; home and down are not part of the mission time
    assert s["vertical_m"] == 26
    assert s["path_length_m"] == pytest.approx(10 + np.hypot(5, 8) + 8 + 15, abs=0.01)
    assert s["energy_wh"] == 6
    assert s["total_energy_wh"] == 8
    assert s["real_time_factor"] == 10


def test_area_covered_is_the_union_of_the_scan_pictures(tiny_run):
    # Pictures of 20 m x 10 m around x = 0, 5, 20 at y = 10: x from 0 to 30, y from 5 to 15.
    assert seen_area(tiny_run).area == pytest.approx(300)
    assert compute_summary(tiny_run)["area_covered"] == pytest.approx(300 / 800)


CROWN = {"position_enu_m": [20, 10], "height_m": 4, "crown_radius_m": 2}


def covered_m2(folder, *eyes, **changes):
    records = [tiny_records()[0], *(state(k, list(eye)) for k, eye in enumerate(eyes))]
    return compute_summary(load_run(write_run(folder, records, **changes)))["area_covered_m2"]


def test_ground_below_a_crown_counts_as_seen_only_where_a_picture_reaches_below_it(tmp_path):
    # The line from 10 m that touches the crown (half axes 2 and 1.3 m, centre 2.7 m up) meets the ground
    # 2.76 m from the trunk. Pictures from 9 m to either side look in below the crown, which ends 1.4 m up.
    above = covered_m2(tmp_path / "above", (20, 10, 10), trees=[CROWN])
    assert above == pytest.approx(200 - np.pi * 2.756**2, abs=2)
    assert covered_m2(tmp_path / "bare", (20, 10, 10)) == 200
    beside = covered_m2(tmp_path / "beside", (20, 10, 10), (11, 10, 10), (29, 10, 10), trees=[CROWN])
    assert beside == pytest.approx(38 * 10, abs=0.5)


def test_ground_in_a_building_is_not_seen(tmp_path):
    house = {"position_enu_m": [20, 10], "size_m": [6, 4], "height_m": 0.3}
    assert covered_m2(tmp_path, (20, 10, 10), buildings=[house]) == pytest.approx(200 - 24, abs=4)


def test_picture_turned_by_90_degrees_covers_the_other_way(tmp_path):
    run = load_run(write_run(tmp_path, [tiny_records()[0], state(0, [20, 10, 10], R=NADIR)]))
    assert seen_area(run).bounds == pytest.approx((15, 0, 25, 20))


def test_ground_that_was_flown_over_blind_is_not_seen(tmp_path):
    """From the first picture that is doubted, or that nobody looked at, to the next answer that counts."""
    eyes = [state(float(t), [5.0 * t, 10, 10]) for t in range(9)]
    answers = {1: {}, 3: {"doubt": ["shows black", 2.0]}, 4: {"failure": "no answer"}, 6: {}}
    looks = [event(t + 0.2, "look") | fields for t, fields in answers.items()]
    run = load_run(write_run(tmp_path, [tiny_records()[0], *sorted(eyes + looks, key=lambda r: r["t"])]))
    assert seen_area(run).area == pytest.approx(10 * 15 + 10 * 20)  # east to 15, and from 20 on


def test_ground_of_which_no_picture_came_is_not_seen(tmp_path):
    """Of seconds in which neither an answer nor a failure was taken down only the ends count."""
    setup, start = event(0.0, "setup") | {"sensor": "imaging"}, tiny_records()[0]
    eyes = [state(float(t), [2.0 * t, 10, 10]) for t in range(21)]
    looks = [event(t + 0.2, "look") for t in (*range(4), *range(17, 21))]
    run = load_run(write_run(tmp_path, [setup, start, *sorted(eyes + looks, key=lambda r: r["t"])]))
    assert seen_area(run).area == pytest.approx(10 * 18 + 10 * 18)  # east to 18, and from 22 on


def test_level_camera_has_seen_nothing(tmp_path):
    level = [0, 0, 1, -1, 0, 0, 0, -1, 0]
    run = load_run(write_run(tmp_path, [tiny_records()[0], state(0, [20, 10, 10], R=level)]))
    assert seen_area(run).area == 0


def test_mission_broken_off_counts_what_was_done(tmp_path):
    records = [r for r in tiny_records() if r["t"] <= 41]
    s = compute_summary(load_run(write_run(tmp_path, records)))
    assert not s["completed"]
    assert s["end_reason"] == "broken off"
    assert s["mission_time_s"] == 40
    assert s["return_time_s"] is None
    assert s["n_confirmed"] == 2


def test_low_battery_ends_the_search_where_the_way_home_begins(tmp_path):
    records = [r for r in tiny_records() if r["kind"] != "finished" and r["t"] != 50]
    records[-1] = {"t": 80, "kind": "end", "reason": "low battery"}
    s = compute_summary(load_run(write_run(tmp_path, records)))
    assert (s["completed"], s["end_reason"]) == (False, "low battery")
    assert (s["mission_time_s"], s["return_time_s"], s["total_time_s"]) == (60, 20, 80)


@pytest.mark.parametrize("changes", [{"targets": []}, {}])
def test_without_truth_nothing_is_judged(tmp_path, changes):
    setup = {"t": 0.0, "kind": "setup"} | ({} if changes else {"truth": False})
    s = compute_summary(load_run(write_run(tmp_path, [setup, *tiny_records()], **changes)))
    judged = (
        "n_targets recall time_to_confirm_s pos_curve false_scans false_positives duplicates "
        "wrong_rejections median_localisation_error_m"
    )
    assert {key: s[key] for key in judged.split()} == dict.fromkeys(judged.split())
    assert (s["n_confirmed"], s["n_checked"], s["mission_time_s"]) == (4, 5, 60)


def run_with(verdicts, targets=((5, 10), (20, 10), (35, 10))) -> Run:
    scenario = Scenario.model_validate(
        {
            "name": "match",
            "area": {"polygon_enu_m": [[0, 0], [40, 0], [40, 20], [0, 20]]},
            "targets": [{"class": "stop sign", "position_enu_m": p} for p in targets],
        }
    )
    start = {"t": 0, "kind": "start", "seed": 0}
    return Run(scenario, (start, *(event(t, kind, i, p) for i, (t, kind, p) in enumerate(verdicts))))


def test_the_later_of_two_confirmations_is_the_duplicate_even_if_nearer():
    m = match(run_with([(10, "confirmed", [6, 10, 0]), (20, "confirmed", [5, 10, 0])]))
    assert m.confirmed == {0: 0}
    assert m.duplicates == {1}


def test_two_targets_close_together_are_two():
    targets = ((5, 10), (7, 10))
    m = match(run_with([(10, "confirmed", [6.5, 10, 0]), (20, "confirmed", [7.5, 10, 0])], targets))
    assert m.confirmed == {0: 0, 1: 1}
    assert not m.false_positives


def test_match_ends_at_three_metres():
    m = match(run_with([(10, "confirmed", [8.0, 10, 0]), (20, "confirmed", [23.01, 10, 0])]))
    assert m.confirmed == {0: 0}
    assert m.false_alarms == {1}


def test_rejecting_a_target_that_nobody_confirmed_is_no_false_scan():
    m = match(run_with([(10, "rejected", [5, 11, 0]), (20, "rejected", [12, 11, 0])]))
    assert m.wrong_rejections == {0: 0}
    assert m.false_scans == {1}


def test_other_class_does_not_match():
    run = run_with([(10, "confirmed", [5, 10, 0])])
    person = Run(run.scenario, (run.records[0], dict(run.records[1]) | {"class_name": "person"}))
    assert match(person).false_alarms == {0}


xy = st.tuples(st.floats(0, 40), st.floats(0, 20), st.just(0.0))
verdicts = st.lists(st.tuples(st.floats(1, 100), st.sampled_from(["confirmed", "rejected"]), xy), max_size=12)


@given(verdicts)
def test_every_checked_candidate_is_exactly_one_thing(told):
    m = match(run_with(told))
    parts = [set(m.confirmed), m.duplicates, m.false_alarms, set(m.wrong_rejections), m.rejected]
    assert sum(map(len, parts)) == len(told)
    assert set().union(*parts) == set(range(len(told)))
    found = [*m.confirmed.values(), *m.wrong_rejections.values()]
    assert len(found) == len(set(found))


@given(st.lists(st.tuples(*[st.floats(-50, 50)] * 3), max_size=20))
def test_path_is_at_least_as_long_as_its_vertical_part(points):
    path_m, vertical_m = travelled_m(np.array(points, dtype=float).reshape(-1, 3))
    assert path_m >= vertical_m - 1e-9


def test_the_real_time_factor_of_a_continued_flight_is_that_of_its_last_part(tiny_run):
    begun_s = tiny_run.start["t"]
    continued = Run(tiny_run.scenario, (*tiny_run.records, {"t": begun_s + 60.0, "kind": "resumed"}))
    assert compute_summary(continued, wall_time_s=2.0)["real_time_factor"] == 10


def test_the_scan_alone_is_timed_from_the_height_that_is_covered(tiny_run):
    high, low = (
        whole_summary(Run(tiny_run.scenario.with_search(strategy=strategy), tiny_run.records))
        for strategy in ("scan-only", "low-only")
    )
    assert low["scan_only_time_s"] > 1.2 * high["scan_only_time_s"]


def test_the_energy_of_a_continued_flight_adds_up(tmp_path):
    """The counter begins again with the program: 2 + 1 Wh before it, and 3 in the air after a battery."""

    def flying(t, wh):
        return state(t, [5, 10, 10]) | {"energy_wh": wh}

    records = [
        tiny_records()[0],
        *(flying(t, wh) for t, wh in ((10, 1.0), (20, 2.0))),
        {"t": 25, "kind": "resumed"},
        *(flying(t, wh) for t, wh in ((30, 0.0), (40, 1.0))),
        {"t": 41, "kind": "sortie", "number": 1, "why": "battery low", "battery": 0.2, "energy_wh": 1.0},
        {"t": 50, "kind": "next_sortie", "number": 2, "why": "", "battery": 1.0, "energy_wh": 1.0},
        *(flying(t, wh) for t, wh in ((51, 1.0), (60, 4.0))),
    ]
    run = load_flown(write_run(tmp_path, records))
    assert [sortie.energy_wh for sortie in run.sorties] == pytest.approx([3.0, 3.0])
    assert compute_summary(run)["total_energy_wh"] == pytest.approx(6.0)


@pytest.mark.parametrize("mode", ["SCAN", "CHECK"])
def test_what_was_seen_does_not_depend_on_the_modes_name(tmp_path, mode):
    eyes = [state(k, eye, mode) for k, eye in enumerate(([5, 10, 10], [20, 10, 3]))]
    run = load_run(write_run(tmp_path, [tiny_records()[0], *eyes]))
    assert seen_area(run).area == pytest.approx(150 + 18)


def test_from_too_high_nothing_counts_as_seen(tmp_path):
    """A sign of 0.75 m spans 8 pixels from 30 m through this lens."""
    assert covered_m2(tmp_path / "near", (20, 10, 29)) > 700
    assert covered_m2(tmp_path / "far", (20, 10, 31)) == 0
    assert covered_m2(tmp_path / "as planned", (20, 10, 31), search={"scan_altitude_agl_m": 31}) > 700


def test_of_an_oblique_picture_only_the_near_part_counts(tmp_path):
    """Looking 45 degrees down to the east, signs have 8 pixels where they are 30 m away along the axis."""
    s = np.sqrt(0.5)
    ahead = state(0, [0, 10, 15], R=[0, -s, s, -1, 0, 0, 0, -s, -s])
    run = load_run(write_run(tmp_path, [tiny_records()[0], ahead]))
    assert seen_area(run).bounds[2] == pytest.approx((30.0 - 15.0 * s) / s)
