"""The journal survives what missions do not."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skysweep.errors import UserError
from skysweep.mission.journal import FileJournal, MemoryJournal, read_journal


def test_lines_come_back_as_plain_rounded_data(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal = FileJournal(path)
    journal.write(1.23456789, "state", p=np.array([1.000049, 2.0, 3.0]), d_c_m=math.inf, mode="SCAN")
    journal.close()
    assert list(read_journal(path)) == [
        {"t": 1.2346, "kind": "state", "p": [1.0, 2.0, 3.0], "d_c_m": "inf", "mode": "SCAN"}
    ]


def test_memory_and_file_say_the_same(tmp_path):
    path = tmp_path / "journal.jsonl"
    memory, file = MemoryJournal(), FileJournal(path)
    for journal in (memory, file):
        journal.write(0.0, "start", seed=3)
        journal.write(0.5, "confirmed", candidate=2, p=(1.0, 2.0, 0.0))
    file.close()
    assert list(read_journal(path)) == memory.lines


@settings(deadline=None)
@given(
    arrays(float, (3,), elements=st.floats(allow_nan=False, allow_infinity=False))
    | arrays(float, (2, 2), elements=st.integers(-(10**7), 10**7).map(lambda k: k / 2e4))
)
def test_arrays_are_rounded_as_their_numbers_are(values):
    journal = MemoryJournal()
    journal.write(0.0, "state", p=values, q=values.tolist())
    assert repr(journal.lines[0]["p"]) == repr(journal.lines[0]["q"])


def test_infinity_in_an_array_is_said_in_words():
    journal = MemoryJournal()
    journal.write(0.0, "state", p=np.array([1.0, math.inf]))
    assert journal.lines[0]["p"] == [1.0, "inf"]


def test_a_torn_last_line_is_left_out(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"t": 0, "kind": "start"}\n{"t": 1, "ki')
    assert [line["kind"] for line in read_journal(path)] == ["start"]


def test_a_broken_line_in_the_middle_says_what_is_sound(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_text('{"t": 0, "kind": "start"}\n{"t": 1, "ki\n{"t": 2, "kind": "end"}\n')
    with pytest.raises(UserError, match=r"line 2 cannot be read; the 1 lines before it are sound"):
        list(read_journal(path))


def test_reopening_appends(tmp_path):
    path = tmp_path / "journal.jsonl"
    for k in range(2):
        journal = FileJournal(path)
        journal.write(float(k), "state")
        journal.close()
    assert [line["t"] for line in read_journal(path)] == [0.0, 1.0]
