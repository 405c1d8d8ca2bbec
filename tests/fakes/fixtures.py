"""Whole runs with fake grounding and fake kinematics: films, configurations, the program."""

from pathlib import Path

import numpy as np
import pytest

from kinebench_drake import cli
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.provenance import code_hash
from kinebench_drake.runs import runner
from kinebench_drake.runs.audit import AuditConfig
from kinebench_drake.runs.config import ScoreConfig
from kinebench_drake.runs.resources import Resources
from kinebench_drake.runs.score import score_videos
from tests.fakes.behavior import VARIABLE, Behavior, Fakes, Gate
from tests.fakes.resources import FakeResources

ROOT = Path(__file__).parents[2]


@pytest.fixture
def fakes(tmp_path_factory, monkeypatch):
    """What the fake grounding does with films; worker processes import it and the package from this checkout."""
    code_hash.cache_clear()  # whoever edits the sources while tests run fails no test that begins later
    folder = tmp_path_factory.mktemp("fakes")
    monkeypatch.setenv(VARIABLE, str(folder))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return Fakes(folder)


@pytest.fixture
def film(tmp_path, fakes):
    """Writes a small film, with which the fake grounding does what `behavior` says (`Behavior`)."""
    numbers = {}

    def write(name, *, frames=8, side=96, fps=17, **behavior):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        images = np.full((frames, side, side, 3), 90, dtype=np.uint8)
        number = numbers.setdefault(name, len(numbers))
        color = [40 + 60 * (number >> shift & 3) for shift in (0, 2, 4)]  # of up to 64 films each has its own
        for k, image in enumerate(images):
            image[side // 2 :, 4 * k : 4 * k + 20] = color
        write_video(path, images, fps)
        fakes.prepare(read_video(path).frames, Behavior(**behavior))
        return path

    return write


@pytest.fixture
def gate(tmp_path_factory):
    """A gate at which films may wait."""
    return Gate(tmp_path_factory.mktemp("gate") / "gate")


@pytest.fixture
def config(tmp_path, fakes):
    """A run over tmp_path/videos into tmp_path/out with the fakes."""

    def make(**changes):
        folders = {"source": tmp_path / "videos", "out": tmp_path / "out"}
        return ScoreConfig(**{**folders, "make_resources": FakeResources, "replays": None, **changes})

    return make


@pytest.fixture
def grounded(config, fakes):
    """Scores and returns the number of videos that were grounded."""

    def run(**changes):
        fakes.take_calls()
        score_videos(config(**changes))
        return len(fakes.take_calls())

    return run


@pytest.fixture
def program(capfd, fakes, monkeypatch):
    """Runs the program in this process with the fakes; returns exit status, standard output and error."""
    for config in (ScoreConfig, AuditConfig):
        defaults = config.__init__.__kwdefaults__
        assert defaults["make_resources"] is Resources
        monkeypatch.setitem(defaults, "make_resources", FakeResources)
    monkeypatch.setattr(runner, "replay_samples", lambda *_: None)  # needs Drake and seconds

    def call(*arguments):
        capfd.readouterr()
        with pytest.raises(SystemExit) as stop:
            cli.main([str(a) for a in arguments])
        out, err = capfd.readouterr()
        return stop.value.code, out, err

    return call


@pytest.fixture
def refusal(program):
    """Runs the program with arguments that it refuses in one line, and returns the line."""

    def call(*arguments):
        code, out, err = program(*arguments)
        assert (code, out) == (2, "")
        assert len(err.splitlines()) == 1, err
        return err

    return call
