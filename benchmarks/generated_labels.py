"""What a person sees in generated videos, beside grounding, detectors, attribution and inverse-dynamics baseline.

Ids of `generated_labels.json` are those of the study's run `best` (`benchmarks.generated`), of anomalies those of other
runs as well. Points and anomalies are those of the episodes' first clips, labelled before their tracks and reported
anomalies were looked at; the causes of StackCube-v1 were, too. Those of OpenBoxEasy-v1 and PullCube-v1 were judged with
the verdicts known. Detectors were mended after a look at the clips of `best`; the other runs are held out.

    videos       points labelled in frames, as in footage_labels.json; `again`: some of these frames a second time
    anomalies    by run: kinds of anomalies that are seen in the clip
    confirmed    by run: kinds that were reported, not seen at first, and seen when their frames were looked at again
    causes       cause of the episode's failure as seen in the rollout: a verdict
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.executions import ClipTrack, Extractor, execute_all
from benchmarks.footage_labels import (
    SILENT_SHARE,
    LabelledFrame,
    hand_lengths_px,
    read_frame,
    read_labels,
    reprojection_px,
)
from benchmarks.generated import BEST, points_text, reported_kinds
from benchmarks.markdown import percent, section, table
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.io.jsonl import read_json
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.stats import PairedShares
from kinebench_drake.suites.catalog import load_suite
from training.baseline.network import Baseline

LABELS = Path(__file__).with_name("generated_labels.json")
SUITE = 3
"""Suite of the study."""
_EXTRACTORS = (Extractor.GROUNDING, Extractor.BASELINE)
FAR_SHARE = 0.1
"""Reprojection error over the hand's length beyond which a pose is not good."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneratedLabels:
    """Content of generated_labels.json."""

    videos: Mapping[str, tuple[LabelledFrame, ...]]
    """Labelled frames by episode."""
    again: Mapping[str, tuple[LabelledFrame, ...]]
    """Frames of these that were labelled a second time, by episode."""
    anomalies: Mapping[str, Mapping[str, Sequence[str]]]
    """Kinds seen in a clip, by run and episode."""
    confirmed: Mapping[str, Mapping[str, Sequence[str]]]
    """Further kinds seen after they were reported, by run and episode."""
    causes: Mapping[str, str]
    """Cause of the failure as seen, by episode."""


def read_generated_labels(path: Path = LABELS) -> GeneratedLabels:
    """Read the labels.

    Raises:
        UsageError: the file is not one of labels.
    """
    data: Any = read_json(path)
    again = {name: tuple(map(read_frame, frames)) for name, frames in data["again"].items()}
    others = {name: data[name] for name in ("anomalies", "confirmed", "causes")}
    return GeneratedLabels(videos=read_labels(path).videos, again=again, **others)


