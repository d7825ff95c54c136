"""Environments of `Gymnasium <https://gymnasium.farama.org>`_ over :class:`skein.Env`.

The whole swarm is one agent here: an observation has the shape (vehicles, features), an action (vehicles, numbers), and
the reward is the mean over the vehicles. ``import skein`` registers them as ``Skein/Swarm-v0``.
"""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Sequence, Tuple, Union

import numpy as np

try:
    import gymnasium
    from gymnasium.error import ResetNeeded
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise ImportError(f"skein.gym needs gymnasium 1.1 or later: pip install skein-swarm[gym] ({error})") from None

from . import _check
from ._env import MOST_WORLDS, Env
from ._errors import ArgumentError
from ._worlds import Lifecycle, action_into, bounds, check_mode, check_options, draw, generator, check_settings

__all__ = ["SwarmEnv", "SwarmVectorEnv"]


def _spaces(env: Env) -> Tuple[Box, Box]:
    if env.action is None:
        raise ArgumentError(
            "action=None: an environment of Gymnasium needs actions, 'velocity', 'field' or 'controls'; skein.Env flies "
            "the scenario's own law"
        )
    low, high = (np.broadcast_to(bound, (env.vehicles, bound.size)).astype(np.float32) for bound in env.action_bounds)
    observation = Box(-np.inf, np.inf, (env.vehicles, len(env.observation_names)), dtype=np.float32)
    return observation, Box(low, high, dtype=np.float32)


