from collections.abc import Iterable
from pathlib import Path

import pytest
import torch
from torch import nn

from kinebench_drake.grounding.training.loop import Batch, Schedule, Terms, optimise

STEPS = 8


def noise(start: int) -> Iterable[Batch]:
    return [{"image": torch.randn(2, 3, 4, 4)} for _ in range(start, STEPS)]


@pytest.mark.parametrize(("fixed_from", "met"), [(1.0, STEPS), (0.25, 2)])
def test_batch_normalisation_keeps_its_statistics_from_a_part_of_the_steps_on(
    tmp_path: Path, fixed_from: float, met: int
) -> None:
    network = nn.Sequential(nn.Conv2d(3, 2, 1), nn.BatchNorm2d(2))
    optimise(
        network,
        batches=noise,
        forward=lambda model, batch: model(batch["image"]),
        losses=lambda output, batch: Terms(total=output.float().square().mean(), shown={}),
        schedule=Schedule(steps=STEPS, learning_rate=1e-3, batch_size=1, fixed_from=fixed_from),
        identity={},
        folder=tmp_path,
        report=lambda line: None,
    )
    tracked = network[1].num_batches_tracked
    assert isinstance(tracked, torch.Tensor)
    assert int(tracked) == met
