"""The contracts of Gymnasium and PettingZoo: seeds of worlds, the order of calls, copies, wrong actions, registered ids."""

import copy
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, InvalidAction, ResetNeeded, UnsupportedMode
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import FlattenObservation, RescaleAction

import skein
from skein.gym import SwarmEnv, SwarmVectorEnv
from skein.pettingzoo import SwarmParallelEnv

SHORT = {"duration_s": 1}


def swarm(**settings):
    return SwarmEnv("hover", **{**SHORT, **settings})


def vector(num_envs=3, **settings):
    return SwarmVectorEnv("hover", num_envs=num_envs, **{**SHORT, **settings})


def parallel(**settings):
    return SwarmParallelEnv("hover", **{**SHORT, **settings})


KINDS = [swarm, vector, parallel]


def action_of(env):
    """An action without motion, as the environment takes it."""
    if isinstance(env, SwarmParallelEnv):
        return {agent: np.zeros(3, dtype=np.float32) for agent in env.possible_agents}
    return np.zeros(env.action_space.shape, dtype=np.float32)


def worlds_of(env):
    """The seeds of the worlds that fly."""
    return env.unwrapped.env.seeds.tolist()


def begun(env, resets, **first):
    """The seeds of the worlds that so many resets begin, the first with these arguments."""
    seeds = []
    for nth in range(resets):
        env.reset(**(first if nth == 0 else {}))
        seeds += worlds_of(env)
    return seeds


def test_environments_of_a_vector_environment_repeat_no_world():
    envs = SyncVectorEnv([swarm] * 4)
    _, info = envs.reset(seed=0)
    worlds = info["seed"].tolist()
    for _ in range(9 * 11):
        _, _, _, _, info = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
        worlds += info["seed"][info["_seed"]].tolist() if "seed" in info else []
    assert len(worlds) == 40 and len(set(worlds)) == 40, sorted(worlds)


def test_the_vector_environment_flies_what_as_many_single_ones_fly():
    one, other = SyncVectorEnv([swarm] * 3), vector()
    for seed in (5, None, [8, None, 2]):
        first, second = one.reset(seed=seed)[0], other.reset(seed=seed)[0]
        if seed is None:
            continue
        assert (first == second).all() and first.dtype == second.dtype == np.float32
        one.action_space.seed(1)
        for _ in range(25):
            action = one.action_space.sample()
            results = one.step(action), other.step(action)
            for left, right in zip(results[0][:4], results[1][:4]):
                assert (left == right).all() and left.dtype == right.dtype
            assert results[0][4].keys() == results[1][4].keys()
            for name, value in results[0][4].items():
                assert (value == results[1][4][name]).all(), name
    assert len(set(begun(other, 10, seed=0))) == 30


def test_a_masked_reset_begins_only_the_worlds_of_the_mask():
    env = vector()
    observations, _ = env.reset(seed=4)
    before = worlds_of(env)
    again, info = env.reset(seed=4, options={"reset_mask": np.array([True, False, True])})
    assert worlds_of(env) == before and (again == observations).all()
    assert info["_seed"].tolist() == [True, False, True]
    env.reset(options={"reset_mask": np.array([False, True, False])})
    after = worlds_of(env)
    assert [after[0], after[2]] == [before[0], before[2]] and after[1] != before[1]
    for mask in ([True] * 3, np.ones(2, dtype=bool), np.zeros(3, dtype=bool), np.ones(3)):
        with pytest.raises(skein.ArgumentError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})


@pytest.mark.parametrize("make", KINDS)
def test_a_seed_fixes_all_worlds_that_follow(make):
    first, again = (begun(make(), 4, seed=7) for _ in range(2))
    # The worlds of a vector environment have the seeds that follow, one each.
    other = begun(make(), 4, seed=7 + len(worlds_of(make())))
    assert first == again
    assert not set(first) & set(other), "another seed has no world in common"


@pytest.mark.parametrize("make", KINDS)
def test_without_a_seed_every_environment_flies_other_worlds(make):
    worlds = begun(make(), 3) + begun(make(), 3)
    assert len(set(worlds)) == len(worlds)


def test_the_seed_of_a_world_flies_it_again_elsewhere():
    env = swarm(action="velocity")
    observation, info = env.reset(seed=3)
    world = info["seed"]
    assert worlds_of(env) == [world]
    same = skein.Env("hover", worlds=1, **SHORT)
    assert (same.reset(seed=world)[0][0].astype(np.float32) == observation).all()
    assert skein.study("hover", seeds=range(world, world + 1), set=SHORT).runs["seed"].tolist() == [world]
    _, infos = parallel().reset(seed=3)
    assert {info["seed"] for info in infos.values()} == {world}


