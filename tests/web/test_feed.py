"""What a viewer gets of a journal while it grows, is torn, cut off, damaged or of a later version."""

import base64
import json
import shutil

import numpy as np
import pytest

from skysweep.files.line_file import LineFile
from skysweep.results.pod import CoverageMap
from skysweep.results.run_folder import load_run
from skysweep.web import feed as feeds
from skysweep.web.feed import Feed, Place


def all_news(feed, place=None):
    """All messages of a viewer until there is nothing new, by type."""
    place = place or Place()
    told = {}
    while True:
        more = feed.refresh() or feed.cover()
        messages = [json.loads(message) for message in feed.news(place)]
        for message in messages:
            told.setdefault(message["type"], []).append(message)
        if not (messages or more):
            return told


def lines_of(told):
    return [line for message in told.get("lines", ()) for line in message["lines"]]


def written(run):
    records = [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    return [{k: v for k, v in record.items() if k != "chain"} for record in records]


@pytest.fixture
def growing(run, tmp_path):
    """An empty run folder, and the bytes of its journal to come."""
    folder = tmp_path / "growing"
    folder.mkdir()
    shutil.copy(run / "config.yaml", folder)
    return folder, (run / "journal.jsonl").read_bytes()


def test_a_finished_mission_comes_whole_in_order_and_without_checksums(run):
    told = all_news(Feed(run))
    assert lines_of(told) == written(run)
    assert told["lines"][0]["from"] == 0
    assert told["status"] == [{"type": "status", "flying": False, "ended": True, "error": None}]


def test_the_film_is_named_by_its_looks_and_pictures_by_their_candidates(run):
    told = all_news(Feed(run))
    times = [time for message in told["film"] for time in message["times"]]
    looks = {f"{line['t']:.4f}" for line in written(run) if line["kind"] == "look"}
    assert len(times) > 10
    assert set(times) <= looks
    assert times == sorted(times, key=float)
    candidate, name = next(iter(told["pictures"][-1]["of"].items()))
    assert name.startswith(f"candidate-{candidate}-")


@pytest.mark.parametrize("step", [37, 1000, 10_000])
def test_a_journal_that_grows_by_any_pieces_comes_line_by_line(growing, step, monkeypatch):
    folder, data = growing
    data = data[:30_000]
    monkeypatch.setattr(feeds, "_READ_BYTES", 64)  # much less than a line
    feed, place, lines = Feed(folder), Place(), []
    for end in range(0, len(data) + step, step):
        (folder / "journal.jsonl").write_bytes(data[:end])
        lines += lines_of(all_news(feed, place))
        assert feed.status.error is None
    whole = data[: data.rindex(b"\n") + 1]
    assert [line["t"] for line in lines] == [json.loads(line)["t"] for line in whole.splitlines()]


def test_two_viewers_have_their_own_places(run):
    feed = Feed(run)
    first = all_news(feed)
    later = all_news(feed, Place(line=5))
    assert later["lines"][0]["from"] == 5
    assert lines_of(first)[5:] == lines_of(later)


def test_a_slow_viewer_gets_a_bounded_batch_at_a_time(run, monkeypatch):
    monkeypatch.setattr(feeds, "BATCH_BYTES", 2000)
    feed, place = Feed(run), Place()
    while feed.refresh():
        pass
    assert max(len(message) for message in feed.news(place)) < 6000
    assert lines_of(all_news(feed, place))


def test_a_viewer_that_comes_back_before_the_journal_is_read_again_keeps_its_place(run, monkeypatch):
    monkeypatch.setattr(feeds, "_READ_BYTES", 500)
    n = len(written(run))
    told = all_news(Feed(run), Place(line=n - 3))
    assert told["lines"][0]["from"] == n - 3


def test_a_journal_cut_off_by_a_resumption_begins_anew(growing):
    folder, data = growing
    journal = folder / "journal.jsonl"
    journal.write_bytes(data)
    feed, place = Feed(folder), Place()
    all_news(feed, place)
    shorter = data[: data.index(b"\n", len(data) // 2) + 1]
    journal.write_bytes(shorter)
    told = all_news(feed, place)
    assert told["lines"][0]["from"] == 0
    assert len(lines_of(told)) == shorter.count(b"\n")
    assert not told["status"][-1]["ended"]


def test_a_damaged_line_is_named_and_those_before_it_are_shown(run):
    journal = run / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    lines[20] = lines[20].replace(b'"t": ', b'"t": 1')
    journal.write_bytes(b"".join(lines))
    told = all_news(Feed(run))
    assert len(lines_of(told)) == 20
    assert (
        told["status"][-1]["error"] == "Line 21 of journal.jsonl is damaged; the mission is shown up to it."
    )


def test_what_no_mission_wrote_is_not_shown(run):
    journal = run / "journal.jsonl"
    journal.unlink()
    file = LineFile(journal, "")
    file.append({"t": 0.0, "kind": "start", "seed": 0}, sync=False)
    file.append({"t": 1.0, "kind": "state", "p": "<script>"}, sync=False)
    file.close()
    told = all_news(Feed(run))
    assert len(lines_of(told)) == 1
    assert told["status"][-1]["error"] == "Line 2 of journal.jsonl was not written by a mission."


@pytest.mark.parametrize(
    "line",
    [
        '{"t": 1.0, "kind": "state", "p": [1e999, 0, 0]}',
        '{"t": 1.0, "kind": "other", "v": NaN}',
        '{"t": 1.0, "kind": "look", "doubt": 3}',
    ],
)
def test_a_line_that_no_browser_can_read_is_not_sent(run, line):
    journal = run / "journal.jsonl"
    journal.write_text('{"t": 0.0, "kind": "start", "seed": 0}\n' + line + "\n")
    told = all_news(Feed(run))
    assert len(lines_of(told)) == 1
    assert told["status"][-1]["error"] == "Line 2 of journal.jsonl was not written by a mission."


def test_a_line_without_end_is_not_read_to_its_end(run, monkeypatch):
    monkeypatch.setattr(feeds, "_READ_BYTES", 1 << 12)
    monkeypatch.setattr(feeds, "_LONGEST_LINE_BYTES", 1 << 16)
    journal = run / "journal.jsonl"
    kept = b"".join(journal.read_bytes().splitlines(keepends=True)[:20])
    journal.write_bytes(kept + b" " * (1 << 20))
    told = all_news(Feed(run))
    assert len(lines_of(told)) == 20
    assert told["status"][-1]["error"] == "Line 21 of journal.jsonl is longer than any that a mission writes."


def test_a_journal_that_is_a_link_is_not_followed(run):
    (run / "journal.jsonl").rename(run.parent / "elsewhere")
    (run / "journal.jsonl").symlink_to(run.parent / "elsewhere")
    told = all_news(Feed(run))
    assert lines_of(told) == []
    assert "is a link" in told["status"][-1]["error"]


def test_a_mission_of_a_later_skysweep_gives_one_sentence(run):
    journal = run / "journal.jsonl"
    journal.unlink()
    file = LineFile(journal, "")
    file.append({"t": 0.0, "kind": "setup", "version": "9.1.0", "seed": 0}, sync=False)
    file.close()
    told = all_news(Feed(run))
    assert lines_of(told) == []
    assert "skysweep 9.1.0" in told["status"][-1]["error"]
    assert "update it" in told["status"][-1]["error"]


def test_a_mission_that_has_not_begun_says_so_and_is_shown_once_it_has(growing):
    folder, data = growing
    feed, place = Feed(folder), Place()
    assert "has not begun" in all_news(feed, place)["status"][-1]["error"]
    (folder / "journal.jsonl").write_bytes(data)
    told = all_news(feed, place)
    assert len(lines_of(told)) == data.count(b"\n")
    assert told["status"][-1]["error"] is None


def test_a_mission_that_is_being_flown_flies_until_its_end(growing):
    folder, data = growing
    journal = folder / "journal.jsonl"
    feed = Feed(folder, is_live=True)
    assert feed.status.flying
    journal.write_bytes(data[: len(data) // 2])
    all_news(feed)
    assert feed.status.flying
    journal.write_bytes(data)
    all_news(feed)
    assert not feed.status.flying
    assert feed.status.ended


def test_snapshots_are_kept_from_the_page(run):
    journal = run / "journal.jsonl"
    file = LineFile(journal, "")
    file.append({"t": 999.0, "kind": "snapshot", "strategy": {}, "tracker": {}}, sync=False)
    file.close()
    assert {line["kind"] for line in lines_of(all_news(Feed(run)))}.isdisjoint({"snapshot"})


def test_coverage_grows_with_the_journal_and_ends_as_the_map_of_the_whole_mission(run):
    frames = all_news(Feed(run))["coverage"]
    pods = [np.frombuffer(base64.b64decode(frame["pod"]), np.uint8) for frame in frames]
    assert len(pods) > 3
    assert pods[0].mean() < pods[-1].mean()
    flown = load_run(run)
    whole = CoverageMap.of(flown.scenario)
    for record in flown.records:
        whole.add(record)
    assert np.array_equal(pods[-1], np.rint(255 * whole.pod()).astype(np.uint8).ravel())
    assert pods[-1].max() > 200
