"""Maps of where a target may be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skysweep.cli import completion
from skysweep.cli.common import SeedOption, friendly, lon_lat_of, refuse_to_replace, tell, warn, working
from skysweep.errors import UserError
from skysweep.text import percent

if TYPE_CHECKING:
    import shapely

    from skysweep.arrays import F64
    from skysweep.geometry.frames import LocalFrame
    from skysweep.planning.prior.maps import ProbabilityMap

app = typer.Typer(no_args_is_help=True, help="Maps of where a target may be, for `plan --prior`.")

_ACROSS = 200  # cells along a new map's longer side
_WORTH_SAYING = 0.01  # of where the target may be, that lies outside a map
_WORTH_A_WARNING = 0.1
_SEA_MARGIN = 0.1  # of the particles' extent, that a map of drift is larger on each side

LkpOption = Annotated[
    str, typer.Option("--lkp", metavar="LON,LAT", help="Last known position, degrees (WGS 84).")
]
MarkOption = Annotated[
    str | None,
    typer.Option("--lkp", metavar="LON,LAT", help="Last known position, to be drawn into the picture."),
]
OverOption = Annotated[
    str | None,
    typer.Option(metavar="SOURCE", help="Scenario or area to make the map of. Default: around --lkp."),
]
CellOption = Annotated[
    float | None,
    typer.Option(help=f"Side of a cell, m. Default: {_ACROSS} cells along the longer side."),
]
OutOption = Annotated[
    Path, typer.Option(help="Map to write (.npz); a picture, and a GeoTIFF with skysweep[geo], go beside it.")
]


@app.command("lost-person")
@friendly
def lost_person(
    lkp: LkpOption,
    category: Annotated[str, typer.Option(help="Of Koester's tables: hiker or dementia.")] = "hiker",
    ecoregion: Annotated[
        str, typer.Option(help="temperate or dry, mountainous or flat; for dementia also urban.")
    ] = "temperate flat",
    within_m: Annotated[
        str | None,
        typer.Option(
            metavar="M,M,M,M", help="Own distances instead: within which 25, 50, 75 and 95 % were found."
        ),
    ] = None,
    over: OverOption = None,
    cell_m: CellOption = None,
    out: OutOption = Path("lost-person.npz"),
) -> None:
    """Map a person lost on land: distances from the last known position at which such people were found.

    The published distances are Koester's (Lost Person Behavior, 2008), from secondary copies: check them
    against the book before a search relies on them.

    Examples:

        skysweep prior lost-person --lkp 22.1,60.2 --category hiker --ecoregion "temperate flat"

        skysweep prior lost-person --lkp 22.1,60.2 --within-m 200,600,1500,4000 --over my-area.kml
    """
    import shapely

    from skysweep.planning.prior.lost_person import Distances, distances_of, with_share

    if within_m is None:
        distances = distances_of(category, ecoregion)
    else:
        near, half, far, farthest = _numbers(within_m, "--within-m", 4)
        distances = Distances("own", "own", (near, half, far, farthest))
    reach_m = distances.within_m[-1]
    cells, here = _cells(lkp, over, cell_m, shapely.box(-reach_m, -reach_m, reach_m, reach_m))
    lost, share = with_share(cells, here, distances)
    lost = _only_inside(cells, lost, share)
    _write(out, f"{distances.category}, {distances.ecoregion}", lost, here, read=[over])


@app.command("drift")
@friendly
def drift(
    lkp: LkpOption,
    hours: Annotated[float, typer.Option(help="Since the last known position.")],
    wind: Annotated[
        list[str],
        typer.Option(metavar="MPS,FROM", help="m/s and compass degrees it blows FROM; may be repeated."),
    ],
    current: Annotated[
        list[str],
        typer.Option(metavar="MPS,TO", help="m/s and compass degrees it flows TO; may be repeated."),
    ],
    leeway: Annotated[str, typer.Option(help="Class of Allen and Plourde (1999).")] = "PIW-1",
    lkp_std_m: Annotated[float, typer.Option(help="Of the last known position on each axis.")] = 100.0,
    wind_std: Annotated[float, typer.Option(help="Of the wind's components, m/s.")] = 2.0,
    current_std: Annotated[float, typer.Option(help="Of the current's components, m/s.")] = 0.1,
    over: OverOption = None,
    cell_m: CellOption = None,
    seed: SeedOption = 0,
    out: OutOption = Path("drift.npz"),
) -> None:
    """Map what drifts at sea: Monte Carlo of wind, current and leeway since the last known position.

    Winds and currents that are repeated follow each other, each for an equal part of the time.

    Examples:

        skysweep prior drift --lkp 21.5,59.8 --hours 3 --wind 8,225 --current 0.3,90 --leeway PIW-1

        skysweep prior drift --lkp 21.5,59.8 --hours 6 --wind 8,225 --wind 11,250 --current 0.3,90
    """
    import numpy as np
    import shapely

    from skysweep.planning.prior.checks import positive
    from skysweep.planning.prior.drift import Weather, drifted, map_of_particles, share_on
    from skysweep.scenarios.leeway import LEEWAY

    if leeway not in LEEWAY:
        raise UserError(f"--leeway {leeway}: is not in the table; write one of {', '.join(LEEWAY)}")
    winds, currents = _steps(wind, "--wind", -1.0), _steps(current, "--current", 1.0)
    n = max(len(winds), len(currents))
    if {len(winds), len(currents)} - {1, n}:
        raise UserError(
            f"--wind, --current: there are {len(winds)} and {len(currents)}; write one, or as many "
            "as of the other"
        )
    shape = (n, 2)
    weather = Weather(
        3600.0 * positive(hours, "--hours", "hours") / n,
        np.broadcast_to(winds, shape),
        np.broadcast_to(currents, shape),
        wind_std,
        current_std,
    )
    frame = _frame_at(lkp)
    particles = drifted(LEEWAY[leeway], weather, (0.0, 0.0), lkp_std_m, np.random.default_rng(seed))
    (west, south), (east, north) = particles.min(axis=0), particles.max(axis=0)
    reach = shapely.box(west, south, east, north).union(shapely.Point(0.0, 0.0)).envelope
    margin_m = _SEA_MARGIN * max(east - west, north - south)
    around = reach.buffer(margin_m, join_style="mitre")
    if around.is_empty and over is None:
        raise UserError(
            "--lkp-std-m, --wind-std, --current-std: leave one place to be at; write one of them above 0, or "
            "name an area with --over"
        )
    cells, here = _cells(lkp, over, cell_m, around)
    if cells.frame != frame:
        heights = np.zeros(len(particles))
        particles = cells.frame.enu_from_geodetic(
            frame.geodetic_from_enu(np.column_stack([particles, heights]))
        )[:, :2]
    drifting = map_of_particles(cells, particles, smooth_m=2.0 * cells.cell_size_m)
    inside = _only_inside(cells, drifting, share_on(cells, particles))
    _write(out, f"{LEEWAY[leeway].name}, after {hours:g} h", inside, here, read=[over])


@app.command("terrain")
@friendly
def terrain(
    prior: Annotated[Path, typer.Argument(metavar="MAP", help="Map to change (.npz, .tif, .csv).")],
    near: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE:M:FACTOR", help="Near trails or streams (GeoJSON); may be repeated."),
    ] = None,
    inside: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE:FACTOR", help="In water or forest (GeoJSON); may be repeated."),
    ] = None,
    slope: Annotated[
        str | None,
        typer.Option(metavar="DEG:FACTOR,...", help="By steepness: each factor up to so many degrees."),
    ] = None,
    heights: Annotated[
        str | None,
        typer.Option(help="Ground for --slope: a GeoTIFF of heights, or a scenario with terrain."),
    ] = None,
    lkp: MarkOption = None,
    out: OutOption = Path("terrain.npz"),
) -> None:
    """Multiply a map with likelihood factors: how much more often people are found on such ground.

    The factors are yours; none is shipped.

    Example:

        skysweep prior terrain lost-person.npz --near trails.geojson:50:3 --inside lake.geojson:0
        --slope 15:1,30:0.5,90:0.1 --heights dem.tif
    """
    from skysweep.planning.prior.features import read_features
    from skysweep.planning.prior.map_files import read_map
    from skysweep.planning.prior.terrain import factors_near, factors_within, slope_deg, slope_factors

    if not (near or inside or slope):
        raise UserError("--near, --inside, --slope: are missing; write at least one of them")
    cells = changed = read_map(prior)
    read: list[Path | str | None] = [prior, heights]
    for text in near or []:
        path, (within_m, factor) = _with_numbers(text, "--near", "FILE:M:FACTOR")
        read.append(path)
        shapes = read_features(path, cells.frame)
        changed = _times(changed, factors_near(cells, shapes, within_m, factor), f"--near {text}")
    for text in inside or []:
        path, (factor,) = _with_numbers(text, "--inside", "FILE:FACTOR")
        read.append(path)
        shapes = read_features(path, cells.frame)
        changed = _times(changed, factors_within(cells, shapes, factor), f"--inside {text}")
    if slope is not None:
        classes = [_numbers(part.replace(":", ","), "--slope", 2) for part in slope.split(",")]
        slopes = slope_deg(_heights(heights, cells), cells.cell_size_m)
        changed = _times(
            changed,
            slope_factors(slopes, *zip(*classes, strict=True)),
            f"--slope {slope}",
            "that --heights has slopes there",
        )
    _write(out, f"{prior.stem}, changed by terrain", changed, _mark(lkp, cells), read=read)


@app.command("mix")
@friendly
def mix(
    maps: Annotated[list[str], typer.Argument(metavar="MAP:WEIGHT...", help="Maps and how likely each is.")],
    lkp: MarkOption = None,
    out: OutOption = Path("mixed.npz"),
) -> None:
    """Mix maps of scenarios that exclude each other: their weighted sum, on one grid over all of them.

    Example:

        skysweep prior mix terrain.npz:0.7 drift.npz:0.3 --out map.npz
    """
    from skysweep.planning.prior.map_files import read_map
    from skysweep.planning.prior.maps import mixed
    from skysweep.planning.prior.rasters import on_one_grid

    given = [_with_numbers(text, "MAP:WEIGHT", "MAP:WEIGHT") for text in maps]
    with working("bringing the maps onto one grid"):
        mixing = [read_map(path) for path, _ in given]
        grids = on_one_grid(mixing)
    finest_m, cell_m = min(cells.cell_size_m for cells in mixing), grids[0].cell_size_m
    if cell_m > 1.001 * finest_m:
        warn(f"cells: are {cell_m:.3g} m wide, as {finest_m:.3g} m over all maps would be too many")
    title = " + ".join(f"{weight:g} {path.stem}" for path, (weight,) in given)
    both = mixed(grids, [weight for _, (weight,) in given])
    _write(out, title, both, _mark(lkp, both), read=[path for path, _ in given])


@app.command("after")
@friendly
def after(
    prior: Annotated[Path, typer.Argument(metavar="MAP", help="Map that was searched (.npz, .tif, .csv).")],
    searched: Annotated[
        list[Path],
        typer.Option(
            help="Run folder or .plan that was flown; may be repeated.", autocompletion=completion.runs
        ),
    ],
    sweep_width_m: Annotated[
        float | None,
        typer.Option(help="Effective sweep width, m. Default: each run by its POD map, look by look."),
    ] = None,
    lkp: MarkOption = None,
    out: OutOption = Path("after.npz"),
) -> None:
    """Update a map by searches that did not find the target (Bayes): the map after each sortie.

    Example:

        skysweep prior after map.npz --searched saturday --searched sunday
    """
    from skysweep.cli.searched import coverage_of_searches
    from skysweep.planning.prior.map_files import read_map

    cells = read_map(prior)
    coverage, tracks = coverage_of_searches(cells, searched, sweep_width_m, sweep_width_m)
    several = "es" if len(searched) > 1 else ""
    title = f"{prior.stem} after {len(searched)} unsuccessful search{several}"
    left = cells.after_coverage(coverage)
    _write(out, title, left, _mark(lkp, cells), tracks, read=[prior, *searched])
    tell(f"POS of what was flown: {cells.pos_of(coverage):.1%} of the map before")


def _write(
    out: Path,
    title: str,
    cells: ProbabilityMap,
    last_known_xy_m: F64 | None = None,
    tracks: list[F64] | None = None,
    read: Sequence[Path | str | None] = (),
) -> None:
    """Write a map, its picture and its GeoTIFF; nothing of what was ``read`` for it is replaced."""
    from skysweep.errors import MissingExtraError
    from skysweep.files.writing import whole_files
    from skysweep.planning.prior.map_files import write_geotiff, write_map
    from skysweep.planning.prior.map_picture import draw_map

    if out.suffix.lower() != ".npz":
        raise UserError(f"--out {out}: is no .npz; write the name of one, a picture goes beside it")
    refuse_to_replace(read, *(out.with_suffix(suffix) for suffix in (".npz", ".png", ".tif")))
    written = [out, out.with_suffix(".png")]
    with working(f"writing {out}"), whole_files(out.parent) as unfinished:
        write_map(unfinished / out.name, cells)
        draw_map(unfinished / written[1].name, title, cells, last_known_xy_m, tracks or [])
        try:
            write_geotiff(unfinished / f"{out.stem}.tif", cells)
            written.append(out.with_suffix(".tif"))
        except MissingExtraError:
            pass
    rows, columns = cells.poa.shape
    tell(f"{columns} x {rows} cells of {cells.cell_size_m:.1f} m: {', '.join(map(str, written))}")


def _frame_at(lkp: str) -> LocalFrame:
    from skysweep.geometry.frames import LocalFrame

    longitude, latitude = lon_lat_of(lkp, "--lkp")
    return LocalFrame(latitude, longitude)


def _cells(
    lkp: str, over: str | None, cell_m: float | None, around_m: shapely.Polygon
) -> tuple[ProbabilityMap, F64]:
    """The cells of a new map, and the last known position (2,) on them, ENU metres."""
    from skysweep.cli.common import scenario_or_area
    from skysweep.planning.prior.flown import ground_path
    from skysweep.planning.prior.maps import grid_over

    frame, area_m = _frame_at(lkp), around_m
    here = (frame.latitude_deg, frame.longitude_deg)
    if over is not None:
        scenario = scenario_or_area(over)
        frame, area_m = scenario.frame, scenario.area_enu_m
    west, south, east, north = area_m.bounds
    cells = grid_over(
        area_m, cell_m if cell_m is not None else max(east - west, north - south) / _ACROSS, frame
    )
    return cells, ground_path([here], frame)[0]


def _only_inside(cells: ProbabilityMap, found: ProbabilityMap, share: float) -> ProbabilityMap:
    """The map without the corners around the area that the cells are of. What is left out is said.

    ``share`` is the probability that the target is within the map's bounds at all.
    """
    inside = cells.poa > 0.0
    outside = 1.0 - share * float(found.poa[inside].sum())
    words = f"outside the area: {percent(outside)} of where the target may be; the map is of the rest"
    if outside > _WORTH_A_WARNING:
        warn(f"{words}, as if it were there for sure: make it larger, or plan for that too")
    elif outside > _WORTH_SAYING:
        tell(words)
    return found.times(inside)


def _mark(lkp: str | None, cells: ProbabilityMap) -> F64 | None:
    from skysweep.planning.prior.flown import ground_path

    if lkp is None:
        return None
    longitude, latitude = lon_lat_of(lkp, "--lkp")
    place: F64 = ground_path([(latitude, longitude)], cells.frame)[0]
    return place


def _steps(texts: list[str], option: str, towards: float) -> F64:
    """East and north (N, 2) in m/s of speeds and compass directions, to where they lead."""
    import numpy as np

    speed_mps, degrees = np.array([_numbers(text, option, 2) for text in texts]).T
    if speed_mps.min() < 0.0:
        raise UserError(f"{option}: has a speed of {speed_mps.min():g} m/s; write speeds from 0 on")
    angle_rad = np.radians(degrees)
    return np.asarray(towards * speed_mps[:, None] * np.column_stack([np.sin(angle_rad), np.cos(angle_rad)]))


def _heights(source: str | None, cells: ProbabilityMap) -> F64:
    from skysweep.planning.prior.map_files import read_heights
    from skysweep.planning.prior.terrain import heights_of_scenario
    from skysweep.scenarios.files import load_scenario

    if source is None:
        raise UserError("--heights: is missing; write a GeoTIFF of heights or a scenario for --slope")
    if Path(source).suffix.lower() in (".tif", ".tiff"):
        heights_m, tells_unit = read_heights(Path(source), cells)
        if not tells_unit:
            warn(
                f"--heights {source}: tells no unit, and its heights are taken for metres; if they are feet, "
                f"say so with  rio edit-info --bidx 1 --units ft {Path(source).name}"
            )
        return heights_m
    return heights_of_scenario(load_scenario(source), cells)


def _times(
    cells: ProbabilityMap, factors: F64, option: str, check: str = "that its shapes lie on the map"
) -> ProbabilityMap:
    """The map with factors. Where they say nothing about it, it is said what to ``check``."""
    if (factors == 1.0).all():
        warn(f"{option}: changes no cell; check {check}")
    return cells.times(factors)


def _with_numbers(text: str, option: str, form: str) -> tuple[Path, list[float]]:
    path, *numbers = text.rsplit(":", form.count(":"))
    if len(numbers) != form.count(":") or not path:
        raise UserError(f"{option} {text}: is not understood; write {form}")
    return Path(path), _numbers(",".join(numbers), f"{option} {text}", len(numbers))


def _numbers(text: str, option: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise UserError(f"{option}: '{text}' is not understood; write {count} number{'s' * (count > 1)}")
    return numbers
