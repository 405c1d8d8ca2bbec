"""Shim for `opencv-python`: a wheel with metadata and no code.

SAPIEN requires `opencv-python`, this project `opencv-python-headless`; both contain the module `cv2`, and the one
installed last overwrites the other. The shim has the first name and depends on the second, so that one `cv2` satisfies
both requirements.

    python cv2_shim.py FOLDER      writes the wheel into the folder and prints its path

Uses the standard library only: setup/install.sh runs it before any package is installed.
"""

import base64
import hashlib
import sys
import zipfile
from pathlib import Path

NAME = "opencv-python"
VERSION = "4.99.0"
"""Version that no package index has."""
HEADLESS = "opencv-python-headless"

_METADATA = f"""\
Metadata-Version: 2.1
Name: {NAME}
Version: {VERSION}
Summary: Shim that resolves {NAME} to {HEADLESS}
Requires-Dist: {HEADLESS}
"""
_WHEEL = """\
Wheel-Version: 1.0
Generator: kinebench-drake
Root-Is-Purelib: true
Tag: py3-none-any
"""


def write_wheel(folder: Path) -> Path:
    """Write the wheel, in PyPA's binary distribution format, with the same bytes every time.

    Returns:
        Path of the wheel.
    """
    stem = f"{NAME.replace('-', '_')}-{VERSION}"
    info = f"{stem}.dist-info"
    files = {f"{info}/METADATA": _METADATA, f"{info}/WHEEL": _WHEEL}
    data = {name: text.encode() for name, text in files.items()}
    digests = {
        name: base64.urlsafe_b64encode(hashlib.sha256(d).digest()).rstrip(b"=").decode() for name, d in data.items()
    }
    record = [f"{name},sha256={digests[name]},{len(d)}\n" for name, d in data.items()]
    files[f"{info}/RECORD"] = "".join([*record, f"{info}/RECORD,,\n"])
    path = folder / f"{stem}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for name, text in files.items():
            wheel.writestr(zipfile.ZipInfo(name), text)
    return path


if __name__ == "__main__":
    print(write_wheel(Path(sys.argv[1])))
