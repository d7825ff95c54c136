"""Speed of Skein beside other simulators of aerial vehicles, on this PC and in one run.

    cargo build --release
    python3 tests/benches/peers.py [--skein target/release/skein]

Installs each simulator from PyPI into an environment of its own under target/peers, each within ten minutes, and prints
what cannot be installed. Each flies 4 and 100 vehicles on one core. Open loop is physics alone; closed loop has a
controller. A step of Skein is a frame of 20 ms; its flight model takes smaller ones. Times are processor times, the
least of three runs in turn. Of the others' programs the start and the compilation are left out; Skein's is its whole
process.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
ENVIRONMENTS = REPOSITORY / "target/peers"
INSTALL_WITHIN_S = 600
RUN_WITHIN_S = 300
REPEATS = 3
SIZES = (4, 100)
LOOPS = ("open", "closed")
# Packages of each simulator; those after the first are for the closed loop.
PACKAGES = {
    "crazyflow": ["crazyflow"],
    "gym-pybullet-drones": ["gym-pybullet-drones"],
    "l2f": ["l2f", "foundation-policy"],
}


def crazyflow(vehicles, loop):
    """One world with all vehicles, physics at 500 Hz, a new command at 50 Hz; closed: its state controller."""
    import jax
    import numpy as np
    from crazyflow.control import Control
    from crazyflow.dynamics import Dynamics
    from crazyflow.sim import Sim

    control = Control.state if loop == "closed" else Control.rotor_vel
    sim = Sim(n_worlds=1, n_drones=vehicles, dynamics=Dynamics.first_principles, control=control, freq=500)
    sim.reset()
    if loop == "closed":
        command = np.zeros((1, vehicles, 16), dtype=np.float32)
        command[..., :3] = np.asarray(sim.data.states.pos)
        command[..., 2] = 1.0
        command[..., 12] = 1.0  # the attitude's quaternion, scalar last
        set_command = sim.state_control
    else:
        command = np.full((1, vehicles, 4), 15_000.0, dtype=np.float32)
        set_command = sim.rotor_vel_control

    def fly(seconds):
        for _ in range(int(50 * seconds)):
            set_command(command)
            sim.step(10)
        jax.block_until_ready(sim.data.states.pos)

    return fly, vehicles, 500


def l2f(vehicles, loop):
    """Environments side by side, as many as the next power of two, at 100 Hz; closed: the foundation policy."""
    import numpy as np
    from l2f import Device, vector_selector

    count = 1 << (vehicles - 1).bit_length()
    vector = vector_selector[count]
    device, rng, env = Device(), vector.VectorRng(), vector.VectorEnvironment()
    parameters, state, following = vector.VectorParameters(), vector.VectorState(), vector.VectorState()
    vector.initialize_rng(device, rng, 0)
    vector.initialize_environment(device, env)
    vector.initial_parameters(device, env, parameters)
    vector.initial_state(device, env, parameters, state)
    action = np.zeros((count, env.ACTION_DIM), dtype=np.float32)
    observation = np.zeros((count, env.OBSERVATION_DIM), dtype=np.float32)
    policy = None
    if loop == "closed":
        from foundation_policy import QuadrotorPolicy

        policy = QuadrotorPolicy()
        policy.reset()

    def step():
        command = action
        if policy:
            vector.observe(device, env, parameters, state, observation, rng)
            command = policy.evaluate_step(observation[:, :22])
        step_s = vector.step(device, env, parameters, state, command, following, rng)[-1]
        state.assign(following)
        return step_s

    rate_hz = round(1 / step())

    def fly(seconds):
        for _ in range(int(rate_hz * seconds)):
            step()

    return fly, count, rate_hz


WORKERS = {"crazyflow": crazyflow, "l2f": l2f}


def work(name, vehicles, loop):
    """Flies in this process for about two seconds of processor time and prints the result."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    fly, vehicles, rate_hz = WORKERS[name](vehicles, loop)
    fly(1)  # compiles
    seconds = 1.0
    while True:
        begin = time.process_time()
        fly(seconds)
        spent = time.process_time() - begin
        if spent > 2.0:
            break
        seconds *= max(2.0, min(20.0, 2.5 / max(spent, 1e-3)))
    print(json.dumps({"vehicles": vehicles, "hz": rate_hz, "flown_s": seconds, "spent_s": spent}))


