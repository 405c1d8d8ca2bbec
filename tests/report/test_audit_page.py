"""The html report of an audit: curves against limits, findings, replays."""

import re

import numpy as np
import pytest

from kinebench_drake.geometry import make_pose
from kinebench_drake.report import page
from kinebench_drake.report.page import write_report
from kinebench_drake.results.store import ResultStore
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack
from tests.report.pages import EVIL, Page, row


@pytest.fixture
def audit(tmp_path):
    """An output folder of an audit: no images, limits in the rows, one replay."""
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
            }
        )
    (tmp_path / "replays").mkdir(exist_ok=True)
    (tmp_path / "replays" / "fast.html").write_text("3D")
    return tmp_path


def section(text, id):
    """The part of the page that belongs to a sample."""
    return next(part for part in text.split('<tbody class="sample"')[1:] if f">{id}</button>" in part)


def test_an_audit_has_no_column_of_images(audit):
    text = write_report(audit).read_text()
    assert "trajectory audit" in text
    assert 'class="none"' not in text
    assert "<img" not in text
    table = text[text.index('<table id="samples"') :]
    heads = re.findall(r"<th[ >]", table[: table.index("</thead>")])
    cells = re.findall(r"<td[ >]", table[table.index("<tbody") : table.index('<tr class="detail"')])
    assert len(heads) == len(cells)
    assert f'colspan="{len(heads)}"' in table


def test_each_trajectory_shows_curves_against_limits(audit):
    fast = section(write_report(audit).read_text(), "fast")
    titles = ["Faults", "Joint angle, limits at ±1", "Joint speed / limit", "Manipulability", "Clearance [mm]"]
    assert [text for text in re.findall(r"<text[^>]*>([^<]*)</text>", fast) if text in titles] == titles
    assert fast.count("<svg") == 2


def test_worst_moments_and_violations_are_listed_beside_the_curves(audit):
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
    links = [link for link in Page(text).links if not link.startswith(("data:", "#"))]
    assert links[0] == "replays/fast.html"
    assert links[1] == "replays/fast.html#t=0.400"
    assert all(link.startswith("replays/fast.html") for link in links)
    assert "kinebench-drake view OUT slow" in section(text, "slow")


def test_curves_are_drawn_only_for_the_worst_samples(audit, monkeypatch):
    monkeypatch.setattr(page, "DRAWN", 1)
    text = write_report(audit).read_text()
    assert "<svg" in section(text, "fast")
    assert "<svg" not in section(text, "slow")
    assert "for the 1 worst samples only" in text


def test_a_table_lists_20_violations_and_counts_the_rest(tmp_path):
    faults = tuple(
        {"kind": "velocity", "frame_start": k, "frame_end": k, "joint": "j1", "value": 2.0, "limit": 1.0}
        for k in range(500)
    )
    with ResultStore(tmp_path) as store:
        store.append(row("wild", feasible=False, violations=faults), 0.1)
        store.finish({"kind": "audit"})
    wild = section(write_report(tmp_path).read_text(), "wild")
    assert wild.count('<tr class="broken">') == 20
    assert "480 more violations" in wild
