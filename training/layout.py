"""Random surroundings of a robot for training images, whatever renders them: surfaces, room, loose things, mounts."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, from_quaternion, make_pose, rotation_exp, rotation_z
from kinebench_drake.models.panda.description import HAND_LINK
from training.texture import random_photograph, random_texture
from training.viewpoint import ViewBounds

FAR_AWAY = np.array([0.0, 0.0, -50.0])
"""Position of hidden things [m]."""
_TABLE_HALF = (0.9, 1.2, 0.02)


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """Look of a surface."""

    colour: Array
    """(3,) RGB in 0..1."""
    texture: NDArray[np.uint8] | None = None
    """(H, W, 4) RGBA, in place of the colour."""
    roughness: float
    """Roughness, 0..1."""
    metallic: float | None = None
    """Share of a metal, 0..1; None keeps the renderer's."""
    specular: float | None = None
    """Specular reflection, 0..1; None keeps the renderer's."""


def random_surface(rng: np.random.Generator) -> Surface:
    """Return a textured, photographic, grey or coloured surface."""
    kind = rng.random()
    colour = np.ones(3)
    texture = None
    if kind < 0.45:
        texture = random_texture(rng)
    elif kind < 0.6:
        photograph = random_photograph(rng, 256)
        texture = np.dstack([photograph, np.full(photograph.shape[:2], 255, np.uint8)])
    elif kind < 0.75:  # white, grey and black things are frequent where robots work, and look like one
        colour = np.clip(rng.uniform(0, 1) + rng.normal(0, 0.02, 3), 0, 1)
    else:
        colour = rng.uniform(0, 1, 3)
    return Surface(
        colour=colour,
        texture=texture,
        roughness=float(rng.uniform(0.1, 1.0)),
        metallic=float(rng.choice([0.0, 0.0, 0.0, 0.7])),
        specular=float(rng.uniform(0, 0.8)),
    )


def _dark_surface(rng: np.random.Generator) -> Surface:
    return Surface(colour=rng.uniform(0.0, 0.25) * np.ones(3), roughness=float(rng.uniform(0.2, 1.0)))


def _grey_surface(rng: np.random.Generator) -> Surface:
    metallic = float(rng.choice([0.0, 0.5]))
    return Surface(colour=rng.uniform(0.2, 0.8) * np.ones(3), roughness=float(rng.uniform(0.2, 1.0)), metallic=metallic)


def random_paint(rng: np.random.Generator) -> Callable[[Array], Surface | None]:
    """Return the paint of a robot: a function of the colour (3,) of a piece as delivered; None keeps the piece.

    Robots are left as they are, tinted, painted in white to grey, in any colour or with textures.
    """
    kind = rng.random()
    tint = rng.uniform(0.7, 1.1, 3)
    grey = rng.uniform(0.25, 1.0)
    gloss = rng.uniform([0.1, 0.0], [1.0, 0.8])

    def paint(colour: Array) -> Surface | None:
        texture = None
        if kind < 0.3:
            return None
        if kind < 0.55:
            colour = colour * tint
        elif kind < 0.85:  # dark pieces stay darker than light ones in two thirds of these scenes
            shade = grey * (0.35 + 0.65 * colour.mean() if kind < 0.75 else 1.0)
            colour = shade * rng.uniform(0.93, 1.0, 3) + rng.normal(0, 0.03)
        elif kind < 0.95:
            colour = rng.uniform(0, 1, 3)
        else:
            texture = random_texture(rng)
        return Surface(
            colour=np.clip(colour, 0, 1), texture=texture, roughness=float(gloss[0]), specular=float(gloss[1])
        )

    return paint


