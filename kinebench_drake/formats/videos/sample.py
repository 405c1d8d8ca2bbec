"""Video samples: their metadata, the cameras of their folders, and the options and warnings of a search for them."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from kinebench_drake.camera import Camera, CameraSetting, CameraSource, benchmark_camera
from kinebench_drake.errors import InputError, count_noun
from kinebench_drake.formats.camerafile import CameraLookup
from kinebench_drake.formats.samples import Sample
from kinebench_drake.geometry import Array
from kinebench_drake.io.files import IMAGE_SUFFIXES
from kinebench_drake.io.images import side_files
from kinebench_drake.io.video import WHOLE, VideoPart
from kinebench_drake.track import InitialState


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoSample(Sample):
    """One video and its metadata."""

    part: VideoPart = WHOLE
    """Part of the file."""
    camera: Camera = field(default_factory=benchmark_camera)
    """Camera before scaling to the size of the video."""
    camera_source: CameraSource = CameraSource.BENCHMARK
    mirrored: bool = False
    """True if the frames are turned left-right before they are measured."""
    table_height_m: float | None = None
    """Height of the table top in the robot base frame by the camera's file [m]; None if it is not stated."""
    camera_key: str | None = None
    """Name of the camera in its dataset; None for a file with one video."""
    fps: float | None = None
    """Frames per second by the manifest, overriding the file [1/s]; None for the value of the file."""
    frame_period_s: float | None = None
    """Task time between two frames by the manifest [s]; None for that of the command line or the file."""
    dataset_period_s: float | None = None
    """Task time between two frames by the metadata of the dataset, overriding the file [s]."""
    initial_state: InitialState | None = None
    """State of the robot in the first frame by the manifest; None if unknown."""
    first_frame: Path | None = None
    """Conditioning image of the video model; None if there is none."""
    view: str | None = None
    """Panel of tiled frames by the manifest; None for that of the command line."""
    actions: Path | None = None
    """File of the actions that the video should show; None if none is named."""
    reference_X_BG: Array | None = field(default=None, compare=False, repr=False)
    """(T, 4, 4) TCP in the robot base frame by another extractor, NaN where it has none [m]; None: there is none."""

    def filmed_by(self, setting: CameraSetting | None, source: CameraSource) -> "VideoSample":
        """Return the sample with a named camera; unchanged if `setting` is None."""
        if setting is None:
            return self
        return replace(
            self,
            camera=setting.camera,
            camera_source=source,
            mirrored=setting.mirrored or self.mirrored,
            table_height_m=setting.table_height_m,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoSamples:
    """All samples of an input in a fixed order, with warnings for the user."""

    samples: tuple[VideoSample, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """Options and warnings of one search."""

    top: Path
    """Named folder, or folder of the named file."""
    cameras: CameraLookup
    camera_key: str | None
    """Camera to use in datasets with several cameras: its name or a part of it."""
    warnings: list[str] = field(default_factory=list)
    """Warnings for the user, appended by the formats."""

    def name(self, path: Path) -> str:
        """Return a path as named in results."""
        return self.top.resolve().name if path == self.top else path.relative_to(self.top).as_posix()

    def choose_camera(self, keys: Sequence[str], where: str) -> str:
        """Return the camera to use in a dataset, which messages call `where`: the one asked for, else the only one.

        Raises:
            InputError: several cameras and none is asked for, or the name matches none or several.
        """
        if not keys:
            raise InputError(f"{where} holds no video")
        wanted = self.camera_key
        if wanted is None:
            if len(keys) == 1:
                return keys[0]
            raise InputError(f"{where} has {len(keys)} cameras ({', '.join(keys)}): choose one with $camera_key NAME")
        parts = {key: key.replace(".", "/").split("/") for key in keys}
        matches = [key for key in keys if key == wanted] or [key for key in keys if wanted in parts[key]]
        if len(matches) != 1:
            fit = f"fits {', '.join(matches)}" if matches else "is none of its cameras"
            raise InputError(f"$camera_key {wanted} {fit}; {where} has {', '.join(keys)}")
        return matches[0]

    def part_sample(self, path: Path) -> VideoSample:
        """Return a sample of a file or frame folder without metadata, with the camera of its folder."""
        is_folder = path.is_dir()
        id = path.resolve().name if is_folder else path.stem
        if is_folder and (others := side_files(path)):
            self.warnings.append(
                f"{self.name(path)}: {count_noun(len(others), 'picture')} of depth or masks beside the frames ignored, "
                f"such as {others[0].name}"
            )
        sample = VideoSample(id=id, path=path, video=self.name(path))
        return sample.filmed_by(self.cameras.find(path if is_folder else path.parent), CameraSource.FOLDER)

    def sample(self, path: Path) -> VideoSample:
        """Return a sample of a video without metadata, with the camera of its folder and the image beside it."""
        return replace(self.part_sample(path), first_frame=image_beside(path))


def image_beside(path: Path) -> Path | None:
    """Return the image with the name of a video, the conditioning image by `suite export`; None if there is none."""
    if path.is_dir():
        return None
    candidates = (path.with_suffix(suffix) for suffix in sorted(IMAGE_SUFFIXES, reverse=True))
    return next((image for image in candidates if os.path.isfile(image)), None)  # false for a name that is too long
