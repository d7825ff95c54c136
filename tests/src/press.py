"""Runs on Windows, in a console: starts a program, and sends it an event of that console after a while.

    press.py EVENT SECONDS OUT PROGRAM...

EVENT is `ctrl-c`, `ctrl-break` or `close`; what the program writes goes into the file OUT. The exit status is that of the program.

Wine's console sends no event but Ctrl-C. The others come as Windows itself brings them to a program: a thread of the program that
runs `CtrlRoutine` of kernelbase with the number of the event. After 5 s Windows ends a program whose console was closed.
"""

import ctypes
import subprocess
import sys
import time

#: The events' numbers, as a handler of a console receives them.
EVENTS = {"ctrl-c": 0, "ctrl-break": 1, "close": 2}
#: How long Windows lets a program live whose console was closed, s.
AFTER_CLOSE_S = 5
ALL_ACCESS = 0x1FFFFF


def send(event, child):
    """Sends an event to a program of this console; whether it was taken."""
    kernel = ctypes.windll.kernel32
    if event == EVENTS["ctrl-c"]:
        return kernel.GenerateConsoleCtrlEvent(event, 0)
    for function in (kernel.OpenProcess, kernel.CreateRemoteThread):
        function.restype = ctypes.c_void_p
    routine = ctypes.cast(ctypes.WinDLL("kernelbase").CtrlRoutine, ctypes.c_void_p)
    process = ctypes.c_void_p(kernel.OpenProcess(ALL_ACCESS, 0, child.pid))
    return kernel.CreateRemoteThread(process, None, ctypes.c_size_t(0), routine, ctypes.c_void_p(event), 0, None)


def main():
    event, seconds, out, *command = sys.argv[1:]
    with open(out, "wb") as written:
        child = subprocess.Popen(command, stdout=written, stderr=written)
        # This program continues, whatever comes.
        handler = ctypes.WINFUNCTYPE(ctypes.c_int, ctypes.c_uint)(lambda _event: 1)
        ctypes.windll.kernel32.SetConsoleCtrlHandler(handler, 1)
        time.sleep(float(seconds))
        if not send(EVENTS[event], child):
            child.kill()
            sys.exit("the event was not taken")
        if event == "close":
            time.sleep(AFTER_CLOSE_S)
            child.kill()
        sys.exit(child.wait())


main()
