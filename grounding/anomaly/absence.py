"""Why a hand was not found in a frame: where it must be, by its arm in that frame, and whether it should be seen there.

The arm is followed by its links alone from the nearest frame in which the hand was found. The hand at its end may be
out of the picture, hidden by the arm, or too small. Only where it is none of these, and the image shows no hand, it is
gone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.registration.arm_fit import LAST_LINKS, ArmFit, ArmFitter, FollowedArm
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.image import GradientImage, GradientImages
from kinebench_drake.grounding.registration.solver import NEAREST_M
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.view import CLOSE_MARGIN, Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.panda.description import GRIPPER, RobotPart
from kinebench_drake.segments import segments

LEAST_PX = 600.0
"""Visible pixels of a hand from which on at least 95 % are found, in an image 384 px wide.

In 34 clean clips of two other simulators 99 % of the hands of 600 px and more are found, whatever their angle."""
_LOCATED = 0.45
"""Least share of the contours of the last links, and of the last one, on image edges of an arm that says where its hand
is.

In a clip of robosuite from which the hand was taken it is 0.48 and more, in one where a door hides the hand 0.37."""
_IN_PICTURE = 0.9
"""Least share of the hand inside the picture."""
_OUTSIDE = 0.3
"""Share of the hand inside the picture below which it is out of it."""
_UNHIDDEN = 0.6
"""Least share of the hand in the picture that the arm does not hide."""
_LIKE_A_HAND = 0.35
"""Share of the hand's contours on image edges, and of its cells in the mask, from which on a hand may be there."""
_RENDERED_PX = 64
"""Width of the crop in which hand and arm are rendered [px]."""


class Absence(Enum):
    """Why a hand was not found."""

    OUT = "out of the picture"
    CUT = "cut by the border"
    HIDDEN = "hidden by its own arm"
    SMALL = "too small"
    UNSURE = "not recognized"
    GONE = "absent"
    DOUBTFUL = "found, but not trusted"


def list_lost(tracked: NDArray[np.bool_], absences: Sequence[Absence | None]) -> list[Json]:
    """Return the stretches of frames that are not `tracked` (T,), each with its first and last frame and the reason."""
    reasons = [None if ok else absence or Absence.DOUBTFUL for ok, absence in zip(tracked, absences, strict=True)]
    spans: list[Json] = []
    first = 0
    for reason, own in groupby(reasons):
        last = first + len(list(own)) - 1
        if reason is not None:
            spans.append({"frame_start": first, "frame_end": last, "reason": reason.value})
        first = last + 1
    return spans


