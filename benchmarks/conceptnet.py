"""Reading ConceptNet's dump: lines a second and memory, on generated lines of its format.

    python benchmarks/conceptnet.py --lines 4000000 --out benchmarks/results/conceptnet.csv

The real file has 34,074,917 lines. Generated ones compress better than it does, so unpacking costs
less here.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import json
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from hoi.actions.conceptnet import write_action_space

DUMP_LINES = 34_074_917
RELATIONS = ["RelatedTo"] * 14 + ["Synonym"] * 8 + ["FormOf"] * 5 + ["IsA"] * 3 + ["UsedFor"]
LANGUAGES = ["en"] * 10 + ["fr"] * 11 + ["de", "es", "it", "ja", "ru", "zh"] * 2


def write_dump(path: Path, lines: int) -> None:
    """A block of 20,000 random lines, repeated; one of them is of a chair."""
    rng = np.random.default_rng(0)
    letters = np.array(list("abcdefghijklmnopqrstuvwxyz"))
    block = []
    for number in range(20_000):
        relation, one, two = (
            RELATIONS[rng.integers(len(RELATIONS))],
            *("".join(letters[rng.integers(0, 26, rng.integers(3, 12))]) for _ in range(2)),
        )
        start = f"/c/{LANGUAGES[rng.integers(len(LANGUAGES))]}/{one}/n"
        end = f"/c/{LANGUAGES[rng.integers(len(LANGUAGES))]}/{two}"
        if number == 0:
            relation, start, end = "UsedFor", "/c/en/chair", "/c/en/sitting"
        described = json.dumps(
            {
                "dataset": "/d/wiktionary/en",
                "license": "cc:by-sa/4.0",
                "sources": [
                    {
                        "contributor": "/s/resource/wiktionary/en",
                        "process": "/s/process/wikiparsec/2",
                    }
                ],
                "weight": 1.0,
            }
        )
        block.append(
            f"/a/[/r/{relation}/,{start}/,{end}/]\t/r/{relation}\t{start}\t{end}\t{described}\n"
        )
    block.sort()
    data = "".join(block).encode()
    with gzip.open(path, "wb", compresslevel=6) as stream:
        for _ in range(lines // len(block)):
            stream.write(data)


def main() -> None:
    """Write the dump (not timed), read it, report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--lines", type=int, default=4_000_000)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        dump = Path(folder) / "dump.csv.gz"
        write_dump(dump, options.lines)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        started, cpu = time.perf_counter(), time.process_time()
        _, count = write_action_space(dump, Path(folder) / "actions.tsv")
        wall, used = time.perf_counter() - started, time.process_time() - cpu
        size = dump.stat().st_size
    row = {
        "lines": count.lines,
        "gz_mb": f"{size / 2**20:.0f}",
        "wall_seconds": f"{wall:.1f}",
        "cpu_seconds": f"{used:.1f}",
        "lines_per_cpu_second": f"{count.lines / used:.0f}",
        "minutes_for_the_dump": f"{DUMP_LINES / count.lines * used / 60:.1f}",
        "grown_mb": f"{(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024:.0f}",
    }
    print(row)
    if options.out:
        with options.out.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, list(row), lineterminator="\n")
            writer.writeheader()
            writer.writerow(row)


if __name__ == "__main__":
    main()
