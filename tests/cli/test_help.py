"""The help of every command: short, with examples, and the same name for the same thing."""

import shlex
import subprocess
import sys

import pytest
from test_answers import COMMANDS
from typer.testing import CliRunner

import skysweep
from skysweep.cli import app

_ONE_NAME = {  # what is found, under which it is said, in every command
    "confidence": "--confidence",
    "workers": "--workers",
    "seed": "--seed",
    "out": "--out",
    "change": "--set",
    "as_json": "--json",
    "from_sound_lines": "--from-sound-lines",
}
_LONGEST = 150  # characters of an option's help


def examples(command):
    """Its examples, each as one line."""
    _, _, after = command.help.replace("\b", "").partition("Example")
    paragraphs = after.partition(":")[2].split("\n\n")
    lines = (" ".join(line.strip() for line in paragraph.splitlines()) for paragraph in paragraphs)
    return [line for line in lines if line.startswith("skysweep ")]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_examples_of_this_command_with_its_own_options(name):
    command = COMMANDS[name]
    shown = examples(command)
    assert shown
    own = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    for example in shown:
        words = shlex.split(example, comments=True)[1:]
        group = [word for word in words[:2] if word.isidentifier() or "-" in word]
        known = COMMANDS.get(" ".join(group[:2])) or COMMANDS[words[0]]
        if known is command:
            words = words[: words.index("--ros-args")] if "--ros-args" in words else words
            used = {word.partition("=")[0] for word in words if word.startswith("--")}
            assert used <= own, example
    assert any(example.startswith(f"skysweep {name}") for example in shown)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_what_it_is_in_a_line(name):
    for parameter in COMMANDS[name].params:
        assert parameter.help, parameter.name
        assert len(parameter.help) <= _LONGEST, parameter.name


@pytest.mark.parametrize("name", COMMANDS)
def test_the_first_line_of_help_is_one_sentence(name):
    first = COMMANDS[name].help.split("\n\n")[0]
    assert first.rstrip().endswith(".")
    assert len(first) < 130


@pytest.mark.parametrize("name", COMMANDS)
def test_one_thing_has_one_name(name):
    for parameter in COMMANDS[name].params:
        if parameter.name in _ONE_NAME and parameter.param_type_name == "option":
            assert _ONE_NAME[parameter.name] == parameter.opts[0]


def test_the_version_is_told():
    assert CliRunner().invoke(app, ["--version"]).output == f"skysweep {skysweep.__version__}\n"


def test_python_runs_the_package():
    told = subprocess.run(
        [sys.executable, "-m", "skysweep", "--help"], capture_output=True, text=True, check=True
    )
    assert "Usage: skysweep " in told.stdout
