#!/usr/bin/env bash
# Everything that is delivered, in out/dist: wheels, binaries and Debian packages of gelstereo-host for x86-64
# and aarch64, with licence texts and checksums. zig links against glibc 2.17, so that they run on any Linux
# since 2014.
set -euo pipefail
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}
OUT=${OUT:-$PWD/out}/dist
GLIBC=2.17
WORK=$PWD/target/dist
TOOLS=$WORK/tools
export PATH=$TOOLS/bin:$PATH

step() { printf '%s\n' "dist: $*"; }

tools() {
    [ -x "$TOOLS/bin/python" ] || "$PYTHON" -m venv "$TOOLS"
    "$TOOLS/bin/pip" install --quiet 'maturin>=1.9.4,<2' ziglang cargo-zigbuild auditwheel abi3audit
    [ -x "$TOOLS/bin/cargo-deb" ] || cargo install --quiet --locked --root "$TOOLS" cargo-deb
}

# build TARGET: the target's wheel, binary and Debian package.
build() {
    local target=$1 arch=${1%%-*} binary=$OUT/gelstereo-host-${1%%-*} wheel audit
    [ -d "$(rustc --print target-libdir --target "$target")" ] || rustup --quiet target add "$target"
    "$TOOLS/bin/python" packaging/third_party.py gelstereo-host "$target" >"$WORK/third-party-licences.txt"
    "$TOOLS/bin/python" packaging/third_party.py gelstereo-python "$target" >python/gelstereo/third-party-licences.txt

    step "binary for $arch"
    cargo zigbuild --quiet --profile dist --package gelstereo-host --target "$target.$GLIBC"
    install -m 755 "target/$target/dist/gelstereo-host" "$binary"
    cat LICENSE "$WORK/third-party-licences.txt" >"$binary.licences.txt"

    step "Debian package for $arch"
    cargo deb --quiet --no-build --no-strip --package gelstereo-host --profile dist --target "$target" --output "$OUT"

    step "wheel for $arch"
    maturin build --quiet --profile dist --zig --compatibility manylinux2014 --target "$target" --out "$OUT"
    wheel=$(ls "$OUT"/gelstereo-*"$arch".whl)
    audit=$(auditwheel show "$wheel")
    [[ $audit = *'"manylinux_2_17_'* ]] || { printf '%s\n' "$audit" >&2; exit 1; }
    abi3audit --strict --summary "$wheel"
    "$TOOLS/bin/python" packaging/check.py "$wheel" "$binary"
}

# The wheel in an environment of its own, with NumPy alone; and both for aarch64, compared with it.
try_out() {
    rm -rf "$WORK/venv"
    "$PYTHON" -m venv "$WORK/venv"
    "$WORK/venv/bin/pip" install --quiet --no-deps "$OUT"/gelstereo-*x86_64.whl numpy
    if command -v qemu-aarch64 >/dev/null && command -v apt-get >/dev/null; then
        step "aarch64 by qemu-user, compared with x86-64"
        tests/same_bits/packages.sh "$WORK/venv/bin/python" "$OUT/gelstereo-host-x86_64" \
            "$OUT"/gelstereo-*aarch64.whl "$OUT/gelstereo-host-aarch64"
    else
        step "nothing was run for aarch64: that needs qemu-user and Debian's apt-get"
    fi
}

rm -rf "$OUT"
mkdir -p "$OUT" "$WORK"
trap 'rm -f python/gelstereo/third-party-licences.txt' EXIT
tools
for target in x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu; do
    build "$target"
done
try_out
(cd "$OUT" && sha256sum ./* >SHA256SUMS)
ls -l "$OUT"
