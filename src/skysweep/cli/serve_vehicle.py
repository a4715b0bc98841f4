"""Serve the embedded vehicle over MAVLink."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skysweep.cli.common import (
    ScenarioArg,
    SeedOption,
    SetOption,
    chosen_scenario,
    friendly,
    say,
    spinner,
    warn,
)
from skysweep.cli.terminal import enter_pressed

if TYPE_CHECKING:
    from skysweep.vehicles.served.autopilot import Autopilot


@friendly
def serve_vehicle(
    scenario: ScenarioArg = "clusters",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Where it sends to: MAVSDK's udpin://127.0.0.1:PORT.")
    ] = 14540,
    gcs_port: Annotated[
        int,
        typer.Option("--gcs-port", min=1, max=65535, help="Where it also sends to: QGroundControl's port."),
    ] = 14550,
    local_port: Annotated[
        int, typer.Option("--local-port", min=0, max=65535, help="Where it listens; 0: any free port.")
    ] = 14580,
    system_id: Annotated[
        int,
        typer.Option("--system-id", min=1, max=254, help="Its MAVLink system id; each vehicle has its own."),
    ] = 1,
    host: Annotated[
        str, typer.Option(help="Host of both programs; another computer opens the vehicle to the network.")
    ] = "127.0.0.1",
    speed: Annotated[float, typer.Option(min=0.1, max=50, help="Vehicle time over wall time.")] = 1.0,
    signing_key: Annotated[
        Path | None, typer.Option(help="File with 64 hexadecimal digits: only frames signed with it count.")
    ] = None,
    change: SetOption = None,
    seed: SeedOption = 0,
) -> None:
    """Let QGroundControl or a MAVSDK program fly the embedded vehicle, as if it were a PX4.

    Enter puts a full battery into the disarmed vehicle. Runs until Ctrl-C.

    Examples:

        skysweep serve-vehicle

        skysweep serve-vehicle person-wilderness --speed 10

        skysweep serve-vehicle --port 14541 --local-port 14581 --system-id 2

        skysweep serve-vehicle --signing-key key.txt
    """
    from skysweep.vehicles.embedded.at_home import embedded_vehicle
    from skysweep.vehicles.mavlink.modes import Refused
    from skysweep.vehicles.mavlink.signing import read_signing_key
    from skysweep.vehicles.served.server import EVERYWHERE, LOOPBACK, VehicleServer, address_of

    chosen = chosen_scenario(scenario, change)
    key = None if signing_key is None else read_signing_key(signing_key)
    to = address_of(host)
    if to != LOOPBACK:
        who = "Anyone with the key" if key else "Anyone who reaches this computer"
        warn(f"{host} is another computer: the vehicle listens on every network. {who} can command it.")
    vehicle, listeners = embedded_vehicle(chosen, seed), [(to, port), (to, gcs_port)]
    interface = LOOPBACK if to == LOOPBACK else EVERYWHERE
    server = VehicleServer(vehicle, chosen, listeners, speed, interface, local_port, key, system_id)
    say(
        f"{chosen.name} at {speed:g}x: MAVSDK udpin://{to}:{port}, QGroundControl {to}:{gcs_port}; "
        f"system {system_id}, listening on {':'.join(map(str, server.address))}. "
        "Enter changes its battery, Ctrl-C ends it."
    )

    def watch(pilot: Autopilot) -> None:
        if enter_pressed():
            try:
                pilot.change_battery()
                say("battery changed")
            except Refused as refusal:
                warn(str(refusal))
        progress.update(task, description=_status(pilot))

    with spinner() as progress:
        task = progress.add_task("")
        try:
            server.run(watch)
        except KeyboardInterrupt:
            say(f"stopped after {server.face.pilot.time_s:.0f} s of flight time")
        finally:
            server.stop()


def _status(pilot: Autopilot) -> str:
    up = pilot.state.position_enu_m[2] - pilot.home_enu_m[2]
    armed = "armed" if pilot.armed else "disarmed"
    return (
        f"t = {pilot.time_s:6.1f} s   {pilot.mode.name.lower():8s} {armed:8s} {up:6.1f} m up   "
        f"battery {pilot.state.battery_remaining:4.0%}"
    )
