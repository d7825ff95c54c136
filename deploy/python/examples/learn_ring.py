"""Learns a formation law on the CPU in a few minutes: a linear law on six features, by the cross-entropy method.

    python learn_ring.py                      # learns, judges, writes learned.json
    python learn_ring.py --generations 3      # a quick try

The law flies afterwards wherever a law flies:

    >>> import json, skein                                                              # doctest: +SKIP
    >>> from learn_ring import Learned                                                  # doctest: +SKIP
    >>> weights = json.load(open("learned.json"))                                       # doctest: +SKIP
    >>> skein.fly("hover", law=Learned, parameters={"weights": weights})                # doctest: +SKIP

Each candidate flies in worlds of its own, all at once. The features are in the vehicle's own polar frame about the centre
of the formation, so that what is learned on one side of the circle holds on every other.
"""

import argparse
import json
import time

import numpy as np

import skein

NEIGHBOURS = 3
FEATURES = ["outside", "above", "radial_speed", "around_speed", "push_outward", "push_around"]
ACTIONS = ["outward", "around", "down"]
SHAPE = (len(ACTIONS), len(FEATURES) + 1)
SPEED_M_S = 5.0


def features(observed):
    """The features of observations, shape (..., features of the environment), and the unit vector away from the centre."""
    north, east, down = observed[..., 0], observed[..., 1], observed[..., 2]
    radius = observed[..., 7]
    rho = np.maximum(np.sqrt(north * north + east * east), 1e-3)
    out_n, out_e = north / rho, east / rho
    push_n, push_e = np.zeros_like(rho), np.zeros_like(rho)
    for nth in range(NEIGHBOURS):
        there = observed[..., 8 + 7 * nth : 11 + 7 * nth]
        apart = np.maximum(np.sqrt(there[..., 1] * there[..., 1] + there[..., 2] * there[..., 2]), 1.0)
        weight = there[..., 0] * radius / (apart * apart)
        push_n, push_e = push_n - weight * there[..., 1], push_e - weight * there[..., 2]
    along = lambda a, b: a * out_n + b * out_e
    around = lambda a, b: b * out_n - a * out_e
    speed_n, speed_e = observed[..., 3] / SPEED_M_S, observed[..., 4] / SPEED_M_S
    columns = [
        np.clip(4.0 * (rho / radius - 1.0), -1.0, 1.0),
        np.clip(-down / 10.0, -1.0, 1.0),
        along(speed_n, speed_e),
        around(speed_n, speed_e),
        along(push_n, push_e),
        around(push_n, push_e),
        np.ones_like(rho),
    ]
    return np.stack(columns, axis=-1), out_n, out_e


def velocity(weights, observed):
    """The law: weights of shape (..., actions, features + 1), observations of shape (..., features)."""
    inputs, out_n, out_e = features(observed)
    outward, around, down = np.moveaxis(np.clip((weights * inputs[..., np.newaxis, :]).sum(axis=-1), -1.0, 1.0), -1, 0)
    north = outward * out_n - around * out_e
    east = outward * out_e + around * out_n
    return SPEED_M_S * np.stack([north, east, down], axis=-1)


class Learned(skein.Law):
    """The law with the weights of the parameter ``weights``, as a list."""

    def __init__(self, setup):
        super().__init__(setup)
        self.weights = np.array(setup.parameters["weights"], dtype=float).reshape(SHAPE)

    def answer(self, observation):
        return skein.Velocity(velocity(self.weights, observation.features(NEIGHBOURS)))


def reward(env):
    """Near the circle, at the altitude, evenly spread, slow, and nowhere near another vehicle."""
    place = env.position_ned_m[..., :2]
    bearing = np.sort(np.arctan2(place[..., 1], place[..., 0]), axis=-1)
    gaps = np.diff(bearing, axis=-1, append=bearing[..., :1] + 2 * np.pi)
    uneven = np.abs(gaps - 2 * np.pi / env.vehicles).max(axis=-1, keepdims=True)
    speed = np.sqrt((env.velocity_ned_m_s[..., :2] ** 2).sum(axis=-1))
    return skein.default_reward(env) - 0.5 * uneven - 0.02 * speed - 2.0 * (env.separation_m < 8.0)


def learn(generations=25, candidates=32, seeds=2, duration_s=80, threads=1, seed=0, report=print):
    """The cross-entropy method: draws candidates, flies all at once, and draws the next about the best quarter."""
    rng = np.random.default_rng(seed)
    env = skein.Env(
        "hover",
        worlds=candidates * seeds,
        action="velocity",
        neighbours=NEIGHBOURS,
        duration_s=duration_s,
        threads=threads,
        reward=reward,
        ends_on_crash=False,
    )
    mean, spread = np.zeros(SHAPE), np.full(SHAPE, 0.5)
    for generation in range(generations):
        drawn = mean + spread * rng.standard_normal((candidates, *SHAPE))
        drawn[0] = mean
        weights = np.repeat(drawn, seeds, axis=0)[:, np.newaxis]
        first = 1000 + generation * seeds
        observed, _ = env.reset(seed=np.tile(np.arange(first, first + seeds), candidates))
        returns, steps = np.zeros(env.worlds), 0
        while True:
            observed, rewards, terminated, truncated, _ = env.step(velocity(weights, observed))
            returns, steps = returns + rewards.mean(axis=1), steps + 1
            if (terminated | truncated).all():
                break
        scores = (returns / steps).reshape(candidates, seeds).mean(axis=1)
        best = drawn[np.argsort(scores)[::-1][: candidates // 4]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.02
        report(f"generation {generation + 1}: best {scores.max():.3f}, mean {scores.mean():.3f} a step")
    return mean


def judge(weights, seeds=10, duration_s=200):
    """Flies the learned law and the built-in one, as frames of runs."""
    parameters = {"weights": weights.ravel().tolist()}
    keys = {"duration_s": duration_s}
    return (
        skein.study("hover", seeds=seeds, set=keys, law=Learned, parameters=parameters),
        skein.study("hover", seeds=seeds, set=keys),
    )


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--generations", type=int, default=25)
    options.add_argument("--threads", type=int, default=1)
    options.add_argument("--out", default="learned.json")
    options = options.parse_args()
    began = time.monotonic()
    weights = learn(options.generations, threads=options.threads)
    print(f"learned in {time.monotonic() - began:.0f} s")
    with open(options.out, "w", encoding="utf-8") as file:
        json.dump(weights.ravel().tolist(), file)
    for name, flown in zip(("learned", "built in"), judge(weights)):
        runs = flown.runs
        columns = ["collisions", "crashes", "min_separation_m", "radial_rms_m", "spacing_error_deg"]
        print(name, runs[columns].median().round(3).to_dict())


if __name__ == "__main__":
    main()
