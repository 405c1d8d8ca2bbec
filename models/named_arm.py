"""Arms by name: where their descriptions are, which limits their makers publish, how data sets call them."""

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType

from pydantic import BaseModel, ConfigDict

from kinebench_drake.errors import SetupError
from kinebench_drake.models.joint_limits import LimitTable

UNNAMED = "auto"
"""Name in the place of an arm that data or else the default determine."""


class NamedArm(BaseModel):
    """One arm of arms.toml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    types: tuple[str, ...]
    """Values of `robot_type` of LeRobot data sets, in lower case."""
    package: str = ""
    """Folder of site-packages that contains the description; empty for the arms of `panda.description`."""
    requirement: str = ""
    """Name of the package for pip."""
    file: str = ""
    """Description in that folder."""
    tool: str = ""
    """Link whose frame is G, or its pose in a link, as in `--tool`."""
    columns: tuple[str, ...] = ()
    """Names of the joints in data sets; empty if they are those of the description."""
    floor_m: float = 0.0
    """Height in B of what the arm stands on [m], the table where the user states none."""
    arms: tuple[str, ...] = ()
    """Names of the arms of a pair, left first; empty for one arm."""
    source: str = ""
    """Sources of description and limits."""
    limits: LimitTable = LimitTable()
    """Limits that replace those of the description."""

    def path(self) -> Path:
        """Return the description in the installed package, which is not imported.

        Raises:
            SetupError: it is not installed, or does not contain the description.
        """
        name = re.split(r"[^\w-]", self.requirement)[0]
        try:
            path = Path(str(distribution(name).locate_file(self.package))) / self.file
        except PackageNotFoundError:
            path = Path()
        if not path.is_file():
            raise SetupError(f"{self.title} is described in {self.requirement}; pip install '{self.requirement}'")
        return path


@cache
def named_arms() -> Mapping[str, NamedArm]:
    """Return the arms by name."""
    text = (files("kinebench_drake.models") / "arms.toml").read_text(encoding="utf-8")
    return MappingProxyType({name: NamedArm.model_validate(arm) for name, arm in tomllib.loads(text).items()})


def find_arm(robot_type: str) -> str | None:
    """Return the name of the arm that a data set calls `robot_type`; None if there is none."""
    return next((name for name, arm in named_arms().items() if robot_type.lower() in arm.types), None)
