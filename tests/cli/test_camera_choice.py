from dataclasses import replace

import numpy as np
import pytest
from fake_analyzer import Act, FakeAnalyzer

from kinebench_drake.camera import CameraSetting, benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.formats.videos.sample import CameraSource, VideoSample
from kinebench_drake.grounding.camera.camera_estimate import (
    ALIGNED_AGREEMENT,
    ALIGNED_BASE_AGREEMENT,
    ARM_AGREEMENT,
    BASE_AGREEMENT,
    GRIPPER_SIGMA_M,
    CameraEstimate,
)
from kinebench_drake.grounding.camera.contradiction import LARGE_M, CameraContradiction
from kinebench_drake.grounding.camera.estimate import usual_camera
from kinebench_drake.grounding.camera.reading import BetterReading, Reading
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.camerafile import save_camera
from kinebench_drake.io.video import Video
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.analyzer import RobotOptions
from kinebench_drake.runs.camera import AGREEMENT, CONFIRMED, SURE, CameraState, with_camera_option
from kinebench_drake.runs.grounding import ground_with_camera
from kinebench_drake.runs.score import score_videos
from kinebench_drake.types import Domain, GripperKind

WIDE = np.zeros((12, 96, 160, 3), np.uint8)
SQUARE = np.zeros((12, 96, 96, 3), np.uint8)


class CameraAnalyzer(FakeAnalyzer):
    """Analyzer whose evidence for cameras is known in advance, and that notes what is asked of it."""

    def __init__(self, *, agreements=(0.7,), detected=None, estimate=None, contradiction=None, reading=None, hands=8):
        super().__init__(RobotOptions())
        self.agreements, self.detected, self.estimate = list(agreements), detected, estimate
        self.contradiction, self.reading, self.hands = contradiction, reading, hands
        self.asked = []
        self.domain, self.fitted, self.arm_seen, self.arm_tracks = Domain.FAMILIAR, True, True, False

    def _with_domain(self, grounding, domain):
        object.__setattr__(grounding, "domain", domain)
        object.__setattr__(grounding, "arm_consistency_px", 2.0 if self.arm_seen else None)
        if not self.fitted:
            object.__setattr__(grounding, "arm_q", np.full((len(grounding.track.t_s), 7), np.nan))
        return grounding

    def ground(self, frames, camera, t_s, priors):
        self.asked.append("assumed" if priors.camera_is_assumed else "ground")
        return self._with_domain(FakeAnalyzer.ground_arm(self, frames, camera, t_s, priors), self.domain)

    def ground_arm(self, frames, camera, t_s, priors, gripper=GripperKind.NONE):
        self.asked.append(gripper.value)
        if self.arm_tracks:
            frames = np.zeros_like(frames)
        return self._with_domain(FakeAnalyzer.ground_arm(self, frames, camera, t_s, priors), Domain.ARM)

    def posture_agreement(self, frames, camera, q, finger_m, *, hand):
        assert len(frames) == len(q) == len(finger_m) <= 5
        return self.agreements.pop(0) if len(self.agreements) > 1 else self.agreements[0]

    def camera_agreement(self, frames, camera):
        return self.detected

    def camera_reading(self, frames, camera, least, *, likely_only):
        self.asked.append("mirror" if likely_only else "readings")
        return self.reading

    def camera_contradiction(self, frames, camera):
        self.asked.append("contradiction")
        return self.contradiction

    def count_hands(self, frames):
        return self.hands, 8

    def estimate_camera(self, frames):
        self.asked.append("estimate")
        if self.estimate is None:
            raise UnmeasurableError("no camera can be estimated: nothing is seen")
        return self.estimate


