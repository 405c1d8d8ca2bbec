"""The html report: one file, safe against its content, readable without a finished run."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import make_pose
from kinebench_drake.products import GripperTrack, IkStatus, JointTrack
from kinebench_drake.report import page, write_report
from kinebench_drake.report.plot import Band, Curve, draw_plot
from kinebench_drake.results import ResultStore
from kinebench_drake.row import SampleRow, Status
from kinebench_drake.trackfile import write_track

EVIL = "<script>alert('x')</script>"
VOID = {"meta", "img", "input", "br", "circle", "path", "rect", "polyline", "line"}


class Page(HTMLParser):
    """Collects what a page would load, and whether its tags balance."""

    def __init__(self, text):
        super().__init__()
        self.links, self.open, self.scripts = [], [], 0
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.links += [v for k, v in attributes if k in ("src", "href", "xlink:href", "srcset", "data", "action") if v]
        self.scripts += tag == "script"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        pass

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


@pytest.fixture
def out(tmp_path):
    """An output folder with a sample of every kind."""
    n = 9
    X = make_pose(np.broadcast_to(np.eye(3), (n, 3, 3)), np.linspace(0, 1, 3 * n).reshape(n, 3))
    X[4] = np.nan
    on = np.isfinite(X[:, 0, 0])
    track = GripperTrack(
        t_s=np.arange(n) * 0.2, X_CH=X, X_BG=X, tracked=on, confidence=on * 0.9, finger_width_m=np.full(n, 0.04)
    )
    violation = {
        "kind": "velocity",
        "frame_start": 2,
        "frame_end": 3,
        "joint": "panda_joint2",
        "value": 3.0,
        "limit": None,
    }
    vanish = {"kind": "vanish", "frame_start": 4, "frame_end": 4, "severity": 1.0}
    good = {"tracked_fraction": 8 / 9, "sparc": -1.5, "ik_success_rate": 1.0, "anomalies": []}
    with ResultStore(tmp_path) as store:
        for r in (
            row("good", feasible=True, metrics=good),
            row("shaky", feasible=True, metrics={**good, "anomalies": [vanish], "tracked_fraction": 0.5}),
            row("bad", feasible=False, metrics={**good, "sparc": None}, violations=(violation,)),
            row("unknown", feasible=None, metrics=good),
            row("dark", Status.UNMEASURABLE, reason="no robot", metrics={"sparc": None}),
            row("evil", Status.ERROR, reason=EVIL, task=EVIL, model=EVIL, video=EVIL),
        ):
            store.append(r, 0.1)
            if r.status is Status.OK:
                write_track(tmp_path / "tracks" / f"{r.id}.npz", track, None, {})
        tags = {"note": EVIL}
        store.finish({"kind": "score", "tags": tags, "config": {"source": EVIL}, "seeds": {"bootstrap": 0}})
    return tmp_path


def test_the_page_stands_alone_and_its_tags_balance(out):
    text = write_report(out).read_text()
    page = Page(text)
    assert page.open == []
    assert all(link.startswith("data:image/jpeg;base64,") for link in page.links)
    assert not re.search(r"https?://|url\(|@import", text)
    assert str(out) not in text


def test_nothing_from_outside_is_taken_for_html(out):
    text = write_report(out).read_text()
    assert Page(text).scripts == 1
    assert EVIL not in text
    assert text.count("&lt;script&gt;") >= 5


def test_the_worst_comes_first(out):
    text = write_report(out).read_text()
    assert re.findall(r'aria-expanded="false">(\w+)<', text) == ["evil", "bad", "dark", "unknown", "shaky", "good"]


def test_numbers_come_with_interval_and_coverage(out):
    text = re.sub(r"\s+", " ", write_report(out).read_text())
    tile = text[text.index("Feasible for the robot") :]
    assert re.match(
        r"Feasible for the robot</span><b>67%</b> <div class=\"note\">95% interval 21% to 94%<br>3 of 6", tile
    )
    sparc = text[text.index('<span class="name">SPARC') :]
    assert re.match(r'<span class="name">SPARC</span><b>-1.50</b> <div class="note">all samples alike<br>3 of 6', sparc)


def test_the_same_folder_gives_the_same_bytes(out):
    first = write_report(out).read_bytes()
    assert write_report(out).read_bytes() == first


def test_both_colour_schemes_are_there(out):
    text = write_report(out).read_text()
    assert "prefers-color-scheme: dark" in text
    light, dark = (
        set(re.findall(r"(--[\w]+):", block)) for block in re.findall(r":root \{(.*?)\}", text, re.DOTALL)[:2]
    )
    assert dark
    assert dark == light


def test_an_unfinished_run_has_a_report_too(out):
    (out / "results.json").unlink()
    assert "has not been finished" in write_report(out).read_text()


def test_a_run_without_a_measured_sample_has_a_report(tmp_path):
    with ResultStore(tmp_path) as store:
        store.append(row("dark", Status.UNMEASURABLE, metrics={"sparc": None}), 0.1)
        store.finish({})
    assert "0 / 1" in write_report(tmp_path).read_text()


def test_damaged_files_are_told(out):
    (out / "tracks" / "good.npz").write_bytes(b"PK broken")
    with pytest.raises(InputError, match=r"good\.npz"):
        write_report(out)


def points(svg):
    return [
        [tuple(map(float, p.split(","))) for p in line.split()]
        for line in re.findall(r'<polyline[^>]*points="([^"]+)"', svg)
    ]


def test_curves_break_where_nothing_is_known_and_stay_inside():
    t = np.arange(10) * 0.2
    values = np.array([0.0, 1.0, 2.0, np.nan, 4.0, 5.0, np.nan, 7.0, np.nan, np.nan])
    svg = draw_plot(
        "p", t, [Curve(label="a", values=values, css="c0")], [Band(label="b", start=-5, end=99, css="anomaly")]
    )
    lines = points(svg)
    assert [len(line) for line in lines] == [3, 2]
    assert svg.count("<circle") == 1
    ys = [y for line in lines for _, y in line]
    assert ys == sorted(ys, reverse=True)  # greater is higher
    assert all(0 <= x <= 430 and 0 <= y <= 128 for line in lines for x, y in line)


@pytest.mark.parametrize("values", [np.full(5, np.nan), np.zeros(5), np.full(5, 1e9), np.array([0, 1e-12, 0, 0, 0])])
def test_plots_of_nothing_much(values):
    svg = draw_plot("p", np.arange(5) * 1.0, [Curve(label="a", values=values, css="c0")])
    assert "nan" not in svg
    assert "inf" not in svg


def test_long_curves_are_thinned():
    t = np.arange(5000) * 0.01
    (line,) = points(draw_plot("p", t, [Curve(label="a", values=np.sin(t), css="c0")]))
    assert 100 < len(line) <= 400


def test_peaks_survive_the_thinning():
    t = np.arange(5000) * 0.01
    values = np.zeros(5000)
    values[3211] = 7.0
    (line,) = points(draw_plot("p", t, [Curve(label="a", values=values, css="c0")], limits=(0.0, 7.0)))
    assert min(y for _, y in line) == 8.0


def test_a_gap_in_a_long_curve_stays_a_gap():
    t = np.arange(5000) * 0.01
    values = np.sin(t)
    values[2500] = np.nan
    assert len(points(draw_plot("p", t, [Curve(label="a", values=values, css="c0")]))) == 2


@pytest.fixture
def audit(tmp_path):
    """An output folder of an audit: no pictures, limits in the rows, one replay."""
    n = 30
    X = make_pose(np.broadcast_to(np.eye(3), (n, 3, 3)), np.linspace(0, 1, 3 * n).reshape(n, 3))
    track = GripperTrack(
        t_s=np.arange(n) * 0.1,
        X_CH=X * np.nan,
        X_BG=X,
        tracked=np.ones(n, dtype=bool),
        confidence=np.ones(n),
        finger_width_m=np.full(n, np.nan),
    )
    joints = JointTrack(
        t_s=track.t_s,
        q=np.outer(np.sin(track.t_s), np.ones(7)),
        status=(IkStatus.OK,) * n,
        position_error_m=np.zeros(n),
        rotation_error_rad=np.zeros(n),
    )
    limits = {"joints": [f"j{k}" for k in range(1, 8)], "position": {"lower": [-2.0] * 7, "upper": [2.0] * 7}}
    details = {"limits": {**limits, "velocity": [1.1] * 7}, "noise": {"position_m": 0.0015}}
    speed = {"kind": "velocity", "frame_start": 4, "frame_end": 9, "joint": "j2", "value": 2.2, "limit": 1.1}
    bump = {"kind": "velocity", "frame_start": 6, "frame_end": 12, "joint": "j3", "value": 1.2, "limit": 1.1}
    with ResultStore(tmp_path) as store:
        for id, violations in (("slow", ()), ("fast", (speed, bump))):
            store.append(
                row(
                    id,
                    feasible=not violations,
                    violations=violations,
                    details=details,
                    null_reasons={"jerk_ratio_max": "the noise hides it"},
                    metrics={"ik_success_rate": 1.0, "slowdown_min": 0.9, "noise_floor": 0.25},
                    extra={"frames": n, "duration_s": 2.9, "format": "npz", "warnings": [EVIL]},
                ),
                0.1,
            )
            curves = {
                "velocity": np.outer(np.cos(track.t_s), np.ones(7)),
                "manipulability": np.full(n, 0.1),
                "table_distance_m": np.full(n, 0.02),
            }
            write_track(tmp_path / "tracks" / f"{id}.npz", track, joints, curves)
        store.finish(
            {
                "kind": "audit",
                "config": {"source": "tracks"},
                "normalization": {"noise_floor": {"low": 0.2, "high": 0.4, "mean": 0.25, "n": 2}},
            }
        )
    (tmp_path / "replays").mkdir(exist_ok=True)
    (tmp_path / "replays" / "fast.html").write_text("3D")
    return tmp_path


def section(text, id):
    """The part of the page that belongs to a sample."""
    return next(part for part in text.split('<tbody class="sample"')[1:] if f">{id}</button>" in part)


def test_an_audit_has_no_column_of_pictures(audit):
    text = write_report(audit).read_text()
    assert "trajectory audit" in text
    assert 'class="none"' not in text
    assert "<img" not in text
    table = text[text.index('<table id="samples">') :]
    heads = re.findall(r"<th[ >]", table[: table.index("</thead>")])
    cells = re.findall(r"<td[ >]", table[table.index("<tbody") : table.index('<tr class="detail"')])
    assert len(heads) == len(cells)
    assert f'colspan="{len(heads)}"' in table


def test_each_trajectory_shows_curves_against_limits(audit):
    fast = section(write_report(audit).read_text(), "fast")
    titles = re.findall(r"<figcaption>([^<]*)", fast)
    assert titles == [
        "Joint angles, limits at ±1:",
        "Joint speed / limit:",
        "Manipulability",
        "Clearance [mm]",
        "TCP position in the base frame [m]",
    ]
    speed = fast[fast.index("Joint speed / limit:") :]
    assert re.findall(r'<span class="key c(\d)">(\d)</span>', speed[: speed.index("<svg")]) == [
        (str(k), str(k + 1)) for k in range(7)
    ]
    assert fast.count('class="band violation"') == len(titles)  # overlapping violations are one band a plot


def test_worst_moments_and_findings_stand_beside_the_curves(audit):
    text = write_report(audit).read_text()
    fast = section(text, "fast")
    assert "0.40 to 0.90 s (frames 4 to 9)" in fast
    assert '<td class="n past">2</td>' in fast
    assert "1.5 mm" in fast
    assert "the noise hides it" in fast
    assert "&lt;script&gt;" in fast
    assert EVIL not in text
    assert "noise_floor" in text


def test_replays_are_linked_where_they_exist(audit):
    text = write_report(audit).read_text()
    links = [link for link in Page(text).links if not link.startswith("data:")]
    assert links[0] == "replays/fast.html"
    assert links[1] == "replays/fast.html#t=0.400"
    assert all(link.startswith("replays/fast.html") for link in links)
    assert "kinebench-drake view OUT slow" in section(text, "slow")


def test_the_run_s_own_scale_is_shown(audit):
    text = write_report(audit).read_text()
    scale = text[text.index("On the run") :]
    assert re.search(r"noise_floor</td><td[^>]*>0\.2</td><td[^>]*>0\.4</td><td[^>]*>0\.250</td>", scale)


def test_only_the_worst_are_drawn(audit, monkeypatch):
    monkeypatch.setattr(page, "DRAWN", 1)
    text = write_report(audit).read_text()
    assert "<svg" in section(text, "fast")
    assert "<svg" not in section(text, "slow")
    assert "for the 1 worst only" in text


def test_endless_violations_are_cut_short(tmp_path):
    faults = tuple(
        {"kind": "velocity", "frame_start": k, "frame_end": k, "joint": "j1", "value": 2.0, "limit": 1.0}
        for k in range(500)
    )
    with ResultStore(tmp_path) as store:
        store.append(row("wild", feasible=False, violations=faults), 0.1)
        store.finish({"kind": "audit"})
    wild = section(write_report(tmp_path).read_text(), "wild")
    assert wild.count('<tr class="broken">') == 20
    assert "480 more limits" in wild


@pytest.mark.parametrize(
    ("used", "told"), [("used", "first frame known"), ("contradicted", "was not used"), ("unknown", None)]
)
def test_what_was_given_stands_beside_the_video(tmp_path, used, told):
    given = {"given": {"first_frame": "manifest", "depth": "sensor"}, "first_frame": used}
    with ResultStore(tmp_path) as store:
        store.append(row("a", feasible=True, extra=given), 0.1)
        store.finish({"kind": "score", "config": {}, "tags": {}, "seeds": {"bootstrap": 0}})
    text = write_report(tmp_path).read_text()
    assert "depth from sensor" in text
    for words in ("first frame known", "was not used"):
        assert (words in text) == (words == told)
