#!/bin/sh
# What the long tests need besides the build's prerequisites, as Debian packages, installed when root: QEMU
# with module tools for the device tests, QEMU for Arm, GStreamer and ffmpeg as feeders, torch for LeRobot's
# datasets. Where they cannot be installed those tests are skipped and say so; with CI=true the tests in QEMU fail
# instead.
set -u
packages="qemu-system-x86 qemu-system-arm busybox-static kmod cpio zstd gstreamer1.0-tools gstreamer1.0-plugins-base ffmpeg"
packages="$packages python3-venv python3-torch python3-torchvision"

missing() {
    for tool in qemu-system-x86_64 qemu-system-arm busybox depmod cpio gst-launch-1.0 ffmpeg; do
        PATH="$PATH:/usr/sbin:/sbin" command -v "$tool" >/dev/null || return 0
    done
    /usr/bin/python3 -c 'import importlib.util as u; exit(not (u.find_spec("torch") and u.find_spec("torchvision")))' ||
        return 0
    ! apt-cache show linux-image-amd64 >/dev/null 2>&1
}

missing || exit 0
if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
    log=$(mktemp)
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends $packages; } \
        >"$log" 2>&1 || tail -n 3 "$log" >&2
    rm -f "$log"
fi
if missing; then
    echo "some long tests are skipped without: apt-get install $packages" >&2
fi
exit 0
