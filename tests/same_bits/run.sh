#!/bin/sh
# Compares the digests on every processor that this machine can run or emulate: docs/same-bits.md. Debian
# packages and Rust targets that are missing are installed, the packages only when root. A processor that
# cannot be had is skipped and named; with CI=true that is a failure.
set -u
cd "$(dirname "$0")/../.."
out=$PWD/target/same_bits
mkdir -p "$out"
rm -f "$out"/*.log "$out"/*.fault
python=${VENV:-.venv}/bin/python
export CARGO_PROFILE_RELEASE_DEBUG=false
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
export CARGO_TARGET_S390X_UNKNOWN_LINUX_GNU_LINKER=s390x-linux-gnu-gcc

packages="qemu-user qemu-system-arm gcc-aarch64-linux-gnu libc6-dev-arm64-cross gcc-s390x-linux-gnu libc6-dev-s390x-cross"
tools="qemu-aarch64 qemu-s390x qemu-system-arm aarch64-linux-gnu-gcc s390x-linux-gnu-gcc"

has() {
    for tool; do command -v "$tool" >/dev/null || return 1; done
}

if ! has $tools && has apt-get && [ "$(id -u)" = 0 ]; then
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends $packages; } \
        >"$out/packages.log" 2>&1 || tail -n 3 "$out/packages.log" >&2
fi

# Rust's library for a target.
has_target() {
    [ -d "$(rustc --print target-libdir --target "$1")" ] || { has rustup && rustup --quiet target add "$1"; }
}

fault() {
    printf '%s: %s\n' "$1" "$2" | tee -a "$out/$1.fault" >&2
}

skip() {
    if [ "${CI:-}" = true ]; then fault "$1" "needs $2"; else echo "$1: skipped, it needs $2" >&2; fi
}

# compare NAME COMMAND...: beside what follows, as an emulator uses one processor.
compare() {
    name=$1 start=$(date +%s)
    shift
    if "$@" >"$out/$name.log" 2>&1; then
        cat "$out/$name.log"
        echo "$name: $(tail -n 1 "$out/$name.log"); $(($(date +%s) - start)) s"
    else
        fault "$name" "$(cat "$out/$name.log")"
    fi
}

# on NAME TARGET BINARY OPTION COMMAND...: builds for a target, unless the command's program or the target is
# missing.
on() {
    name=$1 target=$2 binary=$3 options=$4
    shift 4
    if ! has "$1"; then
        skip "$name" "$1 (apt-get install $packages)"
    elif ! has_target "$target"; then
        skip "$name" "Rust's library for it (rustup target add $target)"
    elif nice cargo build --quiet --release --package same-bits --bin "$binary" --target "$target" \
        --target-dir "$out/$name" $options; then
        compare "$name" "$@" "$out/$name/$target/release/$binary" &
    else
        fault "$name" "does not build"
    fi
}

# The host, built above, and the wheel for aarch64: the same results as this machine's.
packages() {
    name=aarch64-packages target=aarch64-unknown-linux-gnu host=target/release/gelstereo-host
    built=$out/aarch64/$target/release/gelstereo-host
    if ! "$python" -c 'import gelstereo, maturin' 2>/dev/null || ! [ -x "$host" ]; then
        skip "$name" "gelstereo and maturin in $python, and $host (make test-long installs and builds them)"
    elif ! has apt-get qemu-aarch64 || ! [ -x "$built" ]; then
        skip "$name" "the build for aarch64, qemu-aarch64 and Debian's apt-get"
    elif rm -rf "$out/wheels" && nice "$python" -m maturin build --quiet --release --compatibility linux \
        --target "$target" --target-dir "$out/aarch64" --out "$out/wheels" 2>"$out/wheel.log"; then
        compare "$name" tests/same_bits/packages.sh "$python" "$host" "$out"/wheels/*.whl "$built" &
    else
        fault "$name" "$(cat "$out/wheel.log")"
    fi
}

if cargo build --quiet --workspace --bin same-bits; then
    compare x86-64-debug target/debug/same-bits &
else
    fault x86-64-debug "does not build"
fi
# Together with the host, whose release build has compiled all but the program.
if cargo build --quiet --release --package gelstereo-host --package same-bits --bin same-bits; then
    compare x86-64 target/release/same-bits &
else
    fault x86-64 "does not build"
fi
on aarch64 aarch64-unknown-linux-gnu same-bits "--package gelstereo-host --bin gelstereo-host" \
    qemu-aarch64 -L /usr/aarch64-linux-gnu
packages
on s390x s390x-unknown-linux-gnu same-bits "" qemu-s390x -L /usr/s390x-linux-gnu
links="--config target.thumbv7em-none-eabihf.rustflags=['-Clink-arg=-Tlink.x','-Ltests/same_bits']"
on cortex-m4 thumbv7em-none-eabihf same-bits-bare "--features bare $links" \
    qemu-system-arm -M mps2-an386 -nographic -semihosting-config enable=on,target=native -kernel
if grep -qw avx2 /proc/cpuinfo; then
    on x86-64-v3 x86_64-unknown-linux-gnu same-bits "--config build.rustflags=['-Ctarget-cpu=x86-64-v3']" env
else
    skip x86-64-v3 "a processor with AVX2"
fi
wait
! ls "$out"/*.fault >/dev/null 2>&1
