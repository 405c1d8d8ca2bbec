"""LeRobot datasets, v2.x (a film an episode) and v3 (many episodes a film): the films of their episodes.

Task texts, frame rate and each episode's place come from the dataset's description; the camera's geometry from a
`camera.json` in the dataset, in its `meta/` (where `suite demos --format lerobot-v3` puts it) or at the films.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

from kinebench_drake.errors import InputError
from kinebench_drake.grounding.decoded import VideoPart
from kinebench_drake.inputs.sample import Sample, camera_of
from kinebench_drake.inputs.search import CAMERA_NAME, Search
from kinebench_drake.manifest import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.trajectories.dataset import film_place, is_lerobot, list_episodes, read_info
from kinebench_drake.trajectories.description import mapping

__all__ = ["is_lerobot", "list_lerobot"]


def list_lerobot(folder: Path, search: Search) -> list[Sample]:
    """The episodes of a dataset, one camera of each.

    Raises:
        InputError: the dataset cannot be used, or it is not said which of its cameras to take.
        UsageError: a camera.json is unusable.
    """
    info = read_info(folder)
    features = mapping(info["features"])
    cameras = list(_cameras(features))
    if not cameras:
        expected = "expected a feature of dtype video or image (`audit` reads its trajectories)"
        raise InputError(f"the LeRobot dataset has no video, {expected}")
    key = search.choose(cameras, "the dataset")
    in_parquet = mapping(features[key]).get("dtype") == "image"
    search.cameras.settle(folder, folder / "meta" / CAMERA_NAME)
    samples = []
    for episode in list_episodes(folder, info, key):
        problem, path, part = None, episode.data, VideoPart(key=key, episode=episode.number, frames=episode.length)
        if not in_parquet:
            try:
                place = film_place(folder, info, episode, key)
                # A film of its own may be longer than the table; of a shared one all frames must be there.
                told = None if place.to_s is None else episode.length
                path, part = place.path, VideoPart(from_s=place.from_s, to_s=place.to_s, frames=told)
            except InputError as error:
                problem = str(error)
        if problem is None and not path.is_file():
            problem = f"{path.relative_to(folder).as_posix()}: there is no such file"
        taken, source = camera_of(search.cameras.of(path.parent))
        samples.append(
            Sample(
                id=f"{folder.resolve().name}-episode_{episode.number:06d}",
                path=path,
                part=part,
                video=f"{search.name(path)}#episode_{episode.number:06d}",
                camera=taken,
                camera_source=source,
                camera_key=key,
                prompt=episode.tasks,
                dataset_period_s=_period_s(info),
                problem=problem,
            )
        )
    if not samples:
        raise InputError("the dataset holds no episode")
    return samples


def _cameras(features: Mapping[str, object]) -> Iterator[str]:
    """Features that hold colour pictures."""
    for name, feature in features.items():
        about = mapping(feature)
        told = {**mapping(about.get("info")), **mapping(about.get("video_info"))}
        depth = any(told.get(key) is True for key in ("video.is_depth_map", "is_depth_map"))
        if about.get("dtype") in ("video", "image") and not depth:
            yield name


def _period_s(info: Mapping[str, object]) -> float | None:
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float):
        return None
    return 1.0 / fps if 1.0 / MAX_PERIOD_S <= fps <= 1.0 / MIN_PERIOD_S else None
