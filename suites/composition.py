"""Complete description of an episode, from which its scene and first frame are reproducible."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.families.blocks import assets as blocks
from kinebench_drake.suites.families.boxes import assets as boxes
from kinebench_drake.suites.families.drawers import assets as cabinets
from kinebench_drake.suites.families.faucets import assets as faucets
from kinebench_drake.suites.families.fruits import assets as fruits
from kinebench_drake.suites.families.fruits import containers
from kinebench_drake.suites.families.laptops import assets as laptops
from kinebench_drake.suites.families.registry import find_task
from kinebench_drake.suites.families.task import SceneLayout, TaskVariant
from kinebench_drake.suites.scene.look import SORTS, look_ids
from kinebench_drake.suites.scene.model import AssetMaker, AssetModel
from kinebench_drake.suites.seeding import generator, share

_FAMILIES = (blocks, boxes, cabinets, containers, faucets, fruits, laptops)
KINDS: dict[str, AssetMaker] = {kind: make for family in _FAMILIES for kind, make in family.KINDS.items()}
"""Maker of each kind; kinds between which tasks distinguish have their own names, such as "fruit/apple"."""


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


def asset_ids(kind: str) -> tuple[str, ...]:
    """Return the ids of a kind's instances.

    Raises:
        UsageError: the kind is unknown.
    """
    if kind not in KINDS:
        raise UsageError(f"no kind of asset {kind!r}; there are {', '.join(KINDS)}")
    return tuple(f"{kind}/{i:02d}" for i in range(24))


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """Task, seed and all values drawn from them."""

    id: str
    """Safe as a file name, such as "StackCube-v1_s0003"."""
    task: str
    """Plain task id."""
    seed: int
    variant: TaskVariant
    assets: Mapping[str, str]
    """Asset id of each of the task's slots."""
    table: str
    """Id of the table's look."""
    background: str
    """Id of the look of wall and floor."""
    light: str
    """Id of the light."""
    camera: str
    """Name of the camera; there is one, "benchmark"."""
    prompt: str

    def models(self) -> dict[str, AssetModel]:
        """Return the asset of each slot."""
        return {slot: model(asset_id) for slot, asset_id in self.assets.items()}

    def layout(self) -> SceneLayout:
        """Return the initial layout of the scene."""
        return _layout(self.task, self.seed, self.variant, self.models())


def _layout(task: str, seed: int, variant: TaskVariant, models: Mapping[str, AssetModel]) -> SceneLayout:
    return find_task(task).layout(models, generator("layout", task, seed, variant.value), variant)


def episode_id(task: str, seed: int, pool: Pool, variant: TaskVariant) -> str:
    """Return the id of an episode, such as "StackCube-v1_s0003_unseen"."""
    suffix = "".join(f"_{v}" for v in (pool.value, variant.value) if v not in (Pool.ALL.value, TaskVariant.PLAIN.value))
    return f"{task}_s{seed:04d}{suffix}"


def compose(task: str, seed: int, *, pool: Pool = Pool.ALL, variant: TaskVariant = TaskVariant.PLAIN) -> Episode:
    """Compose the episode of a task and seed with assets and looks from a pool."""
    definition = find_task(task, variant)
    rng = generator("episode", task, seed, pool.value)
    looks = {sort: str(rng.choice(pool_ids(look_ids(sort), pool))) for sort in SORTS}
    assets = {
        slot: str(rng.choice(pool_ids(asset_ids(kind), pool))) for slot, kind in definition.slots_of(variant).items()
    }
    return Episode(
        id=episode_id(task, seed, pool, variant),
        task=task,
        seed=seed,
        variant=variant,
        assets=assets,
        **looks,
        camera="benchmark",
        prompt=_layout(task, seed, variant, {slot: model(a) for slot, a in assets.items()}).prompt,
    )
