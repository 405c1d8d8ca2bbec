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
    FIXED_Q7,
    FRANKIK_FIXED_Q7,
    NEWTON,
    OURS,
    PEERS,
    PLAIN_DRAKE,
    POSITION_M,
    ROTATION_RAD,
    WARM_START,
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
_NOT_OTHERS = (OURS, NEWTON, WARM_START, PLAIN_DRAKE, FRANKIK_FIXED_Q7)  # and their variants


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverTiming:
    """Result of one solver on one set of tracks."""

    name: str
    label: str
    """Name and version."""
    how: str
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
        one, other = by_name.get(name), by_name.get(to)
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
            how=peer.how,
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
    arm, rng = Arm(), np.random.default_rng(seed)
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
        f"Written by `python -m benchmarks ik`, one thread, on {machine_text()}; CPU times, "
        "so that other load hardly counts. Seconds are those of this machine, ratios carry over.",
        "Expert-like tracks, each started from the posture of its first pose, reached to "
        f"{1e3 * POSITION_M:g} mm and {1e3 * ROTATION_RAD:g} mrad. "
        "The solvers take turns; ratios are of the same turn. Reached: share of poses at which Drake's forward "
        "kinematics puts the TCP at the pose, joints within limits. Within speed limits: share of tracks whose joint "
        "path keeps the speed limits, as the motions do that the poses were taken from; any other path jumps between "
        "postures, and no arm can follow it.",
        "Ours and pytorch_kinematics solve whole tracks, as an audit has them; the others solve pose by pose and could "
        "also drive an arm whose next pose is not known yet. Ours chooses the redundancy (joint 7 of the Panda) along "
        "the track and verifies its own result in Drake within its time. The two with fixed joint 7 and no sweep omit "
        "that choice and have no solution where joint 7 has to move; they are to be compared with each other: the bare "
        "closed form, ours a track at a time, frankik's pose by pose.",
    ]
    for comparison in comparisons:
        tracks = comparison.tracks
        head = (
            *("solver", "used as", "us a pose, median (minimum to maximum)"),
            *("times ours (minimum to maximum)", "reached", "within speed limits"),
        )
        parts.append(f"### {tracks.tracks} tracks of {tracks.frames} frames at {tracks.period_s:g} s")
        parts += [markdown.table(head, [_row(comparison, t) for t in comparison.timings]), _summary(comparison)]
    return markdown.section("Inverse kinematics along smooth tracks", *parts)


def _row(comparison: IkComparison, timing: SolverTiming) -> list[str]:
    ratio = comparison.ratio(timing.name)
    if timing.us_per_pose is None or ratio is None or timing.reached is None or timing.within_speed is None:
        return [timing.label, timing.how, "not installed", "", "", ""]
    shares = f"{100 * timing.reached:.1f} %", f"{100 * timing.within_speed:.0f} %"
    return [timing.label, timing.how, _spread(timing.us_per_pose), _spread(ratio), *shares]


def _spread(values: Array) -> str:
    """Format values as median (minimum to maximum)."""
    return f"{_short(np.median(values))} ({_short(values.min())} to {_short(values.max())})"


def _short(value: float | np.floating[Any]) -> str:
    """Format a number with two or three significant digits."""
    return f"{value:.{2 if value < 1.0 else 1 if value < 100.0 else 0}f}"


def _summary(comparison: IkComparison) -> str:
    """Compare ours with plain Drake and with the fastest of the others, those that solve everything apart."""
    drake, fixed = comparison.ratio(PLAIN_DRAKE), comparison.ratio(FRANKIK_FIXED_Q7, FIXED_Q7)
    others = [t for t in comparison.timings if t.us_per_pose is not None and not t.name.startswith(_NOT_OTHERS)]
    parts = [] if drake is None else [f"{_short(np.median(drake))} times as fast as plain Drake InverseKinematics"]
    complete = [t for t in others if t.reached == 1.0 and t.within_speed == 1.0]
    for group, words in (
        (
            complete,
            "the fastest of the other packages that reaches every pose within the speed limits (warm starts, which are "
            "given the true postures, left out)",
        ),
        ([t for t in others if t not in complete], "the fastest of those that do not"),
    ):
        ratios = {t.label: r for t in group if (r := comparison.ratio(t.name)) is not None}
        if ratios:
            fastest = min(ratios, key=lambda label: float(np.median(ratios[label])))
            parts.append(f"{_short(np.median(ratios[fastest]))} times as fast as {fastest}, {words}")
    if fixed is not None:
        shares = {t.name: f"{100 * t.reached:.1f} %" for t in comparison.timings if t.reached is not None}
        parts.append(
            f"as a bare closed form, joint 7 fixed and no sweep, {_short(np.median(fixed))} times as fast as frankik "
            f"(poses reached: {shares[FIXED_Q7]} and {shares[FRANKIK_FIXED_Q7]})"
        )
    return f"Ours is {'; '.join(parts)}." if parts else ""
