#!/usr/bin/env bash
# Writes setup/constraints.txt from the packages in .venv.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

packages=$(.venv/bin/python -m pip --disable-pip-version-check freeze --exclude-editable)
{
    echo "# The versions this project is tested with, for Python 3.11 and 3.12; written by \`make constraints\`."
    # The cv2 shim is installed from a folder, and a build of torch may have a local suffix (+cpu): both become plain pins.
    sed -E 's/^opencv-python @.*/opencv-python==4.99.0/; s/^(torch==[^+]*)\+.*/\1/' <<<"$packages"
} >setup/constraints.txt
