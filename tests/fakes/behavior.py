"""What the fake grounding does with each film: stated by the test that writes the film, read in every process."""

import fcntl
import hashlib
import os
import pickle
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

VARIABLE = "KINEBENCH_FAKES"
"""Environment variable with the folder of the behaviors."""


@dataclass(frozen=True, kw_only=True)
class Behavior:
    """What the fake grounding does with a film: by default it tracks a gripper, surely, that the arm can follow."""

    has_gripper: bool = True
    """False: the sample is unmeasurable."""
    is_sure: bool = True
    """False: every frame has a pose and none is tracked."""
    feasible: bool = True
    """False: the track lies out of the fake arm's reach."""
    vanishes: bool = False
    """True: the gripper vanishes for two frames, which is an anomaly."""
    raises: Exception | None = None
    """Error of the grounding."""
    kills_worker: bool = False
    """True: the process is killed over the film."""
    waits_for: "Gate | None" = None
    """Gate at which the grounding waits."""
    waits_in_overlay: "Gate | None" = None
    """Gate at which the drawing of the second frame of the overlay waits."""
    result: Mapping[str, object] = field(default_factory=dict)
    """Fields of the result that differ from those of the default behavior."""
    choice: Mapping[str, object] = field(default_factory=dict)
    """Likewise of the choice of the camera."""

    def act(self) -> None:
        """Wait, die, raise."""
        if self.waits_for is not None:
            self.waits_for.wait()
        if self.kills_worker:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.raises is not None:
            raise self.raises


@dataclass(frozen=True)
class Gate:
    """A gate that processes of this machine wait at: closed within `closed`, open ever after."""

    path: Path

    @contextmanager
    def closed(self) -> Iterator[None]:
        """Keep the gate closed; it opens with the end of the context, or of this process."""
        with self.path.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def wait(self) -> None:
        """Wait until the gate is open."""
        with self.path.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH)


@dataclass(frozen=True)
class Fakes:
    """Behaviors of films, and the calls of the grounding; both in files."""

    folder: Path

    @classmethod
    def of_environment(cls) -> "Fakes":
        """Return those that the test has prepared."""
        return cls(Path(os.environ[VARIABLE]))

    def prepare(self, frames: np.ndarray, behavior: Behavior) -> None:
        """Set what the grounding does with a film, which it recognizes by the first frame."""
        self._behavior_file(frames).write_bytes(pickle.dumps(behavior))

    def note_call(self) -> None:
        """Note a call of the grounding."""
        with (self.folder / "calls").open("a") as calls:
            calls.write(f"{os.getpid()}\n")

    def behavior(self, frames: np.ndarray) -> Behavior:
        """Return what to do with a film."""
        file = self._behavior_file(frames)
        return pickle.loads(file.read_bytes()) if file.exists() else Behavior()

    def take_calls(self) -> list[int]:
        """Return the process of each call since the last time, in their order."""
        file = self.folder / "calls"
        calls = list(map(int, file.read_text().split())) if file.exists() else []
        file.unlink(missing_ok=True)
        return calls

    def _behavior_file(self, frames: np.ndarray) -> Path:
        return self.folder / hashlib.sha256(np.ascontiguousarray(frames[0])).hexdigest()
