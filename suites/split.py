"""Division of assets and looks into halves for training (seen) and testing (unseen), by a fixed hash."""

from enum import Enum

from kinebench_drake.suites.seeding import share


class Pool(Enum):
    """Assets and looks that episodes draw from."""

    ALL = "all"
    SEEN = "seen"
    UNSEEN = "unseen"


def pool_ids(ids: tuple[str, ...], pool: Pool) -> tuple[str, ...]:
    """Return the ids of a pool: the half with the lower hashes is seen, so that both halves are equally large."""
    if pool is Pool.ALL:
        return ids
    ranked = sorted(ids, key=lambda name: share("split", name))
    training = set(ranked[: len(ranked) // 2])
    return tuple(name for name in ids if (name in training) == (pool is Pool.SEEN))
