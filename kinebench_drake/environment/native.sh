#!/usr/bin/env bash
# Unpacks native libraries that this system lacks below a Python environment: no root, no change of the system.
#
#   native.sh PYTHON           for the environment of PYTHON (its sys.prefix); intact libraries are kept
#   native.sh PYTHON --anew    the same, but libraries unpacked before are replaced
#
# Called by `setup/install.sh` and `kinebench-drake doctor --fix`. KINEBENCH_DRAKE_RENDER=cpu: also unpack the software
# Vulkan driver although there is an NVIDIA driver.
set -euo pipefail

mesa_minimum=24.3 # the first Mesa whose software driver has the features that SAPIEN needs

say() { printf '==> %s\n' "$*"; }
stop() {
    printf 'setup: %s\n' "$*" >&2
    exit 1
}

# The shared objects of a purpose, whose dependencies native.py preloads. $driver: the unpacked Vulkan driver, if any.
roots() {
    case $1 in
    drake) ls "$site"/pydrake/lib/libdrake.so ;;
    open3d) ls "$site"/open3d/pybind*.so "$site"/open3d/cpu/pybind*.so 2>/dev/null || true ;;
    vulkan) ls "$site"/sapien/pysapien.*.so $driver ;;
    esac
}

# Names of libraries that the linker does not find for some purposes ($1: further folders to search).
# SAPIEN loads its own OpenImageDenoise.
missing() {
    local folders=$1 purpose
    shift
    for purpose; do
        roots "$purpose" | LD_LIBRARY_PATH=$folders${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} xargs -r ldd 2>/dev/null
    done | awk '/not found/ && $1 !~ /^libOpenImageDenoise/ { print $1 }' | sort -u
}

package_of() { # Debian's package names; a second one if Ubuntu 24.04 and Debian 13 renamed it
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
    mesa) echo mesa-vulkan-drivers ;;
    esac
}

has_vulkan_driver() {
    if [ "${KINEBENCH_DRAKE_RENDER:-}" != cpu ] && "$python" -P -c \
        'import sys; from kinebench_drake.environment import native; sys.exit(not native.has_nvidia_vulkan())'; then
        say "Vulkan: NVIDIA's driver is installed and is used"
        return
    fi
    if [ -n "${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}" ]; then
        say "Vulkan: the driver that VK_DRIVER_FILES or VK_ICD_FILENAMES names is used"
        return
    fi
    local version
    version=$(dpkg-query -W -f '${Version}' mesa-vulkan-drivers 2>/dev/null) || return 1
    dpkg --compare-versions "$version" ge "$mesa_minimum" || return 1
    say "Vulkan: the system's Mesa $version is used"
}

# Prints a file of apt sources with a further suite from the same mirrors.
with_suite() { # $1: codename, $2: the further suite (may be empty), $3: file
    if [ -z "$2" ] || grep -q "$2" "$3"; then
        cat "$3"
    elif [[ $3 == *.sources ]]; then
        sed -E "/^Suites:/ s/(\s)$1(\s|\$)/\1$1 $2\2/" "$3"
    else
        sed -nE "p; s/^(deb +(\[[^]]*\] +)?\S+ +)$1( )/\1$2\3/p" "$3"
    fi
}

# A private apt: the machine's sources (with the backports suite on Debian 12), lists and cache below $work.
# Needs no root; the system's package lists and packages do not change.
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
    # A failing source is no reason to stop: whether the packages are available is checked next.
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
        else
            [ -n "$(package_of "$name")" ] || stop "no package is known for $name; install the library with your system's package manager and run this again."
            tail -n 3 "$work/update.log" >&2
            stop "the package for $name is not available ($(package_of "$name")); is the network up and the distribution's archive in apt's sources?"
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

# Prints the libraries below the folder that the linker uses for a purpose, as relative paths.
preload_list() { # $1: the folder, $2: library folders, rest: shared objects
    local folder=$1 folders=$2
    shift 2
    { LD_LIBRARY_PATH=$folders ldd "$@" | awk '{ print $3 }' && printf '%s\n' "$@"; } |
        sed -n "s#^$folder/##p" | sort -u
}

