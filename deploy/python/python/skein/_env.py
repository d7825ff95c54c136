"""Many swarms at once, for learning."""

from __future__ import annotations

import json
import sys
from typing import Any, Callable, Dict, List, Mapping, NoReturn, Optional, Sequence, Tuple, Union

import numpy as np
import pandas as pd

from . import _check, _skein
from ._errors import ArgumentError, SkeinError
from ._keys import Scenario, scenario_path, sets
from ._tables import row_of_run

__all__ = ["Env", "default_reward"]

#: Below this distance a pair has collided, m.
COLLISION_M = 2.0
#: The largest number of an action, as in the protocol of external laws.
MOST_ACTION = 1e9
#: More worlds than a PC's memory holds.
MOST_WORLDS = 65_536

#: Names of the numbers of an action, of each kind of action.
ACTION_NAMES: Dict[Optional[str], List[str]] = {
    "velocity": ["velocity_north_m_s", "velocity_east_m_s", "velocity_down_m_s"],
    "field": ["field_north", "field_east"],
    "controls": ["roll", "pitch", "yaw", "collective"],
    None: [],
}


def default_reward(env: "Env") -> np.ndarray:
    """The reward of each vehicle: 0 on its circle at its altitude, less the farther it is away.

    Minus the distance from the circle of the formation and minus the error of the altitude, both as shares of the
    radius; minus 1 while another vehicle is nearer than 2 m, and minus 10 while the vehicle lies crashed.
    """
    if not isinstance(env, Env):
        _check.wrong("env", env, "a skein.Env is wanted; of an environment of skein.gym it is the attribute env")
    observed = env.observations
    radius_m = observed[..., env.column("radius_m")]
    from_centre_m = np.hypot(observed[..., env.column("north_m")], observed[..., env.column("east_m")])
    error = (np.abs(from_centre_m - radius_m) + np.abs(observed[..., env.column("down_m")])) / radius_m
    return -error - 1.0 * (env.separation_m < COLLISION_M) - 10.0 * env.crashed


def _numbers(given: Any) -> Optional[np.ndarray]:
    """The array, if it has real numbers."""
    try:
        array = np.asarray(given)
    except ValueError:  # rows of different lengths
        return None
    return array if array.dtype.kind in "fiu" else None


def checked_action(
    name: str, given: Any, shape: Tuple[int, ...], names: Sequence[str], out: np.ndarray, bounds: Any = None, skipped: Any = None
) -> None:
    """Writes actions into an array, after a check of their shape, of their numbers and of the bounds, if there are any.

    The last axis has the numbers of an action, which have these names, and the one before it the vehicles. Rows of skipped
    worlds are not checked.
    """
    axes = ("worlds", "vehicles", "numbers")[3 - len(shape) :]
    wanted = f"has to be an array of shape {shape}: {', '.join(axes)} ({', '.join(names)})"
    numbers = _numbers(given)
    if numbers is None:
        _check.wrong(name, given, wanted)
    if numbers.shape != shape:
        raise ArgumentError(f"{name} of shape {numbers.shape}: {wanted}")
    if skipped is not None:
        numbers = np.where(skipped[:, np.newaxis, np.newaxis], 0.0, numbers)
    low, high = bounds if bounds is not None else (-MOST_ACTION, MOST_ACTION)
    is_wrong = ~((numbers >= low) & (numbers <= high))
    if is_wrong.any():
        *place, nth = np.argwhere(is_wrong)[0]
        vehicle = f"of vehicle {place[-1] + 1}" if len(shape) > 1 else ""
        where = f"{name}: {names[nth]} {vehicle}{f' of world {place[0]}' if len(place) > 1 else ''}".rstrip()
        found = numbers[(*place, nth)]
        if not np.isfinite(found):
            raise ArgumentError(f"{where} is {found}, not finite: check what the policy gives")
        low, high = (float(np.broadcast_to(bound, shape)[(*place, nth)]) for bound in (low, high))
        raise ArgumentError(f"{where} is {found:g}, but lies within {low:g} to {high:g}: clip the action with np.clip")
    np.copyto(out, numbers)


