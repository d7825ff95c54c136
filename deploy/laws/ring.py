"""The law "ring" of Skein as another program: even spacing on an ellipse, after Garcia & Barnes 2010, section 4.1.

The field V = (w_in S_in - w_out S_out) g + A - S_perp (A.g) g + w_circ S_perp t, all weights but w_circ one, with
sigmoids for limiting functions. The answer is a dimensionless field: Skein's own conversion makes metres of it.
Parameters (all optional): inner_width_m, outer_width_m, edge_share, avoid_distance_m (else it follows from the number of
live members), full_avoidance, circulation. Radius, gamma and heading of the ellipse come with the goal.
Standard library only.
"""

import json
import sys
from math import cos, exp, hypot, log, pi, sin, sqrt

MAX_AVOIDANCE = 2.0  # a crowd must not expel its members
COINCIDENT_M = 1e-3


def limiting(z):
    """Falls from 1 to 0."""
    return 1.0 / (1.0 + exp(min(z, 700.0)))


def avoidance(own, place, peers, half_m, alpha):
    """A: the push of all neighbours together."""
    north, east = 0.0, 0.0
    for peer in peers:
        away_n = place[0] - peer["position_ned_m"][0]
        away_e = place[1] - peer["position_ned_m"][1]
        distance_m = hypot(away_n, away_e)
        if distance_m < COINCIDENT_M:
            direction = (1.0, 0.0) if own < peer["id"] else (-1.0, 0.0)
        else:
            direction = (away_n / distance_m, away_e / distance_m)
        push = limiting(alpha * (distance_m - half_m))
        north += push * direction[0]
        east += push * direction[1]
    length = hypot(north, east)
    if length > MAX_AVOIDANCE:
        north, east = north * MAX_AVOIDANCE / length, east * MAX_AVOIDANCE / length
    return north, east


def field(ask, parameters):
    """V at the own place, and rho."""
    goal, place = ask["goal"], ask["own"]["position_ned_m"]
    radius_m, gamma, heading = goal["radius_m"], goal["gamma"], goal["heading_rad"]
    inner_m = parameters.get("inner_width_m", 20.0)
    outer_m = parameters.get("outer_width_m", 20.0)
    share = parameters.get("edge_share", 0.01)
    edge = log((1.0 - share) / share)

    # Along the ellipse's own axes.
    from_n = place[0] - goal["centre_ned_m"][0]
    from_e = place[1] - goal["centre_ned_m"][1]
    x = cos(heading) * from_n + sin(heading) * from_e
    y = cos(heading) * from_e - sin(heading) * from_n
    rho_m = sqrt(x * x + gamma * y * y)
    length = hypot(x, gamma * y)
    if length < 1e-6:
        g = (0.0, 0.0)
    else:
        g_x, g_y = x / length, gamma * y / length
        g = (cos(heading) * g_x - sin(heading) * g_y, sin(heading) * g_x + cos(heading) * g_y)

    s_in = limiting(edge / inner_m * (rho_m - (radius_m - inner_m)))
    s_out = 1.0 - limiting(edge / outer_m * (rho_m - (radius_m + outer_m)))
    s_perp = (1.0 - s_in) * (1.0 - s_out)

    live = max(len(ask["peers"]) + 1, 2)
    half_m = parameters.get("avoid_distance_m", radius_m * sqrt(2.0) * sin(pi / live))
    a = avoidance(ask["vehicle"], place, ask["peers"], half_m, edge / half_m)
    along_g = 0.0 if parameters.get("full_avoidance", False) else s_perp * (a[0] * g[0] + a[1] * g[1])
    circulation = parameters.get("circulation", 0.0) * s_perp
    v_n = (s_in - s_out) * g[0] + a[0] - along_g * g[0] - circulation * g[1]
    v_e = (s_in - s_out) * g[1] + a[1] - along_g * g[1] + circulation * g[0]
    return (v_n, v_e), rho_m


def answer(ask, parameters):
    wanted, rho_m = field(ask, parameters)
    goal, own = ask["goal"], ask["own"]
    in_band = -parameters.get("inner_width_m", 20.0) <= rho_m - goal["radius_m"] <= parameters.get("outer_width_m", 20.0)
    velocity, centre = own["velocity_ned_m_s"], goal["centre_velocity_ned_m_s"]
    slow = hypot(velocity[0] - centre[0], velocity[1] - centre[1]) < 0.5
    return {
        "say": "answer",
        "vehicle": ask["vehicle"],
        "tick": ask["tick"],
        "field_ne": wanted,
        "reached": in_band and slow and hypot(*wanted) < 0.15,
        "log": {"rho_m": rho_m},
    }


def main():
    # One program may serve several vehicles, over one connection: the parameters are the same for all.
    parameters = {}
    for line in sys.stdin:
        message = json.loads(line)
        if message["say"] == "hello":
            parameters = message["parameters"]
            reply = {"say": "ready", "protocol": 1}
        elif message["say"] == "ask":
            reply = answer(message, parameters)
        else:
            break
        print(json.dumps(reply), flush=True)


if __name__ == "__main__":
    main()
