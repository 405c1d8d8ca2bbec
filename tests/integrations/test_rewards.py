"""Rewards with the interfaces of trainers, as these publish them; none of them is installed here."""

from abc import ABC, abstractmethod
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

from kinebench_drake.api.scorer import Score
from kinebench_drake.errors import InputError
from kinebench_drake.integrations.rewards import (
    CosmosReward,
    ExecutabilityReward,
    FlowFactoryGroupReward,
    FlowFactoryReward,
    RlinfReward,
    to_frames,
)

CLIPS = np.stack([np.full((5, 8, 6, 3), level, np.uint8) for level in (51, 204, 102)])
REWARDS = [0.2, 0.8, 0.4]


class FakeScorer:
    """Reward: the mean grey level of the clip; 0 if it begins with another image."""

    def __call__(self, frames, *, camera=None, period_s, first_frame=None):
        assert frames.dtype == np.uint8
        assert (camera, period_s, frames.shape) == ("benchmark", 0.1, (5, 8, 6, 3))
        fits = first_frame is None or (first_frame == frames[0]).all()
        return Score(
            executable=None, feasible=None, reasons=(), numbers={}, terms={}, executability=fits * frames.mean() / 255.0
        )

    def batch(self, clips, **options):
        return [self(frames, **options) for frames in clips]


OPTIONS = {"scorer": FakeScorer(), "camera": "benchmark", "period_s": 0.1}


def test_frames_are_read_from_every_layout_and_range():
    clip = np.random.default_rng(0).integers(256, size=(5, 8, 6, 3), dtype=np.uint8)
    unit = clip / 255.0
    layouts = [
        *(clip, torch.tensor(clip), unit.astype(np.float32), clip.astype(np.float64)),
        *(clip.transpose(0, 3, 1, 2), torch.tensor(2.0 * unit - 1.0).permute(3, 0, 1, 2)),
        [Image.fromarray(frame) for frame in clip],
    ]
    for layout in layouts:
        assert (to_frames(layout) == clip).all()
    for wrong in (np.zeros((5, 8, 6)), np.zeros((5, 4, 8, 6))):
        with pytest.raises(InputError, match="a clip has the shape"):
            to_frames(wrong)


def test_a_reward_function_of_trl_takes_columns_and_returns_floats():
    reward = ExecutabilityReward(**OPTIONS)
    assert reward.__name__ == "executability"
    rewards = reward(prompts=["a"] * 3, completions=list(CLIPS), completion_ids=[[1]] * 3, task=["b"] * 3)
    assert rewards == pytest.approx(REWARDS)
    assert all(type(value) is float for value in rewards)
    assert reward(prompts=["a"] * 3, completions=[""] * 3, videos=list(CLIPS)) == pytest.approx(REWARDS)


class PointwiseRewardModel(ABC):
    """As in Flow-Factory, `flow_factory/rewards/abc.py`."""

    def __init__(self, config, accelerator):
        self.config = config

    @abstractmethod
    def __call__(self, prompt, image=None, video=None, audio=None, condition_images=None, condition_videos=None): ...


def test_reward_models_of_flow_factory_are_pointwise_and_groupwise():
    class Pointwise(FlowFactoryReward, PointwiseRewardModel):
        options = OPTIONS

    class Groupwise(FlowFactoryGroupReward, PointwiseRewardModel):
        options = OPTIONS

    config = SimpleNamespace(batch_size=3)
    videos = [[Image.fromarray(frame) for frame in clip] for clip in CLIPS]
    prompts = ["a"] * 3
    point = Pointwise(config, SimpleNamespace(device="cpu"))
    assert point(prompt=prompts, video=videos).rewards == pytest.approx(REWARDS)
    first = [[videos[0][0]], [videos[0][0]], [videos[2][0]]]
    assert point(prompt=prompts, video=videos, condition_images=first).rewards == pytest.approx([0.2, 0.0, 0.4])
    group = Groupwise(config, SimpleNamespace(device="cpu"))
    assert group(prompt=prompts, video=videos, image=None).rewards == pytest.approx([0.0, 1.0, 0.5])
    assert group(prompt=prompts[:1], video=videos[:1]).rewards == [0.0]
    assert group(prompt=prompts[:2], video=[videos[0]] * 2).rewards == [0.5, 0.5]


class BaseRewardHandler:
    """As in cosmos-rl, `cosmos_rl_reward/handler/reward_base.py`."""

    def __init__(self, **kwargs):
        self.redis_manager = None

    def set_up(self):
        raise NotImplementedError

    def calculate_reward(self, images, metadata):
        raise NotImplementedError


def test_a_reward_handler_of_cosmos_rl_takes_a_batch_of_tensors():
    class Handler(CosmosReward, BaseRewardHandler):
        options = OPTIONS

    handler = Handler(model_path="", dtype=None, device="cpu")
    handler.set_up()
    images = torch.tensor(CLIPS).permute(0, 4, 1, 2, 3)  # (B, C, T, H, W)
    result = handler.calculate_reward(images, {"uuid": "a", "prompts": ["a"] * 3, "input_info": {"shape": 1}})
    assert result["scores"]["executability"] == pytest.approx(REWARDS)
    assert (result["type"], result["input_info"]) == ("executability", {"shape": 1})
    assert {"duration", "decoded_duration"} <= set(result)


class BaseRewardModel(torch.nn.Module, ABC):
    """As in RLinf, `rlinf/models/embodiment/reward/base_reward_model.py`."""

    def __init__(self, cfg):
        super().__init__()
        self.cfg = cfg

    @abstractmethod
    def forward(self, input_data, labels=None): ...

    @abstractmethod
    def compute_reward(self, observations): ...


def test_a_reward_model_of_rlinf_takes_observations():
    class Reward(RlinfReward, BaseRewardModel):
        options = OPTIONS

    model = Reward({"model_type": "executability"}).to("cpu").eval()
    rewards = model.compute_reward({"main_images": torch.tensor(CLIPS)})
    assert rewards.shape == (3,)
    assert rewards.tolist() == pytest.approx(REWARDS)
