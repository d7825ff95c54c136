"""Talks to the stand-in's Web API through xpwebapi, which others wrote: REST and WebSocket. Fails with an assertion."""

import sys
import threading
import time

import xpwebapi
from checks import JOYSTICK, LATITUDE, PAUSE, PAUSED, RESUME, RUNNING, succeed, until
from xpwebapi.ws import CALLBACK_TYPE

port, latitude_deg = int(sys.argv[1]), float(sys.argv[2])
THROTTLE = "sim/cockpit2/engine/actuators/throttle_ratio"
ACF = "sim/aircraft/view/acf_relative_path"

rest = xpwebapi.rest_api(port=port, api_version="v3")
assert rest.capabilities["api"]["versions"] == ["v1", "v2", "v3"], rest.capabilities
assert rest.xp_version == "12.4.0", rest.xp_version
here = rest.dataref_value(rest.dataref(LATITUDE))
assert abs(here - latitude_deg) < 1e-9, f"exact, not single precision: {here}"
assert rest.dataref_value(rest.dataref(ACF)).startswith(b"Aircraft/Skein/xcell60/xcell60.acf\0")
assert len(rest.dataref_value(rest.dataref(THROTTLE))) == 16
assert not rest.dataref("sim/none").valid
print("REST reads: a double, bytes, an array, and no dataref that does not exist")

joystick = rest.dataref(JOYSTICK)
joystick.value = 1
assert rest.write_dataref(joystick)
until("the written dataref", lambda: rest.dataref_value(rest.dataref(JOYSTICK)) == 1)
latitude = rest.dataref(LATITUDE)
latitude.value = 1.0
assert rest.write_dataref(latitude) is False, "it is read-only"
assert rest.execute_command(rest.command(PAUSE))
until("the pause", lambda: rest.dataref_value(rest.dataref(PAUSED)) == 1)
assert rest.execute_command(rest.command(RESUME))
until("the resumed simulation", lambda: rest.dataref_value(rest.dataref(PAUSED)) == 0)
print("REST writes a dataref and executes commands")

updates, arrived = [], threading.Event()


def on_update(dataref, value):
    updates.append((time.monotonic(), dataref, value))
    arrived.set()


ws = xpwebapi.ws_api(port=port, api_version="v3")
ws.add_callback(CALLBACK_TYPE.ON_DATAREF_UPDATE, on_update)
ws.connect()
assert ws.wait_connection() is not False
ws.start()
running = ws.dataref(RUNNING)
ws.monitor_dataref(running)
assert arrived.wait(5), "no update"
time.sleep(2)
times = [at for at, dataref, _ in updates if dataref == RUNNING]
values = [value for _, dataref, value in updates if dataref == RUNNING]
assert 15 <= len(times) <= 26, f"ten a second: {len(times)} in 2 s"
assert values == sorted(values), "time increases"
ws.unmonitor_dataref(running)
time.sleep(0.5)
count = len(updates)
time.sleep(0.5)
assert len(updates) == count, "silence after the subscription"
print(f"WebSocket: {len(times)} updates in 2 s, then silence")
pause = {"id": rest.command(PAUSE).ident, "is_active": True, "duration": 0.1}
ws.send({"type": "command_set_is_active", "params": {"commands": [pause]}})
until("the pause by WebSocket", lambda: rest.dataref_value(rest.dataref(PAUSED)) == 1)
ws.send({"type": "dataref_set_values", "params": {"datarefs": [{"id": joystick.ident, "value": 0}]}})
until("the dataref by WebSocket", lambda: rest.dataref_value(rest.dataref(JOYSTICK)) == 0)
print("WebSocket writes a dataref and activates a command")
ws.disconnect()
succeed()
