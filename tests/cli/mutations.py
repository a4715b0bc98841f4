"""Valid inputs of every kind, broken at random, and the command line run on each with limits.

    python tests/cli/mutations.py 2000        # the long version; prints what was tried and what was wrong

A case is a few files and a command. It runs in a fork of a process that has imported everything, with 20 s of
CPU and 2 GB more address space. Right is: exit code 0 or 2; with 2 one sentence on standard error, and the
folder as it was; no traceback, no control characters; nothing half-written.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import math
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import yaml

if __name__ == "__main__":
    sys.path.append(str(Path(__file__).parents[1]))  # as pytest does
from warm import Ended, forked, import_all

MEMORY_BYTES = 2 * 10**9
CPU_S = 20
WALL_S = 120

Files = dict[str, bytes]


@dataclass(frozen=True)
class Case:
    """``files`` are written into an empty folder, in which the command runs. ``out_bytes``: size of a file
    that it may write at most, as a full disk would have it."""

    kind: str
    command: tuple[str, ...]
    files: Files
    out_bytes: int | None = None


# --- running a case


def run(case: Case, folder: Path) -> tuple[Ended, Files, Files]:
    """Run a case in a new, empty folder; also what was in it before and after."""
    for name, content in case.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    before = _content(folder)
    ended = forked(case.command, folder, {**os.environ, "COLUMNS": "200"}, WALL_S, partial(_limit, case))
    return ended, before, _content(folder)


def _limit(case: Case) -> None:
    address_space = _virtual_bytes() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (address_space, address_space))
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if case.out_bytes is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (case.out_bytes, case.out_bytes))


def _virtual_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _content(folder: Path) -> Files:
    """Every file and folder below, a folder's name with a slash."""
    paths = (Path(parent) / name for parent, folders, names in os.walk(folder) for name in folders + names)
    return {
        str(path.relative_to(folder)) + "/" * path.is_dir(): b"" if path.is_dir() else path.read_bytes()
        for path in paths
    }


# --- judging it


def faults(ended: Ended, before: Files, after: Files) -> list[str]:
    """What is wrong with how a case ended, a phrase each."""
    found = []
    if ended.code not in (0, 2):
        found.append(f"exit code {ended.code}")
    if "Traceback" in ended.errors:
        found.append(ended.errors.strip().splitlines()[-1])
    if ended.cpu_s > CPU_S:
        found.append(f"{ended.cpu_s:.0f} s of CPU")
    if ended.peak_bytes > MEMORY_BYTES:
        found.append(f"{ended.peak_bytes / 1e9:.1f} GB")
    if steering := re.findall("[\x00-\x08\x0b-\x1f\x7f-\x9f]", ended.output + ended.errors):
        found.append(f"control characters {sorted(set(steering))}")
    if ended.code == 2:
        told = [line for line in ended.errors.splitlines() if line.startswith("error: ")]
        told_by_click = (
            "Usage: " in ended.errors
            or "\N{BOX DRAWINGS LIGHT HORIZONTAL} Error \N{BOX DRAWINGS LIGHT HORIZONTAL}" in ended.errors
        )
        if not told_by_click and (len(told) != 1 or not ended.errors.endswith(f"{told[0]}\n")):
            found.append("not one sentence")
        if changed := {name for name, _ in before.items() ^ after.items()}:
            found.append(f"left {sorted(changed)[:4]}")
    if half := [name for name in after if "unfinished" in name or re.search(r"\btmp\w{8}\b", name)]:
        found.append(f"left {half[:4]}")
    return found


# --- breaking trees (YAML, JSON), bytes and words

