"""A cluster of which two hosts are Windows PCs: sshd gives them Wine's cmd.exe as login shell. `windows.py` runs this.

Each host is a network namespace with an account, a home folder and a registry of its own. The sshd is Linux's: that Windows' own
sshd lets agents live when a session ends, and what access rights it asks of keys, is not tried here.
"""

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

#: The addresses of the operator, of the hosts with Windows, and of all hosts: the last has Linux.
OPERATOR, HOSTS = "10.81.0.100", {"heli1": "10.81.0.1", "heli2": "10.81.0.2"}
ALL = {**HOSTS, "heli3": "10.81.0.3"}
#: What sshd of Windows calls: `cmd.exe /c` with the whole command.
SHELL = """#!/bin/sh
export WINEDEBUG=-all WINEPREFIX="$HOME/wine" LC_ALL=C.UTF-8
[ "$1" = -c ] || exit 1
exec wine cmd.exe /c "$2"
"""
SSHD = """\
HostKey /run/keys/host
AuthorizedKeysFile /run/keys/authorized
StrictModes no
UsePAM no
Subsystem sftp internal-sftp
MaxSessions 20
MaxStartups 100
"""


class Failed(Exception):
    """What came of a test instead of what had to."""


def wait(what, condition, within=60):
    """Waits until the condition gives something, and gives that."""
    until = time.monotonic() + within
    while time.monotonic() < until:
        found = condition()
        if found:
            return found
        time.sleep(0.2)
    raise Failed(f"not within {within} s: {what}")


def sh(script, **more):
    """What a shell script prints; its failure is one of this program."""
    return subprocess.run(["sh", "-ec", script], check=True, text=True, stdout=subprocess.PIPE, **more).stdout


