"""Pages in a real browser, without a network: the 3D view draws, nothing is asked for."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import socketserver
import subprocess
import threading
import time
from html import unescape as html_text
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from PIL import Image

import report_synthetic as synthetic
from hoi.report.config import ReportConfig
from hoi.report.gallery import gallery_page
from hoi.report.page import frame_page
from hoi.report.tables import LaidOutTable, as_html
from test_report_gallery import good, half, lost

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM = next((path for path in map(shutil.which, NAMES) if path), None)
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium"),
]

CONFIG = ReportConfig(image_width=160, tile_width=64, supersampling=1)
QUIET = (
    "--headless",
    "--no-sandbox",
    "--hide-scrollbars",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--no-first-run",
    "--disable-domain-reliability",
    "--disable-features=OptimizationHints,MediaRouter",
    "--enable-logging=stderr",
)


@pytest.fixture(scope="module")
def requests():
    """A proxy that answers nothing and remembers who knocked: every request would land here."""
    seen: list[bytes] = []

    class Knock(socketserver.StreamRequestHandler):
        def handle(self):
            seen.append(self.rfile.readline())

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Knock) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield seen, server.server_address[1]
        server.shutdown()


@pytest.fixture
def browse(requests, tmp_path):
    """Open HTML from a file; returns (dumped DOM or None, screenshot or None, console lines)."""
    seen, port = requests
    seen.clear()

    def run(html: str, size: tuple[int, int], shot: bool) -> tuple[str, np.ndarray | None, list]:
        source, picture = tmp_path / "page.html", tmp_path / "page.png"
        source.write_text(html, encoding="utf-8")
        command = [
            str(CHROMIUM),
            *QUIET,
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--proxy-server=http://127.0.0.1:{port}",
            "--proxy-bypass-list=<-loopback>",
            f"--window-size={size[0]},{size[1]}",
            "--virtual-time-budget=6000",
            f"--screenshot={picture}" if shot else "--dump-dom",
            source.as_uri(),
        ]
        environment = os.environ | {"HOME": str(tmp_path)}
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=150, env=environment, check=False
        )
        console = [line for line in done.stderr.splitlines() if ":CONSOLE" in line]
        image = np.asarray(Image.open(picture).convert("RGB")) if shot else None
        return done.stdout, image, console

    return run


@pytest.fixture
def told(requests, tmp_path):
    """Open HTML that calls `tell(data)` in a browser that draws as time goes by; returns the data.

    `browse` lets time jump, and what waits for a page to be drawn then never happens.
    """
    seen, port = requests
    seen.clear()
    tell = """<script>const tell = (data) => { new Image().src =
      "http://told.invalid/?" + encodeURIComponent(JSON.stringify(data)) + "&"; };</script>"""

    def run(html: str) -> dict:
        source = tmp_path / "page.html"
        source.write_text(html.replace("</head>", tell + "</head>", 1), encoding="utf-8")
        process = subprocess.Popen(
            [
                str(CHROMIUM),
                *QUIET,
                f"--user-data-dir={tmp_path / 'profile'}",
                f"--proxy-server=http://127.0.0.1:{port}",
                "--window-size=1280,900",
                "--remote-debugging-port=0",  # stays open
                source.as_uri(),
            ],
            stderr=subprocess.DEVNULL,
            env=os.environ | {"HOME": str(tmp_path)},
        )
        try:
            for _ in range(600):
                for line in seen:
                    if found := re.search(rb"told.invalid/\?([^&]+)&", line):
                        return json.loads(unquote(found[1].decode()))
                time.sleep(0.1)
            raise AssertionError("the page told nothing within a minute")
        finally:
            process.terminate()
            process.wait()

    return run


@pytest.fixture(scope="module")
def page() -> str:
    return frame_page(
        synthetic.frame(),
        synthetic.detection(),
        [synthetic.method("phosa", x=0.9), synthetic.method("ours")],
        synthetic.person()[1],
        synthetic.exemplars(),
        CONFIG,
        truth=synthetic.truth(),
    )


NOTHING_BUT_ITSELF = (
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
    "script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:\">"
)


def sealed(html: str) -> str:
    """The page under a policy that forbids every request; an attempt is a console error."""
    return html.replace('<meta charset="utf-8">', '<meta charset="utf-8">' + NOTHING_BUT_ITSELF, 1)


def of_the_page(requests) -> list[bytes]:
    """Requests that are not the browser's own; those of the page are told by `sealed` too."""
    return [line for line in requests[0] if b"google" not in line]


