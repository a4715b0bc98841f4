"""What a node makes of its parameters and of other nodes' answers, without ROS: its link is a stand-in."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.flights import on_ros
from skysweep.flights.on_ros import Settings, ros_flight
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.ros import messages as m
from skysweep.ros.parts import RosDetector
from skysweep.types import Detections, Frame

LENS, NOWHERE = Lens(320, 180, 1.4), CameraPose(np.zeros(3), np.eye(3))


@pytest.fixture
def parameters(tmp_path, monkeypatch):
    """The parameters that the node was given."""
    given = {}

    def link(_name, arguments):
        return SimpleNamespace(parameter=given.get, close=lambda: None)

    monkeypatch.setattr(on_ros, "RosLink", link)
    monkeypatch.chdir(tmp_path)
    return given


def test_the_default_folder_is_named_by_the_parameters_and_new(parameters):
    parameters |= {"scenario": "sparse", "seed": 3}
    with ros_flight(Settings("clusters", 0)) as flight:
        assert flight.folder == Path("runs", "sparse-ros-seed3")
        assert flight.scenario.name == "sparse"
    flight.folder.mkdir(parents=True)
    with ros_flight(Settings("clusters", 0)) as flight:
        assert flight.folder == Path("runs", "sparse-ros-seed3-2")


def test_a_folder_that_is_given_is_kept(parameters):
    with ros_flight(Settings(out="elsewhere")) as flight:
        assert flight.folder == Path("elsewhere")


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"seed": -1}, "seed: is -1; write 0 or more"),
        ({"speed": 0.0}, "speed: must be above 0"),
        ({"speed": math.nan}, "speed: must be above 0"),
    ],
)
def test_a_parameter_out_of_range_is_one_sentence(given, sentence, parameters):
    parameters |= given
    with pytest.raises(UserError, match=sentence), ros_flight(Settings()):
        pass


def test_of_boxes_of_unknown_classes_alone_the_node_warns_once():
    warnings, answers = [], []
    node = SimpleNamespace(get_logger=lambda: SimpleNamespace(warning=warnings.append))
    inlet = SimpleNamespace(name="/yolo", wait=lambda _wanted, _patience_s: answers.pop(0))
    link = SimpleNamespace(
        node=node,
        advertise=lambda *_: None,
        listen=lambda *_: inlet,
        wait_for_listener=lambda *_: True,
        listeners=lambda _: 0,
    )
    detector = RosDetector(link, "/yolo", ("stop sign", "person"), 0.25)
    frame = Frame(1.0, np.zeros((180, 320, 3), np.uint8), NOWHERE, LENS)

    def found(*names):
        boxes, confidences = np.array([[1.0, 2.0, 3.0, 4.0]] * len(names)), np.full(len(names), 0.9)
        told = Detections(1.0, boxes.reshape(-1, 4), confidences, names, NOWHERE, LENS)
        answers.append(SimpleNamespace(message=m.detections(told)))
        return detector.detect(frame).class_names

    assert found() == ()
    assert found("0", "person") == ("person",)
    assert not warnings
    assert found("11", "0", "11") == ()
    assert found("7") == ()
    assert warnings == [
        "/yolo: boxes of '0', '11' are ignored; publish what the mission looks for as 'stop sign', 'person'"
    ]
