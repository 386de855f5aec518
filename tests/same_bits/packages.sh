#!/bin/sh
# Runs the host and the wheel for aarch64 by qemu-user, and compares their results with this machine's.
#
# usage: packages.sh PYTHON HOST WHEEL_AARCH64 HOST_AARCH64
#
# PYTHON has gelstereo installed. A Python for aarch64 comes from Debian's packages, unpacked into a folder of
# their own.
set -eu
python=$1 host=$2 wheel=$3 foreign_host=$4
case $python in /*) ;; *) python=$PWD/$python ;; esac
here=$(cd "$(dirname "$0")" && pwd)
work=$here/../../target/same_bits/packages
root=$work/root
mkdir -p "$work"
work=$(cd "$work" && pwd)
root=$work/root

foreign() {
    qemu-aarch64 -L "$root" "$@"
}

# What `apt-get install python3` would bring to an empty system; this system's packages stay as they are.
unpack_python() {
    [ -x "$root/usr/bin/python3" ] && return
    apt=$work/apt
    mkdir -p "$apt/lists/partial" "$apt/cache/archives/partial" "$root"
    : >"$apt/status"
    set -- -qq -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Dir::State::Lists="$apt/lists" \
        -o Dir::State::Status="$apt/status" -o Dir::Cache="$apt/cache" -o APT::Sandbox::User=root
    apt-get "$@" update
    apt-get "$@" install --yes --download-only --no-install-recommends python3
    for package in "$apt"/cache/archives/*.deb; do
        dpkg-deb --extract "$package" "$root"
    done
    rm -r "$apt"
}

install_wheel() {
    rm -rf "$work/site"
    version=$(foreign "$root/usr/bin/python3" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    "$python" -m pip install --quiet --disable-pip-version-check --target "$work/site" --no-deps \
        --only-binary=:all: --python-version "$version" --platform manylinux2014_aarch64 --platform linux_aarch64 \
        "$wheel" numpy
}

unpack_python
install_wheel
(cd "$work" && "$python" -I "$here/package.py") >"$work/here.txt"
PYTHONPATH=$work/site foreign "$root/usr/bin/python3" "$here/package.py" >"$work/foreign.txt"
diff "$work/here.txt" "$work/foreign.txt"

"$host" run --record "$work/run.mcap" >"$work/run.txt"
foreign "$foreign_host" replay "$work/run.mcap" >"$work/replay.txt"
grep -q 'same bits$' "$work/replay.txt"
echo "$(wc -l <"$work/here.txt") lines of the wheel equal; $(tail -n 1 "$work/replay.txt")"
