"""Video samples and the result of a search for them."""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.io.video import WHOLE, VideoPart
from kinebench_drake.types import InitialState


class CameraSource(Enum):
    """Where a sample's camera comes from, in order of precedence."""

    GIVEN = "given"
    """By a caller from Python."""
    MANIFEST = "manifest"
    FOLDER = "folder"
    BENCHMARK = "benchmark"


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoSample:
    """One video to work on and what its owner says about it."""

    id: str
    """Unique, safe as a file name, contains the video's stem, or its dataset's name and its own in it."""
    path: Path
    """The file or frame folder that holds the video."""
    part: VideoPart = WHOLE
    """Which part of the file it is."""
    video: str
    """The video as results name it: relative to the named folder or manifest, a part of a file behind a #."""
    camera: Camera
    """The camera before it is scaled to the video's size."""
    camera_source: CameraSource
    camera_key: str | None = None
    """Name of the camera in its dataset; None where a file is one video."""
    task: str | None = None
    model: str | None = None
    seed: int | None = None
    prompt: str | None = None
    fps: float | None = None
    """Frames per second that the manifest tells, over what the file says [1/s]; None leaves it to the file."""
    frame_period_s: float | None = None
    """Task time between two frames [s] given by the manifest; None leaves it to the command line or the file."""
    dataset_period_s: float | None = None
    """Task time between two frames [s] by the dataset's description, over what the film says."""
    initial_state: InitialState | None = None
    """The robot in the first frame as the manifest tells it; None where it does not."""
    first_frame: Path | None = None
    """The picture that the video's maker was given to begin with; None where there is none."""
    problem: str | None = None
    """Why the sample cannot be read at all (a broken manifest line); None when it can be tried."""

    @property
    def is_part(self) -> bool:
        """Whether its file holds other videos, too."""
        return self.part != WHOLE


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoSamples:
    """All samples found, in a fixed order, and what the user should know about them."""

    samples: tuple[VideoSample, ...]
    warnings: tuple[str, ...] = ()


def camera_of(found: Camera | None) -> tuple[Camera, CameraSource]:
    """A folder's camera, else the benchmark's, and which it is."""
    return (benchmark_camera(), CameraSource.BENCHMARK) if found is None else (found, CameraSource.FOLDER)
