"""Tasks with fruits."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.geometry import Array
from kinebench_drake.suites.assets.containers import COMPARTMENTS
from kinebench_drake.suites.assets.fruits import FRUITS
from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, TaskVariant
from kinebench_drake.suites.tasks.layout import resting, undisturbed
from kinebench_drake.suites.tasks.state import STILL_M_S, State
from kinebench_drake.suites.tasks.task import Placement, SceneLayout, Task

GAP_M = 0.038
"""Least distance between the outlines of things, for the fingers to go down there."""
LEAN_RAD = 0.6
"""How far the way across a long fruit may be turned from y, so that the hand can close there."""
HAND_M = 0.13
"""Least distance along y from a fruit to the side of something tall, for the hand to come down."""
STAY_M = 0.05
"""How far a fruit that is to stay may be from where it lay."""
OTHERS = ("other_0", "other_1", "other_2")
"""The fruits of PickFruits that stay where they are."""
ORDER = ("first", "second", "third")
"""The fruits of StoreFruitsBox."""


def inside(state: State, name: str, container: str) -> Tensor:
    """Whether (N,) a fruit lies in a container: its middle within the rim's outline, its underside below the rim."""
    p = _within(state, name, container)
    half_x, half_y = 0.5 * state.size(container, "inner_x_m"), 0.5 * state.size(container, "inner_y_m")
    radius = torch.linalg.norm(p[:, :2], dim=-1)
    boxed = (p[:, 0].abs() <= half_x) & (p[:, 1].abs() <= half_y)
    level = torch.where(state.size(container, "round") > 0.5, radius <= half_x, boxed)
    return level & _sunk(state, name, container, p)


def _strayed(state: State, name: str) -> Tensor:
    """How far (N,) a thing is from where it lay [m]."""
    way: Tensor = torch.linalg.norm(state.position(name) - state.starts[name][:, :3, 3], dim=-1)
    return way


def _within(state: State, name: str, container: str) -> Tensor:
    """Where (N, 3) a fruit is in a container's frame [m]."""
    X = state.poses[container]
    offset = state.position(name) - state.position(container)
    return torch.einsum("nji,nj->ni", X[:, :3, :3], offset)


def _sunk(state: State, name: str, container: str, p: Tensor) -> Tensor:
    underside = p[:, 2] - state.size(name, "rest_m")
    return (p[:, 2] > 0.0) & (underside <= state.size(container, "rim_m"))


def _shuffled(models: Mapping[str, Model], names: Sequence[str]) -> list[str]:
    """The names in an order that the assets drawn decide: a scene that is not rebuilt keeps who plays what."""
    order = generator("roles", *(model.asset_id for model in models.values())).permutation(len(names))
    return [names[i] for i in order]


def _yaw(model: Model, rng: np.random.Generator) -> float:
    """Any direction for a round fruit; a long one lies about along x."""
    if model.size["oblong"] < 0.5:
        return float(rng.uniform(-np.pi, np.pi))
    return float(rng.uniform(-LEAN_RAD, LEAN_RAD) + np.pi * rng.integers(2))


def _strewn(
    rng: np.random.Generator, reaches_m: Sequence[float], taken: Sequence[tuple[Array, float]], low: Array, high: Array
) -> Array:
    """Points (K, 2) in a rectangle for things of some reach, clear of each other and of places (point, reach) taken.

    The gap asked for gives way a little with each round, so that it always ends.
    """
    gap = GAP_M
    while True:
        for _ in range(60):
            places = list(taken)
            for reach in reaches_m:
                tries = rng.uniform(low, high, size=(40, 2))
                free = np.ones(len(tries), dtype=bool)
                for point, other in places:
                    free &= np.linalg.norm(tries - point, axis=1) >= reach + other + gap
                if not free.any():
                    break
                places.append((tries[np.argmax(free)], reach))
            else:
                return np.stack([point for point, _ in places[len(taken) :]])
        gap *= 0.95


