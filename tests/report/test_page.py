"""The html report: one file, safe against its content, readable without a finished run."""

import json
import re

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import make_pose
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.page import write_report
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack
from tests.report.pages import EVIL, Page, row


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
            row("good", feasible=True, executable=True, metrics=good),
            row(
                "shaky",
                feasible=True,
                executable=False,
                metrics={**good, "anomalies": [vanish], "tracked_fraction": 0.5},
            ),
            row("bad", feasible=False, metrics={**good, "sparc": None}, violations=(violation,)),
            row("unknown", feasible=None, metrics=good),
            row("dark", Status.UNMEASURABLE, reason="no robot", metrics={"sparc": None}),
            row("evil", Status.ERROR, reason=EVIL, task=EVIL, model=EVIL, video=EVIL),
        ):
            store.append(r, 0.1)
            if r.status is Status.OK:
                repeated = np.isin(np.arange(n), [2, 3, 7]) * (r.id == "good")
                write_track(tmp_path / "tracks" / f"{r.id}.npz", track, None, {"repeated": repeated.astype(float)})
        tags = {"note": EVIL}
        store.finish({"kind": "score", "tags": tags, "config": {"source": EVIL}, "seeds": {"bootstrap": 0}})
    return tmp_path


def test_lone_surrogates_in_texts_are_shown_as_question_marks(out, tmp_path):
    """Another program may have written the folder: JSON can name halves of surrogate pairs."""
    rows = tmp_path / "samples.jsonl"
    rows.write_text(rows.read_text().replace('"unknown.mp4"', '"caf\\udce9.mp4"'))
    results = json.loads((tmp_path / "results.json").read_text())
    (tmp_path / "results.json").write_text(json.dumps({**results, "tags": {"note": "caf\ud800"}}))
    text = write_report(out).read_text()
    assert "caf?.mp4" in text
    assert "note = caf?" in text


def test_the_page_is_self_contained_and_its_tags_balance(out):
    text = write_report(out).read_text()
    page = Page(text)
    assert page.open == []
    assert all(link.startswith(("data:image/jpeg;base64,", "#")) for link in page.links)
    assert not re.search(r"https?://|url\((?!#)|@import", text)
    assert str(out) not in text


def test_checks_of_rate_limits_are_listed_with_the_ratio_of_each_joint(tmp_path):
    checks = {
        "velocity": {"ratio_max": 1.5, "window_s": 0.2, "bandwidth_hz": 2.2, "ratios": [1.5, None], "noise_ratio": 0.1},
        "acceleration": {"ratio_max": 0.5},
        "jerk": {"ratio_max": None},
    }
    with ResultStore(tmp_path) as store:
        store.append(row("a", feasible=True, details={"checks": checks}), 0.1)
    text = write_report(tmp_path).read_text()
    numbers = "".join(f'<td class="n">{cell}</td>' for cell in ("0.2 s", "2.2 Hz", "0.1"))
    dash = '<td class="n">–</td>'
    assert f'<tr><td>velocity</td>{numbers}<td class="n past">1.5</td>{dash}</tr>' in text
    assert f"<tr><td>acceleration</td>{3 * dash}</tr>" in text
    assert "<tr><td>jerk</td>" not in text


def test_texts_of_the_results_are_escaped_in_html(out):
    text = write_report(out).read_text()
    assert Page(text).scripts == 1
    assert EVIL not in text
    assert text.count("&lt;script&gt;") >= 5


def test_samples_are_sorted_worst_first(out):
    text = write_report(out).read_text()
    assert re.findall(r'aria-expanded="false">(\w+)<', text) == ["evil", "bad", "dark", "shaky", "unknown", "good"]


@pytest.fixture
def pictures(out):
    """The folder with an image of every sample."""
    for id in ("good", "shaky", "bad", "unknown", "dark", "evil"):
        write_atomically(out / "thumbnails" / f"{id}.jpg", id.encode())
    return out


def test_the_worst_samples_hold_no_executable_one(pictures):
    text = write_report(pictures).read_text()
    shown = re.findall(r'data-open="(\w+)"', text)
    assert shown == ["evil", "bad", "dark", "shaky", "unknown", "good"]
    assert text.index("<h3>Worst</h3>") < text.index('data-open="unknown"') < text.index("<h3>Best</h3>")
    assert text.index("<h3>Best</h3>") < text.index('data-open="good"')


def test_a_run_of_executable_samples_says_that_there_is_no_worst(tmp_path):
    with ResultStore(tmp_path) as store:
        for id in "ab":
            store.append(row(id, feasible=True, executable=True, metrics={"sparc": -1.5}), 0.1)
            write_atomically(tmp_path / "thumbnails" / f"{id}.jpg", b"picture")
    text = write_report(tmp_path).read_text()
    assert "None: every sample with an image is executable." in text
    assert re.findall(r'data-open="(\w+)"', text) == ["a", "b"]


def test_motionless_samples_are_counted_and_marked(tmp_path):
    with ResultStore(tmp_path) as store:
        for id, motionless in (("a", True), ("b", False)):
            store.append(row(id, feasible=True, metrics={"motionless": motionless}), 0.1)
    text = write_report(tmp_path).read_text()
    assert "Motionless: 1 of 2 samples" in text
    assert text.count('<span class="chip lost">motionless</span>') == 1


