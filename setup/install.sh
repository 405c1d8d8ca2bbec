#!/usr/bin/env bash
# Sets kinebench-drake up in this folder's .venv; safe to run again: what is there already is left as it is.
#
#   setup/install.sh              everything
#   PYTHON=python3.12 setup/install.sh      with a Python of your choice (3.11 or 3.12)
#   KINEBENCH_DRAKE_RENDER=cpu setup/install.sh     the software Vulkan driver too, although an NVIDIA driver is there
#
# Everything lands below .venv. The one exception is named before it happens: where Debian's Python comes without
# its venv module, that module is installed with apt-get (root or sudo).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

venv=$PWD/.venv
constraints=setup/constraints.txt
native=$venv/share/kinebench_drake/native
mesa_minimum=24.3 # the first Mesa whose software driver has what SAPIEN asks for

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

install_venv_module() { # Debian and Ubuntu ship it as a package of its own
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
    say "Making .venv with $python ($("$python" -V))"
    "$python" -m venv --clear "$venv"
}

# --- Python packages ---------------------------------------------------------------------------------------------

# What was installed, from what: when this is unchanged and the environment is sound, there is nothing to do.
packages_key() { { pwd && "$venv/bin/python" -V && cat pyproject.toml "$constraints" setup/opencv-python/pyproject.toml; } | sha256sum; }

install_packages() {
    local pip=("$venv/bin/python" -m pip --disable-pip-version-check) stamp=$venv/share/kinebench_drake/packages.sha256
    [ -t 1 ] || pip+=(--quiet) # on a terminal pip's progress bars pass the time, in a log they are noise
    if [ "$(packages_key)" = "$(cat "$stamp" 2>/dev/null)" ] && "${pip[@]}" check >/dev/null 2>&1; then
        say "Python packages: as in $constraints, nothing to do"
        return
    fi
    say "Installing Python packages into .venv (about 4 GB; versions of $constraints)"
    # First, so that sapien's wish for opencv-python is met without a second copy of cv2: the folder says why.
    "${pip[@]}" install -c "$constraints" setup/opencv-python
    # By itself: beside other packages pip prefers the CUDA build and gigabytes of libraries, where a smaller one is at hand.
    "${pip[@]}" install -c "$constraints" "$(grep '^torch==' "$constraints")"
    "${pip[@]}" install -c "$constraints" -e '.[dev,diffusers]'
    "$venv/bin/python" -m pip check
    mkdir -p "$(dirname "$stamp")"
    packages_key >"$stamp"
}

# --- Native libraries --------------------------------------------------------------------------------------------

site() { "$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("platlib"))'; }

# The shared objects a purpose starts from; kinebench_drake/native.py preloads what they need, by purpose.
# $driver is the unpacked Vulkan driver, if there is one.
roots() {
    case $1 in
    drake) ls "$site"/pydrake/lib/libdrake.so ;;
    open3d) ls "$site"/open3d/pybind*.so "$site"/open3d/cpu/pybind*.so 2>/dev/null || true ;;
    vulkan) ls "$site"/sapien/pysapien.*.so $driver ;;
    esac
}

# Names of libraries that the linker misses for the purposes given ($1: further folders to look in).
# SAPIEN loads its own OpenImageDenoise before the linker asks for it.
missing() {
    local folders=$1 purpose
    shift
    for purpose; do
        roots "$purpose" | LD_LIBRARY_PATH=$folders${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} xargs -r ldd 2>/dev/null
    done | awk '/not found/ && $1 !~ /^libOpenImageDenoise/ { print $1 }' | sort -u
}

package_of() { # Debian's names; a second one where Ubuntu 24.04 and Debian 13 renamed it
    case $1 in
    libEGL.so.1) echo libegl1 ;;
    libGL.so.1) echo libgl1 ;;
    libX11.so.6) echo libx11-6 ;;
    libglib-2.0.so.0) echo libglib2.0-0t64 libglib2.0-0 ;;
    libgomp.so.1) echo libgomp1 ;;
    libidn2.so.0) echo libidn2-0 ;;
    libudev.so.1) echo libudev1 ;;
    libusb-1.0.so.0) echo libusb-1.0-0 ;;
    libstdc++.so.6) echo libstdc++6 ;;
    libz.so.1) echo zlib1g ;;
    tcmalloc) echo libtcmalloc-minimal4t64 libtcmalloc-minimal4 ;;
    mesa) echo mesa-vulkan-drivers ;;
    esac
}

