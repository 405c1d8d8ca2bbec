"""Laws of the baseline, on synthetic demonstrations: a bright square whose position encodes the pose."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.geometry import make_pose, rotation_exp
from training.baseline.fitting import (
    LABELLED,
    BaselineConfig,
    Demonstrations,
    Windows,
    decode,
    load_demonstrations,
    losses,
    train,
)
from training.baseline.network import CONTEXT, Baseline, PoseOutput, from_six, resize_frames
from training.loop import Schedule

FRAMES = 6
SIZE = 64


def rotations(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(n, 3))
    return rotation_exp(axis / np.linalg.norm(axis, axis=1, keepdims=True) * rng.uniform(0, np.pi, (n, 1)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("demos")
    (out / "truth").mkdir()
    save_camera(benchmark_camera(), out / "camera.json")
    lines = []
    for number, task in enumerate(("Often-v1", "Often-v1", "Often-v1", "Rare-v1")):
        name = f"{task}_{number}"
        frames = np.full((FRAMES, 96, 96, 3), 40 * number, np.uint8)
        for k in range(FRAMES):
            frames[k, 10 * k : 10 * k + 12, 20:40] = 250 - k
        np.save(out / f"{name}.npy", frames)
        p = np.stack([np.full(FRAMES, 0.5), np.linspace(-0.1, 0.1, FRAMES), np.full(FRAMES, 0.2)], axis=1)
        truth = {"t_s": np.arange(FRAMES) * 0.2, "base_from_tcp": make_pose(rotations(FRAMES, number), p)}
        np.savez(out / "truth" / f"{name}.npz", finger_width_m=np.linspace(0, 0.08, FRAMES), **truth)
        lines.append(json.dumps({"video": f"{name}.npy", "task": task}))
    (out / "manifest.jsonl").write_text("\n".join(lines))
    return out


@pytest.fixture(scope="module")
def demonstrations(folder: Path) -> Demonstrations:
    return load_demonstrations(folder)


@pytest.fixture(scope="module")
def frames(demonstrations: Demonstrations, tmp_path_factory: pytest.TempPathFactory) -> list[NDArray[np.uint8]]:
    return decode(demonstrations.clips, tmp_path_factory.mktemp("frames"), SIZE, lambda _: None)


@pytest.fixture(scope="module")
def windows(demonstrations: Demonstrations, frames: list[NDArray[np.uint8]]) -> Callable[[int], Windows]:
    return lambda seed: Windows(demonstrations.clips, frames, seed, 400)


def config(folder: Path, out: Path, steps: int = 4) -> BaselineConfig:
    schedule = Schedule(steps=steps, learning_rate=1e-3, batch_size=2, warm_up_steps=1, checkpoint_every=2)
    return BaselineConfig(data=folder, out=out, size=SIZE, workers=0, schedule=schedule)


def test_six_numbers_determine_a_rotation() -> None:
    R = torch.from_numpy(rotations(200))
    torch.testing.assert_close(from_six(R[..., :, :2].mT.flatten(-2)), R)
    six = torch.from_numpy(np.random.default_rng(1).normal(size=(200, 6)))
    any_R = from_six(six)
    torch.testing.assert_close(any_R @ any_R.mT, torch.eye(3, dtype=six.dtype).expand(200, 3, 3))
    torch.testing.assert_close(torch.linalg.det(any_R), torch.ones(200, dtype=six.dtype))
    longer = six * torch.tensor([3.0, 3, 3, 0.5, 0.5, 0.5])
    torch.testing.assert_close(from_six(longer), any_R)


def truth_and(angle: float, shift_m: float, gap_m: float) -> dict[str, float]:
    R = torch.from_numpy(rotations(4)).float().view(2, 2, 3, 3)
    batch = {"position": torch.rand(2, 2, 3), "rotation": R, "finger_width": torch.rand(2, 2) * 0.08}
    turn = torch.from_numpy(rotation_exp([0.0, angle, 0.0])).float()
    output = PoseOutput(
        position=batch["position"] + torch.tensor([0.0, shift_m, 0.0]),
        rotation=R @ turn,
        finger_width=batch["finger_width"] + gap_m,
    )
    terms = losses(output, batch)
    return {"total": float(terms.total), **{name: float(value) for name, value in terms.reported.items()}}


def test_the_loss_is_zero_at_the_truth_and_reports_errors_in_mm_and_degrees() -> None:
    assert truth_and(0.0, 0.0, 0.0) == pytest.approx(dict.fromkeys(truth_and(0, 0, 0), 0.0), abs=1e-4)
    told = truth_and(np.deg2rad(8.0), 0.05, 0.02)
    assert told["position_mm"] == pytest.approx(50, abs=1.1)
    assert told["rotation_deg"] == pytest.approx(8, abs=0.4)
    assert told["finger_mm"] == pytest.approx(20, abs=1.1)
    single = [truth_and(np.deg2rad(8.0), 0, 0), truth_and(0, 0.05, 0), truth_and(0, 0, 0.02)]
    assert told["total"] == pytest.approx(sum(s["total"] for s in single), rel=1e-3)
    assert all(s["total"] > 0.1 for s in single)


def test_windows_depend_on_seed_and_index_alone(windows: Callable[[int], Windows]) -> None:
    first = windows(3)
    again = windows(3)
    other = windows(4)
    again[0]
    for name, value in first[7].items():
        torch.testing.assert_close(value, again[7][name], rtol=0, atol=0)
    assert any((first[i]["image"] != other[i]["image"]).any() for i in range(3))
    assert first[0]["image"].shape == (LABELLED + 2 * CONTEXT, 3, SIZE, SIZE)


def shown(image: Tensor, frames: list[NDArray[np.uint8]]) -> tuple[int, list[int]] | None:
    """Number of the clip and those of its frames that a window shows as they are; None if it was degraded."""
    window = image.permute(0, 2, 3, 1).numpy()
    for number, clip in enumerate(frames):
        numbers = [[k for k in range(FRAMES) if (clip[k] == picture).all()] for picture in window]
        if all(numbers):
            return number, [k for (k,) in numbers]
    return None


def test_labels_of_a_window_are_those_of_its_inner_frames(
    windows: Callable[[int], Windows], frames: list[NDArray[np.uint8]], demonstrations: Demonstrations
) -> None:
    seen = set()
    for item in (windows(0)[i] for i in range(200)):
        told = shown(item["image"], frames)
        if told is None:
            continue
        number, numbers = told
        inner = numbers[CONTEXT:-CONTEXT]
        np.testing.assert_allclose(item["rotation"], demonstrations.clips[number].X_BG[inner, :3, :3], atol=1e-6)
        np.testing.assert_allclose(item["finger_width"], np.linspace(0, 0.08, FRAMES)[inner], atol=1e-6)
        seen.add(tuple(numbers))
    assert seen == {(0, 0, 1, 2, 3), (0, 1, 2, 3, 4), (1, 2, 3, 4, 5), (2, 3, 4, 5, 5)}  # the ends of a video repeat


def test_windows_draw_tasks_with_equal_frequency(
    windows: Callable[[int], Windows], frames: list[NDArray[np.uint8]]
) -> None:
    told = [shown(windows(1)[i]["image"], frames) for i in range(400)]
    rare = [t[0] == 3 for t in told if t is not None]  # one clip of four
    assert len(rare) > 50
    assert 0.35 < np.mean(rare) < 0.65


def test_the_baseline_predicts_a_rigid_pose_for_every_frame(folder: Path, tmp_path: Path) -> None:
    baseline = Baseline.load(train(config(folder, tmp_path, steps=1), lambda _: None))
    assert baseline.tasks == ("Often-v1", "Rare-v1")
    with pytest.raises(UsageError, match="holds a training with"):
        train(config(folder, tmp_path, steps=5), lambda _: None)
    frames = np.random.default_rng(0).integers(0, 255, (5, 80, 80, 3), dtype=np.uint8)
    X_BG, finger_width_m = baseline.predict(frames)
    R = X_BG[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-5)
    assert finger_width_m.shape == (5,)
    alone, _ = baseline.predict(frames[1:4])
    np.testing.assert_allclose(alone[1], X_BG[2], atol=1e-5)  # a frame and its two neighbours, no more
    assert np.abs(alone[0] - X_BG[1]).max() > 1e-6


def test_the_baseline_refuses_another_camera_and_damaged_weights(folder: Path, tmp_path: Path) -> None:
    from dataclasses import replace

    baseline = Baseline.load(train(config(folder, tmp_path, steps=1), lambda _: None))
    camera = benchmark_camera()
    baseline.require_camera(camera.resized(256, 256))
    with pytest.raises(UsageError, match="another camera"):
        baseline.require_camera(replace(camera, fx=1.1 * camera.fx))
    with pytest.raises(SetupError, match="no such weights"):
        Baseline.load(tmp_path / "none.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"not safetensors at all")
    with pytest.raises(SetupError, match="not weights"):
        Baseline.load(tmp_path / "bad.safetensors")


def test_demonstrations_without_manifest_or_truth_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no manifest\.jsonl"):
        load_demonstrations(tmp_path)
    (tmp_path / "manifest.jsonl").write_text('{"video": "a.mp4", "task": "T"}\n')
    save_camera(benchmark_camera(), tmp_path / "camera.json")
    with pytest.raises(UsageError, match=r"truth/a\.npz is missing"):
        load_demonstrations(tmp_path)


def test_resizing_in_two_steps_equals_resizing_at_once() -> None:
    y, x = np.mgrid[:384, :384]
    picture = np.stack([x / 2, y / 2, 0 * x], axis=-1).astype(np.uint8)[None]
    direct = resize_frames(picture, 224)
    over = resize_frames(resize_frames(picture, 256), 224)
    assert np.abs(direct.astype(int) - over).max() <= 1
