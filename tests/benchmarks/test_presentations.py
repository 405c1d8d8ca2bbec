"""Presentations of videos and the gate."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.presentations import (
    CLIPS,
    RIGHT_M,
    WRONG_M,
    WRONG_RAD,
    Outcome,
    Presentation,
    Verdict,
    check_outcomes,
    find_trials,
    summary_table,
)
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import invert

FRAMES = np.random.default_rng(0).integers(0, 255, (2, 40, 40, 3), dtype=np.uint8)
CAMERA = benchmark_camera().resized(40, 40)
OUTCOME = Outcome(id="a", presentation="plain", state="estimated", position_m=0.01, rotation_rad=0.01, cpu_s=3.0)


def test_every_presentation_but_named_and_plain_changes_frames_or_camera():
    for presentation in Presentation:
        frames, camera = presentation.apply(FRAMES, CAMERA)
        same = frames.shape == FRAMES.shape and (frames == FRAMES).all() and camera is CAMERA
        assert same == (presentation in (Presentation.NAMED, Presentation.PLAIN))


def test_presentations_transform_frames_and_camera_as_named():
    assert (Presentation.MIRRORED.apply(FRAMES, CAMERA)[0][:, :, ::-1] == FRAMES).all()
    assert Presentation.CORNER.apply(FRAMES, CAMERA)[0].shape == (2, 36, 36, 3)
    assert (Presentation.CORNER.apply(FRAMES, CAMERA)[0][:, 0, -1] == FRAMES[:, 0, -1]).all()
    assert Presentation.LONG_FOCAL.apply(FRAMES, CAMERA)[1].fx == pytest.approx(1.4 * CAMERA.fx)
    np.testing.assert_allclose(Presentation.INVERTED.apply(FRAMES, CAMERA)[1].X_BC, invert(CAMERA.X_BC), atol=1e-12)
    assert not Presentation.PLAIN.names_camera
    assert Presentation.OPENGL_AXES.names_camera


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, Verdict.RIGHT),
        ({"position_m": 1.01 * RIGHT_M}, Verdict.NEAR),
        ({"position_m": 1.01 * WRONG_M}, Verdict.WRONG),
        ({"rotation_rad": 1.01 * WRONG_RAD}, Verdict.WRONG),
        ({"position_m": None, "rotation_rad": None}, Verdict.WITHHELD),
    ],
)
def test_verdict_follows_from_the_pose_error(changes, verdict):
    assert replace(OUTCOME, **changes).verdict is verdict


def test_the_gate_fails_silently_wrong_and_unexpected_outcomes():
    wrong = replace(OUTCOME, position_m=0.4)
    withheld = replace(OUTCOME, position_m=None, rotation_rad=None, reading="mirrored", reason="it is mirrored")
    key = ("a", "plain")
    assert check_outcomes([OUTCOME], {key: "right"}) == []
    assert "silently wrong by 400 mm" in check_outcomes([wrong], {key: ""})[0]
    assert "silently wrong" in check_outcomes([wrong], {})[0]
    assert check_outcomes([withheld], {key: "withheld"}) == check_outcomes([withheld], {key: "mirrored"}) == []
    assert "expected right: it is mirrored" in check_outcomes([withheld], {key: "right"})[0]


def test_the_clips_of_the_gate_are_below_1_mb_and_have_bounds():
    trials, expected = find_trials(CLIPS, None)
    assert {(trial.clip.id, trial.presentation.value) for trial in trials} == set(expected)
    assert sum(file.stat().st_size for file in CLIPS.iterdir()) < 1e6
    clips = {trial.clip.id: trial.clip.load() for trial in trials}
    assert set(clips) == set(json.loads((CLIPS / "bounds.json").read_text()))
    assert all(len(clip.X_CH) == 17 for clip in clips.values())


def test_clips_of_a_further_folder_are_added_to_the_gate(tmp_path):
    for name in ("g05.mp4", "g05.gt.npz"):
        (tmp_path / name).write_bytes((CLIPS / name).read_bytes())
    lines = [line for line in (CLIPS / "manifest.jsonl").read_text().splitlines() if "g05" in line]
    (tmp_path / "manifest.jsonl").write_text("\n".join(lines))
    trials, expected = find_trials(Path(CLIPS), tmp_path)
    assert len(trials) == len(expected) + 3


def test_the_table_counts_verdicts():
    lines = summary_table([OUTCOME, replace(OUTCOME, id="b", position_m=0.4)])
    assert "| plain | 2 | 1 | 0 | 1 | 0 |" in lines[2]
