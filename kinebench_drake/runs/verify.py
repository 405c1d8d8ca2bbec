"""Verification of a bundle: hashes, aggregates from the rows, and a random part of the rows from tracks or videos."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinebench_drake.errors import InputError, KinebenchError, UsageError
from kinebench_drake.geometry import pose_difference
from kinebench_drake.io.jsonl import Json, as_number
from kinebench_drake.models.arm import PANDA
from kinebench_drake.models.named_arm import named_arms
from kinebench_drake.results.aggregate import RunStatistics
from kinebench_drake.results.bundle import MANIFEST, Bundle
from kinebench_drake.results.details import read_details
from kinebench_drake.results.metadata import RunMetadata
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import RESULTS, artifact_path, read_rows
from kinebench_drake.results.trackfile import TrackFile, read_track
from kinebench_drake.runs.config import RunKind, ScoreConfig
from kinebench_drake.runs.evaluator import judge_row
from kinebench_drake.runs.option import options_of
from kinebench_drake.runs.preparation import read_sample
from kinebench_drake.runs.resources import Resources, RobotOptions, load_resources
from kinebench_drake.runs.resume import SCHEMA_VERSION, hash_sample
from kinebench_drake.runs.runner import summarize
from kinebench_drake.runs.score import VideoEvaluator, find_videos, mean_confidence
from kinebench_drake.track import GripperTrack

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.kinematic_result import KinematicResult

RELATIVE = 1e-3
ABSOLUTE = 1e-6
"""Tolerances of a number: it holds within either."""
POSITION_M = 0.01
ROTATION_RAD = float(np.deg2rad(5.0))
"""Tolerances of a pose that is measured from the video anew."""
FRAMES = 0.05
"""Share of the frames that may be beyond them, or be tracked in one measurement only."""
_MOST = 5
"""Differences of a row that are named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """Outcome of a verification."""

    faults: Sequence[str]
    """What does not hold, a line each."""
    measured: Sequence[str]
    """Ids of the samples that were measured anew."""
    candidates: int
    """Samples that can be: those measured in one clip. Of several clips the track lacks the frames where they join."""
    samples: int
    """All samples."""


def verify_bundle(bundle: Bundle, samples: int, seed: int, videos: Path | None = None) -> Verification:
    """Compare what a bundle states with what follows from its files.

    Args:
        videos: folder of the videos, from which they are grounded anew, too.
    """
    rows, run, stated = _read(bundle)
    own = {name: digest for name, digest in bundle.files.items() if name != MANIFEST}
    changed = sorted(name for name in {**bundle.stated, **own} if bundle.stated.get(name) != own.get(name))
    faults = [f"{name}: SHA-256 differs from that stated" for name in changed]
    expected = summarize(list(rows.values()), run, RunStatistics.of(rows.values(), run.bootstrap_seed))
    faults += [f"{RESULTS}: {text}" for text in list_differences(stated, expected, "the rows give")]
    candidates = [id for id, row in rows.items() if row.status is Status.OK and row.rounds in (None, 1)]
    chosen = np.random.default_rng(seed).permutation(len(candidates))[:samples]
    ids = sorted(candidates[k] for k in chosen)
    tools = load_resources(Resources, _robot_options(run)) if ids and RunKind(run.kind).judges else None
    grounder = None if videos is None else _Regrounder(run, videos)
    for id in ids:
        row = rows[id]
        try:
            file = read_track(artifact_path(bundle.folder, "tracks", id))
            texts = list(_compare_row(row, file, tools))
            texts += grounder.compare(row, file.track, bundle.videos.get(row.video)) if grounder else []
        except (InputError, KeyError) as error:
            texts = [str(error)]
        faults += [f"{id}: {text}" for text in texts[:_MOST]]
        faults += [f"{id}: {len(texts) - _MOST} more differences"] if len(texts) > _MOST else []
    return Verification(faults=faults, measured=ids, candidates=len(candidates), samples=len(rows))


def _read(bundle: Bundle) -> tuple[dict[str, SampleRow], RunMetadata, Mapping[str, object]]:
    """Read rows, sorted by id, and results.json."""
    from kinebench_drake.report.run import read_results

    try:
        stated = read_results(bundle.folder)
        run = RunMetadata.from_json(stated)
        rows = read_rows(bundle.folder)
    except InputError as error:
        raise UsageError(f"{bundle.path}: {error}") from None
    if run.schema_version != SCHEMA_VERSION or run.kind not in [kind.value for kind in RunKind]:
        raise UsageError(
            f"{bundle.path}: is of kind {run.kind!r:.20} and schema_version {run.schema_version}, expected "
            f"{SCHEMA_VERSION}"
        )
    return dict(sorted(rows.items())), run, stated


