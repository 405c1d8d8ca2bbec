from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.models.perception.network import DenseOutput, load_network
from training.crops import Shards
from training.layout import TrainedNetwork
from training.loop import Schedule
from training.train import TrainingConfig, likelier_half_turn, losses, train


def config(shards: Shards, out: Path) -> TrainingConfig:
    schedule = Schedule(
        steps=4, batch_size=2, learning_rate=1e-3, checkpoint_every=2, warm_up_steps=1,  # steps that show a lost state
    )  # fmt: skip
    return TrainingConfig(data=shards.folders, out=out, workers=0, schedule=schedule)


@pytest.mark.sapien
def test_training_the_arm_alone_gives_its_own_weights(shards: Shards, tmp_path: Path) -> None:
    weights = [
        train(replace(config(shards, tmp_path / network.value), network=network), lambda _: None)
        for network in (TrainedNetwork.ARM, TrainedNetwork.GRIPPER)
    ]
    assert [file.name for file in weights] == ["arm.safetensors", "gripper.safetensors"]
    of_arm, of_gripper = (load_file(file) for file in weights)
    assert any((of_arm[key] != of_gripper[key]).any() for key in of_arm)  # other crops of the same frames
    with torch.inference_mode():
        assert torch.isfinite(load_network(weights[1])(torch.rand(1, 3, 64, 64)).coordinates).all()


def test_training_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no rendered shards"):
        Shards([tmp_path])


def test_missing_and_damaged_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    with pytest.raises(SetupError, match="no such weights"):
        load_network(path)
    path.write_bytes(b"not safetensors at all")
    with pytest.raises(SetupError, match="not weights"):
        load_network(path)


def batch_of(part: RobotPart) -> dict[str, torch.Tensor]:
    return {
        "part": torch.full((1, 8, 8), int(part)),
        "coordinates": torch.zeros(1, 3, 8, 8),
        "log_depth": torch.zeros(1, 8, 8),
    }


def output_for(batch: dict[str, torch.Tensor], errors: tuple[float, float], log_scale: float) -> DenseOutput:
    """An output whose coordinates are off by one error where it takes cells for gripper, by another for arm."""
    h = batch["part"].shape[1]
    return DenseOutput(
        part_logits=torch.zeros(1, len(RobotPart), h, h),
        coordinates=torch.stack([batch["coordinates"] + error for error in errors], dim=1),
        coordinate_log_scale=torch.full((1, 2, h, h), log_scale),
        log_depth=batch["log_depth"].clone(),
        depth_log_scale=torch.zeros(1, h, h),
    )


def coordinate_loss(output: DenseOutput, batch: dict[str, torch.Tensor]) -> float:
    return float(losses(output, batch).reported["coordinates"])


def test_the_coordinate_loss_is_least_at_the_true_scale() -> None:
    batch = batch_of(RobotPart.HAND)
    scales = np.linspace(-4, 0, 41)
    values = [coordinate_loss(output_for(batch, (0.1, 0.1), float(s)), batch) for s in scales]
    assert scales[int(np.argmin(values))] == pytest.approx(np.log(0.1), abs=0.06)


@pytest.mark.parametrize(("part", "others"), [(RobotPart.LEFT_FINGER, (0.1, 9.0)), (RobotPart.LINK6, (9.0, 0.1))])
def test_gripper_and_arm_heads_are_penalised_on_their_own_parts_alone(
    part: RobotPart, others: tuple[float, float]
) -> None:
    batch = batch_of(part)
    right = coordinate_loss(output_for(batch, (0.1, 0.1), 0.0), batch)
    assert coordinate_loss(output_for(batch, others, 0.0), batch) == pytest.approx(right)
    assert coordinate_loss(output_for(batch, others[::-1], 0.0), batch) > 2 * right


def test_the_background_has_no_coordinate_loss() -> None:
    batch = batch_of(RobotPart.BACKGROUND)
    assert coordinate_loss(output_for(batch, (5.0, 5.0), 0.0), batch) == 0.0


@pytest.mark.sapien
def test_resuming_with_another_configuration_is_refused(shards: Shards, tmp_path: Path) -> None:
    first = config(shards, tmp_path)
    train(first, lambda _: None)
    with pytest.raises(UsageError, match="holds a training with"):
        train(replace(first, schedule=replace(first.schedule, seed=1)), lambda _: None)


def test_labels_after_half_a_turn_count_where_the_output_is_nearer_to_them() -> None:
    """Each crop by itself; arm and background stay."""
    part = torch.tensor([[[1, 2], [3, 4]]]).repeat(2, 1, 1)
    coordinates = torch.arange(12.0).reshape(1, 3, 2, 2).repeat(2, 1, 1, 1) / 10
    half_turn = torch.tensor([-1.0, -1.0, 1.0])[:, None, None]
    predicted = torch.stack([coordinates[0], coordinates[0] * half_turn])[:, None].repeat(1, 2, 1, 1, 1)
    output = DenseOutput(
        part_logits=torch.zeros(2, len(RobotPart), 2, 2),
        coordinates=predicted,
        coordinate_log_scale=torch.zeros(2, 2, 2, 2),
        log_depth=torch.zeros(2, 2, 2),
        depth_log_scale=torch.zeros(2, 2, 2),
    )
    likelier = likelier_half_turn(output, {"part": part, "coordinates": coordinates})
    assert likelier["part"].tolist() == [[[1, 2], [3, 4]], [[1, 3], [2, 4]]]
    assert torch.equal(likelier["coordinates"][0], coordinates[0])
    gripper = part[1] < 4
    assert torch.equal(likelier["coordinates"][1][:, gripper], (coordinates[1] * half_turn)[:, gripper])
    assert torch.equal(likelier["coordinates"][1][:, ~gripper], coordinates[1][:, ~gripper])
