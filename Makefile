# Two commands: `make demo` runs the main job, `make test` passes all tests. Both set up what they need.
# `make test-long` adds what takes minutes: device drivers in a virtual machine, killed recordings, long runs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
OUT ?= out
HOST := $(CURDIR)/target/release/gelstereo-host
# Of the tests in Rust: `make test` builds the host once. `make test-long` takes the one that is delivered.
DEBUG_HOST := $(CURDIR)/target/debug/gelstereo-host

.PHONY: demo test lint test-rust test-python test-long same-bits long-builds explore fuzz experiment frontier docs dist clean prerequisites

demo: prerequisites $(BIN)/python
	$(BIN)/pip install --quiet '.[recording]'
	cargo build --release --quiet -p gelstereo-host
	@mkdir -p $(OUT)/demo
	$(HOST) run --record $(OUT)/demo/run.mcap
	$(BIN)/gelstereo view $(OUT)/demo/run.mcap --output $(OUT)/demo/located.png
	@echo "picture:   $(OUT)/demo/located.png"
	@echo "recording: $(OUT)/demo/run.mcap"

test: prerequisites test-rust test-python
	@echo "all tests passed"

# Property tests try the same cases on every run, so that a change fails for what it did; `make explore` tries others.
test-rust: export PROPTEST_RNG_SEED ?= 20211
explore: export PROPTEST_CASES ?= 200

test-rust: prerequisites
	$(PYTHON) .ci/imports.py crates/gelstereo-core/src
	cargo fmt --all --check
	@! LC_ALL=C.UTF-8 git grep -nP '^.{111,}' -- '*.rs' || { echo 'the lines above have more than 110 columns'; exit 1; }
	cargo test --workspace --lib --bins --tests --quiet
	cargo test --workspace --doc --quiet

# Checks that compile everything once more; `make test-long` runs them too.
lint: prerequisites
	cargo clippy --workspace --all-targets --quiet -- -D warnings
	cargo build --quiet --manifest-path tests/no_std_probe/Cargo.toml --target-dir target/no_std_probe
	.ci/bare-metal.sh
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet

test-python: prerequisites $(BIN)/python
	@# Most of what is installed is never imported: compiling it would take half a minute.
	$(BIN)/pip install --quiet --no-compile '.[test]' './bench[batch,physics]'
	@# It would bring a second OpenCV with it; only its recordings are read.
	$(BIN)/pip install --quiet --no-deps pytac3d==3.3.0.9
	@.ci/second-opinion.sh
	cargo build --quiet --workspace --bins --example world_server
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --strict python/gelstereo bench/gelstereo_bench
	$(BIN)/python -m mypy.stubtest gelstereo._native
	GELSTEREO_HOST=$(DEBUG_HOST) $(BIN)/pytest -n auto -m "not long and not realtime"
	GELSTEREO_HOST=$(DEBUG_HOST) $(BIN)/pytest -m "realtime and not long"

# The live outputs are optional features; the everyday build stays light without them. They are built in the profile
# of the tests and for the whole workspace, which has most of their dependencies already.
LIVE_FEATURES := gelstereo-host/zenoh,gelstereo-host/foxglove
ROS_PEER := $(CURDIR)/target/ros_peer

test-long: export GELSTEREO_HOST := $(HOST)
test-long: export GELSTEREO_HOST_LIVE := $(DEBUG_HOST)
test-long: export GELSTEREO_ROS_PEER := $(ROS_PEER)/debug/ros-peer
test-long: prerequisites $(BIN)/python lint
	@.ci/long-prerequisites.sh
	$(BIN)/pip install --quiet '.[test,long]' './bench[batch,physics]'
	cargo build --release --quiet -p gelstereo-host --bins --example world_server
	GELSTEREO_KILLS=25 cargo test --quiet --workspace --test all -- faults::
	GELSTEREO_LONG_FRAMES=3000 cargo test --quiet --workspace --test long_run
	GELSTEREO_SOAK_FRAMES=2000 cargo test --quiet --workspace --test all -- row_35_a_localizer
	@# Many seeds and many configurations: worth a build of the host with optimisation.
	GELSTEREO_SEEDS=3 cargo test --quiet --config 'profile.dev.package.gelstereo-host.opt-level=2' --workspace --test all -- --ignored --skip faults::
	$(MAKE) long-builds
	GELSTEREO_RUNS=3 $(BIN)/pytest -m "long and realtime"
	$(BIN)/pytest -n auto -m "long and not realtime"
	@# One waits for compilers and emulators of one thread where the other computes.
	$(MAKE) --jobs=2 same-bits fuzz
	@echo "all long tests passed"

# Not beside tests that keep a camera's pace: on two cores the builds made their watchdogs act.
long-builds:
	cargo build --quiet --workspace --bin gelstereo-host --features $(LIVE_FEATURES)
	CARGO_PROFILE_DEV_DEBUG=0 cargo build --quiet --manifest-path tests/ros_peer/Cargo.toml --target-dir $(ROS_PEER)

# Digests of results on other processors and builds. Beside another target, cargo must not look for make's own jobs.
same-bits: prerequisites
	env -u MAKEFLAGS tests/same_bits/run.sh

# Cases that no run has tried yet, of every property test in Rust.
explore: prerequisites
	cargo test --workspace --quiet

# So many seconds for each target; a find ends it.
FUZZ_SECONDS ?= 3
fuzz: prerequisites
	cargo fmt --manifest-path fuzz/Cargo.toml --check
	env -u MAKEFLAGS fuzz/run.sh $(FUZZ_SECONDS)

# `make experiment WORDS="boards --output out/boards"`; without words it lists them.
WORDS ?= --help
experiment: prerequisites $(BIN)/python
	$(BIN)/pip install --quiet . ./bench
	$(BIN)/gelstereo experiment $(WORDS)

# `make frontier TOPIC=pipeline` measures whole pipelines, also on the pairs of bench/outside.
TOPIC ?= sensing
frontier: prerequisites $(BIN)/python
	$(BIN)/pip install --quiet . ./bench
	PYTHONPATH=bench $(BIN)/gelstereo frontier $(TOPIC)

# The documentation as a site in out/site; a broken link or anchor fails. `python -m http.server -d out/site` serves it.
docs: export NO_MKDOCS_2_WARNING = 1
docs: prerequisites $(BIN)/python
	$(BIN)/pip install --quiet '.[docs]'
	$(BIN)/mkdocs build --quiet --strict --site-dir $(abspath $(OUT))/site
	@echo "site: $(OUT)/site/index.html"

# Wheels, binaries and Debian packages for x86-64 and aarch64, in out/dist; needs rustup.
dist: prerequisites
	PYTHON=$(PYTHON) OUT=$(abspath $(OUT)) packaging/dist.sh

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

prerequisites:
	@PYTHON=$(PYTHON) .ci/prerequisites.sh

clean:
	rm -rf target fuzz/target fuzz/corpus fuzz/found $(VENV) $(OUT)
