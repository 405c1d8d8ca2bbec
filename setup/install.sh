#!/usr/bin/env bash
# Installs kinebench-drake into .venv of this folder; safe to run again: existing installations are kept.
#
#   setup/install.sh              everything
#   PYTHON=python3.12 setup/install.sh      with a chosen Python (3.11 or 3.12)
#   KINEBENCH_DRAKE_RENDER=cpu setup/install.sh     also the software Vulkan driver, despite an NVIDIA driver
#
# Everything is installed below .venv, with one exception, which is announced: if Debian's Python lacks its venv module,
# that module is installed with apt-get (root or sudo).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

venv=$PWD/.venv
constraints=setup/constraints.txt

say() { printf '==> %s\n' "$*"; }
stop() {
    printf 'setup: %s\n' "$*" >&2
    exit 1
}

# --- Python ------------------------------------------------------------------------------------------------------

is_fit() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 13))' 2>/dev/null; }

find_python() {
    local candidate fallback=
    for candidate in ${PYTHON:-python3.11 python3.12 python3 python}; do
        is_fit "$candidate" || continue
        if "$candidate" -c 'import ensurepip, venv' 2>/dev/null; then
            echo "$candidate"
            return
        fi
        fallback=${fallback:-$candidate}
    done
    echo "$fallback"
}

install_venv_module() { # a separate package on Debian and Ubuntu
    local package as_root=
    package=$("$1" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    command -v apt-get >/dev/null || stop "$1 has no venv module and this system no apt-get; install Python's venv module."
    if [ "$(id -u)" != 0 ]; then
        if sudo -n true 2>/dev/null || { [ -t 0 ] && command -v sudo >/dev/null; }; then
            as_root=sudo
        else
            stop "$1 has no venv module; ask an administrator for: apt-get install $package (or set PYTHON to another Python 3.11 or 3.12)."
        fi
    fi
    say "Installing the system package $package (apt-get${as_root:+, with sudo})"
    $as_root apt-get update -q
    $as_root apt-get install -y -q --no-install-recommends "$package"
}

make_venv() {
    if [ -x "$venv/bin/python" ] && "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
        is_fit "$venv/bin/python" || stop ".venv has $("$venv/bin/python" -V), 3.11 or 3.12 is needed; delete .venv and run this again."
        return
    fi
    local python
    python=$(find_python)
    [ -n "$python" ] || stop "no Python 3.11 or 3.12 found; install one (Debian 12, Ubuntu 24.04: apt-get install python3 python3-venv) or set PYTHON."
    "$python" -c 'import ensurepip, venv' 2>/dev/null || install_venv_module "$python"
    [ ! -e "$venv" ] || say "Emptying .venv, which has no working Python or pip"
    say "Creating .venv with $python ($("$python" -V))"
    "$python" -m venv --clear "$venv"
}

# --- Python packages ---------------------------------------------------------------------------------------------

# Fingerprint of the installation's inputs: if it is unchanged and the environment is sound, there is nothing to do.
packages_key() { { pwd && "$venv/bin/python" -V && cat pyproject.toml "$constraints" kinebench_drake/environment/cv2_shim.py; } | sha256sum; }

install_packages() {
    local pip=("$venv/bin/python" -m pip --disable-pip-version-check) stamp=$venv/share/kinebench_drake/packages.sha256
    [ -t 1 ] || pip+=(--quiet) # progress bars on a terminal only
    if [ "$(packages_key)" = "$(cat "$stamp" 2>/dev/null)" ] && "${pip[@]}" check >/dev/null 2>&1; then
        say "Python packages: as in $constraints, nothing to do"
        return
    fi
    say "Installing Python packages into .venv (about 4 GB; versions of $constraints)"
    # First, so that sapien's requirement of opencv-python brings no second copy of cv2 (see cv2_shim.py).
    work=$(mktemp -d "$venv/cv2-shim.XXXXXX")
    trap 'rm -rf "$work"' EXIT
    "${pip[@]}" install -c "$constraints" "$("$venv/bin/python" -P kinebench_drake/environment/cv2_shim.py "$work")"
    # Separately: together with other packages pip prefers the CUDA build, with gigabytes of libraries, to a smaller one.
    "${pip[@]}" install -c "$constraints" "$(grep '^torch==' "$constraints")"
    "${pip[@]}" install -c "$constraints" -e '.[dev,diffusers,rerun]'
    "$venv/bin/python" -m pip check
    mkdir -p "$(dirname "$stamp")"
    packages_key >"$stamp"
}

# --- Steps -------------------------------------------------------------------------------------------------------

[ "$(uname -sm)" = "Linux x86_64" ] || stop "Linux on x86-64 is needed (SAPIEN exists for no other), this is $(uname -sm)."
make_venv
install_packages
bash kinebench_drake/environment/native.sh "$venv/bin/python"
say "Ready. Try: .venv/bin/kinebench-drake doctor"
