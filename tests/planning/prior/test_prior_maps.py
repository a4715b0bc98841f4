"""Maps: what they may be, how they mix, what is left after a search; and their files."""

import numpy as np
import pyproj
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from maps_of_all_kinds import gaussian

from skysweep.errors import MissingExtraError, UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.coverage import coverage_of
from skysweep.planning.prior.map_files import read_heights, read_map, write_geotiff, write_map
from skysweep.planning.prior.maps import ProbabilityMap, grid_over, mixed
from skysweep.planning.prior.rasters import on_one_grid

FRAME = LocalFrame(60.2, 22.1)


def cells_of(poa, cell_m=10.0, origin=(0.0, 0.0), frame=FRAME):
    poa = np.asarray(poa, dtype=float)
    return ProbabilityMap(poa / poa.sum(), cell_m, np.array(origin), frame)


def mean_xy(cells):
    return np.sum(cells.poa[..., None] * cells.centres_xy_m, axis=(0, 1))


def test_what_is_searched_becomes_less_probable_and_the_rest_more():
    cells = cells_of(np.ones((2, 4)))
    after = cells.after_search([np.array([[0.0, 5.0], [40.0, 5.0]])], 10.0)
    assert after.poa[0] == pytest.approx(np.full(4, np.exp(-1) / (4 * np.exp(-1) + 4)))
    assert after.poa.sum() == pytest.approx(1.0)
    again = cells.after_search([np.array([[0.0, 5.0], [40.0, 5.0], [0.0, 5.0]])], 10.0)
    twice = after.after_search([np.array([[0.0, 5.0], [40.0, 5.0]])], 10.0)
    assert twice.poa == pytest.approx(again.poa)


@pytest.mark.parametrize("width_m", [3.0, 10.0, 25.0])
def test_coverage_is_the_swept_area_over_that_of_the_cells(width_m):
    path = np.array([[-30.0, 33.0], [71.0, 95.0], [71.0, 95.0], [20.0, 20.0], [20.0, 90.0]])
    coverage = coverage_of([path], (40, 40), 10.0, np.array([-200.0, -200.0]), width_m)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert coverage.sum() == pytest.approx(width_m * length / 100.0)


def test_a_wide_sweep_covers_the_cells_beside_its_path():
    coverage = coverage_of([np.array([[0.0, 25.0], [50.0, 25.0]])], (5, 5), 10.0, np.zeros(2), 30.0)
    assert coverage == pytest.approx(np.repeat([0.0, 1.0, 1.0, 1.0, 0.0], 5).reshape(5, 5))


def test_mixed_maps_weigh_their_scenarios():
    one, other = cells_of([[1.0, 0.0]]), cells_of([[0.0, 1.0]])
    assert mixed([one, other], [3.0, 1.0]).poa == pytest.approx(np.array([[0.75, 0.25]]))


@pytest.mark.parametrize(
    ("maps", "weights", "word"),
    [
        ([cells_of([[1.0, 0.0]])], [1.0, 2.0], "weights"),
        ([cells_of([[1.0, 0.0]])], [-1.0], "weights"),
        ([cells_of([[1.0, 0.0]]), cells_of([[1.0], [0.0]])], [1.0, 1.0], "different cells"),
        ([], [], "weights"),
    ],
)
def test_what_cannot_be_mixed_is_said(maps, weights, word):
    with pytest.raises(UserError, match=word):
        mixed(maps, weights)


def test_a_map_is_cut_to_an_area():
    cells = cells_of(np.ones((10, 10)))
    west = shapely.box(0, 0, 50, 100)
    assert cells.share_within(west) == pytest.approx(0.5)
    assert cells.within(west).poa[:, 5:].sum() == 0.0
    with pytest.raises(UserError, match="does not overlap the area"):
        cells.within(shapely.box(500, 0, 600, 100))


