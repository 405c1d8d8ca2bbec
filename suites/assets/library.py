"""All instances of all kinds of things, by asset id such as "box/07"."""

from functools import lru_cache

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.assets import boxes, cabinets, containers, cubes, faucets, fruits, laptops, marks, pegs
from kinebench_drake.suites.assets.model import AssetKind, Model
from kinebench_drake.suites.seeding import generator

INSTANCES = 24
"""Instances of each kind."""

_FAMILIES = (boxes, cabinets, containers, cubes, faucets, fruits, laptops, marks, pegs)
KINDS: dict[str, AssetKind] = {kind.name: kind for family in _FAMILIES for kind in family.KINDS}
"""All kinds by name."""


def asset_ids(kind: str) -> tuple[str, ...]:
    """The ids of a kind's instances.

    Raises:
        UsageError: there is no such kind.
    """
    if kind not in KINDS:
        raise UsageError(f"no kind of asset {kind!r}; there are {', '.join(KINDS)}")
    return tuple(f"{kind}/{i:02d}" for i in range(INSTANCES))


@lru_cache(maxsize=256)
def model(asset_id: str) -> Model:
    """The instance of an id.

    Raises:
        UsageError: there is none.
    """
    kind, _, number = asset_id.rpartition("/")
    ids = asset_ids(kind)
    if asset_id not in ids:
        raise UsageError(f"no asset {asset_id!r}; of {kind} there are {ids[0]} to {ids[-1]}")
    return KINDS[kind].make(asset_id, int(number), generator("asset", asset_id))
