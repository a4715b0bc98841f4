"""Every place that reads a user's file refuses what has no end, and what is too large."""

import os

import pytest

from skysweep.detection.training.reading import read_dataset
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.experiments.sweep.spec import load_spec
from skysweep.files.reading import read_limited, read_text_limited
from skysweep.planning.area_files import read_area
from skysweep.planning.qgc import read_plan
from skysweep.scenarios.files import load_scenario
from skysweep.sensing.statistical.model import StatisticalModel
from skysweep.vehicles.mavlink.signing import read_signing_key

READERS = {
    "sweep": (load_spec, "a.yaml"),
    "signing key": (read_signing_key, "key"),
    "scenario": (load_scenario, "a.yaml"),
    "plan": (read_plan, "a.plan"),
    "area": (read_area, "a.kmz"),
    "sensor model": (StatisticalModel.load, "a.yaml"),
    "detector": (YoloDetector, "a.onnx"),
    "data set": (read_dataset, "a.json"),
}


@pytest.mark.parametrize(("reader", "name"), READERS.values(), ids=READERS)
@pytest.mark.parametrize("endless", ["pipe", "/dev/zero"])
def test_pipes_and_devices_are_refused_unopened(tmp_path, reader, name, endless):
    path = tmp_path / name
    if endless == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(endless)
    refusal = "is a folder or device|there is no such|is a file; write"
    with pytest.raises(UserError, match=rf"{name}: .*({refusal})"):
        reader(path)


def test_a_file_is_read_up_to_its_limit(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_limited(path, 5) == b"12345"
    with pytest.raises(UserError, match="file: is larger than 4e-06 MB"):
        read_limited(path, 4)


def test_text_is_utf_8(tmp_path):
    path = tmp_path / "file"
    path.write_bytes("mökki".encode())
    assert read_text_limited(path, 100) == "mökki"
    path.write_bytes("mökki".encode("latin-1"))
    with pytest.raises(UserError, match="file: is not a text file in UTF-8"):
        read_text_limited(path, 100)


def test_a_key_of_a_gigabyte_is_not_read(tmp_path):
    path = tmp_path / "key"
    with path.open("wb") as file:
        file.truncate(1_000_000_000)
    with pytest.raises(UserError, match="key: is larger than"):
        read_signing_key(path)
