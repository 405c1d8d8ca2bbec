"""All perturbations by name, with the strengths at which they are measured.

The kinds are those of the paper's section 4.2 (gripper deformation, three levels of occlusion, contrast, motion blur,
noise), which gives no numbers, and the effects of video coding and of frame blending. Of the three strengths of a kind
the first is typical of a good video model, the second must be tolerated by the pipeline, and the third is beyond that;
occlusion must be tolerated at all three.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from kinebench_drake.grounding.evaluation.perturbation.degrade import (
    add_noise,
    blur_motion,
    code_h264,
    code_latent,
    fade,
    ghost,
)
from kinebench_drake.grounding.evaluation.perturbation.gripper import Masks, deform, occlude
from kinebench_drake.grounding.view import Frames


class PerturbationKind(Enum):
    """Kinds of perturbations."""

    DEFORMATION = "deformation"
    OCCLUSION = "occlusion"
    CONTRAST = "contrast"
    MOTION_BLUR = "motion-blur"
    NOISE = "noise"
    H264 = "h264"
    LATENT = "latent"
    GHOSTING = "ghosting"


@dataclass(frozen=True, slots=True, kw_only=True)
class Perturbation:
    """Kind and strength of a perturbation."""

    kind: PerturbationKind
    strength: float
    """Strength in the unit of the kind; 0 changes nothing."""

    @property
    def label(self) -> str:
        """Kind and strength as in tables."""
        return _ENTRIES[self.kind].label.format(self.strength)

    @property
    def is_required(self) -> bool:
        """True if the grounding is required to tolerate it."""
        return self.strength in _ENTRIES[self.kind].required


@dataclass(frozen=True, slots=True)
class _Entry:
    function: Callable[[Frames, Masks, np.random.Generator, float], tuple[Frames, Masks]]
    label: str
    strengths: tuple[float, ...]
    required: tuple[float, ...]


_ENTRIES: Mapping[PerturbationKind, _Entry] = {
    PerturbationKind.DEFORMATION: _Entry(deform, "deformation {:g} px", (2.0, 4.0, 8.0), (4.0,)),
    PerturbationKind.OCCLUSION: _Entry(occlude, "occlusion {:.0%}", (0.15, 0.30, 0.50), (0.15, 0.30, 0.50)),
    PerturbationKind.CONTRAST: _Entry(fade, "contrast -{:.0%}", (0.4, 0.6, 0.8), (0.6,)),
    PerturbationKind.MOTION_BLUR: _Entry(blur_motion, "motion blur {:g} px", (5.0, 10.0, 20.0), (10.0,)),
    PerturbationKind.NOISE: _Entry(add_noise, "noise {:g}/255", (10.0, 20.0, 40.0), (20.0,)),
    PerturbationKind.H264: _Entry(code_h264, "H.264 crf {:g}", (28.0, 35.0, 42.0), (35.0,)),
    PerturbationKind.LATENT: _Entry(code_latent, "latent 1:{:g}", (24.0, 48.0, 96.0), (48.0,)),
    PerturbationKind.GHOSTING: _Entry(ghost, "ghosting {:.0%}", (0.2, 0.35, 0.5), (0.35,)),
}


def ladder(kind: PerturbationKind) -> tuple[Perturbation, ...]:
    """Return a kind at its strengths, in increasing order."""
    return tuple(Perturbation(kind=kind, strength=s) for s in _ENTRIES[kind].strengths)


def perturb(perturbation: Perturbation, frames: Frames, masks: Masks, seed: int, id: str) -> tuple[Frames, Masks]:
    """Return the perturbed frames (T, H, W, 3) and masks (T, H, W) of the clip `id`.

    The pattern depends on clip, kind and seed, not on the strength.
    """
    rng = np.random.default_rng([seed, *perturbation.kind.value.encode(), *id.encode()])
    return _ENTRIES[perturbation.kind].function(frames, masks, rng, perturbation.strength)