def list_differences(stated: object, expected: object, verb: str, name: str = "") -> Iterator[str]:
    """Describe each value in which two JSON values differ, numbers beyond the tolerance."""
    if isinstance(stated, Mapping) and isinstance(expected, Mapping):
        for key in dict.fromkeys((*stated, *expected)):
            inner = f"{name}.{key}" if name else str(key)
            yield from list_differences(stated.get(key), expected.get(key), verb, inner)
    elif isinstance(stated, list | tuple) and isinstance(expected, list | tuple) and len(stated) == len(expected):
        for k, (one, other) in enumerate(zip(stated, expected, strict=True)):
            yield from list_differences(one, other, verb, f"{name}[{k}]")
    else:
        a = as_number(stated)
        b = as_number(expected)
        alike = stated == expected if a is None or b is None else isclose(a, b, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
        if not alike:
            texts = (f"{value:.6g}" if isinstance(value, float) else f"{value!r:.60}" for value in (stated, expected))
            yield f"{name} is {next(texts)}, {verb} {next(texts)}"


def _robot_options(run: RunMetadata) -> RobotOptions:
    """Return the robot and the table of a run."""
    name = str(run.config.get("robot") or PANDA)
    payload_kg, height_m = (as_number(run.config.get(key)) or 0.0 for key in ("payload_kg", "table_height_m"))
    options = RobotOptions(robot=name, payload_kg=payload_kg, table_height_m=height_m)
    if name not in named_arms() or options.load().id != run.config.get("robot_id"):
        raise UsageError(
            f"judged with {name} and a tool, limits or obstacles that a bundle does not hold, or by another version; "
            f"expected {' or '.join(named_arms())} as it is here"
        )
    return options


def _compare_row(row: SampleRow, file: TrackFile, tools: Resources | None) -> Iterator[str]:
    """Describe in what a row differs from the numbers of its track, which without `tools` are not judged."""
    expected = row
    if "tracked_fraction" in row.metrics:
        tracked = float(np.mean(file.track.tracked))
        expected = row.measured({"tracked_fraction": tracked, "confidence_mean": mean_confidence(file.track)})
    if tools is not None and row.base_frame_reason is None:
        expected = judge_row(expected, _judge_file(row, file, tools), curves=file.curves)
    elif row.feasible is not None and row.possible_cameras is None:
        yield f"feasible is {row.feasible}, but the row has no base frame"
    yield from list_differences(_verdict(row), _verdict(expected), "its track gives")


def _judge_file(row: SampleRow, file: TrackFile, tools: Resources) -> "KinematicResult":
    """Judge the track of a row as the run did."""
    if row.judged == "joints":
        return tools.judge_joints(file.track.t_s, file.q, file.track.finger_width_m)
    noise = read_details(row).noise
    track = replace(
        file.track,
        offset_m=noise.offset_m or 0.0,
        offset_rad=noise.offset_rad or 0.0,
        turn_is_sure=noise.turn_is_sure,
    )
    return tools.judge(track, row.table_height_m)


def _verdict(row: SampleRow) -> dict[str, Json]:
    data = row.to_json()
    return {name: data[name] for name in ("feasible", "executable", "executable_reasons", "violations", "metrics")}


class _Regrounder:
    """Grounding of the videos of a run with its settings."""

    def __init__(self, run: RunMetadata, videos: Path) -> None:
        """Find the videos; networks are loaded with the first.

        Raises:
            UsageError: the run is of another kind, or its settings name files that a bundle does not hold.
        """
        if run.kind not in (RunKind.SCORE.value, RunKind.GROUND.value):
            raise UsageError(f"$videos is for runs of score and ground, this one is of kind {run.kind}")
        options: dict[str, Any] = {
            name: run.config.get(option.key or name)
            for name, option in options_of(ScoreConfig).items()
            if option.key is not None and name not in ("source", "limit", "shard", "jobs", "engine")
        }
        options = {name: value for name, value in options.items() if value is not None}
        config = ScoreConfig(source=videos, out=Path(), kind=RunKind(run.kind), **options)
        self._evaluator = VideoEvaluator(config=config, overrides=config.overrides())
        self._samples = {sample.id: sample for sample in find_videos(config).samples}
        self._tools = self._evaluator.setup()

    def compare(self, row: SampleRow, track: GripperTrack, stated: object) -> list[str]:
        """Describe in what a row and its track differ from its video, whose SHA-256 is `stated`."""
        sample = self._samples.get(row.id)
        if sample is None or stated != hash_sample(self._evaluator, sample).input:
            return [f"{row.video} {'is absent' if sample is None else 'is another video: its SHA-256 differs'}"]
        try:
            again = self._evaluator.measure(sample, read_sample(sample), self._tools, row)
        except KinebenchError as error:
            return [f"{row.video}: {error}"]
        new = again.grounding.visible_track
        n = len(track.t_s)
        if len(new.t_s) != n:
            return [f"track has {n} frames, its video gives {len(new.t_s)}"]
        both = track.tracked & new.tracked
        position_m, rotation_rad = pose_difference(track.X_CH[both], new.X_CH[both])
        apart = int((track.tracked != new.tracked).sum())
        apart += int(((position_m > POSITION_M) | (rotation_rad > ROTATION_RAD)).sum())
        texts = list(list_differences(row.feasible, again.row.feasible, "its video gives", "feasible"))
        if apart > FRAMES * n:
            texts.append(f"{apart} of {n} frames are not within {POSITION_M * 1e3:g} mm and 5 degrees of its video's")
        return texts
