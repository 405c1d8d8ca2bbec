"""Inverse kinematics compared with that of other packages.

All solvers do the same problems in turn, one thread each, several times over, so that other load on the machine affects
all of them and ratios are comparable; times are CPU times of this process. Every posture is verified by Drake's forward
kinematics.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks import markdown
from benchmarks.feasible import BENCHMARK_FRAMES, BENCHMARK_PERIOD_S, TrackSet, smooth_motions
from benchmarks.motion import Arm
from benchmarks.peers import (
    OURS,
    PEERS,
    POSITION_M,
    ROTATION_RAD,
    IkProblem,
    Peer,
    Solve,
    problem_of,
    reached_share,
    within_speed_share,
)
from benchmarks.record import machine_text
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant

TRACKS = TrackSet(tracks=20, frames=BENCHMARK_FRAMES, period_s=BENCHMARK_PERIOD_S)
"""Tracks like benchmark episodes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverTiming:
    """Result of one solver on one set of tracks."""

    name: str
    label: str
    """Name and version."""
    us_per_pose: Array | None
    """(R,) microseconds a pose of each repeat; None if the package is missing."""
    reached: float | None
    """Share of poses reached within limits, by Drake's forward kinematics."""
    within_speed: float | None
    """Share of tracks whose joint path keeps the speed limits."""


def compare_solvers(problems: Sequence[IkProblem], peers: Sequence[Peer], repeats: int) -> tuple[SolverTiming, ...]:
    """Time all solvers on the same problems, in turn, `repeats` times, after one untimed turn."""
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
        SolverTiming(
            name=peer.name,
            label=peer.label,
            us_per_pose=1e6 * np.array(seconds[peer.name]) / poses if peer.name in seconds else None,
            reached=reached_share(plant, problems, paths[peer.name]) if peer.name in paths else None,
            within_speed=within_speed_share(plant, problems, paths[peer.name]) if peer.name in paths else None,
        )
        for peer in peers
    )


def compare_ik(
    *,
    repeats: int,
    seed: int = 0,
    tracks: TrackSet = TRACKS,
    peers: Sequence[Peer] = PEERS,
    log: Callable[[str], None] = lambda text: None,
) -> tuple[SolverTiming, ...]:
    """Draw tracks and time all solvers on them, in `repeats` turns."""
    arm = Arm()
    for peer in peers:
        log(f"{peer.label}: {peer.how}")
    log(f"inverse kinematics of {tracks.tracks} tracks of {tracks.frames} frames, {repeats} times each")
    problems = [problem_of(arm.plant, *drawn) for drawn in smooth_motions(np.random.default_rng(seed), arm, tracks)]
    return compare_solvers(problems, peers, repeats)


def times_ours(timings: Sequence[SolverTiming]) -> dict[str, float]:
    """Return time of a solver / time of ours by name, the median of those of each turn."""
    timed = {t.name: t.us_per_pose for t in timings if t.us_per_pose is not None}
    return {name: float(np.median(us / timed[OURS])) for name, us in timed.items()}


def figures(timings: Sequence[SolverTiming]) -> dict[str, float]:
    """Return the time of ours, and its ratio to those of the others in the same turns."""
    ratios = times_ours(timings)
    costs = {f"ours / {t.label}": 1.0 / ratios[t.name] for t in timings if t.name in ratios and t.name != OURS}
    ours = next(t.us_per_pose for t in timings if t.name == OURS)
    return {"us a pose": float(np.median(ours)), **costs} if ours is not None else costs


def section(timings: Sequence[SolverTiming]) -> str:
    """Return the section of the document."""
    ratios = times_ours(timings)
    return markdown.section(
        "Inverse kinematics along smooth tracks",
        f"`python -m benchmarks ik`, one thread, on {machine_text()}; CPU times. {TRACKS.tracks} expert-like tracks of "
        f"{TRACKS.frames} frames at {TRACKS.period_s:g} s are reached to {1e3 * POSITION_M:g} mm and "
        f"{1e3 * ROTATION_RAD:g} mrad from the posture of the first pose. The solvers take turns; ratios are medians "
        "of those of a turn. Reached: share of poses, joints within limits. Smooth: share of tracks whose joint path "
        "keeps the speed limits; any other path jumps between postures.",
        "Ours and pytorch_kinematics solve whole tracks, the others pose by pose. Ours chooses joint 7 along the track "
        "and verifies its own result in Drake within its time. A warm start is given the true postures. "
        "`benchmarks/peers.py` has how each solver is used.",
        markdown.table(
            ("solver", "us a pose", "times ours", "reached, smooth"),
            ([timing.label, *_cells(timing, ratios.get(timing.name))] for timing in timings),
        ),
    )


def _cells(timing: SolverTiming, ratio: float | None) -> list[str]:
    if timing.us_per_pose is None or ratio is None or timing.reached is None or timing.within_speed is None:
        return ["not installed", "", ""]
    shares = f"{timing.reached:.1%}, {timing.within_speed:.0%}"
    return [_short(float(np.median(timing.us_per_pose))), _short(ratio), shares]


def _short(value: float) -> str:
    """Format a number with two or three significant digits."""
    return f"{value:.{2 if value < 1.0 else 1 if value < 100.0 else 0}f}"