@dataclass(frozen=True, slots=True)
class AbsenceFinder:
    """Explanation of frames without a hand, of one pipeline."""

    model: ArmModel
    edges: EdgeMatcher

    def explain(
        self,
        frames: Frames,
        camera: Camera,
        places: Array | None,
        wide: Sequence[GripperView],
        poses: Sequence[FramePose | None],
        present: NDArray[np.bool_],
    ) -> tuple[Absence | None, ...]:
        """Return why the hand was not found in each of T frames; None where it is `present` (T,).

        Args:
            frames: (T, H, W, 3) RGB, of a steady camera.
            camera: that camera.
            places: (T, 3) places of a camera that moves, in its first frame [m].
            wide: (T,) views of whole images.
            poses: (T,) poses; those of present frames count.
            present: frames that show the hand.
        """
        reasons: list[Absence | None] = [None if is_present else Absence.UNSURE for is_present in present]
        fitter = ArmFitter(camera, self.model, self.edges, places)
        images = GradientImages(frames, camera)
        for run in segments(~present):
            before = _arms(poses, present, range(run.start - 1, max(run.start - 3, -1), -1))
            after = _arms(poses, present, range(run.stop, min(run.stop + 1, len(poses))))
            if not before:  # a hand that has not appeared yet is not missing
                continue
            path = [(run.start - 1 - k, arm.q) for k, arm in enumerate(before)][::-1]
            for i in range(run.start, run.stop):
                q = _interpolate(path[-1], (run.stop, after[0].q), i) if after else _extrapolate(path, i)
                last, q_last = path[-1]
                arm_last = replace(before[0], q=q_last)
                X_CP_last = fitter.at([last]).closed(arm_last)
                followed = (
                    fitter.at([i]).follow(arm_last, X_CP_last, images[last], images[i]) if last == i - 1 else None
                )
                arm, agreement = self._locate(fitter.at([i]), replace(before[0], q=q), images[i], followed)
                reason = self._judge(fitter.at([i]).closed(arm), camera, wide[i], images[i])
                is_sure = agreement >= _LOCATED
                reasons[i] = Absence.UNSURE if reason is Absence.GONE and not is_sure else reason
                if is_sure:
                    path.append((i, arm.q))
        return tuple(reasons)

    def _locate(
        self, fitter: ArmFitter, guess: ArmFit, image: GradientImage, followed: FollowedArm | None
    ) -> tuple[ArmFit, float]:
        """Return the arm that agrees most with the edges of an image, and its agreement.

        It is that of a guess, or of where the surface of the frame before went, or fitted to the links from there.
        """
        postures = [guess.q, fitter.refine_links(guess.q, image)]
        if followed is not None:
            points = followed.points.take(followed.points.part >= RobotPart.LINK0)
            postures += [followed.q, fitter.refine_links(followed.q, image, points)]
        arms = [replace(guess, q=q) for q in postures if q is not None]
        parts = LAST_LINKS, (RobotPart.LINK7,)  # what hides the hand, but is no part of the arm, hides the last link
        worse = [min(self.edges.agreements(image, fitter.closed(arm), parts)) for arm in arms]
        best = int(np.argmax(worse))
        return arms[best], worse[best]

    def _judge(self, X_CP: Array, camera: Camera, wide: GripperView, image: GradientImage) -> Absence:
        """Return why a hand at the end of its arm, at `X_CP` (PARTS, 4, 4) [m], is not found."""
        X_CH = X_CP[RobotPart.HAND]
        if X_CH[2, 3] <= NEAREST_M:
            return Absence.OUT
        crop = Crop.of_gripper(X_CH, CLOSE_MARGIN, _RENDERED_PX)
        rays = crop.rays().reshape(-1, 3)
        X_VP = invert(crop.X_CV) @ X_CP
        first = self.edges.caster.first_hits(X_VP, rays)[1].reshape(_RENDERED_PX, _RENDERED_PX)
        alone = X_VP.copy()
        alone[[p for p in RobotPart if p not in GRIPPER and p is not RobotPart.BACKGROUND], :3, 3] = [0.0, 0.0, -10.0]
        hand = self.edges.caster.first_hits(alone, rays)[1].reshape(first.shape) > 0
        inside = hand & crop.in_image(camera)
        share = inside.sum() / max(1, hand.sum())
        if share < _OUTSIDE:
            return Absence.OUT
        shown = inside & np.isin(first, GRIPPER)
        if shown.sum() < _UNHIDDEN * inside.sum():
            return Absence.HIDDEN
        if share < _IN_PICTURE:
            return Absence.CUT
        px = float(shown.sum()) * (camera.fx / crop.focal / camera.unit_px) ** 2
        if px < LEAST_PX:
            return Absence.SMALL
        mask = wide.to_frame(wide.gripper, camera)
        covered = crop.warp(mask.astype(np.uint8), camera, nearest=True)[shown].astype(bool)
        agreement = self.edges.agreement(image, X_CP, (RobotPart.HAND,))
        return Absence.GONE if max(agreement, float(covered.mean())) < _LIKE_A_HAND else Absence.UNSURE


def _arms(poses: Sequence[FramePose | None], present: NDArray[np.bool_], numbers: Sequence[int]) -> list[ArmFit]:
    """Return the arms of frames that show the hand, up to the first without one."""
    arms: list[ArmFit] = []
    for i in numbers:
        pose = poses[i]
        if not present[i] or pose is None or pose.arm is None or not pose.arm.agrees:
            break
        arms.append(pose.arm)
    return arms


def _interpolate(first: tuple[int, Array], second: tuple[int, Array], number: int) -> Array:
    """Return the posture (7,) of a frame on the line through those of two frames [rad]."""
    share = (number - first[0]) / (second[0] - first[0])
    return np.asarray(first[1] + share * (second[1] - first[1]))


def _extrapolate(path: Sequence[tuple[int, Array]], number: int) -> Array:
    """Return the posture (7,) to which a path of postures leads [rad]."""
    last, q = path[-1]
    return q if len(path) == 1 else _interpolate(path[-2], path[-1], min(number, last + 1))
