"""Every wrong argument of every public function is a sentence: the argument, its value, and what to write instead."""

import io
import os
import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import skein
import skein.plot
from laws_of_tests import Gather

SHORT = {"duration_s": 5}
LARGE = 2**63


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A small study with a sweep, in a folder that stays."""
    out = tmp_path_factory.mktemp("swept") / "out"
    return skein.study("hover", seeds=2, set=SHORT, sweep={"network.loss": [0, 0.5]}, out=out, record=True)


@pytest.fixture(scope="module")
def flight(swept):
    return skein.recording(swept)


def refused(call, *parts):
    """The sentence of the error, which contains these parts."""
    with pytest.raises(skein.SkeinError) as caught:
        call()
    sentence = str(caught.value)
    assert all(part in sentence for part in parts), sentence
    assert not sentence.startswith(("'", '"')), "a KeyError would show its text in quotes"
    return caught.value


WRONG_KEYS = [
    ("a=b", 'set={"formation.radius_m": 50}'),
    (["a=b"], 'set={"formation.radius_m": 50}'),
    (3, "has to be a mapping"),
    ({3: 1}, "the key 3 is not a text"),
    ({"": 1}, "is not a text"),
    ({"formation.radius_m": None}, "set: formation.radius_m: a scenario key takes no NoneType"),
    ({"formation.radius_m": object()}, "takes no object: give a number, a text"),
    ({"formation.radius_m": b"50"}, "takes no bytes"),
    ({"formation.external.parameters": {1: 2}}, "the key 1 of a table is not a text"),
    ({"formation.raduis_m": 50}, "did you mean `formation.radius_m`?"),
    ({"formation.radius_m": -50}, "--set formation.radius_m=-50"),
]
WRONG_COUNTS = [0, -1, 1.5, 2.0, "2", True, [2], None, 10**12, float("nan"), np.float64(2)]
WRONG_FLAGS = [1, 0, "yes", None, []]
WRONG_PATHS = [3, "", ["out"], b"", True, 1.5]
WRONG_SEED = [-1, 1.0, "3", True, LARGE, [1], float("nan")]
WRONG_SCENARIOS = [3, "", ["hover"], True, {"scenario": "hover"}]


@pytest.mark.parametrize("call", [skein.study, skein.fly, skein.Env])
@pytest.mark.parametrize("value, part", WRONG_KEYS, ids=repr)
def test_wrong_keys(call, value, part):
    refused(lambda: call("hover", set=value), "set", part)


@pytest.mark.parametrize("call", [skein.study, skein.fly, skein.Env])
@pytest.mark.parametrize("value", WRONG_SCENARIOS, ids=repr)
def test_wrong_scenarios(call, value):
    refused(lambda: call(value), "scenario=", 'such as "hover"')


@pytest.mark.parametrize("call", [skein.study, skein.fly, skein.Env])
def test_a_misspelt_scenario_is_named_with_the_shipped_one(call):
    refused(lambda: call("hoover"), "hoover: ", "did you mean the shipped scenario hover?")


@pytest.mark.parametrize(
    "seeds, part",
    [
        ("0..3", "seeds='0..3': write seeds=range(0, 3)"),
        ("three", "seeds=20"),
        (0, "seeds=range(0, 20)"),
        (-3, "seeds=-3"),
        (1.5, "seeds=1.5"),
        (True, "seeds=True"),
        ([], "seeds=[]"),
        ([0, 2], "without gaps"),
        ([1.0, 2.0], "seeds="),
        (["0", "1"], "seeds="),
        (range(0), "without gaps"),
        (range(5, 3), "without gaps"),
        (range(0, 10, 2), "without gaps"),
        (range(-1, 3), "whole numbers from 0"),
        (range(LARGE - 1, LARGE + 1), "whole numbers from 0 to 9223372036854775807"),
        (10**12, "fly fewer seeds"),
        ({"seed": 1}, "seeds="),
        (object(), "seeds="),
    ],
    ids=repr,
)
def test_wrong_seeds_of_a_study(seeds, part):
    refused(lambda: skein.study("hover", seeds=seeds), part)


def test_right_seeds_of_a_study():
    for seeds in (1, np.int64(1), [4], range(4, 5), np.arange(4, 5), range(4, 6, 2), iter([4])):
        assert len(skein.study("hover", seeds=seeds, set=SHORT)) == 1


@pytest.mark.parametrize(
    "sweep, parts",
    [
        ({"network.loss": 0.3}, ["network.loss=0.3", "[0, 0.3]", '"0..0.5"', "one value belongs to set"]),
        ({"network.loss": None}, ["several values"]),
        ({"network.loss": True}, ["several values"]),
        ({"network.loss": {"a": 1}}, ["several values"]),
        ({"network.loss": np.float64(0.3)}, ["several values"]),
        ({"network.loss": []}, ["there is no value to fly"]),
        ({"network.loss": ""}, ["there is no value to fly"]),
        ({"network.loss": [None]}, ["network.loss", "takes no NoneType"]),
        ({"network.loss": "0..0.5"}, ["--points"]),
        ({"network.loss": [0, 2]}, ["network.loss"]),
        ({"network.los": [0, 0.1]}, ["did you mean `network.loss`?"]),
        ("network.loss=0,0.1", ["sweep=", 'such as sweep={"network.loss": [0, 0.1]}']),
        (["network.loss"], ["has to be a mapping"]),
        ({3: [0, 1]}, ["the key 3 is not a text"]),
    ],
    ids=repr,
)
def test_wrong_sweeps(sweep, parts):
    refused(lambda: skein.study("hover", set=SHORT, sweep=sweep), *parts)


@pytest.mark.parametrize("argument", ["jobs", "threads", "points"])
@pytest.mark.parametrize("value", WRONG_COUNTS, ids=repr)
def test_wrong_counts_of_a_study(argument, value):
    if value is None:
        return
    sweep = {"network.loss": "0..0.5"} if argument == "points" else None
    refused(lambda: skein.study("hover", set=SHORT, sweep=sweep, **{argument: value}), f"{argument}=", "whole number of 1")


@pytest.mark.parametrize("argument", ["record", "parquet", "progress"])
@pytest.mark.parametrize("value", WRONG_FLAGS, ids=repr)
def test_wrong_flags_of_a_study(argument, value):
    if value is None and argument == "record":
        return
    refused(lambda: skein.study("hover", set=SHORT, **{argument: value}), f"{argument}=", "True")


@pytest.mark.parametrize("value", WRONG_PATHS, ids=repr)
def test_wrong_folders(value, swept):
    refused(lambda: skein.study("hover", set=SHORT, out=value), "out=", "has to be the path of a folder")
    refused(lambda: skein.fly("hover", out=value), "out=", "has to be the path of a folder")
    refused(lambda: skein.load(value), "folder=", "has to be the path of a folder")
    refused(lambda: swept.save(value), "folder=", "has to be the path of a folder")
    refused(lambda: swept.to_parquet(value), "path=", "has to be the path of a file")
    refused(lambda: skein.Recording(value), "file=", "has to be the path of a recording")
    refused(lambda: skein.recording(value), "source=", "a study, or the path")
    refused(lambda: skein.compare(value, swept), "a=", "a study of skein.study")
    refused(lambda: skein.compare(swept, value), "b=", "a study of skein.study")


def test_folders_that_are_not_there(swept, tmp_path):
    refused(lambda: skein.load("no/such"), "no/such: no such folder")
    refused(lambda: skein.load(swept), "this is a study already")
    refused(lambda: skein.recording("no/such"), "no/such: no such folder")
    refused(lambda: skein.recording(tmp_path), "no runs in it")
    refused(lambda: skein.compare(swept, tmp_path), str(tmp_path))
    (tmp_path / "file").write_text("")
    refused(lambda: swept.save(tmp_path / "file"), "this is a file; choose a folder")


@pytest.mark.parametrize(
    "law, part",
    [(Gather(), "the class, not an object of it"), (dict, "a subclass of skein.Law"), ("ring", "law='ring'"), (3, "law=3")],
)
@pytest.mark.parametrize("call", [skein.study, skein.fly])
def test_wrong_laws(call, law, part):
    refused(lambda: call("hover", law=law), part)


@pytest.mark.parametrize("call", [skein.study, skein.fly])
@pytest.mark.parametrize("value", ["gain=0.5", [1], 3, {1: 2}, {"gain": object()}], ids=repr)
def test_wrong_parameters(call, value):
    refused(lambda: call("hover", law=Gather, parameters=value), "parameters")


@pytest.mark.parametrize("value", WRONG_SEED, ids=repr)
def test_wrong_seeds_of_a_flight(value, swept):
    refused(lambda: skein.fly("hover", seed=value), "seed=", "whole number from 0 to 9223372036854775807")
    refused(lambda: swept.recording(seed=value), "seed=", "whole number from 0")


@pytest.mark.parametrize("value", [0, -1, "5", True, float("nan"), float("inf"), [5], 10**400], ids=lambda value: repr(value)[:9])
def test_wrong_durations(value):
    refused(lambda: skein.fly("hover", duration_s=value), "duration_s=", "a number above 0, such as duration_s=20")
    refused(lambda: skein.Env("hover", duration_s=value), "duration_s=", "a number above 0")
    if value != 0:
        refused(lambda: skein.Env("hover", warm_up_s=value), "warm_up_s=", "a number of 0 at least")


@pytest.mark.parametrize("value", WRONG_FLAGS, ids=repr)
def test_wrong_flags_of_a_flight_and_of_an_environment(value):
    refused(lambda: skein.fly("hover", quiet=value), "quiet=", "quiet=True or quiet=False")
    if value is not None:
        refused(lambda: skein.Env("hover", ends_on_crash=value), "ends_on_crash=", "True")


@pytest.mark.parametrize(
    "only, part",
    [
        (["colisions"], "--only colisions: no figure that can be worse; did you mean collisions?"),
        (["collisions", "min_seperation_m"], "did you mean min_separation_m?"),
        (["duration_s"], "neither good nor bad"),
        (["qqqqqqqqqqq"], "The figures are "),
        ("collisions", "only=['collisions']"),
        ([3], "3 is not the key of a figure"),
        (3, "has to be a list of figures"),
        ([""], "--only "),
    ],
    ids=repr,
)
def test_wrong_figures_of_a_comparison(only, part, swept):
    error = refused(lambda: skein.compare(swept, swept, only=only), part)
    assert isinstance(error, skein.ArgumentError)


def test_a_figure_that_no_pair_has_is_named():
    one = skein.study("hover", seeds=1, set=SHORT)
    table = skein.figures()
    missing = set(table.index[table["worse"].notna()]) - set(skein.compare(one, one).index)
    assert "band_occupancy" in missing, "a ring has no figures of a flock"
    for figure in missing:
        refused(lambda: skein.compare(one, one, only=[figure]), f"no pair of runs has a value of {figure}")


@pytest.mark.parametrize("value", [0, 5, -1, 1.5, "1", True, LARGE], ids=repr)
def test_wrong_points(value, swept):
    refused(lambda: swept.point(value), "point" if value in (0, 5, -1, LARGE) and value is not True else "nth=")
    if value not in (5, LARGE) or value is True:
        refused(lambda: swept.recording(point=value), "point=")


def test_wrong_values_of_a_sweep(swept):
    refused(lambda: swept.point(network__loss=0.3), "network__loss=0.3: no run has this value", "the values are 0.0, 0.5")
    refused(lambda: swept.point(network__loss=[0]), "no run has this value")
    refused(lambda: swept.point(duration_s=3), "duration_s is not swept; swept: network.loss")
    with pytest.raises(KeyError):
        swept.point(duration_s=3)
    with pytest.raises(IndexError):
        swept.point(3)


@pytest.mark.parametrize("argument", ["worlds", "threads", "neighbours"])
@pytest.mark.parametrize("value", WRONG_COUNTS, ids=repr)
def test_wrong_counts_of_an_environment(argument, value):
    if argument == "neighbours" and value in (0, None) and value is not False:
        return
    refused(lambda: skein.Env("hover", **{argument: value}), f"{argument}=")


def test_more_neighbours_than_other_vehicles_are_refused():
    for neighbours in (4, 99, 10**6):
        refused(lambda: skein.Env("hover", neighbours=neighbours), f"neighbours={neighbours}: ", "a swarm of 4 has 3 neighbours")
    alone = {"swarm.vehicles": 1}
    refused(lambda: skein.Env("hover", neighbours=1, set=alone), "a swarm of 1 has 0 neighbours")
    assert skein.Env("hover", neighbours=0, worlds=1).neighbours == 0
    assert skein.Env("hover", neighbours=3, worlds=1).neighbours == 3
    assert skein.Env("hover", worlds=1, set=alone).neighbours == 0


@pytest.mark.parametrize(
    "action, part",
    [("speed", "'velocity', 'field', 'controls' or None"), ("velocty", "did you mean 'velocity'?"), (3, "action=3"), (["field"], "")],
    ids=repr,
)
def test_wrong_kinds_of_action(action, part):
    refused(lambda: skein.Env("hover", action=action), "an action has to be", part)


@pytest.mark.parametrize(
    "reward, part",
    [
        (lambda env: 0.0, "shape (), but has to give one of shape (2, 4)"),
        (lambda env: np.zeros(2), "shape (2,), but"),
        (lambda env: np.zeros((4, 2)), "shape (4, 2), but"),
        (lambda env: np.zeros((2, 4, 1)), "shape (2, 4, 1), but"),
        (lambda env: None, "no numbers"),
        (lambda env: "good", "no numbers"),
        (lambda env: np.full((2, 4), "good"), "no numbers"),
        (lambda env: np.zeros((2, 4), dtype=complex), "no numbers"),
        (lambda env: [[0.0] * 4, [0.0]], "no numbers"),
        (lambda env: env.crashed, "no numbers"),
    ],
)
def test_wrong_rewards(reward, part):
    env = skein.Env("hover", worlds=2, reward=reward, **SHORT)
    env.reset(seed=0)
    refused(lambda: env.step(np.zeros(env.actions.shape)), "reward: the function gave", part)


def test_a_reward_is_a_function():
    for reward in (3, "good", np.zeros((2, 4))):
        refused(lambda: skein.Env("hover", reward=reward), "reward=", "a function that takes the environment")
    env = skein.Env("hover", worlds=2, reward=lambda env: [[1] * 4] * 2, **SHORT)
    env.reset(seed=0)
    assert env.step(np.zeros(env.actions.shape))[1].tolist() == [[1.0] * 4] * 2


@pytest.mark.parametrize("seed", [*WRONG_SEED[:-2], [1], [0, -1], [0, "1"], [0.0, 1.0], [0, LARGE], LARGE - 1, {}, {0: 1}], ids=repr)
def test_wrong_seeds_of_an_environment(seed):
    env = skein.Env("hover", worlds=2, **SHORT)
    refused(lambda: env.reset(seed=seed), "seed=")


@pytest.mark.parametrize("worlds", [[True], [1, 0], "all", 3, [[True], [True]], [True, None], [[True], [True, False]]], ids=repr)
def test_wrong_masks_of_an_environment(worlds):
    env = skein.Env("hover", worlds=2, **SHORT)
    refused(lambda: env.reset(seed=0, worlds=worlds), "worlds=", "True or False for each of the 2 worlds")


def test_wrong_actions_of_an_environment():
    env = skein.Env("hover", worlds=2, **SHORT)
    refused(lambda: env.step(np.zeros(env.actions.shape)), "step before reset: 2 of 2 worlds", "call reset() first")
    env.reset(seed=0, worlds=[True, False])
    refused(lambda: env.step(np.zeros(env.actions.shape)), "step before reset: 1 of 2 worlds")
    env.reset(seed=0)
    undefined = np.zeros(env.actions.shape)
    undefined[1, 2, 0] = np.nan
    refused(lambda: env.step(undefined), "velocity_north_m_s of vehicle 3 of world 1 is nan, not finite")
    for actions in (None, 0.0, np.zeros((4, 3)), "north", np.zeros((2, 4, 2)), env.crashed):
        refused(lambda: env.step(actions), "actions", "(2, 4, 3): worlds, vehicles, numbers (velocity_north_m_s")
    env.step(np.full(env.actions.shape, 50.0))  # a faster velocity is cut
    own_law = skein.Env("hover", worlds=1, action=None, **SHORT)
    own_law.reset()
    refused(lambda: own_law.step(np.zeros((1, 4, 3))), "call step() without actions")
    own_law.figures()
    refused(own_law.step, "step before reset")
    refused(lambda: env.column("north"), "north: an observation has no such feature; did you mean north_m?")
    refused(lambda: skein.default_reward(3), "env=3: a skein.Env is wanted")
    refused(lambda: env.column(3), "3: an observation has no such feature")


@pytest.mark.parametrize("draw", [skein.plot.tracks, skein.plot.distances])
@pytest.mark.parametrize("value", ["run.mcap", None, 3], ids=repr)
def test_a_plot_of_a_flight_takes_a_recording(draw, value, swept, flight):
    refused(lambda: draw(value), "recording=", "skein.recording(...) reads one")
    refused(lambda: draw(swept), "skein.recording(...) reads one")
    panels = plt.subplots(1, 2)[1]
    for ax in (panels, 3, plt, "axes", plt.gcf()):
        refused(lambda: draw(flight, ax), "ax=", "such as axes[0]")
    plt.close("all")


def test_wrong_arguments_of_a_plot_of_a_sweep(swept):
    sweep = skein.plot.sweep
    refused(lambda: sweep("folder", "network.loss", "collisions"), "study=", "skein.load(...) reads one")
    for x in ("network.los", 3, None, "collisions"):
        refused(lambda: sweep(swept, x, "collisions"), "is not swept; swept: network.loss")
    refused(lambda: sweep(swept, "network.loss", "colisions"), "colisions: no figure of this study; did you mean collisions?")
    for y in (3, None, ["collisions"]):
        refused(lambda: sweep(swept, "network.loss", y), "no figure of this study")
    refused(lambda: sweep(swept, "network.loss", "collisions", ax=3), "ax=3")
    refused(lambda: sweep(swept, "network.loss", "collisions", network__loss=0.3), "no run has this value")
    refused(lambda: sweep(swept, "network.loss", "collisions", seeds=3), "seeds is not swept")
    texts = [key for key in swept.runs if not pd.api.types.is_numeric_dtype(swept.runs[key])]
    for y in texts:
        refused(lambda: sweep(swept, "network.loss", y), "this column has texts")


@pytest.mark.parametrize("size", [(12, 4), (6.4, 4.8)])
def test_legends_and_ids_lie_inside_their_panels(size, flight, swept):
    figure, panels = plt.subplots(2, 2, figsize=size)
    skein.plot.tracks(flight, panels[0, 0])
    skein.plot.tracks(flight, panels[0, 1])
    skein.plot.distances(flight, panels[1, 0])
    skein.plot.sweep(swept, "network.loss", "min_separation_m", panels[1, 1])
    figure.canvas.draw()
    for nth, ax in enumerate(panels.flat):
        legend, panel = ax.get_legend().get_window_extent(), ax.get_window_extent()
        assert panel.x0 <= legend.x0 and legend.x1 <= panel.x1, f"panel {nth}"
        assert panel.y0 <= legend.y0 and legend.y1 <= panel.y1, f"panel {nth}"
    assert [text.get_text() for text in panels[0, 0].texts] == ["1", "2", "3", "4"]
    assert all(text.get_clip_on() for text in panels[0, 0].texts), "an id beyond the edge is cut off"
    plt.close(figure)


@pytest.mark.parametrize(
    "call, part",
    [
        (lambda: skein.Velocity("fast"), "a velocity='fast': 3 numbers are wanted"),
        (lambda: skein.Velocity("123"), "3 numbers are wanted"),
        (lambda: skein.Velocity(1), "a velocity=1: 3 numbers are wanted"),
        (lambda: skein.Velocity(1, 2), "3 numbers are wanted"),
        (lambda: skein.Velocity([1, 2]), "3 numbers are wanted, not 2"),
        (lambda: skein.Velocity(None), "3 numbers are wanted"),
        (lambda: skein.Field([1, 2, 3]), "a field=[1, 2, 3]: 2 numbers are wanted, not 3"),
        (lambda: Gather(3), "setup=3: a skein.Setup is wanted"),
        (lambda: Gather({"gain": 1}), "a skein.Setup is wanted"),
        (lambda: skein.Observation(own=[0, 0, 0], goal=skein.Goal([0, 0, 0])), "own=[0, 0, 0]: a skein.Own is wanted"),
        (lambda: skein.Observation(own=skein.Own([0, 0, 0]), goal=None), "goal=None: a skein.Goal is wanted"),
        (lambda: skein.Observation(skein.Own([0, 0]), skein.Goal([0, 0, 0])), "position_ned_m of shape (2,): three numbers"),
        (lambda: skein.Observation(skein.Own("here"), skein.Goal([0, 0, 0])), "position_ned_m='here': three numbers"),
        (lambda: skein.Observation(skein.Own([0, 0, 0]), skein.Goal([0, 0, 0]), peers=[3]), "peers=3: a skein.Peer is wanted"),
        (lambda: skein.Observation.from_json({}), "ask: not an `ask` of the protocol"),
        (lambda: skein.Observation.from_json(3), "ask: not an `ask` of the protocol"),
        (lambda: observation().features(-1), "neighbours=-1"),
        (lambda: observation().features("3"), "neighbours='3'"),
    ],
)
def test_wrong_parts_of_a_law(call, part):
    refused(call, part)


def observation():
    return skein.Observation(own=skein.Own([0, 0, -30]), goal=skein.Goal([0, 0, -30]))


@pytest.mark.parametrize("wrong", [{"heading_rad": "north"}, {"log": 3}, {"log": {"away_m": "far"}}], ids=repr)
def test_a_wrong_answer_of_a_law_is_named(wrong):
    class Answers(skein.Law):
        def answer(self, observation):
            return skein.Velocity(0, 0, 0, **wrong)

    refused(lambda: skein.study("hover", set=SHORT, law=Answers), "the law's answer: heading_rad is a number")


def test_missing_packages_are_named(swept, monkeypatch):
    for missing, call, remedy in [
        ("polars", swept.to_polars, "pip install skein-swarm[polars]"),
        ("matplotlib", lambda: skein.plot.sweep(swept, "network.loss", "collisions"), "pip install skein-swarm[plot]"),
    ]:
        with monkeypatch.context() as without:
            for name in [name for name in sys.modules if name.split(".")[0] == missing]:
                without.delitem(sys.modules, name)
            without.setitem(sys.modules, missing, None)
            refused(call, remedy)


@pytest.mark.parametrize(
    "module, missing, remedy",
    [
        ("skein.gym", "gymnasium", "pip install skein-swarm[gym]"),
        ("skein.pettingzoo", "pettingzoo", "pip install skein-swarm[pettingzoo]"),
        ("skein.pettingzoo", "gymnasium", "pip install skein-swarm[pettingzoo]"),
    ],
)
def test_the_environments_name_the_package_that_is_missing(module, missing, remedy):
    code = f"import sys; sys.modules[{missing!r}] = None; import skein, importlib; importlib.import_module({module!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1 and remedy in done.stderr.splitlines()[-1], done.stderr


@pytest.mark.parametrize("quiet", [True, False])
def test_the_exception_of_a_flight_has_the_sentence_of_the_command(quiet, tmp_path, monkeypatch):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("")
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    for arguments in (
        {"set": {"formation.raduis_m": 3}},
        {"set": {"formation.radius_m": 1}},
        {"out": tmp_path / "full"},
        {"duration_s": 1e300},
    ):
        error = refused(lambda: skein.fly("hover", quiet=quiet, **{"duration_s": 2, **arguments}))
        sets = [part for key, value in arguments.get("set", {}).items() for part in ("--set", f"{key}={value}")]
        out = ["--out", str(arguments.get("out", tmp_path / "never"))]
        duration = ["--duration", str(arguments.get("duration_s", 2))]
        done = subprocess.run([skein.program(), "fly", "hover", *sets, *duration, *out], capture_output=True, text=True)
        assert done.returncode == 2 and str(error) in done.stderr and str(error) and "For more information" not in str(error)
    assert ("raduis_m" in shown.getvalue()) != quiet


def test_a_program_that_cannot_be_started_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("SKEIN_PROGRAM", str(tmp_path / "skein"))
    refused(lambda: skein.fly("hover", duration_s=2), str(tmp_path / "skein"), "SKEIN_PROGRAM names the program")
    monkeypatch.delenv("SKEIN_PROGRAM")
    monkeypatch.setenv("PATH", os.fspath(tmp_path))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    refused(skein.program, "neither beside this Python nor on the PATH")
