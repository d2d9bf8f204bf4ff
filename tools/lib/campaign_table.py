"""The results of a campaign: rows from berth-sim into one Parquet or CSV file, and the summary.

    with open_results(path, parameters) as results:
        results.add(CSV in bytes)       shard by shard, in the order of their seeds
        summary.add(results.table)      what was just added, as a table
    summary.result()                    a dictionary for JSON
    print_summary(...)
"""

import json
import math
import os
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

TEXTS = ("shape", "drive", "fault", "end", "reason", "wrong")
COUNTS = ("seed", "obstacles", "overlap", "collisions", "steps", "recovered", "blocked")
MODES = ("track", "regulated", "conservative_turn", "conservative_go", "blocked")
BAD_KEPT = 1000
BIN = 0.05  # width of the bins of violation


def read_rows(data):
    """A table of rows as berth-sim writes them; every other column is a number, empty ones are null."""
    header = data.partition(b"\n")[0].decode().split(",")
    types = {name: pa.float64() for name in header}
    types.update({name: pa.string() for name in TEXTS})
    types.update({name: pa.int64() for name in COUNTS})
    options = pa.csv.ConvertOptions(column_types=types, strings_can_be_null=True, null_values=[""])
    return pa.csv.read_csv(pa.BufferReader(data), convert_options=options)


class CsvResults:
    """Byte for byte what one berth-sim would have written."""

    def __init__(self, path):
        self.file = open(path, "wb")
        self.begun = False

    def add(self, data):
        header, _, rows = data.partition(b"\n")
        self.file.write(rows if self.begun else header + b"\n" + rows)
        self.begun = True
        return read_rows(data)

    def close(self):
        self.file.flush()
        os.fsync(self.file.fileno())
        self.file.close()


class ParquetResults:
    """One row group a shard; the parameters are in the file's metadata, under berth."""

    def __init__(self, path, parameters):
        self.path = path
        self.metadata = {"berth": json.dumps(parameters)}
        self.writer = None

    def add(self, data):
        table = read_rows(data)
        if self.writer is None:
            self.writer = pa.parquet.ParquetWriter(
                self.path, table.schema.with_metadata(self.metadata), compression="zstd")
        self.writer.write_table(table.replace_schema_metadata(self.metadata))
        return table

    def close(self):
        self.writer.close()


def open_results(path, parameters):
    """By the ending of the final name; path is where it is written meanwhile."""
    return CsvResults(path) if Path(path).suffixes[-2:-1] == [".csv"] else ParquetResults(path, parameters)


def wilson(hits, count, z=1.959964):
    """The 95 % interval of a rate (Wilson 1927)."""
    if count == 0:
        return 0.0, 1.0
    rate = hits / count
    centre = rate + z * z / (2.0 * count)
    spread = z * math.sqrt(rate * (1.0 - rate) / count + z * z / (4.0 * count * count))
    scale = 1.0 + z * z / count
    low = 0.0 if hits == 0 else (centre - spread) / scale
    high = 1.0 if hits == count else (centre + spread) / scale
    return low, high


def collision_curve(violation, collided):
    """Collision rate over violation, in bins of BIN; those with fewer than 20 runs are left out."""
    bins = np.floor(np.round(violation / BIN, 9)).astype(int)
    curve = []
    for number in np.unique(bins):
        inside = bins == number
        runs, hits = int(inside.sum()), int(collided[inside].sum())
        if runs >= 20:
            low, high = wilson(hits, runs)
            curve.append({"from": round(number * BIN, 9), "to": round((number + 1) * BIN, 9), "runs": runs,
                          "mean_violation": float(violation[inside].mean()), "collided": hits,
                          "rate": hits / runs, "low": low, "high": high})
    return curve


def _quantiles(values):
    if len(values) == 0:
        return None
    picks = np.percentile(values, (50, 99, 100), method="inverted_cdf")
    return dict(zip(("median", "p99", "most"), map(float, picks)))