def random_room(
    rng: np.random.Generator,
    table_z: float,
    add_box: Callable[[tuple[float, ...], tuple[float, ...]], object],
    *,
    table: bool = True,
) -> ViewBounds:
    """Add a table top at height `table_z` [m], floor, pedestal and sometimes walls; return where cameras may stand.

    Args:
        rng: source of sizes and places.
        table_z: height of the table [m].
        add_box: function of half extents and position [m] that adds a box.
        table: False where there is a table already.
    """
    lower = np.array([-3.0, -3.0, table_z + 0.03])
    upper = np.full(3, 3.0)
    if table:
        length = _TABLE_HALF[0] * rng.uniform(0.5, 1.0)
        width = _TABLE_HALF[1] * rng.uniform(0.5, 1.0)
        thickness = _TABLE_HALF[2]
        behind = float(rng.uniform(-0.5, 0.1)) if table_z == 0.0 else float(rng.uniform(0.1, 0.3))
        add_box((length, width, thickness), (behind + length, float(rng.normal(0, 0.2)), table_z - thickness))
    if table_z < 0.0 or rng.random() < 0.2:  # a pedestal or a mounting plate
        height = max(-table_z, 0.02) / 2
        half = rng.uniform(0.1, 0.22, 2)
        add_box((half[0], half[1], height), (float(rng.normal(-0.05, 0.03)), 0.0, -height))
    add_box((4, 4, 0.01), (0, 0, min(-0.4, -0.93 + rng.uniform(-0.1, 0.4))))
    if rng.random() < 0.5:
        lower[0] = rng.uniform(-2.5, -0.5)
        add_box((0.02, 4, 3), (float(lower[0]) - 0.1, 0, 1))
    if rng.random() < 0.4:
        side = float(rng.choice([-1, 1]))
        distance = float(rng.uniform(0.8, 2.5))
        add_box((3, 0.02, 3), (0, side * (distance + 0.1), 1))
        lower[1], upper[1] = (-distance, 3.0) if side < 0 else (-3.0, distance)
    if rng.random() < 0.3:
        upper[0] = rng.uniform(1.4, 2.8)
        add_box((0.02, 4, 3), (float(upper[0]) + 0.1, 0, 1))
    return ViewBounds(tuple(lower), tuple(upper))


class TrainedNetwork(Enum):
    """Network that frames are rendered for."""

    GRIPPER = "gripper"
    """Arm and Franka hand."""
    ROBOTIQ = "robotiq"
    """Arm and Robotiq 2F-85."""
    ARM = "arm"
    """The arm alone: most scenes show a gripper that is not Franka's."""


class ShownGripper(Enum):
    """Gripper that a random scene shows."""

    FRANKA = "franka"
    NONE = "none"
    OTHER = "other"
    """A random one, of boxes."""
    ROBOTIQ = "robotiq"


class SolidKind(IntEnum):
    """Shape of a loose thing."""

    SPHERE = 0
    CAPSULE = 1
    CYLINDER = 2
    BOX = 3


@dataclass(frozen=True, slots=True)
class Solid:
    """Primitive with half thickness `half[1]` and half length `half[0]` [m]."""

    kind: SolidKind
    half: tuple[float, float, float]


def random_solid(rng: np.random.Generator, half: float) -> Solid:
    """Return a random primitive with half thickness `half` [m]."""
    length = float(half * np.exp(rng.uniform(-0.7, 1.4)))
    kind = SolidKind(min(int(rng.integers(5)), SolidKind.BOX))
    height = float(half * np.exp(rng.uniform(-0.7, 1.0))) if kind is SolidKind.BOX else half
    return Solid(kind, (length, half, height))


def random_sizes(rng: np.random.Generator) -> list[float]:
    """Return the half thicknesses of loose things [m]; few are large."""
    return [float(rng.uniform(0.05, 0.15) if rng.random() < 0.12 else rng.uniform(0.01, 0.05)) for _ in range(12)]


def random_places(rng: np.random.Generator, halves: Sequence[float], X_BH: Array, table_z: float) -> Iterator[Array]:
    """Yield a pose (4, 4) in the base frame for each thing of half thickness `halves` [m].

    Things lie on the table, float near the gripper at `X_BH` (4, 4), where some hide parts of it, or are hidden.
    """
    middle = X_BH[:3, 3] + 0.06 * X_BH[:3, 2]
    for half in halves:
        position = FAR_AWAY
        kind = rng.random()
        if kind < 0.45:
            position = np.array([*rng.uniform([0.15, -0.6], [0.9, 0.6]), table_z + half])
        elif kind < 0.65:
            position = middle + rng.normal(0, 0.12, 3)
            position[2] = max(position[2], table_z + half)
        if np.linalg.norm(position - middle) < 0.09 + half:
            position = FAR_AWAY
        yield from_quaternion(rng.normal(size=4), position)


