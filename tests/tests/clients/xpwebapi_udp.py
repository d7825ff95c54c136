"""Talks to the stand-in by UDP through xpwebapi, which others wrote, at the address of the beacon. Fails with an assertion."""

import sys
import time

import xpwebapi
from checks import JOYSTICK, LATITUDE, PAUSE, PAUSED, RESUME, RUNNING, succeed, until

port, latitude_deg = int(sys.argv[1]), float(sys.argv[2])
monitor = xpwebapi.beacon()
beacon = monitor.get_beacon()
assert (beacon.port, beacon.role, beacon.hostname.rstrip("\0")) == (port, 1, "xplane-standin-1"), beacon
assert beacon.xplane_version == 124000, beacon
print(f"beacon: X-Plane {beacon.xplane_version} on port {beacon.port}")

arrivals = []
udp = xpwebapi.udp_api(host="127.0.0.1", port=port)
# This version of the client calls a function of the monitor that does not exist if it is given to the constructor.
udp.beacon = monitor
udp.add_callback(lambda dataref, value: arrivals.append((time.monotonic(), dataref, value)))
datarefs = {path: udp.dataref(path) for path in (LATITUDE, RUNNING, JOYSTICK, PAUSED)}
for path, dataref in datarefs.items():
    assert udp.monitor_dataref(dataref, frequency_hz=20), path


def value(path):
    udp.read_monitored_dataref_values()
    return udp.xplaneValues.get(path)


until("the latitude in single precision", lambda: abs((value(LATITUDE) or 0) - latitude_deg) < 1e-5)
arrivals.clear()
end = time.monotonic() + 2
while time.monotonic() < end:
    udp.read_monitored_dataref_values()
times = [seen for _, dataref, seen in arrivals if dataref == RUNNING]
assert 35 <= len(times) <= 42 and times == sorted(times), f"20 a second: {len(times)} in 2 s"

for wanted in (1, 0):
    datarefs[JOYSTICK].value = wanted
    assert udp.write_dataref(datarefs[JOYSTICK])
    until("the written dataref", lambda: value(JOYSTICK) == wanted)
for command, wanted in ((PAUSE, 1), (RESUME, 0)):
    assert udp.execute_command(udp.command(command))
    until(command, lambda: value(PAUSED) == wanted)

assert udp.unmonitor_datarefs(datarefs)[0]
time.sleep(0.5)
udp.socket.settimeout(0.5)
while True:
    # What had arrived before the end of the subscription is read first.
    try:
        udp.socket.recvfrom(2048)
    except TimeoutError:
        break
print(f"UDP: {len(times)} values in 2 s, a dataref written, commands executed, silence after the subscription")
succeed()
