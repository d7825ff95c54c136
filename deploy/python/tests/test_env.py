"""Environments: the bits of a study, arrays without copies, rewards, seeds."""

import numpy as np
import pytest

import skein
from laws_of_tests import ByFeatures


def fly_to_the_end(env, policy=lambda observations: None):
    over = np.zeros(env.worlds, dtype=bool)
    while not over.all():
        _, _, terminated, truncated, _ = env.step(policy(env.observations))
        over |= terminated | truncated
    return env.figures()


@pytest.mark.parametrize("scenario, duration_s", [("hover", 30), ("flock", 20)])
def test_worlds_without_actions_have_the_bits_of_a_study(scenario, duration_s, same_bits):
    env = skein.Env(scenario, worlds=5, action=None, duration_s=duration_s)
    env.reset(seed=7)
    flown = fly_to_the_end(env)
    study = skein.study(scenario, seeds=range(7, 12), set={"duration_s": duration_s})
    same_bits(flown, study.runs)


def test_actions_of_a_law_give_the_bits_of_the_law(same_bits):
    env = skein.Env("hover", worlds=3, action="velocity", duration_s=30)
    assert env.neighbours == ByFeatures.neighbours
    env.reset(seed=0)
    flown = fly_to_the_end(env, ByFeatures.velocity)
    study = skein.study("hover", seeds=3, set={"duration_s": 30}, law=ByFeatures)
    same_bits(flown, study.runs)


def test_threads_change_nothing():
    def flown(threads):
        env = skein.Env("hover", worlds=5, action="field", duration_s=5, threads=threads)
        env.reset(seed=3)
        for nth in range(20):
            env.step(np.full((5, env.vehicles, 2), 0.1 * nth))
        return env.observations.copy(), env.position_ned_m.copy()

    one, three = flown(1), flown(3)
    assert all((a == b).all() for a, b in zip(one, three))


def test_arrays_are_filled_in_place():
    env = skein.Env("hover", worlds=2, duration_s=5)
    observations, info = env.reset(seed=0)
    before = observations.copy()
    later, rewards, terminated, truncated, _ = env.step(np.zeros(env.actions.shape))
    assert later is observations and info["position_ned_m"] is env.position_ned_m
    assert not np.array_equal(before, later)
    assert rewards.shape == (2, 4) and terminated.shape == truncated.shape == (2,)
    heights = -env.position_ned_m[..., 2]
    assert np.isfinite(heights).all()


def test_controls_fly_the_helicopter():
    settings = dict(worlds=2, action="controls", duration_s=60, warm_up_s=15)
    env = skein.Env("hover", **settings)
    env.reset(seed=0)
    heights = -env.position_ned_m[..., 2]
    assert (heights > 20).all(), "the warm-up has lifted them"
    full = np.zeros(env.actions.shape)
    full[0, :, 3], full[1, :, 3] = 1.0, 0.0
    start = heights.copy()
    for _ in range(10):
        env.step(full)
    change = -env.position_ned_m[..., 2] - start
    assert (change[0] > 0.2).all() and (change[1] < -0.5).all(), change
    for _ in range(200):
        _, rewards, terminated, _, _ = env.step(full)
    assert env.crashed[1].any() and terminated[1] and rewards[1].min() < -9


def test_worlds_begin_one_by_one_with_their_seeds():
    env = skein.Env("hover", worlds=3, duration_s=2)
    first, _ = env.reset(seed=5)
    first = first.copy()
    truncated = np.zeros(3, dtype=bool)
    while not truncated.all():
        truncated = env.step(np.zeros(env.actions.shape))[3]
    kept = env.observations.copy()
    again, _ = env.reset(seed=6, worlds=[True, False, True])
    assert env.seeds.tolist() == [6, 6, 7]
    assert (again[0] == first[1]).all() and (again[2] == first[2]).all() and (again[1] == kept[1]).all()
    env.reset(worlds=[True, False, False])
    assert env.seeds[0] == 8, "without a seed the next number"


def test_a_reward_of_the_user_takes_the_arrays():
    env = skein.Env("hover", worlds=2, duration_s=5, reward=lambda env: -env.position_ned_m[..., 2])
    env.reset(seed=0)
    rewards = env.step(np.zeros(env.actions.shape))[1]
    assert (rewards == -env.position_ned_m[..., 2]).all()


def test_wrong_settings_and_actions_are_refused():
    with pytest.raises(skein.SkeinError, match="an action has to be"):
        skein.Env("hover", action="speed")
    with pytest.raises(skein.SkeinError, match="whole frames"):
        skein.Env("hover", set={"formation.external.period_s": 0.05})
    with pytest.raises(skein.ScenarioError):
        skein.Env("hover", set={"formation.radius": 3})
    env = skein.Env("hover", worlds=2)
    env.reset(seed=0)
    with pytest.raises(skein.SkeinError, match="not finite"):
        env.step(np.full(env.actions.shape, np.nan))
