import numpy as np
import pytest
import torch

from benchmarks.gpu import Device, figures, link_copies, measure, section
from kinebench_drake.errors import UsageError

COSTS = {"an image, ms": {Device.CPU: [40.0, 60.0], Device.GPU: [4.0, 5.0]}}


def test_ratios_compare_both_devices_within_the_same_turn(monkeypatch):
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "A GPU")
    text = section(COSTS)
    assert "with A GPU" in text
    assert "of 2 turns" in text
    assert "| an image, ms | 50.0 (40.0 to 60.0) | 4.50 (4.00 to 5.00) | 11.0 (10.0 to 12.0) |" in text
    assert figures(COSTS) == {"CPU: an image, ms": 50.0, "GPU: an image, ms": 4.5}


def test_the_cpu_run_hides_all_gpus():
    assert Device.CPU.environment == {"CUDA_VISIBLE_DEVICES": "", "KINEBENCH_DRAKE_RENDER": "cpu"}
    assert not Device.GPU.environment


def test_without_a_gpu_the_measurement_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match="find no NVIDIA GPU"):
        measure(tmp_path / "a.mp4", tmp_path, videos=16, turns=1, log=print)


def test_copies_are_hard_links(tmp_path):
    film = tmp_path / "film.mp4"
    film.write_bytes(np.random.default_rng(0).bytes(1000))
    names = [tmp_path / "in" / f"{k}.mp4" for k in range(3)]
    link_copies(film, names)
    assert {name.read_bytes() for name in names} == {film.read_bytes()}
    assert len({name.stat().st_ino for name in names}) == 1