def run_bounded(command, within_s, folder):
    """Output of a command in a process group of its own, which is killed when its time is over. What it writes stays in
    the folder, also the files that a killed build leaves behind."""
    folder.mkdir(parents=True, exist_ok=True)
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder)},
    )
    try:
        output, _ = process.communicate(timeout=within_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        raise RuntimeError(f"not done within {within_s:.0f} s") from None
    if process.returncode != 0:
        lines = [line for line in output.splitlines() if line.strip() and "[notice]" not in line]
        errors = [line for line in lines if "rror" in line] or lines or ["no output"]
        raise RuntimeError(errors[-1].strip())
    return output


def install(name):
    """Installs a simulator, unless that was done before; returns its Python and what is missing."""
    folder, until = ENVIRONMENTS / name, time.monotonic() + INSTALL_WITHIN_S
    python, done = folder / "bin/python", folder / "installed"
    if not done.exists():
        shutil.rmtree(folder, ignore_errors=True)
        temporary = folder / "tmp"
        run_bounded([sys.executable, "-m", "venv", str(folder)], INSTALL_WITHIN_S, temporary)
        missing = []
        for nth, package in enumerate(PACKAGES[name]):
            try:
                pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", package]
                run_bounded(pip, max(until - time.monotonic(), 1), temporary)
            except RuntimeError as why:
                if nth == 0:
                    raise
                missing.append(f"{package} cannot be installed: {why}")
        shutil.rmtree(temporary, ignore_errors=True)
        done.write_text("\n".join(missing))
    return python, done.read_text().splitlines()


def peer(python, name, vehicles, loop):
    """One run of a simulator."""
    command = [str(python), str(Path(__file__).resolve()), "--worker", name, str(vehicles), loop]
    return json.loads(run_bounded(command, RUN_WITHIN_S, ENVIRONMENTS / name / "tmp").splitlines()[-1])


def skein(program, vehicles):
    """One run of `skein study`: the hover in one ring, with agreement, messages, formation, control and figures."""
    seconds = max(100, 1600 // vehicles)
    side_m = max(150, round(30 * vehicles**0.5))
    with tempfile.TemporaryDirectory() as folder:
        command = [program, "study", str(REPOSITORY / "deploy/scenarios/hover.toml"), "--seed", "1", "--no-record"]
        command += ["--jobs", "1", "--out", folder + "/out"]
        sets = {"swarm.vehicles": vehicles, "formation.radius_m": 12 * vehicles, "start.square_m": side_m}
        for key, value in {**sets, "duration_s": seconds}.items():
            command += ["--set", f"{key}={value}"]
        output = Path(folder, "output")
        to_output = [(os.POSIX_SPAWN_OPEN, 1, output, os.O_WRONLY | os.O_CREAT, 0o600), (os.POSIX_SPAWN_DUP2, 1, 2)]
        pid = os.posix_spawn(command[0], command, os.environ, file_actions=to_output)
        _, status, used = os.wait4(pid, 0)
        if status != 0:
            raise RuntimeError(f"{' '.join(command)}: {output.read_text()}")
    return {"vehicles": vehicles, "hz": 50, "flown_s": seconds, "spent_s": used.ru_utime + used.ru_stime}


def row(name, loop, result):
    steps = result["hz"] * result["flown_s"] / result["spent_s"]
    speed = result["vehicles"] * result["flown_s"] / result["spent_s"]
    return [name, loop, str(result["vehicles"]), str(result["hz"]), f"{steps:.0f}", f"{speed:.0f}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--skein", default=str(REPOSITORY / "target/release/skein"))
    parser.add_argument("--worker", nargs=3, metavar=("NAME", "VEHICLES", "LOOP"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        name, vehicles, loop = arguments.worker
        work(name, int(vehicles), loop)
        return
    runs, failures = [], []
    for vehicles in SIZES:
        runs.append(("skein study", "closed", vehicles, lambda n=vehicles: skein(arguments.skein, n)))
    for name in PACKAGES:
        try:
            python, missing = install(name)
        except RuntimeError as why:
            failures.append(f"{name}: not installed from PyPI: {why}")
            continue
        failures += [f"{name}: {what}" for what in missing]
        if name not in WORKERS:
            failures.append(f"{name}: installed, but this script does not fly it")
            continue
        for vehicles in SIZES:
            for loop in LOOPS:
                fly = lambda p=python, s=name, n=vehicles, l=loop: peer(p, s, n, l)
                runs.append((name, loop, vehicles, fly))
    best = {}
    for _ in range(REPEATS):
        for nth, (name, loop, vehicles, fly) in enumerate(runs):
            if best.get(nth) == "failed":
                continue
            try:
                result = fly()
            except RuntimeError as why:
                failures.append(f"{name}, {loop} loop, {vehicles} vehicles: {why}")
                best[nth] = "failed"
                continue
            spent = lambda one: one["spent_s"] / one["flown_s"]
            best[nth] = min(best.get(nth, result), result, key=spent)
    rows = [["simulator", "loop", "vehicles", "step Hz", "steps per CPU-s", "vehicle-s per CPU-s"]]
    rows += [row(name, loop, best[nth]) for nth, (name, loop, _, _) in enumerate(runs) if best[nth] != "failed"]
    widths = [max(len(line[column]) for line in rows) for column in range(len(rows[0]))]
    for line in rows:
        cells = [cell.ljust(width) if column < 2 else cell.rjust(width)
                 for column, (cell, width) in enumerate(zip(line, widths))]
        print("  ".join(cells).rstrip())
    for failure in failures:
        print(failure)


if __name__ == "__main__":
    main()
