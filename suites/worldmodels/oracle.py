"""The expert as a world model: what it would do from the present state on, rendered. It tells how far the rest can get.

With a fault its videos are made worse by a known amount, to see that success falls with it.
"""

from pathlib import Path

from kinebench_drake.errors import InputError
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.faults.fault import FaultGrade
from kinebench_drake.suites.worldmodels.oracle_renderer import OracleRenderer
from kinebench_drake.suites.worldmodels.privileged import State, TrueTrack
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError


class OracleModel:
    """See the module. It is told the true state before each request (`see`)."""

    def __init__(self, name: str = "oracle", fault: FaultGrade | None = None, *, tells: bool = False) -> None:
        """Prepare.

        Args:
            name: how results call it.
            fault: what to plant into the first clip of each episode.
            tells: whether it tells the true track of its clips, so that none has to be read from the pixels.
        """
        self.name = name
        self._fault, self._tells = fault, tells
        self._private = OracleRenderer()

    def see(self, episode: Episode, state: State) -> None:
        """See `Privileged`."""
        self._private.see(episode, state)

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`."""
        fault = self._fault if request.round == 0 else None
        try:
            return self._private.write_clip(find_expert(request.task), request, out, fault)
        except WorldModelError:
            raise
        except InputError as error:
            raise WorldModelError(str(error)) from None

    def true_track(self) -> TrueTrack | None:
        """See `Telling`."""
        return self._private.true_track if self._tells else None

    def close(self) -> None:
        """See `WorldModel`."""
        self._private.close()
