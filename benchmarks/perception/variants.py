"""Variants of the grounding pipeline, in which ground truth takes the place of estimates."""

from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.perception.clip import TruthClip
from kinebench_drake.grounding.pipeline import GroundingPipeline, PipelineResult
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.io.frames import Frames


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineVariant:
    """The shipped pipeline with ground truth as prior."""

    label: str
    """Name in tables."""
    mask: bool = False
    depth: bool = False
    start: bool = False
    """True if the pose in the first frame is a prior."""
    opening: bool = False
    """True if the gap between the fingers is a prior."""

    @property
    def needs_depth(self) -> bool:
        """True if the ground truth must hold depth and mask."""
        return self.mask or self.depth

    def ground(self, pipeline: GroundingPipeline, clip: TruthClip, frames: Frames) -> PipelineResult:
        """Ground frames with the priors of this variant."""
        exact = ExternalDepth(depth_m=clip.depth_m, exact=True) if self.depth and clip.depth_m is not None else None
        priors = Priors(
            mask=clip.mask if self.mask else None,
            depth=exact,
            initial_state=clip.initial_state if self.start else None,
            finger_width_m=clip.finger_width_m if self.opening else None,
        )
        return pipeline.ground(frames, clip.camera, clip.t_s[: len(frames)], priors)


VARIANTS: Mapping[str, PipelineVariant] = {
    "pixels": PipelineVariant(label="pixels only"),
    "true-mask": PipelineVariant(label="true mask", mask=True),
    "true-depth": PipelineVariant(label="true depth", depth=True),
    "true-mask-and-depth": PipelineVariant(label="true mask and depth", mask=True, depth=True),
    "true-start": PipelineVariant(label="true start pose", start=True),
    "true-opening": PipelineVariant(label="true finger opening", opening=True),
    "all-true": PipelineVariant(label="all of these", mask=True, depth=True, start=True, opening=True),
}
"""Variants by name."""
