"""What several tests share."""

import subprocess

import matplotlib
import pytest

import skein

matplotlib.use("agg")

#: The only figures that differ between two runs of one seed.
WALL_CLOCK = ["wall_s", "real_time_factor", "step_p50_us", "step_p99_us", "frame_overruns"]


@pytest.fixture
def command(tmp_path):
    """Runs ``skein study`` into a folder and gives it back."""

    def run(*arguments, name="command", record=False):
        out = tmp_path / name
        line = [skein.program(), "study", *map(str, arguments), "--out", str(out)]
        line += [] if record else ["--no-record"]
        done = subprocess.run(line, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return out

    return run


@pytest.fixture
def same_bits():
    """Checks that two frames of runs are the same but for the wall clock."""

    def check(one, other):
        keys = [key for key in one.columns if key not in WALL_CLOCK]
        assert set(keys) == {key for key in other.columns if key not in WALL_CLOCK}
        assert len(one) == len(other)
        for key in keys:
            left, right = one[key].tolist(), other[key].tolist()
            assert all(a == b or (a != a and b != b) for a, b in zip(left, right)), f"{key}: {left} {right}"

    return check
