"""Talks to the stand-in by UDP through pyXPUDP, which others wrote. Fails with an assertion."""

import socket
import sys

from checks import JOYSTICK, LATITUDE, PAUSE, PAUSED, RESUME, succeed, until
from pyXPUDP import XPConnector

port, latitude_deg = int(sys.argv[1]), float(sys.argv[2])
client = XPConnector("127.0.0.1", send_port=port, listen_freq=50)
# The client subscribes at once a second when it first reads a dataref; this later request has the same index.
for path in (LATITUDE, JOYSTICK, PAUSED):
    client.get_dataref(path)
    client.subscribe_to_dataref(path, freq=10)
assert abs(client.get_dataref(LATITUDE) - latitude_deg) < 1e-5
for wanted in (1, 0):
    client.set_dataref(JOYSTICK, wanted)
    until("the written dataref", lambda: client.get_dataref(JOYSTICK) == wanted)
for command, wanted in ((PAUSE, 1), (RESUME, 0)):
    client.send_command(command)
    until(command, lambda: client.get_dataref(PAUSED) == wanted)

# The end of the connection ends the subscriptions. What had arrived before is read first.
client.close()
client.sock.settimeout(0.5)
left = 0
try:
    while True:
        client.sock.recvfrom(2048)
        left += 1
        assert left < 20, "values after the end of the subscriptions"
except socket.timeout:
    pass
print("UDP: datarefs read and written, commands executed, silence after the subscriptions")
succeed()
