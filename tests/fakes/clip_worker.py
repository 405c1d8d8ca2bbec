"""Worker of a reward server that needs no network: its reward is in the clip, and each clip is noted in a file."""

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

from kinebench_drake.api.scorer import Score


@dataclass(frozen=True)
class FakeClipWorker:
    notes: Path
    seconds: float = 0.02

    def __call__(self):
        return self.work

    def work(self, request):
        """Body: `crash` ends the process, `slow` takes a minute, else the reward in digits."""
        text = request.body.decode()
        if text == "crash":
            os._exit(1)
        time.sleep(60.0 if text == "slow" else self.seconds)
        with self.notes.open("a") as file:
            file.write(f"{text}\n")
        return replace(Score.failed("fake"), executability=float(text), reasons=())