def test_a_grid_spans_its_area():
    cells = grid_over(shapely.box(-20, 5, 101, 64), 10.0, FRAME)
    west, south, east, north = cells.bounds_m
    assert (west, south) == (-20.0, 5.0)
    assert east >= 101
    assert north >= 64


def test_a_written_map_is_read_back_bit_for_bit(tmp_path):
    cells = cells_of(gaussian(20, 40, 9), origin=(-3.5, 7.25))
    write_map(tmp_path / "map.npz", cells)
    read = read_map(tmp_path / "map.npz")
    assert read.poa == pytest.approx(cells.poa, rel=1e-12)
    assert read.bounds_m == cells.bounds_m
    assert read.frame == cells.frame
    elsewhere = read_map(tmp_path / "map.npz", LocalFrame(60.201, 22.103))
    geodetic = [[*mean_xy(cells), 0.0]]
    expected = elsewhere.frame.enu_from_geodetic(cells.frame.geodetic_from_enu(geodetic))[0, :2]
    assert mean_xy(elsewhere) == pytest.approx(expected, abs=0.5)


def lon_lat_file(tmp_path, kind, poa, bounds):
    """A map of the same cells as a file of each kind."""
    west, south, east, north = bounds
    rows, columns = poa.shape
    path = tmp_path / f"map.{kind}"
    if kind == "npz":
        np.savez(path, poa=poa, bounds_lon_lat_deg=bounds)
    elif kind == "csv":
        lines = ["poa, lat, lon"]
        for row in range(rows):
            for column in range(columns):
                lon = west + (column + 0.5) * (east - west) / columns
                lat = south + (row + 0.5) * (north - south) / rows
                lines.append(f"{poa[row, column]}, {lat}, {lon}")
        path.write_text("\n".join(lines))
    else:
        rasterio = pytest.importorskip("rasterio")
        transform = rasterio.Affine((east - west) / columns, 0, west, 0, (south - north) / rows, north)
        with rasterio.open(path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="float64",
                           crs="EPSG:4326", transform=transform) as file:  # fmt: skip
            file.write(poa[::-1], 1)
    return path


@pytest.mark.parametrize("kind", ["npz", "csv", "tif"])
def test_a_map_in_degrees_comes_to_lie_where_it_was(tmp_path, kind):
    poa = gaussian(20, 40, 5, cells=60)
    bounds = (22.10, 60.20, 22.12, 60.21)
    cells = read_map(lon_lat_file(tmp_path, kind, poa, bounds))
    share = np.sum(poa[..., None] * (np.stack(np.meshgrid(np.arange(60), np.arange(60)), -1) + 0.5), (0, 1))
    share = share / poa.sum() / 60
    there = [60.20 + 0.01 * share[1], 22.10 + 0.02 * share[0], 0.0]
    off_m = mean_xy(cells) - cells.frame.enu_from_geodetic([there])[0, :2]
    assert np.abs(off_m).max() < 0.15 * cells.cell_size_m
    west, south, east, north = cells.bounds_m
    assert (east - west, north - south) == pytest.approx((1111, 1114), abs=25)


