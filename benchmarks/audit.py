"""Speed of the audit in one process, one thread: its quick parts over many tracks, and whole audits."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from benchmarks import markdown
from benchmarks.feasible import BENCHMARK_FRAMES, BENCHMARK_PERIOD_S, TrackSet, smooth_motions
from benchmarks.motion import Arm, Motion
from benchmarks.peers import problem_of
from benchmarks.record import machine_text
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.manipulability import compute_manipulability
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.track_ik import solve_track
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.metrics.limit_checks import check_limits
from kinebench_drake.metrics.noise import estimate_track_noise, propagate_noise
from kinebench_drake.metrics.smoothness import measure_smoothness
from kinebench_drake.track import GripperTrack


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditTiming:
    """Times of audits of expert-like tracks."""

    tracks: int
    """Tracks through the quick parts."""
    parts_s: Mapping[str, float]
    """Time of each part over all tracks [s]."""
    audit_s: Array
    """(N,) time of each whole audit [s]."""
    feasible: int
    """Whole audits with the verdict feasible."""


def track_of(arm: Arm, motion: Motion, t_s: Array) -> GripperTrack:
    """Return the poses of a motion at times (T,) [s] as a track for the audit."""
    poses = problem_of(arm.plant, motion, t_s)
    n = len(t_s)
    return GripperTrack(
        t_s=poses.t_s,
        X_CH=np.full((n, 4, 4), np.nan),
        X_BG=poses.X_BG,
        tracked=np.ones(n, dtype=bool),
        confidence=np.ones(n),
        finger_width_m=motion.width(t_s),
    )


def time_parts(tracks: Sequence[GripperTrack]) -> dict[str, float]:
    """Time the parts of an audit that need no trajectory optimisation, over all `tracks` in turn [s]."""
    plant = ArmPlant()
    parts = dict.fromkeys(("inverse kinematics", "manipulability", "limits", "smoothness"), 0.0)

    @contextmanager
    def timed(part: str) -> Iterator[None]:
        start = time.process_time()
        yield
        parts[part] += time.process_time() - start

    for track in tracks:
        with timed("inverse kinematics"):
            joints = solve_track(plant, track)
        with timed("manipulability"):
            J = plant.chain.jacobians(joints.q)
            compute_manipulability(plant, joints.q, J)
        with timed("limits"):
            noise = estimate_track_noise(track.t_s, track.X_BG, track.tracked)
            check_limits(plant, track.t_s, joints.q, propagate_noise(J, noise))
        with timed("smoothness"):
            measure_smoothness(track)
    return parts


def time_audits(tracks: Sequence[GripperTrack]) -> tuple[Array, int]:
    """Time whole audits with both trajectory optimisations (N,) [s], and count those with the verdict feasible."""
    judge = TrackJudge(ArmPlant())
    judge.judge_poses(tracks[0])
    seconds = []
    feasible = 0
    for track in tracks:
        start = time.process_time()
        result = judge.judge_poses(track)
        seconds.append(time.process_time() - start)
        feasible += result.feasible is True
    return np.array(seconds), feasible


def measure(*, tracks: int, audits: int, seed: int = 0, log: Callable[[str], None] = lambda text: None) -> AuditTiming:
    """Draw tracks like benchmark episodes; time the quick parts of `tracks` audits, and `audits` whole ones."""
    arm = Arm()
    rng = np.random.default_rng(seed)
    episodes = TrackSet(tracks=max(tracks, audits), frames=BENCHMARK_FRAMES, period_s=BENCHMARK_PERIOD_S)
    log(f"drawing {episodes.tracks} tracks")
    drawn = [track_of(arm, *motion) for motion in smooth_motions(rng, arm, episodes)]
    log(f"{tracks} tracks through inverse kinematics, manipulability, limits and smoothness")
    parts = time_parts(drawn[:tracks])
    log(f"{audits} whole audits")
    audit_s, feasible = time_audits(drawn[:audits])
    return AuditTiming(tracks=tracks, parts_s=parts, audit_s=audit_s, feasible=feasible)


def figures(timing: AuditTiming) -> dict[str, float]:
    """Return the processor time of each part and of a whole audit."""
    return {
        **{f"{part}, ms a track": 1e3 * seconds / timing.tracks for part, seconds in timing.parts_s.items()},
        "whole audit, mean, ms": 1e3 * float(timing.audit_s.mean()),
    }


def section(timing: AuditTiming) -> str:
    """Return the section of the document."""
    parts = ", ".join(f"{part} {seconds:.1f} s" for part, seconds in timing.parts_s.items())
    return markdown.section(
        "The audit in one process",
        f"`python -m benchmarks audit`, one thread, on {machine_text()}; CPU times.",
        f"{timing.tracks} tracks of {BENCHMARK_FRAMES} frames: {sum(timing.parts_s.values()):.1f} s ({parts}).",
        f"{len(timing.audit_s)} whole audits, with collisions and both trajectory optimisations: median "
        f"{np.median(timing.audit_s):.3f} s a track, 95th percentile {np.percentile(timing.audit_s, 95):.3f} s, "
        f"maximum {timing.audit_s.max():.3f} s; {timing.feasible} feasible.",
    )
