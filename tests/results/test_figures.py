from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from results_data import tiny_records, write_run

from skysweep.results import figures
from skysweep.results.figures import panels, pos_curves, run_map
from skysweep.results.reporting.style import step_values
from skysweep.results.run_folder import load_run


def test_step_values_hold_until_the_next_step():
    steps = np.array([[0, 0.0], [10, 0.5], [20, 1.0]])
    assert step_values(steps, np.array([-1, 0, 9.9, 10, 15, 20, 99])).tolist() == [0, 0, 0, 0.5, 0.5, 1, 1]


def test_map_is_a_picture_with_something_on_it(tiny_run, tmp_path):
    picture = Image.open(run_map(tiny_run, tmp_path / "map.png")).convert("RGB")
    assert picture.width > 1000
    assert len(set(picture.resize((200, 200)).get_flattened_data())) > 50


def test_map_of_a_mission_killed_at_the_start(tmp_path):
    run = load_run(write_run(tmp_path, tiny_records()[:1]))
    assert run_map(run, tmp_path / "map.png").stat().st_size > 0


def test_map_of_a_vehicle_that_once_did_not_know_where_it_was(tmp_path):
    lost = [r | {"p": ["nan"] * 3} if r["kind"] == "state" and r["t"] > 0 else r for r in tiny_records()]
    assert run_map(load_run(write_run(tmp_path, lost)), tmp_path / "map.png").stat().st_size > 0


def test_panels_come_in_three_formats_and_leave_missing_cells_empty(tmp_path):
    runs = []
    for name, n_c in (("a", 1), ("a", float("inf")), ("b", float("inf"))):
        folder = tmp_path / f"{name}{n_c}"
        runs.append(load_run(write_run(folder, tiny_records(), name=name, search={"n_c": n_c})))
    files = panels(runs, tmp_path / "panels.png")
    assert [f.name for f in files] == ["panels.png", "panels.svg", "panels.pdf"]
    image = np.array(Image.open(files[0]).convert("L"))
    height, width = image.shape
    bottom_left = image[int(height * 0.55) : int(height * 0.75), : int(width * 0.4)]
    assert (bottom_left > 250).all()


def test_pos_axis_ends_at_1(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "save_figure", lambda figure, path: drawn.append(figure) or path)
    pos_curves({"one": [np.array([[0.0, 0.0], [10.0, 1.0]])]}, tmp_path / "pos.svg")
    (axis,) = drawn[0].axes
    assert axis.get_ylim() == (0.0, 1.0)


@pytest.mark.parametrize("missions", [1, 3])
def test_pos_curves(tmp_path, missions):
    steps = np.array([[0, 0.0], [10, 0.5], [20, 1.0]])
    path = pos_curves({"one": [steps + np.array([k, 0]) for k in range(missions)]}, tmp_path / "pos.svg")
    assert path.read_text(encoding="utf-8").startswith("<?xml")


def test_a_strategy_looks_alike_in_figures_with_and_without_another(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "save_figure", lambda figure, path: drawn.append(figure) or path)
    steps = [np.array([[0.0, 0.0], [10.0, 1.0]])]
    for missions in (steps, []):
        pos_curves({"1": steps, "5": missions, "belief": steps}, tmp_path / "pos.svg")
    looks = [{line.get_label(): line.get_color() for line in figure.axes[0].lines} for figure in drawn]
    assert looks[0].keys() == {"1", "5", "belief"}
    assert looks[1].keys() == {"1", "belief"}
    assert looks[1].items() <= looks[0].items()
