#!/bin/sh
# Runs every fuzz target for so many seconds (default 10), with libFuzzer's coverage from stable rustc.
#
# usage: fuzz/run.sh [SECONDS [TARGET...]]
#
# Inputs that fail are written to fuzz/found/TARGET-*. `fuzz/run.sh 0 TARGET` repeats them.
set -eu
cd "$(dirname "$0")"
seconds=${1:-10}
[ $# -gt 0 ] && shift
if ! command -v c++ >/dev/null; then
    echo "fuzzing needs a C++ compiler for libFuzzer (apt-get install g++); skipped" >&2
    exit 0
fi
coverage="-Cpasses=sancov-module"
for option in level=4 inline-8bit-counters pc-table trace-compares; do
    coverage="$coverage -Cllvm-args=-sanitizer-coverage-$option"
done
# With --target, build scripts and macros of the host are built without these flags.
host=$(rustc -vV | sed -n 's/^host: //p')
RUSTFLAGS="$coverage --cfg fuzzing" cargo build --release --quiet --target "$host"
[ $# -gt 0 ] || set -- $(for source in fuzz_targets/*.rs; do basename "$source" .rs; done)

fuzz() {
    target=$1
    mkdir -p "corpus/$target" found
    # From nothing, inputs grow by bytes, and a slow target would meet no more than its first choices.
    for seed in 1 2 3 4 5 6 7 8; do
        LC_ALL=C awk -v seed=$seed 'BEGIN { srand(seed); for (i = 0; i < 2048; i++) printf "%c", int(256 * rand()) }' \
            >"corpus/$target/seed-$seed"
    done
    log=found/$target.log
    # The seed is fixed; the clock still decides how far a run gets.
    if "target/$host/release/$target" "corpus/$target" -max_total_time="$seconds" -seed=1 -timeout=10 -rss_limit_mb=2048 \
        -max_len=4096 -len_control=0 -artifact_prefix="found/$target-" -print_final_stats=1 >"$log" 2>&1; then
        echo "$target: $(sed -n 's/^stat::number_of_executed_units: //p' "$log") inputs, nothing found"
    else
        tail -n 40 "$log" >&2
        echo "$target: see fuzz/found/" >&2
        return 1
    fi
}

# Two at a time, each on a processor of its own.
failed=0
while [ $# -gt 0 ]; do
    fuzz "$1" &
    beside=$!
    shift
    if [ $# -gt 0 ]; then
        (fuzz "$1") || failed=1
        shift
    fi
    wait "$beside" || failed=1
done
exit $failed
