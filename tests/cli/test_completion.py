"""What the shell completes, without the package being imported for it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from skysweep.cli import completion
from skysweep.scenarios.files import list_scenarios
from skysweep.strategies import strategy_names

PROGRAM = Path(sys.executable).parent / "skysweep"
HEAVY = {"numpy", "scipy", "polars", "matplotlib", "onnxruntime", "shapely", "numba", "cv2"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with a scenario, two runs, and other things."""
    monkeypatch.chdir(tmp_path)
    for run in ("runs/first", "runs/second", "mine"):
        Path(run).mkdir(parents=True)
        Path(run, "journal.jsonl").touch()
    Path("runs/empty").mkdir()
    Path("clusters-2.yaml").touch()
    Path("clusters.txt").touch()
    Path(".hidden.yaml").touch()
    return tmp_path


def test_names_are_those_that_there_are(folder):
    assert completion.scenarios("") == [*list_scenarios(), "clusters-2.yaml"]
    assert completion.strategies("") == sorted(strategy_names())


@pytest.mark.parametrize(
    ("offer", "typed", "expected"),
    [
        (completion.scenarios, "clu", ["clusters", "clusters-2.yaml"]),
        (completion.scenarios, "./clu", []),  # left to the shell
        (completion.strategies, "scan", ["scan-check", "scan-only"]),
        (completion.runs, "", ["mine", "runs/first", "runs/second"]),
        (completion.runs, "ru", ["runs/first", "runs/second"]),
        (completion.runs, "runs/", ["runs/first", "runs/second"]),
        (completion.runs, "runs/f", ["runs/first"]),
        (completion.runs, "nowhere/", []),
        (completion.runs, "s3://bucket/", []),
        (completion.scenarios_and_runs, "m", ["maritime", "mine"]),
    ],
)
def test_what_is_offered(folder, offer, typed, expected):
    assert offer(typed) == expected


@pytest.mark.parametrize("name", ["a b", "$(touch owned)", "`id`", "x;y", "-\nz", "q'"])
def test_a_name_that_a_shell_would_run_is_not_offered(folder, name):
    Path("runs", name).mkdir()
    Path("runs", name, "journal.jsonl").touch()
    Path(f"clusters{name}.yaml").touch()
    assert completion.runs("runs/") == ["runs/first", "runs/second"]
    assert completion.scenarios("clusters") == ["clusters", "clusters-2.yaml"]


def test_a_folder_that_is_gone_or_a_loop_offers_nothing(folder, monkeypatch):
    Path("loop").mkdir()
    Path("loop/journal.jsonl").symlink_to("journal.jsonl")
    assert completion.runs("lo") == []
    gone = folder / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert completion.runs("") == []
    assert completion.scenarios("clusters") in ([], ["clusters"])


@pytest.mark.parametrize(
    ("shell", "asked"),
    [
        ("bash", {"COMP_WORDS": "skysweep resume m", "COMP_CWORD": "2"}),
        ("zsh", {"_TYPER_COMPLETE_ARGS": "skysweep resume m"}),
        (
            "fish",
            {"_TYPER_COMPLETE_ARGS": "skysweep resume m", "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
        ),
    ],
)
def test_each_shell_is_answered(folder, shell, asked):
    program = [sys.executable, "-c", "from skysweep.cli import app; app(prog_name='skysweep')"]
    source = {"_SKYSWEEP_COMPLETE": f"source_{shell}"}
    script = subprocess.run(program, env=os.environ | source, capture_output=True, text=True, check=True)
    assert f"complete_{shell}" in script.stdout
    wanted = {"_SKYSWEEP_COMPLETE": f"complete_{shell}"}
    answered = subprocess.run(
        program, env=os.environ | wanted | asked, capture_output=True, text=True, check=True
    )
    assert "mine" in answered.stdout
    assert "runs" not in answered.stdout


@pytest.mark.skipif(not (PROGRAM.exists() and shutil.which("bash")), reason="needs skysweep and bash")
def test_bash_completes_a_scenario(folder):
    script = (
        'eval "$(_SKYSWEEP_COMPLETE=source_bash skysweep)"\n'
        "COMP_WORDS=(skysweep run --seed 3 clusters-); COMP_CWORD=4\n"
        '_skysweep_completion skysweep; printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    path = {"PATH": f"{PROGRAM.parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", script], env=os.environ | path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []
    done = subprocess.run(
        ["bash", "-c", script.replace("clusters-)", "clu)")],
        env=os.environ | path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split() == ["clusters", "clusters-2.yaml"]


@pytest.mark.parametrize(
    "asked",
    [
        {"_SKYSWEEP_COMPLETE": "complete_bash", "COMP_WORDS": "skysweep run ", "COMP_CWORD": "2"},
        {"_SKYSWEEP_COMPLETE": "complete_bash", "COMP_WORDS": "skysweep run --strategy ", "COMP_CWORD": "3"},
        {},
    ],
)
def test_completion_and_help_import_little(folder, asked):
    code = (
        "import sys\nfrom skysweep.cli import app\nsys.argv = ['skysweep', '--help']\n"
        "try:\n    app(prog_name='skysweep')\nfinally:\n"
        f"    print(sorted({HEAVY!r} & set(sys.modules)), file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asked, capture_output=True, text=True, check=True
    )
    assert "clusters" in done.stdout or "scan-check" in done.stdout or "Commands" in done.stdout
    assert done.stderr.strip() == "[]"
