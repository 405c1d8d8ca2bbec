"""What the verdicts of a run rest on: frame period and camera, each with its source, and motion."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum

from kinebench_drake.camera import CameraSource, CameraState
from kinebench_drake.errors import count_noun
from kinebench_drake.io.jsonl import Json, as_number
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.track import Domain


class PeriodSource(Enum):
    """Source of the task time between two frames; of a video in order of precedence."""

    MANIFEST = "manifest"
    OPTION = "option"
    MANIFEST_FPS = "manifest_fps"
    DATASET = "dataset"
    TIME_STAMPS = "time_stamps"
    FPS = "fps"
    BENCHMARK = "benchmark"
    RATE = "rate"
    """Frame rate that the command line sets for trajectories."""
    TASK_DURATION = "task_duration"
    """Duration of the whole video, which precedes all."""


_PERIODS: Mapping[str, str] = {
    PeriodSource.MANIFEST.value: "from the manifest",
    PeriodSource.OPTION.value: "from --frame-period",
    PeriodSource.MANIFEST_FPS.value: "1 / fps of the manifest",
    PeriodSource.DATASET.value: "from the metadata of the dataset",
    PeriodSource.TIME_STAMPS.value: "from the times in the file",
    PeriodSource.FPS.value: "1 / fps of the file",
    PeriodSource.BENCHMARK.value: "the benchmark's, by default",
    PeriodSource.RATE.value: "from --rate",
    PeriodSource.TASK_DURATION.value: "from --task-duration",
}
_CAMERAS: Mapping[str, str] = {
    "argument": "argument of the call",
    "manifest": "from the manifest",
    "folder": "from camera.json",
    "benchmark": "the benchmark's",
    "option": "from --camera",
    "auto": "one known by name where the arm confirms it, else estimated from the arm",
    "fitted": "fitted to the arm where its motion is stated",
    "recognized": "known by name, recognized by the arm",
    "estimated": "estimated from the arm",
    "none": "unknown: without a base frame (the robot's own) verdicts are undecided",
}
_LOOKS: Mapping[str, str] = {
    Domain.FAMILIAR.value: "familiar to the networks",
    Domain.UNFAMILIAR.value: "unfamiliar to the networks",
    Domain.ARM.value: "no hand of Franka's, only the flange is measured",
}
_MOST = 3
"""Values that a line lists."""
BENCHMARK_PERIOD_S = 0.2
"""Task time between two frames of the benchmark's videos (4 control steps at 20 Hz) [s]."""


def describe_period(row: SampleRow) -> str:
    """Describe the frame period of a row and its source."""
    if row.frame_period_s is None:
        return "unknown"
    source = str(row.frame_period_source)
    return f"{row.frame_period_s:.4g} s, {_PERIODS.get(source, source)}"


def table_height(row: SampleRow, config: Mapping[str, object]) -> float:
    """Return the height of the table that a row was judged with [m]: that of its camera, else of the run's options."""
    return row.table_height_m if row.table_height_m is not None else as_number(config.get("table_height_m")) or 0.0


def list_inputs(rows: Iterable[SampleRow]) -> dict[str, list[dict[str, Json]]]:
    """Count the frame periods and cameras of the rows, the most frequent first.

    Returns:
        `frame_periods`: objects of frame_period_s [s], source and number of samples; `cameras`: of source and number of
        samples that were measured. A row without one of them is not counted there.
    """
    periods = Counter[tuple[float, str]]()
    cameras = Counter[str]()
    for row in rows:
        if row.frame_period_s is not None and row.frame_period_source is not None:
            periods[float(f"{row.frame_period_s:.4g}"), row.frame_period_source] += 1
        if row.status is Status.OK and row.camera_source is not None:
            cameras[row.camera_source] += 1
    return {
        "frame_periods": [
            {"frame_period_s": period_s, "source": source, "samples": n}
            for (period_s, source), n in sorted(periods.items(), key=lambda item: (-item[1], item[0]))
        ],
        "cameras": [
            {"source": source, "samples": n}
            for source, n in sorted(cameras.items(), key=lambda item: (-item[1], item[0]))
        ],
    }


def input_lines(rows: Sequence[SampleRow]) -> list[str]:
    """Describe frame period and camera of the rows with their sources, and their looks; count the motionless ones.

    A line each; there is none of what no row has. Where the benchmark camera fits and the period is that of the file,
    the first line has the number of verdicts that the benchmark's period would change.
    """
    inputs = list_inputs(rows)
    periods = [
        (f"{entry['frame_period_s']:g} s, {_PERIODS.get(str(entry['source']), entry['source'])}", entry["samples"])
        for entry in inputs["frame_periods"]
    ]
    cameras = [
        (_CAMERAS.get(str(entry["source"]), str(entry["source"])), entry["samples"]) for entry in inputs["cameras"]
    ]
    lines = [f"{name}: {_join(groups)}" for name, groups in (("frame period", periods), ("camera", cameras)) if groups]
    if changes := [change for row in rows if (change := _changes_in_benchmark(row)) is not None]:
        count = {0: "no verdict changes", 1: "1 verdict changes"}.get(sum(changes), f"{sum(changes)} verdicts change")
        lines[0] += f"; but the benchmark camera fits: {count} at {BENCHMARK_PERIOD_S:g} s"
    looks = Counter(row.domain for row in rows if row.domain is not None)
    if looks:
        lines.append(f"look: {_join([(_LOOKS.get(domain, domain), n) for domain, n in looks.most_common()])}")
    if motionless := sum(row.metrics.motionless for row in rows):
        lines.append(f"motionless: {motionless} of {count_noun(len(rows), 'sample')}")
    return lines


def _changes_in_benchmark(row: SampleRow) -> bool | None:
    """Return whether the benchmark's frame period changes the verdict on a motion.

    None unless the arm confirms the benchmark's camera, the period is that of the file, and both verdicts are known.
    """
    fits = row.camera_source == CameraSource.BENCHMARK.value and row.camera_state == CameraState.CONFIRMED.value
    if not fits or row.frame_period_source != PeriodSource.FPS.value or row.feasible is None:
        return None
    least_s = row.metrics.feasible_from_period_s
    if least_s is not None:
        return (least_s <= BENCHMARK_PERIOD_S) is not row.feasible
    return None if row.feasible else False


def _join(groups: Sequence[tuple[str, Json]]) -> str:
    """Join descriptions, each with its number of samples where there are several."""
    if len(groups) == 1:
        return groups[0][0]
    more = [f"{len(groups) - _MOST} more"] if len(groups) > _MOST else []
    return "; ".join([*(f"{text} ({n} x)" for text, n in groups[:_MOST]), *more])
