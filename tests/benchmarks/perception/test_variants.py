"""Ground truth, degraded depth and external depth in place of estimates; the estimator is a fake."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.perception.clip import TruthClip
from benchmarks.perception.study import depth_ablation
from benchmarks.perception.variants import Degradation, DegradedEstimator, external
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.grounding.overrides.depth import DepthPlugIn
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.grounding.tracking.view import Crop, GripperView, OverrideEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import RobotPart


class Flat:
    """Estimator of a hand one metre away everywhere."""

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        return ((number, self.view(crop)) for number, crop in crops.items())

    @staticmethod
    def view(crop: Crop) -> GripperView:
        n = crop.size // 2
        return GripperView(
            crop=crop,
            stride=2,
            in_image=np.ones((n, n), dtype=bool),
            part=np.full((n, n), RobotPart.HAND, np.uint8),
            depth_m=np.ones((n, n)),
            depth_sigma=np.full((n, n), 0.02),
            depth_factor_sigma=0.012,
            coordinates_P=np.zeros((n, n, 3)),
            coordinates_sigma_m=np.full((n, n), 0.01),
        )


@pytest.fixture
def crop() -> Crop:
    return Crop.towards([0.0, 0.0, 1.0], 0.4, 64)


def test_true_mask_and_depth_replace_estimates_of_their_own_frame(
    square: tuple[np.ndarray, np.ndarray], camera: Camera, crop: Crop
) -> None:
    frames, masks = square
    depth = np.broadcast_to(0.5 + 0.01 * np.arange(len(frames))[:, None, None], masks.shape)
    estimator = OverrideEstimator(
        Flat(), Priors(mask=masks, depth=ExternalDepth(depth_m=np.where(masks, depth, 0.0), exact=True))
    )
    views = dict(estimator.estimate(frames, camera, dict.fromkeys([7, 2, 11], crop)))
    assert views.keys() == {7, 2, 11}
    for number, view in views.items():
        assert 0 < view.gripper.sum() < view.part.size
        np.testing.assert_allclose(view.depth_m[view.gripper], 0.5 + 0.01 * number, rtol=1e-6)
        assert (view.depth_m[~view.gripper] == 1.0).all()
        assert (view.depth_sigma[view.gripper] == 1e-3).all()


def test_without_a_prior_mask_or_depth_the_estimate_stays(
    square: tuple[np.ndarray, np.ndarray], camera: Camera, crop: Crop
) -> None:
    frames, masks = square
    view = dict(OverrideEstimator(Flat(), Priors(mask=masks)).estimate(frames, camera, {0: crop}))[0]
    assert (view.depth_m == 1.0).all()
    assert not view.gripper.all()
    depth = np.full(masks.shape, 0.6)
    view = dict(
        OverrideEstimator(Flat(), Priors(depth=ExternalDepth(depth_m=depth))).estimate(frames, camera, {0: crop})
    )[0]
    assert view.gripper.all()
    np.testing.assert_allclose(view.depth_m, 0.6, rtol=1e-6)


def test_masks_of_another_video_are_refused(square: tuple[np.ndarray, np.ndarray], camera: Camera, crop: Crop) -> None:
    frames, masks = square
    with pytest.raises(InputError, match="shape"):
        Priors(mask=masks[:3]).check_shapes(*frames.shape[:3])


@pytest.mark.parametrize(
    ("degradation", "spread"),
    [(Degradation(scale=0.05), 0.0), (Degradation(field=0.05), 0.05), (Degradation(noise=0.05), 0.05)],
)
def test_degraded_depth_has_its_nominal_rms_error_and_repeats_by_seed(
    square: tuple[np.ndarray, np.ndarray], camera: Camera, degradation: Degradation, spread: float
) -> None:
    frames, _ = square
    wide = Crop.towards([0.0, 0.0, 1.0], 0.5, 96)
    errors = []
    for seed in range(6):
        worse = DegradedEstimator(Flat(), len(frames), degradation, np.random.default_rng(seed))
        views = dict(worse.estimate(frames, camera, dict.fromkeys(range(len(frames)), wide)))
        errors.append([views[i].depth_m - 1.0 for i in range(len(frames))])
        again = DegradedEstimator(Flat(), len(frames), degradation, np.random.default_rng(seed))
        np.testing.assert_array_equal(dict(again.estimate(frames, camera, {3: wide}))[3].depth_m, views[3].depth_m)
    values = np.array(errors)
    assert np.sqrt((values**2).mean()) == pytest.approx(0.05, rel=0.15)
    assert np.mean([e.std() for e in values]) == pytest.approx(spread, rel=0.3, abs=1e-9)


def test_a_smooth_depth_error_is_smooth_in_image_and_time(
    square: tuple[np.ndarray, np.ndarray], camera: Camera
) -> None:
    frames, _ = square
    wide = Crop.towards([0.0, 0.0, 1.0], 0.5, 96)
    worse = DegradedEstimator(Flat(), len(frames), Degradation(field=0.05), np.random.default_rng(0))
    views = dict(worse.estimate(frames, camera, dict.fromkeys(range(len(frames)), wide)))
    error = np.array([views[i].depth_m - 1.0 for i in range(len(frames))])
    for axis in (0, 1, 2):
        assert np.diff(error, axis=axis).std() < 0.6 * error.std()


CLASS = """
class Ramp:
    def depth(self, frames, camera):
        return 0.5 + frames[..., 1] / 100 + 0 * camera.rays()[..., 0]
"""


def test_a_depth_plugin_reaches_the_pipeline_as_inexact_prior(
    clip: TruthClip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a_ramp_of_mine.py").write_text(CLASS)
    monkeypatch.syspath_prepend(tmp_path)
    calls = list[Priors]()
    shipped = SimpleNamespace(ground=lambda frames, camera, t_s, priors: calls.append(priors))
    frames = np.random.default_rng(0).integers(0, 255, (5, 192, 192, 3), dtype=np.uint8)  # other than the camera
    external(DepthPlugIn("a_ramp_of_mine:Ramp"))(SimpleNamespace(shipped=shipped), clip, frames)  # type: ignore[arg-type]
    (priors,) = calls
    assert priors.depth is not None
    assert not priors.depth.exact
    np.testing.assert_allclose(priors.depth.depth_m, 0.5 + frames[..., 1] / 100)
    assert (priors.mask, priors.X_CH, priors.initial_state) == (None, None, None)


def test_a_missing_depth_estimator_is_refused_before_any_measurement() -> None:
    with pytest.raises(UsageError, match="no module"):
        depth_ablation(["no_such_module:Depth"])
