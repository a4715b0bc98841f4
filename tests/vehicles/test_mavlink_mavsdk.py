"""Real clients over UDP on loopback: MAVSDK flies a survey and offboard; two programs at once."""

import contextlib
import json
import time

import numpy as np
import pytest
from mavlink_clients import scenario, served, wait

from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.qgc import plan_for_qgc, write_plan

mavsdk = pytest.importorskip("mavsdk.mavsdk")

from mavsdk.component_type import ComponentType  # noqa: E402
from mavsdk.plugins.action.action import Action  # noqa: E402
from mavsdk.plugins.gimbal.gimbal import Gimbal  # noqa: E402
from mavsdk.plugins.mission_raw.mission_raw import MissionRaw  # noqa: E402
from mavsdk.plugins.offboard.offboard import (  # noqa: E402
    Offboard,
    OffboardError,
    PositionNedYaw,
    VelocityNedYaw,
)
from mavsdk.plugins.param.param import Param  # noqa: E402
from mavsdk.plugins.telemetry.telemetry import FlightMode, Telemetry  # noqa: E402

PATIENT_S = 10.0  # COM_OF_LOSS_T where a busy machine may let a program stutter


@contextlib.contextmanager
def client(url: str):
    program = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        program.add_any_connection(url)
        system = program.first_autopilot(20.0)
        assert system is not None, f"nothing at {url}"
        yield system
    finally:
        program.destroy()


def test_it_is_found_healthy_as_px4_at_its_home():
    with served() as (server, (url,)), client(url) as system:
        telemetry = Telemetry(system)
        wait(telemetry.health_all_ok, what=str(telemetry.health()))
        wait(lambda: system.autopilot_type().name == "PX4")  # a heartbeat later than found
        home = wait(lambda: telemetry.home() if telemetry.home().latitude_deg else None)
        assert home.latitude_deg == pytest.approx(server.face.pilot.site.frame.latitude_deg, abs=1e-5)
        assert telemetry.flight_mode() == FlightMode.HOLD
        parameters = Param(system)
        assert parameters.get_param_int("SYS_AUTOSTART") == 10040
        parameters.set_param_float("MIS_TAKEOFF_ALT", 14.0)
        assert server.face.parameters["MIS_TAKEOFF_ALT"] == 14.0
        parameters.set_param_int("GF_ACTION", 3)
        assert server.face.parameters["GF_ACTION"] == 3


def test_a_survey_plan_is_uploaded_flown_and_ends_on_the_ground_at_home(tmp_path):
    of = scenario(geofence_enu_m=[[-30, -30], [150, -30], [150, 110], [-30, 110]])
    coverage, estimate = plan_scenario(of)
    path = write_plan(tmp_path / "survey.plan", plan_for_qgc(of, coverage))
    with served(of) as (server, (url,)), client(url) as system:
        mission, action, telemetry = MissionRaw(system), Action(system), Telemetry(system)
        wait(telemetry.health_all_ok)
        plan = mission.import_qgroundcontrol_mission(str(path))
        mission.upload_mission(plan.mission_items)
        mission.upload_geofence(plan.geofence_items)
        back = mission.download_mission()
        back = back[1] if isinstance(back, tuple) else back
        assert [(i.command, i.x, i.y) for i in back] == [(i.command, i.x, i.y) for i in plan.mission_items]
        action.arm()
        pilot, track = server.face.pilot, []
        start_s = pilot.time_s
        mission.start_mission()
        while pilot.armed:
            track.append(pilot.state.position_enu_m)
            assert pilot.time_s - start_s < 3.0 * estimate.time_s
            time.sleep(0.01)
        assert mission.is_mission_finished()
        progress = mission.mission_progress()
        assert progress.current == progress.total == len(plan.mission_items)
        wait(lambda: not telemetry.in_air() and not telemetry.armed())
    track = np.array(track)
    for x, y in coverage.waypoints_xy_enu_m:
        assert np.linalg.norm(track - [x, y, 20.25], axis=1).min() < 2.6
    assert pilot.time_s - start_s == pytest.approx(estimate.time_s, rel=0.25)
    assert np.hypot(*(track[-1] - pilot.home_enu_m)[:2]) < 1.5
    assert json.loads(path.read_text())["fileType"] == "Plan"


def test_offboard_flight_lost_and_taken_again():
    with served(speed=5.0) as (server, (url,)), client(url) as system:
        action, telemetry, offboard = Action(system), Telemetry(system), Offboard(system)
        wait(telemetry.health_all_ok)
        Param(system).set_param_float("COM_OF_LOSS_T", PATIENT_S)
        action.arm()
        offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -8.0, 90.0))
        offboard.start()
        pilot = server.face.pilot

        def near(*ned):
            return np.linalg.norm(pilot.site.ned_from_enu(pilot.state.position_enu_m) - ned) < 0.5

        wait(lambda: near(0.0, 0.0, -8.0))
        assert telemetry.flight_mode() == FlightMode.OFFBOARD
        offboard.set_position_ned(PositionNedYaw(10.0, 5.0, -8.0, 0.0))
        wait(lambda: near(10.0, 5.0, -8.0))
        offboard.set_velocity_ned(VelocityNedYaw(0.0, 3.0, 0.0, 0.0))
        wait(lambda: telemetry.velocity_ned().east_m_s > 2.5)
        offboard.stop()
        wait(lambda: telemetry.flight_mode() == FlightMode.HOLD)
        action.land()
        wait(lambda: not telemetry.armed())


def test_the_second_of_two_programs_is_refused():
    with served(speed=2.0, ports=2) as (server, (first_url, second_url)), contextlib.ExitStack() as programs:
        first, second = (programs.enter_context(client(url)) for url in (first_url, second_url))
        wait(Telemetry(first).health_all_ok)
        Param(first).set_param_float("COM_OF_LOSS_T", PATIENT_S)
        mine, theirs = Offboard(first), Offboard(second)
        Action(first).arm()
        mine.set_position_ned(PositionNedYaw(0.0, 0.0, -5.0, 0.0))
        mine.start()
        pilot = server.face.pilot
        wait(lambda: pilot.state.position_enu_m[2] > 4.5)
        owner = pilot.offboard.owner
        theirs.set_position_ned(PositionNedYaw(40.0, 40.0, -25.0, 0.0))
        with pytest.raises(OffboardError, match="COMMAND_DENIED"):
            theirs.start()
        time.sleep(1.0)
        assert pilot.offboard.owner == owner
        assert np.hypot(*pilot.state.position_enu_m[:2]) < 1.0
        Action(second).hold()
        wait(lambda: pilot.mode.name == "HOLD")


def test_the_gimbal_is_found():
    with served() as (_, (url,)), client(url) as system:
        gimbal = Gimbal(system)
        (found,) = wait(lambda: gimbal.gimbal_list().gimbals)
        assert (found.vendor_name, found.gimbal_device_id) == ("skysweep", 1)


def test_vehicle_time_keeps_its_pace():
    """Never faster than asked, however busy the machine; here slower only where it hardly computes at all."""
    with served(speed=2.0) as (server, _):
        wait(lambda: server.face.pilot.time_s > 0.2)
        start, wall = server.face.pilot.time_s, time.monotonic()
        time.sleep(2.0)
        flown = server.face.pilot.time_s - start
        pace = flown / (time.monotonic() - wall)
    assert 0.5 < pace < 2.6
