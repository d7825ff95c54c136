"""A ground station that watches a swarm over MAVLink, with independent implementations: pymavlink or MAVSDK.

ground_station.py pymavlink|mavsdk PORT VEHICLES SECONDS LANDED [KEY]
Watches this number of vehicles at this UDP port for some seconds once all fly in formation, then lands one of them, and prints what
it has received as one JSON object. With the file of a key pymavlink signs its messages and believes signed ones only; it then also
holds vehicle 1, lets it fly on, and sends it to land as its mission does. What a vehicle does not send within two minutes ends it with
an error.
"""

import json
import os
import sys
import time

os.environ["MAVLINK20"] = "1"
KIND, PORT, VEHICLES, SECONDS, LANDED = sys.argv[1], *map(int, sys.argv[2:6])
KEY = open(sys.argv[6], "rb").read() if len(sys.argv) > 6 else None
TIMEOUT_S = 120.0


def until(what, found):
    """Calls `found` until it returns something true."""
    end = time.monotonic() + TIMEOUT_S
    while time.monotonic() < end:
        value = found()
        if value:
            return value
    raise SystemExit(f"not received: {what}")


def pymavlink():
    from pymavlink import mavutil

    station = mavutil.mavlink_connection(f"udpin:127.0.0.1:{PORT}", source_system=255, source_component=190, dialect="common")
    mavlink = mavutil.mavlink
    unsigned = []
    if KEY:
        station.setup_signing(KEY, sign_outgoing=True, allow_unsigned_callback=lambda *of: unsigned.append(of) and False)
    modes, states, seen, texts = {}, {}, [], []
    counts, next_numbers, lost = {}, {}, {}

    def receive():
        """The next message; its number must follow that of the one before."""
        message = station.recv_match(blocking=True, timeout=1.0)
        if message is None or message.get_type() == "BAD_DATA":
            if message is not None:
                raise SystemExit(f"bad data: {message}")
            return None
        system, number = message.get_srcSystem(), message.get_seq()
        gap = (number - next_numbers.get(system, number)) % 256
        next_numbers[system] = (number + 1) % 256
        counts[system] = counts.get(system, 0) + 1
        lost[system] = lost.get(system, 0) + gap
        kind = message.get_type()
        if kind == "HEARTBEAT":
            assert message.type == mavlink.MAV_TYPE_HELICOPTER, message
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            modes[system] = (mavutil.mode_string_v10(message), armed)
        elif kind == "EXTENDED_SYS_STATE":
            states[system] = message.landed_state
        elif kind == "STATUSTEXT":
            texts.append(message.text)
        elif kind == "ATTITUDE":
            seen.append({"system": system, "at_ms": time.time() * 1e3, "attitude_rad": [message.roll, message.pitch, message.yaw]})
        elif kind == "GLOBAL_POSITION_INT":
            seen.append({
                "system": system,
                "at_ms": time.time() * 1e3,
                "place": [message.lat / 1e7, message.lon / 1e7, message.alt / 1e3],
                "relative_m": message.relative_alt / 1e3,
                "velocity_ned_m_s": [message.vx / 1e2, message.vy / 1e2, message.vz / 1e2],
            })
        return message

    def answer(kind, fits=lambda message: True):
        message = receive()
        return message if message is not None and message.get_type() == kind and fits(message) else None

    def in_formation():
        receive()
        return len(modes) == VEHICLES and all(mode == ("MISSION", True) for mode in modes.values())

    until("all vehicles in formation", in_formation)
    # From here on every message is counted.
    seen.clear(), counts.clear(), lost.clear()
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        receive()
    watched = {"seen": list(seen), "counts": dict(counts), "lost": dict(lost)}
    station.mav.param_request_list_send(LANDED, 1)
    parameter = until("parameter", lambda: answer("PARAM_VALUE", lambda one: one.get_srcSystem() == LANDED))
    station.mav.mission_request_list_send(LANDED, 1, mavlink.MAV_MISSION_TYPE_FENCE)
    mission = until("mission", lambda: answer("MISSION_COUNT", lambda one: one.get_srcSystem() == LANDED))

    def command(system, number):
        """Sends a command; returns its results, the last of which is final."""
        station.mav.command_long_send(system, 1, number, 0, 0, 0, 0, 0, 0, 0, 0)
        results = []

        def acknowledged():
            message = answer("COMMAND_ACK", lambda one: one.get_srcSystem() == system and one.command == number)
            results.extend([message.result] if message else [])
            return message and message.result != mavlink.MAV_RESULT_IN_PROGRESS

        until("acknowledgement", acknowledged)
        return results

    commanded = []
    if KEY:
        for number, mode in [
            (mavlink.MAV_CMD_NAV_LOITER_UNLIM, "LOITER"),
            (mavlink.MAV_CMD_NAV_TAKEOFF, "MISSION"),
            # The step of the mission that lands.
            (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, "LAND"),
        ]:
            commanded.append([command(1, number)[-1], mode])
            until(f"mode {mode}", lambda: receive() and modes[1][0] == mode)
    results = command(LANDED, mavlink.MAV_CMD_NAV_LAND)
    if results[-1] == mavlink.MAV_RESULT_ACCEPTED:
        until("landing", lambda: receive() and modes[LANDED][0] == "LAND")
        until("ground", lambda: receive() and states[LANDED] == mavlink.MAV_LANDED_STATE_ON_GROUND)
        until("text about the landing", lambda: f"vehicle {LANDED}: landed" in texts or answer("STATUSTEXT") and False)
    else:
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            receive()
    return {
        **watched,
        "parameter": [parameter.param_id, parameter.param_value, parameter.param_count],
        "mission": [mission.count, mission.mission_type],
        "results": results,
        "commanded": commanded,
        "unsigned": len(unsigned),
        "texts": texts,
        "modes": {str(system): mode for system, (mode, _) in modes.items()},
    }


