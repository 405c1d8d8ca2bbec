"""Rewards in the process of a trainer: callables with the interfaces of TRL, Flow-Factory, cosmos-rl and RLinf.

None of these packages is imported: a class of theirs is recognized by its methods. All use one `Scorer`.
"""

import time
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.api.runs import PathName
from kinebench_drake.api.scorer import Score, Scorer
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError

Frames = NDArray[np.uint8]
REWARD_NAME = "executability"


def to_frames(clip: Any) -> Frames:
    """Return the frames (T, H, W, 3) uint8 RGB of a clip.

    Args:
        clip: array or tensor (T, H, W, 3), (T, 3, H, W) or (3, T, H, W), of bytes 0..255 or of numbers in 0..1 or,
            where one is negative, in -1..1; or a sequence of images, such as those of Pillow.

    Raises:
        InputError: it has another shape.
    """
    array = np.asarray(clip.detach().float().cpu() if hasattr(clip, "detach") else clip)
    if array.ndim == 0 or array.dtype == object:
        array = np.stack([np.asarray(image) for image in clip])
    if array.ndim == 4 and array.shape[3] != 3:
        axis = next((k for k in (1, 0) if array.shape[k] == 3), None)
        array = array if axis is None else np.moveaxis(array, axis, 3)
    if array.ndim != 4 or array.shape[3] != 3:
        raise InputError(f"a clip has the shape {array.shape}, expected (T, H, W, 3), (T, 3, H, W) or (3, T, H, W)")
    if np.issubdtype(array.dtype, np.floating) and array.max(initial=0.0) <= 1.0:
        low = -1.0 if array.min(initial=0.0) < 0.0 else 0.0
        array = (array - low) * (255.0 / (1.0 - low))
    return np.ascontiguousarray(np.clip(np.round(array), 0, 255).astype(np.uint8))


class ExecutabilityReward:
    """Reward of clips; also a reward function of TRL: `GRPOTrainer(reward_funcs=[reward])`.

    Example:
        reward = ExecutabilityReward(camera="camera.json", period_s=0.2)
        rewards = reward(completions=clips)
    """

    __name__ = REWARD_NAME

    def __init__(
        self,
        *,
        camera: Camera | PathName | None = None,
        period_s: float = 0.2,
        jobs: int = 1,
        weights: Mapping[str, float] | None = None,
        stride: int = 1,
        scorer: Scorer | None = None,
    ) -> None:
        """Create the reward; arguments are those of `Scorer`, or a `scorer` that is shared."""
        self._scorer = scorer or Scorer(jobs=jobs, weights=weights, camera=camera, stride=stride)
        self._camera = camera if scorer else None
        self._period_s = period_s

    def score(self, clips: Sequence[Any], first_frames: Sequence[Any] | None = None) -> list[Score]:
        """Score clips as `to_frames` takes them, each against the image with which it should begin."""
        options: dict[str, Any] = {"camera": self._camera, "period_s": self._period_s}
        if first_frames is None:
            return self._scorer.batch([to_frames(clip) for clip in clips], **options)
        images = [to_frames([image])[0] for image in first_frames]
        return [
            self._scorer(to_frames(clip), first_frame=image, **options)
            for clip, image in zip(clips, images, strict=True)
        ]

    def __call__(self, prompts: Any = None, completions: Any = None, videos: Any = None, **columns: Any) -> list[float]:
        """Return the rewards of the clips `completions` or `videos`; other columns of the data set have no effect."""
        clips = completions if videos is None else videos
        return [float(score.reward) for score in self.score([] if clips is None else clips)]


class _Model:
    """Part of a reward model of a framework."""

    options: Mapping[str, Any] = MappingProxyType({})
    """Arguments of `ExecutabilityReward`."""

    @cached_property
    def reward(self) -> ExecutabilityReward:
        """Reward behind the model, created with the first batch."""
        return ExecutabilityReward(**self.options)


class FlowFactoryReward(_Model):
    """Pointwise reward model of Flow-Factory: `class Reward(FlowFactoryReward, PointwiseRewardModel)`."""

    required_fields = ("prompt", "video", "condition_images")
    use_tensor_inputs = False

    def __call__(self, prompt: Sequence[str], video: Any = None, condition_images: Any = None, **others: Any) -> Any:
        """Return the rewards (batch,) of the videos, each with the first of its condition images as its first frame."""
        images = None if condition_images is None else [own[0] for own in condition_images]
        rewards = self.rewards([score.reward for score in self.reward.score(video, images)])
        return SimpleNamespace(rewards=rewards, extra_info={})

    def rewards(self, rewards: list[float]) -> list[float]:
        """Return the rewards of the samples."""
        return rewards


class FlowFactoryGroupReward(FlowFactoryReward):
    """Groupwise one, `class Reward(FlowFactoryGroupReward, GroupwiseRewardModel)`: ranks within the group, 0 to 1."""

    def rewards(self, rewards: list[float]) -> list[float]:
        """Return the share of the other samples of the group that are worse, ties as a half."""
        values = np.asarray(rewards)
        worse = (values[:, None] > values).sum(axis=1) + 0.5 * ((values[:, None] == values).sum(axis=1) - 1)
        return list(map(float, worse / max(len(values) - 1, 1)))


class CosmosReward(_Model):
    """Reward handler of cosmos-rl: `class Handler(CosmosReward, BaseRewardHandler)`, registered as its others are."""

    reward_name = REWARD_NAME
    NEEDS_LATENT_DECODER = True

    def set_up(self) -> None:
        """Do nothing: models are loaded with the first batch."""

    def calculate_reward(self, images: Any, metadata: Mapping[str, Any]) -> dict[str, Any]:
        """Return the scores of `images` (B, 3, T, H, W) in the form of cosmos-rl."""
        start = time.monotonic()
        scores = self.reward.score(list(images))
        return cosmos_result(scores, metadata, time.monotonic() - start)


def cosmos_result(scores: Sequence[Score], metadata: Mapping[str, Any], duration_s: float) -> dict[str, Any]:
    """Return scores in the form of cosmos-rl."""
    return {
        "scores": {REWARD_NAME: [score.reward for score in scores]},
        "input_info": metadata.get("input_info", {}),
        "duration": f"{duration_s:.2f}",
        "decoded_duration": metadata.get("decode_duration", "0.00"),
        "type": REWARD_NAME,
    }


class RlinfReward(_Model):
    """Reward model of RLinf: `class Reward(RlinfReward, BaseRewardModel)`, entered in its registry of reward models.

    An observation is a history of images: `main_images` (B, T, H, W, 3) or (B, T, 3, H, W).
    """

    def compute_reward(self, observations: Any) -> Any:
        """Return a tensor (B,) of rewards."""
        import torch

        clips = observations["main_images"] if isinstance(observations, Mapping) else observations
        return torch.tensor([score.reward for score in self.reward.score(list(clips))])

    def forward(self, input_data: Any, labels: Any = None) -> Any:
        """Refuse to be trained."""
        raise UsageError("the executability is measured, not trained")
