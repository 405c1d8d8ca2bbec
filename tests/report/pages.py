"""Rows, a page parser and a browser for the tests of reports."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

from kinebench_drake.results.row import Status
from tests.rows import make_row

EVIL = "<script>alert('x')</script>"
VOID = {"meta", "img", "input", "br", "circle", "path", "rect", "polyline", "line", "use"}
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WIDTH = 390
"""Width of a phone [px of CSS]."""
WATCH = """<script>window.troubles = []; addEventListener("error", e => troubles.push(e.message));</script>"""


class Page(HTMLParser):
    """Collects the addresses that a page would load, its ids, and the tags left open."""

    def __init__(self, text):
        super().__init__()
        self.links = []
        self.open = []
        self.ids = []
        self.scripts = 0
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self._collect(attributes)
        self.scripts += tag == "script"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self._collect(attributes)

    def _collect(self, attributes):
        self.links += [v for k, v in attributes if k in ("src", "href", "xlink:href", "srcset", "data", "action") if v]
        self.ids += [v for k, v in attributes if k == "id"]

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag


def row(id, status=Status.OK, **changes):
    return make_row(id, status, **{"task": "T", "model": "m", **changes})


def probe(page, script, profile, width=WIDTH):
    """Open a page with a script added to it; returns the state that the script leaves."""
    text = page.read_text().replace("<title>", f"{WATCH}<title>", 1).replace("</body>", f"{script}</body>")
    probed = page.with_name(f"probed-{page.name}")
    probed.write_text(text)
    done = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},844",
         "--enable-logging=stderr",
         "--virtual-time-budget=5000", f"--user-data-dir={profile}", "--dump-dom", probed.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert "CONSOLE" not in done.stderr
    state = json.loads(re.search(r'data-state="([^"]*)"', done.stdout)[1].replace("&quot;", '"'))
    assert state["errors"] == []
    return state
