"""Skein: decentralised helicopter swarms, for people who know numpy, pandas and Gymnasium.

==========================  =====================================================================
:func:`study`               flies a scenario many times in virtual time and gives a frame
:func:`load`                reads what ``skein study`` or ``skein fly`` wrote
:func:`compare`             judges one study against another, figure by figure
:func:`recording`           reads a recorded flight as frames
:mod:`skein.plot`           draws tracks, distances and sweeps
:class:`Law`                a formation law of your own, in Python
:func:`fly`                 flies in real time by the program ``skein``
:class:`Env`                steps many swarms at once, for learning
:mod:`skein.gym`            the same as environments of Gymnasium, one swarm or many
:mod:`skein.pettingzoo`     one swarm as a ``ParallelEnv`` of PettingZoo
==========================  =====================================================================

Units end the names of numbers (``_m``, ``_m_s``, ``_rad``). Frames are north, east, down about the scenario's origin.
"""

from ._env import Env, default_reward
from ._errors import ArgumentError, NotFoundError, ScenarioError, SkeinError
from ._fly import fly, program
from ._laws import Field, Goal, Law, Observation, Own, Peer, Setup, Velocity
from ._recording import Recording, recording
from ._skein import __version__
from ._study import Study, compare, figures, load, study

__all__ = [
    "ArgumentError",
    "Env",
    "Field",
    "Goal",
    "Law",
    "NotFoundError",
    "Observation",
    "Own",
    "Peer",
    "Recording",
    "ScenarioError",
    "Setup",
    "SkeinError",
    "Study",
    "Velocity",
    "__version__",
    "compare",
    "default_reward",
    "figures",
    "fly",
    "load",
    "program",
    "recording",
    "study",
]


def _register() -> None:
    """Registers the environments of :mod:`skein.gym`, if Gymnasium is installed."""
    try:
        import gymnasium
    except ImportError:
        return
    # The environment itself ends an episode, after duration_s: no fixed number of steps holds for every scenario.
    kinds = {"Swarm": {}, "SwarmField": {"action": "field"}, "SwarmControls": {"action": "controls", "warm_up_s": 15.0}}
    for name, kwargs in kinds.items():
        if f"Skein/{name}-v0" not in gymnasium.registry:
            gymnasium.register(
                f"Skein/{name}-v0",
                entry_point="skein.gym:SwarmEnv",
                vector_entry_point="skein.gym:SwarmVectorEnv",
                kwargs=kwargs,
            )


_register()