# Prints what is wrong with the unpacked libraries; nothing if they are intact or there are none.
damage() {
    local output
    [ -e "$native" ] || return 0
    output=$("$python" -P -c 'import sys; from kinebench_drake.environment import native; sys.exit(native.damage())' 2>&1) ||
        tail -n 1 <<<"${output:-a library crashes the process that loads it}"
}

lacks() { # $@: wanted names; true if one of them was not unpacked before
    [ -n "$(printf '%s\n' "$@" | grep -vxF -f <(cat "$native/wanted.txt" 2>/dev/null || true))" ]
}

install_native() { # $1: --anew or nothing
    local wanted=() purpose folders root driver= left wrong
    mapfile -t wanted < <(missing "" drake open3d vulkan)
    has_vulkan_driver || wanted+=(mesa)
    wrong=$(damage)
    [ "$1" = "" ] || [ ! -e "$native" ] || wrong=${wrong:-replacement was requested}
    if ! lacks "${wanted[@]}" && [ -z "$wrong" ]; then
        say "Native libraries: all there, nothing to do"
        return
    fi
    if [ "${#wanted[@]}" != 0 ]; then
        command -v apt-get >/dev/null && command -v dpkg >/dev/null ||
            stop "this system has no apt-get; install by other means (mesa: Mesa's Vulkan drivers $mesa_minimum or newer): ${wanted[*]}"
    fi
    [ -z "$wrong" ] || say "Replacing $native ($wrong)"
    work=$(mktemp -d "$prefix/native.XXXXXX") || stop "$prefix cannot be written to; run this as its owner."
    trap 'rm -rf "$work"' EXIT
    root=$work/native
    mkdir -p "$root"
    if [ "${#wanted[@]}" = 0 ]; then
        rm -rf "$native" "$site/kinebench_drake_native.pth"
        say "Native libraries: the system has them all"
        return
    fi
    say "Unpacking libraries that this system lacks below $native (${wanted[*]}); the system is not changed"
    fetch_libraries "${wanted[@]}"

    folders=$(find "$root" -name '*.so*' -path "*/x86_64-linux-gnu/*" -printf '%h\n' | grep 'x86_64-linux-gnu$' | sort -u | paste -sd:)
    driver=$(find "$root" -name libvulkan_lvp.so)
    for purpose in drake open3d vulkan; do
        preload_list "$root" "$folders" $(roots "$purpose") >"$root/$purpose.txt"
    done
    if [ -n "$driver" ]; then
        sed "s#\"library_path\": *\"[^\"]*\"#\"library_path\": \"$native/${driver#"$root"/}\"#" \
            "$root"/usr/share/vulkan/icd.d/lvp_icd*.json >"$root/lavapipe.json"
    fi
    left=$(missing "$folders" drake open3d vulkan)
    [ -z "$left" ] || stop "libraries are still missing: $left; install them with your system's package manager and run this again."
    printf '%s\n' "${wanted[@]}" >"$root/wanted.txt"
    mkdir -p "$(dirname "$native")"
    rm -rf "$native" "$site/kinebench_drake_native.pth"
    mv "$root" "$native"
    # Many modules import Drake, so its list is loaded whenever this environment's Python starts.
    if [ -s "$native/drake.txt" ]; then
        echo 'import importlib.util; importlib.util.find_spec("kinebench_drake") and __import__("kinebench_drake.environment.native").environment.native.prepare_drake()' \
            >"$site/kinebench_drake_native.pth"
    fi
}

# --- Steps -------------------------------------------------------------------------------------------------------

python=$1
{ read -r prefix && read -r site; } < <("$python" -P -c 'import sys, sysconfig; print(sys.prefix); print(sysconfig.get_path("platlib"))') ||
    stop "$python does not start."
native=$prefix/share/kinebench_drake/native
for package in pydrake open3d sapien; do
    [ -e "$site/$package" ] ||
        stop "$site holds no $package; \`$python -m pip install kinebench-drake\` brings missing packages."
done
install_native "${2:-}"
