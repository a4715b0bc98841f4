"""Output that nobody reads: a real pipe and a real pseudo-terminal whose buffers are full."""

import os
import select
import subprocess
import sys
import threading
import time
from contextlib import redirect_stderr
from io import StringIO

import pytest

from skysweep.cli.common import say
from skysweep.cli.terminal import unblocked

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and pseudo-terminals of POSIX")


def filled(descriptor: int) -> int:
    """Writes until nothing more goes in; how much that was."""
    os.set_blocking(descriptor, False)
    written = 0
    try:
        while True:
            written += os.write(descriptor, b"#")
    except BlockingIOError:
        os.set_blocking(descriptor, True)
        return written


@pytest.fixture
def pipe():
    reader, writer = os.pipe()
    yield reader, writer
    os.close(reader)
    os.close(writer)


def read_all(reader: int) -> bytes:
    """What there is to read, up to half a second of nothing."""
    got = b""
    while select.select([reader], [], [], 0.5)[0]:
        got += os.read(reader, 65536)
    return got


def test_what_nobody_reads_holds_nobody_up_and_is_read_later(pipe):
    reader, writer = pipe
    n_filled = filled(writer)
    nobody_reads = os.fdopen(writer, "w", closefd=False)

    def write():
        with redirect_stderr(nobody_reads), unblocked():
            print("first", file=sys.stderr)
            for _ in range(1000):
                print("a warning that is much longer than the pipe has room for", file=sys.stderr)
            print("lost", file=sys.stderr)

    busy = threading.Thread(target=write, daemon=True)
    busy.start()
    busy.join(20.0)
    assert not busy.is_alive()
    got = read_all(reader)
    assert got.startswith(b"#" * n_filled + b"first\n")
    assert got.endswith(b"has room for\n")
    assert b"lost" not in got


def test_what_is_read_arrives_whole_and_in_order(pipe):
    reader, writer = pipe
    with redirect_stderr(os.fdopen(writer, "w", closefd=False)):
        with unblocked():
            print("größer\N{ESCAPE}[1m", file=sys.stderr)
            assert not sys.stderr.isatty()
        print("and after", file=sys.stderr, flush=True)
    assert os.read(reader, 1000).decode() == "größer\N{ESCAPE}[1m\nand after\n"


def test_a_reader_that_is_gone_is_no_error():
    reader, writer = os.pipe()
    os.close(reader)
    with redirect_stderr(os.fdopen(writer, "w", closefd=False)), unblocked():
        print("into the void", file=sys.stderr)
    os.close(writer)


def test_a_stream_without_a_file_is_left_alone():
    text = StringIO()
    with redirect_stderr(text), unblocked():
        print("hello", file=sys.stderr)
        assert sys.stderr is text
    assert text.getvalue() == "hello\n"


def test_names_from_outside_neither_steer_the_terminal_nor_are_markup(capsys):
    say("found [red]boat\N{ESCAPE}]0;title\a 1")
    assert capsys.readouterr().err == "found [red]boat\\x1b]0;title\\x07 1\n"


def test_a_program_can_end_while_its_output_waits(pipe):
    _, writer = pipe
    filled(writer)
    program = (
        "from skysweep.cli.terminal import unblocked\nimport sys\n"
        "with unblocked():\n    print('waits', file=sys.stderr)\n"
    )
    begun = time.monotonic()
    done = subprocess.run([sys.executable, "-c", program], stderr=writer, timeout=60)
    assert done.returncode == 0
    assert time.monotonic() - begun < 30.0


def test_a_mission_on_a_frozen_terminal_is_flown_and_written(tmp_path):
    from skysweep.scenarios.files import load_scenario, write_scenario

    file = write_scenario(load_scenario("clusters"), tmp_path / "mine.yaml")
    ours, terminal = os.openpty()
    filled(terminal)
    out = tmp_path / "run"
    command = [sys.executable, "-m", "skysweep.cli", "run", str(file), "--sensor", "statistical"]
    program = subprocess.Popen(
        [*command, "--out", str(out)], stdin=subprocess.DEVNULL, stdout=terminal, stderr=terminal
    )
    try:
        end = time.monotonic() + 120.0
        while not (out / "report.html").exists():
            assert time.monotonic() < end, "it waits for its terminal"
            time.sleep(0.1)
    finally:
        program.kill()
        program.wait()
        os.close(ours)
        os.close(terminal)
