"""Reads a run's latency.hlog with HdrHistogram's own Python reader, and compares it with summary.json.

    read_hlog.py FOLDER        needs the package hdrhistogram
"""

import json
import math
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



def value_at(histogram, quantile):
    """The value of rank ceil(quantile * n), by counting: the reader's own percentiles round the rank."""
    rank = max(1, math.ceil(quantile * histogram.get_total_count()))
    counted = 0
    for index in range(histogram.counts_len):
        counted += histogram.get_count_at_index(index)
        if counted >= rank:
            return histogram.get_highest_equivalent_value(histogram.get_value_from_index(index))
    raise AssertionError((quantile, rank, counted))


for hop, figures in expected.items():
    found = sums.pop(hop, None)
    total = found.get_total_count() if found else 0
    assert total == figures["n"], (hop, total, figures["n"])
    if total:
        # The summary names no value above the largest that was measured.
        for quantile, key in [(0.5, "p50"), (0.9, "p90"), (0.99, "p99"), (0.999, "p99_9")]:
            value = min(value_at(found, quantile), figures["max"])
            assert value == figures[key], (hop, key, value, figures[key])
        assert found.get_min_value() == figures["min"], (hop, found.get_min_value(), figures["min"])
        if figures["overflow"] == 0:
            largest = found.get_max_value()
            ends = found.get_lowest_equivalent_value(largest), found.get_highest_equivalent_value(largest)
            assert ends[0] <= figures["max"] <= ends[1], (hop, ends, figures["max"])
assert set(sums) <= {"floor"}, sums.keys()
print(f"{intervals} intervals, {len(expected)} hops to the rank as in the summary")
