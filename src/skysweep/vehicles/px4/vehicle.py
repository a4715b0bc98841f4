"""A PX4 that a mission flies over MAVLink, simulated or real. Implements ``types.Vehicle``.

Needs the extra ``px4``. The orders and PX4's responses are described in docs/px4.md.
"""

from __future__ import annotations

import atexit
import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame, enu_from_ned
from skysweep.scenarios.model import Home, Scenario
from skysweep.types import F64, Setpoint, Truth, VehicleState
from skysweep.vehicles.mavlink.dialect import mavlink as m
from skysweep.vehicles.mavlink.modes import PX4Mode, Site
from skysweep.vehicles.px4.authority import FlightAuthority, is_free
from skysweep.vehicles.px4.link import CONNECT_S, ORDER_S, PX4Link, message_id
from skysweep.vehicles.px4.offboard import SetpointStream
from skysweep.vehicles.px4.telemetry import SILENCE_S, PxMode, Telemetry, mode_name

Condition = Callable[[], bool]

MAX_FROM_HOME_M = 200.0  # between the vehicle and a scenario's home on Earth
_MULTICOPTERS = {2: "quadrotor", 13: "hexarotor", 14: "octorotor", 15: "tricopter", 29: "dodecarotor"}
_RATES_HZ = {"LOCAL_POSITION_NED": 30.0, "ATTITUDE_QUATERNION": 30.0, "EXTENDED_SYS_STATE": 5.0}
_RATES_HZ |= {"BATTERY_STATUS": 2.0, "ESTIMATOR_STATUS": 2.0, "WIND_COV": 1.0, "HOME_POSITION": 1.0}
_RATES_HZ |= {"CURRENT_MODE": 10.0, "SYS_STATUS": 2.0, "DISTANCE_SENSOR": 5.0}
_GIMBAL_RATE_HZ = 20.0
_GIMBAL_STATUS_HZ = 1.0
_GIMBAL_S = 3.0  # on the wall, until we control it
_POINT_AGAIN_S = 1.0
_LEVEL = m.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | m.GIMBAL_MANAGER_FLAGS_PITCH_LOCK  # not with the tilting frame
_LEAVE, _RELEASE = -1.0, -3.0  # ids in DO_GIMBAL_MANAGER_CONFIGURE; -2 is the vehicle itself
# At several times real time PX4's telemetry thread cannot keep up with its usual streams.
_SPARED = (
    "ATTITUDE", "ATTITUDE_TARGET", "ALTITUDE", "GLOBAL_POSITION_INT", "HIGHRES_IMU", "ODOMETRY",
    "POSITION_TARGET_LOCAL_NED", "SCALED_PRESSURE", "SERVO_OUTPUT_RAW", "VFR_HUD", "VIBRATION",
)  # fmt: skip
_FAST = 1.5  # times real time: a simulator
_HOLD_S = 3.0  # on the wall
_LEFT_GROUND_S = 30.0  # on the wall
_SHOWS_S = 0.3  # on the wall, until what was accepted is reported
_HELLO_S = 1.0
_FRESH_S = 1.0  # until the vehicle has told its mode, once asked for it
_STREAM_FIRST_S = 0.2  # on the wall: PX4 needs setpoints before it enters Offboard
_CHECKS_S = 1.5  # on the wall, for PX4's reasons not to arm
_POSITION_GAIN = 0.95  # MPC_XY_P
_OFFBOARD_BELOW_M = 5.0  # the height of a take-off: there Offboard takes over
_TWO = (
    "two vehicles with the system id {} answer, and both obey; switch one off, or give it another MAV_SYS_ID"
)
_DISARMED = "it was disarmed"
_LEFT_OVER = (PX4Mode.OFFBOARD, PX4Mode.LAND, PX4Mode.RETURN, PX4Mode.MISSION, PX4Mode.TAKEOFF)