def random_grasp(rng: np.random.Generator) -> Array:
    """Return the pose X_HO (4, 4) of a thing between the fingers [m]."""
    return make_pose(np.eye(3), [0, 0, 0.1034 + rng.uniform(-0.02, 0.04)])


def random_finger(rng: np.random.Generator) -> float:
    """Return the opening of each finger of an empty gripper [m]: often fully open or closed."""
    return float(rng.choice([rng.uniform(0, 0.04), 0.04, 0.0], p=[0.7, 0.2, 0.1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """Box that moves with a link."""

    link: str
    half: tuple[float, ...]
    """(3,) half extents [m]."""
    X_LA: Array
    """(4, 4) pose of the box in the link frame [m]."""
    surface: Surface


def random_attachments(rng: np.random.Generator) -> list[Attachment]:
    """Return mounts and cameras on Franka's hand, cables along the arm, and pads on the fingers; often none."""
    attachments = _random_mount(rng) + _random_cable(rng)
    if rng.random() < 0.25:  # other pads or fingers over Franka's own
        surface = random_surface(rng)
        half = tuple(float(h) for h in rng.uniform([0.008, 0.003, 0.01], [0.014, 0.009, 0.03]))
        outward = rng.uniform(0.0, 0.008)
        for link, sign in (("panda_leftfinger", 1.0), ("panda_rightfinger", -1.0)):
            p_LA = [0.0, sign * (half[1] + outward), 0.054 - rng.uniform(-0.01, 0.6) * half[2]]
            attachments.append(_attach(link, half, p_LA, np.zeros(3), surface))
    return attachments


def random_gripper(rng: np.random.Generator) -> list[Attachment]:
    """Return a gripper that is not Franka's, of boxes: adapter, palm, up to three fingers; often mounts and a cable."""
    surface = _dark_surface(rng) if rng.random() < 0.6 else random_surface(rng)
    other = _dark_surface(rng) if rng.random() < 0.5 else random_surface(rng)
    R_HG = rotation_exp([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    up = np.array([0.0, 0.0, 1.0])
    gripper = list[Attachment]()
    top = 0.0

    def add(half: Array, p_GA: Array, R_GA: Array, look: Surface) -> None:
        X_HA = make_pose(R_HG @ R_GA, R_HG @ p_GA)
        gripper.append(Attachment(link=HAND_LINK, half=tuple(half.tolist()), X_LA=X_HA, surface=look))

    adapter = (rng.uniform(0.035, 0.048), rng.uniform(0.003, 0.02))
    palm = rng.uniform([0.025, 0.02], [0.06, 0.06])
    for (wide, high), look in ((adapter, other), (palm, surface)):
        half = np.array([wide, wide * rng.uniform(0.6, 1.0), high])
        for eighth in range(1 + (rng.random() < 0.6)):  # two boxes at 45 degrees are nearly round
            add(half, (top + high) * up, rotation_z(eighth * np.pi / 4), look)
        top += 2 * high
    count = int(rng.choice([1, 2, 3], p=[0.12, 0.73, 0.15]))
    spread = rng.uniform(0.0, 0.05)
    half = rng.uniform([0.005, 0.007, 0.02], [0.014, 0.018, 0.05])
    lean = rng.uniform(-0.2, 0.9)
    for k in range(count):
        R_GF = rotation_z(2 * np.pi * k / count)
        outward = R_GF[:, 0] * (count > 1)
        along = np.sin(lean) * outward + np.cos(lean) * up
        knuckle = spread * outward + top * up
        look = surface if rng.random() < 0.8 else other
        add(half, knuckle + half[2] * along, R_GF @ rotation_exp([0.0, lean, 0.0]), look)
        add(half, knuckle + half[2] * (2 * along + up), R_GF, look)
    return gripper + _random_mount(rng) + _random_bracket(rng) + _random_cable(rng)


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperLook:
    """How a gripper of known shape is mounted and painted."""

    X_HR: Array
    """(4, 4) pose of its mounting face in panda_hand [m]."""
    hand: Surface
    fingers: Surface
    knuckles: Surface
    attachments: list[Attachment]
    """Adapter, mounts, cameras and cables."""


def random_mounted(rng: np.random.Generator) -> GripperLook:
    """Return a random look of a gripper, turned against panda_hand by eighths of a turn, on an adapter of any height.

    Turns of half a turn more look alike, and are left out: networks could not tell them.
    """
    turn = np.pi / 4 * rng.integers(4) + rng.normal(0.0, np.deg2rad(2.0))
    height = float(rng.uniform(0.0, 0.022))
    adapter = _dark_surface(rng) if rng.random() < 0.5 else random_surface(rng)
    wide = float(rng.uniform(0.03, 0.04))
    attachments = [
        _attach(
            HAND_LINK, (wide, 0.7 * wide, height / 2), [0.0, 0.0, height / 2], np.array([0, 0, k * np.pi / 4]), adapter
        )
        for k in range(2)
    ]
    for add in (_random_mount, _random_bracket, _random_bracket, _random_cable, _random_cable):
        attachments += add(rng)
    kind = rng.random()
    if kind < 0.6:
        surfaces = [_dark_surface(rng), _dark_surface(rng), _grey_surface(rng)]
    elif kind < 0.8:
        surfaces = [_grey_surface(rng) for _ in range(3)]
    else:
        surfaces = [random_surface(rng) for _ in range(3)]
    return GripperLook(
        X_HR=make_pose(rotation_z(turn), [0.0, 0.0, height]),
        hand=surfaces[0],
        fingers=surfaces[1],
        knuckles=surfaces[0] if rng.random() < 0.3 else surfaces[2],
        attachments=attachments,
    )


def _attach(link: str, half: tuple[float, ...], p_LA: ArrayLike, turn: Array, surface: Surface) -> Attachment:
    return Attachment(link=link, half=half, X_LA=make_pose(rotation_exp(turn), p_LA), surface=surface)


def _random_mount(rng: np.random.Generator) -> list[Attachment]:
    """Return a camera and its mount: boxes before or behind the wide side of the hand; often none."""
    attachments = []
    if rng.random() < 0.35:
        side = float(rng.choice([-1.0, 1.0]))
        surface = random_surface(rng) if rng.random() < 0.4 else _dark_surface(rng)
        for _ in range(rng.integers(1, 4)):
            half = tuple(float(h) for h in rng.uniform([0.008, 0.012, 0.006], [0.03, 0.06, 0.03]))
            p_HA = [side * (0.032 + half[0] + rng.uniform(0, 0.03)), rng.normal(0, 0.02), rng.uniform(-0.05, 0.06)]
            attachments.append(_attach(HAND_LINK, half, p_HA, rng.normal(0, 0.2, 3), surface))
    return attachments


def _random_bracket(rng: np.random.Generator) -> list[Attachment]:
    """Return a plate between flange and gripper that holds a camera at its end; often none."""
    if rng.random() < 0.6:
        return []
    angle = rng.uniform(-np.pi, np.pi)
    reach = rng.uniform(0.05, 0.1)
    ahead = np.array([np.cos(angle), np.sin(angle), 0.0])
    turn = np.array([0.0, 0.0, angle])
    plate = random_surface(rng)
    camera = random_surface(rng) if rng.random() < 0.6 else _dark_surface(rng)
    half = tuple(float(h) for h in rng.uniform([0.008, 0.015, 0.008], [0.02, 0.06, 0.02]))
    return [
        _attach(HAND_LINK, (reach / 2, float(rng.uniform(0.02, 0.045)), 0.004), 0.5 * reach * ahead, turn, plate),
        _attach(HAND_LINK, half, reach * ahead + [0.0, 0.0, rng.normal(0, 0.02)], turn, camera),
    ]


def _random_cable(rng: np.random.Generator) -> list[Attachment]:
    """Return a cable along the last links; often none."""
    attachments = []
    if rng.random() < 0.2:
        surface = _dark_surface(rng)
        angle = rng.uniform(-np.pi, np.pi)
        for link, height in (("panda_link5", -0.15), ("panda_link5", -0.05), ("panda_link7", 0.05)):
            p_LA = [0.07 * np.cos(angle), 0.07 * np.sin(angle), height + rng.normal(0, 0.03)]
            attachments.append(_attach(link, (0.005, 0.005, 0.06), p_LA, rng.normal(0, 0.4, 3), surface))
    return attachments