class PickFruits(Task):
    """Put the fruit that is named into the container.

    Description: four different fruits and a bowl, basket, tray or plate stand on the table; grasp the named fruit, put
    it into the container, let go, leave the others. With obstacles something upright stands between the two.
    Randomizations: which fruits, which of them is named, all places and directions, the container's side, kind and
    size, sizes and skins of the fruits.
    Success: the named fruit lies in the container (`in_container`), is still and let go; the other fruits are within
    5 cm of where they lay (`others_stay`); an obstacle stands where it stood.
    """

    card = TaskCard(
        id="PickFruits-v1",
        family="fruits",
        difficulty=Difficulty.MEDIUM,
        articulated_dof=0,
        axes="",
        contacts=1,
        variants=(TaskVariant.PLAIN, TaskVariant.OBSTACLES),
    )
    slots: ClassVar[Mapping[str, str]] = {**{name: f"fruit/{name}" for name in FRUITS}, "container": "container"}

    def slots_of(self, variant: TaskVariant) -> Mapping[str, str]:
        """With obstacles one more."""
        return {**self.slots, **({"obstacle": "obstacle/upright"} if variant is TaskVariant.OBSTACLES else {})}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """The container left or right, the fruits beside it, at least a finger's room between all of them."""
        names = _shuffled(models, FRUITS)[: 1 + len(OTHERS)]
        fruits = dict(zip(("target", *OTHERS), (models[name] for name in names), strict=True))
        container, side = models["container"], 1.0 if rng.random() < 0.5 else -1.0
        middle = np.array([rng.uniform(0.49, 0.58), side * rng.uniform(0.13, 0.16)])
        taken = [(middle, container.size["reach_m"])]
        placed = {}
        if variant is TaskVariant.OBSTACLES:
            obstacle = models["obstacle"]
            target = np.array([rng.uniform(0.45, 0.57), -side * rng.uniform(0.19, 0.22)])
            radius = obstacle.size["radius_m"]
            aside = target[1] + side * (HAND_M + radius + rng.uniform(0.0, 0.015))
            share = (aside - target[1]) / (middle[1] - target[1])
            post = np.array([target[0] + share * (middle[0] - target[0]) + rng.uniform(-0.01, 0.01), aside])
            taken += [(target, fruits["target"].size["reach_m"]), (post, radius)]
            placed["target"] = target
        rest = [name for name in fruits if name not in placed]
        ends = np.sort([-side * 0.225, side * 0.10])
        points = _strewn(
            rng,
            [fruits[name].size["reach_m"] for name in rest],
            taken,
            np.array([0.41, ends[0]]),
            np.array([0.67, ends[1]]),
        )
        placed |= dict(zip(rest, points, strict=True))
        placements = {
            name: Placement(
                model=model, X_BM=resting(placed[name][0], placed[name][1], model.size["rest_m"], _yaw(model, rng))
            )
            for name, model in fruits.items()
        }
        placements["container"] = Placement(
            model=container, X_BM=resting(middle[0], middle[1], 0.0, rng.uniform(-0.25, 0.25))
        )
        past = ""
        if variant is TaskVariant.OBSTACLES:
            placements["obstacle"] = Placement(
                model=obstacle, X_BM=resting(post[0], post[1], 0.0, rng.uniform(-np.pi, np.pi)), avoid=True
            )
            past = f", past the {obstacle.words} without knocking it over"
        return SceneLayout(
            placements=placements,
            prompt=(
                f"The robot arm picks up the {fruits['target'].words}, puts it into the {container.words}{past} and "
                "lets go. The other fruits stay where they are."
            ),
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        conditions = {
            "in_container": inside(state, "target", "container"),
            "others_stay": torch.stack([_strayed(state, name) <= STAY_M for name in OTHERS]).all(dim=0),
            "still": state.speeds["target"] <= STILL_M_S,
            "released": ~state.grasps("target"),
        }
        return conditions | (undisturbed(state, "obstacle") if "obstacle" in state.poses else {})

    def progress(self, state: State) -> Tensor:
        """Part of the way from the fruit's place to the middle of the container."""
        goal = state.position("container").clone()
        goal[:, 2] += state.size("container", "floor_m") + state.size("target", "rest_m")
        return state.approached("target", goal)


class StoreFruitsBox(Task):
    """Put apple, banana and orange into a crate's three compartments in the order that is told.

    Description: the fruits lie before an open crate with three compartments; the first one named goes into the left
    compartment as the camera sees it, the second into the middle one, the third into the right one.
    Randomizations: the order, all places and directions, sizes and skins of the fruits, kind and size of the crate.
    Success: each fruit lies in its compartment (`first_in_left`, `second_in_middle`, `third_in_right`), all are still
    and let go. The order in time is not asked for, only where each of them lies in the end.
    """

    card = TaskCard(
        id="StoreFruitsBox-v1",
        family="fruits",
        difficulty=Difficulty.HARD,
        articulated_dof=0,
        axes="",
        contacts=3,
        clips=3,
    )
    slots: ClassVar[Mapping[str, str]] = {
        "apple": "fruit/apple",
        "banana": "fruit/banana",
        "orange": "fruit/orange",
        "crate": "crate",
    }

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """The crate nearer to the robot, the fruits in a row before it."""
        names = _shuffled(models, ("apple", "banana", "orange"))
        fruits = dict(zip(ORDER, (models[name] for name in names), strict=True))
        x, y = rng.uniform(0.43, 0.46), rng.uniform(-0.03, 0.03)
        crate = resting(x, y, 0.0, rng.uniform(-0.08, 0.08))
        edge = x + 0.5 * models["crate"].size["outer_x_m"]
        row = rng.permutation([-0.15, 0.0, 0.15]) + rng.uniform(-0.02, 0.02, 3)
        placements = {}
        for (name, model), aside in zip(fruits.items(), row, strict=True):
            nearest = edge + 0.5 * model.size["length_m"] + 0.025
            at = rng.uniform(max(nearest, 0.59), 0.67)
            placements[name] = Placement(model=model, X_BM=resting(at, aside, model.size["rest_m"], _yaw(model, rng)))
        placements["crate"] = Placement(model=models["crate"], X_BM=crate)
        first, second, third = (model.words for model in fruits.values())
        return SceneLayout(
            placements=placements,
            prompt=(
                f"The robot arm puts the fruits into the crate one after the other, from left to right: first the "
                f"{first} into the left compartment, then the {second} into the middle one and last the {third} into "
                "the right one."
            ),
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        where = zip(ORDER, ("left", "middle", "right"), strict=True)
        still = torch.stack([state.speeds[name] <= STILL_M_S for name in ORDER])
        held = torch.stack([state.grasps(name) for name in ORDER])
        return {
            **{f"{name}_in_{place}": self._in_cell(state, name, i) for i, (name, place) in enumerate(where)},
            "still": still.all(dim=0),
            "released": ~held.any(dim=0),
        }

    def _in_cell(self, state: State, name: str, number: int) -> Tensor:
        p, pitch = _within(state, name, "crate"), state.size("crate", "pitch_m")
        beside = (p[:, 1] - (number - 0.5 * (COMPARTMENTS - 1)) * pitch).abs() <= 0.5 * pitch
        along = p[:, 0].abs() <= 0.5 * state.size("crate", "inner_x_m")
        return beside & along & _sunk(state, name, "crate", p)

    def progress(self, state: State) -> Tensor:
        """Mean over the fruits of the part of the way to the compartment."""
        parts = []
        for i, name in enumerate(ORDER):
            at = torch.zeros_like(state.position(name))
            at[:, 1] = (i - 0.5 * (COMPARTMENTS - 1)) * state.size("crate", "pitch_m")
            at[:, 2] = state.size("crate", "floor_m") + state.size(name, "rest_m")
            goal = state.position("crate") + torch.einsum("nij,nj->ni", state.poses["crate"][:, :3, :3], at)
            parts.append(state.approached(name, goal).clamp(0.0, 1.0))
        return torch.stack(parts).mean(dim=0)


TASKS = (PickFruits(), StoreFruitsBox())
"""Tasks of this family."""
