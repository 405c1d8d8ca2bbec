"""Which assets and looks are seen in training and which are kept for testing, by a fixed hash."""

from enum import Enum

from kinebench_drake.suites.assets.library import asset_ids
from kinebench_drake.suites.assets.look import look_ids
from kinebench_drake.suites.seeding import share


class Pool(Enum):
    """Assets and looks to draw from."""

    ALL = "all"
    SEEN = "seen"
    UNSEEN = "unseen"


def _half(ids: tuple[str, ...], pool: Pool) -> tuple[str, ...]:
    """The ids of a pool: of each kind the half with the lower hashes is seen, so that both halves are equally large."""
    if pool is Pool.ALL:
        return ids
    ranked = sorted(ids, key=lambda name: share("split", name))
    seen = set(ranked[: len(ranked) // 2])
    return tuple(name for name in ids if (name in seen) == (pool is Pool.SEEN))


def pool_assets(kind: str, pool: Pool) -> tuple[str, ...]:
    """Asset ids of a kind in a pool."""
    return _half(asset_ids(kind), pool)


def pool_looks(sort: str, pool: Pool) -> tuple[str, ...]:
    """Ids of a sort of looks in a pool."""
    return _half(look_ids(sort), pool)