def estimate(**changes):
    fields = {
        "camera": usual_camera(160, 96),
        "covariance": 1e-6 * np.eye(9),
        "gripper_sigma_m": 0.01,
        "gripper_sigma_rad": 0.01,
        "agreement": ARM_AGREEMENT + 0.1,
        "is_aligned": False,
        "runner_up": 0.0,
        "base_agreement": BASE_AGREEMENT + 0.1,
        "base_runner_up": 0.0,
        "residual_px": 0.4,
        "rows": np.arange(4),
        "scene": None,
        "contour_part": np.zeros(0, np.uint8),
        "contour_error_px": np.zeros(0),
    }
    return CameraEstimate(**{**fields, **changes})


def reading(kind=Reading.MIRRORED):
    return BetterReading(reading=kind, agreement=0.5, better=0.72, camera=benchmark_camera())


def contradiction(gripper_m):
    return CameraContradiction(agreement=0.3, better=0.7, focal_ratio=0.7, gripper_m=gripper_m, gripper_rad=0.01)


def ground(tmp_path, analyzer, frames=SQUARE, *, source=None, gripper=GripperKind.AUTO, **changes):
    """Ground a video, unnamed if there is no source."""
    video = Video(frames=frames, fps=10.0, stamps_s=None)
    sample = VideoSample(id="a", path=tmp_path / "a.mp4", video="a.mp4", **changes)
    if source is not None:
        sample = sample.filmed_by(CameraSetting(camera=benchmark_camera()), source)
    return ground_with_camera(video, sample, Overrides(), analyzer, gripper=gripper)


def robotless(frames=SQUARE):
    frames = frames.copy()
    frames[:, :20, :20] = [40 * Act.NO_ROBOT, 0, 0]
    return frames


@pytest.mark.parametrize(
    ("agreement", "asked"),
    [(SURE, ["assumed"]), (SURE - 0.01, ["assumed", "mirror"]), (CONFIRMED, ["assumed", "mirror"])],
)
def test_an_unnamed_camera_is_the_benchmarks_where_the_track_confirms_it(tmp_path, agreement, asked):
    analyzer = CameraAnalyzer(agreements=[agreement])
    grounded = ground(tmp_path, analyzer)
    assert analyzer.asked == asked
    assert grounded.choice.state is CameraState.CONFIRMED
    assert grounded.choice.agreement == agreement
    assert np.isfinite(grounded.track.X_BG).all()


def test_without_confirmation_there_is_no_base_frame_however_close_the_agreement_is(tmp_path):
    grounded = ground(tmp_path, CameraAnalyzer(agreements=[CONFIRMED - 0.01]))
    assert grounded.choice.state is CameraState.NONE
    assert grounded.choice.to_json()["camera_source"] == "none"
    assert np.isnan(grounded.track.X_BG).all()
    assert np.isfinite(grounded.track.X_CH).all()
    assert "59%" in grounded.choice.reason
    assert "nothing is seen" in grounded.choice.reason


@pytest.mark.parametrize("detected", [None, CONFIRMED - 0.01, CONFIRMED])
def test_a_video_of_unfamiliar_look_needs_a_whole_grounding_that_confirms_the_camera(tmp_path, detected):
    analyzer = CameraAnalyzer(agreements=[0.2, CONFIRMED], detected=detected)
    analyzer.domain = Domain.UNFAMILIAR
    grounded = ground(tmp_path, analyzer)
    confirmed = detected is not None and detected >= CONFIRMED
    assert (grounded.choice.state is CameraState.CONFIRMED) == confirmed
    assert analyzer.asked[:2] == (["assumed", "ground"] if confirmed else ["assumed", "readings"])


@pytest.mark.parametrize("source", [None, CameraSource.FOLDER, CameraSource.OPTION])
@pytest.mark.parametrize("agreement", [0.3, CONFIRMED + 0.02])
def test_a_reading_that_agrees_better_is_named_and_costs_the_base_frame(tmp_path, source, agreement):
    analyzer = CameraAnalyzer(agreements=[agreement], reading=reading())
    grounded = ground(tmp_path, analyzer, source=source)
    assert "the picture mirrored left-right agrees better" in grounded.choice.reason
    assert "72%" in grounded.choice.reason
    assert "--mirrored" in grounded.choice.reason
    assert grounded.choice.to_json()["camera_reading"]["reading"] == "mirrored"
    assert "estimate" not in analyzer.asked
    assert np.isnan(grounded.track.X_BG).all()