def running(*words):
    """Process ids of Skein's programs for Windows that have all these words in their command."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = entry.read_bytes().decode(errors="replace")
        except OSError:
            continue
        # Wine's own programs that start one have its command behind theirs.
        if command.split("\0")[0].endswith("skein.exe") and all(word in command for word in words):
            found.append(int(entry.parent.name))
    return sorted(found)


class Cluster:
    """The operator's PC, which is this one, and the hosts on a bridge with it."""

    def __init__(self, root, own, program, folder):
        """Starts all hosts. `root` is the Debian system with Wine, `own` this PC's program, `program` that for Windows."""
        self.own, self.folder = own, Path(folder)
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        # Names of namespaces are of this PC; nothing of this stays.
        sh("mount -t tmpfs none /run; mkdir -p /run/netns; ip link add lan type bridge; ip link set lan up; "
           f"ip addr add {OPERATOR}/24 dev lan")
        sh(f"for key in key host; do ssh-keygen -q -t ed25519 -N '' -f {self.folder}/$key; done")
        for name, address in ALL.items():
            sh(f"ip netns add {name}; ip link add {name} type veth peer name eth0 netns {name}; ip link set {name} master lan up; "
               f"ip -n {name} addr add {address}/24 dev eth0; ip -n {name} link set eth0 up; ip -n {name} link set lo up")
            self.start(name, root if name in HOSTS else Path("/"))
        self.configure_ssh()
        self.write_cluster(program)

    def configure_ssh(self):
        """Makes `ssh` and `sftp` of `skein cluster` those of this PC, with a configuration of their own."""
        hosts = "".join(f"Host {name}\n HostName {address}\n" for name, address in ALL.items())
        every = {"IdentityFile": self.folder / "key", "UserKnownHostsFile": self.folder / "known", "StrictHostKeyChecking": "no",
                 "LogLevel": "ERROR"}
        settings = "".join(f" {name} {value}\n" for name, value in every.items())
        (self.folder / "config").write_text(f"{hosts}Host *\n{settings}")
        (self.folder / "bin").mkdir()
        for tool in ("ssh", "sftp"):
            path = self.folder / "bin" / tool
            path.write_text(f'#!/bin/sh\nexec /usr/bin/{tool} -F {self.folder}/config "$@"\n')
            path.chmod(0o755)

    def write_cluster(self, program):
        """Writes `cluster.toml`, the scenario for as many vehicles, and the program beside it."""
        shutil.copy(program, self.folder / "skein.exe")
        (self.folder / "scenarios").mkdir()
        text = (Path(__file__).parents[2] / "deploy" / "scenarios" / "hover.toml").read_text()
        (self.folder / "scenarios" / "hover.toml").write_text(text.replace("vehicles = 4", f"vehicles = {len(ALL)}"))
        lines = ['swarm = "lab"', 'scenario = "scenarios/hover.toml"', "[defaults]", 'plant = "builtin"', 'user = "pilot"',
                 'service = "own"']
        for id, (name, address) in enumerate(ALL.items(), 1):
            lines += [f"[node.{id}]", f'host = "{name}"', f'address = "{address}"']
            lines += ['system = "windows"', 'binary = "skein.exe"'] if name in HOSTS else []
        (self.folder / "cluster.toml").write_text("\n".join(lines) + "\n")

    def start(self, name, root):
        """Starts sshd of a host, with an account `pilot` of its own."""
        mine = self.folder / name
        home, keys = mine / "home", mine / "keys"
        for folder in (mine, home, keys):
            folder.mkdir()
        shell = "/bin/sh"
        if name in HOSTS:
            shell = "/usr/local/bin/windows-shell"
            (root / shell[1:]).write_text(SHELL)
            (root / shell[1:]).chmod(0o755)
        accounts = {
            "passwd": ["root:x:0:0:root:/root:/bin/sh", "sshd:x:74:65534::/run/sshd:/usr/sbin/nologin",
                       f"pilot:x:1000:1000::/home/pilot:{shell}"],
            "group": ["root:x:0:", "pilot:x:1000:", "nogroup:x:65534:"],
            "shadow": ["root:*:1::::::", "sshd:*:1::::::", "pilot:*:1::::::"],
        }
        for file, lines in accounts.items():
            (mine / file).write_text("\n".join(lines) + "\n")
        shutil.copy(self.folder / "key.pub", keys / "authorized")
        shutil.copy(self.folder / "host", keys / "host")
        (keys / "sshd_config").write_text(SSHD)
        os.chown(home, 1000, 1000)
        # Nothing of the folders in which these stand is changed.
        mounts = [f'mount -t tmpfs none "{root}/run"', f'mkdir -p "{root}/run/keys" "{root}/run/sshd"',
                  f'mount --bind "{keys}" "{root}/run/keys"', f'mount -t tmpfs none "{root}/home"', f'mkdir "{root}/home/pilot"',
                  f'mount --bind "{home}" "{root}/home/pilot"']
        mounts += [f'mount --bind "{mine / file}" "{root}/etc/{file}"' for file in accounts]
        run = "; ".join([*mounts, f'exec chroot "{root}" /usr/sbin/sshd -D -e -f /run/keys/sshd_config'])
        log = open(mine / "sshd.log", "w")
        subprocess.Popen(["ip", "netns", "exec", name, "unshare", "--mount", "sh", "-ec", run], stdout=log, stderr=log)

    def skein(self, *words, within=300, status=0):
        """What the operator's program prints."""
        env = {**os.environ, "PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}", "HOME": str(self.folder)}
        done = subprocess.run([self.own, *words], cwd=self.folder, env=env, text=True, timeout=within, stdin=subprocess.DEVNULL,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        if done.returncode != status:
            raise Failed(f"skein {' '.join(words)} ended with {done.returncode}:\n{done.stdout[-2500:]}")
        return done.stdout

    def phases(self):
        """The phase of each vehicle, by its node's number."""
        status = json.loads(self.skein("cluster", "status", "--json"))
        return {node["id"]: (node["said"] or {}).get("phase") for node in status["nodes"]}

    def all_fly(self):
        """Waits until all vehicles are in formation."""
        wait("all in formation", lambda: set(self.phases().values()) == {"formation"}, 90)

    def flown(self):
        """Installs, flies, disturbs, updates in flight, lands and uninstalls a swarm; gives what the row of the table says."""
        for name in HOSTS:
            # The first login makes Wine's registry.
            login = [self.folder / "bin" / "ssh", f"pilot@{name}", "ver"]
            subprocess.run(login, check=True, timeout=200, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.skein("cluster", "keys")
        self.skein("cluster", "install", within=600)
        again = self.skein("cluster", "install", within=600)
        if again.count("nothing") + again.count("unchanged") < 3:
            raise Failed(f"a second install is not without changes:\n{again}")
        self.skein("check", "-f", "cluster.toml")
        self.skein("cluster", "up")
        self.all_fly()
        # Its supervisor starts a killed agent again, and the vehicle comes back.
        agents = running("agent", "node-1")
        os.kill(agents[0], signal.SIGKILL)
        wait("the killed agent flies again", lambda: set(running("agent", "node-1")) - set(agents), 30)
        # Another version, beside the one that flies.
        with open(self.folder / "skein.exe", "ab") as program:
            program.write(b"another version")
        self.skein("cluster", "install", within=600)
        self.all_fly()
        logs = self.skein("cluster", "logs")
        self.skein("cluster", "down", within=600)
        self.skein("cluster", "up")
        self.all_fly()
        self.skein("cluster", "down", within=600)
        self.skein("cluster", "uninstall")
        left = [str(path) for name in HOSTS for path in (self.folder / name / "home" / ".skein").glob("**/*")]
        if left:
            raise Failed(f"uninstall has left {left}")
        return f"killed agent restarted, updated in flight, landed, removed; {len(logs.splitlines())} lines of logs"
