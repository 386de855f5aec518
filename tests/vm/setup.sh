#!/bin/sh
# What the device tests need: QEMU, a static busybox, module tools and the stock kernel's package list. Debian packages,
# installed when root. Where they cannot be installed the device tests are skipped (with CI=true they fail).
set -u
missing() {
    for tool in qemu-system-x86_64 busybox depmod cpio; do
        PATH="$PATH:/usr/sbin:/sbin" command -v "$tool" >/dev/null || return 0
    done
    ! apt-cache show linux-image-amd64 >/dev/null 2>&1
}

missing || exit 0
if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
    log=$(mktemp)
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends \
        qemu-system-x86 busybox-static kmod cpio zstd; } >"$log" 2>&1 || tail -n 3 "$log" >&2
    rm -f "$log"
fi
if missing; then
    echo "the device tests need QEMU and a Debian kernel:" \
        "apt-get install qemu-system-x86 busybox-static kmod cpio zstd" >&2
fi
exit 0