def test_a_geotiff_in_another_projection_comes_to_lie_where_it_was(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    poa = gaussian(20, 40, 5, cells=60).astype("float32")
    east, north = 450_000.0, 6_670_000.0
    transform = rasterio.Affine(10.0, 0.0, east, 0.0, -10.0, north + 600.0)
    path = tmp_path / "utm.tif"
    with rasterio.open(path, "w", driver="GTiff", width=60, height=60, count=1, dtype="float32",
                       crs="EPSG:32635", transform=transform, nodata=-1.0) as file:  # fmt: skip
        written = poa[::-1].copy()
        written[0, 0] = -1.0
        file.write(written, 1)
    cells = read_map(path)
    lon, lat = pyproj.Transformer.from_crs("EPSG:32635", "EPSG:4326", always_xy=True).transform(
        east + 200.0, north + 400.0
    )
    assert mean_xy(cells) == pytest.approx(cells.frame.enu_from_geodetic([[lat, lon, 0.0]])[0, :2], abs=1.0)
    assert cells.cell_size_m == pytest.approx(10.0, rel=0.01)


@settings(max_examples=40)
@given(
    latitude=st.floats(-85.0, 85.0),
    longitude=st.floats(-180.0, 180.0),
    aspect=st.sampled_from([0.5, 1.0, 2.0]),
    places=st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20)), min_size=2, max_size=2, unique=True),
)
def test_cells_keep_their_probability_in_degrees(tmp_path_factory, latitude, longitude, aspect, places):
    """Two of as much, anywhere on earth: what lies nearer to one of them is half of all."""
    poa, pitch = np.zeros((21, 21)), np.array([0.001 * aspect, 0.001])
    for row, column in places:
        poa[row, column] = 0.5
    path = tmp_path_factory.mktemp("maps") / "map.npz"
    east = (longitude + 21 * pitch[0] + 180.0) % 360.0 - 180.0
    np.savez(path, poa=poa, bounds_lon_lat_deg=(longitude, latitude, east, latitude + 21 * pitch[1]))
    cells = read_map(path)
    assert cells.poa.sum() == pytest.approx(1.0)
    middles = [[latitude + (r + 0.5) * pitch[1], longitude + (c + 0.5) * pitch[0], 0.0] for r, c in places]
    one, other = cells.frame.enu_from_geodetic(middles)[:, :2]
    assume(np.linalg.norm(one - other) > 4.0 * cells.cell_size_m)
    away_m = [np.linalg.norm(cells.centres_xy_m - place, axis=-1) for place in (one, other)]
    assert cells.poa[away_m[0] < away_m[1]].sum() == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("latitude", [0.0, 60.0, 80.0])
def test_an_even_map_in_degrees_stays_even(tmp_path, latitude):
    path = lon_lat_file(tmp_path, "npz", np.ones((50, 50)), (22.0, latitude, 22.05, latitude + 0.05))
    inside = read_map(path).poa[3:-3, 3:-3]
    assert inside == pytest.approx(np.full(inside.shape, inside.mean()), rel=0.01)