NUMBERS: tuple[Any, ...] = (
    *(0, -1, 1e-300, 1e300, -1e30, math.nan, math.inf, -math.inf, 2**31, 2**63, 10**30, 0.5),
    *(91.0, 181.0, 1e-9),
)
ODD: tuple[Any, ...] = (
    *(None, True, False, "", "x", "1e400", "2001-13-45", "\x1b[31mred", "\x00", "a\nb", "[/y]", "ä" * 300),
    *("../../x", "~nobody/x", "\u202e", "\ud800", "zip://x::y", [], {}, [[]], [None], {"a": 1}, {"": None}),
    *([1, 2, 3], [[0, 0], [1, 1]]),
)
_NESTED = "nested-here"


def broken_tree(tree: Any, rng: random.Random) -> Any:
    """A copy with one to three places changed: dropped, doubled, of another type, a wild number, nested."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(tree))
        if places:
            node, key = rng.choice(places)
            _break_at(node, key, rng)
    return tree


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for key in keys:
        yield node, key
        yield from _places(node[key])


def _break_at(node: Any, key: Any, rng: random.Random) -> None:
    value = node[key]
    how = rng.choice(("drop", "double", "retype", "number", "number", "nest", "scale", "rename"))
    if how == "drop":
        del node[key]
    elif how == "double" and isinstance(node, list):
        node.insert(key, value)
    elif how == "scale" and isinstance(value, int | float) and not isinstance(value, bool):
        node[key] = value * rng.choice((-1, 1e-6, 10, 1e3, 1e9))
    elif how == "nest":
        node[key] = rng.choice(
            ([value], [[value]], {"x": value}, f"{_NESTED}{rng.choice((30, 500, 20_000))}.")
        )
    elif how == "rename" and isinstance(node, dict):
        node[rng.choice((f"{key}x", "", "\x1b]0;x\x07", str(key).upper()))] = node.pop(key)
    elif how == "number":
        node[key] = rng.choice(NUMBERS)
    else:
        node[key] = rng.choice(ODD)


def as_yaml(tree: Any) -> bytes:
    return _nested(yaml.safe_dump(tree, sort_keys=False))


def as_json(tree: Any) -> bytes:
    return _nested(json.dumps(tree)).replace(b'"[[', b"[[").replace(b']]"', b"]]")


def _nested(text: str) -> bytes:
    text = re.sub(_NESTED + r"(\d+)\.", lambda match: "[" * int(match[1]) + "]" * int(match[1]), text)
    return text.encode("utf-8", "surrogatepass")


def broken_text(content: bytes, rng: random.Random) -> bytes:
    """One to three numbers or words of a text replaced."""
    text = content.decode()
    for _ in range(rng.choice((1, 1, 2, 3))):
        word = rng.choice(list(re.finditer(r"-?[\d.]+|\w+", text)))
        odd = rng.choice((*map(str, NUMBERS), *(odd for odd in ODD if isinstance(odd, str)), "-" + word[0]))
        text = text[: word.start()] + odd + text[word.end() :]
    return text.encode("utf-8", "surrogatepass")


def broken_bytes(content: bytes, rng: random.Random) -> bytes:
    """Bits flipped, or a piece cut off, cut out, doubled, zeroed or replaced by others."""
    data = bytearray(content)
    how = rng.choice(("flip", "flip", "flips", "truncate", "cut", "double", "zero", "random", "other"))
    start = rng.randrange(len(data))
    end = min(len(data), start + rng.choice((1, 2, 4, 16, 256, 4096)))
    if how in ("flip", "flips"):
        for _ in range(1 if how == "flip" else 20):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif how == "truncate":
        del data[start:]
    elif how == "cut":
        del data[start:end]
    elif how == "double":
        data[start:start] = data[start:end]
    elif how == "other":
        data = bytearray(
            rng.choice((b"", b"\x00" * 100, b"\xff\xfe" * 50, b"{}", b"PAR1PAR1", b"PK\x05\x06"))
        )
    else:
        data[start:end] = bytes(end - start) if how == "zero" else rng.randbytes(end - start)
    return bytes(data)


WORDS = (
    *("", "-1", "0", "1e30", "nan", "inf", "-inf", "99999999999999999999999", "0.5", "x", "true", "é"),
    *("\x1b[31m", "[/y]", "x[/y]", "..", "/", "/dev/null/x", "ftp://h/x", "zip://x", "s3://", "~nobody/x"),
    *("a" * 300, "--", "-x", "--out", "search.n_c=", "=", "search.n_c=[[", "area=1", "name=\x1b", "a.b.c=1"),
    *("search.n_c=1:1e300", "search.n_c=", "camera.rate_hz=2001-13-45", "ros:", "ros:/x", "targets.0=1"),
)


def broken_words(command: Sequence[str], rng: random.Random) -> tuple[str, ...]:
    """A command line with a word replaced, left out, doubled or put in; not the command's own name."""
    words = list(command)
    first = next(k for k, word in enumerate(words) if "." in word or word.startswith("-") or k == 2)
    for _ in range(rng.choice((1, 1, 2))):
        place = rng.randrange(first, len(words) + 1)
        how = rng.choice(("replace", "replace", "replace", "drop", "double", "insert"))
        if how == "insert" or place == len(words):
            words.insert(place, rng.choice(WORDS))
        elif words[place - 1] == "--out" or words[place] == "--out":
            continue  # where it is safe from what would be flown for long
        elif how == "replace":
            words[place] = rng.choice(WORDS)
        elif how == "drop":
            del words[place]
        else:
            words.insert(place, words[place])
    return tuple(words)


