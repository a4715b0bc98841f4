"""The autopilot: arming, modes, and the manoeuvre of each mode. It knows nothing of messages."""

from __future__ import annotations

from collections.abc import Callable

from skysweep.types import Vehicle
from skysweep.vehicles.mavlink.modes import STICK_MODES, PX4Mode, Refused, Site
from skysweep.vehicles.served.failsafes import CRITICAL_BATTERY, Failsafes, Health, Reaction, why_not
from skysweep.vehicles.served.link import NOTICE
from skysweep.vehicles.served.manoeuvres import Hold, Land, Return, TakeOff
from skysweep.vehicles.served.mission_run import MissionRun
from skysweep.vehicles.served.offboard import OffboardControl
from skysweep.vehicles.served.parameters import Parameters
from skysweep.vehicles.served.pilot import Manoeuvre, Pilot
from skysweep.vehicles.served.sticks import ByStick, Sticks

_NOT_FROM_THE_GROUND = (PX4Mode.RETURN, PX4Mode.LAND, PX4Mode.TERMINATION)
_FENCE_EVERY_S = 0.2
_WITHOUT_GNSS_S = 5.0  # EKF2_NOAID_TOUT: until the estimator loses its position
_WITH_GNSS_S = 2.0  # until it has one again; measured
_OVERRIDE_AUTO, _OVERRIDE_OFFBOARD = 1, 2  # COM_RC_OVERRIDE
_BATTERY_LIMITS = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")

_MANOEUVRES: dict[PX4Mode, Callable[[], Manoeuvre]] = {
    PX4Mode.HOLD: Hold,
    PX4Mode.TAKEOFF: TakeOff,
    PX4Mode.RETURN: Return,
    PX4Mode.LAND: Land,
    PX4Mode.TERMINATION: Land,
}