def test_mirrored_frames_are_turned_before_they_are_measured(tmp_path, monkeypatch):
    frames = SQUARE.copy()
    frames[:, :, 50:] = 200
    analyzer = CameraAnalyzer()
    grounded = ground(tmp_path, analyzer, frames, mirrored=True)
    assert (grounded.prepared.frames[0, 30, :40] == 200).all()
    assert grounded.choice.to_json()["mirrored"] is True


def test_where_no_hand_is_seen_whatever_the_camera_none_is_estimated(tmp_path):
    analyzer = CameraAnalyzer(hands=0)
    with pytest.raises(UnmeasurableError, match="no Franka hand is found in any of 8 frames searched"):
        ground(tmp_path, analyzer, robotless())
    assert "estimate" not in analyzer.asked


@pytest.mark.parametrize("agreement", [CONFIRMED, CONFIRMED - 0.01])
def test_the_arm_alone_counts_where_it_confirms_the_assumed_camera(tmp_path, agreement):
    analyzer = CameraAnalyzer(hands=0, agreements=[agreement])
    analyzer.arm_tracks = True
    if agreement < CONFIRMED:
        with pytest.raises(UnmeasurableError, match="no Franka hand"):
            ground(tmp_path, analyzer, robotless())
    else:
        grounded = ground(tmp_path, analyzer, robotless())
        assert grounded.grounding.domain is Domain.ARM
        assert grounded.choice.state is CameraState.CONFIRMED


def test_a_hand_that_is_seen_but_lost_under_the_benchmark_camera_leads_to_an_estimate(tmp_path):
    analyzer = CameraAnalyzer(hands=8)
    with pytest.raises(UnmeasurableError, match="no Franka hand is found in any of 12 frames"):
        ground(tmp_path, analyzer, robotless())
    assert "estimate" in analyzer.asked


@pytest.mark.parametrize(
    ("best", "words"),
    [
        (estimate(), None),
        (None, "nothing is seen"),
        (estimate(agreement=ARM_AGREEMENT - 0.01), "no estimated camera agrees"),
        (estimate(agreement=ALIGNED_AGREEMENT - 0.01, is_aligned=True), "no estimated camera agrees"),
        (estimate(runner_up=0.9), "two different cameras"),
        (estimate(base_agreement=BASE_AGREEMENT - 0.01), "cannot be seen"),
        (estimate(base_agreement=ALIGNED_BASE_AGREEMENT - 0.01, is_aligned=True), "cannot be seen"),
        (estimate(base_runner_up=BASE_AGREEMENT + 0.09), "two turns"),
        (estimate(gripper_sigma_m=GRIPPER_SIGMA_M + 0.01), "uncertain by 30 mm"),
    ],
)
def test_an_estimated_camera_gives_a_base_frame_where_it_agrees_and_is_determined(tmp_path, monkeypatch, best, words):
    monkeypatch.setattr(CameraEstimate, "to_json", lambda self: {"agreement": self.agreement})
    choice = ground(tmp_path, CameraAnalyzer(estimate=best), WIDE).choice
    assert (choice.sample.camera.width, choice.sample.camera.height) == (160, 96)
    if words is None:
        assert choice.reason is None
        assert choice.to_json()["camera_source"] == choice.state.value == "estimated"
    else:
        assert words in choice.reason
        assert choice.to_json()["camera_source"] == choice.state.value == "none"


def test_lines_along_the_base_confirm_a_camera_that_few_contours_do():
    few = estimate(agreement=ALIGNED_AGREEMENT + 0.01, base_agreement=ALIGNED_BASE_AGREEMENT + 0.01)
    assert few.doubt is not None
    assert replace(few, is_aligned=True).doubt is None


