"""Reads a run's samples.mcap with the format's own library, and compares it with samples.csv and events.jsonl.

    read_mcap.py FOLDER        needs the packages mcap and mcap-protobuf-support
"""

import csv
import json
import math
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

folder = Path(sys.argv[1])
with open(folder / "samples.csv", newline="") as file:
    rows = list(csv.DictReader(file))
with open(folder / "events.jsonl") as file:
    events = [json.loads(line) for line in file]

with open(folder / "samples.mcap", "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    counts = {summary.channels[id].topic: n for id, n in summary.statistics.channel_message_counts.items()}
    assert counts["/loopbound/record"] == counts["/loopbound/tick"] == len(rows), counts
    assert counts["/loopbound/events"] == len(events), counts
    assert counts["/loopbound/scene"] >= float(rows[-1]["t_s"]) * 25, counts

    previous = 0
    ticks = reader.iter_decoded_messages(topics=["/loopbound/tick"])
    for row, (schema, channel, message, tick) in zip(rows, ticks, strict=True):
        assert (schema.name, schema.encoding, channel.message_encoding) == ("loopbound.Tick", "protobuf", "protobuf")
        assert message.log_time > previous
        previous = message.log_time
        assert tick.tick == int(row["tick"])
        for column, values in (("q", tick.q_rad), ("v", tick.v_rad_s), ("qd", tick.q_d_rad), ("tau", tick.tau_nm)):
            for link, value in enumerate(values, 1):
                assert value == float(row[f"{column}{link}"]), (row["tick"], column, link)
        for column, value in (("V", tick.lyapunov), ("V_bound", tick.lyapunov_promised)):
            assert value == float(row[column]) if row[column] else math.isnan(value), (row["tick"], column)

    # An event whose cause had to be waited for stands later in the file than its time says.
    lines = reader.iter_messages(topics=["/loopbound/events"], log_time_order=False)
    for event, (schema, channel, message) in zip(events, lines, strict=True):
        assert (schema.name, schema.encoding) == ("foxglove.Log", "jsonschema")
        log = json.loads(message.data)
        assert json.loads(log["message"]) == event
        assert log["timestamp"]["sec"] * 10**9 + log["timestamp"]["nsec"] == message.log_time

    for schema, channel, message in reader.iter_messages(topics=["/loopbound/scene"]):
        properties = json.loads(schema.data)["properties"]
        scene = json.loads(message.data)
        assert schema.name == "foxglove.SceneUpdate" and set(scene) == set(properties)
        entity = properties["entities"]["items"]["properties"]
        for found in scene["entities"]:
            assert set(found) == set(entity), set(found) ^ set(entity)
            links = len([name for name in rows[0] if name.startswith("tau")])
            assert len(found["lines"][0]["points"]) == links + 1
print(f"{len(rows)} ticks, {len(events)} events: as in the tables")
