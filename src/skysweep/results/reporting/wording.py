"""Texts of all reports: the parameters of a mission and the meaning of words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from skysweep.mission.notes import LOOKED, SORTIE
from skysweep.results.metrics import MATCH_DISTANCE_M
from skysweep.results.reporting.html import Grid
from skysweep.scenarios.model import Scenario, VehicleLimits
from skysweep.text import printable
from skysweep.types import EventKind
from skysweep.worlds.obstacles import BODY_RADIUS_M

_ACTIONS = {
    "CONTINUE": "Note",
    "REFUSE_CHECK": "A check is refused",
    "HOLD": "The vehicle holds",
    "KEEP_OUT": "Hands off",
    "RETURN": "The vehicle turns home",
    "LAND": "The vehicle lands where it is",
}


def parameters(scenario: Scenario) -> Grid:
    """The parameters of a mission except n_c and d_c."""
    search, camera, detector = scenario.search, scenario.camera, scenario.detector
    vehicle, wind = scenario.vehicle, scenario.wind
    rows = {
        "Area": f"{scenario.area_enu_m.area / 1e4:.2f} ha, {scenario.terrain.surface}",
        "Scan": f"{search.scan_altitude_agl_m:g} m above ground at {search.scan_speed_mps:g} m/s, "
        f"sidelap {search.sidelap:.0%}; the smallest target spans "
        f"{scenario.pixels_on_target(search.scan_altitude_agl_m):.0f} px",
        "Check": f"{search.check_altitude_agl_m:g} m above ground at {search.check_speed_mps:g} m/s, "
        f"confirmed from confidence {search.c_t:g}; there it spans "
        f"{scenario.pixels_on_target(search.check_altitude_agl_m):.0f} px",
        "Camera": f"{camera.width_px} x {camera.height_px} px, {camera.hfov_rad:g} rad across, "
        f"{camera.rate_hz:g} Hz, latency {camera.latency_s:g} s, gimbal lag {camera.gimbal.lag_s:g} s",
        "Detector": f"{detector.model}, {detector.rate_hz:g} Hz, from confidence {detector.confidence_min:g}",
        "Vehicle": f"climb {vehicle.climb_speed_mps:g} m/s, descent {vehicle.descent_speed_mps:g} m/s, "
        f"{_batteries(vehicle)}, position noise {vehicle.position_noise_m:g} m",
        "Wind": f"{wind.mean_speed_mps:g} m/s from {wind.from_heading_deg:g}°, "
        f"gusts {wind.gust_std_mps:g} m/s",
    }
    return Grid(("What", "Value"), list(rows.items()), words=True)


def moving_words(scenario: Scenario) -> str:
    """What a probability of detection does not say of targets that may move; empty if they do not."""
    of_targets = [generator for generator in scenario.generators if generator.kind in scenario.target_classes]
    moving = any(target.motion for target in scenario.targets) or any(g.motion for g in of_targets)
    if not moving and not scenario.search.target_speed_mps:
        return ""
    return "Targets may move: the POD counts where they were when looked for, and not where they are now."


def _batteries(vehicle: VehicleLimits) -> str:
    if vehicle.batteries == 1:
        return f"battery {vehicle.battery_wh:g} Wh"
    return f"{vehicle.batteries} batteries of {vehicle.battery_wh:g} Wh, changed in {vehicle.swap_s:g} s"


def glossary(meanings: Mapping[str, str]) -> Grid:
    """A table of words and their meanings."""
    return Grid(("Word", "Meaning"), list(meanings.items()), words=True)


def definitions() -> Grid:
    """The words of a report in short; docs/results.md has them in full."""
    return glossary(
        {
            "Mission time": "From the take-off command until all transects are flown and the last candidate "
            "is confirmed or rejected, without return and landing (see total_time_s).",
            "Scanned": "Seen from the scan altitude and put on the list of candidates.",
            "Confirmed": "Detected at the check altitude with enough confidence. By a strategy that gives "
            "probabilities: probable enough, from whatever height it was seen. Or by the operator.",
            "Rejected": "Not confirmed although the vehicle was above it at the check altitude. By a "
            "strategy that gives probabilities: too improbable to be worth another look. Or by the operator.",
            "Probability": "That the candidate is a target, as the strategy believed.",
            "Unchecked": "On the list of candidates but never checked: it may be a target, so have a look.",
            "Right": f"Confirmed, with a true target of its class within {MATCH_DISTANCE_M:g} m that no "
            "other candidate takes.",
            "False scan": "A checked candidate that was no new target. Duplicates of a target count.",
            "False positive": "A false scan that was confirmed. Duplicates of a confirmed target count.",
            "Recall": "True targets confirmed over all true targets.",
            "POS": "Probability of success: share of the true targets confirmed so far.",
            "Nearest to an obstacle": "Smallest distance of the vehicle's centre from trees, buildings and, "
            "between take-off and landing, the ground. Less than "
            f"{BODY_RADIUS_M:g} m is a collision.",
            "Area seen": "Share of the area's ground that the camera saw while scanning: in its picture, and "
            "not hidden by a crown or building.",
        }
    )


def is_said(record: Mapping[str, Any]) -> bool:
    """Whether ``safety_words`` has a sentence for a line; a search that ends as planned has none."""
    if record["kind"] == EventKind.FINISHED:
        return bool(record.get("reason"))
    return record["kind"] in ("safety", "unsearched", EventKind.MISFIT, EventKind.LOOKS_AGAIN)


def safety_words(record: Mapping[str, Any]) -> str:
    """One sentence for a line that ``is_said``."""
    if record["kind"] == EventKind.FINISHED:
        return f"The search ends early: {printable(record['reason'])}."
    if record["kind"] == EventKind.LOOKS_AGAIN:
        place = _at(record["p"]) if record.get("p") is not None else ""
        return f"Back to ground that was searched weakly{place}: {printable(record['reason'])}."
    if record["kind"] == EventKind.MISFIT:
        return f"The sensor model does not fit what is seen here: {printable(record['reason'])}."
    if record["kind"] == "unsearched":
        again = "they are scanned again" if record["again"] else "they were not scanned again"
        return f"{record['length_m']:.0f} m of the scan turned out to be flown blind; {again}."
    return f"{_ACTIONS[record['action']]}: {record['sentence']}"


def order_words(record: Mapping[str, Any]) -> str:
    """One sentence for an ``operator`` or ``looked`` line of a journal."""
    of = ""
    if record.get("candidate") is not None:
        of = f" candidate {record['candidate']}"
    if record.get("p") is not None:
        of += _at(record["p"])
    if record["kind"] == LOOKED:
        return f"Looked{of} for the operator."
    return f"The operator orders: {printable(record['word'])}{of}."


def _at(place_enu_m: Sequence[float]) -> str:
    east_m, north_m, _ = place_enu_m
    return f" at {east_m:.0f} m east, {north_m:.0f} m north"


def sortie_words(record: Mapping[str, Any]) -> str:
    """One sentence for a ``sortie`` or ``next_sortie`` line of a journal."""
    charge = f", battery at {record['battery']:.0%}" if isinstance(record.get("battery"), float) else ""
    if record["kind"] == SORTIE:
        why = f"{printable(record['why'])}, {record['energy_wh']:.1f} Wh used"
        return f"Sortie {record['number']} has landed for another battery ({why}{charge})."
    return f"Sortie {record['number']} takes off{charge}."


def decision_words(record: Mapping[str, Any]) -> str:
    """Why a strategy decided what a line of a journal says, and what could be decided at what cost."""
    costs = ", ".join(
        f"{printable(what)}: {cost_s:.0f}\u00a0s" for what, cost_s in record.get("alternatives", ())
    )
    return f"{printable(record.get('reason') or '')}{f' ({costs})' if costs else ''}"


def probability_of(value: float) -> str:
    """A probability with two digits; never 0 or 1."""
    return "over 0.99" if value > 0.99 else "under 0.01" if value < 0.01 else f"{value:.2f}"


def share(value: float) -> str:
    """A share in whole percent; 0 % and 100 % only where they are exact."""
    if 0.0 < value < 0.005:
        return "under 1%"
    return "over 99%" if 0.995 <= value < 1.0 else f"{value:.0%}"


def counted(n: int, word: str) -> str:
    """A number with its noun."""
    return f"{n} {word}{'' if n == 1 else 's'}"


def clock(seconds: float) -> str:
    """Minutes and seconds."""
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
