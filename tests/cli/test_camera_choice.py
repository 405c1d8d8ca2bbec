from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fake_analyzer import Act, FakeAnalyzer

from kinebench_drake.calibration.camera_estimate import (
    ALIGNED_AGREEMENT,
    ARM_AGREEMENT,
    BASE_AGREEMENT,
    GRIPPER_SIGMA_M,
    CameraEstimate,
)
from kinebench_drake.calibration.contradiction import CameraContradiction
from kinebench_drake.calibration.estimate import usual_camera
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.datasets.videos.sample import CameraSource, VideoSample
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.evaluation.analyzer import RobotOptions
from kinebench_drake.evaluation.camera import (
    AGREEMENT,
    CONFIRMED,
    CameraChoice,
    check_camera,
    choose_camera,
    explain_loss,
    with_camera_option,
)
from kinebench_drake.evaluation.grounding import ground_with_camera
from kinebench_drake.evaluation.score import score_videos
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.camerafile import save_camera
from kinebench_drake.io.video import Video
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.types import GripperKind

FRAMES = np.zeros((4, 96, 160, 3), np.uint8)
SQUARE = np.zeros((4, 96, 96, 3), np.uint8)


def sample(tmp_path):
    return VideoSample(
        id="a",
        path=tmp_path / "a.mp4",
        video="a.mp4",
        camera=benchmark_camera(),
        camera_source=CameraSource.BENCHMARK,
    )


class Judge:
    """Checks and estimates of a camera that are known in advance."""

    def __init__(self, agreement=None, estimate=None, contradiction=None):
        self.agreement, self.estimate, self.contradiction = agreement, estimate, contradiction
        self.searched = 0

    def camera_agreement(self, frames, camera):
        return self.agreement

    def posture_agreement(self, frames, camera, q, finger_m):
        assert len(frames) == len(q) == len(finger_m) <= 5
        return self.agreement

    def camera_contradiction(self, frames, camera):
        self.searched += 1
        return self.contradiction

    def estimate_camera(self, frames):
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


def test_the_benchmark_camera_stays_where_the_arm_agrees_or_is_not_seen(tmp_path):
    for agreement in (AGREEMENT + 0.01, None):
        choice = choose_camera(sample(tmp_path), SQUARE, (SQUARE, benchmark_camera()), Judge(agreement))
        assert choice.sample.camera_source is CameraSource.BENCHMARK
        assert choice.reason is None
        assert choice.estimate is None


def test_lines_along_the_base_confirm_a_camera_that_few_contours_do():
    few = estimate(agreement=ALIGNED_AGREEMENT + 0.01)
    assert few.doubt is not None
    assert replace(few, is_aligned=True).doubt is None


@pytest.mark.parametrize("whole", [None, (SQUARE, benchmark_camera())])
def test_a_camera_is_estimated_where_shape_or_arm_contradict_the_benchmarks(tmp_path, monkeypatch, whole):
    monkeypatch.setattr(CameraEstimate, "to_json", lambda self: {"agreement": self.agreement})
    judge = Judge(AGREEMENT - 0.1, estimate())
    choice = choose_camera(sample(tmp_path), FRAMES, whole, judge)
    assert choice.sample.camera_source is CameraSource.ESTIMATED
    assert choice.sample.camera is judge.estimate.camera
    assert choice.reason is None
    assert choice.to_json()["camera_source"] == "estimated"


@pytest.mark.parametrize(
    ("best", "words"),
    [
        (None, "nothing is seen"),
        (estimate(agreement=ARM_AGREEMENT - 0.01), "no estimated camera agrees"),
        (estimate(agreement=ALIGNED_AGREEMENT - 0.01, is_aligned=True), "no estimated camera agrees"),
        (estimate(runner_up=0.9), "two different cameras"),
        (estimate(base_agreement=BASE_AGREEMENT - 0.01), "cannot be seen"),
        (estimate(base_runner_up=BASE_AGREEMENT + 0.09), "two turns"),
        (estimate(gripper_sigma_m=GRIPPER_SIGMA_M + 0.01), "uncertain by 60 mm"),
    ],
)
def test_there_is_no_base_frame_where_no_camera_agrees_or_is_determined(tmp_path, best, words):
    choice = choose_camera(sample(tmp_path), FRAMES, None, Judge(None, best))
    assert words in choice.reason
    assert choice.sample.camera_source is CameraSource.ESTIMATED
    assert (choice.sample.camera.width, choice.sample.camera.height) == (160, 96)


