"""Studies: the same bits as the command, frames, sweeps, errors, Ctrl-C."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pandas as pd
import pytest

import skein

SHORT = {"duration_s": 20}


def test_a_study_has_the_bits_of_the_command(command, same_bits):
    flown = skein.study("hover", seeds=range(3, 6), set={"duration_s": 40, "network.loss": 0.2})
    out = command("hover", "--seeds", "3..6", "--set", "duration_s=40", "--set", "network.loss=0.2")
    same_bits(flown.runs, skein.load(out).runs)
    text = [line.split(",") for line in (out / "runs.csv").read_text().splitlines()]
    assert list(flown.runs.columns) == text[0]
    nth = text[0].index("min_separation_m")
    assert flown.runs["min_separation_m"].tolist() == [float(row[nth]) for row in text[1:]], "no bit is lost"


def test_jobs_and_threads_change_nothing(same_bits):
    one = skein.study("hover", seeds=4, set=SHORT, jobs=1)
    same_bits(one.runs, skein.study("hover", seeds=4, set=SHORT, jobs=3, threads=2).runs)


def test_a_sweep_has_a_column_of_each_key_and_a_summary_of_each_point(same_bits):
    sweep = {"network.loss": [0, 0.5], "preset": ["default", "paper"]}
    flown = skein.study("hover", seeds=2, set=SHORT, sweep=sweep)
    assert flown.swept == ["network.loss", "preset"]
    assert flown.runs["network.loss"].tolist() == [0, 0, 0, 0, 0.5, 0.5, 0.5, 0.5]
    assert flown.runs["preset"].tolist() == ["default", "default", "paper", "paper"] * 2
    assert flown.summary.loc[(3, "collisions"), "n"] == 2
    same_bits(flown.point(3), flown.point(network__loss=0.5, preset="default"))
    with pytest.raises(KeyError, match="duration_s is not swept"):
        flown.point(duration_s=3)
    with pytest.raises(IndexError, match="points 1 to 4"):
        flown.point(5)


def test_a_range_is_sampled(same_bits):
    flown = skein.study("hover", seeds=1, set=SHORT, sweep={"network.loss": "0..0.4"}, points=5)
    samples = flown.runs["network.loss"]
    assert len(set(samples)) == 5 and samples.between(0, 0.4).all()


def test_a_saved_study_is_read_again_and_resumes_nothing(tmp_path, same_bits):
    flown = skein.study("hover", seeds=2, set=SHORT)
    kept = flown.save(tmp_path / "kept")
    same_bits(flown.runs, kept.runs)
    pd.testing.assert_frame_equal(flown.summary, kept.summary)
    with pytest.raises(skein.SkeinError, match="already contains files"):
        flown.save(tmp_path / "kept")
    folder = flown.folder
    del flown
    assert not folder.exists(), "a temporary folder goes with its study"


def test_polars_has_the_same_numbers():
    flown = skein.study("hover", seeds=2, set=SHORT)
    frame = flown.to_polars()
    assert frame["seed"].to_list() == [0, 1]
    assert frame["radial_rms_m"].null_count() == flown.runs["radial_rms_m"].isna().sum() == 2


def test_an_invalid_scenario_is_an_exception_with_its_place(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[formation]\nraduis_m = 80\n")
    with pytest.raises(skein.ScenarioError) as caught:
        skein.study(file)
    error = caught.value
    assert str(error) == f"{file}:2:1: unknown key `formation.raduis_m`; did you mean `formation.radius_m`?"
    assert (error.file, error.line, error.column, error.key) == (str(file), 2, 1, "formation.raduis_m")
    done = subprocess.run([skein.program(), "study", str(file)], capture_output=True, text=True)
    assert done.stderr.strip() == str(error)
    with pytest.raises(skein.ScenarioError) as caught:
        skein.study("hover", set={"swarm.vehicles": "many"})
    assert caught.value.line is None
    with pytest.raises(skein.SkeinError, match="no/such.toml"):
        skein.study("no/such.toml")
    with pytest.raises(skein.SkeinError, match="network.loss=0.5..0.1"):
        skein.study("hover", sweep={"network.loss": "0.5..0.1"}, points=2)


def test_progress_is_called_with_the_runs_that_are_done():
    calls = []
    skein.study("hover", seeds=3, set=SHORT, progress=lambda done, runs: calls.append((done, runs)))
    assert calls[-1] == (3, 3) and calls == sorted(calls)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_ends_a_study_that_would_take_hours(tmp_path):
    code = """
        import skein
        print("begins", flush=True)
        try:
            skein.study("hover", seeds=100_000, set={"duration_s": 3000}, out=OUT)
        except KeyboardInterrupt:
            print("interrupted", flush=True)
    """
    code = textwrap.dedent(code).replace("OUT", repr(str(tmp_path / "out")))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begins\n"
    while not (tmp_path / "out" / "study.json").exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=60)[0] == "interrupted\n"


def test_a_comparison_has_the_verdicts_of_the_command(tmp_path):
    a = skein.study("hover", seeds=8, set=SHORT, out=tmp_path / "a", record=False)
    b = skein.study("hover", seeds=8, set={**SHORT, "network.loss": 0.6}, out=tmp_path / "b", record=False)
    compared = skein.compare(a, b)
    done = subprocess.run(
        [skein.program(), "compare", str(tmp_path / "a"), str(tmp_path / "b")], capture_output=True, text=True
    )
    worse = compared.index[compared["verdict"] == "worse"].tolist()
    assert worse and done.returncode == 1 and done.stderr.strip().endswith("worse: " + ", ".join(worse))
    assert (skein.compare(a, a)["verdict"] == "same").all()
    only = skein.compare(tmp_path / "a", tmp_path / "b", only=["collisions"])
    assert only.index.tolist() == ["collisions"]


def test_a_recording_gives_frames_and_figures(tmp_path):
    import skein.plot as plot

    fault = [{"at_s": 5, "fault": "engine_out", "vehicle": 2}]
    flown = skein.study("hover", seeds=1, set={**SHORT, "mission.events": fault}, out=tmp_path / "out")
    flight = skein.recording(flown)
    assert sorted(flight.steps["vehicle"].unique()) == [1, 2, 3, 4]
    assert flight.scenario["swarm"]["vehicles"] == 4
    assert flight.faults["vehicle"].tolist() == [2] and flight.faults["t_s"].tolist() == [5.0]
    assert "at altitude" in " ".join(flight.events["text"])
    assert len(plot.tracks(flight).get_lines()) == 9
    nearest = plot.distances(flight).get_lines()[-1].get_ydata()
    assert nearest.min() > 2.0
    with pytest.raises(skein.SkeinError, match="not an MCAP file"):
        skein.recording(tmp_path / "out" / "runs.csv")


def test_a_sweep_is_drawn_with_its_medians():
    import skein.plot as plot

    flown = skein.study("hover", seeds=3, set=SHORT, sweep={"swarm.vehicles": [3, 4]})
    ax = plot.sweep(flown, "swarm.vehicles", "min_separation_m")
    medians = ax.get_lines()[-1].get_ydata().tolist()
    assert medians == flown.runs.groupby("swarm.vehicles")["min_separation_m"].median().tolist()
    assert ax.get_ylabel() == "min_separation_m, m"
    with pytest.raises(KeyError, match="formation.radius_m is not swept"):
        plot.sweep(flown, "formation.radius_m", "collisions")


def test_runs_become_a_parquet_file_with_the_same_bits(tmp_path, same_bits, monkeypatch):
    flown = skein.study("hover", seeds=2, set=SHORT, out=tmp_path / "flown", parquet=True, record=False)
    same_bits(flown.runs, pd.read_parquet(tmp_path / "flown" / "runs.parquet"))
    again = skein.load(tmp_path / "flown").to_parquet(tmp_path / "other.parquet")
    pd.testing.assert_frame_equal(flown.runs, pd.read_parquet(again))

    def without_pyarrow(*_, **__):
        raise ImportError("no pyarrow")

    monkeypatch.setattr(pd.DataFrame, "to_parquet", without_pyarrow)
    with pytest.raises(skein.SkeinError, match="pip install pyarrow"):
        flown.to_parquet()