def orange(image: np.ndarray) -> np.ndarray:
    """Pixels of the chair's colour as the viewer lights it."""
    r, g, b = (image[..., k].astype(int) for k in range(3))
    return (r > 150) & (r - b > 70) & (r - g > 25) & (g > 80)


def blue(image: np.ndarray) -> np.ndarray:
    r, g, b = (image[..., k].astype(int) for k in range(3))
    return (b - r > 30) & (b > 120) & (g > r)


def only_view(page: str) -> str:
    """The page with everything but the 3D view hidden, so that pixels are the view's."""
    return page.replace(
        "</style>",
        "#view{position:fixed!important;inset:0;height:100vh!important;z-index:9}</style>",
        1,
    )


def test_the_3d_view_draws_body_and_object_from_a_file_without_a_network(browse, page, requests):
    _, image, console = browse(sealed(only_view(page)), (600, 450), True)
    assert blue(image).mean() > 0.02 and orange(image).mean() > 0.01
    assert not [line for line in console if "rror" in line or "iolat" in line], console
    assert of_the_page(requests) == []


def test_a_request_would_have_been_noticed(browse, page, requests):
    asks = '<img src="http://example.invalid/a.png" alt=""></body>'
    _, _, console = browse(sealed(page).replace("</body>", asks), (600, 450), True)
    assert any("Content Security Policy" in line for line in console)
    browse(page.replace("</body>", asks), (600, 450), True)
    assert any(b"example.invalid" in line for line in of_the_page(requests))


def test_the_3d_view_reports_itself_ready(browse, page):
    dom, _, _ = browse(page, (800, 600), False)
    assert 'data-viewer="ready"' in dom
    assert re.search(r'data-method="ours" aria-pressed="true"', dom)


def test_buttons_switch_method_view_and_parts(browse, page):
    press = """<script>
      const wait = setInterval(() => {
        if (document.documentElement.dataset.viewer !== "ready") return;
        clearInterval(wait);
        for (const q of ["[data-method=phosa]", "[data-view=top]", "[data-part=body]"])
          document.querySelector("button" + q).click();
      }, 50);</script></body>"""
    _, image, _ = browse(only_view(page).replace("</body>", press), (600, 450), True)
    assert blue(image).mean() < 0.001  # the body is hidden
    assert orange(image).mean() > 0.01
    rows, columns = np.nonzero(orange(image))
    box = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert 0.8 < box[0] / box[1] < 1.25  # from above the chair is a square


def test_the_page_works_as_snakemakes_report_shows_it(browse, page, requests):
    """Snakemake opens an HTML result as a data: URL in an iframe."""
    encoded = base64.b64encode(sealed(only_view(page)).encode()).decode()
    frame = (
        '<!doctype html><body style="margin:0"><iframe style="border:0;width:600px;height:450px" '
        f'src="data:text/html;base64,{encoded}"></iframe></body>'
    )
    _, image, console = browse(frame, (600, 450), True)
    assert blue(image).mean() > 0.02 and orange(image).mean() > 0.01
    assert not [line for line in console if "rror" in line or "iolat" in line], console
    assert of_the_page(requests) == []


def test_a_browser_without_webgl_keeps_the_pictures_and_says_why(browse, page):
    broken = "<script>HTMLCanvasElement.prototype.getContext = () => null;</script>\n"
    without = page.replace("<script>\n//", broken + "<script>\n//", 1)
    assert without != page
    dom, _, _ = browse(without, (800, 600), False)
    assert 'data-viewer="failed"' in dom and "The 3D view is not available here" in dom