class Px4Vehicle:
    """Connects to a PX4 and flies it; nothing moves before ``takeoff``.

    Time is the vehicle's own and begins with the first ``takeoff``. A scenario without latitude and longitude
    is flown where the vehicle stands, with the vehicle's home; ``scenario`` is the resulting one. Heights are
    above the vehicle's home, on the scenario's ground there.

    Raises UserError if nothing answers in ``timeout_s``, or if the vehicle is not a multicopter with PX4, has
    no position, or stands far from the scenario's home. ``close``, or the program's end, hands over to Hold.
    """

    def __init__(
        self,
        url: str,
        scenario: Scenario,
        ground_height_m: Callable[[F64], F64],
        timeout_s: float = CONNECT_S,
        system_id: int | None = None,
        open_link: Callable[[str, float, int | None], PX4Link] = PX4Link,
    ) -> None:
        self.scenario = scenario
        self.truth: Truth | None = None
        self._ground_height_m = ground_height_m
        self.begins_in_air: bool | None = None  # at the preflight list; None: no list was made
        self._must_land = False  # a landing is ordered but not confirmed
        self._taking_off = False  # PX4's own take-off, before Offboard
        self._ordered: PxMode | None = None  # by an order that goes on, or that the program's end broke off
        self.is_called_off: Condition = lambda: False  # a take-off, by the operator while it arms
        self._offboard_from_m: float | None = None  # height above ground where Offboard ends a take-off
        self._has_flown = False
        self._closed = False
        self._pointed_s = -math.inf  # by the vehicle's clock
        self.link = open_link(url, timeout_s, system_id)
        try:
            self._identify()
            self.telemetry = Telemetry(
                self.link, scenario.camera.gimbal.pitch_rad, scenario.vehicle.battery_wh
            )
            self._ask_for_telemetry(timeout_s)
            self.home_enu_m, self.site = self._located()
            self.gimbal = self.link.ask("GIMBAL_MANAGER_INFORMATION", _HELLO_S) is not None
            self._has_gimbal = False  # has taken control of it
            self._watch_gimbal()
            if self.is_free:
                self._take_gimbal()
            self._since_boot_s = self.telemetry.boot_s
            on_loss = self.link.parameter("COM_OBL_RC_ACT")
            loss_act = None if on_loss is None else int(on_loss)
            self.authority = FlightAuthority(self.link, self.telemetry, loss_act)
            gain = self.link.parameter("MPC_XY_P") or _POSITION_GAIN
            self._offboard = SetpointStream(self.link, self.telemetry, self.authority.may_stream, gain)
        except BaseException:
            self.link.close()
            raise
        self._due_s = self.telemetry.boot_s
        self._state = self._look()
        atexit.register(self.close)

    # ---- types.Vehicle -------------------------------------------------------------------------------

    def state(self) -> VehicleState:
        return self._state

    def command(self, setpoint: Setpoint) -> None:
        """Flies to the setpoint in Offboard; does nothing while somebody else flies the vehicle.

        Raises UserError if the vehicle refuses Offboard, ValueError if a coordinate is not finite.
        """
        if not all(map(math.isfinite, setpoint.position_enu_m)):
            raise ValueError(f"a setpoint must be finite, not {setpoint.position_enu_m}")
        if self.authority.lost():
            return
        self._end_wait()
        self._must_land = False
        self._offboard.aim(setpoint, self.site)
        pitch_rad = setpoint.gimbal_pitch_rad
        if pitch_rad is not None and pitch_rad != self.telemetry.gimbal_pitch_rad:
            self.look(pitch_rad)
        if self.authority.wanted is not PX4Mode.OFFBOARD:
            self._go_into_offboard()

    def advance(self, duration_s: float) -> None:
        """Waits until the vehicle's clock has advanced by that much, or the vehicle is silent."""
        told = self.telemetry
        self._due_s = max(self._due_s + duration_s, told.boot_s)
        while not self.link.wait(lambda: told.boot_s >= self._due_s, SILENCE_S):
            if told.silent_s >= SILENCE_S:
                self._due_s = told.boot_s
                break
        if told.are_two:
            raise UserError(_TWO.format(self.link.system_id))
        if told.restarted:
            raise UserError(
                "the vehicle's clock went back: it restarted in flight; look after it by hand"
                if self._state.airborne
                else "the vehicle restarted on the ground, as it does without its battery: go on with the "
                "flight from its run folder, with 'skysweep fly FOLDER'"
            )
        self._look_after_orders()
        if told.gimbal_is_off and told.boot_s > self._pointed_s + _POINT_AGAIN_S:
            self._point_again()
        self._state = self._look()

    def takeoff(self, altitude_agl_m: float) -> None:
        """Arms, lets PX4 take off, and returns when the vehicle leaves the ground; time begins here at first.

        A vehicle in the air climbs in Offboard. Offboard takes over before PX4's take-off ends, because its
        own Hold could not be distinguished from one that somebody chose.
        """
        told = self.telemetry
        if not self.link.wait(self.authority.knows, CONNECT_S):
            raise UserError("the vehicle is silent: nothing is ordered; look after it, and start again")
        self._refuse_taken()
        self._take_gimbal()
        if told.airborne:
            self._start_clock()
            self.command(self._above_here(altitude_agl_m))
            if self.authority.wanted is not PX4Mode.OFFBOARD and not self.authority.lost():
                raise UserError("the vehicle fell silent before Offboard; look after it, and start again")
            self._state = self._look()
            self._has_flown, self.begins_in_air = True, False
            return
        if self._has_flown:
            self.telemetry.begin_battery()
            self.stand_by()
        self._taking_off, before = True, told.flown
        try:
            self._arm(before)
        except UserError:
            self._taking_off = False  # who arms it now does so for themselves
            raise
        if self.is_called_off():
            self._call_off(before)
        self._start_clock()
        self._level()
        self._order_take_off(altitude_agl_m, before)
        if not self.link.wait(lambda: told.airborne or self.authority.lost(), _LEFT_GROUND_S):
            raise UserError(f"the vehicle did not leave the ground in {_LEFT_GROUND_S:g} s; look after it")
        if not told.airborne:
            raise UserError(f"the vehicle did not take off: {self.authority.theirs}; it is on the ground")
        self._has_flown, self.begins_in_air = True, False
        self._state = self._look()
        self._offboard_from_m = max(altitude_agl_m - _OFFBOARD_BELOW_M, 0.5 * altitude_agl_m)
        self._offboard.aim(self._above_here(altitude_agl_m), self.site)
        self._offboard.start()

    def land(self) -> None:
        """Lets PX4 land here, a silent one once it is heard; does nothing while somebody else flies it."""
        self._end_wait()
        self._must_land = not self.authority.lost()
        self._look_after_orders()

    def hold(self) -> None:
        """Stops and hovers in Offboard, so that PX4's Hold is always somebody else's choice.

        Does nothing if somebody else flies it, or nobody does.
        """
        if self.authority.wanted is PX4Mode.OFFBOARD and not self.authority.lost():
            self._offboard.hover(self.site)

    def regain(self, holder: str | None = None) -> str:
        """Hovers here after a person took the vehicle back; on the ground, stands by. Why not, or empty.

        ``holder`` are the words of ``taken_over`` that the person has read; None: those of now.
        """
        told, authority = self.telemetry, self.authority
        if told.armed and not told.airborne and authority.lost():
            return "its motors run on the ground; disarm it, then say take back again"
        before = told.flown
        why = authority.take_back(holder)
        if why or not told.airborne:
            return why
        self._offboard.hover(self.site)
        try:
            self._go_into_offboard(before)
        except UserError as error:
            authority.keep_out(str(error))
            return f"{error}; say take back again"
        if authority.wanted is PX4Mode.OFFBOARD:
            return ""
        if not authority.lost():  # not heard any more
            authority.keep_out()
        return f"somebody keeps the vehicle ({authority.theirs}); say take back again"

    def look(self, pitch_rad: float) -> None:
        """Points the gimbal, if there is one, above (+) or below the horizon; its yaw follows the vehicle.

        The command is repeated every second while the gimbal reports another pitch. Without a gimbal the
        camera is believed to look as before.
        """
        if self._has_gimbal:
            self.telemetry.gimbal_pitch_rad = pitch_rad
            self._pointed_s = self.telemetry.boot_s
            pitch_deg = math.degrees(pitch_rad)
            self.link.command(m.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, pitch_deg, 0.0, None, None, _LEVEL)

    # ---- before and after a mission ------------------------------------------------------------------

    @property
    def is_free(self) -> bool:
        """Whether nobody flies it: it is on the ground, in Hold, or lost its program."""
        return not self.telemetry.airborne or is_free(self.telemetry)

    @property
    def gimbal_obeys(self) -> tuple[int, int] | None:
        """System and component in control of the gimbal; (0, 0): nobody, None: not reported."""
        said = self.link.newest("GIMBAL_MANAGER_STATUS")
        return None if said is None else (said["primary_control_sysid"], said["primary_control_compid"])

    def arming_checks(self) -> tuple[str, ...]:
        """PX4's reasons not to arm, from a new check."""
        asked_s = self.link.now_s()
        self.link.command(m.MAV_CMD_RUN_PREARM_CHECKS)
        self.link.wait(lambda: False, _CHECKS_S)
        said = self.link.warnings(asked_s)
        return tuple(text for text in said if not text.startswith("Arming denied"))

    def wait_disarmed(self, seconds: float) -> bool:
        """Whether the motors stop within ``seconds`` on the wall; the vehicle then stands by."""
        disarmed = self.link.wait(lambda: not self.telemetry.armed, seconds)
        if disarmed:
            self.stand_by()
        return disarmed

    def stand_by(self) -> None:
        """Changes to Hold on the ground: PX4 does not arm in a mode left from another flight."""
        told = self.telemetry
        if not (told.armed or told.airborne) and told.mode in _LEFT_OVER:
            self._change_mode(PX4Mode.HOLD, "go into Hold")
            self.authority.regain(None)

    def close(self) -> None:
        """Hands over to Hold if the vehicle flies on our orders, and disconnects.

        Signals that end the program are ignored meanwhile.
        """
        if self._closed:
            return
        with _signals_wait():
            self._hand_over()
            self._offboard.stop()
            if self._has_gimbal:
                self.link.command(m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, _RELEASE, _RELEASE, _LEAVE, _LEAVE)
            for name in self._spared:
                self.link.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, message_id(name), 0.0)
            self.link.close()
            self._closed = True
            atexit.unregister(self.close)

    # ---- connecting ----------------------------------------------------------------------------------

    def _identify(self) -> None:
        heartbeat, url = self.link.newest("HEARTBEAT") or {}, self.link.url
        autopilot, kind = heartbeat.get("autopilot"), heartbeat.get("type")
        if autopilot != m.MAV_AUTOPILOT_PX4:
            raise UserError(
                f"--connection {url}: the vehicle's firmware is not PX4 (MAV_AUTOPILOT {autopilot}); give "
                "the address of a PX4"
            )
        if kind not in _MULTICOPTERS:
            raise UserError(
                f"--connection {url}: the vehicle is not a multicopter (MAV_TYPE {kind}); this mission stops "
                "and hovers, fly it with a vehicle that can"
            )
        self.kind = _MULTICOPTERS[kind]

    def _ask_for_telemetry(self, timeout_s: float) -> None:
        """Requests message rates, and fewer streams from a simulator that runs faster than real time."""
        told = self.telemetry
        self._spared: tuple[str, ...] = ()
        if self.link.wait(lambda: told.has_position, _HELLO_S):
            boot_s, wall_s, now_s = told.boot_s, self.link.now_s(), self.link.now_s
            self.link.wait(lambda: now_s() - wall_s > 0.5, 0.6)
            if told.boot_s - boot_s > _FAST * (now_s() - wall_s):
                self._spared = _SPARED
        for name in self._spared:
            self.link.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, message_id(name), -1.0)
        for name, rate_hz in _RATES_HZ.items():
            self.link.every(name, rate_hz)

        def ready() -> bool:
            return told.has_position and told.has_attitude and told.home is not None

        if not self.link.wait(ready, timeout_s):
            missing = "home" if told.has_position else "position"
            raise UserError(f"the vehicle has no {missing} ({timeout_s:g} s); wait for its GNSS fix")
        self.link.wait(lambda: not math.isnan(told.battery_remaining), _HELLO_S)
        if told.are_two:
            raise UserError(f"--connection {self.link.url}: {_TWO.format(self.link.system_id)}")

    def _located(self) -> tuple[F64, Site]:
        """The vehicle's home (3,) in the scenario, and where its local NED lies."""
        said = self.telemetry.home or {}
        latitude, longitude = said["latitude"] * 1e-7, said["longitude"] * 1e-7
        if not names_its_place(self.scenario):
            self.scenario = placed(self.scenario, latitude, longitude, said["altitude"] * 1e-3)
        frame, home = self.scenario.frame, self.scenario.home
        stands = frame.enu_from_geodetic([latitude, longitude, home.altitude_amsl_m])[0][:2]
        away_m = math.dist(stands, home.position_enu_m)
        if away_m > MAX_FROM_HOME_M:
            raise UserError(
                f"the vehicle stands {away_m:.0f} m from the scenario's home; carry it within "
                f"{MAX_FROM_HOME_M:g} m, or write home.latitude_deg: {latitude:.6f} and home.longitude_deg: "
                f"{longitude:.6f}"
            )
        home_enu_m = np.array([*stands, self._ground_m(stands)])
        return home_enu_m, Site(frame, home_enu_m - enu_from_ned([said["x"], said["y"], said["z"]]))

    def _level(self) -> None:
        """Takes the vehicle's height now for the ground's: its barometer has drifted since home was set."""
        here = self.site.enu_from_ned(self.telemetry.ned_m)
        up_m = np.array([0.0, 0.0, self._ground_m(here) - here[2]])
        self.site = Site(self.site.frame, self.site.origin_enu_m + up_m)

    def _watch_gimbal(self) -> None:
        if self.gimbal:
            self.link.every("GIMBAL_DEVICE_ATTITUDE_STATUS", _GIMBAL_RATE_HZ)
            self.link.every("GIMBAL_MANAGER_STATUS", _GIMBAL_STATUS_HZ)

    def _take_gimbal(self) -> None:
        """Takes control of the gimbal, if there is one, and points it as it was told last."""
        if not self.gimbal or self._has_gimbal:
            return
        self._has_gimbal = True
        what, take, ours = "hand over its gimbal", m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, self.link.own_ids
        with suppress(UserError):  # the preflight list reports who controls it
            self.link.order(what, take, [*ours, _LEAVE, _LEAVE], lambda: self.gimbal_obeys == ours, _GIMBAL_S)
        self.look(self.telemetry.gimbal_pitch_rad)

    # ---- orders --------------------------------------------------------------------------------------

    def _point_again(self) -> None:
        """Points the gimbal anew, and asks for control where nobody has it; not while somebody else flies."""
        if not self._has_gimbal or self.authority.lost():
            return
        if self.gimbal_obeys == (0, 0):
            take = m.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE
            self.link.command(take, *self.link.own_ids, _LEAVE, _LEAVE)
        self.look(self.telemetry.gimbal_pitch_rad)

    def _refuse_taken(self) -> None:
        """Raises UserError if somebody flew, landed or armed it since the preflight list."""
        told = self.telemetry
        if self.begins_in_air is not None and told.airborne is not self.begins_in_air:
            raise UserError("the vehicle took off or landed since the preflight list; look, and start again")
        if told.airborne and not is_free(told):
            raise UserError(f"somebody flies the vehicle in {mode_name(told.flown)}; let them choose Hold")
        if told.armed and not told.airborne:
            raise UserError("the vehicle is armed already: somebody is about to fly it; disarm it first")

    def _arm(self, before: PxMode) -> None:
        """Arms in the mode ``before``: once, unless the order was lost.

        Raises UserError if the vehicle refuses, or if somebody disarms it or chooses another mode meanwhile.
        """
        told, link, number = self.telemetry, self.link, m.MAV_CMD_COMPONENT_ARM_DISARM
        self._refuse_taken()

        def was_lost(sent_s: float) -> bool:
            unheard = link.answer_s(number) == math.inf and link.heard_s("HEARTBEAT") > sent_s
            return unheard and self._knows_since(sent_s)

        def disarmed() -> bool:
            return not told.armed and link.heard_s("HEARTBEAT") > link.accepted_s(number) + _SHOWS_S

        def changed() -> bool:
            return told.flown != before

        def accepted() -> bool:
            return told.armed or link.accepted_s(number) < math.inf

        try:
            link.order("arm", number, [1.0], accepted, given_up=changed, may_repeat=was_lost)
        except UserError as error:
            reasons = self.arming_checks()
            raise UserError(f"{error}; {'; '.join(reasons)}" if reasons else str(error)) from None
        link.request("HEARTBEAT")
        link.wait(lambda: told.armed or disarmed() or changed(), ORDER_S)
        if changed() or not told.armed:
            self.authority.keep_out(_DISARMED if disarmed() else "")
            raise UserError(f"the vehicle does not take off: {self.authority.theirs}; look, and start again")

    def _call_off(self, before: PxMode) -> None:
        """Disarms, unless somebody has chosen another mode than ``before``. Raises UserError."""
        told, number = self.telemetry, m.MAV_CMD_COMPONENT_ARM_DISARM
        if self.link.order(
            "disarm", number, [0.0], lambda: not told.armed, given_up=lambda: told.flown != before
        ):
            self._taking_off = False
            raise UserError("the operator called the take-off off: the vehicle is disarmed again")
        self.authority.keep_out()
        raise UserError(f"the vehicle does not take off: {self.authority.theirs}; look, and start again")

    def _order_take_off(self, altitude_agl_m: float, before: PxMode) -> None:
        told, home = self.telemetry, self.telemetry.home or {}
        up_amsl_m = home["altitude"] * 1e-3 - (told.ned_m[2] - home["z"]) + altitude_agl_m
        params = (0.0, 0.0, 0.0, None, None, None, up_amsl_m)
        number = m.MAV_CMD_NAV_TAKEOFF
        self._order(PX4Mode.TAKEOFF, "take off", number, params, lambda: told.airborne, before=before)

    def _change_mode(
        self,
        mode: PX4Mode,
        what: str,
        or_else: Condition = lambda: False,
        timeout_s: float = ORDER_S,
        before: PxMode | None = None,
    ) -> None:
        main, sub = mode.value
        numbers = float(m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(main), float(sub)
        self._order(mode, what, m.MAV_CMD_DO_SET_MODE, numbers, or_else, timeout_s, before)

    def _order(
        self,
        mode: PX4Mode,
        what: str,
        number: int,
        params: tuple[float | None, ...],
        or_else: Condition,
        timeout_s: float = ORDER_S,
        before: PxMode | None = None,
    ) -> None:
        """Orders the vehicle into a mode, unless somebody disarms it or chooses another one than ``before``.

        That is the mode at the beginning, if none is given.
        """
        told, begun_s = self.telemetry, self.link.now_s()
        was_armed, was_in = told.armed, told.flown if before is None else before
        broken_off, self._ordered = self._ordered, mode.value
        self.link.request("HEARTBEAT")  # by now somebody may have chosen another mode

        def done() -> bool:
            return (told.flown == mode.value and told.mode_heard_s > begun_s) or or_else()

        def disarmed() -> bool:
            return was_armed and not told.armed and not or_else()

        def elsewhere() -> bool:
            if told.flown == mode.value:
                return False
            undone = told.mode_heard_s > self.link.accepted_s(number) + _SHOWS_S and not or_else()
            changed = told.flown not in (was_in, broken_off) and not self.authority.lost_us_since(begun_s)
            return undone or changed or disarmed() or self.authority.lost()

        def knows_since(sent_s: float) -> bool:
            return self._knows_since(max(sent_s, begun_s))

        self.link.wait(lambda: knows_since(begun_s), min(_FRESH_S, timeout_s))
        try:
            is_done = self.link.order(what, number, params, done, timeout_s, elsewhere, knows_since)
        except UserError:
            self._ordered = None
            raise
        self._ordered = None
        if is_done:
            self.authority.regain(mode)
            self._taking_off = mode is PX4Mode.TAKEOFF
        else:
            self.authority.keep_out(_DISARMED if disarmed() else "")

    def _knows_since(self, sent_s: float) -> bool:
        """Whether the vehicle has told its mode since then, and is heard: else somebody may have taken it."""
        return self.telemetry.mode_heard_s > sent_s and self.authority.knows()

    def _is_nobodys(self) -> bool:
        """Whether it flies without an order of this program, and nobody else flies it either."""
        return self.authority.wanted is None and self.is_free

    def _go_into_offboard(self, before: PxMode | None = None) -> None:
        """From anybody's mode only if a person asked for it, who saw the vehicle in the mode ``before``."""
        if self.authority.knows():
            if self.authority.wanted is None and before is None:
                before = self.telemetry.flown
                if not self._is_nobodys():
                    self.authority.keep_out()
                    return
            self._offboard_from_m = None
            if self._offboard.start():
                self.link.wait(lambda: False, _STREAM_FIRST_S)
            self._change_mode(PX4Mode.OFFBOARD, "go into Offboard", before=before)

    def _end_wait(self) -> None:
        """The mission commands something, and knows that the vehicle waited."""
        if self._state.waits:
            self.authority.waits = ""

    def _look_after_orders(self) -> None:
        """Gives pending orders, unless somebody else flies the vehicle or it is silent."""
        authority, told = self.authority, self.telemetry
        if authority.lost() or authority.waits:
            self._must_land = False
            if not self._offboard.hovers:
                self._offboard.hover(self.site)
            return
        if not authority.knows():
            return
        ours = self._is_nobodys() or told.flown in (PX4Mode.OFFBOARD.value, PX4Mode.TAKEOFF.value)
        if self._must_land and ours:
            with suppress(UserError):  # the order is repeated: a mission must not end in the air for that
                self._change_mode(PX4Mode.LAND, "land", lambda: not told.airborne)
                self._must_land = False
                self._offboard.stop()
        elif self._offboard_from_m is not None and self._height_agl_m() >= self._offboard_from_m:
            self._go_into_offboard()

    def _hand_over(self) -> None:
        """Leaves a flying vehicle in PX4's Hold; a silent one follows COM_OBL_RC_ACT.

        PX4's own failsafes continue. A take-off that has not left the ground is cancelled.
        """
        told, authority = self.telemetry, self.authority
        if not (self._taking_off or authority.wanted in (PX4Mode.OFFBOARD, PX4Mode.TAKEOFF)):
            return
        self.link.wait(authority.knows, _HOLD_S)
        if self._taking_off and told.armed and not told.airborne and not authority.lost():
            self.link.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)  # PX4 refuses it in the air
            self.link.wait(lambda: told.airborne or not told.armed, _HOLD_S)
        ours = authority.nobody_chose if authority.lost() else True
        flown = told.flown in (PX4Mode.OFFBOARD.value, PX4Mode.TAKEOFF.value)
        if ours and flown and told.airborne and authority.knows():
            with suppress(UserError):
                self._change_mode(PX4Mode.HOLD, "hold", timeout_s=_HOLD_S)

    def _height_agl_m(self) -> float:
        here = self.site.enu_from_ned(self.telemetry.ned_m)
        return float(here[2]) - self._ground_m(here)

    def _above_here(self, altitude_agl_m: float) -> Setpoint:
        place = self.site.enu_from_ned(self.telemetry.ned_m)
        place[2] = self._ground_m(place) + altitude_agl_m
        return Setpoint(place, 1.0, self.telemetry.yaw_rad)

    def _ground_m(self, position_enu_m: F64) -> float:
        return float(self._ground_height_m(position_enu_m[None, :2])[0])

    def _start_clock(self) -> None:
        if self._has_flown:
            return
        self._since_boot_s = self._due_s = self.telemetry.boot_s

    def _look(self) -> VehicleState:
        state = self.telemetry.state(self.site, self._since_boot_s)
        return state._replace(taken_over=self.authority.theirs, waits=self.authority.waits)


def names_its_place(scenario: Scenario) -> bool:
    """Whether a scenario has a place on Earth, instead of the vehicle's."""
    home, nowhere = scenario.home, Home()
    named = (home.latitude_deg, home.longitude_deg) != (nowhere.latitude_deg, nowhere.longitude_deg)
    return named or scenario.area.polygon_lat_lon_deg is not None or scenario.search.plan is not None


def placed(scenario: Scenario, latitude_deg: float, longitude_deg: float, altitude_amsl_m: float) -> Scenario:
    """The scenario with its home at a place on Earth."""
    x, y = scenario.home.position_enu_m
    at_home = LocalFrame(latitude_deg, longitude_deg, altitude_amsl_m)
    latitude, longitude, _ = at_home.geodetic_from_enu([[-x, -y, 0.0]])[0]
    place = {"latitude_deg": float(latitude), "longitude_deg": float(longitude)}
    home = scenario.home.model_copy(update=place | {"altitude_amsl_m": altitude_amsl_m})
    return scenario.model_copy(update={"home": home})


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Ignores signals that end the program; only the main thread can do that."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
