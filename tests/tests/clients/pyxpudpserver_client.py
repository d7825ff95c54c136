"""Talks to the stand-in by UDP through pyXPUDPServer, which others wrote: one socket per dataref. Fails with an assertion."""

import sys
import time

import pyxpudpserver
from checks import JOYSTICK, LATITUDE, PAUSE, PAUSED, RESUME, succeed, until

port, latitude_deg = int(sys.argv[1]), float(sys.argv[2])
client = pyxpudpserver.pyXPUDPServer
client.initialiseUDP(("127.0.0.1", 0), ("127.0.0.1", port), "xplane-standin-1")
client.start()
until("the beacon", lambda: client.XPalive)
assert client.XPbeacon["port"] == port and client.XPbeacon["version_number"] == 124000, client.XPbeacon
print(f"beacon: {client.statusMsg}")

until("the latitude", lambda: abs(client.getData(LATITUDE) - latitude_deg) < 1e-5)
# The client appends an index to every dataref, also to those that have no elements.
for wanted in (1, 0):
    client.sendXPDref(JOYSTICK, 0, wanted)
    until("the written dataref", lambda: client.getData(JOYSTICK) == wanted)
for command, wanted in ((PAUSE, 1), (RESUME, 0)):
    client.sendXPCmd(command)
    until(command, lambda: client.getData(PAUSED) == wanted)

# Second handles of the client's sockets, which it closes, show whether its subscriptions have ended.
sockets = [own.dup() for own in client.RREF_sockets]
assert len(sockets) == 3
client.quit()
client.join()
time.sleep(0.2)
for own in sockets:
    own.setblocking(False)
    try:
        while True:
            own.recvfrom(2048)
    except BlockingIOError:
        pass
time.sleep(0.5)
for own in sockets:
    try:
        assert not own.recvfrom(2048), "a value after the end of the subscription"
    except BlockingIOError:
        pass
print("UDP: datarefs read and written, commands executed, silence after the subscriptions")
succeed()