def refuse_copy(env: Any) -> NoReturn:
    """Raises the error of an environment that is copied or pickled."""
    name = type(env).__name__
    raise ArgumentError(
        f"{name} cannot be copied or pickled: its worlds are in flight. Make another {name} with the same arguments, and begin "
        "the same flight in it with reset(seed=...); to a process of its own, send the function that makes it"
    )


class Env:
    """Steps many worlds of one scenario at once. A world is a whole swarm.

    All arrays are of numpy and made once: each :meth:`step` and :meth:`reset` fills the same ones in place, without a
    copy. Copy what you keep.

    Parameters
    ----------
    scenario : str or path, optional
        A scenario file, or the name of a shipped scenario. It is one swarm, not a fleet.
    worlds : int
        Number of worlds.
    action : {"velocity", "field", "controls", None}
        What an action is.

        ``"velocity"``
            In place of the law's answer: the velocity over the ground, north, east, down, m/s. The safety filter and the
            vehicle's own control follow. What :class:`skein.Velocity` is for a law.
        ``"field"``
            In place of the law's answer: the field, north and east, without a unit. What :class:`skein.Field` is.
        ``"controls"``
            In place of the vehicle's own control: roll, pitch, yaw (each -1 to 1) and collective (0 to 1).
        ``None``
            Nothing: the scenario's own law flies, with the same bits as in :func:`skein.study`.
    set : mapping, optional
        Keys of the scenario and their values. ``formation.external.period_s``, 0.1 s, is the length of a step.
    neighbours : int, optional
        Neighbours in an observation, the nearest first: as many as the swarm has other vehicles at most. Without it all
        others, at most 6.
    duration_s : float, optional
        Length of an episode, s; without it that of the scenario.
    warm_up_s : float
        The vehicles' own agents fly this long before the first observation, s. For ``"controls"``, which would begin on
        the ground without it.
    threads : int
        Threads that step the worlds. The results do not depend on it.
    reward : callable, optional
        Takes the environment and returns an array of shape (worlds, vehicles). Without it :func:`default_reward`.
    ends_on_crash : bool, optional
        Whether a crash of a vehicle ends the episode of its world; without it only with an action.

    Attributes
    ----------
    observations : array of float64, shape (worlds, vehicles, features)
        :attr:`observation_names` names the features. Positions are relative to the formation's centre at the altitude of
        the vehicle (``north_m``, ``east_m``, ``down_m``), velocities to the velocity of the centre; those of neighbours
        are relative to the vehicle. With the actions ``"velocity"`` and ``"field"`` they are what a law observes: the
        vehicle's own estimate, and the peers' states as received. Otherwise they are the ground truth.
    actions : array of float64, shape (worlds, vehicles, numbers)
        The last actions.
    position_ned_m, velocity_ned_m_s : arrays of float64, shape (worlds, vehicles, 3)
        The ground truth in the scenario's frame, m and m/s.
    separation_m : array of float64, shape (worlds, vehicles)
        True distance to the nearest other vehicle in the air, m; infinite on the ground.
    crashed : array of bool, shape (worlds, vehicles)
        Whether the vehicle has crashed.
    vehicles : int
        Vehicles of a world.
    step_s : float
        Length of a step, s.

    Examples
    --------
    >>> import skein
    >>> env = skein.Env("hover", worlds=3, action="velocity", duration_s=5)
    >>> observations, info = env.reset(seed=0)
    >>> observations.shape == (3, 4, len(env.observation_names))
    True
    >>> to_centre = -0.2 * observations[..., :3]
    >>> observations, rewards, terminated, truncated, info = env.step(to_centre)
    >>> rewards.shape, terminated.any()
    ((3, 4), np.False_)
    """

    def __init__(
        self,
        scenario: Scenario = None,
        *,
        worlds: int = 64,
        action: Optional[str] = "velocity",
        set: Optional[Mapping[str, Any]] = None,
        neighbours: Optional[int] = None,
        duration_s: Optional[float] = None,
        warm_up_s: float = 0.0,
        threads: int = 1,
        reward: Optional[Callable[["Env"], np.ndarray]] = None,
        ends_on_crash: Optional[bool] = None,
    ) -> None:
        _check.choice("action", action, ACTION_NAMES)
        self.worlds = _check.count("worlds", worlds, most=MOST_WORLDS)
        self._reward_of_user(reward)
        warm_up_s = _check.number("warm_up_s", warm_up_s)
        threads = _check.count("threads", threads, most=_check.MOST_THREADS)
        if neighbours is not None:
            neighbours = _check.count("neighbours", neighbours, least=0, most=2**31)
        if ends_on_crash is not None:
            ends_on_crash = _check.flag("ends_on_crash", ends_on_crash)
        keys: Dict[str, Any] = {}
        if action in ("velocity", "field"):
            # The actions answer: the program is never started.
            keys = {"formation.law": "external", "formation.external.command": [sys.executable]}
        if duration_s is not None:
            keys["duration_s"] = _check.number("duration_s", duration_s, above=0)
        self.action = action
        self.ends_on_crash = action is not None if ends_on_crash is None else ends_on_crash
        self._worlds = _skein.Worlds(
            {
                "scenario": scenario_path(scenario),
                "sets": sets(keys) + sets(set),
                "worlds": self.worlds,
                "action": action,
                "neighbours": neighbours,
                "warm_up_s": warm_up_s,
                "threads": threads,
            }
        )
        self.vehicles: int = self._worlds.vehicles
        self.neighbours: int = self._worlds.neighbours
        self.step_s: float = self._worlds.step_s
        self.observation_names: List[str] = _skein.observation_names(action, self.neighbours)
        self.action_names: List[str] = list(ACTION_NAMES[action])
        self._columns = {name: nth for nth, name in enumerate(self.observation_names)}
        shape = (self.worlds, self.vehicles)
        self.observations = np.zeros((*shape, len(self.observation_names)))
        self.actions = np.zeros((*shape, len(self.action_names)))
        self.position_ned_m = np.zeros((*shape, 3))
        self.velocity_ned_m_s = np.zeros((*shape, 3))
        self.separation_m = np.full(shape, np.inf)
        self.crashed = np.zeros(shape, dtype=bool)
        self._terminated = np.zeros(self.worlds, dtype=bool)
        self._truncated = np.zeros(self.worlds, dtype=bool)
        self._has_begun = np.zeros(self.worlds, dtype=bool)
        self._truths = {
            "position_ned_m": self.position_ned_m,
            "velocity_ned_m_s": self.velocity_ned_m_s,
            "separation_m": self.separation_m,
            "crashed": self.crashed,
            "terminated": self._terminated,
            "truncated": self._truncated,
        }
        self._next_seed: int = self._worlds.seed
        #: Seed of each world's flight.
        self.seeds = np.zeros(self.worlds, dtype=np.uint64)

    def _reward_of_user(self, reward: Any) -> None:
        wanted = "has to be a function that takes the environment and gives an array of shape (worlds, vehicles)"
        self.reward = default_reward if reward is None else _check.function("reward", reward, wanted)

    def column(self, name: str) -> int:
        """The place of a feature in an observation."""
        if not isinstance(name, str) or name not in self._columns:
            _check.unknown(str(name), "an observation has no such feature", self._columns)
        return self._columns[name]

    @property
    def action_bounds(self) -> Tuple[np.ndarray, np.ndarray]:
        """The least and the largest action, each of shape (numbers,). A velocity is cut to a speed besides."""
        if self.action == "velocity":
            most = np.full(3, self._worlds.max_speed_m_s)
            return -most, most
        if self.action == "controls":
            return np.array([-1.0, -1.0, -1.0, 0.0]), np.ones(4)
        return -np.ones(len(self.action_names)), np.ones(len(self.action_names))

    def reset(
        self,
        seed: Union[int, Sequence[int], None] = None,
        *,
        worlds: Optional[Sequence[bool]] = None,
    ) -> Tuple[np.ndarray, Dict[str, Any]]:
        """Begins new flights: all vehicles have joined, and their first observation is there.

        Parameters
        ----------
        seed : int or sequence, optional
            The seed of the first world, those of the next are the numbers that follow; or one for each world that
            begins. Without it the numbers that follow the last ones.
        worlds : sequence of bool, optional
            The worlds that begin; without it all.

        Returns
        -------
        observations, info
        """
        begins = np.ones(self.worlds, dtype=bool) if worlds is None else self._mask(worlds)
        count = int(begins.sum())
        if seed is None:
            # After the largest seed the first one.
            first = self._next_seed if self._next_seed + count <= _check.MOST_SEED + 1 else 0
            seeds = list(range(first, first + count))
        elif _check.is_whole(seed) or isinstance(seed, (str, bytes)) or not hasattr(seed, "__len__"):
            first = _check.seed(seed)
            if count:
                _check.seed(first + count - 1)
            seeds = list(range(first, first + count))
        else:
            if len(seed) != count:
                _check.wrong("seed", seed, f"{count} worlds begin, not {len(seed)}: give a seed for each, or one number for all")
            seeds = [_check.seed(each) for each in seed]
        if seeds:
            self._next_seed = seeds[-1] + 1
        self.seeds[begins] = seeds
        of_each = iter(seeds)
        wanted = [next(of_each) if begin else None for begin in begins]
        self.actions[begins] = 0.0
        self._has_begun |= begins
        self._worlds.reset(wanted, self.observations, self._truths)
        return self.observations, self._info()

    def step(
        self, actions: Optional[np.ndarray] = None
    ) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Dict[str, Any]]:
        """Flies all worlds for :attr:`step_s`. A world that is over stands still until it is reset.

        Parameters
        ----------
        actions : array of shape (worlds, vehicles, numbers)
            In the units of :attr:`action_names`; ``None`` with the action ``None``.

        Returns
        -------
        observations : array of shape (worlds, vehicles, features)
        rewards : array of shape (worlds, vehicles)
        terminated : array of bool, shape (worlds,)
            Whether the mission has finished or, if that ends an episode, a vehicle has crashed.
        truncated : array of bool, shape (worlds,)
            Whether the time is over.
        info : dict
            The arrays ``position_ned_m``, ``velocity_ned_m_s``, ``separation_m`` and ``crashed``.
        """
        if not self._has_begun.all():
            waiting = self.worlds - int(self._has_begun.sum())
            raise SkeinError(f"step before reset: {waiting} of {self.worlds} worlds have not begun; call reset() first")
        if self.action is None:
            if actions is not None:
                _check.wrong("actions", actions, "the scenario's own law flies this environment: call step() without actions")
        else:
            checked_action("actions", actions, self.actions.shape, self.action_names, self.actions)
        self._worlds.step(self.actions if self.action_names else None, self.observations, self._truths)
        terminated = self._terminated.copy()
        if self.ends_on_crash:
            terminated |= self.crashed.any(axis=1)
        rewards = self._rewards()
        return self.observations, rewards, terminated, self._truncated & ~terminated, self._info()

    def _rewards(self) -> np.ndarray:
        rewards = _numbers(self.reward(self))
        shape = (self.worlds, self.vehicles)
        if rewards is None or rewards.shape != shape:
            given = "no numbers" if rewards is None else f"an array of shape {rewards.shape}"
            raise ArgumentError(
                f"reward: the function gave {given}, but has to give one of shape {shape}: a number for each vehicle of each world"
            )
        return rewards.astype(np.float64)

    def _mask(self, worlds: Any) -> np.ndarray:
        wanted = f"has to be True or False for each of the {self.worlds} worlds, such as env.crashed.any(axis=1)"
        try:
            mask = np.asarray(worlds)
        except ValueError:
            _check.wrong("worlds", worlds, wanted)
        if mask.dtype != bool or mask.shape != (self.worlds,):
            _check.wrong("worlds", worlds, wanted)
        return mask

    def _info(self) -> Dict[str, Any]:
        return {name: self._truths[name] for name in ("position_ned_m", "velocity_ned_m_s", "separation_m", "crashed")}

    def figures(self) -> pd.DataFrame:
        """Ends all flights and gives what they measured: one row a world, as :attr:`skein.Study.runs` has one a run."""
        self._has_begun[:] = False
        texts = [self._worlds.report(nth) for nth in range(self.worlds)]
        return pd.DataFrame([row_of_run(json.loads(text)) for text in texts if text is not None])

    def __reduce_ex__(self, protocol: Any) -> Any:
        refuse_copy(self)

    def __repr__(self) -> str:
        return f"<skein.Env of {self.worlds} worlds with {self.vehicles} vehicles, action: {self.action}>"
