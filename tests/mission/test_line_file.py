"""Whatever happens to a file of lines, nobody reads from it what was not written."""

import json
import multiprocessing
import zlib
from contextlib import closing, suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.mission.line_file import LineFile, encode, read_lines

RECORDS = [{"t": k / 3, "kind": "state", "name": "Zoë", "p": [k, None]} for k in range(4)]
WHOLE = b"".join(encode(r) for r in RECORDS)


def read(path, content):
    path.write_bytes(content)
    return read_lines(path, "mend it")


def test_lines_are_json_with_the_checksum_of_the_rest():
    line = encode({"t": 0.5, "kind": "end"})
    assert line == b'{"t": 0.5, "kind": "end", "crc": "%08x"}\n' % zlib.crc32(b'{"t": 0.5, "kind": "end"}')
    assert json.loads(line)["kind"] == "end"


def test_a_last_line_torn_at_any_byte_is_left_out_and_written_again(tmp_path):
    path = tmp_path / "lines"
    whole_lines = len(WHOLE) - len(encode(RECORDS[-1]))
    for n_bytes in range(whole_lines, len(WHOLE)):
        assert read(path, WHOLE[:n_bytes]) == RECORDS[:-1]
        with closing(LineFile(path, "mend it")) as file:
            assert file.records == RECORDS[:-1]
            file.append(RECORDS[-1], sync=False)
        assert path.read_bytes() == WHOLE


@settings(deadline=None)
@given(st.integers(0, len(WHOLE) - 1), st.integers(1, 255))
def test_no_changed_byte_goes_unseen(tmp_path_factory, place, change):
    path = tmp_path_factory.getbasetemp() / "flipped"
    damaged = bytearray(WHOLE)
    damaged[place] ^= change
    if place >= len(WHOLE) - len(encode(RECORDS[-1])) - 1:
        assert read(path, bytes(damaged)) in (RECORDS[:-1], RECORDS[:-2])
    else:
        with pytest.raises(UserError, match=r"line \d is damaged, \d before it are sound; mend it"):
            read(path, bytes(damaged))


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_no_content_can_crash_a_reader(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "anything"
    with suppress(UserError):
        assert all(isinstance(record, dict) for record in read(path, content))


def test_the_lines_before_the_damage_are_saved(tmp_path):
    path, aside = tmp_path / "lines", tmp_path / "lines.damaged"
    damaged = WHOLE.replace(b'"p": [2', b'"p": [3')
    path.write_bytes(damaged)
    with closing(LineFile(path, "mend it", aside)) as file:
        assert file.records == RECORDS[:2]
        file.append(RECORDS[2], sync=True)
    assert read_lines(path, "mend it") == RECORDS[:3]
    assert aside.read_bytes() == damaged


def test_lines_without_checksums_of_an_older_version_may_come_first(tmp_path):
    path = tmp_path / "lines"
    old = "".join(json.dumps(r) + "\n" for r in RECORDS[:2]).encode()
    path.write_bytes(old)
    with closing(LineFile(path, "mend it")) as file:
        file.append(RECORDS[2], sync=False)
    assert read_lines(path, "mend it") == RECORDS[:3]
    with pytest.raises(UserError, match="line 3 is damaged"):
        read(path, encode(RECORDS[0]) * 2 + old)


def test_lines_can_be_cut_off_before_others_are_written(tmp_path):
    path = tmp_path / "lines"
    path.write_bytes(WHOLE)
    with closing(LineFile(path, "mend it")) as file:
        file.cut(1)
        assert file.records == RECORDS[:1]
        file.append(RECORDS[3], sync=True)
    assert path.read_bytes() == encode(RECORDS[0]) + encode(RECORDS[3])


def test_two_processes_cannot_write_one_file(tmp_path):
    path = tmp_path / "lines"
    with closing(LineFile(path, "mend it")), multiprocessing.get_context("spawn").Pool(1) as other:
        assert other.apply(refusal, (path,)) == (
            f"{path}: another skysweep is writing it; wait until that one has ended, or stop it"
        )
    with closing(LineFile(path, "mend it")) as again:
        assert again.records == []


def refusal(path):
    try:
        LineFile(path, "mend it")
    except UserError as error:
        return str(error)


def test_a_place_where_nothing_can_be_written_is_said(tmp_path):
    with pytest.raises(UserError, match=r"cannot be written \(Is a directory\); choose another place"):
        LineFile(tmp_path, "mend it")
