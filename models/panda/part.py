"""The parts of the robot that a pixel can show."""

from enum import IntEnum


class Part(IntEnum):
    """What a pixel shows; hand and fingers are the gripper."""

    BACKGROUND = 0
    HAND = 1
    LEFT_FINGER = 2
    RIGHT_FINGER = 3
    ARM = 4


GRIPPER = (Part.HAND, Part.LEFT_FINGER, Part.RIGHT_FINGER)
"""The parts that move with the hand."""

OPENING_SIGN = {Part.HAND: 0.0, Part.LEFT_FINGER: 1.0, Part.RIGHT_FINGER: -1.0}
"""Direction along the hand's y axis in which a part moves as the gripper opens."""
