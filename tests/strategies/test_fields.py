import pytest

from skysweep.errors import UserError
from skysweep.experiments.matrix import Matrix
from skysweep.experiments.sweep.spec import matrix_of, parse_spec
from skysweep.experiments.tune.space import changed_space, default_space
from skysweep.scenarios.files import load_scenario
from skysweep.strategies.fields import checked, value_at

FIELD = "search.parameters.confirm_probability"
SWEEP = f"""
name: own
scenarios: [clusters]
strategies: [belief, {{strategy: scan-only, parameters: {{}}}}]
parameters: {{{FIELD}: [0.9, 0.97]}}
seeds: 2
"""


def belief(**parameters):
    return load_scenario("clusters").with_search(strategy="belief", parameters=parameters)


def test_the_value_is_what_is_set_or_the_strategys_default():
    assert value_at(belief(confirm_probability=0.9), FIELD) == 0.9
    assert value_at(belief(), FIELD) == 0.95
    assert value_at(load_scenario("clusters"), FIELD) is None
    assert value_at(belief(), "search.n_c") == load_scenario("clusters").search.n_c


@pytest.mark.parametrize(
    ("scenario", "sentence"),
    [
        (belief(confirm_probabilty=0.9), "did you mean 'confirm_probability'"),
        (belief(confirm_probability=2.0), "confirm_probability: is 2.0"),
        (load_scenario("clusters").with_search(parameters={"missed_cost_s": 1.0}), "leave it out"),
        (load_scenario("clusters").with_search(strategy="beleif"), "there is no strategy 'beleif'"),
    ],
)
def test_what_is_none_of_the_strategys_is_refused(scenario, sentence):
    with pytest.raises(UserError, match=sentence):
        checked(scenario)


def test_a_sweep_varies_them():
    table = matrix_of(parse_spec(SWEEP, "sweep")).table()
    values = dict(zip(table["config_hash"], table[f"param.{FIELD}"], strict=True))
    assert len(values) == len(table) == 6
    assert sorted(v for v in values.values() if v is not None) == [0.9, 0.9, 0.97, 0.97]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (FIELD, f"{FIELD[:-2]}yt", "did you mean 'confirm_probability'"),
        ("0.97", "1.5", "confirm_probability: is 1.5"),
        (", parameters: {}", "", "scan-only: confirm_probability: there is no such field"),
    ],
)
def test_a_sweep_with_what_a_strategy_does_not_know_is_refused(old, new, sentence):
    with pytest.raises(UserError, match=sentence):
        parse_spec(SWEEP.replace(old, new), "sweep")


def test_a_column_of_strategies_without_them_is_empty():
    scenario = load_scenario("clusters")
    assert (
        Matrix.of([("clusters", scenario)], [0], "statistical", [FIELD]).table()[f"param.{FIELD}"][0] is None
    )


def test_tuning_takes_their_ranges():
    space, settings = changed_space(
        default_space([belief()]), [belief()], [f"{FIELD}=0.8:0.95"], ["search.parameters.lapse=0.05"]
    )
    assert FIELD in {parameter.field for parameter in space}
    assert settings == {"search.parameters.lapse": 0.05}


@pytest.mark.parametrize(
    ("scenario", "text", "sentence"),
    [
        (load_scenario("clusters"), f"{FIELD}=0.8:0.95", "there is no parameter"),
        (belief(), f"{FIELD}=0.8:1.5", "confirm_probability: is 1.5"),
        (belief(), "search.parameters.n_missing=1:4", "has no value of it"),
    ],
)
def test_tuning_refuses_what_is_none(scenario, text, sentence):
    with pytest.raises(UserError, match=sentence):
        changed_space(default_space([scenario]), [scenario], [text], [])
