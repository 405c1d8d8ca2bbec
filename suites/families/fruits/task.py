"""Tasks with fruits."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from kinebench_drake.geometry import Array
from kinebench_drake.suites.families.fruits.assets import FRUITS
from kinebench_drake.suites.families.fruits.containers import COMPARTMENTS
from kinebench_drake.suites.families.task import Difficulty, Placement, SceneLayout, Task, TaskCard, TaskVariant
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import STILL_M_S, State, to_frame
from kinebench_drake.suites.seeding import generator

GAP_M = 0.038
"""Least distance between the outlines of objects, so that a finger fits between them."""
LEAN_RAD = 0.6
"""Greatest angle between y and the short axis of a long fruit, so that the hand can close across it."""
HAND_M = 0.13
"""Least distance along y from a fruit to the side of an obstacle, so that the hand can come down."""
STAY_M = 0.05
"""Greatest displacement of a fruit that is to stay."""
OTHERS = ("other_0", "other_1", "other_2")
"""Roles of the fruits of PickFruits that stay in place."""
ORDER = ("first", "second", "third")
"""Roles of the fruits of StoreFruitsBox, by compartment."""


def in_container(state: State, name: str, container: str) -> Tensor:
    """Return (N,) bool: True where a fruit's centre is within the rim's outline and its underside below the rim."""
    p = to_frame(state.poses[container], state.position(name))
    half_x = 0.5 * state.size(container, "inner_x_m")
    half_y = 0.5 * state.size(container, "inner_y_m")
    radius = torch.linalg.norm(p[:, :2], dim=-1)
    in_rectangle = (p[:, 0].abs() <= half_x) & (p[:, 1].abs() <= half_y)
    in_outline = torch.where(state.size(container, "round") > 0.5, radius <= half_x, in_rectangle)
    return in_outline & _below_rim(state, name, container, p)


def _below_rim(state: State, name: str, container: str, p: Tensor) -> Tensor:
    """Return (N,) bool: True where a fruit at `p` (N, 3) in a container's frame has its underside below the rim."""
    return (p[:, 2] > 0.0) & ((p[:, 2] - state.size(name, "rest_m")) <= state.size(container, "rim_m"))


def _shuffle(models: Mapping[str, AssetModel], names: Sequence[str]) -> list[str]:
    """Return the names in an order fixed by the assets, so that a scene keeps its roles when only poses are redrawn."""
    order = generator("roles", *(model.asset_id for model in models.values())).permutation(len(names))
    return [names[i] for i in order]


def _yaw(model: AssetModel, rng: np.random.Generator) -> float:
    """Draw the yaw of a fruit: any for a round one, roughly along x for a long one."""
    if model.size["oblong"] < 0.5:
        return float(rng.uniform(-np.pi, np.pi))
    return float(rng.uniform(-LEAN_RAD, LEAN_RAD) + np.pi * rng.integers(2))


def _scatter_apart(
    rng: np.random.Generator, radii_m: Sequence[float], occupied: Sequence[tuple[Array, float]], low: Array, high: Array
) -> Array:
    """Draw points (K, 2) in a rectangle for objects of given radii, apart from each other and from occupied discs.

    After every 60 attempts the required gap, `GAP_M` at first, shrinks by 5 %, so that the loop terminates.

    Args:
        occupied: centre (2,) and radius of each disc that is occupied already.
        low: lower corner (2,) of the rectangle.
        high: upper corner (2,) of the rectangle.
    """
    gap = GAP_M
    while True:
        for _ in range(60):
            discs = list(occupied)
            for radius in radii_m:
                candidates = rng.uniform(low, high, size=(40, 2))
                free = np.ones(len(candidates), dtype=bool)
                for point, other in discs:
                    free &= np.linalg.norm(candidates - point, axis=1) >= radius + other + gap
                if not free.any():
                    break
                discs.append((candidates[np.argmax(free)], radius))
            else:
                return np.stack([point for point, _ in discs[len(occupied) :]])
        gap *= 0.95


