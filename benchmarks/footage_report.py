"""Report of the grounding on videos of other programs and cameras: footage.json and footage.md."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.footage import ReferenceKind, TrackRecord, find_footage, ground_videos, reference_of
from benchmarks.footage_errors import PoseErrors, compare, error_table, figures
from benchmarks.footage_labels import FootageLabels, compare_labels, label_figures, label_table, read_labels
from benchmarks.markdown import table
from benchmarks.perception.clip import TruthClipFile
from benchmarks.record import current_revision
from kinebench_drake.executors.base import Observer
from kinebench_drake.io.atomic import make_folder, write_atomically
from kinebench_drake.io.jsonl import Json, dump
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.results.record import to_json

_POSES = (ReferenceKind.SIMULATOR, ReferenceKind.JOINTS, ReferenceKind.EDGES)


def measure(folder: Path, out: Path, gripper: GripperKind, observer: Observer) -> str:
    """Ground the videos of a folder, write footage.json and footage.md, and return the Markdown.

    Raises:
        UsageError: the folder has no such videos.
    """
    labels = read_labels()
    videos = find_footage(folder)
    kinds = {video.id: reference_of(video, labels.videos) for video in videos}
    make_folder(out)
    tracks = ground_videos(videos, out, gripper, observer)
    result: dict[str, Json] = {"revision": current_revision(), "gripper": gripper.value}
    lines = [f"Revision {result['revision']}."]
    pairs = list(zip(videos, tracks, strict=True))
    lines += _pose_lines([(kinds[v.id], v, t) for v, t in pairs if kinds[v.id] in _POSES], result)
    lines += _label_lines([(v, t) for v, t in pairs if kinds[v.id] is ReferenceKind.LABELS], labels, result)
    lines += _anomaly_lines(tracks, labels, result)
    text = "\n".join(lines) + "\n"
    write_atomically(out / "footage.json", dump(to_json(result), indent=1).encode())
    write_atomically(out / "footage.md", text.encode())
    return text


def _pose_lines(
    pairs: Sequence[tuple[ReferenceKind, TruthClipFile, TrackRecord]], result: dict[str, Json]
) -> list[str]:
    """Return the section on videos with reference poses, and put its figures into `result`."""
    errors: dict[ReferenceKind, list[PoseErrors]] = {}
    for kind, video, track in pairs:
        errors.setdefault(kind, []).append(compare(video.load(), track))
    kinds = {kind.value: figures(group) for kind, group in errors.items()}
    single = {e.id: figures([e]) for group in errors.values() for e in group}
    result["kinds"] = kinds
    result["videos"] = single
    if not kinds:
        return []
    return ["", *error_table(kinds), "", *error_table(single)]


def _label_lines(
    pairs: Sequence[tuple[TruthClipFile, TrackRecord]], labels: FootageLabels, result: dict[str, Json]
) -> list[str]:
    """Return the section on labelled videos, and put its figures into `result`."""
    errors = [compare_labels(video, track, labels.videos[video.id]) for video, track in pairs]
    if not errors:
        return []
    groups = {"all": errors, "clean": [e for e in errors if e.id in labels.clean]}
    groups |= {e.id: [e] for e in errors}
    figures_by_name = {name: label_figures(group) for name, group in groups.items() if group}
    result["labels"] = figures_by_name
    return ["", *label_table(figures_by_name)]


def _anomaly_lines(tracks: Sequence[TrackRecord], labels: FootageLabels, result: dict[str, Json]) -> list[str]:
    """Return the section on anomalies by video, and put them into `result`."""
    ranges = {t.id: [f"{a.kind.value} {a.frame_start}-{a.frame_end}" for a in t.anomalies] for t in tracks}
    clean = [t for t in tracks if t.id in labels.clean]
    false = sum(bool(t.anomalies) for t in clean)
    result["anomalies"] = {"by_video": ranges, "clean_videos": len(clean), "clean_videos_with_anomalies": false}
    rows = [[name, "yes" if name in labels.clean else "no", "; ".join(kinds)] for name, kinds in ranges.items()]
    summary = f"{false} of {len(clean)} clean videos have anomalies."
    return ["", summary, "", *table(("", "clean", "anomalies, frames"), rows)]
