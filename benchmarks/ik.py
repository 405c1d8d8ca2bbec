"""Inverse kinematics compared with that of other packages.

All solvers do the same problems in turn, one thread each, several times over, so that other load on the machine affects
all of them and ratios are comparable; times are CPU times of this process. Every posture is verified by Drake's forward
kinematics.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

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

IK_SETS = (
    TrackSet(tracks=20, frames=BENCHMARK_FRAMES, period_s=BENCHMARK_PERIOD_S),
    TrackSet(tracks=4, frames=490, period_s=0.02),
)
"""Benchmark episodes, and tracks of the same duration with ten times as many frames."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class IkComparison:
    """All solvers on one set."""

    tracks: TrackSet
    timings: tuple[SolverTiming, ...]

    def ratio(self, name: str, to: str = OURS) -> Array | None:
        """Return time of a solver / time of another (R,), repeat by repeat; None if either was not timed."""
        by_name = {t.name: t.us_per_pose for t in self.timings}
        one = by_name.get(name)
        other = by_name.get(to)
        return None if one is None or other is None else np.asarray(one / other)


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
    sets: Sequence[TrackSet] = IK_SETS,
    peers: Sequence[Peer] = PEERS,
    log: Callable[[str], None] = lambda text: None,
) -> list[IkComparison]:
    """Draw the tracks of each set and time all solvers on them, in `repeats` turns."""
    arm = Arm()
    rng = np.random.default_rng(seed)
    for peer in peers:
        log(f"{peer.label}: {peer.how}")
    comparisons = []
    for tracks in sets:
        log(f"inverse kinematics of {tracks.tracks} tracks of {tracks.frames} frames, {repeats} times each")
        problems = [problem_of(arm.plant, *drawn) for drawn in smooth_motions(rng, arm, tracks)]
        comparisons.append(IkComparison(tracks=tracks, timings=compare_solvers(problems, peers, repeats)))
    return comparisons


def figures(comparisons: Sequence[IkComparison]) -> dict[str, float]:
    """Return the time of ours, and its ratio to those of the others in the same turns."""
    costs = {}
    for comparison in comparisons:
        frames = f"{comparison.tracks.frames} frames"
        for timing in comparison.timings:
            ratio = comparison.ratio(OURS, timing.name)
            if timing.us_per_pose is not None and timing.name == OURS:
                costs[f"{frames}, us a pose"] = float(np.median(timing.us_per_pose))
            elif ratio is not None:
                costs[f"{frames}, ours / {timing.label}"] = float(np.median(ratio))
    return costs


def section(comparisons: Sequence[IkComparison]) -> str:
    """Return the section of the document."""
    parts: list[str | list[str]] = [
        f"`python -m benchmarks ik`, one thread, on {machine_text()}; CPU times. Expert-like tracks are reached to "
        f"{1e3 * POSITION_M:g} mm and {1e3 * ROTATION_RAD:g} mrad from the posture of the first pose. The solvers take "
        "turns; ratios are medians of those of a turn. Reached: share of poses, joints within limits. Smooth: share of "
        "tracks whose joint path keeps the speed limits; any other path jumps between postures.",
        "Ours and pytorch_kinematics solve whole tracks, the others pose by pose. Ours chooses joint 7 along the track "
        "and verifies its own result in Drake within its time. A warm start is given the true postures. "
        "`benchmarks/peers.py` has how each solver is used.",
    ]
    (first, tracks), *others = [(c, f"{c.tracks.frames} frames at {c.tracks.period_s:g} s") for c in comparisons]
    rest = "".join(f" and those for tracks of {text}" for _, text in others)
    parts.append(
        f"{first.tracks.tracks} tracks of {tracks}. Of each solver the table has the setting with most smooth tracks, "
        f"the fastest of these. The others{rest} stand in `benchmarks/results/ik.json`."
    )
    head = ("solver", "us a pose", "times ours", "reached, smooth")
    best = dict[str, SolverTiming]()
    for timing in sorted(first.timings, key=_quality):
        best[timing.label.partition(",")[0]] = timing
    shown = [timing for timing in first.timings if timing in best.values()]
    parts.append(markdown.table(head, ([timing.label, *_cells(first, timing)] for timing in shown)))
    return markdown.section("Inverse kinematics along smooth tracks", *parts)


def _quality(timing: SolverTiming) -> tuple[float, float]:
    """Return the share of smooth tracks, then speed; of a solver that is not installed the least."""
    if timing.us_per_pose is None:
        return -1.0, 0.0
    return timing.within_speed or 0.0, -float(np.median(timing.us_per_pose))


def _cells(comparison: IkComparison, timing: SolverTiming) -> list[str]:
    ratio = comparison.ratio(timing.name)
    if timing.us_per_pose is None or ratio is None or timing.reached is None or timing.within_speed is None:
        return ["not installed", "", ""]
    shares = f"{timing.reached:.1%}, {timing.within_speed:.0%}"
    return [_short(np.median(timing.us_per_pose)), _short(np.median(ratio)), shares]


def _short(value: float | np.floating[Any]) -> str:
    """Format a number with two or three significant digits."""
    return f"{value:.{2 if value < 1.0 else 1 if value < 100.0 else 0}f}"
