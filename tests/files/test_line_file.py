"""Whatever happens to a file of lines, nobody reads from it what was not written."""

import json
import multiprocessing
import zlib
from contextlib import closing, suppress
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skysweep.errors import UserError
from skysweep.files.line_file import LineFile, read_lines, read_sound_lines, scan_lines

RECORDS = [{"t": k / 3, "kind": "state", "name": "Zoë", "p": [k, None]} for k in range(4)]


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    """Each line of a file, its end included."""
    return written(tmp_path_factory.mktemp("lines") / "lines", RECORDS)


@pytest.fixture(scope="module")
def whole(lines):
    return b"".join(lines)


def written(path, records):
    with closing(LineFile(path, "mend it")) as file:
        for record in records:
            file.append(record, sync=False)
    return path.read_bytes().splitlines(keepends=True)


def read(path, content):
    path.write_bytes(content)
    return read_lines(path, "mend it")


def test_a_chained_checksum_goes_on_from_that_of_the_line_before(tmp_path):
    before = 0
    for line, record in zip(written(tmp_path / "lines", RECORDS), RECORDS, strict=True):
        before = zlib.crc32(json.dumps(record).encode(), before)
        assert json.loads(line) == record | {"chain": f"{before:08x}"}
    assert read_sound_lines(tmp_path / "lines").seal == before


def test_a_last_line_torn_at_any_byte_is_left_out_and_written_again(tmp_path, lines, whole):
    path = tmp_path / "lines"
    for n_bytes in range(len(whole) - len(lines[-1]), len(whole)):
        assert read(path, whole[:n_bytes]) == RECORDS[:-1]
        with closing(LineFile(path, "mend it")) as file:
            assert file.records == RECORDS[:-1]
            file.append(RECORDS[-1], sync=False)
        assert path.read_bytes() == whole


@pytest.mark.parametrize("torn", [b"", b'{"t": 1.3, "kind": "sta'])
def test_every_single_bit_counts(whole, torn):
    """But for those of a torn line, which is left out as it is."""
    for bit in range(8 * len(whole)):
        flipped = bytearray(whole + torn)
        flipped[bit // 8] ^= 1 << bit % 8
        found = scan_lines(bytes(flipped))
        assert found.damaged is not None, f"bit {bit} of {len(whole)} bytes"
        assert found.records == RECORDS[: found.damaged - 1]


@given(place=st.integers(0), change=st.integers(1, 255))
def test_no_changed_byte_goes_unseen(whole, place, change):
    changed = bytearray(whole)
    changed[place % len(whole)] ^= change
    assert scan_lines(bytes(changed)).damaged is not None


def test_a_chained_line_that_is_missing_doubled_or_elsewhere_is_found(tmp_path):
    lines = written(tmp_path / "lines", RECORDS)
    for k, _ in enumerate(lines[:-1]):
        assert scan_lines(b"".join(lines[:k] + lines[k + 1 :])).damaged == k + 1
    for k, _ in enumerate(lines):
        assert scan_lines(b"".join([*lines[: k + 1], *lines[k:]])).damaged == k + 2
    for k, (line, next_line) in enumerate(pairwise(lines)):
        assert scan_lines(b"".join([*lines[:k], next_line, line, *lines[k + 2 :]])).damaged == k + 1


@given(st.binary(max_size=300))
def test_no_content_can_crash_a_reader(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "anything"
    with suppress(UserError):
        assert all(isinstance(record, dict) for record in read(path, content))


def test_the_lines_before_the_damage_are_saved(tmp_path, whole):
    path, aside = tmp_path / "lines", tmp_path / "lines.damaged"
    damaged = whole.replace(b'"p": [2', b'"p": [3')
    path.write_bytes(damaged)
    with closing(LineFile(path, "mend it", aside)) as file:
        assert file.records == RECORDS[:2]
        assert path.read_bytes() == damaged, "nothing changes before something is written"
        file.append(RECORDS[2], sync=True)
    assert read_lines(path, "mend it") == RECORDS[:3]
    assert aside.read_bytes() == damaged


def test_opening_changes_nothing(tmp_path, whole):
    """A file of one torn line: whatever it is, it is not ours to empty."""
    for content in (b"root:x:0:0", whole + b'{"t": 9'):
        (tmp_path / "lines").write_bytes(content)
        with closing(LineFile(tmp_path / "lines", "mend it")):
            pass
        assert (tmp_path / "lines").read_bytes() == content


def test_links_and_devices_are_refused(tmp_path):
    (tmp_path / "elsewhere").write_bytes(b"root:x:0:0")
    (tmp_path / "lines").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UserError, match=r"cannot be written \(it is a link\)"):
        LineFile(tmp_path / "lines", "mend it")
    assert (tmp_path / "elsewhere").read_bytes() == b"root:x:0:0"
    (tmp_path / "lines").unlink()
    (tmp_path / "lines").symlink_to("/dev/zero")
    with pytest.raises(UserError, match="is no file; put the file itself there"):
        read_lines(tmp_path / "lines", "mend it")


def test_lines_of_an_older_version_may_come_first(tmp_path):
    path = tmp_path / "lines"
    bare = [json.dumps(record).encode() + b"\n" for record in RECORDS]
    single = bare[1][:-2] + b', "crc": "%08x"}\n' % zlib.crc32(bare[1][:-1])
    path.write_bytes(bare[0] + single)
    written(path, RECORDS[2:])
    assert read_lines(path, "mend it") == RECORDS
    chained = written(tmp_path / "chained", RECORDS[:1])[0]
    for first, second in ((chained, bare[0]), (chained, single), (single, bare[0])):
        with pytest.raises(UserError, match="line 2 is damaged"):
            read(path, first + second)


def test_lines_can_be_cut_off_before_others_are_written(tmp_path, whole):
    path = tmp_path / "lines"
    path.write_bytes(whole)
    with closing(LineFile(path, "mend it")) as file:
        file.cut(1)
        assert file.records == RECORDS[:1]
        file.append(RECORDS[3], sync=True)
    content = path.read_bytes()
    path.unlink()
    assert content == b"".join(written(path, [RECORDS[0], RECORDS[3]]))


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


def test_half_a_character_is_told_as_a_whole_one(tmp_path):
    names = ["half \udc80 of one", "\\udc80", "whole \U0001f681"]
    written(tmp_path / "lines", [{"name": name} for name in names])
    told = [record["name"] for record in read_lines(tmp_path / "lines", "mend it")]
    assert told == ["half ? of one", *names[1:]]
