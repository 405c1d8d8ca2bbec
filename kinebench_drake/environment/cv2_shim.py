"""A stand-in for `opencv-python`: a wheel with metadata and no code.

SAPIEN asks for `opencv-python`, this project for `opencv-python-headless`; both own the module `cv2`, and whichever is
copied last wins. The stand-in bears the first name and depends on the second: everybody's wish is met by one `cv2`.

    python stand_in.py FOLDER      writes the wheel into the folder and prints its path

Needs nothing but Python: the set-up runs it before anything is installed.
"""

import base64
import hashlib
import sys
import zipfile
from pathlib import Path

NAME = "opencv-python"
VERSION = "4.99.0"
"""No index has this version."""
HEADLESS = "opencv-python-headless"

_METADATA = f"""\
Metadata-Version: 2.1
Name: {NAME}
Version: {VERSION}
Summary: Stand-in that resolves {NAME} to {HEADLESS}
Requires-Dist: {HEADLESS}
"""
_WHEEL = """\
Wheel-Version: 1.0
Generator: kinebench-drake
Root-Is-Purelib: true
Tag: py3-none-any
"""


def write_wheel(folder: Path) -> Path:
    """Write the stand-in's wheel into a folder; the same bytes every time.

    The layout is that of PyPA's binary distribution format.

    Args:
        folder: Where to; it exists.

    Returns:
        The wheel's path.
    """
    stem = f"{NAME.replace('-', '_')}-{VERSION}"
    info = f"{stem}.dist-info"
    files = {f"{info}/METADATA": _METADATA, f"{info}/WHEEL": _WHEEL}
    record = [f"{name},sha256={_digest(text)},{len(text.encode())}\n" for name, text in files.items()]
    files[f"{info}/RECORD"] = "".join([*record, f"{info}/RECORD,,\n"])
    path = folder / f"{stem}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for name, text in files.items():
            wheel.writestr(zipfile.ZipInfo(name), text)
    return path


def _digest(text: str) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()


if __name__ == "__main__":
    print(write_wheel(Path(sys.argv[1])))