def test_a_camera_file_of_the_command_line_is_that_of_all_videos(tmp_path):
    camera = replace(benchmark_camera(), fx=400.0)
    save_camera(camera, tmp_path / "mine.json")
    (changed,) = with_camera_option([sample(tmp_path)], str(tmp_path / "mine.json"))
    assert changed.camera.fx == 400.0
    assert changed.camera_source is CameraSource.OPTION


def test_without_a_base_frame_motion_and_anomalies_are_measured_alone(film, config, tmp_path):
    (tmp_path / "videos").mkdir()
    np.save(tmp_path / "videos" / "wide.npy", np.repeat(FRAMES[:1], 12, axis=0))
    score_videos(config(source=tmp_path / "videos" / "wide.npy"))
    row = read_rows(tmp_path / "out")["wide"]
    assert row.status is Status.OK
    assert row.feasible is None
    assert "nothing" not in row.null_reasons["feasible"]
    assert row.null_reasons["feasible"] == row.extra["base_frame_reason"] == row.null_reasons["ik_success_rate"]
    assert row.metrics["sparc"] is not None
    assert row.metrics["anomalies"] == []
    assert row.executable is None
    assert row.executable_reasons == ("undecided",)
    with np.load(tmp_path / "out" / "tracks" / "wide.npz") as track:
        assert np.isnan(track["base_from_tcp"]).all()
        assert np.isfinite(track["camera_from_hand"]).all()


def test_lost_frames_and_anomalies_are_against_execution_without_a_base_frame_too(config, program, tmp_path):
    frames = np.repeat(FRAMES[:1], 12, axis=0)
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
    np.save(tmp_path / "videos" / "wide.npy", FRAMES)
    score_videos(config(source=tmp_path / "videos" / "wide.npy", camera="benchmark"))
    row = read_rows(tmp_path / "out")["wide"]
    assert row.status is Status.UNMEASURABLE
    assert "aspect ratios differ" in row.reason


@pytest.mark.parametrize(
    ("posture_agreement", "agreement", "groundings", "source"),
    [
        (CONFIRMED, None, 1, CameraSource.BENCHMARK),
        (CONFIRMED - 0.01, AGREEMENT, 1, CameraSource.BENCHMARK),
        (CONFIRMED - 0.01, AGREEMENT - 0.01, 2, CameraSource.ESTIMATED),
    ],
)
def test_the_benchmark_camera_is_confirmed_by_the_track_itself(
    tmp_path, monkeypatch, posture_agreement, agreement, groundings, source
):
    analyzer, assumed = FakeAnalyzer(RobotOptions()), []

    def ground(frames, camera, t_s, priors):
        assumed.append(priors.camera_is_assumed)
        return analyzer.ground_arm(frames, camera, t_s, priors)

    analyzer.ground = ground
    analyzer.posture_agreement = lambda *_: posture_agreement
    analyzer.camera_agreement = lambda *_: agreement
    analyzer.estimate_camera = lambda _: estimate(camera=usual_camera(96, 96))
    video = Video(frames=np.repeat(SQUARE[:1], 12, axis=0), fps=10.0, stamps_s=None)
    choice, _, grounding = ground_with_camera(video, sample(tmp_path), Overrides(), analyzer)
    assert assumed == [True, False][:groundings]
    assert choice.sample.camera_source is source
    assert choice.agreement == (posture_agreement if agreement is None else agreement)
    assert grounding.track.tracked.all()


def test_where_no_gripper_is_seen_neither_another_camera_nor_another_gripper_is_sought(tmp_path):
    analyzer, sought = FakeAnalyzer(RobotOptions()), []

    def ground_arm(*inputs):
        sought.append(inputs[4])
        return FakeAnalyzer.ground_arm(analyzer, *inputs)

    analyzer.ground = lambda *inputs: FakeAnalyzer.ground_arm(analyzer, *inputs)
    analyzer.ground_arm = ground_arm
    analyzer.camera_agreement = analyzer.estimate_camera = lambda *_: pytest.fail("a camera is sought")
    frames = np.repeat(SQUARE[:1], 12, axis=0)
    frames[:, :20, :20] = [40 * Act.NO_ROBOT, 0, 0]
    with pytest.raises(UnmeasurableError, match="0 of 12 frames"):
        ground_with_camera(Video(frames=frames, fps=10.0, stamps_s=None), sample(tmp_path), Overrides(), analyzer)
    assert sought == [GripperKind.NONE]


