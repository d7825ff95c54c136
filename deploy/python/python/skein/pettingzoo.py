"""One swarm as a ``ParallelEnv`` of `PettingZoo <https://pettingzoo.farama.org>`_ over :class:`skein.Env`.

Each vehicle is an agent, called ``vehicle_1`` and so on.
"""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

import numpy as np

try:
    from gymnasium.spaces import Box
    from pettingzoo import ParallelEnv
except ImportError as error:
    needs = "skein.pettingzoo needs pettingzoo and gymnasium"
    raise ImportError(f"{needs}: pip install skein-swarm[pettingzoo] ({error})") from None

from . import _check
from ._env import Env
from ._errors import ArgumentError
from ._worlds import Lifecycle, WrongAction, action_into, bounds, check_mode, check_options, draw, generator, check_settings

__all__ = ["SwarmParallelEnv"]


class SwarmParallelEnv(Lifecycle, ParallelEnv):
    """One swarm. The arguments are those of :class:`skein.Env`, without ``worlds``; all vehicles end together.

    Each flight has a seed of its own, drawn from a generator that ``reset(seed=...)`` seeds; it is ``infos[agent]["seed"]``
    of the reset. ``options`` have no effect.
    """

    metadata = {"name": "skein_swarm_v0", "render_modes": []}
    render_mode = None

    def __init__(self, scenario: Any = None, *, render_mode: None = None, **settings: Any) -> None:
        check_mode(render_mode)
        check_settings(settings, "SwarmParallelEnv is one world; skein.gym.SwarmVectorEnv has many, num_envs")
        self.env = Env(scenario, worlds=1, **settings)
        if self.env.action is None:
            raise ArgumentError("action=None: agents need actions, 'velocity', 'field' or 'controls'; skein.Env flies without")
        self.possible_agents = [f"vehicle_{nth + 1}" for nth in range(self.env.vehicles)]
        self.agents = []
        low, high = (bound.astype(np.float32) for bound in self.env.action_bounds)
        features = len(self.env.observation_names)
        self.observation_spaces = {
            agent: Box(-np.inf, np.inf, (features,), dtype=np.float32) for agent in self.possible_agents
        }
        self.action_spaces = {agent: Box(low, high, dtype=np.float32) for agent in self.possible_agents}
        self._bounds = bounds(self.action_spaces[self.possible_agents[0]])
        self._actions = np.zeros(self.env.actions.shape[1:])
        self._generator: Optional[np.random.Generator] = None

    def observation_space(self, agent: str) -> Box:
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> Box:
        return self.action_spaces[self._known(agent)]

    def reset(
        self, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[Dict[str, np.ndarray], Dict[str, Dict[str, Any]]]:
        self._check_open("reset")
        check_options(options)
        if seed is not None or self._generator is None:
            self._generator, _ = generator(seed)
        world = draw(self._generator)
        self.env.reset(world)
        self._is_over = False
        self.agents = list(self.possible_agents)
        return self._observations(), {agent: {**info, "seed": world} for agent, info in self._infos().items()}

    def step(self, actions: Dict[str, np.ndarray]) -> Tuple[Dict[str, Any], ...]:
        self._check_step()
        self._take(actions)
        _, rewards, terminated, truncated, _ = self.env.step(self._actions[np.newaxis])
        of_each, infos = self._observations(), self._infos()
        rewarded = {agent: float(reward) for agent, reward in zip(self.agents, rewards[0])}
        ended = {agent: bool(terminated[0]) for agent in self.agents}
        cut = {agent: bool(truncated[0]) for agent in self.agents}
        self._is_over = bool(terminated[0] or truncated[0])
        if self._is_over:
            self.agents = []
        return of_each, rewarded, ended, cut, infos

    def close(self) -> None:
        """Frees the world. A second call has no effect."""
        self._is_closed = True
        self.agents = []
        self.env = None  # type: ignore[assignment]

    def _take(self, actions: Any) -> None:
        """Writes the actions of all agents into one array."""
        if not isinstance(actions, dict):
            raise WrongAction(f"actions: a dict with the action of each agent is wanted, not a {type(actions).__name__}")
        for agent in actions:
            if agent not in self.agents:
                raise WrongAction(f"actions: there is no agent {agent!r}; {_check.meant(str(agent), self.agents)}")
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise WrongAction(f"actions: the action of {', '.join(missing)} is missing; every agent acts in every step")
        for agent, out in zip(self.agents, self._actions):
            action_into(f"actions[{agent!r}]", actions[agent], out.shape, self.env.action_names, out, self._bounds)

    def _known(self, agent: Any) -> Any:
        if agent not in self.possible_agents:
            _check.unknown(str(agent), "there is no such agent", self.possible_agents)
        return agent

    def _observations(self) -> Dict[str, np.ndarray]:
        rows = self.env.observations[0].astype(np.float32)
        return {agent: row.copy() for agent, row in zip(self.possible_agents, rows)}

    def _infos(self) -> Dict[str, Dict[str, Any]]:
        env = self.env
        return {
            agent: {
                "position_ned_m": env.position_ned_m[0, nth].copy(),
                "velocity_ned_m_s": env.velocity_ned_m_s[0, nth].copy(),
                "separation_m": float(env.separation_m[0, nth]),
                "crashed": bool(env.crashed[0, nth]),
            }
            for nth, agent in enumerate(self.possible_agents)
        }
