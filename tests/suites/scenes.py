"""Tasks of the benchmark as test parameters: one of each family in `make test`, all in `make test-all`."""

import pytest

from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.families.task import TaskVariant

REPRESENTATIVES = frozenset(
    {
        "CloseBox-v1",
        "CloseFaucet-v1",
        "LiftPegUpright-v1",
        "OpenDrawer-v1",
        "OpenLaptopEasy-v1",
        "PickFruits-v1",
        "StackCube-v1",
    }
)
"""One task of each family of assets and experts."""


EACH_TASK = [pytest.param(task, marks=() if task in REPRESENTATIVES else pytest.mark.exhaustive) for task in TASKS]
EACH_SCENE = [
    pytest.param(
        (task, variant),
        id=f"{task}-{variant.value}",
        marks=()
        if task in REPRESENTATIVES and (variant is TaskVariant.PLAIN or task == "StackCube-v1")
        else pytest.mark.exhaustive,
    )
    for task, t in TASKS.items()
    for variant in t.card.variants
]
"""Every task in each of its variants."""
