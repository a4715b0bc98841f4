"""ROS 2: a mission as a node, a detector as a node, and their cost."""

from __future__ import annotations

import os
from contextlib import ExitStack, closing
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from skysweep.cli.answers import JsonOption, answer
from skysweep.cli.common import (
    ScenarioArg,
    SeedOption,
    SensorOption,
    SetOption,
    changes_of,
    friendly,
    say,
    spinner,
)
from skysweep.cli.live import (
    LOOPBACK,
    HostOption,
    LiveOption,
    NoBrowserOption,
    PortOption,
    TilesOption,
    live_page,
)
from skysweep.cli.missions import answer_mission, flying

app = typer.Typer(no_args_is_help=True, help="Fly missions, and look for targets, as ROS 2 nodes.")

_ROS_ARGUMENTS = "skysweep.ros_arguments"


class _RosCommand(TyperCommand):
    """A command that leaves everything after ``--ros-args`` to ROS."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        begin = args.index("--ros-args") if "--ros-args" in args else len(args)
        ctx.meta[_ROS_ARGUMENTS] = tuple(args[begin:])
        return super().parse_args(ctx, args[:begin])


PatienceOption = Annotated[
    float, typer.Option("--patience", min=0.1, help="Seconds to wait for the other nodes to appear.")
]


@app.command("fly", cls=_RosCommand)
@friendly
def ros_fly(
    context: typer.Context,
    scenario: ScenarioArg = "clusters",
    change: SetOption = None,
    seed: SeedOption = 0,
    sensor: SensorOption = "imaging",
    speed: Annotated[float, typer.Option(min=0.01, help="Vehicle time over wall time, at most.")] = 1.0,
    wait: Annotated[bool, typer.Option("--wait", help="Begin when the service ~/start is called.")] = False,
    camera: Annotated[str, typer.Option(help="Topic of pictures. Default: rendered.")] = "",
    detector: Annotated[
        str, typer.Option(help="Topic of another node's detections. Default: the scenario's detector.")
    ] = "",
    pose: Annotated[str, typer.Option(help="Topic of odometry. Default: the vehicle's own.")] = "",
    out: Annotated[Path | None, typer.Option(help="Run folder. Default: runs/SCENARIO-...")] = None,
    live: LiveOption = False,
    host: HostOption = LOOPBACK,
    port: PortOption = None,
    no_browser: NoBrowserOption = False,
    tiles: TilesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly one mission with pictures, poses, paths, detections and targets on topics.

    Services of the node: ~/start, ~/pause, ~/abort (std_srvs/Trigger). With --live it can be watched and
    steered in the browser, too. ROS arguments follow --ros-args; every option but --set, --json and those of
    the live page is a parameter too (--wait is autostart:=false).

    Examples:

        skysweep ros fly clusters

        skysweep ros fly clusters --sensor statistical --speed 5 --wait

        skysweep ros fly clusters --live --speed 5

        skysweep ros fly clusters --detector /my_model/detections

        skysweep ros fly --ros-args -r __ns:=/uav1 -p scenario:=clusters -p seed:=3
    """
    from skysweep.flights.on_ros import Settings, ros_flight
    from skysweep.flights.rig import Rig

    settings = Settings(scenario, seed, sensor, speed, not wait, str(out or ""), camera, detector, pose)
    with ExitStack() as page:
        with ros_flight(settings, changes_of(change), context.meta[_ROS_ARGUMENTS]) as flight:
            folder = flight.folder
            orders = page.enter_context(live_page(folder, live, host, port, no_browser, tiles))
            with flying(folder.name, folder) as watch:
                summary = flight.fly(watch.over(Rig(operator=orders)))
        answer_mission(as_json, folder, summary)


@app.command("detect", cls=_RosCommand)
@friendly
def ros_detect(
    context: typer.Context,
    images: Annotated[str, typer.Option(help="Topic of pictures.")] = "camera/image_raw",
    model: Annotated[str, typer.Option(help="'skysweep' or the path of an ONNX file.")] = "skysweep",
    confidence: Annotated[
        float,
        typer.Option(
            "--confidence", "--confidence-min", min=0.0, max=1.0, help="Detections below are dropped."
        ),
    ] = 0.25,
    threads: Annotated[int, typer.Option(min=1, max=256, help="Of the detector.")] = 1,
    patience: PatienceOption = 30.0,
) -> None:
    """Look for targets in the pictures of a topic; publish detections until Ctrl-C.

    Examples:

        skysweep ros detect

        skysweep ros detect --images /camera/color/image_raw --model my-yolo.onnx --threads 4
    """
    from skysweep.detection.yolo import YoloDetector
    from skysweep.ros.detector_node import serve_detector
    from skysweep.ros.link import RosLink

    finder = YoloDetector(model, confidence_min=confidence, threads=threads)
    with (
        closing(RosLink("detector", arguments=context.meta[_ROS_ARGUMENTS])) as link,
        spinner() as progress,
    ):
        task = progress.add_task(f"waiting for {link.node.resolve_topic_name(images)}")

        def count(pictures: int, boxes: int) -> None:
            progress.update(task, description=f"{pictures} pictures answered, {boxes} boxes")

        try:
            serve_detector(link, finder, images, patience, count)
        except KeyboardInterrupt:
            say("stopped")


@app.command("measure", cls=_RosCommand)
@friendly
def ros_measure(
    context: typer.Context,
    width: Annotated[int, typer.Option(min=16, max=8192, help="Pixels.")] = 640,
    height: Annotated[int, typer.Option(min=16, max=8192, help="Pixels.")] = 360,
    rate: Annotated[float, typer.Option(min=0.1, max=200, help="Pictures a second.")] = 10.0,
    seconds: Annotated[float, typer.Option(min=1.0, help="How long.")] = 20.0,
    patience: PatienceOption = 10.0,
    as_json: JsonOption = False,
) -> None:
    """Publish pictures; say what that costs and how long another node's detections take.

    Needs a detector that listens: skysweep ros detect, in another terminal.

    Examples:

        skysweep ros measure

        skysweep ros measure --width 1280 --height 720 --rate 30
    """
    from skysweep.ros.link import RosLink
    from skysweep.ros.measure import measure

    say(f"publishing for {seconds:g} s")
    with closing(RosLink("measure", arguments=context.meta[_ROS_ARGUMENTS])) as link:
        figures = measure(link, width, height, rate, seconds, patience)
    record = asdict(figures) | {"cpu_cores": os.cpu_count(), "load": os.getloadavg()[0]}
    answer(
        as_json,
        record,
        f"{width}x{height} at {rate:g} Hz: publishing takes {figures.core_share:.1%} of a core\n"
        f"{figures.answered} of {figures.pictures} pictures answered; from picture to detections "
        f"{figures.latency_median_s * 1e3:.0f} ms (median), {figures.latency_p95_s * 1e3:.0f} ms (95 %)\n"
        f"machine: {record['cpu_cores']} cores, load {record['load']:.1f}",
    )
