"""Formation laws in Python: the same class flies in a study, in real time, and in a unit test."""

from __future__ import annotations

import inspect
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Type, Union

import numpy as np

from . import _check
from ._errors import ArgumentError
from ._keys import sets

__all__ = ["Field", "Goal", "Law", "Observation", "Own", "Peer", "Setup", "Velocity"]

Vector = Union[Sequence[float], np.ndarray]


@dataclass
class Setup:
    """What a law knows before its first observation: the ``hello`` of the protocol of external laws.

    Every entry has a default, so that a test writes only what matters to it.
    """

    #: Id of the vehicle whose law this is.
    vehicle: int = 1
    #: Ids of the whole swarm, in order.
    ids: List[int] = field(default_factory=lambda: [1])
    #: For the law's own random numbers; different for each vehicle and run.
    seed: int = 0
    #: Scenario and seed, such as ``"hover/1"``.
    run: str = "test/0"
    #: ``"virtual"``: the swarm waits for every answer; ``"real"``: it does not wait.
    time: str = "virtual"
    #: Time between two observations, s.
    period_s: float = 0.1
    #: A faster velocity is cut to this speed, m/s.
    max_speed_m_s: float = 5.0
    #: The scenario's table ``formation.external.parameters``.
    parameters: Dict[str, Any] = field(default_factory=dict)
    #: Version of the protocol.
    protocol: int = 1

    @classmethod
    def _of(cls, hello: Mapping[str, Any]) -> "Setup":
        return cls(**{name: hello[name] for name in cls.__dataclass_fields__ if name in hello})


@dataclass
class Own:
    """The vehicle's own estimate of itself, in metres north, east, down of the scenario's origin."""

    #: Position, shape (3,), m.
    position_ned_m: np.ndarray
    #: Velocity over the ground, shape (3,), m/s.
    velocity_ned_m_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    #: Heading, clockwise from north, rad.
    heading_rad: float = 0.0
    #: Age of the estimate, s.
    age_s: float = 0.0


@dataclass
class Peer:
    """The last state of another live member."""

    #: Its id.
    id: int
    #: Position carried forward to now, shape (3,), m.
    position_ned_m: np.ndarray
    #: Velocity as last received, shape (3,), m/s.
    velocity_ned_m_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    #: Heading as last received, clockwise from north, rad.
    heading_rad: float = 0.0
    #: Age of the state, s.
    age_s: float = 0.0
    #: Whether the state is fresh, not stale.
    fresh: bool = True


@dataclass
class Goal:
    """Where the formation is and how large it is."""

    #: Centre at the altitude at which this vehicle is to fly, shape (3,), m.
    centre_ned_m: np.ndarray
    #: Radius R* of the formation, m.
    radius_m: float = 100.0
    #: Velocity of the centre, shape (3,), m/s.
    centre_velocity_ned_m_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    #: Heading of the ellipse's first axis, clockwise from north, rad.
    heading_rad: float = 0.0
    #: Squared ratio of the semi-axes; 1 is a circle.
    gamma: float = 1.0
    #: Step of the mission, counted from 0.
    step: int = 0


