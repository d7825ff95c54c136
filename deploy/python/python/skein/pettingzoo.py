"""One swarm as a ``ParallelEnv`` of `PettingZoo <https://pettingzoo.farama.org>`_ over :class:`skein.Env`.

Each vehicle is an agent, called ``vehicle_1`` and so on.
"""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

import numpy as np
from gymnasium.spaces import Box
from pettingzoo import ParallelEnv

from ._env import Env

__all__ = ["SwarmParallelEnv"]


class SwarmParallelEnv(ParallelEnv):
    """One swarm. The arguments are those of :class:`skein.Env`, without ``worlds``; all vehicles end together."""

    metadata = {"name": "skein_swarm_v0", "render_modes": []}
    render_mode = None

    def __init__(self, scenario: Any = None, **settings: Any) -> None:
        self.env = Env(scenario, worlds=1, **settings)
        self.possible_agents = [f"vehicle_{nth + 1}" for nth in range(self.env.vehicles)]
        self.agents = []
        low, high = self.env.action_bounds
        features = len(self.env.observation_names)
        self.observation_spaces = {
            agent: Box(-np.inf, np.inf, (features,), dtype=np.float64) for agent in self.possible_agents
        }
        self.action_spaces = {agent: Box(low, high, dtype=np.float64) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Box:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        return self.action_spaces[agent]

    def reset(
        self, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[Dict[str, np.ndarray], Dict[str, Dict[str, Any]]]:
        observations, _ = self.env.reset(seed)
        self.agents = list(self.possible_agents)
        return self._of_each(observations[0]), self._infos()

    def step(self, actions: Dict[str, np.ndarray]) -> Tuple[Dict[str, Any], ...]:
        if not self.agents:
            return {}, {}, {}, {}, {}
        together = np.stack([np.asarray(actions[agent], dtype=np.float64) for agent in self.possible_agents])
        observations, rewards, terminated, truncated, _ = self.env.step(together[np.newaxis])
        of_each, infos = self._of_each(observations[0]), self._infos()
        rewarded = {agent: float(reward) for agent, reward in zip(self.agents, rewards[0])}
        ended = {agent: bool(terminated[0]) for agent in self.agents}
        cut = {agent: bool(truncated[0]) for agent in self.agents}
        if terminated[0] or truncated[0]:
            self.agents = []
        return of_each, rewarded, ended, cut, infos

    def _of_each(self, observations: np.ndarray) -> Dict[str, np.ndarray]:
        return {agent: row.copy() for agent, row in zip(self.possible_agents, observations)}

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
