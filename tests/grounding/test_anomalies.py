import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.anomalies import (
    find_anomalies,
    find_freezes,
    find_teleports,
    find_vanishing,
    still_frames,
)
from kinebench_drake.products import Anomaly, AnomalyKind

N = 49
T_S = 0.2 * np.arange(N)


def path(seed: int = 0, noise_m: float = 0.003) -> Array:
    """A smooth reach of 40 cm and back with tracking noise."""
    s = np.linspace(0, 1, N)
    p = np.stack([0.2 * np.sin(2 * np.pi * s), 0.1 * np.cos(3 * s), 0.7 - 0.1 * s], axis=1)
    return p + np.random.default_rng(seed).normal(0, noise_m, p.shape)


def spans(found: list[Anomaly]) -> list[tuple[str, int, int]]:
    return [(a.kind.value, a.frame_start, a.frame_end) for a in found]


SEEN = np.ones(N, dtype=bool)


def test_a_smooth_noisy_path_has_no_jump() -> None:
    for seed in range(50):
        assert find_teleports(path(seed), SEEN) == []


def test_a_jump_is_found_at_its_first_frame() -> None:
    for frame in (2, 20, 46):
        p = path()
        p[frame:] += [0.0, 0.15, 0.0]
        assert spans(find_teleports(p, SEEN)) == [("teleport", frame, frame)]


def test_a_jump_there_and_back_is_two() -> None:
    p = path()
    p[20:30] += [0.0, 0.15, 0.0]
    assert sorted(spans(find_teleports(p, SEEN))) == [("teleport", 20, 20), ("teleport", 30, 30)]


def test_vanishing_needs_a_gripper_that_was_inside_the_picture() -> None:
    camera = benchmark_camera()
    seen = SEEN.copy()
    seen[12:22] = False
    p = path()
    p[~seen] = np.nan
    assert spans(find_vanishing(p, seen, camera)) == [("vanish", 12, 21)]
    leaving = path() * 0 + [0.0, 0.0, 0.7]
    leaving[:12, 0] = np.linspace(0.2, 0.42, 12)  # the picture ends at x = 0.404 there
    leaving[~seen] = np.nan
    assert find_vanishing(leaving, seen, camera) == []
    late = SEEN.copy()
    late[:5] = False
    assert find_vanishing(path(), late, camera) == []


def frozen_path(start: int, length: int) -> Array:
    p = path(noise_m=0.0)
    p[start : start + length] = p[start - 1]
    return p


def test_a_freeze_begins_in_motion_and_ends_with_a_jump() -> None:
    still = np.zeros(N, dtype=bool)
    still[20:28] = True
    assert spans(find_freezes(frozen_path(20, 8), SEEN, still, T_S)) == [("freeze", 20, 27)]


def test_a_dwell_is_no_freeze() -> None:
    s = np.concatenate([np.sin(np.linspace(0, np.pi / 2, 20)), np.ones(10), np.cos(np.linspace(0, np.pi / 2, 19))])
    p = np.stack([0.3 * s, 0 * s, 0 * s + 0.6], axis=1)
    still = np.zeros(N, dtype=bool)
    still[20:30] = True
    assert find_freezes(p, SEEN, still, T_S) == []


def test_repeated_pictures_are_still_and_moving_ones_are_not() -> None:
    rng = np.random.default_rng(0)
    frames = np.zeros((6, 96, 96, 3), np.uint8)
    for i, x in enumerate((10, 16, 22, 22, 22, 28)):
        frames[i, 30:60, x : x + 30] = 200
    noisy = np.clip(frames + rng.normal(0, 2, frames.shape), 0, 255).astype(np.uint8)
    assert still_frames(noisy).tolist() == [False, False, False, True, True, False]


def test_the_jump_at_the_end_of_a_freeze_is_part_of_it() -> None:
    p = frozen_path(20, 8)
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (N, 64, 64, 3), dtype=np.uint8)
    frames[20:28] = frames[19]
    found = find_anomalies(frames=frames, t_s=T_S, p_C=p, seen=SEEN, sure=SEEN, camera=benchmark_camera())
    assert [a.kind for a in found] == [AnomalyKind.FREEZE]
