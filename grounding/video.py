"""Grounding of a video, the one way in: choose its camera, track gripper or flange, confirm the camera by the arm."""

from collections.abc import Sequence
from dataclasses import replace

from kinebench_drake.camera import Camera, CameraSource, benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.grounding.anomaly.camera_motion import find_cuts
from kinebench_drake.grounding.camera.choice import CameraChooser, PriorSource
from kinebench_drake.grounding.camera.evidence import CameraChoice
from kinebench_drake.grounding.camera.framing import FIRST_FRAME_ADVICE
from kinebench_drake.grounding.camera.watch import CameraWatch
from kinebench_drake.grounding.components import GroundingComponents
from kinebench_drake.grounding.panels.panel import Panel
from kinebench_drake.grounding.panels.split import Tile
from kinebench_drake.grounding.priors import NO_PRIORS, Clip, Priors
from kinebench_drake.grounding.video_result import GroundingResult
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import GripperKind

_LISTED_CUTS = 10
"""Most cuts that a message names."""


class Grounder:
    """Grounding of videos; one instance serves any number of them."""

    def __init__(self, parts: GroundingComponents | None = None, table_height_m: float = 0.0) -> None:
        """Ground with `parts`; None: the shipped networks.

        The height of the table top in the robot base frame [m] is `table_height_m` where none comes with the camera.
        """
        self._parts = parts or GroundingComponents()
        self._table_height_m = table_height_m

    def list_panels(self, frames: Frames, tiles: Sequence[Tile]) -> tuple[Panel, ...]:
        """Return the panels of tiled frames (T, H, W, 3) in reading order, with what each shows (`panels.split`).

        Raises:
            SetupError: weights or libraries are missing.
        """
        return self._parts.panels(frames, tiles)

    def ground(
        self,
        clip: Clip,
        camera: Camera | None = None,
        priors: PriorSource | Priors = NO_PRIORS,
        *,
        source: CameraSource = CameraSource.ARGUMENT,
        table_height_m: float | None = None,
        gripper: GripperKind = GripperKind.AUTO,
        trusts_camera: bool = False,
        stride: int = 1,
        watch: CameraWatch | None = None,
    ) -> GroundingResult:
        """Choose the camera of a video, ground the video, and confirm the camera by the arm of the track.

        Base-frame poses exist only where the camera is named and not contradicted, or confirmed.

        Args:
            clip: frames and their times.
            camera: the named camera; None: one known by name if the arm confirms it, else an estimated one, else none.
            priors: quantities that replace estimates, or their source.
            source: source of the named camera.
            table_height_m: height of the table top in the robot base frame that is stated with it [m]; None: none is.
            gripper: gripper of the robot.
            trusts_camera: True to take the camera, or without one the benchmark's, as exact, and whatever is seen.
            stride: every how many frames are measured in full.
            watch: spot checks of a named camera; None: it is checked.

        Raises:
            InputError: the priors do not fit the video.
            UnmeasurableError: the shape of the video does not fit the named camera, no gripper is seen, or the video
                consists of several clips.
            SetupError: weights or libraries are missing.
        """
        cuts = [] if trusts_camera else find_cuts(clip.frames)
        if cuts:
            places = f"frame{'s' if len(cuts) > 1 else ''} {', '.join(map(str, cuts[:_LISTED_CUTS]))}"
            raise UnmeasurableError(
                f"cut before {places}: several clips in one video; split it there and score each clip by itself"
            )
        run = CameraChooser(self._parts, clip, priors, gripper, self._table_height_m, stride, watch)
        if camera is None and not trusts_camera:
            result = run.ground_unnamed()
        else:
            choice = CameraChoice(
                camera=camera or benchmark_camera(),
                source=CameraSource.BENCHMARK if camera is None else source,
                table_height_m=table_height_m,
            )
            result = run.ground_trusted(choice) if trusts_camera else run.ground_named(choice)
        if not trusts_camera:
            result.require_pose()
        reason = result.choice.reason
        if reason is not None and clip.conditioning is None:
            result = replace(result, choice=replace(result.choice, reason=f"{reason}; {FIRST_FRAME_ADVICE}"))
        return result
