"""The same motion in more or fewer frames has the same metrics, once its frames lie on the task's clock."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from kinebench_drake.clip_timing import sample_uniformly
from kinebench_drake.geometry import Array, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.kinematic_result import KinematicResult
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.suites.clock import CLIP_S, FRAME_PERIOD_S
from kinebench_drake.track import GripperTrack

TRUTH = Path(__file__).parents[2] / "examples" / "videos" / "truth"
NOISE_M = 0.0015
NOISE_RAD = 0.0075
SMOOTHNESS = ("sparc", "ldlj", "sparc_filtered", "sparc_rotation")


@pytest.fixture(scope="module")
def analyzer() -> Resources:
    return Resources(RobotOptions())


@pytest.fixture(scope="module", params=["CloseLaptopEasy", "OpenFaucet", "PickFruits"])
def motion(request: pytest.FixtureRequest) -> PchipInterpolator:
    """An expert's joint angles [rad] at any time of a clip [s]."""
    with np.load(TRUTH / f"{request.param}-v1_s0010_unseen.npz") as truth:
        return PchipInterpolator(truth["t_s"], truth["q"])


def judge(
    analyzer: Resources, motion: PchipInterpolator, frames: int, t_s: Array, chosen: Array, noise: float = 1.0
) -> KinematicResult:
    """Judge the chosen frames of a clip of the motion with white noise, the same in equal frames."""
    plant = ArmPlant()
    X = np.stack([plant.forward(q) for q in motion(np.linspace(0.0, CLIP_S, frames)[chosen])])
    rng = np.random.default_rng(0)
    X[:, :3, 3] += noise * rng.normal(0.0, NOISE_M, (len(X), 3))
    X[:, :3, :3] = rotation_exp(noise * rng.normal(0.0, NOISE_RAD, (len(X), 3))) @ X[:, :3, :3]
    track = GripperTrack(
        t_s=t_s,
        X_CH=X,
        X_BG=X,
        tracked=np.ones(len(X), bool),
        confidence=np.ones(len(X)),
        finger_width_m=np.full(len(X), 0.04),
    )
    return analyzer.judge(track)


def sampled(analyzer: Resources, motion: PchipInterpolator, frames: int, noise: float = 1.0) -> KinematicResult:
    chosen, t_s = sample_uniformly(frames, CLIP_S, FRAME_PERIOD_S)
    return judge(analyzer, motion, frames, t_s, chosen, noise)


def test_49_and_150_frames_have_the_same_metrics(analyzer: Resources, motion: PchipInterpolator) -> None:
    """Within the noise floor of the smoothness, and within 2 % of manipulability."""
    short = sampled(analyzer, motion, 49)
    long = sampled(analyzer, motion, 150)
    assert short.feasible is long.feasible is True
    for name in SMOOTHNESS:
        width = short.metrics[f"{name}_floor_high"] - short.metrics[f"{name}_floor_low"]
        assert abs(long.metrics[name] - short.metrics[name]) < width, name
    for name in ("manipulability_mean", "manipulability_integral", "manipulability_min"):
        assert long.metrics[name] == pytest.approx(short.metrics[name], rel=0.02), name
    assert long.metrics["slowdown_min"] == pytest.approx(short.metrics["slowdown_min"], rel=0.1)


def test_without_noise_smoothness_is_the_same_for_49_and_150_frames(
    analyzer: Resources, motion: PchipInterpolator
) -> None:
    """Frames at their own times; at times rounded to the period LDLJ would be off by 0.4 to 1.4."""
    short = sampled(analyzer, motion, 49, noise=0.0)
    long = sampled(analyzer, motion, 150, noise=0.0)
    assert long.metrics["sparc"] == pytest.approx(short.metrics["sparc"], abs=0.05)
    assert long.metrics["ldlj"] == pytest.approx(short.metrics["ldlj"], abs=0.2)


def test_150_frames_at_the_frame_period_of_49_have_different_metrics(
    analyzer: Resources, motion: PchipInterpolator
) -> None:
    """What uniform timing is for: the same frames, played at one frame period each, are a third as fast."""
    short = sampled(analyzer, motion, 49)
    slow = judge(analyzer, motion, 150, FRAME_PERIOD_S * np.arange(150), np.arange(150))
    assert slow.metrics["manipulability_integral"] > 1.5 * short.metrics["manipulability_integral"]
    floor = short.metrics["sparc_floor_high"] - short.metrics["sparc_floor_low"]
    assert slow.metrics["sparc"] < short.metrics["sparc"] - 0.5 * floor