# --- valid inputs


def scenario_fields() -> dict[str, Any]:
    """A small scenario with every kind of thing in it."""
    square = [[0, 0], [40, 0], [40, 30], [0, 30]]
    return {
        "name": "tiny",
        "area": {"polygon_enu_m": square, "holes_enu_m": [[[18, 12], [22, 12], [22, 16]]]},
        "home": {"latitude_deg": 60.2, "longitude_deg": 22.1, "position_enu_m": [-5, -5]},
        "geofence_enu_m": [[-30, -30], [80, -30], [80, 80], [-30, 80]],
        "terrain": {"surface": "grass", "hills_height_m": 2.0, "hills_wavelength_m": 100.0, "seed": 1},
        "trees": [{"position_enu_m": [10, 25], "height_m": 5, "crown_radius_m": 1.5, "kind": "conifer"}],
        "forests": [{"trees_per_hectare": 50, "polygon_enu_m": [[30, 20], [40, 20], [40, 30]]}],
        "buildings": [{"position_enu_m": [60, 60], "size_m": [8, 6], "height_m": 3, "yaw_deg": 20}],
        "targets": [{"class": "stop sign", "position_enu_m": [8, 12], "size_m": 0.9, "pose": "face-up"}],
        "distractors": [{"class": "red bucket", "position_enu_m": [26, 22]}],
        "generators": [
            {"class": "boat", "pattern": "clustered", "count": 2, "centres_enu_m": [[20, 8]], "spread_m": 4},
            {"class": "rock", "pattern": "sparse", "count": 2, "seed": None},
        ],
        "scatter_m": 1.0,
        "wind": {"mean_speed_mps": 2, "from_heading_deg": 240},
        "camera": {"hfov_rad": 1.2, "gimbal": {"pitch_deg": -90}},
        "search": {"n_c": 2, "d_c_m": math.inf, "scan_altitude_agl_m": 14, "check_altitude_agl_m": 4},
        "safety": {"no_fly_enu_m": [[[70, 70], [75, 70], [75, 75]]]},
    }  # fmt: skip


SWEEP = {
    "name": "small",
    "scenarios": [{"scenario": "clusters", "label": "a", "set": {"wind.mean_speed_mps": 1.0}}, "mine.yaml"],
    "strategies": ["scan-check", {"strategy": "scan-only", "parameters": {}}],
    "parameters": {"search.n_c": [1, math.inf], "search.c_t": [0.5, 0.6]},
    "points": [{"search.n_c": 3}],
    "seeds": 10,
    "first_seed": 2,
    "sensor": "statistical",
}