def checked(tmp_path, judge, *, source=CameraSource.FOLDER, fitted=True, arm_seen=True):
    """Check a camera of the input with a track of twelve frames."""
    n = 12
    track = SimpleNamespace(tracked=np.arange(n) != 3, finger_width_m=np.full(n, np.nan))
    grounding = SimpleNamespace(
        track=track, arm_q=np.full((n, 7), 0.1 if fitted else np.nan), arm_consistency_px=2.0 if arm_seen else None
    )
    choice = CameraChoice(sample=replace(sample(tmp_path), camera_source=source))
    return check_camera(choice, np.repeat(SQUARE[:1], n, axis=0), benchmark_camera(), grounding, judge)


def contradiction(gripper_m):
    return CameraContradiction(agreement=0.3, better=0.7, focal_ratio=0.7, gripper_m=gripper_m, gripper_rad=0.01)


def test_a_camera_that_the_arm_confirms_costs_no_search(tmp_path):
    for source in (CameraSource.FOLDER, CameraSource.GIVEN):
        sure, unsure = (Judge(CONFIRMED + step, contradiction=contradiction(0.2)) for step in (0.01, -0.01))
        choice = checked(tmp_path, sure, source=source)
        assert sure.searched == 0
        assert choice.to_json() == {"camera_agreement": CONFIRMED + 0.01}
        assert checked(tmp_path, unsure, source=source).contradiction is not None


@pytest.mark.parametrize("fitted", [True, False])
def test_a_wrong_camera_of_the_input_is_said_and_costs_the_base_frame_where_it_is_far_off(tmp_path, fitted):
    near = checked(tmp_path, Judge(0.3, contradiction=contradiction(0.5 * GRIPPER_SIGMA_M)), fitted=fitted)
    far = checked(tmp_path, Judge(0.3, contradiction=contradiction(2 * GRIPPER_SIGMA_M)), fitted=fitted)
    assert near.reason is None
    assert near.to_json()["camera_contradiction"]["focal_ratio"] == 0.7
    assert "1.43 times as long" in far.reason
    assert "100 mm" in far.reason
    assert far.sample.camera_source is CameraSource.FOLDER


@pytest.mark.parametrize("agreement", [AGREEMENT + 0.01, AGREEMENT - 0.01])
def test_a_doubtful_camera_stays_where_no_other_explains_the_arm_better_and_the_arm_agrees(tmp_path, agreement):
    choice = checked(tmp_path, Judge(agreement))
    assert (choice.reason is None) == (agreement > AGREEMENT)
    assert choice.to_json()["camera_agreement"] == agreement


def test_an_estimated_camera_is_not_checked_again(tmp_path):
    assert checked(tmp_path, Judge(0.2), source=CameraSource.ESTIMATED).agreement is None


@pytest.mark.parametrize("arm_seen", [True, False])
def test_a_camera_with_which_a_visible_arm_never_agrees_gives_no_base_frame(tmp_path, arm_seen):
    choice = checked(tmp_path, Judge(0.2), fitted=False, arm_seen=arm_seen)
    assert (choice.reason is not None) == arm_seen
    assert not arm_seen or "no tracked frame" in choice.reason


def test_where_no_gripper_is_tracked_the_arm_may_still_contradict_the_camera(tmp_path):
    choice = CameraChoice(sample=replace(sample(tmp_path), camera_source=CameraSource.FOLDER))
    assert explain_loss(choice, SQUARE, benchmark_camera(), Judge()) == ""
    wrong = Judge(contradiction=contradiction(0.2))
    assert "1.43 times as long" in explain_loss(choice, SQUARE, benchmark_camera(), wrong)
    assert explain_loss(CameraChoice(sample=sample(tmp_path)), SQUARE, benchmark_camera(), wrong) == ""
