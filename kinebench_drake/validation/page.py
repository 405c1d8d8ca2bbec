"""The benchmark as a page of Markdown."""

import numpy as np

from kinebench_drake.validation.bench import IK_TRACKS, Bench
from kinebench_drake.validation.feasible import BENCHMARK_FRAMES, BENCHMARK_PERIOD_S
from kinebench_drake.validation.peers import OURS, OWN_PARTS, PLAIN_DRAKE, POSITION_M, ROTATION_RAD, TOLD

COMMAND = "make bench"


def document(bench: Bench) -> str:
    """The bench as a page of Markdown."""
    poses = BENCHMARK_FRAMES * IK_TRACKS
    lines = [
        "# Benchmarks",
        "",
        f"Written by `{COMMAND}`, one thread, on {bench.host.get('cpu')} ({bench.host.get('cores')} cores). Times are "
        "those of the process on the processor, so that other load hardly counts. Seconds are this machine's; ratios "
        "carry over.",
        "",
        "## Inverse kinematics along smooth tracks",
        "",
        f"{poses} poses ({IK_TRACKS} expert-like tracks of {BENCHMARK_FRAMES} frames at {BENCHMARK_PERIOD_S} s), "
        f"started from the posture of the first, reached to {1e3 * POSITION_M:g} mm and {1e3 * ROTATION_RAD:g} mrad. "
        "The solvers take turns; ratios are of the same turn. Reached: share of poses at which Drake's forward "
        "kinematics finds the TCP where it should be, joints within limits. Kept up: share of tracks whose joint path "
        "keeps the limits of speed, as the motions do that the poses were taken from; a path that does not jumps "
        "between postures, and no arm can follow it.",
        "",
        "| solver | used as | us a pose, median (least to most) | times ours (least to most) | reached | kept up |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for t in bench.timings:
        ratio = bench.ratio(t.name)
        if t.us_a_pose is None or ratio is None or t.reached is None or t.kept_up is None:
            lines.append(f"| {t.label} | {t.how} | not installed | | | |")
            continue
        spread = f"{t.median:.0f} ({t.us_a_pose.min():.0f} to {t.us_a_pose.max():.0f})"
        times = f"{np.median(ratio):.1f} ({ratio.min():.1f} to {ratio.max():.1f})"
        lines.append(
            f"| {t.label} | {t.how} | {spread} | {times} | {100 * t.reached:.1f} % | {100 * t.kept_up:.0f} % |"
        )
    lines += ["", _summary(bench), "", "## Throughput", ""]
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


def _summary(bench: Bench) -> str:
    """Ours beside plain Drake and beside the fastest of the others, told apart by whether they solve all of it."""
    drake = bench.ratio(PLAIN_DRAKE)
    others = [
        t
        for t in bench.timings
        if t.us_a_pose is not None and t.name not in (OURS, OWN_PARTS, TOLD) and not t.name.startswith(PLAIN_DRAKE)
    ]
    said = [] if drake is None else [f"{np.median(drake):.1f} times as fast as plain Drake InverseKinematics"]
    whole = [t for t in others if t.reached == 1.0 and t.kept_up == 1.0]
    for group, words in (
        (whole, "the fastest of the other packages that reaches every pose and keeps up on every track"),
        ([t for t in others if t not in whole], "the fastest of those that do not"),
    ):
        ratios = {t.label: r for t in group if (r := bench.ratio(t.name)) is not None}
        if ratios:
            fastest = min(ratios, key=lambda label: float(np.median(ratios[label])))
            said.append(f"{np.median(ratios[fastest]):.1f} times as fast as {fastest}, {words}")
    return f"So ours is {'; '.join(said)}." if said else ""