RING = [[22.10, 60.20], [22.101, 60.20], [22.101, 60.2006], [22.10, 60.2006], [22.10, 60.20]]
HOLE = [[22.1003, 60.2002], [22.1006, 60.2002], [22.1006, 60.2004], [22.1003, 60.2002]]
GEOJSON = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "x"},
            "geometry": {"type": "Polygon", "coordinates": [RING, HOLE]},
        },
        {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": RING[0]}},
    ],
}


def kml() -> bytes:
    def ring(corners: list[list[float]]) -> str:
        text = " ".join(f"{lon},{lat},0" for lon, lat in corners)
        return f"<LinearRing><coordinates>{text}</coordinates></LinearRing>"

    return (
        '<?xml version="1.0" encoding="UTF-8"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>'
        f"<name>Area</name><Polygon><outerBoundaryIs>{ring(RING)}</outerBoundaryIs>"
        f"<innerBoundaryIs>{ring(HOLE)}</innerBoundaryIs></Polygon></Placemark></Document></kml>"
    ).encode()


def kmz(method: int = zipfile.ZIP_DEFLATED, content: bytes | None = None) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        archive.writestr(zipfile.ZipInfo("doc.kml"), kml() if content is None else content, method)
    return packed.getvalue()


def plan_fields() -> dict[str, Any]:
    """What QGroundControl would save of a small survey with a fence and a rally point."""
    from skysweep.planning.flight_plan import plan_scenario
    from skysweep.planning.qgc import plan_for_qgc
    from skysweep.scenarios.model import Scenario

    scenario = Scenario.model_validate(
        {
            "name": "field",
            "area": {"polygon_enu_m": [[0, 0], [120, 0], [120, 80], [0, 80]]},
            "home": {"position_enu_m": [-5, -5], "latitude_deg": 60.2, "longitude_deg": 22.1},
            "geofence_enu_m": [[-30, -30], [150, -30], [150, 110], [-30, 110]],
            "search": {"scan_altitude_agl_m": 25.0},
        }
    )
    plan: dict[str, Any] = plan_for_qgc(scenario, plan_scenario(scenario)[0]).model_dump(mode="json")
    plan["rallyPoints"]["points"] = [[60.2001, 22.1001, 20.0]]
    return plan


