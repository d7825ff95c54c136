"""Laws that the tests fly, in a file of their own, so that another process imports them."""

import importlib.util
from pathlib import Path

import numpy as np

import skein

RING = Path(__file__).parents[2] / "laws" / "ring.py"


def exact(numbers):
    """The numbers rounded to short ones: Skein's reader of JSON may miss the last bit of a long one."""
    return np.round(np.asarray(numbers) * 256.0) / 256.0


def _ring():
    spec = importlib.util.spec_from_file_location("ring", RING)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Ring(skein.Law):
    """The shipped law ``ring.py`` as a class."""

    ring = _ring()

    def answer(self, observation):
        answer = self.ring.answer(observation.to_json(), self.setup.parameters)
        return skein.Field(exact(answer["field_ne"]), reached=answer["reached"], log=answer["log"])


class Gather(skein.Law):
    """Every vehicle flies to the centre."""

    def answer(self, observation):
        gain = self.setup.parameters.get("gain", 0.1)
        away = observation.own.position_ned_m - observation.goal.centre_ned_m
        return skein.Velocity(exact(-gain * away), log={"away_m": float((away**2).sum() ** 0.5)})


class ByFeatures(skein.Law):
    """A linear law on the features that an environment observes."""

    neighbours = 3

    @staticmethod
    def velocity(features):
        # One operation after another, so that one row and many rows give the same bits.
        return -0.2 * features[..., 0:3] - 0.1 * features[..., 3:6] - 0.05 * features[..., 9:12]

    def answer(self, observation):
        return skein.Velocity(self.velocity(observation.features(self.neighbours)))


class ByExactFeatures(ByFeatures):
    """The same, rounded to short numbers."""

    @staticmethod
    def velocity(features):
        return exact(ByFeatures.velocity(features))
