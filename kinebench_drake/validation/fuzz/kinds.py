"""What is fuzzed: kinds of input, valid ones to begin with, and who reads them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.validation.fuzz import answers, films, motions, readers, runs
from kinebench_drake.validation.fuzz.tree import Tree


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One kind of input."""

    name: str
    trees: Callable[[], Sequence[Tree]]
    """Valid inputs; the same every time."""
    read: Callable[[Path], None]
    """Reads one that was written to a folder; raises KinebenchError where it refuses."""
    weight: float = 1.0
    """How often it is drawn, as against others."""


KINDS = (
    Kind(name="film", trees=films.film_trees, read=readers.read_file, weight=3.0),
    Kind(name="frames", trees=films.frame_trees, read=readers.read_videos),
    Kind(name="manifest", trees=films.manifest_trees, read=readers.read_manifest, weight=2.0),
    Kind(name="camera", trees=films.camera_trees, read=readers.read_videos),
    Kind(name="video arrays", trees=films.array_trees, read=readers.read_file, weight=2.0),
    Kind(name="metadata", trees=films.metadata_trees, read=readers.read_videos),
    Kind(name="EWM, WorldArena", trees=films.layout_trees, read=readers.read_layouts),
    Kind(name="LeRobot video", trees=films.lerobot_trees, read=readers.read_videos, weight=2.0),
    Kind(name="masks, depth, poses", trees=films.given_trees, read=readers.read_given),
    Kind(name="trajectory npz", trees=motions.npz_trees, read=readers.read_trajectories, weight=2.0),
    Kind(name="trajectory csv", trees=motions.csv_trees, read=readers.read_trajectories, weight=2.0),
    Kind(name="ManiSkill", trees=motions.maniskill_trees, read=readers.read_trajectories, weight=2.0),
    Kind(name="LeRobot table", trees=motions.lerobot_trees, read=readers.read_trajectories, weight=2.0),
    Kind(name="tracks", trees=runs.result_trees, read=readers.audit_results),
    Kind(name="resume", trees=runs.result_trees, read=readers.resume),
    Kind(name="merge", trees=runs.shard_trees, read=readers.merge, weight=0.5),
    Kind(name="compare", trees=runs.suite_trees, read=readers.compare),
    Kind(name="compare, page", trees=runs.suite_trees, read=readers.compare_drawn, weight=0.02),
    Kind(name="reply with video", trees=answers.simple_trees, read=readers.ask_simple),
    Kind(name="reply with frames", trees=answers.predict_trees, read=readers.ask_predict),
    Kind(name="DashScope", trees=answers.dashscope_trees, read=readers.ask_dashscope),
    Kind(name="MiniMax", trees=answers.minimax_trees, read=readers.ask_minimax),
    Kind(name="video folder", trees=answers.folder_trees, read=readers.ask_folder),
)
