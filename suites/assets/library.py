"""Library of all assets, by asset id such as "box/07"."""

from functools import lru_cache

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.assets import blocks, boxes, cabinets, containers, faucets, fruits, laptops, marks
from kinebench_drake.suites.assets.model import AssetMaker, AssetModel
from kinebench_drake.suites.seeding import generator

INSTANCES = 24
"""Number of instances of each kind."""

_FAMILIES = (blocks, boxes, cabinets, containers, faucets, fruits, laptops, marks)
KINDS: dict[str, AssetMaker] = {kind: make for family in _FAMILIES for kind, make in family.KINDS.items()}
"""Maker of each kind; kinds between which tasks distinguish have their own names, such as "fruit/apple"."""


def asset_ids(kind: str) -> tuple[str, ...]:
    """Return the ids of a kind's instances.

    Raises:
        UsageError: the kind is unknown.
    """
    if kind not in KINDS:
        raise UsageError(f"no kind of asset {kind!r}; there are {', '.join(KINDS)}")
    return tuple(f"{kind}/{i:02d}" for i in range(INSTANCES))


@lru_cache(maxsize=256)
def model(asset_id: str) -> AssetModel:
    """Make the asset with an id.

    Raises:
        UsageError: the id is unknown.
    """
    kind, _, number = asset_id.rpartition("/")
    ids = asset_ids(kind)
    if asset_id not in ids:
        raise UsageError(f"no asset {asset_id!r}; of {kind} there are {ids[0]} to {ids[-1]}")
    return KINDS[kind](asset_id, int(number), generator("asset", asset_id))