def mavsdk():
    from mavsdk import ComponentType, Configuration, Mavsdk
    from mavsdk.plugins.action import Action
    from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry

    station = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    station.add_any_connection(f"udpin://127.0.0.1:{PORT}")

    def found():
        time.sleep(0.1)
        systems = {system.get_system_id(): system for system in station.get_systems() if system.has_autopilot()}
        return systems if len(systems) == VEHICLES else None

    systems = until("all vehicles", found)
    telemetry = {number: Telemetry(system) for number, system in systems.items()}

    def in_formation():
        time.sleep(0.1)
        return all(one.flight_mode() == FlightMode.MISSION for one in telemetry.values())

    until("all vehicles in formation", in_formation)
    seen = []
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        time.sleep(0.2)
        for number, one in telemetry.items():
            place, attitude, velocity, at_ms = one.position(), one.attitude_euler(), one.velocity_ned(), time.time() * 1e3
            degrees = [attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg]
            seen.append({
                "system": number,
                "at_ms": at_ms,
                "place": [place.latitude_deg, place.longitude_deg, place.absolute_altitude_m],
                "relative_m": place.relative_altitude_m,
                "attitude_rad": [angle * 0.017453292519943295 for angle in degrees],
                "velocity_ned_m_s": [velocity.north_m_s, velocity.east_m_s, velocity.down_m_s],
            })
    armed = all(one.armed() and one.in_air() for one in telemetry.values())
    Action(systems[LANDED]).land()

    def on_ground():
        time.sleep(0.2)
        return telemetry[LANDED].landed_state() == LandedState.ON_GROUND

    until("ground", on_ground)
    modes = {str(number): one.flight_mode().name for number, one in telemetry.items()}
    return {"seen": seen, "armed": armed, "modes": modes}


print(json.dumps({"pymavlink": pymavlink, "mavsdk": mavsdk}[KIND]()), flush=True)
# MAVSDK's own threads do not have to end.
os._exit(0)
