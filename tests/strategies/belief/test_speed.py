"""How long one decision takes where there is much to decide."""

import time

import numpy as np
from tests.strategies.contexts import context_of

from skysweep.geometry.camera import CameraPose, project
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.belief.search import BeliefSearch
from skysweep.types import Candidate, Look, Observation, Sighting, VehicleState

N, SIDE_M = 100, 4472.0  # candidates on 20 km2
STEP_S, SPEED_MPS = 0.4, 15.0
DOWN = rotation_camera_to_enu(0.0, -np.pi / 2)


def steps_s(n_steps):
    """Seconds of each step that finds the candidates, and of the way to them, on which looks go on."""
    rng = np.random.default_rng(5)
    places = np.column_stack([rng.uniform(0.0, SIDE_M, (N, 2)), np.zeros(N)])
    end = (SIDE_M, SIDE_M)
    context = context_of(
        [end], parameters=BeliefParameters(missed_cost_s=1e5, alarm_cost_s=1e5, confirm_probability=1 - 1e-9)
    )
    strategy = BeliefSearch(context)
    candidates, took = {}, []

    def step(time_s, at):
        camera = CameraPose(np.array(at, dtype=float), DOWN)
        uv, _ = project(context.lens, camera, places)
        seen = np.nonzero(
            ((uv >= 0.0) & (uv <= (context.lens.width_px, context.lens.height_px))).all(axis=1)
        )[0]
        hits = []
        for k in seen.tolist():
            confidence = float(rng.uniform(0.4, 0.7))
            of_it = candidates[k].confidences if k in candidates else ()
            candidates[k] = Candidate(
                k, "stop sign", places[k], np.eye(2) * 0.2, time_s, time_s, (*of_it, confidence)
            )
            hits.append(Sighting(k, not of_it, time_s, places[k], confidence, float(at[2])))
        state = VehicleState(
            time_s, camera.position_enu_m, np.zeros(3), np.eye(3), camera, 1.0, 0.0, airborne=True
        )
        look = Look(time_s, camera, context.lens, tuple(hits))
        began_s = time.perf_counter()
        command = strategy.step(Observation(state, float(at[2]), (look,), candidates))
        took.append(time.perf_counter() - began_s)
        return command

    for k in range(N):
        for repeat in range(3):
            step(3.0 * k + repeat, (*places[k, :2], 30.0))
    at, time_s = np.array([*end, 30.0]), 3.0 * N
    for _ in range(n_steps):
        command = step(time_s, at)
        if command.waypoint is None:
            break
        to = np.array([*command.waypoint.xy_enu_m, command.waypoint.altitude_agl_m])
        way = to - at
        at = at + way * min(1.0, SPEED_MPS * STEP_S / max(float(np.linalg.norm(way)), 1e-9))
        time_s += STEP_S
    return np.array(took)


def test_a_decision_among_a_hundred_candidates_takes_milliseconds():
    steps_s(5)  # compiles
    took = steps_s(400)
    assert len(took) == 3 * N + 400
    print(f"median {1e3 * np.median(took):.2f} ms, worst {1e3 * took.max():.1f} ms")
    assert np.median(took) <= 2e-3 * 3  # on a busy machine
    assert took.max() <= 20e-3 * 3