@pytest.mark.parametrize("make", KINDS)
@pytest.mark.parametrize("seed", [-1, 1.0, 0.5, True, "0", 2**63, [1], {}, float("nan")], ids=repr)
def test_a_wrong_seed_is_refused_by_name(make, seed):
    env = make()
    with pytest.raises(skein.ArgumentError, match="seed=") as caught:
        env.reset(seed=seed)
    assert "whole number from 0 to" in str(caught.value) or "entries" in str(caught.value)
    env.reset(seed=np.int64(3))


@pytest.mark.parametrize("make", KINDS)
def test_calls_out_of_order_are_refused(make):
    env = make()
    with pytest.raises(ResetNeeded, match="Cannot call env.step.. before calling env.reset"):
        env.step(action_of(env))
    env.reset(seed=0)
    if make is not vector:  # a vector environment begins anew by itself
        ended = False
        while not ended:
            *_, terminated, truncated, _ = env.step(action_of(env))
            ended = truncated if make is swarm else any(truncated.values())
        with pytest.raises(ResetNeeded, match="after the flight has ended"):
            env.step(action_of(env))
        env.reset()
        env.step(action_of(env))
    assert env.render() is None
    env.close()
    env.close()
    for call in (lambda: env.step(None), env.reset):
        with pytest.raises(ClosedEnvironmentError, match="after env.close"):
            call()