class PickFruits(Task):
    """Put the fruit that the prompt names into the container.

    Description: four different fruits and a bowl, basket, tray or plate stand on the table; grasp the named fruit, put
    it into the container and release it; leave the others. With obstacles, an upright object stands between the two.
    Randomizations: which fruits, which of them is named; positions and yaws of all objects; the container's side, kind
    and size; sizes and skins of the fruits.
    Success: the named fruit's centre is within the container's rim and its underside below it (`in_container`); it is
    slower than `STILL_M_S` (`still`) and not grasped (`released`); the other fruits are within `STAY_M` of their places
    (`others_stay`). An obstacle stands upright within `MOVED_M` of its place (`obstacle_upright`, `obstacle_in_place`).
    """

    card = TaskCard(
        id="PickFruits-v1",
        family="fruits",
        difficulty=Difficulty.MEDIUM,
        variants=(TaskVariant.PLAIN, TaskVariant.OBSTACLES),
    )
    slots: ClassVar[Mapping[str, str]] = {**{name: f"fruit/{name}" for name in FRUITS}, "container": "container"}

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place the container left or right and the fruits beside it, at least `GAP_M` apart."""
        names = _shuffle(models, FRUITS)[: 1 + len(OTHERS)]
        fruits = dict(zip(("target", *OTHERS), (models[name] for name in names), strict=True))
        container = models["container"]
        side = 1.0 if rng.random() < 0.5 else -1.0
        middle = np.array([rng.uniform(0.49, 0.58), side * rng.uniform(0.13, 0.16)])
        occupied = [(middle, container.size["reach_m"])]
        points = {}
        if variant is TaskVariant.OBSTACLES:
            obstacle = models["obstacle"]
            target = np.array([rng.uniform(0.45, 0.57), -side * rng.uniform(0.19, 0.22)])
            radius = obstacle.size["radius_m"]
            y = target[1] + side * (HAND_M + radius + rng.uniform(0.0, 0.015))
            share = (y - target[1]) / (middle[1] - target[1])
            post = np.array([target[0] + share * (middle[0] - target[0]) + rng.uniform(-0.01, 0.01), y])
            occupied += [(target, fruits["target"].size["reach_m"]), (post, radius)]
            points["target"] = target
        rest = [name for name in fruits if name not in points]
        y_ends = np.sort([-side * 0.225, side * 0.10])
        drawn = _scatter_apart(
            rng,
            [fruits[name].size["reach_m"] for name in rest],
            occupied,
            np.array([0.41, y_ends[0]]),
            np.array([0.67, y_ends[1]]),
        )
        points |= dict(zip(rest, drawn, strict=True))
        placements = {
            name: Placement.upright(model, (*points[name], model.size["rest_m"]), _yaw(model, rng))
            for name, model in fruits.items()
        }
        placements["container"] = Placement.upright(container, (*middle, 0.0), rng.uniform(-0.25, 0.25))
        past = ""
        if variant is TaskVariant.OBSTACLES:
            placements["obstacle"] = Placement.upright(obstacle, (*post, 0.0), rng.uniform(-np.pi, np.pi), avoid=True)
            past = f", past the {obstacle.words} without knocking it over"
        return SceneLayout(
            placements=placements,
            prompt=(
                f"The robot arm picks up the {fruits['target'].words}, puts it into the {container.words}{past} and "
                "lets go. The other fruits stay where they are."
            ),
        )

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        strayed = torch.stack([torch.linalg.norm(state.displacement(name), dim=-1) for name in OTHERS])
        return {
            "in_container": in_container(state, "target", "container"),
            "others_stay": (strayed <= STAY_M).all(dim=0),
            **state.release_conditions("target"),
        } | state.obstacle_conditions()

    def progress(self, state: State) -> Tensor:
        """Return the fraction of the fruit's way to the middle of the container."""
        goal = state.position("container").clone()
        goal[:, 2] += state.size("container", "floor_m") + state.size("target", "rest_m")
        return state.distance_progress("target", goal)


