import os
import sys
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake import cli
from kinebench_drake.io.container import write_video
from kinebench_drake.results.provenance import code_hash
from kinebench_drake.runs import audit, score
from kinebench_drake.runs import runner as run
from kinebench_drake.runs.config import ScoreConfig
from kinebench_drake.runs.resources import Resources

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from fake_tools import FakeTools  # noqa: E402  importable by name in worker processes, too


@pytest.fixture(autouse=True)
def _code_as_it_is_now():
    """The sources are looked at anew: whoever works on them while tests run fails no test that began later."""
    code_hash.cache_clear()


@pytest.fixture(autouse=True)
def _fake_tools_in_workers(monkeypatch):
    """Worker processes can import the fake analyzer, too, and the same package as the tests."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), str(HERE.parent.parent)]))


@pytest.fixture
def film(tmp_path):
    """Writes a small film that makes the fake analyzer do something."""

    def write(name, act=0, *, frames=8, side=96, fps=17):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        images = np.full((frames, side, side, 3), 90, dtype=np.uint8)
        for k, image in enumerate(images):
            image[side // 2 :, 4 * k : 4 * k + 20] = [30, 60 + 10 * (len(name) % 7), 200]
        images[:, :20, :20] = [40 * act, 0, 0]
        write_video(path, images, fps)
        return path

    return write


@pytest.fixture
def config(tmp_path):
    """A run over tmp_path/videos into tmp_path/out with the fake analyzer."""

    def make(**changes):
        return ScoreConfig(
            **{
                "source": tmp_path / "videos",
                "out": tmp_path / "out",
                "make_resources": FakeTools,
                "replays": None,
                **changes,
            }
        )

    return make


@pytest.fixture
def program(capfd, monkeypatch):
    """Runs the program in this process with the fake analyzer; returns exit status, standard output and error."""
    for config in (score.ScoreConfig, audit.AuditConfig):
        defaults = config.__init__.__kwdefaults__
        assert defaults["make_resources"] is Resources
        monkeypatch.setitem(defaults, "make_resources", FakeTools)

    monkeypatch.setattr(run, "_replay", lambda *_: None)  # needs Drake and seconds

    def call(*arguments):
        capfd.readouterr()
        with pytest.raises(SystemExit) as stop:
            cli.main([str(a) for a in arguments])
        out, err = capfd.readouterr()
        return stop.value.code, out, err

    return call
