"""What the environments of Gymnasium and PettingZoo share: seeds of worlds, the order of calls, copies, rendering."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
from gymnasium.error import ClosedEnvironmentError, InvalidAction, ResetNeeded, UnsupportedMode
from gymnasium.utils.seeding import np_random

from . import _check
from ._env import checked_action, refuse_copy
from ._errors import ArgumentError

#: Seeds of worlds are drawn below this number, which every reader of JSON keeps to the last digit.
SEEDS = 2**53


class WrongAction(ArgumentError, InvalidAction):
    """An action that the space of actions does not contain."""


class WrongMode(ArgumentError, UnsupportedMode):
    """A render mode that the environment does not have."""


def draw(generator: np.random.Generator) -> int:
    """The seed of the next world."""
    return int(generator.integers(SEEDS))


def generator(seed: Optional[int]) -> Any:
    """A generator of seeds and its own seed, as ``gymnasium.utils.seeding.np_random`` makes them."""
    return np_random(None if seed is None else _check.seed(seed))


def action_into(name: str, given: Any, shape: Any, names: Any, out: np.ndarray, bounds: Any, skipped: Any = None) -> None:
    """Writes actions into an array; one that the space does not contain is an error."""
    try:
        checked_action(name, given, shape, names, out, bounds, skipped)
    except ArgumentError as error:
        raise WrongAction(str(error)) from None


def bounds(space: Any) -> Any:
    """The bounds of a space of actions, widened by what rounding to 32 bits may have cut off."""
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    return low - 1e-6 * np.abs(low), high + 1e-6 * np.abs(high)


class Lifecycle:
    """Refuses calls out of order, copies, and what an environment without pictures cannot do."""

    #: ``None`` before the first reset; whether the flight is over.
    _is_over: Optional[bool] = None
    _is_closed = False

    def _check_open(self, call: str) -> None:
        if self._is_closed:
            raise ClosedEnvironmentError(f"Cannot call env.{call}() after env.close(): make a new environment")

    def _check_step(self) -> None:
        self._check_open("step")
        if self._is_over is None:
            raise ResetNeeded("Cannot call env.step() before calling env.reset()")
        if self._is_over:
            raise ResetNeeded(
                "Cannot call env.step() after the flight has ended (terminated or truncated): call env.reset() first"
            )

    def render(self) -> None:
        """Draws nothing: ``render_mode`` is always ``None``."""
        self._check_open("render")

    def __reduce_ex__(self, protocol: Any) -> Any:
        refuse_copy(self)


def check_mode(render_mode: Any) -> None:
    """Refuses every render mode but ``None``."""
    if render_mode is not None:
        raise WrongMode(
            f"render_mode={render_mode!r}: the environment draws no pictures, so render_mode has to be None; skein.plot draws "
            "a flight with the seed of the world, info['seed'], that skein.study has flown"
        )


def check_options(options: Any) -> None:
    """Refuses options that are no mapping."""
    if options is not None and not isinstance(options, dict):
        _check.wrong("options", options, "has to be a dict or None")


def check_settings(settings: Any, worlds: str) -> None:
    """Refuses what is not among the settings of :class:`skein.Env` here: the number of worlds, and the length in steps."""
    if "worlds" in settings:
        raise ArgumentError(f"worlds={settings['worlds']!r}: {worlds}")
    if "max_episode_steps" in settings:
        raise ArgumentError(
            f"max_episode_steps={settings['max_episode_steps']!r}: give the length of an episode in seconds, such as "
            "duration_s=60"
        )
