"""Files that are written whole or not at all, on disks that are full and places that cannot be written."""

import pickle
import subprocess
import sys

import pytest

from skysweep.errors import CannotWriteError, UserError
from skysweep.files.writing import make_folder, replace_file, whole_files


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def fail(folder, error):
    with whole_files(folder) as unfinished:
        (unfinished / "x.txt").write_text("half")
        raise error


def test_files_are_there_when_the_block_ends_and_replace_those_of_before(tmp_path):
    out = tmp_path / "a" / "b"
    for text in ("first", "second"):
        with whole_files(out) as unfinished:
            (unfinished / "inner").mkdir()
            (unfinished / "inner" / "x.txt").write_text(text)
            assert text == "second" or names(out) == [
                unfinished.name,
                f"{unfinished.name}/inner",
                f"{unfinished.name}/inner/x.txt",
            ]
        assert names(out) == ["inner", "inner/x.txt"]
        assert (out / "inner" / "x.txt").read_text() == text


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt()])
def test_a_block_that_fails_leaves_nothing(tmp_path, error):
    with pytest.raises(type(error)):
        fail(tmp_path / "a" / "b", error)
    assert names(tmp_path) == []


def test_a_block_that_fails_leaves_what_was_there(tmp_path):
    (tmp_path / "x.txt").write_text("whole")
    with pytest.raises(ValueError):
        fail(tmp_path, ValueError())
    assert (tmp_path / "x.txt").read_text() == "whole"
    assert names(tmp_path) == ["x.txt"]


FULL = """
import resource, signal, sys
from pathlib import Path
from skysweep.errors import CannotWriteError
from skysweep.files.writing import whole_files, replace_file
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    with whole_files(Path(sys.argv[1])) as unfinished:
        (unfinished / "a.txt").write_bytes(bytes(900))
        (unfinished / "b.txt").write_bytes(bytes(5000))
except CannotWriteError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_full_disk_leaves_nothing_and_is_one_sentence(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "out")], capture_output=True, text=True, timeout=60
    )
    out = tmp_path / "out"
    assert done.stdout == f"--out {out}: cannot be made or written to (File too large); choose another\n"
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    "place", ["file/x", "file", "new/" + "x" * 256, "ftp://host/x", "s3://bucket", "zip://a"]
)
def test_places_that_cannot_be_written_are_refused_and_nothing_is_made(tmp_path, monkeypatch, place):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="--out"):
        make_folder(type(tmp_path)(place))
    assert names(tmp_path) == ["file"]


def test_the_error_survives_another_process():
    error = CannotWriteError("out", OSError(28, "No space left on device"))
    again = pickle.loads(pickle.dumps(error))
    assert (
        str(again)
        == str(error)
        == "--out out: cannot be made or written to (No space left on device); choose another"
    )


def test_a_file_is_replaced_whole_or_stays_as_it_was(tmp_path):
    path = tmp_path / "a.txt"
    replace_file(path, b"old")
    with pytest.raises(TypeError):
        replace_file(path, "no bytes")
    assert path.read_bytes() == b"old"
    replace_file(path, b"new", sync=True)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.txt", b"new")]


def test_an_error_names_the_file_and_not_its_unfinished_part(tmp_path):
    path = tmp_path / ("a" * 250)
    with pytest.raises(OSError, match="name too long") as refused:
        replace_file(path, b"x")
    assert refused.value.filename == str(path)
