from collections.abc import Iterable
from pathlib import Path

import pytest
import torch
from torch import nn

from kinebench_drake.errors import UsageError
from training.loop import Batch, LossTerms, Schedule, optimise

STEPS = 8


def noise(start: int) -> Iterable[Batch]:
    return [{"image": torch.randn(2, 3, 4, 4)} for _ in range(start, STEPS)]


@pytest.mark.parametrize(("fixed_from", "met"), [(1.0, STEPS), (0.25, 2)])
def test_batch_normalisation_statistics_are_frozen_after_a_share_of_the_steps(
    tmp_path: Path, fixed_from: float, met: int
) -> None:
    network = nn.Sequential(nn.Conv2d(3, 2, 1), nn.BatchNorm2d(2))
    optimise(
        network,
        batches=noise,
        forward=lambda model, batch: model(batch["image"]),
        losses=lambda output, batch: LossTerms(total=output.float().square().mean(), reported={}),
        schedule=Schedule(steps=STEPS, learning_rate=1e-3, batch_size=1, fixed_from=fixed_from),
        identity={},
        folder=tmp_path,
        report=lambda line: None,
    )
    tracked = network[1].num_batches_tracked
    assert isinstance(tracked, torch.Tensor)
    assert int(tracked) == met


def test_a_training_resumed_from_its_checkpoint_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    def seeded(start: int) -> Iterable[Batch]:
        return [{"image": torch.randn(2, 3, generator=torch.Generator().manual_seed(k))} for k in range(start, STEPS)]

    def train(folder: Path, upto: int) -> dict[str, torch.Tensor]:
        torch.manual_seed(0)
        network = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Linear(4, 1))
        batches = seeded if upto == STEPS else (lambda start: list(seeded(start))[:upto])
        average = optimise(
            network,
            batches=batches,
            forward=lambda model, batch: model(batch["image"]),
            losses=lambda output, batch: LossTerms(total=output.float().square().mean(), reported={}),
            schedule=Schedule(steps=STEPS, learning_rate=1e-2, batch_size=2, warm_up_steps=2, checkpoint_every=3),
            identity={"name": "x", "tasks": ("a", "b")},
            folder=folder,
            report=lambda line: None,
        )
        return average.state_dict()

    (tmp_path / "stopped").mkdir()
    train(tmp_path / "stopped", 4)  # its last checkpoint is of three steps
    went_on = train(tmp_path / "stopped", STEPS)
    (tmp_path / "whole").mkdir()
    for name, values in train(tmp_path / "whole", STEPS).items():
        assert torch.equal(values, went_on[name]), name
    (tmp_path / "stopped" / "checkpoint.safetensors").write_bytes(b"no checkpoint")
    with pytest.raises(UsageError, match="remove it to begin anew"):
        train(tmp_path / "stopped", STEPS)
