"""Which camera a video gets: the rule for named, assumed and estimated cameras, with evidence known in advance."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import CONFIRMED, CameraSource, CameraState, benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import make_pose
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections, Detection
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene
from kinebench_drake.grounding.camera.camera_estimate import (
    ALIGNED_AGREEMENT,
    ALIGNED_BASE_AGREEMENT,
    ARM_AGREEMENT,
    GRIPPER_SIGMA_M,
    CameraEstimate,
    Rival,
)
from kinebench_drake.grounding.camera.check import LARGE_M, SURE_AGREEMENT
from kinebench_drake.grounding.camera.estimate import usual_camera
from kinebench_drake.grounding.camera.evidence import BetterReading, CameraContradiction, PictureReading
from kinebench_drake.grounding.camera.lens import Lens
from kinebench_drake.grounding.camera.recognition import Recognition
from kinebench_drake.grounding.camera.watch import CameraWatch
from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.grounding.priors import Clip, InitialStateUse, Priors
from kinebench_drake.grounding.video import Grounder
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.named_cameras import named_cameras
from kinebench_drake.track import Domain, GripperTrack
from tests.grounding.camera.robot import certain_bundle

WIDE = np.zeros((12, 96, 160, 3), np.uint8)
SQUARE = np.zeros((12, 96, 96, 3), np.uint8)
T = len(SQUARE)
NO_ANOMALY = AnomalyDetections(by_kind={kind: Detection(kind=kind, score=np.zeros(T)) for kind in AnomalyKind})


class Tracker:
    """A pipeline that tracks everything or nothing, and notes that it was asked."""

    def __init__(self, parts, name, domain, *, tracks):
        self.parts = parts
        self.name = name
        self.domain = domain
        self.tracks = tracks

    def ground(self, frames, camera, t_s, priors, stride=1):
        self.parts.asked.append("assumed" if priors.camera_is_assumed else self.name)
        tracked = np.full(T, self.tracks)
        X = np.where(tracked[:, None, None], make_pose(np.eye(3), [0.4, 0.0, 0.3]), np.nan)
        track = GripperTrack(
            t_s=t_s,
            X_CH=X,
            X_BG=X,
            tracked=tracked,
            confidence=0.9 * tracked,
            finger_width_m=np.full(T, np.nan),
        )
        return PipelineResult(
            track=track,
            domain=self.domain,
            gripper=GripperKind.FRANKA if self.name == "ground" else GripperKind(self.name),
            from_prior=np.zeros(T, bool),
            first_frame=InitialStateUse.UNKNOWN,
            detections=NO_ANOMALY,
            camera_motion_px=0.1,
            arm_consistency_px=2.0 if self.parts.arm_seen else None,
            wide=(),
            arm_q=np.full((T, 7), 0.1 if self.parts.fitted else np.nan),
            X_CH_raw=X,
            is_between=np.zeros(T, bool),
        )


class Evidence:
    """Parts of the grounding whose evidence for cameras is known in advance, and that note what is asked of them."""

    def __init__(self, *, agreements=(0.7,), recognized=None, estimate=None, contradiction=None, reading=None, hands=8):
        self.agreements = list(agreements)
        self.recognized = recognized
        self.estimated = estimate
        self.contradiction = contradiction
        self.reading = reading
        self.hands = hands
        self.asked = []
        self.domain = Domain.FAMILIAR
        self.fitted = True
        self.arm_seen = True
        self.in_reach = True
        self.arm_tracks = False
        self.hand_tracks = True
        self.checker = self

    def of(self, gripper):
        is_franka = gripper is GripperKind.FRANKA
        hand = Tracker(self, "ground", self.domain, tracks=self.hand_tracks)
        other = Tracker(self, gripper.value, Domain.ARM, tracks=self.arm_tracks)
        return SimpleNamespace(pipeline=hand if is_franka else other, cameras=self)

    def track_agreement(self, frames, camera, result):
        if not np.isfinite(result.arm_q).any() or not result.has_pose.any():
            return None
        return self.agreements.pop(0) if len(self.agreements) > 1 else self.agreements[0]

    def reaches(self, track):
        return self.in_reach

    def recognize(self, frames):
        self.asked.append("recognize")
        return self.recognized

    def find_reading(self, frames, camera, least, readings):
        names = {len(PictureReading): "readings", 1: "crop"}
        self.asked.append(names.get(len(readings), "likely readings"))
        return self.reading

    def find_contradiction(self, frames, camera):
        self.asked.append("contradiction")
        return self.contradiction

    def count_hands(self, frames, camera):
        return self.hands, 8

    def estimate(self, frames, camera):
        self.asked.append("estimate")
        if self.estimated is None:
            raise UnmeasurableError("no camera can be estimated: nothing is seen")
        return self.estimated


def estimate(**changes):
    fields = {
        "bundle": certain_bundle(
            ArmScene(lens=Lens.of_camera(usual_camera(160, 96)), q=np.zeros((4, 7)), finger_m=np.zeros(4))
        ),
        "frames": np.arange(4),
        "gripper_sigma_m": 0.01,
        "gripper_sigma_rad": 0.01,
        "agreement": ARM_AGREEMENT + 0.1,
        "base_agreement": bounds.BASE_AGREEMENT + 0.1,
        "residual_px": 0.4,
        "part": np.zeros(0, np.uint8),
    }
    return CameraEstimate(**{**fields, **changes})


def rival(share):
    return Rival(camera=usual_camera(160, 96), share=share)


def recognition(name, shown=None):
    named = named_cameras()[name]
    camera = named.setting.camera.resized(96, 96)
    return Recognition(
        named=named, camera=camera, reading=shown, agreement=0.6, base_agreement=0.6, lead=0.2, freed=0.6
    )


def reading(kind=PictureReading.MIRRORED):
    return BetterReading(reading=kind, agreement=0.5, better=0.72, camera=benchmark_camera())


def contradiction(gripper_m):
    return CameraContradiction(agreement=0.3, better=0.7, focal_ratio=0.7, gripper_m=gripper_m, gripper_rad=0.01)


def ground(evidence, frames=SQUARE, *, source=None, gripper=GripperKind.AUTO, watch=None):
    """Ground a video, unnamed if there is no source."""
    camera = None if source is None else benchmark_camera()
    clip = Clip(frames=frames, t_s=0.1 * np.arange(len(frames)))
    options = {"source": source or CameraSource.ARGUMENT, "gripper": gripper, "watch": watch}
    return Grounder(evidence).ground(clip, camera, **options)


@pytest.mark.parametrize(
    ("agreement", "asked"),
    [
        (SURE_AGREEMENT, ["assumed"]),
        (SURE_AGREEMENT - 0.01, ["assumed", "likely readings"]),
        (CONFIRMED, ["assumed", "likely readings"]),
    ],
)
def test_the_benchmark_camera_is_assumed_for_an_unnamed_one_if_the_track_confirms_it(agreement, asked):
    evidence = Evidence(agreements=[agreement])
    grounded = ground(evidence)
    assert evidence.asked == asked
    assert grounded.choice.state is CameraState.CONFIRMED
    assert grounded.choice.agreement == agreement
    assert np.isfinite(grounded.track.X_BG).all()


class Shapes(Evidence):
    """Evidence of an estimate that agrees best with one ratio fy / fx of the focal lengths."""

    def __init__(self, ratio):
        super().__init__(agreements=[0.1, 0.7])
        self.ratio = ratio
        self.ratios = []

    def estimate(self, frames, camera):
        ratio = camera.fy / camera.fx
        self.ratios.append(round(ratio, 3))
        scene = ArmScene(lens=Lens.of_camera(camera), q=np.zeros((4, 7)), finger_m=np.zeros(4))
        return estimate(bundle=certain_bundle(scene), agreement=0.9 - abs(ratio - self.ratio))


@pytest.mark.parametrize(
    ("size", "ratios", "best"),
    [((160, 96), [1.067, 1.0], 1.067), ((160, 96), [1.067, 1.0], 1.0), ((208, 120), [1.0], 1.0)],
)
def test_a_picture_that_may_have_been_stretched_is_estimated_both_ways(size, ratios, best):
    evidence = Shapes(best)
    width, height = size
    grounded = ground(evidence, np.zeros((T, height, width, 3), np.uint8))
    assert evidence.ratios == ratios
    assert grounded.camera.fy / grounded.camera.fx == pytest.approx(best, abs=1e-3)


def test_an_assumed_camera_just_below_the_agreement_bound_gives_no_base_frame():
    grounded = ground(Evidence(agreements=[CONFIRMED - 0.01]))
    assert grounded.choice.state is CameraState.NONE
    assert grounded.choice.to_json()["camera_source"] == "none"
    assert np.isnan(grounded.track.X_BG).all()
    assert np.isfinite(grounded.track.X_CH).all()
    assert "59%" in grounded.choice.reason
    assert "nothing is seen" in grounded.choice.reason


@pytest.mark.parametrize("name", ["benchmark", "libero-tabletop", "robosuite-agentview"])
@pytest.mark.parametrize("agreement", [bounds.AGREEMENT, bounds.AGREEMENT - 0.01])
def test_a_recognized_camera_gives_a_base_frame_if_the_track_with_it_confirms_it(name, agreement):
    evidence = Evidence(agreements=[0.9, agreement], recognized=recognition(name))
    evidence.domain = Domain.UNFAMILIAR
    choice = ground(evidence).choice
    assert evidence.asked == ["assumed", "recognize", "ground"]
    assert choice.table_height_m == named_cameras()[name].setting.table_height_m
    assert choice.to_json()["camera_name"] == name
    assert (choice.state is CameraState.CONFIRMED) == (agreement >= bounds.AGREEMENT)
    assert (choice.reason is None) == (agreement >= bounds.AGREEMENT)
    if choice.reason is None:
        assert choice.to_json()["camera_source"] == ("benchmark" if name == "benchmark" else "recognized")


@pytest.mark.parametrize(
    ("shown", "axis"),
    [(PictureReading.ROWS_REVERSED, 1), (PictureReading.MIRRORED, 2)],
    ids=["rows reversed", "mirrored"],
)
def test_pictures_that_are_published_turned_are_turned_before_they_are_measured(shown, axis):
    frames = SQUARE.copy()
    frames[:, :40, :40] = 200
    evidence = Evidence(agreements=[0.3, 0.6], recognized=recognition("libero-tabletop", shown))
    grounded = ground(evidence, frames)
    np.testing.assert_array_equal(grounded.frames, np.flip(frames, axis))
    assert grounded.choice.to_json()["camera_shown"] == shown.value
    assert np.isfinite(grounded.track.X_BG).all()


def test_a_picture_turned_as_its_camera_does_not_publish_it_is_reported_without_a_base_frame():
    evidence = Evidence(agreements=[0.3], recognized=recognition("benchmark", PictureReading.MIRRORED))
    grounded = ground(evidence)
    assert grounded.choice.to_json()["camera_reading"]["reading"] == "mirrored"
    assert np.isnan(grounded.track.X_BG).all()
    assert evidence.asked == ["assumed", "recognize"]


def test_a_turned_picture_is_not_recognized_for_masks_of_the_picture_as_it_is():
    evidence = Evidence(agreements=[0.3], recognized=recognition("libero-tabletop", PictureReading.MIRRORED))
    clip = Clip(frames=SQUARE, t_s=0.1 * np.arange(T))
    with pytest.raises(UnmeasurableError, match="turn all of them first"):
        Grounder(evidence).ground(clip, priors=Priors(mask=np.zeros((T, 96, 96), bool)))


@pytest.mark.parametrize("source", [None, CameraSource.FOLDER, CameraSource.OPTION])
@pytest.mark.parametrize("agreement", [0.3, CONFIRMED + 0.02])
def test_a_camera_reading_that_agrees_better_is_reported_and_leaves_no_base_frame(source, agreement):
    evidence = Evidence(agreements=[agreement], reading=reading())
    grounded = ground(evidence, source=source)
    assert "the picture mirrored left-right agrees better" in grounded.choice.reason
    assert "72%" in grounded.choice.reason
    assert "$mirrored=True" in grounded.choice.reason
    assert grounded.choice.to_json()["camera_reading"]["reading"] == "mirrored"
    assert "estimate" not in evidence.asked
    assert np.isnan(grounded.track.X_BG).all()


def test_no_camera_is_estimated_for_a_video_without_any_hand():
    evidence = Evidence(hands=0)
    evidence.hand_tracks = False
    with pytest.raises(UnmeasurableError, match="no Franka hand is found in any of 8 frames searched"):
        ground(evidence)
    assert evidence.asked.count("estimate") == 1  # by the arm with a Robotiq 2F-85


@pytest.mark.parametrize("agreement", [CONFIRMED, CONFIRMED - 0.01])
def test_a_video_without_a_hand_is_grounded_by_the_arm_if_it_confirms_the_assumed_camera(agreement):
    evidence = Evidence(hands=0, agreements=[agreement])
    evidence.arm_tracks = True
    evidence.hand_tracks = False
    grounded = ground(evidence)
    assert grounded.measured.domain is Domain.ARM
    assert (grounded.choice.state is CameraState.CONFIRMED) == (agreement >= CONFIRMED)
    assert np.isfinite(grounded.track.X_BG).all() == (agreement >= CONFIRMED)


def test_a_camera_is_estimated_if_a_detected_hand_has_no_track_with_the_benchmark_camera():
    evidence = Evidence(hands=8)
    evidence.hand_tracks = False
    with pytest.raises(UnmeasurableError, match="no Franka hand is found in any of 12 frames"):
        ground(evidence)
    assert "estimate" in evidence.asked


@pytest.mark.parametrize(
    ("best", "words"),
    [
        (estimate(), None),
        (None, "nothing is seen"),
        (estimate(agreement=ARM_AGREEMENT - 0.01), "no estimated camera agrees"),
        (estimate(agreement=ALIGNED_AGREEMENT - 0.01, is_aligned=True), "no estimated camera agrees"),
        (estimate(others=(rival(0.9),)), "two different cameras"),
        (estimate(base_agreement=bounds.BASE_AGREEMENT - 0.01), "cannot be seen"),
        (estimate(base_agreement=ALIGNED_BASE_AGREEMENT - 0.01, is_aligned=True), "cannot be seen"),
        (estimate(turns=(rival(bounds.BASE_AGREEMENT + 0.09),)), "two turns"),
        (estimate(gripper_sigma_m=GRIPPER_SIGMA_M + 0.01), "uncertain by 30 mm"),
    ],
)
def test_an_estimated_camera_gives_a_base_frame_only_if_it_agrees_and_is_determined(best, words):
    choice = ground(Evidence(estimate=best), WIDE).choice
    assert (choice.camera.width, choice.camera.height) == (160, 96)
    if words is None:
        assert choice.reason is None
        assert choice.to_json()["camera_source"] == choice.state.value == "estimated"
    else:
        assert words in choice.reason
        assert choice.to_json()["camera_source"] == choice.state.value == "none"


@pytest.mark.parametrize(("agreement", "tracks"), [(0.7, 3), (bounds.AGREEMENT - 0.01, 0)])
def test_a_clip_with_several_possible_cameras_has_a_track_with_each_if_its_arm_confirms_all(agreement, tracks):
    best = estimate(turns=(rival(0.49), rival(0.3)), others=(rival(0.6), rival(0.2)))
    assert len(best.rivals) == 2
    grounded = ground(Evidence(agreements=[0.7, agreement], estimate=best), WIDE)
    assert np.isnan(grounded.track.X_BG).all()
    assert [np.isfinite(track.X_BG).all() for track in grounded.possible] == [True] * tracks
    assert {track.offset_m for track in grounded.possible} <= {0.02}
    many = estimate(turns=tuple(rival(0.49) for _ in range(4)))
    assert len(ground(Evidence(estimate=many), WIDE).possible) == 0


def test_lines_along_the_base_axes_lower_the_agreement_required_of_an_estimated_camera():
    few = estimate(agreement=ALIGNED_AGREEMENT + 0.01, base_agreement=ALIGNED_BASE_AGREEMENT + 0.01)
    assert few.doubt is not None
    assert replace(few, is_aligned=True).doubt is None


def test_the_offset_bound_of_a_track_is_two_sigmas_of_its_estimated_camera():
    track = ground(Evidence(estimate=estimate()), WIDE).track
    assert (track.offset_m, track.offset_rad) == (0.02, 0.02)
    assert ground(Evidence(), SQUARE).track.offset_m == 0.0


@pytest.mark.parametrize("agreement", [bounds.AGREEMENT, bounds.AGREEMENT - 0.01])
def test_an_estimated_camera_needs_the_agreement_of_the_final_track(agreement):
    choice = ground(Evidence(agreements=[agreement], estimate=estimate()), WIDE).choice
    assert (choice.reason is None) == (agreement >= bounds.AGREEMENT)


def test_a_named_camera_that_the_arm_confirms_is_not_compared_with_other_readings():
    for source in (CameraSource.FOLDER, CameraSource.ARGUMENT):
        sure = Evidence(agreements=[SURE_AGREEMENT])
        unsure = Evidence(agreements=[CONFIRMED - 0.01])
        assert ground(sure, source=source).choice.state is CameraState.NAMED
        assert sure.asked == ["ground"]
        ground(unsure, source=source)
        assert unsure.asked == ["ground", "readings", "contradiction"]


@pytest.mark.parametrize("fitted", [True, False])
def test_a_named_camera_far_from_one_that_explains_the_arm_better_gives_no_base_frame(fitted):
    def choose(gripper_m):
        evidence = Evidence(agreements=[0.3], contradiction=contradiction(gripper_m))
        evidence.fitted = fitted
        return ground(evidence, source=CameraSource.FOLDER).choice

    near = choose(0.5 * LARGE_M)
    far = choose(2 * LARGE_M)
    assert near.reason is None
    assert near.to_json()["camera_contradiction"]["focal_ratio"] == 0.7
    assert "1.43 times as long" in far.reason
    assert "60 mm" in far.reason
    assert far.source is CameraSource.FOLDER


@pytest.mark.parametrize("agreement", [bounds.AGREEMENT + 0.01, bounds.AGREEMENT - 0.01])
def test_a_doubtful_named_camera_without_a_better_one_is_kept_if_the_arm_agrees(agreement):
    choice = ground(Evidence(agreements=[agreement]), source=CameraSource.FOLDER).choice
    assert (choice.reason is None) == (agreement > bounds.AGREEMENT)
    assert choice.to_json()["camera_agreement"] == agreement


@pytest.mark.parametrize("arm_seen", [True, False])
def test_a_named_camera_gives_no_base_frame_if_a_visible_arm_agrees_in_no_frame(arm_seen):
    evidence = Evidence()
    evidence.fitted = False
    evidence.arm_seen = arm_seen
    choice = ground(evidence, source=CameraSource.FOLDER).choice
    assert (choice.reason is not None) == arm_seen
    assert not arm_seen or "no tracked frame" in choice.reason


@pytest.mark.parametrize("agreement", [CONFIRMED, bounds.AGREEMENT - 0.01])
def test_the_track_of_an_arm_without_a_hand_needs_the_same_agreement(agreement):
    evidence = Evidence(agreements=[agreement])
    evidence.arm_tracks = True
    grounded = ground(evidence, source=CameraSource.FOLDER, gripper=GripperKind.NONE)
    assert evidence.asked[0] == "none"
    assert "contradiction" not in evidence.asked  # it is sought by hands
    assert (grounded.choice.reason is None) == (agreement >= bounds.AGREEMENT)


def test_the_arm_alone_is_not_tried_if_another_camera_reading_explains_the_hand():
    evidence = Evidence(reading=reading(PictureReading.OPENGL_AXES))
    evidence.hand_tracks = False
    with pytest.raises(UnmeasurableError, match="OpenGL axes"):
        ground(evidence, source=CameraSource.FOLDER)
    assert evidence.asked == ["ground", "readings"]


@pytest.mark.parametrize("arm_seen", [True, False])
def test_a_named_camera_with_which_no_arm_reaches_the_hand_gives_no_base_frame(arm_seen):
    evidence = Evidence()
    evidence.fitted = False
    evidence.arm_seen = arm_seen
    evidence.in_reach = False
    choice = ground(evidence, source=CameraSource.FOLDER).choice
    assert "no posture holds it in any of 12 tracked frames" in choice.reason
    assert choice.state is CameraState.NONE


def test_a_video_with_a_cut_is_unmeasurable_and_the_message_names_the_frame():
    scene = np.kron(np.random.default_rng(0).integers(0, 255, (1, 8, 8, 3)), np.ones((1, 12, 12, 1))).astype(np.uint8)
    frames = np.repeat(np.concatenate([scene, 255 - scene]), 6, axis=0)
    with pytest.raises(UnmeasurableError, match=r"cut before frame 6: several clips in one video"):
        Grounder(Evidence()).ground(Clip(frames=frames, t_s=np.arange(T) / 10))


def test_a_watched_camera_is_checked_with_clips_until_one_passes_and_then_spot_checked():
    evidence = Evidence(agreements=(0.2, 0.9, 0.2, 0.9))
    watch = CameraWatch(every=3)
    results = [ground(evidence, source=CameraSource.ARGUMENT, watch=watch).choice for _ in range(6)]
    assert [choice.agreement for choice in results] == [0.2, 0.9, None, None, 0.2, 0.9]
    assert [choice.reason is None for choice in results] == [False, True, True, True, False, True]


def test_a_clip_in_which_hand_and_arm_do_not_agree_has_a_watched_camera_checked():
    evidence = Evidence(agreements=(0.9,))
    watch = CameraWatch(every=3)
    ground(evidence, source=CameraSource.ARGUMENT, watch=watch)
    evidence.fitted = False
    assert ground(evidence, source=CameraSource.ARGUMENT, watch=watch).choice.reason is not None
