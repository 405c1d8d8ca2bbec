"""Video samples and the result of a search for them."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from kinebench_drake.camera import Camera, CameraSetting, CameraSource, benchmark_camera
from kinebench_drake.io.video import WHOLE, VideoPart
from kinebench_drake.track import InitialState


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoSample:
    """One video and its metadata."""

    id: str
    """Unique, safe as a file name; contains the stem of the file, or the name of the dataset and of its part."""
    path: Path
    """File or frame folder that holds the video."""
    part: VideoPart = WHOLE
    """Part of the file."""
    video: str
    """Name of the video in results: relative to the named folder or manifest, with `#` before a part of a file."""
    camera: Camera = field(default_factory=benchmark_camera)
    """Camera before scaling to the size of the video."""
    camera_source: CameraSource = CameraSource.BENCHMARK
    mirrored: bool = False
    """True if the frames are turned left-right before they are measured."""
    table_height_m: float | None = None
    """Height of the table top in the robot base frame by the camera's file [m]; None if it is not stated."""
    camera_key: str | None = None
    """Name of the camera in its dataset; None for a file with one video."""
    task: str | None = None
    model: str | None = None
    seed: int | None = None
    prompt: str | None = None
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
    problem: str | None = None
    """Reason why the sample cannot be read (a broken manifest line); None if it can be tried."""

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
