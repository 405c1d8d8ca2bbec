"""HDF5 files of videos: of one episode (ALOHA, RoboTwin) or of many (robomimic's demo_K, ManiSkill's traj_K).

ManiSkill's description beside its file tells task, seeds and the control frequency at which its frames were taken.
"""

import re
from pathlib import Path

from kinebench_drake.datasets.trajectories.maniskill import DEFAULT_RATE_HZ, list_maniskill
from kinebench_drake.datasets.trajectories.trajectory import TrajectorySample
from kinebench_drake.datasets.videos.sample import VideoSample, camera_of
from kinebench_drake.datasets.videos.search import Search
from kinebench_drake.io.hdf5 import list_hdf5_videos
from kinebench_drake.io.video import VideoPart

_EPISODE = re.compile(r"(?P<episode>(?:data/)?(?:demo|traj|episode)_\d+)/(?P<camera>.+)")


def list_hdf5(path: Path, search: Search) -> list[VideoSample]:
    """Every episode of a file, one camera of each.

    Raises:
        InputError: the file is damaged, holds no video, or it is not said which of its cameras to take.
    """
    episodes: dict[str, dict[str, str]] = {}
    for name in list_hdf5_videos(path):
        match = _EPISODE.fullmatch(name)
        episode, key = (match["episode"], match["camera"]) if match else ("", name)
        episodes.setdefault(episode, {})[key] = name
    key = search.choose(list(dict.fromkeys(key for found in episodes.values() for key in found)), path.name)
    told = _told(path, list(episodes))
    camera, source = camera_of(search.cameras.of(path.parent))
    samples = []
    for episode, found in episodes.items():
        about, part = told.get(episode), episode.rpartition("/")[2]
        samples.append(
            VideoSample(
                id=f"{path.stem}-{part}" if part else path.stem,
                path=path,
                part=VideoPart(key=found.get(key, key)),
                video=f"{path.name}#{part or key}",
                camera=camera,
                camera_source=source,
                camera_key=key,
                task=about.task if about else None,
                seed=about.seed if about else None,
                dataset_period_s=1.0 / (about.rate_hz or DEFAULT_RATE_HZ) if about else None,
                problem=None if key in found else f"{episode} has no video {key}, but {', '.join(found)}",
            )
        )
    return samples


def _told(path: Path, episodes: list[str]) -> dict[str, TrajectorySample]:
    """What ManiSkill's description tells of each of its trajectories."""
    if not any(episode.startswith("traj_") for episode in episodes):
        return {}
    return {str(sample.part): sample for sample in list_maniskill(path, path.name) if sample.problem is None}
