"""Overrides of grounding stages: where masks, depth and poses of other programs are read from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.grounding.overrides.depth import DepthPlugIn, read_depth
from kinebench_drake.grounding.overrides.files import array_files, errors_naming, pose_files, read_masks, read_poses
from kinebench_drake.grounding.priors import NO_PRIORS, Priors
from kinebench_drake.io.frames import Frames
from kinebench_drake.track import InitialState

TRUTH = "truth"
TRACKS = "tracks"
"""Subfolder of a demonstration folder, and of the output folder of another run."""
_POSE_PLACES = (TRUTH, TRACKS)


def find_entry(folder: Path, names: Sequence[str], places: Sequence[str] = (TRUTH,)) -> Path:
    """Find the file `NAME.npz` or `NAME.npy` or the folder `NAME/` of a video by its names, the preferred one first.

    Subfolders `places` precede the folder itself, which may hold the videos under the same names.

    Raises:
        InputError: there is none.
    """
    for name in names:
        for place in (*places, ""):
            for file in (folder / place / f"{name}.npz", folder / place / f"{name}.npy"):
                if file.is_file():
                    return file
            if (folder / place / name).is_dir():
                return folder / place / name
    expected = " or ".join(f"{name}.npz, {name}.npy, {name}/" for name in names)
    where = " and ".join(f"{place}/" for place in places)
    raise InputError(
        f"{folder.resolve().name} has nothing for this video: looked for {expected} in it and in its {where}"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Overrides:
    """Sources of masks, depth and poses named on the command line; picklable, unlike their content."""

    masks: Path | None = None
    """Folder of masks."""
    depth: str | None = None
    """Folder of depth, `moge:CHECKPOINT` or `module:Class`."""
    poses: Path | None = None
    """Folder of poses."""
    depth_exact: bool = False
    """True if the depth is accurate to a few millimetres."""

    def __post_init__(self) -> None:
        """Check that all sources exist.

        Raises:
            UsageError: one does not exist, or `depth_exact` is set without `depth`.
        """
        if self.depth_exact and self.depth is None:
            raise UsageError("$depth_exact says how good the depth of $depth is; give that as well")
        for name, folder in (("masks", self.masks), ("poses", self.poses)):
            if folder is not None and not folder.is_dir():
                raise UsageError(f"${name} {folder}: there is no such folder")
        if self._plug_in is not None:
            self._plug_in.check()

    @property
    def folders(self) -> dict[str, Path]:
        """Folders of the overrides by stage: their images are no videos."""
        depth = Path(self.depth) if self.depth is not None and Path(self.depth).is_dir() else None
        named = {"masks": self.masks, "depth": depth, "poses": self.poses}
        return {stage: folder for stage, folder in named.items() if folder is not None}

    @property
    def names(self) -> dict[str, str]:
        """Source of each replaced stage, for results: without absolute paths."""
        names = {stage: folder.resolve().name for stage, folder in self.folders.items()}
        if self._plug_in is not None:
            names["depth"] = self._plug_in.name
        return dict(sorted(names.items()))

    def files(self, video: Sequence[str]) -> list[Path]:
        """Return the files that `priors` reads for a video, in a fixed order; `video` as in `priors`."""
        files: list[Path] = []
        try:
            for stage, folder in self.folders.items():
                if stage == "poses":
                    files += pose_files(folder, find_entry(folder, video, _POSE_PLACES))
                else:
                    files += array_files(find_entry(folder, video))
        except InputError:
            return files  # the video becomes an error row, which is never reused
        return files if self._plug_in is None else [*files, *self._plug_in.files]

    def priors(self, video: Sequence[str], frames: Frames, camera: Camera, first: InitialState | None = None) -> Priors:
        """Read the priors of a video by its names, the preferred one first.

        Its frames (T, H, W, 3) and their camera, at their size, are the input of a plug-in; `first` is the state of the
        robot in the first one.

        Raises:
            InputError: a source has nothing for the video, does not fit it or is broken; the message names the stage.
            SetupError: the plug-in cannot be created.
        """
        priors = NO_PRIORS
        mask = None
        depth = None
        if self.masks is not None:
            with errors_naming("$masks"):
                mask = read_masks(find_entry(self.masks, video))
        if "depth" in self.folders:
            with errors_naming("$depth"):
                depth = read_depth(find_entry(self.folders["depth"], video), exact=self.depth_exact)
        if self.poses is not None:
            with errors_naming("$poses"):
                priors = read_poses(self.poses, find_entry(self.poses, video, _POSE_PLACES), len(frames))
        if self._plug_in is not None:
            depth = self._plug_in.estimate(frames, camera, exact=self.depth_exact)
        priors = replace(priors, initial_state=first, mask=mask, depth=depth)
        priors.check_shapes(*frames.shape[:3])
        return priors

    @property
    def _plug_in(self) -> DepthPlugIn | None:
        return None if self.depth is None or "depth" in self.folders else DepthPlugIn(self.depth)
