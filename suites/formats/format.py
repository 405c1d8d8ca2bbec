"""What a format does: a part for each demonstration as it comes, and the whole when all are there."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from kinebench_drake.suites.formats.demo import Content, Demo, FormatKind, Record, Shots


class Format(Protocol):
    """A format of demonstrations in a folder."""

    content: Content
    """What it holds."""

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Files that a demonstration's part consists of."""

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write a demonstration's part, each file whole or not at all."""

    def finish(self, folder: Path, records: Sequence[Record], shots: Shots, about: dict[str, Any]) -> list[Path]:
        """Write what speaks of all demonstrations, given in order; the parts stay.

        Args:
            folder: where.
            records: the demonstrations.
            shots: how they were filmed.
            about: suite, split, pool and variant.

        Returns:
            The files that parts were joined into; none where parts stay as they are.
        """

    def lists(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Files that `finish` writes beside those it returns."""


def find_format(kind: FormatKind) -> Format:
    """The format of a name."""
    match kind:
        case FormatKind.MP4:
            from kinebench_drake.suites.formats.videofolder import VideoFolder

            return VideoFolder()
        case FormatKind.LEROBOT:
            from kinebench_drake.suites.formats.lerobot import LeRobot

            return LeRobot()
        case FormatKind.MANISKILL:
            from kinebench_drake.suites.formats.maniskill import ManiSkill

            return ManiSkill()
        case FormatKind.FRAMES:
            from kinebench_drake.suites.formats.frames import Frames

            return Frames()