class StoreFruitsBox(Task):
    """Put apple, banana and orange into a crate's three compartments in the order of the prompt.

    Description: the fruits lie in front of an open crate with three compartments; the first one named goes into the
    left compartment as seen by the camera, the second into the middle one, the third into the right one.
    Randomizations: the order; positions and yaws of all objects; sizes and skins of the fruits, kind and size of the
    crate.
    Success: each fruit's centre is in its compartment and its underside below the rim (such as
    first_in_left); all are slower than `STILL_M_S` (`still`) and none is grasped (`released`).
    Only the final places count, not the order in time.
    """

    card = TaskCard(id="StoreFruitsBox-v1", family="fruits", difficulty=Difficulty.HARD, contacts=3, clips=3)
    slots: ClassVar[Mapping[str, str]] = {
        "apple": "fruit/apple",
        "banana": "fruit/banana",
        "orange": "fruit/orange",
        "crate": "crate",
    }

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place the crate near the robot and the fruits in a row beyond it."""
        names = _shuffle(models, ("apple", "banana", "orange"))
        fruits = dict(zip(ORDER, (models[name] for name in names), strict=True))
        x = rng.uniform(0.43, 0.46)
        y = rng.uniform(-0.03, 0.03)
        crate = Placement.upright(models["crate"], (x, y, 0.0), rng.uniform(-0.08, 0.08))
        edge = x + 0.5 * models["crate"].size["outer_x_m"]
        row_y = rng.permutation([-0.15, 0.0, 0.15]) + rng.uniform(-0.02, 0.02, 3)
        placements = {}
        for (name, model), fruit_y in zip(fruits.items(), row_y, strict=True):
            nearest = edge + 0.5 * model.size["length_m"] + 0.025
            p_BM = (rng.uniform(max(nearest, 0.59), 0.67), fruit_y, model.size["rest_m"])
            placements[name] = Placement.upright(model, p_BM, _yaw(model, rng))
        placements["crate"] = crate
        first, second, third = (model.words for model in fruits.values())
        return SceneLayout(
            placements=placements,
            prompt=(
                f"The robot arm puts the fruits into the crate one after the other, from left to right: first the "
                f"{first} into the left compartment, then the {second} into the middle one and last the {third} into "
                "the right one."
            ),
        )

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        places = zip(ORDER, ("left", "middle", "right"), strict=True)
        still = torch.stack([state.speeds[name] <= STILL_M_S for name in ORDER])
        grasped = torch.stack([state.grasps(name) for name in ORDER])
        return {
            **{f"{name}_in_{place}": self._in_compartment(state, name, i) for i, (name, place) in enumerate(places)},
            "still": still.all(dim=0),
            "released": ~grasped.any(dim=0),
        }

    def _in_compartment(self, state: State, name: str, number: int) -> Tensor:
        p = to_frame(state.poses["crate"], state.position(name))
        pitch = state.size("crate", "pitch_m")
        in_y = (p[:, 1] - (number - 0.5 * (COMPARTMENTS - 1)) * pitch).abs() <= 0.5 * pitch
        in_x = p[:, 0].abs() <= 0.5 * state.size("crate", "inner_x_m")
        return in_y & in_x & _below_rim(state, name, "crate", p)

    def progress(self, state: State) -> Tensor:
        """Return the mean over the fruits of the fraction of the way to the compartment."""
        fractions = []
        for i, name in enumerate(ORDER):
            p = torch.zeros_like(state.position(name))
            p[:, 1] = (i - 0.5 * (COMPARTMENTS - 1)) * state.size("crate", "pitch_m")
            p[:, 2] = state.size("crate", "floor_m") + state.size(name, "rest_m")
            goal = state.position("crate") + torch.einsum("nij,nj->ni", state.poses["crate"][:, :3, :3], p)
            fractions.append(state.distance_progress(name, goal).clamp(0.0, 1.0))
        return torch.stack(fractions).mean(dim=0)


TASKS = (PickFruits(), StoreFruitsBox())
"""Tasks of this family."""