class Summary:
    """Adds tables up."""

    KEPT = ("seed", "collisions", "min_clearance_m", "recovered", "recovery_time_s",
            "rms_position_error_m", "avoidance_time_s", "standing_s", "violation", "steps", "blocked")

    def __init__(self, bus):
        self.bus = bus
        self.columns = {name: [] for name in self.KEPT}
        self.mode_s = Counter()
        self.faults, self.stops, self.reasons, self.wrongs = Counter(), Counter(), Counter(), Counter()
        self.bad = []
        self.bad_count = 0

    def add(self, table):
        for name in self.KEPT:
            self.columns[name].append(table[name].to_numpy(zero_copy_only=False))
        for mode in MODES:
            self.mode_s[mode] += float(table[f"{mode}_s"].to_numpy().sum())
        if self.bus:
            self._add_bus(table)
        self._add_bad(table)

    def _add_bus(self, table):
        faults, reasons = table["fault"].to_pylist(), table["reason"].to_pylist()
        self.faults.update(faults)
        self.stops.update(fault for fault, reason in zip(faults, reasons) if reason)
        self.reasons.update(reason.partition(": ")[2] or reason for reason in reasons if reason)
        self.wrongs.update(wrong for wrong in table["wrong"].to_pylist() if wrong)

    def _add_bad(self, table):
        """Runs that must not be: collided where the condition holds, or wrong on the bus."""
        seeds = table["seed"].to_pylist()
        rows = zip(seeds, table["collisions"].to_pylist(), table["violation"].to_pylist(),
                   table["wrong"].to_pylist())
        for seed, collisions, violation, wrong in rows:
            what = wrong or ("collided" if collisions and violation <= 0.0 else None)
            if what:
                self.bad_count += 1
                if len(self.bad) < BAD_KEPT:
                    self.bad.append({"seed": seed, "what": what})

    def result(self):
        columns = {name: np.concatenate(parts) for name, parts in self.columns.items()}
        collided = columns["collisions"] > 0
        worst = int(np.argmin(columns["min_clearance_m"]))
        held = columns["violation"] <= 0.0
        result = {
            "runs": len(collided),
            "collided": int(collided.sum()),
            "runs_with_condition": int(held.sum()),
            "collided_with_condition": int((collided & held).sum()),
            "worst_clearance_m": float(columns["min_clearance_m"][worst]),
            "worst_clearance_seed": int(columns["seed"][worst]),
            "recovered": int(columns["recovered"].sum()),
            "recovery_time_s": _quantiles(columns["recovery_time_s"][columns["recovered"] > 0]),
            "rms_position_error_m": _quantiles(columns["rms_position_error_m"]),
            "avoidance_time_s": float(columns["avoidance_time_s"].sum()),
            "standing_s": float(columns["standing_s"].sum()),
            "blocked": int(columns["blocked"].sum()),
            "steps": int(columns["steps"].sum()),
            "mode_time_s": {mode: round(self.mode_s[mode], 6) for mode in MODES},
            "bad": self.bad,
            "bad_count": self.bad_count,
        }
        if self.bus:
            result["stopped"] = sum(self.stops.values())
            result["wrong"] = dict(self.wrongs)
            result["faults"] = {name: {"runs": count, "stopped": self.stops[name]}
                                for name, count in sorted(self.faults.items())}
            result["reasons"] = dict(self.reasons.most_common())
        elif held.sum() < len(held):
            result["curve"] = collision_curve(columns["violation"], collided)
        return result


# --- for people ---------------------------------------------------------------------------------

def _share(count, runs):
    return f"{count:,} ({100.0 * count / runs:.3f} %)"


def _print_bus(result):
    print(f"\nstopped by a fault      {_share(result['stopped'], result['runs'])}")
    print(f"not as it must be       {sum(result['wrong'].values()):,}")
    print(f"\n{'what went wrong':<26}{'runs':>10}{'stopped':>10}")
    for name, counts in result["faults"].items():
        print(f"{name:<26}{counts['runs']:>10,}{counts['stopped']:>10,}")
    print(f"\n{'reasons of the stops':<36}{'runs':>10}")
    for name, count in result["reasons"].items():
        print(f"{name:<36}{count:>10,}")


def _print_curve(curve):
    print(f"\n{'violation':>15}{'runs':>10}{'collided':>10}{'rate':>12}   95 % interval")
    for row in curve:
        print(f"{100 * row['from']:>6.0f} to {100 * row['to']:>3.0f} %{row['runs']:>10,}{row['collided']:>10,}"
              f"{row['rate']:>12.5f}   {row['low']:.5f} to {row['high']:.5f}")


def print_summary(result):
    runs = result["runs"]
    print(f"runs                    {runs:,}")
    print(f"collided                {_share(result['collided'], runs)}")
    if result["runs_with_condition"] < runs:
        print(f"  condition met         {result['collided_with_condition']:,} of "
              f"{result['runs_with_condition']:,}")
    print(f"worst clearance         {1000.0 * result['worst_clearance_m']:.1f} mm "
          f"(seed {result['worst_clearance_seed']})")
    print(f"back on the path        {_share(result['recovered'], runs)}")
    times = result["recovery_time_s"]
    if times:
        print(f"  after                 {times['median']:.2f} s median, {times['p99']:.2f} s 99th percentile, "
              f"{times['most']:.2f} s most")
    print(f"ever blocked            {result['blocked']:,}")
    total = sum(result["mode_time_s"].values())
    for mode in MODES:
        share = 100.0 * result["mode_time_s"][mode] / total if total else 0.0
        print(f"  {mode:<22}{result['mode_time_s'][mode]:,.1f} s ({share:.3f} %)")
    if "faults" in result:
        _print_bus(result)
    if "curve" in result:
        _print_curve(result["curve"])