@pytest.mark.parametrize("agreement", [AGREEMENT, AGREEMENT - 0.01])
def test_the_reported_track_has_to_confirm_an_estimated_camera(tmp_path, agreement):
    choice = ground(tmp_path, CameraAnalyzer(agreements=[agreement], estimate=estimate()), WIDE).choice
    assert (choice.reason is None) == (agreement >= AGREEMENT)


def test_a_camera_file_of_the_command_line_is_that_of_all_videos(tmp_path):
    save_camera(replace(benchmark_camera(), fx=400.0), tmp_path / "mine.json")
    sample = VideoSample(id="a", path=tmp_path / "a.mp4", video="a.mp4")
    (changed,) = with_camera_option([sample], str(tmp_path / "mine.json"))
    assert changed.camera.fx == 400.0
    assert changed.camera_source is CameraSource.OPTION
    (insisted,) = with_camera_option([sample], "benchmark", mirrored=True)
    assert insisted.camera_source is CameraSource.OPTION
    assert insisted.mirrored


def test_without_a_base_frame_motion_and_anomalies_are_measured_alone(film, config, tmp_path):
    (tmp_path / "videos").mkdir()
    np.save(tmp_path / "videos" / "wide.npy", WIDE)
    score_videos(config(source=tmp_path / "videos" / "wide.npy"))
    row = read_rows(tmp_path / "out")["wide"]
    assert row.status is Status.OK
    assert row.feasible is None
    assert row.null_reasons["feasible"] == row.extra["base_frame_reason"] == row.null_reasons["ik_success_rate"]
    assert row.metrics["sparc"] is not None
    assert row.metrics["anomalies"] == []
    assert row.executable is None
    assert row.executable_reasons == ("undecided",)
    assert row.extra["camera_source"] == "none"
    assert row.extra["trust"]["level"] == "unknown"
    with np.load(tmp_path / "out" / "tracks" / "wide.npz") as track:
        assert np.isnan(track["base_from_tcp"]).all()
        assert np.isfinite(track["camera_from_hand"]).all()


def test_lost_frames_and_anomalies_are_against_execution_without_a_base_frame_too(config, program, tmp_path):
    frames = WIDE.copy()
    frames[:, :20, :20] = [40 * Act.INFEASIBLE, 0, 0]
    np.save(tmp_path / "wide.npy", frames)
    score_videos(config(source=tmp_path / "wide.npy"))
    row = read_rows(tmp_path / "out")["wide"]
    assert "base_frame_reason" in row.extra
    assert row.executable is False
    assert row.executable_reasons == ("undecided", "lost", "vanish")
    code, _, err = program("view", tmp_path / "out", "wide")
    assert code == 2
    assert "no base frame" in err
    assert "kinebench-drake view OUT" not in (tmp_path / "out" / "report.html").read_text()


def test_the_benchmark_camera_can_be_insisted_on(film, config, tmp_path):
    (tmp_path / "videos").mkdir()
    np.save(tmp_path / "videos" / "wide.npy", WIDE)
    score_videos(config(source=tmp_path / "videos" / "wide.npy", camera="benchmark"))
    row = read_rows(tmp_path / "out")["wide"]
    assert row.status is Status.UNMEASURABLE
    assert "aspect ratios differ" in row.reason


class Unsure(FakeAnalyzer):
    """Sees the gripper everywhere and trusts it nowhere."""

    def ground_arm(self, *inputs):
        grounding = super().ground_arm(*inputs)
        track = grounding.track
        return replace(
            grounding, track=replace(track, tracked=np.zeros(len(track.t_s), bool), confidence=0.2 * track.confidence)
        )