@pytest.mark.parametrize("make", [*KINDS, lambda: skein.Env("hover", worlds=1)])
@pytest.mark.parametrize("copies", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_copy_is_refused_in_a_sentence(make, copies):
    env = make()
    with pytest.raises(skein.SkeinError, match="cannot be copied or pickled: .*same arguments"):
        copies(env)
    env.reset(seed=0)
    with pytest.raises(TypeError, match="cannot be copied or pickled"):
        copies(env)


@pytest.mark.parametrize("make", KINDS)
def test_wrong_constructions_are_refused(make):
    for mode in ("human", "rgb_array", 3):
        with pytest.raises(UnsupportedMode, match="render_mode"):
            make(render_mode=mode)
    assert make(render_mode=None).render_mode is None
    with pytest.raises(skein.ArgumentError, match="worlds=2"):
        make(worlds=2)
    with pytest.raises(skein.ArgumentError, match="duration_s"):
        make(max_episode_steps=50)
    with pytest.raises(skein.ArgumentError, match="skein.Env flies"):
        make(action=None)
    with pytest.raises(skein.ArgumentError, match="neighbours=99.* 3 neighbours at most"):
        make(neighbours=99)
    env = make()
    for options in (3, "fast", ["fast"]):
        with pytest.raises(skein.ArgumentError, match="options="):
            env.reset(options=options)
    env.reset(seed=1, options={"unknown": 1})


@pytest.mark.parametrize("envs", [0, -1, 1.5, "3", True, 10**9])
def test_a_wrong_number_of_worlds_is_refused(envs):
    with pytest.raises(skein.ArgumentError, match="num_envs="):
        vector(num_envs=envs)


def wrong_actions(shape):
    full = np.zeros(shape)
    beyond, undefined, endless = full.copy(), full.copy(), full.copy()
    beyond[..., 1, 2], undefined[..., 0, 1], endless[..., 0, 0] = 7.3, np.nan, np.inf
    return [
        (beyond, "velocity_down_m_s of vehicle 2.* is 7.3, but lies within -5 to 5"),
        (-beyond, "velocity_down_m_s of vehicle 2.* is -7.3"),
        (undefined, "velocity_east_m_s of vehicle 1.* is nan, not finite"),
        (endless, "velocity_north_m_s of vehicle 1.* is inf, not finite"),
        (full[..., :2], "shape"),
        (full[np.newaxis], "shape"),
        (full.ravel(), "shape"),
        (0.0, "shape"),
        (None, "has to be an array of shape"),
        ("north", "has to be an array of shape"),
        (full.astype(bool), "has to be an array of shape"),
        (full.astype(complex), "has to be an array of shape"),
        ([[1, 2], [3]], "has to be an array of shape"),
    ]


@pytest.mark.parametrize("make", [swarm, vector])
def test_a_wrong_action_is_refused_by_name(make):
    env = make()
    env.reset(seed=0)
    before = env.env.position_ned_m.copy()
    for action, message in wrong_actions(env.action_space.shape):
        with pytest.raises(InvalidAction, match=message) as caught:
            env.step(action)
        assert isinstance(caught.value, skein.ArgumentError)
    assert (env.env.position_ned_m == before).all(), "a refused action moves no vehicle"
    for action in (env.action_space.low, env.action_space.high, env.action_space.high.tolist()):
        env.step(action)


def test_actions_of_wrong_agents_are_refused_by_name():
    env = parallel()
    env.reset(seed=0)
    right = action_of(env)
    without = {agent: action for agent, action in right.items() if agent != "vehicle_3"}
    for actions, message in [
        ({**right, "vehicle_9": right["vehicle_1"]}, "no agent 'vehicle_9'; did you mean vehicle_"),
        ({**right, 1: right["vehicle_1"]}, "no agent 1"),
        (without, "the action of vehicle_3 is missing"),
        ({}, "vehicle_1, vehicle_2, vehicle_3, vehicle_4 is missing"),
        (None, "a dict with the action of each agent"),
        (np.zeros((4, 3)), "a dict with the action of each agent"),
        ({**right, "vehicle_2": np.full(3, 6.0)}, r"actions\['vehicle_2'\]: velocity_north_m_s is 6, but lies within -5 to 5"),
        ({**right, "vehicle_2": np.full(3, np.nan)}, "is nan, not finite"),
        ({**right, "vehicle_2": np.zeros(2)}, "shape"),
    ]:
        with pytest.raises(InvalidAction, match=message):
            env.step(actions)
    for space in (env.observation_space, env.action_space):
        with pytest.raises(KeyError, match="vehicle_9: there is no such agent"):
            space("vehicle_9")
    env.step(right)


def test_a_world_that_begins_anew_needs_no_valid_action():
    env = vector()
    env.reset(seed=0)
    for _ in range(10):
        _, _, _, truncated, _ = env.step(action_of(env))
    assert truncated.all()
    _, rewards, _, truncated, info = env.step(np.full(env.action_space.shape, np.nan))
    assert not truncated.any() and (rewards == 0).all() and info["_seed"].all()
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP


@pytest.mark.parametrize("action", ["velocity", "field", "controls"])
def test_gymnasium_checks_the_registered_environments(action):
    name = {"velocity": "Swarm", "field": "SwarmField", "controls": "SwarmControls"}[action]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # That a Box without bounds may not be what one wants is only a hint.
        warnings.filterwarnings("ignore", message=".*(infinity|different from the unwrapped).*")
        env = gymnasium.make(f"skein:Skein/{name}-v0", duration_s=20)
        check_env(env.unwrapped)
    assert env.unwrapped.env.action == action
    assert isinstance(env.unwrapped, SwarmEnv) and env.spec.kwargs["duration_s"] == 20


def test_registered_ids_take_the_settings_and_end_their_episodes():
    env = gymnasium.make("Skein/Swarm-v0", scenario="flock", duration_s=2, neighbours=2)
    assert env.unwrapped.env.neighbours == 2 and len(env.unwrapped.env.observation_names) == 22
    env.reset(seed=0)
    steps, truncated = 0, False
    while not truncated:
        *_, truncated, _ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        steps += 1
    assert steps == 20
    limited = gymnasium.make("Skein/Swarm-v0", max_episode_steps=3, **SHORT)
    limited.reset(seed=0)
    assert [limited.step(np.zeros((4, 3), dtype=np.float32))[3] for _ in range(3)] == [False, False, True]
    many = gymnasium.make_vec("Skein/Swarm-v0", num_envs=3, **SHORT)
    assert isinstance(many, SwarmVectorEnv) and many.num_envs == 3
    with pytest.raises(skein.ArgumentError, match="duration_s"):
        gymnasium.make_vec("Skein/Swarm-v0", num_envs=3, max_episode_steps=3)
    with pytest.raises(UnsupportedMode, match="render_mode"):
        gymnasium.make("Skein/Swarm-v0", render_mode="ansi", disable_env_checker=True)


def test_the_environment_has_what_stable_baselines_requires():
    """The rules of its ``check_env`` and of its vector environments, after the two wrappers of the book."""
    env = gymnasium.make("skein:Skein/Swarm-v0", duration_s=3)
    env = RescaleAction(FlattenObservation(env), np.float32(-1.0), np.float32(1.0))
    for space in (env.observation_space, env.action_space):
        assert isinstance(space, gymnasium.spaces.Box) and space.dtype == np.float32
    assert len(env.observation_space.shape) == 1
    assert (env.action_space.low == -1).all() and (env.action_space.high == 1).all()
    observation, info = env.reset(seed=0)
    assert type(observation) is np.ndarray and observation in env.observation_space and isinstance(info, dict)
    env.action_space.seed(0)
    ended = False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert type(observation) is np.ndarray and observation.dtype == np.float32 and np.isfinite(observation).all()
        assert observation in env.observation_space
        assert type(reward) is float and type(terminated) is bool and type(truncated) is bool and type(info) is dict
        ended = terminated or truncated
    # Its vector environments reset at once, seed only the first reset, and read attributes through the wrappers.
    env.reset()
    assert env.get_wrapper_attr("render_mode") is None and env.unwrapped.metadata["render_modes"] == []
    assert pickle.loads(pickle.dumps(env.spec)).kwargs == env.spec.kwargs


def test_pettingzoo_checks_the_environment():
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(SwarmParallelEnv("hover", duration_s=2), num_cycles=60)
    parallel_seed_test(lambda: SwarmParallelEnv("hover", duration_s=2), num_cycles=60)
