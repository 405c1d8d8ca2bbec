"""The network as an estimator: in reduced precision and on a GPU it estimates what it does in single precision."""

import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.environment.precision import PRECISION_VARIABLE
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.view import Crop, GripperView
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.perception.network import fold_batch_normalisation, load_network, use_onednn
from kinebench_drake.track import GripperTrack

VIDEO = Path(__file__).parents[3] / "examples" / "videos" / "StackCube-v1_s0010_unseen.mp4"


def estimate(device: str) -> GripperView:
    camera = benchmark_camera()
    frames = read_video(VIDEO).frames[:1]
    estimates = NetworkEstimator(load_network(), device).estimate(frames, camera, {0: Crop.of_frame(camera)})
    return next(iter(estimates))[1]


def assert_alike(view: GripperView, exact: GripperView) -> None:
    """Differences are a fraction of the errors that the network itself expects."""
    robot = (view.part > 0) & (exact.part > 0)
    assert robot.sum() > 200
    assert (view.part != exact.part).sum() < 0.03 * robot.sum()
    robot &= view.part == exact.part
    off = np.linalg.norm(view.coordinates_P - exact.coordinates_P, axis=-1)[robot]
    assert np.median(off / exact.coordinates_sigma_m[robot]) < 0.25
    assert np.abs((view.coordinates_P - exact.coordinates_P)[robot].mean(axis=0)).max() < 2e-4
    relative = np.abs(view.depth_m / exact.depth_m - 1.0)[robot]
    assert np.median(relative / exact.depth_sigma[robot]) < 0.25


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> GripperView:
    """Estimates on the CPU in single precision."""
    with monkeypatch.context() as patch:
        patch.setenv(PRECISION_VARIABLE, "float32")
        return estimate("cpu")


@pytest.mark.skipif(
    not torch.ops.mkldnn._is_mkldnn_bf16_supported(), reason="the processor does not compute in bfloat16"
)
def test_bfloat16_changes_estimates_by_less_than_their_sigmas(
    monkeypatch: pytest.MonkeyPatch, exact: GripperView
) -> None:
    monkeypatch.setenv(PRECISION_VARIABLE, "bfloat16")
    reduced = estimate("cpu")
    assert not np.array_equal(reduced.depth_m, exact.depth_m)
    assert_alike(reduced, exact)


def test_onednn_convolutions_with_fused_clamping_give_the_same_outputs() -> None:
    network = fold_batch_normalisation(load_network()).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    clamping = use_onednn(network)
    random = torch.Generator().manual_seed(0)
    for count, size in ((2, 64), (1, 96), (3, 64), (2, 96)):  # in turn: each size has its own order of the weights
        images = torch.rand(count, 3, size, size, generator=random).contiguous(memory_format=torch.channels_last)
        with torch.inference_mode():
            plain = network(images)
            fused = clamping(images)
        torch.testing.assert_close(fused.log_depth, plain.log_depth, atol=1e-4, rtol=0.0)
        torch.testing.assert_close(fused.coordinates, plain.coordinates, atol=1e-4, rtol=0.0)


def test_whole_batches_have_one_size_and_run_in_one_thread(exact: GripperView, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = benchmark_camera()
    frames = read_video(VIDEO).frames[:3]
    estimator = NetworkEstimator(load_network(), "cpu")
    monkeypatch.setattr(estimator, "_whole_batch", 2)
    sizes = []
    threads = set()

    def spy(network: torch.nn.Module, inputs: tuple[torch.Tensor, ...]) -> None:
        sizes.append(len(inputs[0]))
        threads.add(threading.get_ident())

    estimator._network.register_forward_pre_hook(spy)
    for _ in range(2):
        views = dict(estimator.estimate(frames, camera, dict.fromkeys(range(3), Crop.of_frame(camera))))
        assert list(views) == [0, 1, 2]
        assert_alike(views[0], exact)
    assert sizes == [2, 2, 2, 2]
    assert len(threads) == 1


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_estimates_of_gpu_and_cpu_agree(exact: GripperView) -> None:
    assert_alike(estimate("cuda"), exact)


@pytest.mark.gpu
@pytest.mark.slow
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_tracks_of_gpu_and_cpu_agree() -> None:
    frames = read_video(VIDEO).frames
    camera = benchmark_camera()

    def track(device: str) -> GripperTrack:
        pipeline = GroundingPipeline.create(NetworkEstimator(load_network(), device))
        return pipeline.ground(frames, camera, 0.2 * np.arange(len(frames))).track

    on_gpu = track("cuda")
    exact = track("cpu")
    assert exact.tracked.sum() > 40
    np.testing.assert_array_equal(on_gpu.tracked, exact.tracked)
    off_m = np.linalg.norm((on_gpu.X_BG - exact.X_BG)[exact.tracked, :3, 3], axis=-1)
    assert np.median(off_m) < 5e-4
    assert off_m.max() < 3e-3
