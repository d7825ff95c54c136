# The smallest external law: every vehicle flies to the centre. Parameters: gain, 1/s.
import json, sys
for line in sys.stdin:
    m = json.loads(line)
    if m["say"] == "hello":
        gain, reply = m["parameters"]["gain"], {"say": "ready", "protocol": 1}
    elif m["say"] == "ask":
        wanted = [gain * (c - p) for c, p in zip(m["goal"]["centre_ned_m"], m["own"]["position_ned_m"])]
        reply = {"say": "answer", "vehicle": m["vehicle"], "tick": m["tick"], "velocity_ned_m_s": wanted}
    else:
        break
    print(json.dumps(reply), flush=True)