@pytest.mark.parametrize(("west", "east"), [(179.95, -179.95), (179.95, 180.05), (190.0, 190.1)])
def test_a_map_across_the_antimeridian_is_whole(tmp_path, west, east):
    """From a GeoTIFF, from a NumPy file where degrees are within 180; heights, too."""
    poa = np.ones((20, 20))
    poa[15:, 15:] = 10.0
    kinds = ["tif"] if max(west, east) > 180.0 else ["npz"]
    for kind in kinds:
        path = tmp_path / "map.npz"
        if kind == "tif":
            path = lon_lat_file(tmp_path, "tif", poa, (west, 60.0, east, 60.1))
        else:
            np.savez(path, poa=poa, bounds_lon_lat_deg=(west, 60.0, east, 60.1))
        cells = read_map(path)
        columns = cells.poa.shape[1]
        assert cells.poa[:, columns // 2 :].sum() == pytest.approx(425.0 / 625.0, abs=0.02)
        if kind == "tif":
            inside = cells_of(np.ones((5, 5)), 100.0, (-250.0, -250.0), cells.frame)
            assert read_heights(path, inside)[0] == pytest.approx(np.ones((5, 5)))


def test_a_table_across_the_antimeridian_is_whole(tmp_path):
    lines = [f"{(179.99 + 0.001 * j + 180.0) % 360.0 - 180.0:.6f},{60.0 + 0.001 * i:.6f},1"
             for i in range(9) for j in range(20)]  # fmt: skip
    (tmp_path / "map.csv").write_text("\n".join(["lon,lat,poa", *lines]))
    west, _, east, _ = read_map(tmp_path / "map.csv").bounds_m
    assert east - west == pytest.approx(1113, rel=0.08)  # whole cells


def test_a_geotiff_of_metres_that_is_called_degrees_is_refused(tmp_path):
    pytest.importorskip("rasterio")
    path = lon_lat_file(tmp_path, "tif", np.ones((3, 3)), (400_000.0, 6_650_000.0, 400_300.0, 6_650_300.0))
    here = cells_of(np.ones((3, 3)))
    for read in (lambda: read_map(path), lambda: read_map(path, FRAME), lambda: read_heights(path, here)):
        with pytest.raises(UserError, match=r"map\.tif: is in WGS 84, but .* write the CRS that they are in"):
            read()


@pytest.mark.parametrize("decimals", [5, 6, 8])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_a_table_of_few_decimals_is_on_a_grid(tmp_path, decimals, mark):
    """Cells of 10 m, of which 5 decimals are 1.1; and as a spreadsheet writes it."""
    lines = [f"{22.0 + 0.00017986 * j:.{decimals}f},{60.0 + 0.00008983 * i:.{decimals}f},1"
             for i in range(150) for j in range(150)]  # fmt: skip
    (tmp_path / "map.csv").write_text("\n".join([f"{mark}lon,lat,poa", *lines]), encoding="utf-8")
    cells = read_map(tmp_path / "map.csv")
    assert cells.poa.shape == pytest.approx((150, 150), abs=1)
    assert cells.cell_size_m == pytest.approx(10.0, rel=0.01)


def test_a_geotiff_without_crs_is_refused(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "bare.tif"
    with (
        pytest.warns(rasterio.errors.NotGeoreferencedWarning),
        rasterio.open(path, "w", driver="GTiff", width=2, height=2, count=1, dtype="float32") as file,
    ):
        file.write(np.ones((2, 2), dtype="float32"), 1)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), pytest.raises(UserError, match="has no CRS"):
        read_map(path)


def test_a_geotiff_in_a_local_crs_is_refused(tmp_path):
    """As a map, in a frame of its own or a scenario's, and as heights."""
    rasterio = pytest.importorskip("rasterio")
    path, here = tmp_path / "local.tif", cells_of(np.ones((3, 3)))
    with rasterio.open(path, "w", driver="GTiff", width=3, height=3, count=1, dtype="float32",
                       crs=rasterio.CRS.from_wkt('LOCAL_CS["x",UNIT["metre",1]]'),
                       transform=rasterio.Affine(10.0, 0.0, 0.0, 0.0, -10.0, 30.0)) as file:  # fmt: skip
        file.write(np.ones((3, 3), dtype="float32"), 1)
    for read in (lambda: read_map(path), lambda: read_map(path, FRAME), lambda: read_heights(path, here)):
        with pytest.raises(UserError, match=r"local\.tif: is in a CRS that is local .* save it in EPSG:4326"):
            read()


def test_a_geotiff_without_its_extra_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rasterio", None)
    (tmp_path / "map.tif").write_bytes(b"")
    with pytest.raises(MissingExtraError, match=r"install it with  tools/setup\.sh geo"):
        read_map(tmp_path / "map.tif")


BOUNDS = (22.1, 60.2, 22.12, 60.21)


@pytest.mark.parametrize(
    ("arrays", "word"),
    [
        ({}, "poa: is missing"),
        ({"poa": np.ones((3, 3))}, "bounds_lon_lat_deg: is missing"),
        ({"poa": np.ones((3, 3)), "bounds_lon_lat_deg": (0, 0, 1)}, "write 4 finite numbers"),
        ({"poa": np.ones((3, 3)), "bounds_lon_lat_deg": (450000, 6670000, 451000, 6671000)}, "another CRS"),
        ({"poa": np.ones((3, 3)), "bounds_lon_lat_deg": (22.12, 60.2, 22.1, 60.21)}, "not in order"),
        ({"poa": -np.ones((3, 3)), "bounds_lon_lat_deg": BOUNDS}, "holds -1"),
        ({"poa": np.full((3, 3), np.nan), "bounds_lon_lat_deg": BOUNDS}, "9 cells are NaN"),
        ({"poa": np.zeros((3, 3)), "bounds_lon_lat_deg": BOUNDS}, "0 everywhere"),
        ({"poa": np.zeros((0, 3)), "bounds_lon_lat_deg": BOUNDS}, "0x3"),
        ({"poa": np.array([[1.0, None]]), "bounds_lon_lat_deg": BOUNDS}, "holds Python objects, not numbers"),
        ({"poa": np.array(["a"]), "bounds_lon_lat_deg": BOUNDS}, "no table of numbers"),
        ({"poa": np.ones((3, 3)), "frame_lat_lon_deg": (60.2, 22.1)}, "cell_size_m: write 1 finite number"),
    ],
)
def test_bad_numpy_maps_are_told_in_one_sentence(tmp_path, arrays, word):
    np.savez(tmp_path / "map.npz", **arrays)
    with pytest.raises(UserError, match=word) as told:
        read_map(tmp_path / "map.npz")
    assert str(told.value).startswith(f"{tmp_path / 'map.npz'}: ")
    assert str(told.value).count(str(tmp_path)) == 1


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "no header"),
        ("x,y,p\n1,2,3", "no header"),
        ("lon;lat;poa\n22,1;60,2;1", "has semicolons between its columns; write commas"),
        ("lon\tlat\tpoa\n22.1\t60.2\t1", "has tabs between its columns; write commas"),
        ("lon,lat,poa\n", "holds no cells"),
        ("lon,lat,poa\n22.1,60.2,often", "line 2: write a number"),
        ("lon,lat,poa\n22.1,60.2,1\n22.2,60.2,1", "lat: is the same everywhere"),
        ("lon,lat,poa\n22.1,60.2,1\n22.1,60.2,1\n22.2,60.3,1", "tells a cell twice"),
        ("lon,lat,poa\n22.1,60.2,1\n22.15,60.25,1\n22.287,60.3,1", "on no grid"),
        ("lon,lat,poa\n450000,6670000,1\n450010,6670010,1", "another CRS"),
        ("lon,lat,poa\n22.1,60.2,1\n22.2,60.3,-1", "holds -1"),
        ("lon,lat,poa\n22.1,60.2,1\n22.2,60.3,nan", "NaN"),
    ],
)
def test_bad_tables_are_told_in_one_sentence(tmp_path, text, word):
    (tmp_path / "map.csv").write_text(text)
    with pytest.raises(UserError, match=word):
        read_map(tmp_path / "map.csv")


