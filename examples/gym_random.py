"""An agent that knows nothing searches once: the loop that every learner has."""

import gymnasium

import skysweep.gym  # noqa: F401  # registers skysweep/Search-v0

env = gymnasium.make("skysweep/Search-v0", scenario="sparse", time_limit_s=120.0)
env.action_space.seed(0)
observation, info = env.reset(seed=0)
total, over = 0.0, False
while not over:
    action = env.action_space.sample()  # your policy: observation -> east, north, CHECK
    observation, reward, terminated, truncated, info = env.step(action)
    total, over = total + reward, terminated or truncated
summary = info["summary"]
print(f"reward {total:.1f}, recall {summary['recall']:.2f}, {summary['mission_time_s']:.0f} s")
env.close()
