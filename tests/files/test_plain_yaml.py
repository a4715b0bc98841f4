import pytest

from skysweep.cli.common import changes_of
from skysweep.errors import UserError
from skysweep.experiments.sweep.spec import parse_spec
from skysweep.files.plain_yaml import MAX_VALUES, parse_foreign_yaml, parse_yaml

MANY_ALIASES = "a: &a [" + "1, " * 1000 + "1]\nb: [" + "*a, " * 60_000 + "*a]\n"


def test_values_are_read():
    assert parse_yaml("{a: [1, .inf], b: yes it is}", "x") == {"a": [1, float("inf")], "b": "yes it is"}


@pytest.mark.parametrize("parse", [parse_yaml, parse_foreign_yaml, parse_spec])
def test_aliases_are_refused_before_they_grow(parse):
    with pytest.raises(UserError, match=r"x: line 2: the alias \*a is not allowed; write the value out"):
        parse(MANY_ALIASES, "x")


def test_aliases_on_the_command_line_are_refused():
    with pytest.raises(UserError, match=r"--set targets=.*: line 1: the alias \*a is not allowed"):
        changes_of(["targets=[&a [1, 1], *a]"])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "line 1: lists are nested too deeply"),
        ("[" + "1, " * MAX_VALUES + "1]", "line 1: holds more than 250,000 values"),
        ("a: !!python/name:os.system x", "line 1: the YAML tag"),
        ("a: 1\nb: 2\na: 3", "line 3: 'a' is written twice"),
        ("a: [1\nb: 2", "line 2: not YAML"),
        ("{1: a}", "line 1: a field's name must be a word"),
    ],
)
def test_what_is_not_plain_is_one_sentence(text, said):
    with pytest.raises(UserError, match=r"^x: ") as caught:
        parse_yaml(text, "x")
    assert said in str(caught.value)


def test_files_of_other_programs_may_have_numbers_as_keys():
    assert parse_foreign_yaml("names: {0: person, 1: boat}", "x") == {"names": {0: "person", 1: "boat"}}