def test_nothing_is_wider_than_a_phone(browse, page):
    probe = """<script>const root = document.documentElement;
      root.dataset.wide = root.scrollWidth > root.clientWidth;</script></body>"""
    for html in (page, gallery_page([good("a" * 80), lost("b"), half("c")])):
        framed = base64.b64encode(html.replace("</body>", probe).encode()).decode()
        # Chromium's window has a least width, an iframe has none.
        outer = f"""<body><iframe id="phone" style="width:360px;height:700px"></iframe><script>
          const raw = Uint8Array.from(atob("{framed}"), (c) => c.charCodeAt(0));
          const phone = document.getElementById("phone");
          phone.onload = () => {{
            const root = phone.contentDocument.documentElement;
            if (root.dataset.wide) document.body.dataset.wide = root.dataset.wide;
          }};
          phone.srcdoc = new TextDecoder().decode(raw);</script></body>"""
        dom, _, _ = browse(outer, (800, 800), False)
        assert 'data-wide="false"' in dom


def test_the_gallery_sorts_worst_first_and_filters(browse, requests):
    cards = [good("small", 5.0), good("large", 50.0), lost("none"), good("middle", 20.0)]
    act = """<script>
      const order = document.getElementById("sort");
      order.value = "worst 1"; order.dispatchEvent(new Event("change"));
      const status = document.querySelector("select[data-filter=status]");
      const names = () => Array.from(document.querySelectorAll(".card"))
        .filter((card) => card.style.display !== "none")
        .map((card) => card.querySelector(".id").textContent).join(" ");
      document.body.dataset.worst = names();
      status.value = "ok"; status.dispatchEvent(new Event("change"));
      order.value = "best 1"; order.dispatchEvent(new Event("change"));
      document.body.dataset.best = names();
    </script></body>"""
    dom, _, console = browse(sealed(gallery_page(cards)).replace("</body>", act), (900, 700), False)
    assert 'data-worst="none large middle small"' in dom
    assert 'data-best="small middle large"' in dom
    assert "3 of 4 shown" in dom and not console
    assert of_the_page(requests) == []


def test_the_address_chooses_order_filters_and_causes(browse, tmp_path):
    """Numbers of tables and of causes are links to their frames on the same page."""
    cards = [good("small", 5.0), good("large", 50.0), lost("none"), good("middle", 30.0)]
    act = """<script>
      const names = () => Array.from(document.querySelectorAll(".card"))
        .filter((card) => card.style.display !== "none")
        .map((card) => card.querySelector(".id").textContent).join(" ");
      const steps = [["a", "#order=worst:ours"], ["b", "#cause=placement&method=ours"],
                     ["c", "#cause=detection"], ["d", "#status=ok&order=best:ours"]];
      const next = () => {
        if (!steps.length) {
          document.getElementById("clear").click();
          document.body.dataset.e = names();
          return;
        }
        const [key, hash] = steps.shift();
        const told = () => { document.body.dataset[key] = names(); next(); };
        window.addEventListener("hashchange", told, { once: true });
        location.hash = hash;
      };
      next();
    </script></body>"""
    dom, _, console = browse(gallery_page(cards).replace("</body>", act), (900, 700), False)
    for told in (
        'data-a="none large middle small"', 'data-b="large middle"', 'data-c="none"',
        'data-d="small middle large"', 'data-e="small large none middle"',
    ):  # fmt: skip
        assert told in dom, told
    assert not console


def test_only_pictures_near_the_window_are_read(told):
    """A thousand cards open at once because a card far below costs no picture."""
    act = """<script>
      const read = () => Array.from(document.querySelectorAll(".card img"))
        .map((img) => img.hasAttribute("src"));
      const until = (holds, then) => {
        if (holds()) then();
        else setTimeout(until, 50, holds, then);
      };
      until(() => read().some(Boolean), () => setTimeout(() => {
        const first = read(), count = first.filter(Boolean).length;
        const seen = Array.from(document.querySelectorAll(".card")).filter((card) =>
          card.getBoundingClientRect().top < innerHeight).length;
        const gapless = first.lastIndexOf(true) === count - 1;
        document.querySelector(".card:last-child").scrollIntoView();
        until(() => read()[299], () => tell({ seen: seen, read: count, gapless: gapless }));
      }, 200));
    </script></body>"""
    cards = [good(f"card{number:04d}") for number in range(300)]
    answer = told(gallery_page(cards).replace("</body>", act))
    assert 0 < answer["seen"] <= answer["read"] <= 60 and answer["gapless"]


