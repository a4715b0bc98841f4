"""Who flies the vehicle: this program, nobody because PX4 lost this program, or somebody else.

A person and the autopilot always win. PX4 distinguishes the mode that somebody chose (the intended mode) from
the one that it flies; a failsafe changes only the latter. When Offboard is lost (COM_OF_LOSS_T,
COM_OBL_RC_ACT) the intended mode stays Offboard, and PX4 returns to it by itself when it receives setpoints
again, unless somebody chose another mode or another failsafe is active. So no mode is ever ordered to get the
vehicle back: setpoints are sent again if nobody else can be flying it, and PX4's response is the proof.
"""

from __future__ import annotations

import threading
from collections import Counter

from skysweep.vehicles.mavlink.modes import PX4Mode
from skysweep.vehicles.px4.link import PX4Link
from skysweep.vehicles.px4.telemetry import SILENCE_S, PxMode, Telemetry, mode_name

RETURNS_S = 2.0  # until PX4 is back in Offboard after new setpoints
_CATCH_UP_S = 1.0  # a delayed link delivers old messages first
_CLOCK_SLACK_S = 0.3
_RECENT_S = 10.0  # age of a warning that may be the reason
_READ_S = 1.0  # until a person may have read who has the vehicle
_WAITS = "PX4 is in Offboard again, which nobody chose: the vehicle hovers until a person says continue."
AUTO = 4  # PX4's main mode of Hold, Return and Land
_NO_STICKS = {3: PX4Mode.RETURN, 4: PX4Mode.LAND, 5: PX4Mode.HOLD}  # COM_OBL_RC_ACT without a pilot
_STICKS = {0: (3, 0), 1: (2, 0), 2: (7, 0)}  # COM_OBL_RC_ACT that hands over to a pilot


