"""How fast the audit is, and its inverse kinematics beside that of other packages, in one run.

Ratios are what counts: all solvers do the same problems in turn, one thread each, several times over, so that whatever
else the machine does meets them all; what is measured is this process's time on the processor. Every posture found is
verified by Drake's forward kinematics.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from benchmarks.feasible import BENCHMARK_FRAMES, BENCHMARK_PERIOD_S
from benchmarks.motion import Arm, Motion, accelerations
from benchmarks.moves import cartesian
from benchmarks.peers import OURS, PEERS, Peer, Problem, Solve, kept_up, reached
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.manipulability import compute_manipulability
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.track import solve_track
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.metrics.limits import check_limits
from kinebench_drake.metrics.noise import estimate_track_noise, propagate_noise
from kinebench_drake.metrics.smoothness import measure_smoothness
from kinebench_drake.results.provenance import host
from kinebench_drake.types import GripperTrack, Json

REPEATS = 9
"""How often each solver does all tracks of a set."""
TRACKS = 1000
"""Tracks of the throughput."""
AUDITS = 200
"""Tracks that are audited whole."""

_WINDOWS = 4  # tracks cut out of one long motion


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackSet:
    """Expert-like tracks on which inverse kinematics is compared."""

    tracks: int
    frames: int
    """Of each track."""
    period_s: float
    """Time between frames [s]."""


IK_SETS = (
    TrackSet(tracks=20, frames=BENCHMARK_FRAMES, period_s=BENCHMARK_PERIOD_S),
    TrackSet(tracks=4, frames=490, period_s=0.02),
)
"""Benchmark episodes, and tracks as long as those in time with ten times as many frames."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """One solver on the poses of one set."""

    name: str
    label: str
    """With the version."""
    how: str
    us_a_pose: Array | None
    """(R,) microseconds a pose of each repeat; None if the package is missing."""
    reached: float | None
    """Share of poses reached within limits, by Drake's forward kinematics."""
    kept_up: float | None
    """Share of tracks whose joint path keeps the limits of speed."""

    @property
    def median(self) -> float | None:
        """Median of the repeats [us]."""
        return None if self.us_a_pose is None else float(np.median(self.us_a_pose))

    def to_json(self) -> dict[str, Json]:
        """As an object."""
        return {
            "name": self.name,
            "label": self.label,
            "how": self.how,
            "us_a_pose": None if self.us_a_pose is None else self.us_a_pose.tolist(),
            "reached": self.reached,
            "kept_up": self.kept_up,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """All solvers on one set."""

    tracks: TrackSet
    timings: tuple[Timing, ...]

    def ratio(self, name: str, to: str = OURS) -> Array | None:
        """Time of a solver / that of another (R,), repeat by repeat; None if either was not timed."""
        by_name = {t.name: t.us_a_pose for t in self.timings}
        one, other = by_name.get(name), by_name.get(to)
        return None if one is None or other is None else np.asarray(one / other)

    def to_json(self) -> dict[str, Json]:
        """As an object."""
        return {
            "tracks": self.tracks.tracks,
            "frames": self.tracks.frames,
            "period_s": self.tracks.period_s,
            "solvers": [t.to_json() for t in self.timings],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """What one run measured."""

    comparisons: tuple[Comparison, ...]
    throughput_s: float
    """Seconds for all tracks through inverse kinematics, manipulability, limits and smoothness."""
    throughput_parts_s: Mapping[str, float]
    """The same by part [s]."""
    tracks: int
    audit_s: Array
    """(N,) seconds of each whole audit."""
    judged_feasible: int
    """Audits that ended in `feasible`; all tracks are expert-like."""
    host: Mapping[str, Json]

    def to_json(self) -> dict[str, Json]:
        """As an object."""
        return {
            "inverse_kinematics": [c.to_json() for c in self.comparisons],
            "throughput": {
                "tracks": self.tracks,
                "seconds": self.throughput_s,
                "parts_s": dict(self.throughput_parts_s),
            },
            "audit": {"seconds": self.audit_s.tolist(), "feasible": self.judged_feasible},
            "host": dict(self.host),
        }


def smooth_motions(rng: np.random.Generator, arm: Arm, wanted: TrackSet) -> Iterator[tuple[Motion, Array]]:
    """Expert-like motions within the limits of speed and acceleration, each with the times (T,) [s] of its frames."""
    span = wanted.period_s * (wanted.frames - 1)
    found = 0
    while found < wanted.tracks:
        motion = cartesian(rng, arm, _WINDOWS * span)
        if motion is None:
            continue
        for k in range(_WINDOWS):
            t_s = np.asarray(k * span + wanted.period_s * np.arange(wanted.frames), dtype=np.float64)
            fine = np.linspace(t_s[0], t_s[-1], 1000)
            q, v, a = (motion.q(fine, order) for order in range(3))
            within = (q >= arm.plant.lower).all() and (q <= arm.plant.upper).all()
            slow = (np.abs(v) <= arm.plant.velocity_limits).all() and (np.abs(a) <= accelerations(arm)).all()
            if within and slow and found < wanted.tracks:
                found += 1
                yield motion, t_s


def problem(arm: Arm, motion: Motion, t_s: Array) -> Problem:
    """The poses of a motion at some times (T,) [s]."""
    q = motion.q(t_s)
    return Problem(t_s=t_s - t_s[0], X_BG=np.array([arm.plant.forward(row) for row in q]), q=q)


def track_of(arm: Arm, motion: Motion, t_s: Array) -> GripperTrack:
    """The same as a track for the audit."""
    poses = problem(arm, motion, t_s)
    n = len(t_s)
    return GripperTrack(
        t_s=poses.t_s,
        X_CH=np.full((n, 4, 4), np.nan),
        X_BG=poses.X_BG,
        tracked=np.ones(n, dtype=bool),
        confidence=np.ones(n),
        finger_width_m=motion.width(t_s),
    )


def compare_ik(problems: Sequence[Problem], peers: Sequence[Peer], repeats: int) -> tuple[Timing, ...]:
    """Time all solvers on the same problems, in turn, `repeats` times; the first, untimed turn warms them up."""
    plant = ArmPlant()
    solvers: dict[str, Solve] = {}
    for peer in peers:
        try:
            solvers[peer.name] = peer.make(plant)
        except ImportError:
            continue
    paths = {name: solve(problems) for name, solve in solvers.items()}
    seconds: dict[str, list[float]] = {name: [] for name in solvers}
    for _ in range(repeats):
        for name, solve in solvers.items():
            start = time.process_time()
            solve(problems)
            seconds[name].append(time.process_time() - start)
    poses = sum(len(p.t_s) for p in problems)
    return tuple(
        Timing(
            name=peer.name,
            label=peer.label,
            how=peer.how,
            us_a_pose=1e6 * np.array(seconds[peer.name]) / poses if peer.name in seconds else None,
            reached=reached(plant, problems, paths[peer.name]) if peer.name in paths else None,
            kept_up=kept_up(plant, problems, paths[peer.name]) if peer.name in paths else None,
        )
        for peer in peers
    )


def measure_throughput(tracks: Sequence[GripperTrack]) -> dict[str, float]:
    """Seconds that the parts of a quick audit take for all `tracks` in turn."""
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


def measure_audits(tracks: Sequence[GripperTrack]) -> tuple[Array, int]:
    """Seconds (N,) of each whole audit with both trajectory optimisations, and how many end in feasible."""
    judge = TrackJudge(ArmPlant())
    judge.judge_poses(tracks[0])
    seconds, feasible = [], 0
    for track in tracks:
        start = time.process_time()
        result = judge.judge_poses(track)
        seconds.append(time.process_time() - start)
        feasible += result.feasible is True
    return np.array(seconds), feasible


def run_bench(
    *,
    seed: int = 0,
    ik_sets: Sequence[TrackSet] = IK_SETS,
    repeats: int = REPEATS,
    tracks: int = TRACKS,
    audits: int = AUDITS,
    peers: Sequence[Peer] = PEERS,
    note: Callable[[str], None] = lambda text: None,
) -> Bench:
    """Draw the tracks, then measure; `note` is told what comes next."""
    arm = Arm()
    rng = np.random.default_rng(seed)
    comparisons = []
    for wanted in ik_sets:
        note(f"inverse kinematics of {wanted.tracks} tracks of {wanted.frames} frames, {repeats} times each")
        problems = [problem(arm, *drawn) for drawn in smooth_motions(rng, arm, wanted)]
        comparisons.append(Comparison(tracks=wanted, timings=compare_ik(problems, peers, repeats)))
    episodes = TrackSet(tracks=max(tracks, audits), frames=BENCHMARK_FRAMES, period_s=BENCHMARK_PERIOD_S)
    note(f"drawing {episodes.tracks} tracks")
    drawn = [track_of(arm, *d) for d in smooth_motions(rng, arm, episodes)]
    note(f"{tracks} tracks through inverse kinematics, manipulability, limits and smoothness")
    parts = measure_throughput(drawn[:tracks])
    note(f"{audits} whole audits")
    audit_s, feasible = measure_audits(drawn[:audits])
    return Bench(
        comparisons=tuple(comparisons),
        throughput_s=sum(parts.values()),
        throughput_parts_s=parts,
        tracks=tracks,
        audit_s=audit_s,
        judged_feasible=feasible,
        host=host(),
    )
