"""The parts of the robot that a pixel can show."""

from enum import IntEnum

from kinebench_drake.models.panda.robot import ARM_LINKS, FINGER_LINKS, HAND_LINK


class Part(IntEnum):
    """What a pixel shows: hand and fingers are the gripper, the links from the base on the arm."""

    BACKGROUND = 0
    HAND = 1
    LEFT_FINGER = 2
    RIGHT_FINGER = 3
    LINK0 = 4
    LINK1 = 5
    LINK2 = 6
    LINK3 = 7
    LINK4 = 8
    LINK5 = 9
    LINK6 = 10
    LINK7 = 11


GRIPPER = (Part.HAND, Part.LEFT_FINGER, Part.RIGHT_FINGER)
"""The parts that move with the hand."""

ARM = tuple(part for part in Part if part >= Part.LINK0)
"""The parts of the arm, base first; the eighth link has no body."""

LINK_OF = dict(zip((*GRIPPER, *ARM), (HAND_LINK, *FINGER_LINKS, *ARM_LINKS[:-1]), strict=True))
"""Name in the URDF of each part."""

OPENING_SIGN = {Part.HAND: 0.0, Part.LEFT_FINGER: 1.0, Part.RIGHT_FINGER: -1.0}
"""Direction along the hand's y axis in which a part moves as the gripper opens."""