def test_tables_of_the_index_are_not_cut_on_a_laptop(browse):
    heads = ("H", "O", "med.", "fail")
    numbers = ("10.3 (10.7)", "140.8 (116.5)", "137.8", "10 %") * 2 + ("24",)
    groups = (("PHOSA", heads), ("Ours", heads), ("", ("n",)))
    table = as_html(LaidOutTable("Chairs", "Words " * 60, "Action", groups, (("Sit", numbers),)))
    probe = """<script>
      const box = document.querySelector(".tables .scroll");
      document.body.dataset.cut = box.scrollWidth > box.clientWidth;</script></body>"""
    html = gallery_page([good("a")], tables=[table, table]).replace("</body>", probe)
    dom, _, _ = browse(html, (1280, 900), False)
    assert 'data-cut="false"' in dom


UNNAMED = """<script>
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  const all = (query) => Array.from(document.querySelectorAll(query));
  const named = (e) => e.textContent.trim() || e.getAttribute("aria-label") || e.title ||
    (e.labels && e.labels.length) || e.querySelector("img[alt]:not([alt=''])");
  const wrong = [
    ...all("img:not([alt])"), ...all("svg:not([role=img][aria-label]):not([aria-hidden])"),
    ...all("button, select, input, a[href]:not([aria-hidden]), summary").filter((e) => !named(e)),
    ...all("a[href][aria-hidden]:not([tabindex='-1'])"),
    ...all("th").filter((e) => !e.scope || !e.textContent.trim()),
    ...all("[role=group]:not([aria-label])"),
    ...all(".scroll").filter((e) => e.scrollWidth > e.clientWidth && e.tabIndex < 0),
  ].map((e) => e.outerHTML.slice(0, 80));
  const ids = all("[id]").map((e) => e.id), heads = all("h1, h2, h3").map((e) => +e.tagName[1]);
  if (new Set(ids).size !== ids.length) wrong.push("an id twice");
  if (heads[0] !== 1 || heads.some((level, k) => k && level > heads[k - 1] + 1))
    wrong.push("headings out of order");
  if (!document.documentElement.lang || !document.querySelector("main")) wrong.push("no main");
  const told = document.createElement("pre");
  told.id = "wrong";
  told.textContent = JSON.stringify(wrong);
  document.body.append(told);
</script></body>"""


@pytest.mark.parametrize("which", ["frame", "index"])
def test_screen_readers_and_keyboards_find_names_headings_and_every_scroller(browse, page, which):
    table = as_html(LaidOutTable("T", "", "Action", (("", ("n",)),), (("Sit", ("1",)),)))
    cards = [good("small", 5.0), good("large", 50.0), lost("none"), half("middle")]
    source = page if which == "frame" else gallery_page(cards, tables=[table])
    dom, _, _ = browse(source.replace("</body>", UNNAMED), (500, 800), False)
    found = re.search(r'<pre id="wrong">(.*?)</pre>', dom, re.DOTALL)
    assert found is not None and html_text(found[1]) == "[]"


def test_screenshots_are_kept(browse, page):
    """Pictures of each kind of page for people to look at: results/screenshots."""
    folder = Path(__file__).parents[1] / "results" / "screenshots"
    folder.mkdir(parents=True, exist_ok=True)
    cards = [good("small", 5.0), good("large", 50.0), lost("none"), half("middle")]
    for name, html, size in (
        ("frame", page, (1280, 1500)),
        ("frame_phone", page, (500, 1400)),
        ("index", gallery_page(cards, heading="All frames"), (1280, 1300)),
    ):
        _, image, _ = browse(html, size, True)
        assert image.std() > 10
        Image.fromarray(image).save(folder / f"{name}.png")


def test_gallery_links_are_plain_text_inside_a_report(browse):
    """A result shown in an iframe has no folder around it: a relative link would lead nowhere."""
    encoded = base64.b64encode(gallery_page([good("a")]).encode()).decode()
    outer = f"""<body><iframe id="report"></iframe><script>
      const report = document.getElementById("report");
      report.onload = () => {{
        const links = report.contentDocument.querySelectorAll("a.page");
        if (links.length) document.body.dataset.links =
          `${{links.length}} ${{Array.from(links).filter((a) => a.hasAttribute("href")).length}}`;
      }};
      report.srcdoc = new TextDecoder().decode(
        Uint8Array.from(atob("{encoded}"), (c) => c.charCodeAt(0)));</script></body>"""
    dom, _, console = browse(outer, (400, 300), False)
    assert 'data-links="2 0"' in dom and not console
