"""The shipped networks on rendered videos with known poses: the documented accuracy."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import logit

from benchmarks.perception.clip import TruthClip, find_clips
from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.summary import summarize
from benchmarks.perception.trial import evaluate
from benchmarks.perception.variants import VARIANTS
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.overlay import draw_overlay, draw_pose
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.priors import NO_PRIORS, InitialStateUse, Priors
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.pose import (
    FRAME_FEATURES,
    Confidence,
    LogisticRegression,
    load_confidence,
)
from kinebench_drake.grounding.tracking.tracker import CadTracker, Tracking
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.cad import franka_hand
from kinebench_drake.models.panda.description import hand_from_tcp
from kinebench_drake.models.perception.network import load_network
from kinebench_drake.track import Domain

EXAMPLES = Path(__file__).parents[2] / "examples" / "videos"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def estimator() -> NetworkEstimator:
    return NetworkEstimator(load_network(), "cpu")


@pytest.fixture(scope="session")
def pipeline(estimator: NetworkEstimator) -> GroundingPipeline:
    return GroundingPipeline(CadTracker(estimator), load_confidence())


@pytest.fixture(scope="session")
def results(pipeline: GroundingPipeline) -> list[ClipErrors]:
    return [evaluate(c.load(), VARIANTS["pixels"], pipeline) for c in find_clips(EXAMPLES)]


@pytest.fixture(scope="session")
def clip() -> TruthClip:
    return next(c.load() for c in find_clips(EXAMPLES) if c.planted is None)


def test_clean_videos_are_tracked_with_the_documented_accuracy(results: list[ClipErrors]) -> None:
    clean = [e for e in results if not e.planted]
    assert len(clean) == 4
    figures = summarize(clean)
    assert figures["tracked_fraction_worst"] >= 0.95
    assert figures["position_median_mm"] <= 4.0
    assert figures["position_p95_mm"] <= 12.0
    assert figures["rotation_median_deg"] <= 2.0
    assert figures["rotation_p95_deg"] <= 6.0
    assert figures["longest_flip_frames"] == 0
    assert figures["anomalies_not_planted"] == 0


def test_planted_faults_are_reported_at_their_frames_without_false_alarms(results: list[ClipErrors]) -> None:
    faulty = [e for e in results if e.planted]
    assert {e.planted[0].kind.value for e in faulty} == {"vanish", "teleport", "freeze"}
    figures = summarize(faulty)
    assert figures["faults_found"] == figures["faults_planted"] == 3
    assert figures["anomalies_not_planted"] == 0


def test_frames_without_the_gripper_are_not_tracked(results: list[ClipErrors]) -> None:
    (vanish,) = [e for e in results if e.planted and e.planted[0].kind.value == "vanish"]
    assert not vanish.tracked[~vanish.visible].any()


def test_images_without_a_robot_give_no_track(pipeline: GroundingPipeline) -> None:
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (8, 12, 12, 3), dtype=np.uint8)
    frames = np.repeat(np.repeat(coarse, 32, axis=1), 32, axis=2)
    grounding = pipeline.ground(frames, benchmark_camera(), 0.2 * np.arange(8))
    assert not grounding.track.tracked.any()
    assert np.isnan(grounding.track.X_BG).all()
    assert grounding.anomalies == ()


@pytest.mark.parametrize(("agreeing", "comparisons"), [(0, 1), (bounds.SAMPLED_FRAMES, 2)])
def test_a_followed_camera_is_compared_with_a_fixed_one_only_if_frames_show_the_arm(
    pipeline: GroundingPipeline, clip: TruthClip, agreeing: int, comparisons: int
) -> None:
    class Fake:
        """Tracker that finds the same poses in any images, and counts these."""

        def __init__(self) -> None:
            self.counts: list[int] = []

        def track(
            self, frames: Frames, camera: Camera, priors: Priors = NO_PRIORS, places: Array | None = None
        ) -> Tracking:
            self.counts.append(len(frames))
            return replace(seen, poses=(pose,) * len(frames), wide=seen.wide[:1] * len(frames))

    seen = pipeline.tracker.track(read_video(clip.path).frames[:1], clip.camera)
    pose = seen.poses[0] if agreeing else None
    rng = np.random.default_rng(0)
    wide = cv2.resize(rng.integers(0, 255, (48, 72, 3), dtype=np.uint8), (576, 384), interpolation=cv2.INTER_CUBIC)
    frames = np.stack([wide[:, 8 * k : 8 * k + 384] for k in range(12)])
    tracker = Fake()
    GroundingPipeline(tracker, load_confidence()).observe(frames, clip.camera, 0.2 * np.arange(12))
    assert tracker.counts == [1, *comparisons * [bounds.SAMPLED_FRAMES], len(frames)]


def test_the_initial_state_is_used_unless_the_first_frame_contradicts_it(
    pipeline: GroundingPipeline, clip: TruthClip
) -> None:
    frames = read_video(clip.path).frames[:6]
    t_s = clip.t_s[:6]
    used = pipeline.ground(frames, clip.camera, t_s, Priors(initial_state=clip.initial_state))
    assert used.first_frame is InitialStateUse.USED
    assert used.from_prior.tolist() == [True] + [False] * 5
    np.testing.assert_allclose(used.track.X_CH[0], clip.X_CH[0], atol=1e-9)
    assert used.track.finger_width_m[0] == pytest.approx(clip.finger_width_m[0], abs=1e-4)
    elsewhere = replace(
        clip.initial_state,
        X_BG=make_pose(clip.initial_state.X_BG[:3, :3], clip.initial_state.X_BG[:3, 3] + [0.0, 0.05, 0.0]),
    )
    refused = pipeline.ground(frames, clip.camera, t_s, Priors(initial_state=elsewhere))
    assert refused.first_frame is InitialStateUse.CONTRADICTED
    np.testing.assert_array_equal(refused.track.X_CH, pipeline.ground(frames, clip.camera, t_s).track.X_CH)


@pytest.mark.parametrize(
    ("familiar", "unfamiliar", "domain"),
    [(0.9, 0.99, Domain.FAMILIAR), (0.7, 0.75, Domain.UNFAMILIAR), (0.7, 0.65, Domain.FAMILIAR)],
)
def test_a_doubtful_video_gets_the_domain_with_more_expected_correct_poses(
    estimator: NetworkEstimator, clip: TruthClip, familiar: float, unfamiliar: float, domain: Domain
) -> None:
    def always(probability: float, of: Domain) -> Confidence:
        weights = np.zeros(len(FRAME_FEATURES[of]))
        return replace(shipped[of], frame=LogisticRegression(intercept=float(logit(probability)), weights=weights))

    shipped = load_confidence()
    confidence = {
        **shipped,
        Domain.FAMILIAR: always(familiar, Domain.FAMILIAR),
        Domain.UNFAMILIAR: always(unfamiliar, Domain.UNFAMILIAR),
    }
    frames = read_video(clip.path).frames[:2]
    assert CadTracker(estimator, confidence=confidence).track(frames, clip.camera).domain is domain
    assumed = CadTracker(estimator, confidence=confidence).track(frames, clip.camera, Priors(camera_is_assumed=True))
    assert assumed.domain is Domain.FAMILIAR


def test_poses_from_priors_are_used_unchanged(pipeline: GroundingPipeline, clip: TruthClip) -> None:
    X_CH = clip.X_CH[:6].copy()
    X_CH[3] = np.nan
    grounding = pipeline.ground(read_video(clip.path).frames[:6], clip.camera, clip.t_s[:6], Priors(X_CH=X_CH))
    frames = [0, 1, 2, 4, 5]
    assert grounding.from_prior.nonzero()[0].tolist() == frames
    np.testing.assert_allclose(grounding.track.X_CH[frames], X_CH[frames], atol=1e-9)
    assert (grounding.track.confidence[frames] == 1.0).all()
    assert np.linalg.norm(grounding.track.X_CH[3, :3, 3] - clip.X_CH[3, :3, 3]) < 0.01


def test_the_path_does_not_depend_on_the_image_size(pipeline: GroundingPipeline, clip: TruthClip) -> None:
    import cv2

    frames = read_video(clip.path).frames[:12]
    small = np.stack([cv2.resize(f, (320, 320), interpolation=cv2.INTER_AREA) for f in frames])
    large, little = (pipeline.ground(v, clip.camera, clip.t_s[:12]).track.X_CH[:, :3, 3] for v in (frames, small))
    assert np.median(np.linalg.norm(large - little, axis=1)) < 0.01


def test_the_track_is_the_tcp_in_the_base_frame(pipeline: GroundingPipeline, clip: TruthClip) -> None:
    track = pipeline.ground(read_video(clip.path).frames[:4], clip.camera, clip.t_s[:4]).track
    with np.load(EXAMPLES / "truth" / f"{clip.id}.npz", allow_pickle=False) as truth:
        distance = np.linalg.norm(track.X_BG[:, :3, 3] - truth["base_from_tcp"][:4, :3, 3], axis=1)
    assert np.median(distance) < 0.015


def test_the_overlay_lies_on_the_gripper(pipeline: GroundingPipeline, clip: TruthClip) -> None:
    frames = read_video(clip.path).frames[:2]
    track = pipeline.ground(frames, clip.camera, clip.t_s[:2]).track
    drawn = next(iter(draw_overlay(frames, clip.camera, track, gripper=franka_hand())))
    changed = np.abs(drawn[30:].astype(int) - frames[0][30:]).sum(axis=2) > 20
    v, u = np.nonzero(changed)
    centre = clip.camera.project(clip.X_CH[0, :3, 3] + 0.05 * clip.X_CH[0, :3, 2])
    assert np.hypot(u.mean() - centre[0], v.mean() + 30 - centre[1]) < 15.0


def test_the_overlay_draws_the_axes_at_the_projected_tcp() -> None:
    camera = benchmark_camera()
    for offset in np.linspace(0.0, 0.002, 9):
        X_CH = make_pose(np.eye(3), [0.0, 0.05 + offset, 0.8])
        drawn = draw_pose(np.zeros((camera.height, camera.width, 3), np.uint8), camera, X_CH, 0.04, None)
        weight = np.maximum(drawn[..., 0].astype(float) - drawn[..., 1], 0.0)  # the red axis, x, is level in the image
        weight[:, : camera.width // 2 + 8] = 0.0  # where the others begin
        row = (weight.sum(axis=1) * (np.arange(camera.height) + 0.5)).sum() / weight.sum()
        assert row == pytest.approx(camera.project((X_CH @ hand_from_tcp())[None, :3, 3])[0, 1], abs=0.3)


@pytest.mark.sapien
def test_true_mask_and_depth_give_errors_below_a_millimetre_and_half_a_degree(
    tmp_path: Path, pipeline: GroundingPipeline
) -> None:
    from click.testing import CliRunner

    from kinebench_drake.cli import cli

    arguments = ["suite", "demos", "--out", str(tmp_path), "--task", "PullCube-v1", "--episodes", "1", "--with-depth"]
    assert CliRunner().invoke(cli, arguments).exit_code == 0
    (clip,) = (c.load(with_depth=True) for c in find_clips(tmp_path))
    assert isinstance(clip, TruthClip)
    errors = evaluate(clip, VARIANTS["true-mask-and-depth"], pipeline)
    figures = summarize([errors])
    assert figures["tracked_fraction"] >= 0.95
    assert figures["position_median_mm"] <= 1.0
    assert figures["position_p95_mm"] <= 3.0
    assert figures["rotation_median_deg"] <= 0.5