class SwarmVectorEnv(Lifecycle, VectorEnv):
    """Many swarms as a vector environment. The arguments are those of :class:`skein.Env`, with ``num_envs`` for ``worlds``.

    A world that is over begins anew in the next step (``AutoresetMode.NEXT_STEP``). Every world has a generator of its own,
    from which the seeds of its flights are drawn: with ``reset(seed=n)`` the worlds fly what as many :class:`SwarmEnv` in a
    ``gymnasium.vector.SyncVectorEnv`` fly. The seeds of flights that begin are ``info["seed"]``.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
    render_mode = None

    def __init__(self, scenario: Any = None, *, num_envs: int = 64, render_mode: None = None, **settings: Any) -> None:
        check_mode(render_mode)
        check_settings(settings, "a vector environment calls them num_envs")
        self.num_envs = _check.count("num_envs", num_envs, most=MOST_WORLDS)
        self.env = Env(scenario, worlds=self.num_envs, **settings)
        self.single_observation_space, self.single_action_space = _spaces(self.env)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._bounds = bounds(self.single_action_space)
        self._actions = np.zeros_like(self.env.actions)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        self._begun = np.zeros(self.num_envs, dtype=bool)
        self._generators: List[Any] = [None] * self.num_envs

    @property
    def np_random(self) -> Tuple[np.random.Generator, ...]:
        """The generator of each world."""
        return tuple(self._generator(nth)[0] for nth in range(self.num_envs))

    @property
    def np_random_seed(self) -> Tuple[int, ...]:
        """The seed of each world's generator."""
        return tuple(self._generator(nth)[1] for nth in range(self.num_envs))

    def _generator(self, nth: int) -> Any:
        if self._generators[nth] is None:
            self._generators[nth] = generator(None)
        return self._generators[nth]

    def reset(
        self, *, seed: Union[int, Sequence[Optional[int]], None] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[np.ndarray, Dict[str, Any]]:
        """Begins new flights.

        Parameters
        ----------
        seed : int or sequence, optional
            Seeds the generator of the first world, and those of the others with the numbers that follow; or a number, or
            ``None``, for each world. Without it the generators draw on.
        options : dict, optional
            ``{"reset_mask": array}`` names the worlds that begin.
        """
        self._check_open("reset")
        check_options(options)
        begins = np.ones(self.num_envs, dtype=bool)
        if options and "reset_mask" in options:
            begins = self._mask(options["reset_mask"])
        for nth, each in enumerate(self._seeds(seed)):
            if each is not None and begins[nth]:
                self._generators[nth] = generator(each)
        self._begin(begins)
        self._begun |= begins
        return self._observations(), self._info(begins, begins)

    def step(self, actions: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Dict[str, Any]]:
        self._check_open("step")
        if not self._begun.all():
            raise ResetNeeded("Cannot call env.step() before calling env.reset()")
        begins = self._ended.copy()
        action_into(
            "actions", actions, self._actions.shape, self.env.action_names, self._actions, self._bounds, skipped=begins
        )
        rewards, (terminated, truncated) = np.zeros(self.num_envs), np.zeros((2, self.num_envs), dtype=bool)
        if not begins.all():
            _, of_each, terminated, truncated, _ = self.env.step(self._actions)
            rewards = of_each.mean(axis=1)
        if begins.any():
            self._begin(begins)
            rewards[begins], terminated[begins], truncated[begins] = 0.0, False, False
        self._ended = terminated | truncated
        return self._observations(), rewards, terminated, truncated, self._info(np.ones_like(begins), begins)

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the worlds."""
        self._is_closed = True
        self.env = None  # type: ignore[assignment]

    def _begin(self, begins: np.ndarray) -> None:
        self.env.reset([draw(self._generator(nth)[0]) for nth in np.flatnonzero(begins)], worlds=begins)
        self._ended[begins] = False

    def _observations(self) -> np.ndarray:
        return self.env.observations.astype(np.float32)

    def _info(self, of: np.ndarray, begun: np.ndarray) -> Dict[str, Any]:
        """The arrays, each with a mask of the worlds that have an entry, as vector environments give them."""
        info: Dict[str, Any] = {}
        for name, array in self.env._info().items():
            info[name], info[f"_{name}"] = array.copy(), of.copy()
        if begun.any():
            info["seed"], info["_seed"] = np.where(begun, self.env.seeds.astype(np.int64), 0), begun.copy()
        return info

    def _seeds(self, seed: Any) -> List[Optional[int]]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (list, tuple, np.ndarray)) and np.ndim(seed) == 1:
            if len(seed) != self.num_envs:
                _check.wrong("seed", seed, f"has {len(seed)} entries, but there are {self.num_envs} worlds")
            return [None if each is None else _check.seed(each) for each in seed]
        first = _check.seed(seed)
        _check.seed(first + self.num_envs - 1)
        return list(range(first, first + self.num_envs))

    def _mask(self, mask: Any) -> np.ndarray:
        wanted = f"has to be an array of bool of shape ({self.num_envs},) with a True in it"
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            _check.wrong("options: reset_mask", mask, wanted)
        return mask


class SwarmEnv(Lifecycle, gymnasium.Env):
    """One swarm as an environment. The arguments are those of :class:`skein.Env`, without ``worlds``.

    Each flight has a seed of its own, which is drawn from :attr:`np_random` and is ``info["seed"]`` of the reset:
    ``skein.study(..., seeds=range(seed, seed + 1))`` flies the same world. ``options`` have no effect.
    """

    metadata: Dict[str, Any] = {"render_modes": []}
    render_mode = None

    def __init__(self, scenario: Any = None, *, render_mode: None = None, **settings: Any) -> None:
        check_mode(render_mode)
        check_settings(settings, "SwarmEnv is one world; SwarmVectorEnv has many, num_envs")
        self.env = Env(scenario, worlds=1, **settings)
        self.observation_space, self.action_space = _spaces(self.env)
        self._bounds = bounds(self.action_space)
        self._action = np.zeros(self.env.actions.shape[1:])

    def reset(
        self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[np.ndarray, Dict[str, Any]]:
        self._check_open("reset")
        check_options(options)
        super().reset(seed=None if seed is None else _check.seed(seed))
        world = draw(self.np_random)
        self.env.reset(world)
        self._is_over = False
        return self._observation(), {**self._info(), "seed": world}

    def step(self, action: np.ndarray) -> Tuple[np.ndarray, float, bool, bool, Dict[str, Any]]:
        self._check_step()
        action_into("action", action, self._action.shape, self.env.action_names, self._action, self._bounds)
        _, rewards, terminated, truncated, _ = self.env.step(self._action[np.newaxis])
        self._is_over = bool(terminated[0] or truncated[0])
        return self._observation(), float(rewards[0].mean()), bool(terminated[0]), bool(truncated[0]), self._info()

    def close(self) -> None:
        """Frees the world. A second call has no effect."""
        self._is_closed = True
        self.env = None  # type: ignore[assignment]

    def _observation(self) -> np.ndarray:
        return self.env.observations[0].astype(np.float32)

    def _info(self) -> Dict[str, Any]:
        return {name: array[0].copy() for name, array in self.env._info().items()}