class FlightAuthority:
    """Decides whether setpoints may be sent and orders given.

    ``wanted`` is the mode that this program ordered; None: none yet. ``theirs`` says in words who flies the
    vehicle instead, and follows the mode. It stays until ``regain``: only a person gives the vehicle back.
    Where no person has chosen a mode and PX4 flies our setpoints again by itself, nobody else flies it:
    ``waits`` says so, until the mission knows what to do.
    """

    def __init__(self, link: PX4Link, telemetry: Telemetry, on_loss: int | None) -> None:
        self._link, self._told, self._on_loss = link, telemetry, on_loss
        self._lock = threading.RLock()
        self.wanted: PX4Mode | None = None
        self.theirs = self.waits = ""
        self._theirs_when: tuple[bool, PxMode] | None = None  # armed and mode, when that was said
        self._theirs_since_s = float("-inf")
        self._said = Counter[str]()  # of these words, how often: a word for one holder is not for the next
        self._deaf = False
        self._heard_again_s = float("-inf")  # the end of the silence that was noticed last
        self._caught_up_s = float("-inf")  # when its messages were current again: older ones tell nothing
        self._person = False  # a person took it, perhaps from a failsafe
        self._not_followed_s: float | None = None  # since when PX4 ignores our setpoints

    def may_stream(self) -> bool:
        """Whether setpoints may be sent now.

        Those of a hover continue during PX4's own failsafes: silence would be another failsafe, and stop the
        motors with COM_OBL_RC_ACT 7.
        """
        with self._lock:
            return self._look() and (not self.theirs or (self.nobody_chose and self._told.airborne))

    @property
    def nobody_chose(self) -> bool:
        """Whether PX4 took it by itself and no person has chosen a mode since."""
        with self._lock:
            return not self._person and self._is_left_to_px4()

    def _is_left_to_px4(self) -> bool:
        told = self._told
        return told.intended == PX4Mode.OFFBOARD.value and told.flown[0] in (AUTO, PX4Mode.OFFBOARD.value[0])

    def lost_us_since(self, since_s: float) -> bool:
        """Whether the link was lost since then, and PX4 does what it does for that: nobody's choice."""
        with self._lock:
            modes = _STICKS | {action: mode.value for action, mode in _NO_STICKS.items()}
            does_that = self._on_loss is not None and self._told.flown == modes.get(self._on_loss)
            was_lost = since_s < self._heard_again_s and self._told.silent_s < SILENCE_S
            return was_lost and does_that and self._is_left_to_px4()

    def lost(self) -> bool:
        """Whether somebody else flies it, from the newest messages."""
        with self._lock:
            self._look()
            return bool(self.theirs)

    def knows(self) -> bool:
        """Whether the vehicle is heard and its messages are current."""
        with self._lock:
            return self._look()

    def regain(self, mode: PX4Mode | None) -> None:
        """This program flies it from now on, and ordered ``mode``."""
        with self._lock:
            self.wanted, self._not_followed_s, self._person = mode, None, False
            self.theirs = self.waits = ""

    def take_back(self, holder: str | None) -> str:
        """``regain`` at a person's word, who has read ``holder`` in ``theirs``; why not, or empty.

        None: whoever has it now.
        """
        with self._lock:
            if not self._look():
                return "the vehicle is not heard; say it again when it is"
            if not self.theirs:
                return "nobody else flies the vehicle; say continue"
            if holder not in (None, self.theirs):
                return f"since then somebody else took the vehicle ({self.theirs}); say take back again"
            if self._link.now_s() - self._theirs_since_s < _READ_S:
                return f"somebody took the vehicle just now ({self.theirs}); say take back again"
            self.regain(None)
            return ""

    def keep_out(self, why: str = "") -> None:
        """Somebody else flies it now, or keeps it in Offboard against our order."""
        with self._lock:
            self._person = self._person or self._told.flown == PX4Mode.OFFBOARD.value
            if why:
                self._say(why)
            else:
                self._give_up(self._told.flown)

    def _look(self) -> bool:
        """Evaluates the newest messages; False while they are not conclusive."""
        link, told = self._link, self._told
        now_s = link.now_s()
        if told.silent_s >= SILENCE_S:
            self._deaf, self._caught_up_s = True, float("inf")
            return False
        if told.silence.until_s > self._heard_again_s:  # perhaps while this program did not run
            self._deaf, self._caught_up_s = True, float("inf")
            self._heard_again_s = told.silence.until_s
        if self._deaf:
            if self._caught_up_s > now_s:
                if not self._caught_up(now_s):
                    return False
                self._caught_up_s = now_s
                for name in ("HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE"):
                    link.request(name)
            if told.mode_heard_s <= self._caught_up_s:
                return False
        certain = self.wanted is None or bool(self.theirs) or self._judge(now_s)
        self._deaf = self._deaf and not certain
        if self.theirs:
            self._person = self._person or not (told.armed and self._is_left_to_px4())
            self.waits = _WAITS if self._is_ours_again() else ""
            if self.waits:
                self.theirs = ""
            elif self._theirs_when != (told.armed, told.flown):
                self._say_anew()
        return certain

    def _is_ours_again(self) -> bool:
        """Whether PX4 flies our setpoints again, and no person did anything since it stopped to."""
        told = self._told
        is_flown = told.airborne and told.flown == PX4Mode.OFFBOARD.value
        is_told = told.intended_heard_s > self._caught_up_s
        return self.wanted is PX4Mode.OFFBOARD and is_flown and is_told and self.nobody_chose

    def _caught_up(self, now_s: float) -> bool:
        silence = self._told.silence
        is_current = self._told.boot_s >= silence.over_boot_s - _CLOCK_SLACK_S
        return is_current or now_s - silence.until_s > _CATCH_UP_S

    def _judge(self, now_s: float) -> bool:
        """Sets ``theirs``; False while that is not certain."""
        told, wanted = self._told, self.wanted
        assert wanted is not None
        if not told.armed:
            if told.airborne or wanted is not PX4Mode.LAND:
                self._say_anew()
            return True
        mode = told.flown
        if mode == wanted.value or mode == PX4Mode.OFFBOARD.value:
            self._not_followed_s = None
            return True
        if wanted is PX4Mode.LAND and not told.airborne:
            return True
        if wanted is not PX4Mode.OFFBOARD:
            self._give_up(mode)
            return True
        return self._judge_loss(mode, now_s)

    def _judge_loss(self, mode: PxMode, now_s: float) -> bool:
        """As ``_judge``, when PX4 left Offboard: did it lose our setpoints, or did somebody choose a mode?"""
        link, told = self._link, self._told
        if told.intended is None and self._deaf:
            chosen = False  # an older PX4 does not report it: it returns by itself, or not
        elif told.intended_heard_s <= self._caught_up_s and self._deaf:
            return False
        else:
            chosen = told.intended != PX4Mode.OFFBOARD.value
        action = self._on_loss
        if not chosen and action in _STICKS and mode == _STICKS[action]:
            if self._deaf and link.heard_s("SYS_STATUS") <= self._caught_up_s:
                return False
            chosen = told.manual_control
        elif not chosen and (action not in _NO_STICKS or mode != _NO_STICKS[action].value):
            chosen = True
        elif not chosen and self._deaf and link.heard_s("EXTENDED_SYS_STATE") <= self._caught_up_s:
            return False
        if chosen or not told.airborne:  # with setpoints a landed vehicle would take off again
            self._give_up(mode)
            return True
        if self._not_followed_s is None:
            self._not_followed_s = now_s
        elif now_s - self._not_followed_s > RETURNS_S:
            self._give_up(mode)
        return True

    def _say_anew(self) -> None:
        if self._told.armed:
            self._give_up(self._told.flown)
        else:
            self._say("its motors were stopped" if self._told.airborne else "it was disarmed")

    def _give_up(self, mode: PxMode) -> None:
        told, warnings = self._told, self._link.warnings(self._link.now_s() - _RECENT_S)
        if told.intended is not None and told.intended != PX4Mode.OFFBOARD.value and told.intended == mode:
            why = "somebody chose that"
        elif warnings:
            why = f"the autopilot says: {'; '.join(warnings)}"
        else:
            why = "the autopilot or its pilot chose that"
        self._say(f"it is in {mode_name(mode)}: {why}")

    def _say(self, theirs: str) -> None:
        self._said[theirs] += 1
        again = f" (time {self._said[theirs]})" if self._said[theirs] > 1 else ""
        self.theirs, self._theirs_since_s = f"{theirs}{again}", self._link.now_s()
        self._theirs_when = self._told.armed, self._told.flown


def is_free(told: Telemetry) -> bool:
    """Whether a flying vehicle may be taken over: it is in Hold, or PX4 lost its program."""
    lost = told.intended == PX4Mode.OFFBOARD.value and told.flown != PX4Mode.OFFBOARD.value
    return told.flown == PX4Mode.HOLD.value or (lost and (told.flown[0] == AUTO or not told.manual_control))
