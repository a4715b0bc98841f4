"""Which looks were answered, how old the newest is, and which legs were flown blind."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

import numpy as np
import shapely

from skysweep.arrays import F64
from skysweep.scenarios.model import Scenario
from skysweep.types import XY, Detections, Doubt, LookPeriod, VehicleState

_STRAIGHT_M = 2.0  # tolerance of the legs that stand for a flown path
_CLOCK_SLACK_S = 0.5  # a picture farther in the future has a wrong clock
_LOOKS_EACH = 2  # at each place, at least, when looks are rare
_REMEMBERED = 64  # looks, to recognise duplicates
_TRACK_LOOKS = 40  # how many looks back the camera may be doubted
_JUDGED, _HICCUPS = 10, 1  # looks, and how many of them may be doubted without an alarm


class Looks:
    """Takes every answer of the sensor and the track flown meanwhile.

    A stretch that covered ground is blind if no look exposed on it was answered for longer than a look takes
    plus ``safety.detector_silent_s``. While the sensor is slower than usual, looks take longer, and ground
    that was in no picture is blind as well.
    """

    def __init__(self, scenario: Scenario, period: LookPeriod, cover_altitude_agl_m: float) -> None:
        camera, safety = scenario.camera, scenario.safety
        self._period = period
        self._latency_s = camera.latency_s
        self._silent_s, self._dead_s = safety.detector_silent_s, safety.detector_dead_s
        self._along_m = camera.lens.footprint_m(cover_altitude_agl_m)[1]
        self._scan_speed_mps = scenario.search.scan_speed_mps
        self._picture_s = 1.0 / scenario.camera.rate_hz
        self.newest_s = -math.inf  # exposure of the newest look that was answered
        self._excused_s = -math.inf
        self._pose_delay_s = camera.pose_delay_s
        self._lost = self._silent = False
        self._distrusted = (math.inf, math.inf)
        self._elsewhere = (math.inf, -math.inf)  # exposures while the camera looked elsewhere
        self._recent: deque[float] = deque(maxlen=_REMEMBERED)
        self._track: deque[tuple[float, F64, bool]] = deque()
        self._blind: list[tuple[XY, XY]] = []
        self._doubts: deque[str] = deque(maxlen=_JUDGED)  # of the newest looks; empty: trusted
        self.failure = ""  # of the newest look that was no answer

    @property
    def usual_age_s(self) -> float:
        """The greatest normal age of the newest answered look."""
        period_s = self._period.period_s
        answer_s = max(self._latency_s, period_s) if self.are_rare else self._latency_s
        return answer_s + self._pose_delay_s + period_s

    @property
    def silent_age_s(self) -> float:
        """From this age on the detector is silent."""
        return self.usual_age_s + self._silent_s

    @property
    def dead_age_s(self) -> float:
        """From this age on the search is over."""
        return self.usual_age_s + self._dead_s

    @property
    def doubt(self) -> str:
        """Why the camera's pictures are not trusted; empty if they are."""
        doubted = [k for k, why in enumerate(self._doubts) if why]
        if len(doubted) <= _HICCUPS:
            return ""
        n_since = len(self._doubts) - doubted[0]
        return f"{self._doubts[doubted[-1]]} ({len(doubted)} of the last {n_since} pictures)"

    @property
    def rate_hz(self) -> float:
        """Looks a second that the sensor keeps."""
        return 1.0 / self._period.period_s

    @property
    def usual_rate_hz(self) -> float:
        """Looks a second that the scenario asks for."""
        return 1.0 / self._period.usual_period_s

    @property
    def are_rare(self) -> bool:
        """Whether the sensor cannot keep its usual rate."""
        return self._period.period_s > self._period.usual_period_s

    @property
    def scan_speed_mps(self) -> float:
        """The scan's speed; while looks are rare, at most that at which each place lies in two pictures."""
        if not self.are_rare:
            return self._scan_speed_mps
        return min(self._scan_speed_mps, self._along_m / (_LOOKS_EACH * self._period.period_s))

    @property
    def scan_is_slowed(self) -> bool:
        """Whether the scan is slower than planned, because looks are rare."""
        return self.are_rare and self.scan_speed_mps < self._scan_speed_mps

    def begin(self, time_s: float) -> None:
        """Start looking."""
        self.newest_s = self._excused_s = time_s

    def seen_until_enu_m(self) -> F64 | None:
        """(3,) where the newest answered look was exposed; None if the track does not go back to it."""
        before = [position for t, position, _ in self._track if t <= self.newest_s]
        return before[-1] if before else None

    def take(self, now_s: float, detections: Detections) -> bool:
        """Whether an answer counts: not if it is a duplicate, misdated, misplaced or not trusted."""
        exposed_s = detections.time_s
        if exposed_s > now_s + _CLOCK_SLACK_S or exposed_s < now_s - self.dead_age_s:
            self.failure = f"its picture is dated {exposed_s - now_s:+.0f} s from now"
            return False
        if self._distrusted[0] <= exposed_s <= self._distrusted[1]:
            return False
        if self._elsewhere[0] <= exposed_s <= self._elsewhere[1]:
            self.failure = "the camera looks elsewhere"
            return False
        if exposed_s <= self.newest_s and exposed_s in self._recent:
            return False
        self._recent.append(exposed_s)
        self._doubts.append("")
        if detections.doubt is not None:
            self._distrust(detections.doubt)
            return False
        if exposed_s > self.newest_s:
            if exposed_s - self.newest_s > self._longest_gap_s():
                self._note_blind(self.newest_s, exposed_s)
            self.newest_s = exposed_s
            self._forget_track()
        return True

    def _distrust(self, doubt: Doubt) -> None:
        """Discard the newest look and those before it that the doubt covers."""
        self.newest_s = min(self.newest_s, doubt.since_s)
        for k, exposed_s in enumerate(list(self._recent)[-len(self._doubts) :]):
            if exposed_s >= doubt.since_s:
                self._doubts[k] = doubt.why

    def give_up(self, now_s: float) -> None:
        """End the search: what was flown since the newest look is blind."""
        if now_s - self.newest_s > self._longest_gap_s() + self.usual_age_s:
            self._note_blind(self.newest_s, now_s)

    def keep_track(self, state: VehicleState, covers: bool) -> None:
        """Record where the vehicle is, and whether it covers ground from there."""
        if not self._lost:
            self._track.append((state.time_s, state.position_enu_m, covers))

    def trust(self, now_s: float, lost: bool, silent: bool) -> None:
        """Take note of a lost position or silent telemetry.

        Pictures without a position are ignored, and a silent vehicle does not count as a silent detector.
        """
        if lost and not self._lost:
            self._distrusted = (now_s, math.inf)
        elif self._lost and not lost:
            self._distrusted = (self._distrusted[0], now_s + self._pose_delay_s)
        if lost or silent or self._silent:
            self._excused_s = now_s
        self._lost, self._silent = lost, silent

    def look_elsewhere(self, now_s: float, elsewhere: bool) -> None:
        """Take note of whether the camera looks past the ground: what it shows meanwhile does not count."""
        if elsewhere and self._elsewhere[1] < math.inf:
            self._elsewhere = (now_s, math.inf)
        elif not elsewhere and self._elsewhere[1] == math.inf:
            self._elsewhere = (self._elsewhere[0], now_s + self._pose_delay_s)

    def are_due(self, now_s: float, until_s: float) -> bool:
        """Whether late answers to pictures up to ``until_s`` are still awaited."""
        return self.newest_s < until_s and now_s - self.newest_s > 2.0 * self.usual_age_s

    def age_s(self, now_s: float) -> float:
        """Age of the newest answered look, not counting time without position or link."""
        return now_s - max(self.newest_s, self._excused_s)

    def take_blind(self, legs: tuple[tuple[XY, XY], ...]) -> None:
        """Take over legs that were flown blind before."""
        self._blind += legs

    def blind_legs(self) -> tuple[tuple[XY, XY], ...]:
        """Legs found since the last call to be flown blind."""
        legs, self._blind = tuple(self._blind), []
        return legs

    def _longest_gap_s(self) -> float:
        usual_s, now_s = self._period.usual_period_s, self._period.period_s
        usual_s = math.ceil(usual_s / self._picture_s - 1e-6) * self._picture_s  # looks wait for a picture
        return self._silent_s + max(usual_s, min(now_s, self._along_m / self.scan_speed_mps - self._silent_s))

    def _note_blind(self, since_s: float, until_s: float) -> None:
        path: list[XY] = []
        for t, position, covers in [*self._track, (math.inf, np.zeros(3), False)]:
            if covers and since_s - 1.0 <= t <= until_s + 1.0:
                path.append((position.item(0), position.item(1)))
            elif path:
                self._blind += legs_along(path)
                path = []

    def _forget_track(self) -> None:
        while (
            len(self._track) > 1 and self._track[1][0] <= self.newest_s - _TRACK_LOOKS * self._period.period_s
        ):
            self._track.popleft()


def legs_along(path: list[XY]) -> list[tuple[XY, XY]]:
    """A path as few straight legs."""
    if len(path) < 2:
        return []
    corners = [(x, y) for x, y in shapely.LineString(path).simplify(_STRAIGHT_M).coords]
    return list(pairwise(corners))