@dataclass
class Observation:
    """What a law observes of its vehicle, of the peers and of the goal: the ``ask`` of the protocol of external laws.

    Examples
    --------
    >>> import skein
    >>> observation = skein.Observation(own=skein.Own([30, 0, -30]), goal=skein.Goal([0, 0, -30], radius_m=40))
    >>> observation.own.position_ned_m - observation.goal.centre_ned_m
    array([30.,  0.,  0.])
    """

    own: Own
    goal: Goal
    #: The other live members, by id.
    peers: List[Peer] = field(default_factory=list)
    #: Id of this vehicle.
    vehicle: int = 1
    #: Number of the observation, from 0.
    tick: int = 0
    #: The vehicle's own simulator time, s.
    time_s: float = 0.0
    #: Time since the last observation, s; 0 in the first.
    dt_s: float = 0.0

    def __post_init__(self) -> None:
        for name, part, kind in (("own", self.own, Own), ("goal", self.goal, Goal), *(("peers", one, Peer) for one in self.peers)):
            if not isinstance(part, kind):
                _check.wrong(name, part, f"a skein.{kind.__name__} is wanted")
        for part, names in ((self.own, _POINTS), (self.goal, _CENTRE), *((peer, _POINTS) for peer in self.peers)):
            for name in names:
                value = getattr(part, name)
                if not isinstance(value, np.ndarray):
                    value = _vector(name, value)
                    setattr(part, name, value)
                if value.shape != (3,):
                    raise ArgumentError(f"{name} of shape {value.shape}: three numbers are wanted, north, east, down")

    @classmethod
    def _of(cls, parts: Sequence[Any]) -> "Observation":
        """From the nested lists of the extension module."""
        vehicle, tick, time_s, dt_s, own, peers, goal = parts
        step, centre, centre_velocity, heading, radius, gamma = goal
        array = np.array
        return cls(
            Own(array(own[0]), array(own[1]), own[2], own[3]),
            Goal(array(centre), radius, array(centre_velocity), heading, gamma, step),
            [Peer(peer[0], array(peer[1]), array(peer[2]), *peer[3:]) for peer in peers],
            vehicle,
            tick,
            time_s,
            dt_s,
        )

    def features(self, neighbours: int) -> np.ndarray:
        """The observation as :class:`skein.Env` gives it with the actions ``"velocity"`` and ``"field"``, bit for bit.

        Parameters
        ----------
        neighbours : int
            Number of neighbours, the nearest first; :attr:`skein.Env.neighbours` in training.

        Returns
        -------
        array of shape (features,)
            :attr:`skein.Env.observation_names` names the features.
        """
        neighbours = _check.count("neighbours", neighbours, least=0)
        own, goal = self.own, self.goal
        features = np.zeros(8 + 7 * neighbours)
        features[0:3] = own.position_ned_m - goal.centre_ned_m
        features[3:6] = own.velocity_ned_m_s - goal.centre_velocity_ned_m_s
        features[6:8] = own.heading_rad, goal.radius_m
        apart = []
        for peer in self.peers:
            away = peer.position_ned_m - own.position_ned_m
            apart.append((away[0] * away[0] + away[1] * away[1] + away[2] * away[2], away, peer))
        apart.sort(key=lambda one: one[0])
        for nth, (_, away, peer) in enumerate(apart[:neighbours]):
            start = 8 + 7 * nth
            features[start] = 1.0
            features[start + 1 : start + 4] = away
            features[start + 4 : start + 7] = peer.velocity_ned_m_s - own.velocity_ned_m_s
        return features

    @classmethod
    def from_json(cls, ask: Mapping[str, Any]) -> "Observation":
        """From an ``ask`` of the protocol of external laws, for example one that was written to a log."""
        try:
            return cls(
                own=Own(**ask["own"]),
                goal=Goal(**ask["goal"]),
                peers=[Peer(**peer) for peer in ask["peers"]],
                vehicle=ask["vehicle"],
                tick=ask["tick"],
                time_s=ask["time_s"],
                dt_s=ask["dt_s"],
            )
        except (KeyError, TypeError) as error:
            wanted = f"not an `ask` of the protocol of external laws ({type(error).__name__}: {error})"
            raise ArgumentError(f"ask: {wanted}; it is a mapping as Observation.to_json gives it") from None

    def to_json(self) -> Dict[str, Any]:
        """As an ``ask`` of the protocol of external laws, in lists and numbers."""

        def plain(part: Any) -> Dict[str, Any]:
            return {key: value.tolist() if hasattr(value, "tolist") else value for key, value in vars(part).items()}

        return {
            "say": "ask",
            **{name: getattr(self, name) for name in ("vehicle", "tick", "time_s", "dt_s")},
            "own": plain(self.own),
            "peers": [plain(peer) for peer in self.peers],
            "goal": plain(self.goal),
        }


_POINTS = ("position_ned_m", "velocity_ned_m_s")
_CENTRE = ("centre_ned_m", "centre_velocity_ned_m_s")


@dataclass
class _Answer:
    """What every answer may have besides its numbers."""

    #: Where the nose is to point, clockwise from north, rad; ``None`` leaves it to the mission.
    heading_rad: Optional[float] = None
    #: Whether the vehicle is in place; ``None`` leaves that to the agent: within the radius of the centre, and slow.
    reached: Optional[bool] = None
    #: Up to 16 named numbers for the recording.
    log: Optional[Mapping[str, float]] = None


class Velocity(_Answer):
    """A velocity over the ground, in m/s north, east and down: ``Velocity(1, 0, 0)`` or ``Velocity(array)``."""

    _key = "velocity_ned_m_s"

    def __init__(
        self,
        north: Union[float, Vector],
        east: Optional[float] = None,
        down: Optional[float] = None,
        *,
        heading_rad: Optional[float] = None,
        reached: Optional[bool] = None,
        log: Optional[Mapping[str, float]] = None,
    ) -> None:
        super().__init__(heading_rad, reached, log)
        self.numbers = _numbers("a velocity", (north, east, down))


class Field(_Answer):
    """A field without a unit, north and east, flown through the scenario's ``conversion`` at the goal's altitude."""

    _key = "field_ne"

    def __init__(
        self,
        north: Union[float, Vector],
        east: Optional[float] = None,
        *,
        heading_rad: Optional[float] = None,
        reached: Optional[bool] = None,
        log: Optional[Mapping[str, float]] = None,
    ) -> None:
        super().__init__(heading_rad, reached, log)
        self.numbers = _numbers("a field", (north, east))


