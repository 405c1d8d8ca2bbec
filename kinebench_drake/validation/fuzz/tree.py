"""A folder as a value: what lies in it by relative path, so that it can be drawn, changed and written anywhere."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TypeAlias


class Special(Enum):
    """What is neither a file nor a link."""

    FOLDER = "folder"
    PIPE = "pipe"


@dataclass(frozen=True, slots=True)
class Link:
    """A symbolic link."""

    to: str


Node: TypeAlias = bytes | Link | Special
Tree: TypeAlias = Mapping[str, Node]
"""Nodes by paths relative to the folder, parts joined by a slash."""


def write_tree(tree: Tree, folder: Path) -> None:
    """Write a tree below a folder that is made; nodes that no file system takes are left out."""
    folder.mkdir(parents=True)
    for name, node in tree.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(node, bytes):
                path.write_bytes(node)
            elif isinstance(node, Link):
                path.symlink_to(node.to)
            elif node is Special.FOLDER:
                path.mkdir(exist_ok=True)
            else:
                os.mkfifo(path)
        except (OSError, ValueError):  # a name too long, below a file, taken, or with a zero byte
            continue
