"""Data sets of the Hugging Face Hub as input, `hf://datasets/ORG/NAME[@REVISION][/PART]` (extra `hub`)."""

import re
from pathlib import Path

from kinebench_drake.errors import SetupError, UsageError, cause
from kinebench_drake.io.files import absence

_SCHEME = "hf:"
_ADDRESS = re.compile(r"hf:/datasets/([\w.-]+/[\w.-]+?)(?:@([^/]+))?(?:/(.+))?")  # a Path keeps one slash of two


def is_hub(source: Path) -> bool:
    """Return whether a path is an address of the Hub."""
    return source.parts[:1] == (_SCHEME,)


def hub_address(source: Path) -> str:
    """Return the address that a path stands for."""
    return source.as_posix().replace("hf:/", "hf://", 1)


def find_source(source: Path) -> Path:
    """Return the path of an input: of an address of the Hub that in the cache of huggingface_hub.

    What the cache holds is not fetched again; without a network it is used as it is.

    Raises:
        UsageError: there is no such file, folder or data set, the address has another form, or it cannot be fetched.
        SetupError: the package huggingface_hub is missing.
    """
    path = _fetch(source) if is_hub(source) else source
    if not path.exists():
        raise UsageError(f"{source}: {'holds no such file or folder' if path != source else absence(source)}")
    return path


def _fetch(source: Path) -> Path:
    match = _ADDRESS.fullmatch(source.as_posix())
    address = hub_address(source)
    if match is None or ".." in source.parts:
        raise UsageError(f"{address}: expected hf://datasets/ORG/NAME, with @REVISION or /FOLDER if needed")
    try:
        from huggingface_hub import snapshot_download
    except ImportError:
        raise SetupError("the Hub is read with the package huggingface_hub: pip install huggingface_hub") from None
    name, revision, part = match.groups()
    patterns = None if part is None else [part, f"{part}/*"]
    try:
        folder = snapshot_download(name, repo_type="dataset", revision=revision, allow_patterns=patterns)
    except (OSError, ValueError) as error:  # those of huggingface_hub are OSErrors
        raise UsageError(f"{address}: cannot be fetched ({str(error).splitlines()[0] or cause(error)})") from None
    return Path(folder) / (part or "")
