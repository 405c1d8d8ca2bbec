"""Accuracy of the grounding on renderings with exact poses and on videos of other programs and cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

from benchmarks import footage_report, markdown
from benchmarks.footage import ReferenceKind
from benchmarks.markdown import percent
from benchmarks.perception.study import CLEAN, StudyPlan, run_study
from benchmarks.perception.summary import intervals, summarize
from kinebench_drake.environment.precision import network_precision
from kinebench_drake.executors.base import Observer
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.io.jsonl import read_object
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.stats import IntervalEstimate

HELDOUT = ("suite", "demos", "--suite", "2", "--split", "unseen", "--episodes", "2", "--with-depth")
"""Arguments of the program for the renderings; `--out` is to be added."""
_TITLES = {
    ReferenceKind.SIMULATOR.value: "other simulator, cameras from anywhere; exact poses",
    ReferenceKind.EDGES.value: "stock tasks of ManiSkill at their own cameras; poses fitted to edges",
    ReferenceKind.JOINTS.value: "real arm seen from the side; poses from its joint angles",
}
WIDTH = 140
"""Length of the lines of the page."""
_INTRODUCTION = (
    "Poses of panda_hand from pixels and a known camera, compared with references: median / 95th percentile of the",
    "tracked frames. A pose is good within 10 mm and 5 degrees. `confidence` is the probability of that, and its mean",
    "is the claim. In brackets: 95 % bootstrap intervals over videos.",
)
_COMMANDS = (
    f"    kinebench-drake {' '.join(HELDOUT)} --out heldout",
    "    python -m benchmarks accuracy --heldout heldout --others FOLDER --work accuracy",
)
_HEAD = (
    "videos",
    "number",
    "tracked",
    "position",
    "rotation",
    "tracked, but off by 30 mm or 15 degrees",
    "good / claimed",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldoutFigures:
    """Figures of held-out renderings."""

    summary: Mapping[str, float]
    """Figures of all frames, of `summarize`."""
    intervals: Mapping[str, IntervalEstimate]
    """Figures with their intervals over videos, of `intervals`."""


def measure(
    heldout: Path, others: Sequence[Path], work: Path, observer: Observer
) -> tuple[HeldoutFigures, list[Mapping[str, Any]]]:
    """Ground held-out renderings of `suite demos` and videos of others; resumes from the folder `work`.

    Returns:
        Figures of the renderings, and the result of `footage` for each folder.

    Raises:
        UsageError: a folder cannot be used.
    """
    plan = StudyPlan(folder=heldout, keep=work / "heldout.clips.jsonl")
    (results,) = run_study([CLEAN], plan, LocalExecutor(jobs=1), observer).results.values()
    for folder in others:
        footage_report.measure(folder, work / folder.name, GripperKind.FRANKA, observer)
    measured = HeldoutFigures(summary=summarize(results), intervals=intervals(results))
    return measured, [read_object(work / folder.name / "footage.json") for folder in others]


def figures(heldout: HeldoutFigures, others: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return errors and shares of failures by name; of all of them less is better."""
    summary = heldout.summary
    result = {
        "heldout, position median [mm]": summary["position_median_mm"],
        "heldout, position p95 [mm]": summary["position_p95_mm"],
        "heldout, rotation median [deg]": summary["rotation_median_deg"],
        "heldout, not tracked": 1.0 - summary["tracked_fraction"],
        "heldout, processor time of a video [s]": summary["cpu_median_s"],
    }
    for kind, f in _kinds(others).items():
        result[f"{kind}, position median [mm]"] = f["hand_mm_median"]
        result[f"{kind}, rotation median [deg]"] = f["rotation_deg_median"]
        result[f"{kind}, not tracked"] = 1.0 - f["tracked"]
        result[f"{kind}, off by 30 mm or 15 degrees"] = f["silent"]
    return result


def section(heldout: HeldoutFigures, others: Sequence[Mapping[str, Any]]) -> str:
    """Return the section of the page, in Markdown: videos of others first."""
    introduction = (*_INTRODUCTION, f"Networks in {network_precision().value}.")
    rows = [_footage_row(_TITLES[kind], f) for kind, f in _kinds(others).items()]
    rows.append(_heldout_row(heldout))
    texts = (wrap(text, width=WIDTH) for text in (_other_text(others), _heldout_text(heldout.summary)))
    return markdown.section("Accuracy", introduction, markdown.table(_HEAD, rows), *texts, _COMMANDS)


def _other_text(others: Sequence[Mapping[str, Any]]) -> str:
    sentences = []
    for other in others:
        if "labels" in other:
            f = other["labels"]["all"]
            sentences += [
                f"{f['frames']} frames of clips of others were labelled by eye, most with guessed cameras:",
                f"{percent(f['tracked'])} are tracked. The projected hand is off by",
                f"{percent(f['error_median'])} of its length (95 %: {percent(f['error_p95'])}), and",
                f"by more than a fifth of it in {percent(f['silent'])}.",
            ]
        a = other["anomalies"]
        if a["clean_videos"]:
            share = f"{a['clean_videos_with_anomalies']} of {a['clean_videos']}"
            sentences.append(f"Anomalies are reported in {share} clips of others that show none.")
    return " ".join(sentences)


def _heldout_text(s: Mapping[str, float]) -> str:
    return " ".join(
        [
            f"On renderings of this project {percent(s['tracked_frames_off_by_3_cm'])} of the tracked frames are off",
            "by more than 3 cm. `confidence` differs from the share of good poses by",
            f"{s['calibration_error']:.3f} (mean over bins of confidence). The gap between the finger pads is known in",
            f"{percent(s['finger_width_known'])} of the frames, with a median error of",
            f"{s['finger_width_median_mm']:.1f} mm (95 %: {s['finger_width_p95_mm']:.1f} mm).",
            f"False anomalies: {s['anomalies_not_planted']:.0f} in {s['videos']:.0f} videos. The commands:",
        ]
    )


def _kinds(others: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    return {kind: other["kinds"][kind] for kind in _TITLES for other in others if kind in other["kinds"]}


def _footage_row(title: str, f: Mapping[str, Any]) -> list[str]:
    return [
        title,
        str(f["videos"]),
        percent(f["tracked"]),
        f"{f['hand_mm_median']:.1f} / {f['hand_mm_p95']:.1f} mm",
        f"{f['rotation_deg_median']:.1f} / {f['rotation_deg_p95']:.1f} degrees",
        percent(f["silent"]),
        f"{percent(f['good'])} / {percent(f['confidence_mean'])}",
    ]


def _heldout_row(heldout: HeldoutFigures) -> list[str]:
    s = heldout.summary
    position = heldout.intervals["position_median_mm"]
    rotation = heldout.intervals["rotation_median_deg"]
    return [
        "this project's renderer and camera, assets and looks that no network has seen; exact poses",
        f"{s['videos']:.0f}",
        percent(s["tracked_fraction"]),
        f"{position.value:.1f} [{position.low:.1f}, {position.high:.1f}] / {s['position_p95_mm']:.1f} mm",
        f"{rotation.value:.1f} [{rotation.low:.1f}, {rotation.high:.1f}] / {s['rotation_p95_deg']:.1f} degrees",
        "",
        "",
    ]