def test_frames_that_repeat_the_one_before_are_named(out):
    page = write_report(out).read_text()
    assert page.count("frames that repeat the one before") == 1
    assert "3 of 9: 2 to 3, 7" in page


def test_headline_numbers_have_interval_and_coverage(out):
    text = re.sub(r"\s+", " ", write_report(out).read_text())
    tile = text[text.index("Feasible for the robot") :]
    assert re.match(
        r"Feasible for the robot</span><b>67%</b> <div class=\"note\">95% interval 21% to 94%<br>3 of 6", tile
    )
    sparc = text[text.index('<span class="name">SPARC') :]
    assert re.match(r'<span class="name">SPARC</span><b>-1.50</b> <div class="note">no interval<br>3 of 6', sparc)


def test_the_same_folder_gives_the_same_bytes(out):
    first = write_report(out).read_bytes()
    assert write_report(out).read_bytes() == first


def test_light_and_dark_colour_schemes_define_the_same_variables(out):
    text = write_report(out).read_text()
    assert "prefers-color-scheme: dark" in text
    light, dark = (
        set(re.findall(r"(--[\w]+):", block)) for block in re.findall(r":root \{(.*?)\}", text, re.DOTALL)[:2]
    )
    assert dark
    assert dark == light


def test_an_unfinished_run_has_a_report_too(out):
    (out / "results.json").unlink()
    assert "has not finished" in write_report(out).read_text()


def test_a_run_without_a_measured_sample_has_a_report(tmp_path):
    with ResultStore(tmp_path) as store:
        store.append(row("dark", Status.UNMEASURABLE, metrics={"sparc": None}), 0.1)
        store.finish({})
    assert "0 / 1" in write_report(tmp_path).read_text()


def test_a_damaged_track_file_is_refused_by_name(out):
    (out / "tracks" / "good.npz").write_bytes(b"PK broken")
    with pytest.raises(InputError, match=r"good\.npz"):
        write_report(out)


@pytest.mark.parametrize(
    ("used", "words"), [("used", "first-frame prior used"), ("contradicted", "was not used"), ("unknown", None)]
)
def test_priors_are_named_beside_the_video(tmp_path, used, words):
    priors = {"replaced": {"first_frame": "manifest", "depth": "sensor"}, "first_frame": used}
    with ResultStore(tmp_path) as store:
        store.append(row("a", feasible=True, extra=priors), 0.1)
        store.finish({"kind": "score", "config": {}, "tags": {}, "seeds": {"bootstrap": 0}})
    text = write_report(tmp_path).read_text()
    assert "depth from sensor" in text
    for sentence in ("first-frame prior used", "was not used"):
        assert (sentence in text) == (sentence == words)


def test_source_and_uncertainty_of_the_camera_and_its_contradiction_are_shown(tmp_path):
    estimate = {"residual_px": 0.34, "gripper_sigma_m": 0.0551, "gripper_sigma_rad": 0.1}
    contradiction = {"agreement": 0.3, "better": 0.7, "focal_ratio": 0.8, "gripper_m": 0.21, "gripper_rad": 0.02}
    reason = {"base_frame_reason": "the base frame is unknown: the gripper's place is uncertain"}
    with ResultStore(tmp_path) as store:
        store.append(row("a", extra={"camera_source": "estimated", "camera_estimate": estimate} | reason), 0.1)
        store.append(row("b", extra={"camera_source": "folder", "camera_contradiction": contradiction}), 0.1)
    html = write_report(tmp_path).read_text()
    assert "camera: estimated (residual 0.34 px; one sigma at the gripper: 55.1 mm, 5.7 degrees)" in html
    assert "The base frame is unknown: the gripper" in html
    assert "70 % with 1.25 times the focal length, which moves the gripper by 210 mm and 1 degrees" in html


def test_executable_is_the_first_headline_and_the_only_green_verdict(tmp_path):
    good = {"sparc": -1.5, "anomalies": []}
    with ResultStore(tmp_path) as store:
        for r in (
            row("whole", feasible=True, executable=True, metrics=good),
            row("gap", feasible=True, executable=None, executable_reasons=("lost: 3 frames",), metrics={"sparc": None}),
            row("dark", Status.UNMEASURABLE, reason="no robot", metrics={"sparc": None}),
        ):
            store.append(r, 0.1)
        store.finish({"kind": "score", "config": {}, "seeds": {"bootstrap": 0}})
    text = write_report(tmp_path).read_text()
    tiles = text[text.index('aria-label="Headline numbers"') :]
    assert re.findall(r'<span class="name">([^<]*)</span><b[^>]*>([^<]*)</b>', tiles)[0] == ("Executable", "33%")
    assert "bound -1.50" in tiles  # of SPARC: two samples have none
    assert '<span class="chip lost">lost: 3 frames</span>' in text
    assert re.findall(r"\.v-(\w+) { --v: var\(--good\)", text) == ["executable"]
    badges = re.findall(r'<tbody class="sample" data-verdict="(\w+)"', text)
    assert badges == ["unmeasurable", "unjudged", "executable"]
