import cv2
import numpy as np
import pytest

from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.picture import draw_plan
from skysweep.scenarios.model import Area, CameraModel, Scenario, Terrain

HOLE = [(60, 60), (120, 60), (120, 120), (60, 120)]


@pytest.mark.parametrize(
    ("area", "holes"),
    [
        ([(0, 0), (300, 0), (300, 40), (0, 40)], []),
        ([(0, 0), (40, 0), (40, 400), (0, 400)], []),
        ([(0, 0), (300, 0), (150, 240), (0, 220)], [HOLE]),
    ],
)
def test_a_picture_shows_the_path_over_the_area(tmp_path, area, holes):
    s = Scenario(
        name="test", area=Area(polygon_enu_m=area, holes_enu_m=holes), camera=CameraModel(hfov_rad=0.7)
    )
    plan, estimate = plan_scenario(s)
    image = cv2.imread(str(draw_plan(tmp_path / "plan.png", s, plan, estimate)))
    assert image.shape[1] == 1600
    assert 700 < image.shape[0] < 2400
    path_bgr = np.array([0xA5, 0x5F, 0x0B])
    on_path = (np.abs(image.astype(int) - path_bgr) < 12).all(axis=2)
    rows, columns = np.nonzero(on_path)
    assert on_path.sum() > 5000
    spread = (np.ptp(columns) / 1600, np.ptp(rows) / image.shape[0])
    assert max(spread) > 0.5


def test_the_same_plan_gives_the_same_picture(tmp_path):
    s = Scenario(name="test", area=Area(polygon_enu_m=[(0, 0), (90, 0), (90, 60)]))
    plan, estimate = plan_scenario(s)
    one, two = (draw_plan(tmp_path / f"{i}.png", s, plan, estimate).read_bytes() for i in range(2))
    assert one == two


def test_over_hills_the_heights_along_the_path_are_below_the_map(tmp_path):
    area = Area(polygon_enu_m=[(0, 0), (300, 0), (300, 200), (0, 200)])
    wall = [[0.0] * 20] * 8 + [[60.0] * 20] + [[0.0] * 20] * 9
    flat, hilly = (Scenario(name="t", area=area, terrain=Terrain(heightmap_m=h)) for h in (None, wall))
    images = [
        cv2.imread(str(draw_plan(tmp_path / f"{s.name}.png", s, *plan_scenario(s)))) for s in (flat, hilly)
    ]
    assert images[1].shape[0] > images[0].shape[0] + 300
    no_radio_bgr = np.array([0x00, 0x7B, 0xE0])
    marked = [(np.abs(image.astype(int) - no_radio_bgr) < 12).all(axis=2).sum() for image in images]
    assert marked[0] < 50 < 500 < marked[1]
