"""Laws: tested by hand, the same in this process and in another one."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

import skein
from laws_of_tests import ByExactFeatures, ByFeatures, Gather, Ring

SET = {"duration_s": 40, "swarm.vehicles": 3}


def test_a_law_is_tested_without_a_swarm():
    law = Gather(skein.Setup(parameters={"gain": 0.5}))
    observation = skein.Observation(own=skein.Own([10, 0, -28]), goal=skein.Goal([0, 0, -30]))
    assert law.answer(observation).numbers == [-5.0, 0.0, -1.0]
    again = skein.Observation.from_json(observation.to_json())
    assert again.to_json() == observation.to_json()


def test_answers_take_numbers_or_arrays():
    assert skein.Velocity(1, 2, 3).numbers == skein.Velocity(np.array([1, 2, 3])).numbers == [1.0, 2.0, 3.0]
    assert skein.Field(1, 2).numbers == skein.Field((1, 2)).numbers == [1.0, 2.0]
    with pytest.raises(ValueError, match="3 numbers are wanted, not 2"):
        skein.Velocity([1, 2])


@pytest.mark.parametrize("law", [Ring, Gather, ByExactFeatures])
def test_a_law_in_this_process_answers_as_in_another_one(law, command, same_bits, tmp_path):
    parameters = {"gain": 0.08, "inner_width_m": 20}
    here = skein.study("hover", seeds=2, set=SET, law=law, parameters=parameters)
    # Its scenario names the program that serves the law: the command flies it again.
    there = command(here.folder / "seed-1" / "scenario.toml")
    same_bits(here.runs.iloc[[1]], skein.load(there).runs)


@pytest.mark.parametrize("law", [ByFeatures])
def test_long_numbers_differ_in_the_last_bit_at_most(law, command):
    here = skein.study("hover", seeds=1, set=SET, law=law)
    there = skein.load(command(here.folder / "scenario.toml"))
    for key in ("min_separation_m", "energy_j", "max_tilt_deg"):
        assert here.runs[key].tolist() == pytest.approx(there.runs[key].tolist(), rel=1e-6), key


def test_what_a_law_logs_is_recorded(tmp_path):
    flown = skein.study("hover", seeds=1, set=SET, law=Gather, out=tmp_path / "out")
    logged = skein.recording(flown).laws
    assert set(logged["name"]) == {"away_m"} and logged["value"].iloc[-1] < logged["value"].iloc[0]


def test_the_exception_of_a_law_ends_the_study_as_it_is():
    class Divides(skein.Law):
        def answer(self, observation):
            return skein.Velocity(1 / 0, 0, 0)

    class Forgets(skein.Law):
        def answer(self, observation):
            pass

    class Escapes(skein.Law):
        def answer(self, observation):
            return skein.Velocity(float("nan"), 0, 0)

    with pytest.raises(ZeroDivisionError):
        skein.study("hover", seeds=2, set=SET, law=Divides)
    with pytest.raises(TypeError, match="gives a skein.Velocity or a skein.Field, not None"):
        skein.study("hover", seeds=2, set=SET, law=Forgets)
    with pytest.raises(ValueError, match="not finite"):
        skein.study("hover", seeds=2, set=SET, law=Escapes)
    with pytest.raises(TypeError, match="subclass of skein.Law"):
        skein.study("hover", law=dict)


def test_a_law_of_a_restarted_agent_begins_anew():
    begun = []

    class Counts(Gather):
        def __init__(self, setup):
            super().__init__(setup)
            begun.append(setup.vehicle)

    events = [{"at_s": 5, "fault": "kill", "vehicle": 2, "for_s": 3}]
    skein.study("hover", seeds=1, set={**SET, "mission.events": events}, law=Counts)
    assert begun == [1, 2, 3, 2]


def test_a_law_flies_in_real_time(tmp_path):
    # A busy PC answers late: the fallback law has to stay out of it, or the flight counts as failed.
    set = {"swarm.vehicles": 2, "swarm.name": f"python-{os.getpid()}", "formation.external.misses": 1000}
    flown = skein.fly("hover", law=Gather, set=set, duration_s=8, out=tmp_path / "out", quiet=True)
    assert flown.runs["collisions"].tolist() == [0]
    assert skein.recording(flown).laws["name"].eq("away_m").all()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_lands_the_swarm_and_returns_the_flight(tmp_path):
    code = f"""
import skein
keys = {{"swarm.vehicles": 2, "swarm.name": "ctrl-c-{os.getpid()}"}}
flown = skein.fly("hover", set=keys, out={str(tmp_path / "out")!r})
print("returned", len(flown), flown.recording().is_file())
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        # What runs the tests may ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    for line in process.stdout:
        if "all vehicles active" in line:
            break
    os.killpg(process.pid, signal.SIGINT)
    written = process.communicate(timeout=120)[0]
    assert "ordered to land" in written and "returned 1 True" in written and process.returncode == 0, written


def test_a_law_of_a_prompt_is_refused_by_fly():
    code = (
        "import skein\n"
        "class Mine(skein.Law): pass\n"
        "try: skein.fly('hover', law=Mine)\n"
        "except skein.SkeinError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "put the class into a file of its own" in done.stdout, done.stderr
