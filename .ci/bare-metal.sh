#!/bin/sh
# Format and clippy of examples/bare_metal, which no host can build. Where the Rust target cannot be had it is
# skipped; with CI=true that is a failure.
set -eu
cd "$(dirname "$0")/../examples/bare_metal"
target=thumbv7em-none-eabihf

cargo fmt --check
if ! [ -d "$(rustc --print target-libdir --target $target)" ] &&
    ! { command -v rustup >/dev/null && rustup --quiet target add $target; }; then
    echo "examples/bare_metal is not linted without: rustup target add $target" >&2
    [ "${CI:-}" != true ]
    exit
fi
for features in "" "--no-default-features" "--features vga"; do
    cargo clippy --quiet --locked --target-dir ../../target/bare_metal $features -- -D warnings
done
