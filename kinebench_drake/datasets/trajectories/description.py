"""JSON beside trajectories, which may hold anything."""

from collections.abc import Mapping
from pathlib import Path

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import read_json


def read_description(path: Path) -> Mapping[str, object]:
    """The object that a JSON file holds; empty where it holds something else.

    Raises:
        FileNotFoundError: there is no such file.
        InputError: it cannot be read as JSON.
    """
    try:
        return mapping(read_json(path))
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name} cannot be read as JSON ({cause(error)})") from None


def mapping(value: object) -> Mapping[str, object]:
    """The value if it is an object with keys, else one without any."""
    return value if isinstance(value, Mapping) else {}
