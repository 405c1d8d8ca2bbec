"""TODO."""

from kinebench_drake.suites.worldmodels.factory import create
from kinebench_drake.suites.worldmodels.simulated import SIMULATED
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import WorldModel


class LazyWorldModel:
    """The one world model of a process. To another process only its spec goes, where it is made anew."""

    def __init__(self, spec: str) -> None:
        """Make nothing yet.

        Args:
            spec: what the command line says; see docs/worldmodels.md.

        Raises:
            UsageError: an option is given twice.
        """
        self.spec = spec
        self.identity = parse(spec).identity
        self._model: WorldModel | None = None

    def __reduce__(self) -> tuple[type["LazyWorldModel"], tuple[str]]:
        return LazyWorldModel, (self.spec,)

    def get(self) -> WorldModel:
        """The world model.

        Raises:
            UsageError: no world model is named so.
            SetupError: something it needs is missing, such as a key.
        """
        if self._model is None:
            self._model = create(self.spec, SIMULATED)
        return self._model

    def close(self) -> None:
        """Let it go."""
        model, self._model = self._model, None
        if model is not None:
            model.close()
