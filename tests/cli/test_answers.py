"""What commands answer: every table also as JSON, alone on standard output."""

import ast
import dis
import importlib
import inspect
import json
import types
from pathlib import Path

import pytest
import typer
from rich.table import Table
from typer.testing import CliRunner

import skysweep.cli
from skysweep.cli import app, common
from skysweep.cli.answers import answer
from skysweep.results.reporting.html import Grid

CLI = Path(skysweep.cli.__file__).parent
DOCS = Path(__file__).parents[2] / "docs"
FAST = ("--sensor", "statistical")


def commands(group=None, name=()):
    """Every command of the app by its words."""
    group = typer.main.get_command(app) if group is None else group
    found = {}
    for word, command in group.commands.items():
        if hasattr(command, "commands"):
            found |= commands(command, (*name, word))
        if not hasattr(command, "commands") or command.invoke_without_command:
            found[" ".join((*name, word))] = command
    return found


COMMANDS = commands()


def code_of(function):
    """Its code, and the code of functions and comprehensions in it."""
    pending = [inspect.unwrap(function).__code__]
    while pending:
        code = pending.pop()
        yield code
        pending += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]


def used_by(function):
    """Functions of the command line that a function names, also those that it imports."""
    scope, module = inspect.unwrap(function).__globals__, None
    for code in code_of(function):
        for instruction in dis.get_instructions(code):
            if instruction.opname == "IMPORT_NAME" and instruction.argval.startswith("skysweep.cli"):
                module = importlib.import_module(instruction.argval)
            named = [scope.get(instruction.argval)] if isinstance(instruction.argval, str) else []
            if instruction.opname == "IMPORT_FROM" and module is not None:
                named.append(getattr(module, instruction.argval, None))
            for used in named:
                if isinstance(used, types.FunctionType) and used.__module__.startswith("skysweep.cli"):
                    yield used


def reaches(function, wanted, seen=None):
    """Whether a function calls another, by any way through the command line."""
    seen = set() if seen is None else seen
    for used in used_by(function):
        if used is wanted:
            return True
        if used not in seen:
            seen.add(used)
            if reaches(used, wanted, seen):
                return True
    return False


def options(command):
    return {option for parameter in command.params for option in parameter.opts}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_answers_has_json_and_says_what_is_in_it(name):
    command = COMMANDS[name]
    answers = reaches(command.callback, answer)
    assert ("--json" in options(command)) == answers
    if answers:
        assert f"`{name}`" in (DOCS / "command-line.md").read_text(encoding="utf-8")


def test_the_walk_finds_answers_however_deep():
    answering = {name for name, command in COMMANDS.items() if reaches(command.callback, answer)}
    assert {"run", "plan", "calibrate", "ros fly", "report", "benchmark", "doctor"} <= answering
    assert not {"dataset", "train", "serve-vehicle", "scenarios show"} & answering


@pytest.mark.parametrize("path", sorted(CLI.glob("*.py")), ids=lambda path: path.stem)
def test_only_answers_print_tables(path):
    """Standard output is written by ``answer`` and ``tell``; others print what is one text or JSON anyway."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    attributes = {
        f"{node.value.id}.{node.attr}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    }
    if path.stem not in ("answers", "common"):
        assert not {"console", "Console", "PlainConsole", "print"} & names
        assert "errors.print" not in attributes
    if path.stem not in ("answers", "bench", "scenarios", "terminal"):
        assert "sys.stdout" not in attributes
        assert "typer.echo" not in attributes


def test_people_get_tables_and_sentences_and_programs_one_document(capsys):
    table = Table("name", "recall")
    table.add_row("[bold]a", "0.5")
    record = {"rows": [{"name": "[bold]a", "recall": 0.5, "n_c": float("inf"), "error_m": float("nan")}]}
    answer(False, record, table, Grid(("name", "time"), [("b", "3")], "a grid"), "a sentence")
    shown = capsys.readouterr().out
    assert all(words in shown for words in ("[bold]a", "a grid", "a sentence"))
    assert "{" not in shown
    answer(True, record, table, "a sentence")
    printed = capsys.readouterr().out
    assert json.loads(printed) == {
        "rows": [{"name": "[bold]a", "recall": 0.5, "n_c": "inf", "error_m": None}]
    }


def told(*arguments):
    """The one document on standard output of a command, which succeeds."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_a_mission_its_report_and_its_resuming_tell_the_same(tmp_path):
    folder = tmp_path / "run"
    flown = told("run", "clusters", *FAST, "--out", folder, "--json")
    assert flown["folder"] == str(folder)
    assert flown["summary"]["recall"] == pytest.approx(1.0, abs=1.0)
    assert flown["summary"]["ended"] is True
    assert Path(flown["report"]).is_file()
    again = told("report", folder, "--json")
    assert again["summary"] == flown["summary"]
    resumed = told("resume", folder, "--json")
    assert {key: resumed["summary"][key] for key in flown["summary"]} == flown["summary"]


def test_plans_scenarios_and_models_are_told_as_numbers(tmp_path):
    plan = told("plan", "clusters", "--out", tmp_path, "--json")
    assert plan["scenario"] == "clusters"
    assert plan["path_length_m"] > 100.0
    assert isinstance(plan["batteries"], int)
    assert Path(plan["plan"]).is_file()
    listed = told("scenarios", "list", "--json")["scenarios"]
    assert {"name", "area_m2", "targets", "description"} == set(listed[0])
    assert "clusters" in [each["name"] for each in listed]
    assert told("scenarios", "validate", "clusters", "--json") == {
        "files": [{"file": "clusters", "warnings": []}]
    }
    model = told("detect", "inspect", "skysweep", "--json")
    assert model["found"] is None
    assert "classes" in model["model"]


def test_an_error_leaves_standard_output_empty():
    result = CliRunner().invoke(app, ["plan", "no-such-scenario", "--json"])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert common.printable(result.stderr).startswith("error: ")
