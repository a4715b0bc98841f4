from __future__ import annotations

import numpy as np
import pytest
from results_data import state, tiny_records, write_run

from skysweep.errors import UserError
from skysweep.results.run_folder import load_run
from skysweep.results.video.story import Story, event_words


@pytest.fixture
def story(tiny_run):
    return Story(tiny_run, speed=10.0, fps=10)


def at(story, time_s):
    return story.moment(int(np.argmin(np.abs(story.times_s - time_s))))


def test_it_lasts_as_long_as_the_flight_and_lingers_at_the_end(story):
    assert len(story) == 80 + 1 + 20
    assert story.times_s[[0, 40, 80, -1]] == pytest.approx([0, 40, 80, 80])


def test_moments_are_the_states_and_between_them(story):
    at_10, between, at_15 = at(story, 10), at(story, 12.5), at(story, 15)
    assert at_10.position_enu_m == pytest.approx([0, 10, 10])
    assert at_15.position_enu_m == pytest.approx([5, 10, 2])
    assert 2 < between.position_enu_m[2] < 10
    assert (at_10.mode, between.mode, at_15.mode) == ("SCAN", "SCAN", "CHECK")
    assert at_15.altitude_agl_m == pytest.approx(2)
    assert at_15.battery == pytest.approx(0.985)
    assert [m.n_states for m in (at(story, 0), at_10, between, at_15)] == [1, 2, 2, 3]


def test_the_view_turns_smoothly_after_the_flight_and_not_while_it_hovers(story):
    headings = [story.moment(k).heading_rad for k in range(len(story))]
    assert np.abs(np.diff(headings)).max() < 0.5
    assert at(story, 35).heading_rad == pytest.approx(0.0, abs=0.01)  # flew east until there
    assert abs(headings[-1]) > 2.0  # then home, to the west
    assert headings[-20:] == [headings[-1]] * 20


def test_footprint_is_the_picture_on_the_ground(story):
    corners = story.footprint_enu_m(at(story, 10))  # 10 m up, 90 degrees wide, twice as wide as high
    assert np.sort(corners, axis=0) == pytest.approx(np.array([[-10, 5], [-10, 5], [10, 15], [10, 15]]))
    assert story.footprint_enu_m(at(story, 0)) is None


def test_candidates_have_the_standing_of_the_moment(story):
    standing = {}
    for time_s in (10, 12, 18, 25, 70):
        standing[time_s] = {t.id: t.standing for t in story.targets(time_s)}
    assert standing[10] == {}
    assert standing[12] == {1: "scanned"}
    assert standing[18] == {1: "confirmed", 2: "scanned"}
    assert standing[25] == {1: "confirmed", 2: "rejected"}
    assert standing[70][6] == "seen"


def test_events_are_told_in_words_once_they_happened(story):
    assert story.happened(0) == [(0, "Take-off")]
    assert (16, "Candidate 1 confirmed") in story.happened(16)
    assert (16, "Candidate 1 confirmed") not in story.happened(15.9)
    assert [words for _, words in story.happened(80)][-2:] == ["Landed", "Mission ended: completed"]


def test_no_text_of_a_journal_steers_the_terminal():
    told = event_words({"kind": "safety", "action": "RETURN", "sentence": "wind \x1b[31m\n"})
    assert told.startswith("The vehicle turns home: wind")
    assert told.isprintable()


def test_a_mission_without_its_end_says_so(tmp_path):
    story = Story(load_run(write_run(tmp_path / "run", tiny_records()[:12])), 10.0, 10)
    assert story.happened(99)[-1] == (17, "The journal ends here: broken off, or still flying")


def test_a_single_state_is_a_story_and_none_is_refused(tmp_path):
    start, plan = tiny_records()[:2]
    one = Story(
        load_run(write_run(tmp_path / "one", [start, plan, state(0, [0, 10, 0], "TAKEOFF")])), 10.0, 10
    )
    assert one.moment(len(one) - 1).position_enu_m == pytest.approx([0, 10, 0])
    with pytest.raises(UserError, match="no position"):
        Story(load_run(write_run(tmp_path / "none", [start, plan])), 10.0, 10)