class EyeStudy:
    """A study beside the labels."""

    def __init__(self, study: Path, weights: Path) -> None:
        """Name the folder of the study and the weights of the baseline."""
        self._labels = read_generated_labels()
        self._weights = weights
        self._folder = study / BEST
        self._rows = read_rows(self._folder)

    def _clips(self, ids: Sequence[str], extractor: Extractor) -> list[ClipTrack]:
        suite = load_suite(SUITE)
        clips = []
        for id in ids:
            row = self._rows[id]
            (spec,) = suite.specs("test", 1, tasks=[str(row.task)], offset=row.seed or 0)
            video = self._folder / "videos" / f"{id}_r0.mp4"
            source = video if extractor is Extractor.BASELINE else artifact_path(self._folder, "tracks", id)
            clips.append(ClipTrack(id=id, spec=spec, extractor=extractor, source=source))
        return clips

    def sections(self, jobs: int, observer: RunObserver) -> Iterator[str]:
        """Yield the sections of docs/worldmodel.md."""
        yield section("Frames labelled by eye", self.label_lines())
        yield section("Anomalies beside the eye", self.anomaly_lines())
        yield section("Causes beside the eye", self.cause_lines())
        yield section("Beside inverse dynamics", self.execution_lines(jobs, observer))

    def label_lines(self) -> Iterator[str]:
        """Yield the table of errors of both extractors at the labelled frames, and the error of the labels."""
        network = Baseline.load(self._weights)
        camera = benchmark_camera()
        ids = list(self._labels.videos)
        frames = [frame for id in ids for frame in self._labels.videos[id]]
        length = np.concatenate([hand_lengths_px(self._labels.videos[id]) for id in ids])
        rows = []
        for extractor in _EXTRACTORS:
            px = []
            confidence = []
            for id, clip in zip(ids, self._clips(ids, extractor), strict=True):
                track = clip.read(network)
                for frame in self._labels.videos[id]:
                    k = frame.frame
                    X_CH = np.where(track.tracked[k], track.X_CH[k], np.nan)
                    px.append(reprojection_px(frame, camera, X_CH, float(track.finger_width_m[k])))
                    confidence.append(track.confidence[k])
            error = np.array(px)
            tracked = np.isfinite(px)
            share = (error / length)[tracked]
            rows.append([
                extractor.value,
                f"{tracked.sum()} of {len(frames)}",
                f"{np.median(error[tracked]):.1f} px, {np.percentile(error[tracked], 95):.1f} px",
                percent(float(np.median(share))),
                percent(float((share <= FAR_SHARE).mean())),
                "-" if extractor is Extractor.BASELINE else percent(float(np.array(confidence)[tracked].mean())),
                percent(float((share > SILENT_SHARE).mean())),
            ])  # fmt: skip
        head = ("", "tracked", "error, median and 95 %", "of the hand's length", "within 10 % of it")
        yield from table((*head, "confidence, mean", "silent errors"), rows)
        yield ""
        twice = list(self._twice())
        yield (
            f"Labels of {len(twice)} frames made twice differ by {np.median(twice):.1f} px (median) and "
            f"{np.percentile(twice, 95):.1f} px (95 %) a point. The hand is {np.median(length):.0f} px long."
        )

    def _twice(self) -> Iterator[float]:
        for id, frames in self._labels.again.items():
            first = {frame.frame: frame.points_px for frame in self._labels.videos[id]}
            for frame in frames:
                both = frame.points_px.keys() & first[frame.frame].keys()
                yield float(np.mean([np.linalg.norm(frame.points_px[n] - first[frame.frame][n]) for n in both]))

    def anomaly_lines(self) -> list[str]:
        """Return the table of anomalies that a person sees and the detectors report in first clips."""
        rows = []
        for run, labels in self._labels.anomalies.items():
            judged = read_rows(self._folder.with_name(run))
            confirmed = self._labels.confirmed.get(run, {})
            clips = [
                (set(kinds), reported_kinds(judged[id], 0), set(confirmed.get(id, ()))) for id, kinds in labels.items()
            ]
            for kind in (kind.value for kind in AnomalyKind):
                by_eye, reported, later = (np.array([kind in clip[k] for clip in clips]) for k in range(3))
                if (by_eye | reported).any():
                    counts = by_eye, reported, by_eye & reported, later & reported
                    rows.append([run, f"`{kind}`", *(str(count.sum()) for count in counts)])
            agree = sum(bool(by_eye) == bool(reported) for by_eye, reported, _ in clips)
            totals = [str(sum(bool(clip[k]) for clip in clips)) for k in range(2)]
            rows.append([run, "any", *totals, f"{agree} of {len(clips)} clips agree", ""])
        return table(("run", "kind", "seen", "reported", "both", "confirmed later"), rows)

    def cause_lines(self) -> list[str]:
        """Return the table of the causes of failures as seen and as attributed."""
        verdicts = {id: row.verdict for id, row in self._rows.items()}
        pairs = [(cause, str(verdicts[id])) for id, cause in self._labels.causes.items() if verdicts.get(id)]
        names = sorted({name for pair in pairs for name in pair})
        rows = [[cause, *(str(pairs.count((cause, verdict))) for verdict in names)] for cause in names]
        agree = sum(cause == verdict for cause, verdict in pairs)
        return [*table(("seen, attributed:", *names), rows), "", f"{agree} of {len(pairs)} agree."]

    def execution_lines(self, jobs: int, observer: RunObserver) -> Iterator[str]:
        """Yield the success of first clips executed through grounding and baseline; an interrupted run resumes."""
        ids = sorted(id for id, row in self._rows.items() if row.status is Status.OK)
        clips = [clip for extractor in _EXTRACTORS for clip in self._clips(ids, extractor)]
        done = execute_all(clips, self._folder.with_name("executions.jsonl"), self._weights, jobs, observer)
        success = np.array([outcome.success for outcome in done]).reshape(2, -1)
        tasks = np.array([self._rows[id].task for id in ids])
        rows = []
        for task in (*np.unique(tasks), None):
            own = success[:, (tasks == task) | (task is None)]
            rows.append([task or "all", str(own.shape[1]), *map(str, own.sum(axis=1)), *map(str, _only(own))])
        yield from table(("task", "clips", "grounding", "baseline", "grounding only", "baseline only"), rows)
        paired = PairedShares(first=success[0].astype(float), second=success[1].astype(float))
        yield ""
        yield f"Success of the grounding less that of the baseline: {points_text(paired)}."


def _only(success: NDArray[np.bool_]) -> tuple[int, int]:
    one, other = success
    return int((one & ~other).sum()), int((other & ~one).sum())
