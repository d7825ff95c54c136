"""Installs what `deploy/release` has built, in fresh systems and environments, flies each, and prints a table.

    install.py OUT ROOTS [wheel|deb|portable|source|compile|unpacked]...

OUT is the folder of the release, ROOTS that of the Debian systems `bullseye` and `trixie`, into which `deb` and `portable`
install as root. `unpacked` only unpacks the Debian package, `compile` only compiles: they need neither. The Python packages of `tests/requirements.txt`
read the recording of each flight.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mcap.reader import make_reader

#: A helicopter at this height flies, m.
HEIGHT_M = 1.5
#: How long each flight lasts before it lands, s: long enough to climb above that height.
FLIGHT = ["fly", "--duration", "8", "--out"]
#: What the Debian package installs besides the program, among others.
INSTALLED = [
    "man/man1/skein-fly.1.gz", "bash-completion/completions/skein", "system/skein-agent@.service", "doc/skein/copyright",
    "doc/skein/THIRD-PARTY.txt.gz", "skein/scenarios/flock.toml", "skein/laws/ring.py", "skein/cluster.example.toml",
]


def run(*command, **more):
    """Runs a command to its end and gives what it wrote; a failure ends this program."""
    done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **more)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout[-4000:]}")
    return done.stdout


def row(name, text):
    """Prints a row of the table."""
    print(f"{name:24} {text}", flush=True)


def compiled(package, profile, cwd, env):
    """Compiles a package from nothing; gives the processor time that it took, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run("cargo", "build", "--profile", profile, "--locked", "--offline", "-p", package, cwd=cwd, env=env)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def first_above(recording):
    """When the first helicopter was above the height, in seconds of the PC's clock, and how many flew so high."""
    first, high = None, set()
    with open(recording, "rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if channel.topic.endswith("/trace") and json.loads(message.data)["height_m"] > HEIGHT_M:
                first = first or message.log_time / 1e9
                high.add(channel.topic)
    return first, len(high)


def flown(name, program, folder, begin, outside=None):
    """Flies four vehicles, checks that all of them took off, landed and met the revision, and prints a row of the table."""
    version = run(*program, "--version")
    start = time.time()
    run(*program, *FLIGHT, folder)
    folder = Path(f"{outside or ''}{folder}")
    metrics = json.loads((folder / "metrics.json").read_text())
    above, high = first_above(folder / "run.mcap")
    if high != 4 or metrics["crashes"] != 0:
        sys.exit(f"{name}: {high} of 4 vehicles flew, {metrics['crashes']} crashed")
    if metrics["revision"] not in version:
        sys.exit(f"{name}: the flight names revision {metrics['revision']}, and --version says\n{version}")
    wants = next(line.split("  ")[1] for line in version.splitlines() if line.startswith("C library"))
    row(name, f"installed {start - begin:6.1f} s, above {HEIGHT_M} m {above - begin:6.1f} s after the start; {wants}")


def only(out, pattern):
    """The one file of the release with such a name."""
    found = sorted(out.glob(pattern))
    if len(found) != 1:
        sys.exit(f"{out} has {len(found)} files {pattern}: run `deploy/release all --out {out}` into an empty folder")
    return found[0]


def wheel(out, roots, folder):
    """Into a fresh environment of Python, whose packages pip brings."""
    begin = time.time()
    run(sys.executable, "-m", "venv", folder / "fresh")
    run(folder / "fresh/bin/python", "-m", "pip", "install", "--quiet", only(out, "*.whl"))
    flown("wheel", [folder / "fresh/bin/skein"], folder / "wheel", begin)
    script = "import skein; study = skein.study(seeds=[1], set={'duration_s': 20}); print(len(study.runs), skein.program())"
    printed = run(folder / "fresh/bin/python", "-c", script, cwd=folder)
    if printed.split() != ["1", str(folder / "fresh/bin/skein")]:
        sys.exit(f"the Python package printed {printed}")


def in_root(root):
    """The beginning of a command in a Debian system, with what a program needs of the kernel."""
    os.makedirs(root / "run", exist_ok=True)
    if not os.path.ismount(root / "proc"):
        run("mount", "-t", "proc", "proc", root / "proc")
    return ["chroot", root, "/usr/bin/env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "HOME=/root"]


def complete(listed):
    """Checks the list of the files of the Debian package."""
    missing = [name for name in INSTALLED if name not in listed]
    if missing:
        sys.exit(f"the package lacks {missing}:\n{listed}")


def unpacked(out, roots, folder):
    """The Debian package, unpacked into a folder."""
    begin, package = time.time(), only(out, "skein_*_amd64.deb")
    run("dpkg-deb", "--extract", package, folder / "tree")
    complete(run("dpkg-deb", "--contents", package))
    flown("deb, unpacked", [folder / "tree/usr/bin/skein"], folder / "flight", begin)
    run(folder / "tree/usr/bin/skein", "check", folder / "tree/usr/share/skein/scenarios/external.toml")


def deb(out, roots, folder):
    """By dpkg, in the oldest and the newest Debian; removed again."""
    package = only(out, "skein_*_amd64.deb")
    for root in (roots / "bullseye", roots / "trixie"):
        inside = in_root(root)
        shutil.copy(package, root / "tmp/skein.deb")
        begin = time.time()
        run(*inside, "dpkg", "--install", "/tmp/skein.deb")
        shutil.rmtree(root / "tmp/flight", ignore_errors=True)
        flown(f"deb, {root.name}", [*inside, "skein"], "/tmp/flight", begin, root)
        run(*inside, "skein", "check", "/usr/share/skein/scenarios/tour.toml")
        complete(run(*inside, "dpkg", "--listfiles", "skein"))
        run(*inside, "dpkg", "--remove", "skein")
        run("umount", root / "proc")


def portable(out, roots, folder):
    """The bare program, copied into the oldest and the newest Debian."""
    for root in (roots / "bullseye", roots / "trixie"):
        begin, inside = time.time(), in_root(root)
        shutil.copy(only(out, "skein-*-x86_64-linux"), root / "tmp/skein")
        shutil.rmtree(root / "tmp/flight", ignore_errors=True)
        flown(f"portable, {root.name}", [*inside, "/tmp/skein"], "/tmp/flight", begin, root)
        run("umount", root / "proc")


def source(out, roots, folder):
    """Built without network and without any downloaded package."""
    begin = time.time()
    run("tar", "--extract", "--file", only(out, "*-source.tar.xz"), "--directory", folder)
    tree = next(folder.glob("skein-*"))
    (folder / "cargo").mkdir()
    env = {**os.environ, "CARGO_HOME": str(folder / "cargo")}
    env.pop("CARGO_TARGET_DIR", None)
    env["CARGO_BUILD_TARGET_DIR"] = str(tree / "target")
    run("unshare", "--net", "cargo", "build", "--release", "--locked", "--offline", "-p", "skein", cwd=tree, env=env)
    flown("source", [tree / "target/release/skein"], folder / "source", begin)


#: The crates on which Skein is to stand, with the features that they have by default.
EMPTY = """[package]
name = "empty"
version = "0.1.0"
edition = "2024"
[dependencies]
nalgebra = "*"
postcard = { version = "*", features = ["use-std"] }
serde = { version = "*", features = ["derive"] }
tokio = { version = "*", features = ["full"] }
zenoh = "*"
[workspace]
"""


def compile(out, roots, folder):
    """What a node needs, against an empty program with the same five crates at the same versions."""
    ours = Path(__file__).resolve().parents[2]
    (folder / "src").mkdir()
    (folder / "src/main.rs").write_text("fn main() {}\n")
    (folder / "Cargo.toml").write_text(EMPTY)
    shutil.copy(ours / "Cargo.lock", folder)
    # Takes the crates that Skein does not use into the copied lock file, and downloads them.
    run("cargo", "fetch", cwd=folder)
    for profile in ["dev", "release"]:
        empty_s, agent_s = (
            compiled(package, profile, where, {**os.environ, "CARGO_TARGET_DIR": str(folder / "target" / package)})
            for package, where in [("empty", folder), ("skein-agent", ours)]
        )
        text = f"{agent_s:4.0f} s of processor time, {empty_s:4.0f} s an empty program with the same five crates: {agent_s / empty_s:.2f}"
        row(f"skein-agent, {profile}", text)


KINDS = {"wheel": wheel, "deb": deb, "portable": portable, "source": source, "compile": compile, "unpacked": unpacked}


def main():
    """Installs and flies each kind in turn."""
    out, roots, kinds = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve(), sys.argv[3:]
    for kind in kinds or ["wheel", "deb", "portable", "source", "compile"]:
        if kind not in KINDS:
            sys.exit(f"{kind}: one of {', '.join(KINDS)}")
        with tempfile.TemporaryDirectory(prefix="skein-install-") as folder:
            KINDS[kind](out, roots, Path(folder))


if __name__ == "__main__":
    main()
