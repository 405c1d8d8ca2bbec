"""Causal attribution: the same videos executed through the truth, the grounding and the inverse-dynamics baseline.

All is taken from the work folder of `validity`: videos of the oracle without and with planted faults, their ground
truth, the tracks of the grounding and the success of these. An extractor changes the outcome of an episode if its track
succeeds where the true one fails, or fails where that succeeds: the failure is then not the video's.

    extractions.jsonl    success of the true track and of the baseline's, one video a line
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks import markdown
from benchmarks.bootstrap import cluster_bootstrap
from benchmarks.executions import ClipTrack, Extractor, execute_all
from benchmarks.validity import read_study, study_specs
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.io.figure import POSITION, ROTATION, new_figure
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.stats import IntervalEstimate, wilson
from training.baseline.network import Baseline

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE = "extractors.png"
"""Figure beside the page."""
_EXTRACTIONS = "extractions.jsonl"


@dataclass(frozen=True, slots=True, kw_only=True)
class Extraction:
    """Success of one video through all extractors."""

    id: str
    episode: str
    """Id of the episode."""
    kind: AnomalyKind | None
    """Kind of the planted fault; None for the clean video."""
    trained: bool
    """True if the baseline was trained on the task."""
    success: dict[Extractor, bool]

    def changes(self, extractor: Extractor) -> bool:
        """Return whether an extractor changes the outcome."""
        return self.success[extractor] is not self.success[Extractor.TRUTH]


def measure(work: Path, weights: Path, jobs: int, observer: RunObserver) -> list[Extraction]:
    """Execute the videos of a validity study through truth and baseline; an interrupted measurement resumes.

    Raises:
        UsageError: the folder holds no finished study.
        SetupError: something is missing on this machine, or a worker died. What is finished is kept.
    """
    trials, _ = read_study(work)
    specs = {spec.id: spec for spec in study_specs()}
    tasks = Baseline.load(weights).tasks
    sources = {Extractor.TRUTH: "truth/{}.npz", Extractor.BASELINE: "{}.mp4"}
    clips = [
        ClipTrack(
            id=trial.id,
            spec=specs[trial.episode],
            extractor=extractor,
            source=work / "videos" / source.format(trial.id),
        )
        for extractor, source in sources.items()
        for trial in trials
    ]
    done = execute_all(clips, work / _EXTRACTIONS, weights, jobs, observer)
    success = {(clip.extractor, clip.id): outcome.success for clip, outcome in zip(clips, done, strict=True)}
    return [
        Extraction(
            id=trial.id,
            episode=trial.episode,
            kind=trial.kind,
            trained=trial.task in tasks,
            success={Extractor.GROUNDING: trial.success, **{e: success[e, trial.id] for e in sources}},
        )
        for trial in trials
    ]


def _groups(extractions: Sequence[Extraction]) -> Iterator[tuple[str, list[Extraction]]]:
    """Yield all videos, those of tasks that the baseline knows and of others, and those of each kind of fault."""
    yield "all videos", list(extractions)
    for trained, name in ((True, "tasks of the baseline's training"), (False, "other tasks")):
        yield name, [e for e in extractions if e.trained is trained]
    yield "no fault", [e for e in extractions if e.kind is None]
    for kind in AnomalyKind:
        yield f"`{kind.value}`", [e for e in extractions if e.kind is kind]


def changed(extractions: Sequence[Extraction], extractor: Extractor) -> IntervalEstimate:
    """Return the share of videos whose outcome an extractor changes, with its bootstrap interval over episodes.

    If all or none are changed, the interval is Wilson's for as many episodes; else a single episode has none.
    """
    episodes: dict[str, list[bool]] = {}
    for e in extractions:
        episodes.setdefault(e.episode, []).append(e.changes(extractor))
    share = cluster_bootstrap(list(episodes.values()), lambda drawn: float(np.mean(np.concatenate(drawn))))
    if share.value not in (0.0, 1.0):
        return share
    low, high = wilson(round(share.value * len(episodes)), len(episodes))
    return IntervalEstimate(value=share.value, low=low, high=high)


def section(extractions: Sequence[Extraction], about: str) -> str:
    """Return the section of docs/validity.md; `about` describes the baseline."""
    head = ["videos", "number", *(f"success, {e.value}" for e in Extractor)]
    head += [f"changed by the {e.value}" for e in (Extractor.GROUNDING, Extractor.BASELINE)]
    rows = [[name, *_cells(members)] for name, members in _groups(extractions) if members and _stands_out(members)]
    episodes = len({e.episode for e in extractions})
    return markdown.section(
        "Outcomes by extractor",
        f"{len(extractions)} videos of {episodes} episodes, each executed through its true track, through that of the "
        "grounding, and through that of the [inverse-dynamics baseline](grounding-evidence.md#learned-baseline) "
        f"({about}). "
        "Changed: the outcome differs from that of the true track. In brackets: 95 % bootstrap intervals over "
        "episodes. Of the faults the table has those under which the grounding changes outcomes (interval above 0).",
        f"![Outcomes that an extractor changes]({FIGURE})",
        markdown.table(head, rows),
    )


def _stands_out(members: Sequence[Extraction]) -> bool:
    """Return whether the videos have several faults or none, or the grounding changes outcomes under their fault."""
    kinds = {e.kind for e in members}
    return len(kinds) > 1 or kinds == {None} or changed(members, Extractor.GROUNDING).low > 0.0


def _cells(members: Sequence[Extraction]) -> Iterator[str]:
    yield str(len(members))
    for extractor in Extractor:
        yield f"{np.mean([e.success[extractor] for e in members]):.0%}"
    for extractor in (Extractor.GROUNDING, Extractor.BASELINE):
        share = changed(members, extractor)
        yield f"{share.value:.0%} [{100 * share.low:.0f}, {100 * share.high:.0f}]"


def draw(extractions: Sequence[Extraction]) -> "Figure":
    """Draw the share of changed outcomes by group of videos, with intervals."""
    groups = [(name, members) for name, members in _groups(extractions) if members]
    figure, axes = new_figure(7.5, 0.45 * len(groups) + 1.2)
    ax = axes[0][0]
    styles = ((Extractor.GROUNDING, -0.15, POSITION), (Extractor.BASELINE, 0.15, ROTATION))
    for extractor, shift, color in styles:
        for row, (_, members) in enumerate(groups):
            share = changed(members, extractor)
            label = extractor.value if row == 0 else None
            ax.plot([share.low, share.high], [row + shift] * 2, color=color, linewidth=1.8)
            ax.plot(share.value, row + shift, marker="o", color=color, markersize=5, linestyle="none", label=label)
    ax.set_yticks(range(len(groups)), [f"{name.strip('`').replace('_', ' ')} ({len(m)})" for name, m in groups])
    ax.invert_yaxis()
    ax.set_xlim(-0.02, 1.02)
    ax.set_xlabel("share of videos whose outcome the extractor changes, 95 % interval")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return figure
