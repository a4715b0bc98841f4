"""The journal survives what missions do not."""

import math
import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skysweep.errors import UserError
from skysweep.mission.journal import FileJournal, MemoryJournal, line_of, read_journal


def test_lines_come_back_as_plain_rounded_data(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal = FileJournal(path)
    journal.write(1.23456789, "state", p=np.array([1.000049, 2.0, 3.0]), d_c_m=math.inf, mode="SCAN")
    journal.close()
    assert read_journal(path) == [
        {"t": 1.2346, "kind": "state", "p": [1.0, 2.0, 3.0], "d_c_m": "inf", "mode": "SCAN"}
    ]


@pytest.mark.parametrize(
    ("replays", "synced"),
    [(False, ["setup", "start", "confirmed", "operator", "end"]), (True, ["setup", "operator", "end"])],
)
def test_the_disk_has_what_a_resumed_mission_does_not_make_again(tmp_path, monkeypatch, replays, synced):
    calls = []
    monkeypatch.setattr("skysweep.files.line_file.os.fsync", calls.append)
    with closing(FileJournal(tmp_path / "journal.jsonl")) as journal:
        journal.replays = replays
        on_disk = []
        for kind in ("setup", "start", "state", "look", "confirmed", "operator", "end"):
            calls.clear()
            journal.write(0.0, kind)
            on_disk += [kind] * len(calls)
    assert on_disk == synced


def test_memory_and_file_say_the_same(tmp_path):
    path = tmp_path / "journal.jsonl"
    memory, file = MemoryJournal(), FileJournal(path)
    for journal in (memory, file):
        journal.write(0.0, "start", seed=3)
        journal.write(0.5, "confirmed", candidate=2, p=(1.0, 2.0, 0.0))
    file.close()
    assert read_journal(path) == memory.lines


@given(
    arrays(float, (3,), elements=st.floats(allow_nan=False, allow_infinity=False))
    | arrays(float, (2, 2), elements=st.integers(-(10**7), 10**7).map(lambda k: k / 2e4))
)
def test_arrays_are_rounded_as_their_numbers_are(values):
    journal = MemoryJournal()
    journal.write(0.0, "state", p=values, q=values.tolist())
    assert repr(journal.lines[0]["p"]) == repr(journal.lines[0]["q"])


_NUMBERS = st.floats(allow_nan=False) | st.integers(-(10**7), 10**7).map(lambda k: k / 2e4)
_VALUES = st.one_of(
    _NUMBERS,
    st.booleans(),
    st.sampled_from(["SCAN", None, {}, (1.0, 2)]),
    arrays(float, (3,), elements=_NUMBERS),
    arrays(float, st.sampled_from([(0, 2), (2, 2)]), elements=_NUMBERS),
)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["state", "sighting", "look"]), st.floats(0, 1e6), _NUMBERS, _VALUES, _VALUES
        )
    )
)
def test_lines_made_together_are_those_made_one_by_one(told):
    together = MemoryJournal()
    alone = []
    for kind, time_s, number, value, inner in told:
        fields = {"a": number, "p": value, "cam": {"q": inner}}
        together.write(time_s, kind, **fields)
        alone.append(line_of(time_s, kind, fields))
    assert repr(together.lines) == repr(alone)


def test_infinity_in_an_array_is_said_in_words():
    journal = MemoryJournal()
    journal.write(0.0, "state", p=np.array([1.0, math.inf]))
    assert journal.lines[0]["p"] == [1.0, "inf"]


def test_looks_and_snapshots_keep_every_digit(tmp_path):
    path = tmp_path / "journal.jsonl"
    third = np.array([[1.0, 2.0]]) / 3.0
    with closing(FileJournal(path)) as journal:
        journal.write(0.1, "look", boxes=third, names=("person",))
        journal.write(0.1, "snapshot", strategy={"places": [1 / 3, None], "far": math.inf})
    look, snapshot = read_journal(path)
    assert look["boxes"] == third.tolist()
    assert snapshot["strategy"] == {"places": [1 / 3, None], "far": "inf"}


def test_a_damaged_line_in_the_middle_says_how_the_sound_ones_are_saved(tmp_path):
    path = tmp_path / "journal.jsonl"
    with closing(FileJournal(path)) as journal:
        for k in range(3):
            journal.write(k, "state")
    path.write_bytes(path.read_bytes().replace(b'"t": 1,', b'"t": 7,'))
    with pytest.raises(
        UserError, match=r"line 2 is damaged, 1 before it .* report .*--from-sound-lines .*resume .*lines"
    ):
        read_journal(path)
    with pytest.raises(UserError, match="line 2 is damaged"):
        FileJournal(path)


def test_of_a_full_disk_the_journal_says_so_once_and_stays_sound(tmp_path):
    """A limit on the file's size is what a full disk looks like to one process."""
    path = tmp_path / "journal.jsonl"
    program = """
import resource, signal, sys
from pathlib import Path
from skysweep.mission.journal import FileJournal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
journal = FileJournal(Path(sys.argv[1]))
told = [journal.write(k, "state", p=[1.0, 2.0, 3.0]) or journal.failed for k in range(40)]
print(told[0], "|", told[-1], "|", len(set(told)))
"""
    run = subprocess.run([sys.executable, "-c", program, path], capture_output=True, text=True, check=True)
    before, after, kinds = run.stdout.strip().split(" | ")
    assert (before, kinds) == ("None", "2")
    assert after == f"{path}: nothing more can be written (File too large); what it holds is sound"
    assert [line["t"] for line in read_journal(path)] == list(range(len(read_journal(path))))
    assert 900 < path.stat().st_size <= 1000
    assert path.read_bytes().endswith(b"\n")


def test_reopening_appends(tmp_path):
    path = tmp_path / "journal.jsonl"
    for k in range(2):
        journal = FileJournal(path)
        journal.write(float(k), "state")
        journal.close()
    assert [line["t"] for line in read_journal(path)] == [0.0, 1.0]