def _numbers(what: str, given: Tuple[Any, ...]) -> List[float]:
    parts = given if given[1] is not None else given[0]
    try:
        numbers = [float(number) for number in parts]
    except (TypeError, ValueError):
        _check.wrong(what, parts, f"{len(given)} numbers are wanted, one by one or as an array")
    if isinstance(parts, str) or len(numbers) != len(given):
        _check.wrong(what, parts, f"{len(given)} numbers are wanted, not {len(numbers)}")
    return numbers


def _vector(name: str, value: Any) -> np.ndarray:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        _check.wrong(name, value, "three numbers are wanted, north, east, down")


class Law:
    """A formation law: one object for each vehicle, made anew for each run.

    Write a subclass with a method :meth:`answer`. It needs no swarm to be tested, because a :class:`Setup` and an
    :class:`Observation` can be made by hand.

    Parameters
    ----------
    setup : Setup
        What the law knows before its first observation. It is kept as ``self.setup``.

    Examples
    --------
    >>> import skein
    >>> class Gather(skein.Law):
    ...     def answer(self, observation):
    ...         gain = self.setup.parameters.get("gain", 0.1)
    ...         return skein.Velocity(gain * (observation.goal.centre_ned_m - observation.own.position_ned_m))
    >>> law = Gather(skein.Setup(parameters={"gain": 0.5}))
    >>> law.answer(skein.Observation(own=skein.Own([10, 0, -30]), goal=skein.Goal([0, 0, -30]))).numbers
    [-5.0, 0.0, 0.0]
    """

    def __init__(self, setup: Optional[Setup] = None) -> None:
        if setup is not None and not isinstance(setup, Setup):
            _check.wrong("setup", setup, 'a skein.Setup is wanted, such as skein.Setup(parameters={"gain": 0.5})')
        self.setup = setup if setup is not None else Setup()

    def answer(self, observation: Observation) -> Union[Velocity, Field]:
        """The velocity or field that the vehicle is to fly until the next answer."""
        raise NotImplementedError(f"{type(self).__name__} has no method answer")


class _Maker:
    """Makes laws of one class for the extension module."""

    def __init__(self, law: Type[Law]) -> None:
        if not (isinstance(law, type) and issubclass(law, Law)):
            _check.wrong("law", law, "a law is a subclass of skein.Law: the class, not an object of it")
        self.law = law

    def __call__(self, hello: str) -> Law:
        return self.law(Setup._of(json.loads(hello)))


def _ask(law: Law, parts: Sequence[Any]) -> Tuple[Any, ...]:
    """Asks a law for the extension module."""
    answer = law.answer(Observation._of(parts))
    if not isinstance(answer, _Answer):
        raise TypeError(f"{type(law).__name__}.answer gives a skein.Velocity or a skein.Field, not {answer!r}")
    return _plain(answer)


def _plain(answer: _Answer) -> Tuple[Any, ...]:
    try:
        heading = None if answer.heading_rad is None else float(answer.heading_rad)
        reached = None if answer.reached is None else bool(answer.reached)
        log = None if answer.log is None else {str(name): float(value) for name, value in answer.log.items()}
    except (AttributeError, TypeError, ValueError) as error:
        wanted = "heading_rad is a number, reached True or False, and log a mapping of names to numbers"
        raise ArgumentError(f"the law's answer: {wanted}, each or None ({error})") from None
    return answer.numbers, heading, reached, log


def law_spec(law: Type[Law]) -> str:
    """``module:Class`` or ``file.py:Class``, from which another process imports a law."""
    module = sys.modules.get(law.__module__)
    path = getattr(module, "__file__", None)
    if law.__module__ == "__main__" or path is not None and "site-packages" not in path:
        try:
            path = inspect.getsourcefile(law)
        except (OSError, TypeError):
            path = None
        if path is None or not Path(path).is_file():
            return f"__main__:{law.__qualname__}"
        return f"{Path(path).resolve()}:{law.__qualname__}"
    return f"{law.__module__}:{law.__qualname__}"


def law_command(law: Type[Law]) -> List[str]:
    """The command that serves a law as a program of its own, for ``formation.external.command``."""
    return [sys.executable, "-m", "skein._serve", law_spec(law)]


def law_sets(law: Optional[Type[Law]], parameters: Optional[Mapping[str, Any]]) -> List[str]:
    """The keys that make a scenario fly this law."""
    keys: Dict[str, Any] = {}
    if law is not None:
        _Maker(law)
        keys["formation.law"] = "external"
        keys["formation.external.command"] = law_command(law)
    if parameters is not None:
        keys["formation.external.parameters"] = _check.mapping("parameters", parameters, '{"gain": 0.5}')
    return sets(keys, "parameters")