def waypoint_plan(
    *places: tuple[float, float, float], home: Sequence[float] = (60.2, 22.1, 20)
) -> dict[str, Any]:
    """A plan of plain waypoints (latitude, longitude, altitude above home), without survey and fence."""
    items = [
        {"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, *place]}
        for place in places or [(60.2001, 22.101, 30), (60.2005, 22.101, 30), (60.2005, 22.102, 30)]
    ]  # fmt: skip
    mission = {"version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 15, "hoverSpeed": 5}
    mission |= {"plannedHomePosition": list(home), "items": items}
    return {"fileType": "Plan", "version": 1, "groundStation": "QGroundControl", "mission": mission}


def detector_model(names: str | None = "{0: 'person', 1: 'boat', 2: 'stop sign'}") -> bytes:
    """An ONNX file that finds the same two boxes in every picture."""
    import numpy as np
    from onnx import TensorProto, helper, numpy_helper

    rows = np.array([[[4, 4, 20, 20, 0.9, 0], [30, 30, 50, 50, 0.8, 2]]], np.float32)
    graph = helper.make_graph(
        [helper.make_node("Identity", ["rows"], ["out"])],
        "model",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 64, 64])],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)],
        [numpy_helper.from_array(rows, "rows")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if names is not None:
        helper.set_model_props(model, {"names": names})
    content: bytes = model.SerializeToString()
    return content


def labelled_picture() -> Files:
    """A YOLO folder of one grey picture, for a detector to look at."""
    import cv2
    import numpy as np

    _, png = cv2.imencode(".png", np.full((64, 64, 3), 90, np.uint8))
    return {
        "data/images/0.png": png.tobytes(),
        "data/labels/0.txt": b"0 0.2 0.2 0.25 0.25\n",
        "data/data.yaml": b"names: [person, boat, stop sign]\n",
    }


def run_folder(n_lines: int | None = None) -> Files:
    """A mission's folder as ``run/``; with ``n_lines`` as a kill after so many lines leaves it."""
    from skysweep.flights.fly import fly_to_folder
    from skysweep.flights.rig import Rig
    from skysweep.scenarios.model import Scenario

    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "run"
        fly_to_folder(Scenario.model_validate(scenario_fields()), 1, folder, Rig("statistical"))
        files = {f"run/{path.name}": path.read_bytes() for path in folder.iterdir() if path.is_file()}
    if n_lines is not None:
        lines = files["run/journal.jsonl"].splitlines(keepends=True)
        files = {
            "run/config.yaml": files["run/config.yaml"],
            "run/journal.jsonl": b"".join(lines[:n_lines]),
        }
    return files


def sweep_folder() -> Files:
    """A finished sweep's folder as ``sweep/``."""
    from skysweep.experiments.engines import LocalEngine
    from skysweep.experiments.sweep.run import Sweep
    from skysweep.experiments.sweep.spec import parse_spec

    fields = {"scenarios": [{"scenario": scenario_fields() | {"forests": [], "buildings": []}}]}
    fields |= {"name": "small", "parameters": {"search.n_c": [1, 3]}, "seeds": 3}
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "sweep"
        Sweep(parse_spec(yaml.safe_dump(fields), "spec"), folder).fly(LocalEngine(1))
        return {f"sweep/{path.name}": path.read_bytes() for path in folder.iterdir() if path.is_file()}


# --- cases


class Inputs:
    """Valid inputs, made once, and cases made of them."""

    def __init__(self) -> None:
        self.scenario = as_yaml(scenario_fields())
        self.plan, self.waypoints = plan_fields(), waypoint_plan()
        self.model, self.picture = detector_model(), labelled_picture()
        self.flown, self.broken_off, self.swept = run_folder(), run_folder(40), sweep_folder()
        self.good: Files = {"mine.yaml": self.scenario, "file": b"", "m.onnx": self.model, **self.picture}
        self.good |= {"a.plan": as_json(self.plan), "s.yaml": as_yaml(SWEEP), "a.kml": kml(), **self.flown}

    def case(self, rng: random.Random) -> Case:
        """One broken input with a command that reads it."""
        kinds = (
            (self._scenario, 6), (self._plan, 4), (self._area, 5), (self._sweep, 4), (self._model, 2),
            (self._journal, 3), (self._config, 2), (self._table, 2), (self._words, 6),
        )  # fmt: skip
        (made,) = rng.choices([kind for kind, _ in kinds], [weight for _, weight in kinds])
        case: Case = made(rng)
        return case

    def _scenario(self, rng: random.Random) -> Case:
        content = as_yaml(broken_tree(scenario_fields(), rng))
        if rng.random() < 0.15:
            content = broken_bytes(self.scenario, rng)
        command = rng.choice((*[("scenarios", "validate")] * 4, ("scenarios", "show"), ("plan",)))
        return Case("scenario", (*command, "m.yaml"), {"m.yaml": content})

    def _plan(self, rng: random.Random) -> Case:
        plan = rng.choice((self.plan, self.waypoints))
        content = as_json(broken_tree(plan, rng))
        if rng.random() < 0.2:
            content = broken_bytes(as_json(plan), rng)
        files = {"m.plan": content}
        command: tuple[str, ...] = ("fly", "m.plan", "--connection", "nowhere://x", "--timeout", "1")
        if rng.random() < 0.5:
            files["s.yaml"] = (
                b"name: s\narea: {file: m.plan}\nhome: {latitude_deg: 60.2, longitude_deg: 22.1}\n"
            )
            command = ("scenarios", "validate", "s.yaml")
        elif rng.random() < 0.3:
            command = ("plan", "m.plan")
        return Case("plan", command, files)

    def _area(self, rng: random.Random) -> Case:
        suffix = rng.choice(("geojson", "kml", "kmz"))
        if suffix == "geojson":
            content = as_json(broken_tree(GEOJSON, rng))
            if rng.random() < 0.2:
                content = broken_bytes(as_json(GEOJSON), rng)
        else:
            method = rng.choice(
                (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
            )
            content = broken_text(kml(), rng) if rng.random() < 0.5 else kml()
            content = kmz(method, content) if suffix == "kmz" else content
            content = broken_bytes(content, rng) if rng.random() < 0.5 else content
        name = f"m.{suffix}"
        if rng.random() < 0.3:
            return Case(suffix, ("plan", name), {name: content})
        scenario = f"name: s\narea: {{file: {name}}}\nhome: {{latitude_deg: 60.2, longitude_deg: 22.1}}\n"
        files = {name: content, "s.yaml": scenario.encode()}
        return Case(suffix, ("scenarios", "validate", "s.yaml"), files)

    def _sweep(self, rng: random.Random) -> Case:
        content = as_yaml(broken_tree(SWEEP, rng))
        if rng.random() < 0.15:
            content = broken_bytes(as_yaml(SWEEP), rng)
        files = {"m.yaml": content, "mine.yaml": self.scenario, "file": b""}
        return Case("sweep", ("sweep", "m.yaml", "--out", "file/x", "--workers", "1"), files)

    def _model(self, rng: random.Random) -> Case:
        names = rng.choice((None, "5", "'abc'", "{'a': 1}", "[", "[" * 3000, "{1: 2, None: 3}", "\x1b", "0x"))
        content = broken_bytes(self.model, rng) if rng.random() < 0.7 else detector_model(names)
        files = {**self.picture, "m.onnx": content}
        if rng.random() < 0.2:
            files["m.names"] = rng.choice(
                (b"\xff\xfe", b"", b"a\nb\n", b"person\nboat\n\x1b[31m\n", b"\x00" * 99)
            )
        return Case("model", ("detect", "evaluate", "data", "--model", "m.onnx"), files)

    def _journal(self, rng: random.Random) -> Case:
        folder = dict(rng.choice((self.flown, self.broken_off)))
        lines = folder["run/journal.jsonl"].splitlines(keepends=True)
        if rng.random() < 0.6:  # as version 0.1 wrote them, without checksums
            records = [json.loads(line) for line in lines]
            for record in records:
                record.pop("chain")
            number = rng.randrange(len(records))
            records[number] = broken_tree(records[number], rng)
            lines = [as_json(record) + b"\n" for record in records]
        content = b"".join(lines)
        if rng.random() < 0.5:
            content = broken_bytes(content, rng)
        export = ("export", "run", "--format", rng.choice(("cot", "kmz", "geojson", "geotiff")), "--out", "x")
        report = ("report", "run"), ("report", "run", "--out", "out")
        command = rng.choice((*report, ("resume", "run"), export))
        return Case("journal", command, folder | {"run/journal.jsonl": content})

    def _config(self, rng: random.Random) -> Case:
        folder = dict(rng.choice((self.flown, self.broken_off)))
        config = folder["run/config.yaml"]
        tree = yaml.safe_load(config)
        content = broken_bytes(config, rng) if rng.random() < 0.4 else as_yaml(broken_tree(tree, rng))
        command = rng.choice((("report", "run", "--out", "out"), ("resume", "run")))
        return Case("config", command, folder | {"run/config.yaml": content})

    def _table(self, rng: random.Random) -> Case:
        name = rng.choice((*["missions.parquet"] * 4, "timings.parquet", "spec.yaml"))
        content = broken_bytes(self.swept[f"sweep/{name}"], rng)
        return Case("table", ("report", "sweep", "--out", "out"), self.swept | {f"sweep/{name}": content})

    def _words(self, rng: random.Random) -> Case:
        command = rng.choice(COMMANDS)
        return Case("command line", broken_words(command, rng), self.good)


COMMANDS = tuple(
    tuple(line.split())
    for line in (
        "plan clusters --altitude 30 --sidelap 0.2 --heading 10 --hfov 1.2 --speed 5",
        "plan a.kml --altitude 30 --sidelap 0.2",
        "plan a.plan",
        "scenarios show mine.yaml --schema",
        "scenarios validate mine.yaml",
        "run mine.yaml --sensor statistical --seed 3 --n-c 2 --d-c 50 --c-t 0.6 --set wind.mean_speed_mps=1",
        "run mine.yaml --sensor statistical --camera rendered --renderer auto --strategy scan-only",
        "report run --min-recall 0.9",
        "resume run --from-sound-lines",
        "export run --format cot --to udp://127.0.0.1:9 --ttl 1",
        "world export mine.yaml --out file/x --format gz --seed 1 --set search.n_c=1",
        "sweep s.yaml --out file/x --workers 1 --engine local --yes --retry-failed",
        "tune mine.yaml --out file/x --trials 1 --range search.n_c=1:8,inf --fix search.sidelap --seeds 4",
        "fly a.plan --connection nowhere://x --timeout 1 --seed 1 --dry-run --system-id 3",
        "fly mine.yaml --connection nowhere://x --timeout 1 --sensor statistical --set search.n_c=1",
        "detect evaluate data --model m.onnx --confidence 0.3 --tiles 1",
        "calibrate --out file/s.yaml --detector m.onnx --camera mine.yaml --pictures 10 --workers 1",
        "calibrate validate --out file/x --seeds 2 --scenario mine.yaml --n-c 1",
        "compare paper --out file/x --seeds 1 --sensor statistical --set search.c_t=0.6",
        "dataset file/x --images 1 --split train --workers 1",
    )
)


def cases(inputs: Inputs, count: int, seed: int) -> Iterator[Case]:
    """The same cases for the same seed."""
    for number in range(count):
        yield inputs.case(random.Random(f"{seed}-{number}"))


def judged(case: Case) -> tuple[Ended, list[str]]:
    """How a case ends in a folder of its own, and what is wrong with it."""
    with tempfile.TemporaryDirectory() as folder:
        ended, before, after = run(case, Path(folder))
    return ended, faults(ended, before, after)


@contextlib.contextmanager
def judges(workers: int) -> Iterator[Executor]:
    """Fresh processes to fork from: no thread of theirs holds a lock that a fork would wait for."""
    with ProcessPoolExecutor(workers, get_context("spawn"), import_all) as pool:
        yield pool


def made_inputs() -> Inputs:
    """Made in a process of its own: Polars starts threads there."""
    with judges(1) as pool:
        return pool.submit(Inputs).result()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", help="only cases of this kind")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    started, codes, wrong, cpu_s, peak_bytes = time.monotonic(), Counter[tuple[str, int]](), 0, 0.0, 0
    chosen = [
        case
        for case in cases(made_inputs(), options.count, options.seed)
        if options.kind in (None, case.kind)
    ]
    with judges(options.workers) as pool:
        for case, (ended, found) in zip(chosen, pool.map(judged, chosen), strict=True):
            codes[case.kind, ended.code] += 1
            cpu_s, peak_bytes = max(cpu_s, ended.cpu_s), max(peak_bytes, ended.peak_bytes)
            if found:
                wrong += 1
                print(f"{case.kind}: {' '.join(case.command)!r}: {'; '.join(found)}", flush=True)
    for (kind, code), times in sorted(codes.items()):
        print(f"{kind}: exit code {code}: {times}")
    print(
        f"{len(chosen)} cases, {wrong} wrong, {time.monotonic() - started:.0f} s; "
        f"each at most {cpu_s:.1f} s of CPU and {peak_bytes / 1e9:.2f} GB"
    )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