has_vulkan_driver() {
    if [ "${KINEBENCH_DRAKE_RENDER:-}" != cpu ] && "$venv/bin/python" -c \
        'import sys; from kinebench_drake import native; sys.exit(not native.has_nvidia_vulkan())'; then
        say "Vulkan: NVIDIA's driver is installed and is used"
        return
    fi
    local version
    version=$(dpkg-query -W -f '${Version}' mesa-vulkan-drivers 2>/dev/null) || return 1
    dpkg --compare-versions "$version" ge "$mesa_minimum" || return 1
    say "Vulkan: the system's Mesa $version is used"
}

# A file of apt's sources with a further suite from the mirrors that serve the first one.
with_suite() { # $1: codename, $2: the further suite (may be empty), $3: file
    if [ -z "$2" ] || grep -q "$2" "$3"; then
        cat "$3"
    elif [[ $3 == *.sources ]]; then
        sed -E "/^Suites:/ s/(\s)$1(\s|\$)/\1$1 $2\2/" "$3"
    else
        sed -nE "p; s/^(deb +(\[[^]]*\] +)?\S+ +)$1( )/\1$2\3/p" "$3"
    fi
}

# A private apt: the machine's own sources (with its backports suite on Debian 12), lists and cache below $work.
# It needs no root, and neither the system's package lists nor its packages change.
private_apt() {
    local file codename suite=
    codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
    mkdir -p "$work"/sources "$work"/lists/partial "$work"/cache/archives/partial
    [ "$codename" = bookworm ] && suite=$codename-backports
    for file in /etc/apt/sources.list /etc/apt/sources.list.d/*.list /etc/apt/sources.list.d/*.sources; do
        [ -r "$file" ] || continue
        with_suite "$codename" "$suite" "$file" >"$work/sources/${file##*/}"
    done
    cat >"$work/apt.conf" <<CONF
Dir::Etc::sourcelist "/dev/null";
Dir::Etc::sourceparts "$work/sources";
Dir::State::lists "$work/lists";
Dir::Cache "$work/cache";
Debug::NoLocking "1";
APT::Sandbox::User "";
Acquire::Languages "none";
#clear APT::Update::Pre-Invoke;
#clear APT::Update::Post-Invoke;
#clear APT::Update::Post-Invoke-Success;
#clear DPkg::Post-Invoke;
CONF
    # A source that fails is no reason to stop: what matters is whether the packages can be had, and that is asked next.
    apt-get -c "$work/apt.conf" -q update >"$work/update.log" 2>&1 || true
    if [ -n "$suite" ] && compgen -G "$work/lists/*${suite}*" >/dev/null; then
        echo "APT::Default-Release \"$suite\";" >>"$work/apt.conf"
    fi
}

candidate() { apt-cache -c "$work/apt.conf" policy "$1" 2>/dev/null | awk '/Candidate:/ && $2 != "(none)" { print $2 }'; }

