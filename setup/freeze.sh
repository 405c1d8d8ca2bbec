#!/usr/bin/env bash
# Writes setup/constraints.txt from what .venv holds.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

packages=$(.venv/bin/python -m pip --disable-pip-version-check freeze --exclude-editable)
{
    echo "# The versions this project is tested with, for Python 3.11 and 3.12; written by \`make constraints\`."
    # The stand-in is installed from a folder, and a build of torch may carry a local suffix (+cpu): neither is for others.
    sed -E 's/^opencv-python @.*/opencv-python==4.99.0/; s/^(torch==[^+]*)\+.*/\1/' <<<"$packages"
} >setup/constraints.txt