class Autopilot(Pilot):
    """Flies ``vehicle`` by PX4's modes.

    ``intended`` is the chosen mode, ``mode`` the flown one, which differs in a failsafe. Tests may set
    ``gnss_lost`` and ``battery_share`` (None: the vehicle's own).
    """

    def __init__(
        self, vehicle: Vehicle, site: Site, parameters: Parameters, say: Callable[[str, int], None]
    ) -> None:
        super().__init__(vehicle, site, parameters, say)
        self.intended = self.mode = PX4Mode.HOLD
        self.mission = MissionRun()
        self.offboard = OffboardControl()
        self.sticks = Sticks()
        self.gnss_lost = False
        self.battery_share: float | None = None
        self._doing: Manoeuvre = Hold()
        self._failsafes = Failsafes(parameters, say)
        self._after_disarm: PX4Mode | None = None  # None: no mode was ever chosen
        self.position_lost = False  # the estimator's
        self._gnss_s = 0.0  # when position and GNSS were last both lost or both there
        self._outside, self._fence_next_s = False, 0.0
        self._battery_level = 0

    # ---- time ----------------------------------------------------------------------------------------

    def advance(self, duration_s: float) -> None:
        """Lets the vehicle fly for ``duration_s``, then decides what it does next."""
        self._vehicle.advance(duration_s)
        self.state = self._vehicle.state()
        if self.landing and not self.state.airborne:
            self.flying = self.landing = False
            self._landed_s = self.time_s
            self.setpoint = None
            self.say("landed", NOTICE)
        self._look_around()
        self._decide(duration_s, sticks=self._take_over_by_stick())
        if self.armed:
            self._doing.step(self)
            self._disarm_when_idle()

    @property
    def failsafe(self) -> bool:
        return self._failsafes.action > Reaction.WARN

    @property
    def by_stick(self) -> bool:
        """Whether a pilot flies it by sticks, and has not let go of them."""
        return self.flying and self.mode in STICK_MODES and self.sticks.in_use

    @property
    def battery_remaining(self) -> float:
        return self.state.battery_remaining if self.battery_share is None else self.battery_share

    def change_battery(self) -> None:
        """Puts in a full battery. Raises Refused while it is armed, or where there is none to put in."""
        change = getattr(self._vehicle, "change_battery", None)
        if self.armed or change is None:
            raise Refused("Battery not changed: armed" if self.armed else "Battery not changed: no other one")
        change()
        self.battery_share = None
        self.state = self._vehicle.state()
        self.say("battery changed", NOTICE)

    # ---- orders --------------------------------------------------------------------------------------

    def arm(self) -> None:
        """Raises Refused with the reason not to arm."""
        if self.armed:
            return
        why = self.why_not_arm()
        if why is not None:
            raise Refused(f"Arming denied: {why}")
        self.armed, self._armed_s = True, self.time_s
        self.home_enu_m = self.state.position_enu_m
        self.say("armed", NOTICE)

    def why_not_arm(self) -> str | None:
        if self.flying:
            return "still coming down"
        if self.mode in _NOT_FROM_THE_GROUND:
            return "not in this mode, choose Hold"
        if self.parameters["GF_ACTION"] > 0 and self.outside_fence():
            return "outside the geofence"
        if self._battery_level >= CRITICAL_BATTERY:
            return "battery"
        return self._why_not(self.mode)

    def disarm(self, forced: bool = False) -> None:
        """Raises Refused in the air unless ``forced``; then it lands instead of stopping its motors."""
        if self.flying and not forced:
            raise Refused("Disarming denied: not landed")
        if not self.armed:
            return
        self.armed = False
        self.speed_mps = None
        self.say("disarmed", NOTICE)
        if self.flying:
            self.touch_down()
        self.enter(self._after_disarm or PX4Mode.HOLD)

    def change_mode(self, mode: PX4Mode, doing: Manoeuvre | None = None) -> None:
        """Chooses ``mode``, flown by ``doing``. Raises Refused if it is not available now."""
        if self.mode is PX4Mode.TERMINATION:
            raise Refused("flight terminated")
        if self.armed and mode is not PX4Mode.LAND:  # Land is always accepted
            why = self._why_not(mode)
            if why is not None:
                raise Refused(f"{mode.name.title()} denied: {why}")
        self.enter(mode, doing)

    def enter(self, mode: PX4Mode, doing: Manoeuvre | None = None) -> None:
        if doing is None:
            doing = self._doing if mode is self.mode and self._goes_on(mode) else self._manoeuvre(mode)
        self._intend(mode)
        self._decide(0.0, asked=True)
        if self.mode is mode:
            self._doing = doing

    def _goes_on(self, mode: PX4Mode) -> bool:
        """Whether choosing the flown mode again changes nothing."""
        return mode is not PX4Mode.HOLD and not (mode is PX4Mode.MISSION and self.mission.finished)

    def _intend(self, mode: PX4Mode) -> None:
        self.intended = mode
        if mode is PX4Mode.TERMINATION or mode not in (*_NOT_FROM_THE_GROUND, PX4Mode.TAKEOFF):
            self._after_disarm = mode

    # ---- what is flown -------------------------------------------------------------------------------

    def _decide(self, elapsed_s: float, asked: bool = False, sticks: bool = False) -> None:
        """Flies the intended mode, or that of a failsafe."""
        failsafes = self._failsafes
        intended = failsafes.update(self.armed, self.intended, asked, sticks, self._health(), elapsed_s)
        if intended is not self.intended:
            self._intend(intended)
        if failsafes.action is Reaction.DISARM:
            self.disarm(forced=True)
            return
        mode = failsafes.mode(intended)
        if mode is not self.mode:
            self.mode, self._doing = mode, self._manoeuvre(mode)
            self.speed_mps = None  # DO_CHANGE_SPEED is for one mode, as in PX4

    def _manoeuvre(self, mode: PX4Mode) -> Manoeuvre:
        if mode is PX4Mode.OFFBOARD:
            return self.offboard
        if mode is PX4Mode.MISSION:
            self.mission.begin()
            return self.mission
        if mode in STICK_MODES:
            return ByStick(self.sticks)
        return _MANOEUVRES[mode]()

    def _take_over_by_stick(self) -> bool:
        """Lets moving sticks choose Position; True if they moved while a failsafe flies."""
        self.sticks.tick(self.time_s, self.parameters["COM_RC_LOSS_T"], self.parameters["COM_RC_STICK_OV"])
        if not self.armed:
            if not self.sticks.lost and self._after_disarm is None:
                self.enter(PX4Mode.POSITION)
            return False
        if not self.sticks.moving or self.mode in (*STICK_MODES, PX4Mode.TERMINATION):
            return False
        bit = _OVERRIDE_OFFBOARD if self.mode is PX4Mode.OFFBOARD else _OVERRIDE_AUTO
        if not int(self.parameters["COM_RC_OVERRIDE"]) & bit:
            return False
        if not self.failsafe:
            self.say("pilot took over with sticks", NOTICE)
            self.enter(PX4Mode.POSITION)
            return False
        return True

    def _why_not(self, mode: PX4Mode) -> str | None:
        """The reason not to choose a mode; None if there is none."""
        if mode in STICK_MODES and self.sticks.lost:
            return "no manual control"
        if mode is PX4Mode.OFFBOARD and not self.offboard.is_fresh(self):
            return "no stream of setpoints"
        mission_why = self.mission.why_not(self) if mode is PX4Mode.MISSION else None
        return mission_why or why_not(mode, self._health())

    def _health(self) -> Health:
        return Health(
            setpoints_lost=self.position_lost or not self.offboard.is_fresh(self),
            sticks_lost=self.sticks.lost,
            position_lost=self.position_lost,
            outside_fence=self._outside,
            battery_level=self._battery_level,
        )

    def _look_around(self) -> None:
        """Updates GNSS, fence and battery; the battery's level never improves in flight."""
        if self.gnss_lost == self.position_lost:
            self._gnss_s = self.time_s
        elif self.time_s - self._gnss_s > (_WITHOUT_GNSS_S if self.gnss_lost else _WITH_GNSS_S):
            self.position_lost = self.gnss_lost
        if self.time_s >= self._fence_next_s:
            self._fence_next_s = self.time_s + _FENCE_EVERY_S
            self._outside = self.flying and self.parameters["GF_ACTION"] > 0 and self.outside_fence()
        share = self.battery_remaining
        level = sum(share < self.parameters[name] for name in _BATTERY_LIMITS)
        self._battery_level = max(level, self._battery_level) if self.armed else level

    def _disarm_when_idle(self) -> None:
        if self.flying:
            return
        landed = self._landed_s >= self._armed_s
        limit_s = self.parameters["COM_DISARM_LAND" if landed else "COM_DISARM_PRFLT"]
        since = self._landed_s if landed else self._armed_s
        if 0.0 <= limit_s < self.time_s - since:
            self.disarm()