fetch_libraries() { # $@: names that package_of knows
    local name package version packages=()
    private_apt
    for name; do
        version=
        for package in $(package_of "$name"); do
            version=$(candidate "$package")
            [ -z "$version" ] || break
        done
        if [ -n "$version" ]; then
            [ "$name" != mesa ] || dpkg --compare-versions "$version" ge "$mesa_minimum" ||
                stop "SAPIEN needs Mesa $mesa_minimum or newer, this system's newest is $version; use Debian 12 or newer, Ubuntu 24.04 with its updates, or an NVIDIA driver."
            packages+=("$package")
        elif [ "$name" != tcmalloc ]; then
            [ -n "$(package_of "$name")" ] || stop "no package is known for $name; install the library with your system's package manager and run this again."
            tail -n 3 "$work/update.log" >&2
            stop "the package for $name cannot be had ($(package_of "$name")); is the network up and the distribution's archive in apt's sources?"
        fi
    done
    apt-get -c "$work/apt.conf" -q -y --download-only --no-install-recommends install "${packages[@]}" >"$work/install.log" 2>&1 || {
        grep '^E:' "$work/install.log" >&2 || true
        stop "apt-get cannot download ${packages[*]}."
    }
    for package in "$work"/cache/archives/*.deb; do
        case ${package##*/} in libc6_* | libc-bin_*) continue ;; esac # a second C library cannot be loaded
        dpkg -x "$package" "$work/native"
    done
}

# The libraries below the folder that the linker picks for a purpose, as paths below the folder.
preload_list() { # $1: the folder, $2: library folders, rest: shared objects
    local folder=$1 folders=$2
    shift 2
    { LD_LIBRARY_PATH=$folders ldd "$@" | awk '{ print $3 }' && printf '%s\n' "$@"; } |
        sed -n "s#^$folder/##p" | sort -u
}

install_native() {
    local wanted=() purpose folders root driver= left
    mapfile -t wanted < <(missing "" drake open3d vulkan)
    has_vulkan_driver || wanted+=(mesa)
    if [ -z "$(printf '%s\n' "${wanted[@]}" | grep -vxF -f <(cat "$native/wanted.txt" 2>/dev/null || true))" ]; then
        say "Native libraries: all there, nothing to do"
        return
    fi
    command -v apt-get >/dev/null && command -v dpkg >/dev/null ||
        stop "this system has no apt-get; install by its own means (mesa: Mesa's Vulkan drivers $mesa_minimum or newer): ${wanted[*]}"
    wanted+=(tcmalloc) # makes training faster; nothing fails without it
    say "Unpacking libraries that this system lacks below .venv/share/kinebench_drake/native (${wanted[*]}); the system stays as it is"
    work=$(mktemp -d "$venv/native.XXXXXX")
    trap 'rm -rf "$work"' EXIT
    root=$work/native
    mkdir -p "$root"
    fetch_libraries "${wanted[@]}"

    folders=$(find "$root" -name '*.so*' -path "*/x86_64-linux-gnu/*" -printf '%h\n' | grep 'x86_64-linux-gnu$' | sort -u | paste -sd:)
    driver=$(find "$root" -name libvulkan_lvp.so)
    for purpose in drake open3d vulkan; do
        preload_list "$root" "$folders" $(roots "$purpose") >"$root/$purpose.txt"
    done
    (cd "$root" && find . -name 'libtcmalloc_minimal.so.4' -printf '%P\n') >"$root/tcmalloc.txt"
    if [ -n "$driver" ]; then
        sed "s#\"library_path\": *\"[^\"]*\"#\"library_path\": \"$native/${driver#"$root"/}\"#" \
            "$root"/usr/share/vulkan/icd.d/lvp_icd*.json >"$root/lavapipe.json"
    fi
    left=$(missing "$folders" drake open3d vulkan)
    [ -z "$left" ] || stop "libraries are still missing: $left; install them with your system's package manager and run this again."
    printf '%s\n' "${wanted[@]}" >"$root/wanted.txt"
    mkdir -p "$(dirname "$native")"
    rm -rf "$native"
    mv "$root" "$native"
    # Drake's modules are imported everywhere, so its list is loaded whenever this .venv's Python starts.
    if [ -s "$native/drake.txt" ]; then
        echo "import kinebench_drake.native; kinebench_drake.native.prepare_drake()" >"$site/kinebench_drake_native.pth"
    fi
}

[ "$(uname -sm)" = "Linux x86_64" ] || stop "Linux on x86-64 is needed (SAPIEN exists for no other), this is $(uname -sm)."
make_venv
install_packages
site=$(site)
install_native
say "Ready. Try: .venv/bin/kinebench-drake doctor"