@pytest.mark.parametrize("name", ["map.npz", "map.tif", "map.csv"])
def test_a_file_of_something_else_is_refused(tmp_path, name):
    if name.endswith("tif"):
        pytest.importorskip("rasterio")
    (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    with pytest.raises(UserError, match=name):
        read_map(tmp_path / name)
    with pytest.raises(UserError, match="no such file"):
        read_map(tmp_path / f"other-{name}")
    with pytest.raises(UserError, match=r"give a \.npz, \.csv, \.tif, \.tiff file"):
        read_map(tmp_path / "map.xlsx")


@pytest.mark.parametrize("row", ["0.0,0.0\0,1.0", "0.0,0.0," + "1" * 200_000])
def test_what_no_csv_reader_takes_is_refused(tmp_path, row):
    (tmp_path / "map.csv").write_text(f"lon,lat,poa\n{row}\n")
    with pytest.raises(UserError, match=r"map\.csv: (is no CSV file|line 2)"):
        read_map(tmp_path / "map.csv")


@settings(max_examples=60)
@given(st.sampled_from(["npz", "csv"]), st.data())
def test_a_damaged_map_is_read_or_refused(tmp_path_factory, kind, data):
    path = lon_lat_file(tmp_path_factory.mktemp("maps"), kind, np.ones((3, 4)), BOUNDS)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.sampled_from([len(content), len(content) // 2]))])
    try:
        cells = read_map(path)
    except UserError as error:
        sentence = str(error)
    else:
        assert cells.poa.sum() == pytest.approx(1.0)
        assert cells.poa.min() >= 0.0
        return
    assert sentence.startswith(f"{path}: ")
    assert "\n" not in sentence


@pytest.mark.parametrize("kind", ["npz", "csv"])
@pytest.mark.parametrize("extent_deg", [1e-300, 1e-12])
def test_a_map_of_no_extent_is_refused(tmp_path, kind, extent_deg):
    """The outline has an area of 0, or one of rounding errors."""
    path = lon_lat_file(tmp_path, kind, np.ones((3, 4)), (0.0, 0.0, extent_deg, extent_deg))
    with pytest.raises(UserError, match=r"its cells are .* m wide, which no map resolves"):
        read_map(path)


def test_few_cells_that_are_very_long_do_not_become_millions(tmp_path):
    path = lon_lat_file(tmp_path, "npz", np.ones((3, 4)), (22.0, 60.0, 23.0, 60.00000001))
    with pytest.raises(UserError, match="much longer than wide"):
        read_map(path)


def test_maps_in_other_frames_come_onto_one_grid():
    near, far = (
        cells_of(gaussian(20, 40, 9)),
        cells_of(gaussian(60, 60, 9), 20.0, frame=LocalFrame(60.21, 22.12)),
    )
    one, other = on_one_grid([near, far])
    assert one.bounds_m == other.bounds_m
    assert one.frame == other.frame == FRAME
    assert one.cell_size_m == 10.0
    assert mean_xy(one) == pytest.approx(mean_xy(near), abs=0.5)
    there = far.frame.geodetic_from_enu([[*mean_xy(far), 0.0]])
    expected = FRAME.enu_from_geodetic(there)[0, :2]
    assert mean_xy(other) == pytest.approx(expected, abs=0.1 * far.cell_size_m)
    assert mixed([one, other], [0.4, 0.6]).poa.sum() == pytest.approx(1.0)


def test_a_grid_of_too_many_cells_is_refused():
    with pytest.raises(UserError, match=r"cell_size_m: 0\.01 m make 100,000,000 cells"):
        grid_over(shapely.box(0, 0, 100, 100), 0.01, FRAME)


def test_a_map_that_is_searched_for_ever_leaves_nothing():
    cells = cells_of(np.ones((2, 2)))
    with pytest.raises(UserError, match="nothing is left"):
        cells.after_coverage(np.full((2, 2), 1e4))
    assert cells.pos_of(np.full((2, 2), 1.0)) == pytest.approx(1.0 - np.exp(-1.0))


def test_a_geotiff_of_a_map_is_read_back_in_its_place(tmp_path):
    pytest.importorskip("rasterio")
    cells = cells_of(gaussian(20, 40, 9), origin=(-35.0, 72.5))
    write_geotiff(tmp_path / "map.tif", cells)
    read = read_map(tmp_path / "map.tif", FRAME)
    assert read.cell_size_m == pytest.approx(cells.cell_size_m, rel=1e-3)
    assert mean_xy(read) == pytest.approx(mean_xy(cells), abs=0.2)


def test_heights_come_from_a_geotiff_that_covers_the_map(tmp_path):
    pytest.importorskip("rasterio")
    x, y = np.moveaxis(cells_of(np.ones((50, 50))).centres_xy_m, -1, 0)
    write_geotiff(tmp_path / "dem.tif", ProbabilityMap(0.3 * x - 0.1 * y, 10.0, np.zeros(2), FRAME))
    inside = cells_of(np.ones((20, 20)), 13.0, (100.0, 120.0))
    heights, _ = read_heights(tmp_path / "dem.tif", inside)
    east, north = np.moveaxis(inside.centres_xy_m, -1, 0)
    assert heights == pytest.approx(0.3 * east - 0.1 * north, abs=0.01)
    with pytest.raises(UserError, match=r"dem\.tif: has no height for \d+% of the map"):
        read_heights(tmp_path / "dem.tif", cells_of(np.ones((9, 9)), 10.0, (450.0, 100.0)))
