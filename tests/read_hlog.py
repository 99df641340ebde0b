"""Reads a run's latency.hlog with HdrHistogram's own Python reader, and compares it with summary.json.

    read_hlog.py FOLDER        needs the package hdrhistogram
"""

import json
import sys
from pathlib import Path

from hdrh.histogram import HdrHistogram
from hdrh.log import HistogramLogReader

LARGEST_NS = 10_000_000_000

folder = Path(sys.argv[1])
expected = json.loads((folder / "summary.json").read_text())["latency_ns"]
sums = {}
intervals = 0
reader = HistogramLogReader(str(folder / "latency.hlog"), HdrHistogram(1, LARGEST_NS, 3))
while (interval := reader.get_next_interval_histogram()) is not None:
    intervals += 1
    sums.setdefault(interval.get_tag(), HdrHistogram(1, LARGEST_NS, 3)).add(interval)

for hop, figures in expected.items():
    found = sums.pop(hop, None)
    total = found.get_total_count() if found else 0
    assert total == figures["n"], (hop, total, figures["n"])
    if total:
        for percentile, key in [(50, "p50"), (99, "p99"), (99.9, "p99_9")]:
            value = found.get_value_at_percentile(percentile)
            # Three digits, and the two libraries may name either end of the bucket.
            assert abs(value - figures[key]) <= 2e-3 * figures[key] + 1, (hop, key, value, figures[key])
assert set(sums) <= {"floor"}, sums.keys()
print(f"{intervals} intervals, {len(expected)} hops as in the summary")
