"""Study of a learned world model: its success, and the choice between samples by their verdicts.

The study is a folder of output folders of `suite run` on the same episodes, as `examples/worldmodel/study.sh` makes it:
the best training in closed loop, policies to compare it with, and one clip an episode of each training.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path

import cv2
import numpy as np

from benchmarks.markdown import section, table
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.power import least_difference
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.stats import PairedShares, wilson

BEST = "best"
STILL = "still"
RANDOM = "random"
TRANSFER = "transfer"
SAMPLES = "samples"
EXPERT = "oracle"
"""Folders of the best training, videos that do not move, random motions, a task that the best training has not seen,
several samples of each episode, and the clips of the expert."""


def read_runs(study: Path) -> dict[str, list[SampleRow]]:
    """Return the rows of each run of a study, those with an outcome, by the folder's name.

    Raises:
        UsageError: the folder is no study.
    """
    folders = sorted(path.parent for path in study.glob("*/samples.jsonl"))
    rows = {f.name: [r for r in read_rows(f).values() if r.status is not Status.ERROR] for f in folders}
    if not rows.keys() & {BEST, SAMPLES}:
        raise UsageError(f"{study.name}: has no folder {BEST} or {SAMPLES}; make it with examples/worldmodel/study.sh")
    return rows


def _hit(row: SampleRow) -> float:
    return float(row.success is True)


def clip_ends(row: SampleRow) -> list[int]:
    """Return the number of frames of an episode up to the end of each clip."""
    return list(accumulate(row.clip_frames)) if isinstance(row.clip_frames, tuple) else []


def reported_kinds(row: SampleRow, clip: int) -> set[str]:
    """Return the kinds of anomalies that are reported in a clip of an episode, from 0."""
    start, end = [0, *clip_ends(row)][clip : clip + 2]
    return {anomaly.kind.value for anomaly in row.anomalies if start <= anomaly.frame_start < end}


def success_lines(runs: Mapping[str, Sequence[SampleRow]]) -> list[str]:
    """Return the table of successes by run and task, with the share that is executable."""
    tasks = sorted({str(row.task) for own in runs.values() for row in own})
    lines = []
    for name, own in runs.items():
        hits = [[_hit(row) for row in own if row.task == task] for task in tasks]
        texts = [f"{sum(h):.0f} of {len(h)}" if h else "" for h in hits]
        executable = float(np.mean([row.executable is True for row in own]))
        low, high = wilson(round(sum(map(sum, hits))), len(own))
        total = f"{100 * np.mean([_hit(row) for row in own]):.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
        lines.append([name, *texts, total, f"{100 * executable:.0f} %"])
    return table(["run", *tasks, "success", "executable"], lines)


def gain_text(runs: Mapping[str, Sequence[SampleRow]]) -> str:
    """Return the difference of the best training's success and that of policies that see nothing, on their episodes."""
    best = {row.id: _hit(row) for row in runs[BEST]}
    texts = []
    for name in (STILL, RANDOM):
        both = [(best[row.id], _hit(row)) for row in runs.get(name, ()) if row.id in best]
        if both:
            texts.append(
                f"`{name}` {points_text(_pair([a for a, _ in both], [b for _, b in both]))} ({len(both)} episodes)"
            )
    return f"Success of `{BEST}` less that of {', of '.join(texts)}." if texts else ""


def transfer_text(rows: Sequence[SampleRow]) -> str:
    """Return the success in a task that was not trained."""
    hits = int(sum(map(_hit, rows)))
    low, high = wilson(hits, len(rows))
    return f"In {rows[0].task}, not seen in training: {hits} of {len(rows)} [{100 * low:.0f}, {100 * high:.0f}] %."


def _pair(first: Sequence[float] | Array, second: Sequence[float] | Array, samples: int = 1) -> PairedShares:
    return PairedShares(first=np.asarray(first), second=np.asarray(second), samples=samples)


def points_text(paired: PairedShares) -> str:
    """Return the difference in percentage points, with its interval."""
    low, high = paired.interval()
    return f"{100 * paired.difference:.0f} points [{100 * low:.0f}, {100 * high:.0f}]"


def likeness_db(clip: Path, expert: Path) -> float:
    """Return the PSNR of a clip with that of the expert, which stays at its last frame where it is shorter [dB]."""
    frames = np.asarray(read_video(clip).frames)
    shown = np.asarray(read_video(expert).frames)
    shown = shown[np.minimum(np.arange(len(frames)), len(shown) - 1)]
    return float(cv2.PSNR(frames.reshape(len(frames), -1), shown.reshape(len(frames), -1)))


def choice_lines(folder: Path, expert: Path | None = None) -> list[str]:
    """Return the success of the sample of each episode that a choice takes, and its gain over that of any sample.

    Choices are by the executability, 0 where there is none, by the likeness to the clips of the `expert`, where these
    exist, and that of the first sample. Of equal ones the first is taken.
    """
    groups: dict[str, list[SampleRow]] = {}
    for row in sorted(read_rows(folder).values(), key=lambda row: row.sample_index):
        groups.setdefault(row.episode, []).append(row)
    success = np.array([[_hit(row) for row in own] for own in groups.values()])
    choices = {
        "the first sample": np.zeros_like(success),
        "executability": np.array([[row.number("executability") or 0.0 for row in own] for own in groups.values()]),
    }
    if expert is not None:
        shown = {id: expert / row.video for id, row in read_rows(expert).items()}
        choices["likeness to the expert (PSNR)"] = np.array(
            [[likeness_db(folder / row.video, shown[id]) for row in own] for id, own in groups.items()]
        )
    lines = []
    for name, values in choices.items():
        chosen = success[np.arange(len(success)), values.argmax(axis=1)]
        paired = _pair(chosen, success.mean(axis=1), success.shape[1])
        least = least_difference(paired)
        shown_gain = "none" if least is None else f"{100 * least:.0f} points"
        lines.append([name, f"{100 * chosen.mean():.0f} %", points_text(paired), shown_gain])
    each = 100 * success.mean()
    some = 100 * success.max(axis=1).mean()
    return [
        f"{len(success)} episodes, {success.shape[1]} samples of each. {each:.0f} % of the samples succeed, and in "
        f"{some:.0f} % of the episodes any.",
        "",
        *table(["chosen by", "success", "gain over a sample", "least gain that would be shown"], lines),
    ]


def sections(study: Path) -> Iterator[str]:
    """Yield the sections of docs/worldmodel.md that follow from the rows of a study."""
    runs = read_runs(study)
    samples = runs.pop(SAMPLES, None)
    transfer = runs.pop(TRANSFER, None)
    if BEST in runs:
        yield section("Success", success_lines(runs), gain_text(runs), transfer_text(transfer) if transfer else "")
    if samples:
        expert = study / EXPERT
        yield section("Choice of a sample", choice_lines(study / SAMPLES, expert if expert.exists() else None))
