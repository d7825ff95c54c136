"""Reads recordings with the public Python packages and prints one JSON object for each file."""

import json
import math
import sys
from collections import Counter

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def vector(v):
    return [v.x, v.y, v.z]


def turned(q, v):
    """The vector, rotated by the quaternion."""
    u = [q.x, q.y, q.z]
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    t = [2 * c for c in cross(u, v)]
    return [v[i] + q.w * t[i] + cross(u, t)[i] for i in range(3)]


def missing(schema, message):
    """Keys that only one of a JSON schema and a message has. The schema's description names keys of several kinds."""
    described = {name for name in message if f"`{name}`: " in schema.get("description", "")}
    wrong = (set(schema.get("required", [])) ^ set(message)) - described
    for name, inner in schema["properties"].items():
        if inner.get("type") == "object":
            wrong |= missing(inner, message[name])
        if inner.get("type") == "array" and inner["items"].get("type") == "object":
            for item in message[name]:
                wrong |= missing(inner["items"], item)
    return wrong


def nearest_pair_m(last):
    """Least distance between the last positions of the vehicles above two metres, m."""
    up = [trace["position"] for trace in last.values() if trace["height_m"] > 2.0]
    pairs = [math.dist(a, b) for n, a in enumerate(up) for b in up[:n]]
    return min(pairs) if pairs else None


def look(path):
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = {
            "schemas": {},
            "metadata": {record.name: dict(record.metadata) for record in reader.iter_metadata()},
            "attachments": {item.name: item.data.decode() for item in reader.iter_attachments()},
            "first": {},
            "last": {},
            "highest_m": {},
            "upright": {},
            "tilt_deg": 0.0,
            "wrong_keys": [],
            "log": [],
            "events": [],
            "faults": [],
            "scene": [],
            "fixes": {},
        }
        counts, traces, wrong, times, places = Counter(), {}, set(), [], {}
        summary = reader.get_summary()
        # This loop reads JSON; the next one reads Protobuf with its decoder.
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            topic = channel.topic
            counts[topic] += 1
            times.append(message.log_time)
            found["schemas"][topic] = [schema.name, schema.encoding, channel.message_encoding]
            if channel.message_encoding == "json":
                data = json.loads(message.data)
                wrong |= missing(json.loads(schema.data), data)
                if topic.endswith("/trace"):
                    sender = data["header"]["sender"]
                    traces[sender] = data
                    places[f"vehicle/{sender}", message.log_time] = data["position"]
                    tilt = max(abs(data["attitude"]["roll_rad"]), abs(data["attitude"]["pitch_rad"]))
                    found["tilt_deg"] = max(found["tilt_deg"], math.degrees(tilt))
                else:
                    found[topic[1:]].append(data)
        drawn = [topic for topic in counts if found["schemas"][topic][2] == "protobuf"]
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=drawn, log_time_order=False):
            if schema.name == "foxglove.FrameTransforms":
                for t in decoded.transforms:
                    place = vector(t.translation)
                    stamp = t.timestamp.seconds * 10**9 + t.timestamp.nanos
                    entry = {
                        "parent": t.parent_frame_id,
                        "place": place,
                        "forward": turned(t.rotation, [1, 0, 0]),
                        "up": turned(t.rotation, [0, 0, 1]),
                        "is_on_time": stamp == message.log_time,
                    }
                    found["first"].setdefault(t.child_frame_id, entry)
                    found["last"][t.child_frame_id] = entry
                    highest = found["highest_m"].get(t.child_frame_id, place[2])
                    found["highest_m"][t.child_frame_id] = max(highest, place[2])
                    least = found["upright"].get(t.child_frame_id, 1.0)
                    found["upright"][t.child_frame_id] = min(least, entry["up"][2])
            elif schema.name == "foxglove.LocationFix":
                fix = [decoded.latitude, decoded.longitude, decoded.altitude]
                # With the position in the step of the same time.
                found["fixes"][decoded.frame_id] = [fix, places.get((decoded.frame_id, message.log_time))]
            elif schema.name == "foxglove.SceneUpdate":
                found["scene"] += [[channel.topic, e.id, e.frame_id] for e in decoded.entities]
            elif schema.name == "foxglove.Log":
                found["log"].append(decoded.message)
        found["wrong_keys"] = sorted(wrong)
        found["counts"] = counts
        found["messages"] = summary.statistics.message_count
        found["is_ordered"] = times == sorted(times)
        found["span_ns"] = [min(times), max(times)]
        found["nearest_pair_m"] = nearest_pair_m(traces)
        found["state_messages"] = sum(trace["state_messages"] for trace in traces.values())
        found["traces"] = {str(id): trace for id, trace in traces.items()}
        return found


print(json.dumps([look(path) for path in sys.argv[1:]]))
