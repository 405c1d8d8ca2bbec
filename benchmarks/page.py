"""The benchmark as a page of Markdown."""

from typing import Any

import numpy as np

from benchmarks.bench import Bench, Comparison
from benchmarks.feasible import BENCHMARK_FRAMES
from benchmarks.peers import FRANKIK_HELD, OURS, OURS_HELD, OWN_PARTS, PLAIN_DRAKE, POSITION_M, ROTATION_RAD, TOLD
from kinebench_drake.geometry import Array

COMMAND = "make bench"

_NOT_OTHERS = (OURS, OWN_PARTS, TOLD, PLAIN_DRAKE, FRANKIK_HELD)  # and their variants


def document(bench: Bench) -> str:
    """The bench as a page of Markdown."""
    lines = [
        "# Benchmarks",
        "",
        f"Written by `{COMMAND}`, one thread, on {bench.host.get('cpu')} ({bench.host.get('cores')} cores). Times are "
        "those of the process on the processor, so that other load hardly counts. Seconds are this machine's; ratios "
        "carry over.",
        "",
        "## Inverse kinematics along smooth tracks",
        "",
        "Expert-like tracks, each started from the posture of its first pose, reached to "
        f"{1e3 * POSITION_M:g} mm and {1e3 * ROTATION_RAD:g} mrad. "
        "The solvers take turns; ratios are of the same turn. Reached: share of poses at which Drake's forward "
        "kinematics finds the TCP where it should be, joints within limits. Kept up: share of tracks whose joint path "
        "keeps the limits of speed, as the motions do that the poses were taken from; a path that does not jumps "
        "between postures, and no arm can follow it.",
        "",
        "What differs: ours and pytorch_kinematics are given whole tracks, as an audit has them; the others go pose by "
        "pose and could also drive an arm whose next pose is not known yet. Ours chooses the redundancy (of the Panda: "
        "joint 7) along the track and checks its own result in Drake within its time. The two with joint 7 held and no "
        "sweep leave that choice out and find nothing where joint 7 has to move; they are there to be held against "
        "each other: the bare closed form, ours a track at a time, frankik's pose by pose.",
        "",
    ]
    for comparison in bench.comparisons:
        lines += _table(comparison)
    lines += ["## Throughput", ""]
    lines += [
        f"{bench.tracks} tracks of {BENCHMARK_FRAMES} frames on one core, in this process: "
        f"{bench.throughput_s:.1f} s ("
        + ", ".join(f"{part} {seconds:.1f} s" for part, seconds in bench.throughput_parts_s.items())
        + ").",
        "",
        "## The whole audit",
        "",
        f"{len(bench.audit_s)} tracks with collisions and both trajectory optimisations: median "
        f"{np.median(bench.audit_s):.3f} s a track, 95th percentile {np.percentile(bench.audit_s, 95):.3f} s, most "
        f"{bench.audit_s.max():.3f} s.",
        "",
    ]
    return "\n".join(lines)


def _table(comparison: Comparison) -> list[str]:
    """All solvers on one set, and what follows from it."""
    tracks = comparison.tracks
    lines = [
        f"### {tracks.tracks} tracks of {tracks.frames} frames at {tracks.period_s:g} s",
        "",
        "| solver | used as | us a pose, median (least to most) | times ours (least to most) | reached | kept up |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for t in comparison.timings:
        ratio = comparison.ratio(t.name)
        if t.us_a_pose is None or ratio is None or t.reached is None or t.kept_up is None:
            lines.append(f"| {t.label} | {t.how} | not installed | | | |")
            continue
        shares = f"{100 * t.reached:.1f} % | {100 * t.kept_up:.0f} %"
        lines.append(f"| {t.label} | {t.how} | {_spread(t.us_a_pose)} | {_spread(ratio)} | {shares} |")
    return [*lines, "", _summary(comparison), ""]


def _spread(values: Array) -> str:
    """Median, least and most."""
    return f"{_short(np.median(values))} ({_short(values.min())} to {_short(values.max())})"


def _short(value: float | np.floating[Any]) -> str:
    """Two or three digits that count."""
    return f"{value:.{2 if value < 1.0 else 1 if value < 100.0 else 0}f}"


def _summary(comparison: Comparison) -> str:
    """Ours beside plain Drake and beside the fastest of the others, told apart by whether they solve all of it."""
    drake, held = comparison.ratio(PLAIN_DRAKE), comparison.ratio(FRANKIK_HELD, OURS_HELD)
    others = [t for t in comparison.timings if t.us_a_pose is not None and not t.name.startswith(_NOT_OTHERS)]
    said = [] if drake is None else [f"{_short(np.median(drake))} times as fast as plain Drake InverseKinematics"]
    whole = [t for t in others if t.reached == 1.0 and t.kept_up == 1.0]
    for group, words in (
        (whole, "the fastest of the other packages that reaches every pose and keeps up on every track"),
        ([t for t in others if t not in whole], "the fastest of those that do not"),
    ):
        ratios = {t.label: r for t in group if (r := comparison.ratio(t.name)) is not None}
        if ratios:
            fastest = min(ratios, key=lambda label: float(np.median(ratios[label])))
            said.append(f"{_short(np.median(ratios[fastest]))} times as fast as {fastest}, {words}")
    if held is not None:
        found = {t.name: f"{100 * t.reached:.1f} %" for t in comparison.timings if t.reached is not None}
        said.append(
            f"as a bare closed form, joint 7 held and no sweep, {_short(np.median(held))} times as fast as frankik "
            f"(poses reached: {found[OURS_HELD]} and {found[FRANKIK_HELD]})"
        )
    return f"So ours is {'; '.join(said)}." if said else ""
