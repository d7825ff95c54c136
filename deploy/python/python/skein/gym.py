"""Environments of `Gymnasium <https://gymnasium.farama.org>`_ over :class:`skein.Env`.

The whole swarm is one agent here: an observation has the shape (vehicles, features), an action (vehicles, numbers), and
the reward is the mean over the vehicles.
"""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ._env import Env

__all__ = ["SwarmEnv", "SwarmVectorEnv"]


def _spaces(env: Env) -> Tuple[Box, Box]:
    low, high = (np.broadcast_to(bound, (env.vehicles, bound.size)) for bound in env.action_bounds)
    observation = Box(-np.inf, np.inf, (env.vehicles, len(env.observation_names)), dtype=np.float64)
    return observation, Box(low, high, dtype=np.float64)


class SwarmVectorEnv(VectorEnv):
    """Many swarms as a vector environment. The arguments are those of :class:`skein.Env`.

    A world that is over begins anew in the next step (``AutoresetMode.NEXT_STEP``), with the next seed.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
    render_mode = None

    def __init__(self, scenario: Any = None, *, num_envs: int = 64, **settings: Any) -> None:
        self.env = Env(scenario, worlds=num_envs, **settings)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _spaces(self.env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: Any = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[np.ndarray, Dict[str, Any]]:
        """Begins new flights; ``options={"reset_mask": array}`` names the worlds."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        mask = None if options is None else options.get("reset_mask")
        observations, info = self.env.reset(seed, worlds=mask)
        self._over[... if mask is None else np.asarray(mask, dtype=bool)] = False
        return observations.copy(), _copied(info)

    def step(self, actions: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Dict[str, Any]]:
        begins = self._over.copy()
        if begins.all():
            observations, info = self.env.reset(worlds=begins)
            rewards = np.zeros(self.num_envs)
            terminated, truncated = np.zeros((2, self.num_envs), dtype=bool)
        else:
            observations, rewards, terminated, truncated, info = self.env.step(actions)
            rewards = rewards.mean(axis=1)
            if begins.any():
                self.env.reset(worlds=begins)
                rewards[begins], terminated[begins], truncated[begins] = 0.0, False, False
        self._over = terminated | truncated
        return observations.copy(), rewards, terminated, truncated, _copied(info)

    def close_extras(self, **kwargs: Any) -> None:
        """Nothing is left open."""


def _copied(info: Dict[str, Any]) -> Dict[str, Any]:
    return {name: array.copy() for name, array in info.items()}


class SwarmEnv(gymnasium.Env):
    """One swarm as an environment. The arguments are those of :class:`skein.Env`, without ``worlds``."""

    metadata: Dict[str, Any] = {"render_modes": []}
    render_mode = None

    def __init__(self, scenario: Any = None, **settings: Any) -> None:
        self.env = Env(scenario, worlds=1, **settings)
        self.observation_space, self.action_space = _spaces(self.env)

    def reset(
        self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[np.ndarray, Dict[str, Any]]:
        super().reset(seed=seed)
        observations, info = self.env.reset(seed)
        return observations[0].copy(), {name: array[0].copy() for name, array in info.items()}

    def step(self, action: np.ndarray) -> Tuple[np.ndarray, float, bool, bool, Dict[str, Any]]:
        observations, rewards, terminated, truncated, info = self.env.step(np.asarray(action)[np.newaxis])
        info = {name: array[0].copy() for name, array in info.items()}
        return observations[0].copy(), float(rewards[0].mean()), bool(terminated[0]), bool(truncated[0]), info
