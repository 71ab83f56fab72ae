"""The index of many frames in Chromium: how large, how soon it can be read, sorted and scrolled.

    python benchmarks/report_page.py --cards 100 1000 --repeats 3

Every card has a thumbnail with a photo's noise, an address, six methods with errors and causes,
and goes through the code that makes the report. Times are the browser's own, from the start of
the navigation, so its start-up does not count: `paint_s` until something is to be seen,
`ready_s` until the page is loaded and its cards can be sorted, `sort_s` for sorting all of them
worst first with the layout that follows, `filter_s` for one filter. Medians of `--repeats` runs,
each with a fresh profile. Writes ``results/report_page.csv``.
"""

from __future__ import annotations

import argparse
import http.server
import json
import queue
import shutil
import statistics
import subprocess
import tempfile
import threading
import urllib.parse
from pathlib import Path

import numpy as np
from measure import rounded, show, write_csv

from hoi.report.causes import CAUSES
from hoi.report.gallery import Card, MethodScore, Problem, gallery_page

METHODS = ("phosa", "paper", "no_action", "no_contact", "no_normal", "ours")
ACTIONS = ("hand", "lift", "sit", "sitstand", "mix")
PROBE = """<script>
window.addEventListener("load", () => requestAnimationFrame(() => setTimeout(() => {
  const seconds = (run) => {
    const start = performance.now();
    run();
    document.body.getBoundingClientRect();
    return (performance.now() - start) / 1000;
  };
  const choose = (control, value) => {
    control.value = value;
    control.dispatchEvent(new Event("change"));
  };
  const ready = performance.now() / 1000;
  const paint = performance.getEntriesByName("first-contentful-paint")[0];
  const told = {
    paint_s: paint ? paint.startTime / 1000 : ready,
    ready_s: ready,
    sort_s: seconds(() => choose(document.getElementById("sort"), "worst 5")),
    filter_s: seconds(() => choose(document.querySelector("select[data-filter=action]"), "sit")),
  };
  new Image().src = "http://127.0.0.1:PORT/?" + encodeURIComponent(JSON.stringify(told));
})));
</script></body>"""


def cards(count: int) -> list[Card]:
    """Cards as a run makes them: noisy thumbnails, long names, errors, causes, some failures."""
    rng = np.random.default_rng(0)
    causes = list(CAUSES)
    found = []
    for number in range(count):
        action = ACTIONS[number % len(ACTIONS)]
        name = f"Date{number % 7:02d}_Sub{number % 5:02d}_chairblack_{action}-t{number:04d}.000"
        if number % 25 == 24:
            stopped = Problem("no_object_detected", "detect", "The best box was a couch, 0.41.")
            scores = {method: MethodScore(problem=stopped, cause=causes[0]) for method in METHODS}
        else:
            errors = rng.gamma(2.0, 9.0, (len(METHODS), 2))
            scores = {
                method: MethodScore(human, thing, cause=causes[-1] if thing > 20 else "")
                for method, (human, thing) in zip(METHODS, errors.tolist(), strict=True)
            }
        found.append(
            Card(name, "behave_mini", "chair", action, f"pages/{name}.html", photo(rng), scores)
        )
    return found


def photo(rng: np.random.Generator) -> np.ndarray:
    """(180, 240, 3) uint8 with edges and noise: WebP makes about what it makes of a photo."""
    coarse = rng.uniform(40, 220, (9, 12, 3))
    picture = np.kron(coarse, np.ones((20, 20, 1))) + rng.normal(0, 5, (180, 240, 3))
    return np.clip(picture, 0, 255).astype(np.uint8)


class Told(http.server.BaseHTTPRequestHandler):
    """Hands what the page says of itself to `answers`."""

    answers: queue.Queue[dict[str, float]] = queue.Queue()

    def do_GET(self) -> None:
        self.answers.put(json.loads(urllib.parse.unquote(self.path[2:])))
        self.send_response(204)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the answers are what is printed."""


def opened(chromium: str, page: Path) -> dict[str, float]:
    """Open the page once in a fresh browser; what it says of itself."""
    with tempfile.TemporaryDirectory() as profile:
        process = subprocess.Popen(
            [
                chromium, "--headless", "--no-sandbox", "--no-first-run", "--disable-gpu",
                "--disable-background-networking", "--window-size=1280,900",
                "--remote-debugging-port=0",  # stay open until the page has spoken
                f"--user-data-dir={profile}/profile", page.as_uri(),
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            return Told.answers.get(timeout=120)
        finally:
            process.terminate()
            process.wait()


def main() -> None:
    """Measure indexes of several sizes and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--cards", type=int, nargs="+", default=[100, 1000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--csv", default="report_page", help="name of the table")
    options = parser.parse_args()
    chromium = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    if chromium is None:
        raise SystemExit("no Chromium: apt-get install chromium")
    rows = []
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Told) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for count in options.cards:
            html = gallery_page(cards(count), heading=f"{count} frames")
            probe = PROBE.replace("PORT", str(server.server_address[1]))
            with tempfile.TemporaryDirectory() as folder:
                page = Path(folder) / "index.html"
                page.write_text(html.replace("</body>", probe), encoding="utf-8")
                runs = [opened(chromium, page) for _ in range(options.repeats)]
            medians = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
            row = {"cards": count, "methods": len(METHODS), "page_mb": rounded(len(html) / 1e6)}
            rows.append(row | {key: rounded(value) for key, value in medians.items()})
            show(rows[-1])
        server.shutdown()
    write_csv(options.csv, rows)


if __name__ == "__main__":
    main()
