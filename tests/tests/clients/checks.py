"""What the programs of the other clients share: names of datarefs and commands, waiting, and ending at once at a fault."""

import os
import sys
import time
import traceback

LATITUDE = "sim/flightmodel/position/latitude"
RUNNING = "sim/time/total_running_time_sec"
JOYSTICK = "sim/operation/override/override_joystick"
PAUSED = "sim/time/paused"
PAUSE, RESUME = "sim/operation/pause_on", "sim/operation/pause_off"


def fail(*error):
    """Ends at once: the client's own threads would keep a failed program alive."""
    traceback.print_exception(*error)
    sys.stderr.flush()
    os._exit(1)


def succeed():
    """Ends at once, whatever threads the client has left."""
    sys.stdout.flush()
    os._exit(0)


def until(what, is_reached, timeout_s=5):
    end = time.monotonic() + timeout_s
    while not is_reached():
        assert time.monotonic() < end, what
        time.sleep(0.02)


sys.excepthook = fail
