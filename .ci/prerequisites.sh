#!/bin/sh
# Says in one line each what a fresh machine still needs; exits 1 if anything is missing.
missing=0

need() {
    printf 'gelstereo needs %s\n    found: %s\n    to get it: %s\n' "$1" "$2" "$3" >&2
    missing=1
}

# at_least FOUND WANTED: whether a dotted version is new enough.
at_least() {
    [ "$(printf '%s\n%s\n' "$2" "$1" | sort -V | head -n 1)" = "$2" ]
}

PYTHON=${PYTHON:-python3}
RUST_WANTED=1.88
PYTHON_WANTED=3.10

if rust=$(rustc --version 2>/dev/null | cut -d ' ' -f 2) && [ -n "$rust" ]; then
    at_least "$rust" "$RUST_WANTED" || need "Rust $RUST_WANTED or newer" "$rust" "rustup update stable"
else
    need "Rust $RUST_WANTED or newer" "no rustc" "install rustup, then: rustup default stable"
fi
command -v cargo >/dev/null || need "cargo" "no cargo" "it comes with rustup"
command -v cc >/dev/null || need "a C linker" "no cc" "apt-get install gcc"

if python=$("$PYTHON" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null); then
    at_least "$python" "$PYTHON_WANTED" || need "Python $PYTHON_WANTED or newer" "$python" "name one: make PYTHON=python3.12 ..."
    "$PYTHON" -c 'import venv, ensurepip' 2>/dev/null ||
        need "Python's venv module" "none in $PYTHON" "apt-get install python3-venv"
else
    need "Python $PYTHON_WANTED or newer" "no $PYTHON" "apt-get install python3 python3-venv"
fi
exit $missing
