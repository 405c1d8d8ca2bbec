"""Videos in HDF5 files: of one episode (ALOHA, RoboTwin) or of many (demo_K of robomimic, traj_K of ManiSkill).

The JSON file beside a ManiSkill file gives task, seeds and the control frequency, which is the frame rate.
"""

import re
from dataclasses import replace
from pathlib import Path

from kinebench_drake.formats.maniskill import list_maniskill
from kinebench_drake.formats.trajectories.trajectory import TrajectorySample
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.io.hdf5 import list_hdf5_videos
from kinebench_drake.io.video import VideoPart

_EPISODE = re.compile(r"(?P<episode>(?:data/)?(?:demo|traj|episode)_\d+)/(?P<camera>.+)")


def list_hdf5(path: Path, search: Search) -> list[VideoSample]:
    """List the episodes of a file, one camera of each."""
    episodes: dict[str, dict[str, str]] = {}
    for name in list_hdf5_videos(path):
        match = _EPISODE.fullmatch(name)
        episode, camera = (match["episode"], match["camera"]) if match else ("", name)
        episodes.setdefault(episode, {})[camera] = name
    key = search.choose_camera(list(dict.fromkeys(key for videos in episodes.values() for key in videos)), path.name)
    metadata = _maniskill_metadata(path, list(episodes))
    sample = search.part_sample(path)
    samples = []
    for episode, videos in episodes.items():
        about = metadata.get(episode)
        part = episode.rpartition("/")[2]
        samples.append(
            replace(
                sample,
                id=f"{path.stem}-{part}" if part else path.stem,
                part=VideoPart(key=videos.get(key, key)),
                video=f"{path.name}#{part or key}",
                camera_key=key,
                task=about.task if about else None,
                seed=about.seed if about else None,
                dataset_period_s=1.0 / about.rate_hz if about and about.rate_hz else None,
                problem=None if key in videos else f"{episode} has no video {key}, but {', '.join(videos)}",
            )
        )
    return samples


def _maniskill_metadata(path: Path, episodes: list[str]) -> dict[str, TrajectorySample]:
    """Return the metadata of ManiSkill's trajectories by their group; empty for other files."""
    if not any(episode.startswith("traj_") for episode in episodes):
        return {}
    return {str(sample.part): sample for sample in list_maniskill(path, path.name) if sample.problem is None}
