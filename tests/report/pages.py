"""Rows and a page parser for the tests of reports."""

from html.parser import HTMLParser

from kinebench_drake.results.row import SampleRow, Status

EVIL = "<script>alert('x')</script>"
VOID = {"meta", "img", "input", "br", "circle", "path", "rect", "polyline", "line", "use"}


class Page(HTMLParser):
    """Collects the addresses that a page would load, its ids, and the tags left open."""

    def __init__(self, text):
        super().__init__()
        self.links, self.open, self.ids, self.scripts = [], [], [], 0
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
    return SampleRow(
        **{
            **{"id": id, "video": f"{id}.mp4", "task": "T", "model": "m", "status": status, "content_hash": "0"},
            **{"reason": None if status is Status.OK else "because", **changes},
        }
    )