def test_what_is_seen_but_not_trusted_has_a_track_an_overlay_and_its_confidence(film, config, tmp_path):
    film("videos/a.mp4")
    score_videos(config(make_analyzer=Unsure, camera="benchmark", overlay=True))
    row = read_rows(tmp_path / "out")["a"]
    assert row.status is Status.UNMEASURABLE
    assert "a gripper is seen in 8 of 8 frames, but trusted in 0" in row.reason
    assert "0.19 at most" in row.reason
    assert row.executable is None
    assert (tmp_path / "out" / "overlays" / "a.mp4").is_file()
    with np.load(tmp_path / "out" / "tracks" / "a.npz") as track:
        assert np.isfinite(track["camera_from_hand"]).all()
        assert not track["tracked"].any()


def test_a_named_camera_that_the_arm_confirms_costs_no_search(tmp_path):
    for source in (CameraSource.FOLDER, CameraSource.GIVEN):
        sure, unsure = CameraAnalyzer(agreements=[SURE]), CameraAnalyzer(agreements=[CONFIRMED - 0.01])
        assert ground(tmp_path, sure, source=source).choice.state is CameraState.NAMED
        assert sure.asked == ["ground"]
        ground(tmp_path, unsure, source=source)
        assert unsure.asked == ["ground", "readings", "contradiction"]


@pytest.mark.parametrize("fitted", [True, False])
def test_another_camera_that_explains_the_arm_better_costs_the_base_frame_where_it_is_far_off(tmp_path, fitted):
    def choose(gripper_m):
        analyzer = CameraAnalyzer(agreements=[0.3], contradiction=contradiction(gripper_m))
        analyzer.fitted = fitted
        return ground(tmp_path, analyzer, source=CameraSource.FOLDER).choice

    near, far = choose(0.5 * LARGE_M), choose(2 * LARGE_M)
    assert near.reason is None
    assert near.to_json()["camera_contradiction"]["focal_ratio"] == 0.7
    assert "1.43 times as long" in far.reason
    assert "60 mm" in far.reason
    assert far.sample.camera_source is CameraSource.FOLDER


@pytest.mark.parametrize("agreement", [AGREEMENT + 0.01, AGREEMENT - 0.01])
def test_a_doubtful_camera_stays_where_no_other_explains_the_arm_better_and_the_arm_agrees(tmp_path, agreement):
    choice = ground(tmp_path, CameraAnalyzer(agreements=[agreement]), source=CameraSource.FOLDER).choice
    assert (choice.reason is None) == (agreement > AGREEMENT)
    assert choice.to_json()["camera_agreement"] == agreement


@pytest.mark.parametrize("arm_seen", [True, False])
def test_a_camera_with_which_a_visible_arm_never_agrees_gives_no_base_frame(tmp_path, arm_seen):
    analyzer = CameraAnalyzer()
    analyzer.fitted, analyzer.arm_seen = False, arm_seen
    choice = ground(tmp_path, analyzer, source=CameraSource.FOLDER).choice
    assert (choice.reason is not None) == arm_seen
    assert not arm_seen or "no tracked frame" in choice.reason


@pytest.mark.parametrize("agreement", [CONFIRMED, AGREEMENT - 0.01])
def test_the_arm_alone_is_checked_like_a_hand(tmp_path, agreement):
    analyzer = CameraAnalyzer(agreements=[agreement])
    grounded = ground(tmp_path, analyzer, source=CameraSource.FOLDER, gripper=GripperKind.NONE)
    assert analyzer.asked[0] == "none"
    assert "contradiction" not in analyzer.asked  # it is sought by hands
    assert (grounded.choice.reason is None) == (agreement >= AGREEMENT)


def test_where_another_reading_explains_the_hand_the_arm_alone_is_not_tried(tmp_path):
    analyzer = CameraAnalyzer(reading=reading(Reading.OPENGL_AXES))
    with pytest.raises(UnmeasurableError, match="OpenGL axes"):
        ground(tmp_path, analyzer, robotless(), source=CameraSource.FOLDER)
    assert analyzer.asked == ["ground", "readings"]
