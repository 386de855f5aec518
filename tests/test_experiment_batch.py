"""Batches of trials: the same records whoever runs them, and nothing lost when they are stopped."""

from __future__ import annotations

import fcntl
import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from trials import TRIALS, draw, not_json, refuses

from gelstereo_bench.experiments import batch
from gelstereo_bench.experiments.batch import BatchError, Trial, keyed_seed, run_batch
from gelstereo_bench.experiments.store import Record, Store, StoreError


@pytest.fixture(scope="module")
def expected() -> list[Record]:
    """What the trials give when each is run by itself."""
    return [draw(trial.configuration, trial.seed) for trial in TRIALS]


def test_one_worker_needs_no_library(expected: list[Record], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("joblib", "distributed", "dask"):
        monkeypatch.setitem(sys.modules, name, None)
    assert run_batch(draw, TRIALS) == expected
    with pytest.raises(BatchError, match=r"joblib.*\./bench\[batch\].*1 worker"):
        run_batch(draw, TRIALS, workers=2)
    with pytest.raises(BatchError, match=r"distributed.*\./bench\[batch\]"):
        run_batch(draw, TRIALS, scheduler_address="tcp://127.0.0.1:8786")


@pytest.mark.parametrize("workers", [2, 3])
def test_processes_change_nothing(workers: int, expected: list[Record]) -> None:
    pytest.importorskip("joblib")
    assert run_batch(draw, TRIALS, workers=workers) == expected


def test_a_worker_of_another_build_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BatchError, match="another build of gelstereo"):
        batch._run_chunk(draw, [(0, TRIALS[0])], "0" * 64)


def test_records_are_json_and_trials_say_why_they_fail() -> None:
    with pytest.raises(BatchError, match=r"is no JSON.*finite"):
        run_batch(not_json, TRIALS[:1])
    with pytest.raises(BatchError, match="no a today"):
        run_batch(refuses, TRIALS[:1])
    with pytest.raises(BatchError, match="0 workers"):
        run_batch(draw, TRIALS, workers=0)


def test_progress_counts_to_the_end_and_repeats_run_once(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    records = run_batch(draw, [*TRIALS, *TRIALS], progress=lambda done, total: told.append((done, total)))
    assert records[: len(TRIALS)] == records[len(TRIALS) :]
    assert told[0] == (0, len(TRIALS)) and told[-1] == (len(TRIALS), len(TRIALS))
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert run_batch(draw, []) == []


@given(trial_s=st.floats(1e-5, 3.0), count=st.integers(1, 4000), workers=st.integers(1, 64))
def test_tasks_take_half_a_second_and_hold_every_trial_once(trial_s: float, count: int, workers: int) -> None:
    numbered = list(enumerate([TRIALS[0]] * count))
    chunks = batch._Chunks(numbered, workers)
    sizes, indices = [], []
    for chunk in chunks:
        sizes.append(len(chunk))
        indices += [index for index, _ in chunk]
        chunks.learn(trial_s)
    assert indices == list(range(count))
    # A task is shorter only where the rest is shared out among all workers.
    left = count
    for size in sizes:
        assert size == 1 or size <= -(-left // workers)
        if left != count:
            assert size * trial_s >= batch.TASK_S or size == -(-left // workers)
        left -= size


# The folder


def test_a_folder_gives_finished_trials_back_without_running_them(
    tmp_path: Path, expected: list[Record]
) -> None:
    with Store(tmp_path, {"seed": 1}) as store:
        run_batch(draw, TRIALS[:7], store=store)
    with Store(tmp_path, {"seed": 1}, resume=True) as store:
        assert len(store.records) == 7
        assert run_batch(refuses, TRIALS[:7], store=store) == expected[:7]
        assert run_batch(draw, TRIALS, store=store) == expected


@given(cut=st.integers(0, 400))
def test_half_a_line_is_run_again(tmp_path_factory: pytest.TempPathFactory, cut: int) -> None:
    folder = tmp_path_factory.mktemp("cut")
    with Store(folder, {}) as store:
        whole = run_batch(draw, TRIALS[:3], store=store)
    path = folder / "records.jsonl"
    data = path.read_bytes()
    kept = data[: max(len(data) - cut, 0)]
    path.write_bytes(kept)
    with Store(folder, {}, resume=True) as store:
        assert len(store.records) == kept.count(b"\n")
        assert run_batch(draw, TRIALS[:3], store=store) == whole
    assert path.read_bytes() == data


def test_trials_of_another_batch_are_refused(tmp_path: Path) -> None:
    with Store(tmp_path, {"seed": 1, "input scene": "abc"}) as store:
        run_batch(draw, TRIALS[:2], store=store)
    with pytest.raises(StoreError, match="--resume uses them"):
        Store(tmp_path, {"seed": 1, "input scene": "abc"})
    with pytest.raises(StoreError, match=r'with another input scene \("abc" then, "abd" now\); name'):
        Store(tmp_path, {"seed": 1, "input scene": "abd"}, resume=True)
    with pytest.raises(StoreError, match=r"another input scene .* another seed \(1 then, 2 now\)"):
        Store(tmp_path, {"seed": 2}, resume=True)
    (tmp_path / "batch.json").unlink()
    with pytest.raises(StoreError, match="does not say of what batch"):
        Store(tmp_path, {"seed": 1}, resume=True)


def test_damage_is_named(tmp_path: Path) -> None:
    with Store(tmp_path, {}) as store:
        run_batch(draw, TRIALS[:3], store=store)
    path = tmp_path / "records.jsonl"
    lines = path.read_text().splitlines()
    for harm in ("{", "7", '{"trial": "x"}'):
        path.write_text("\n".join([lines[0], harm, lines[2], ""]))
        with pytest.raises(StoreError, match=r"records\.jsonl, line 2, is damaged"):
            Store(tmp_path, {}, resume=True)


def test_two_batches_do_not_share_a_folder(tmp_path: Path) -> None:
    with Store(tmp_path, {}), pytest.raises(StoreError, match="in use by another batch"):
        Store(tmp_path, {}, resume=True)
    with (tmp_path / "records.jsonl").open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody holds it any more


SLOW = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from trials import TRIALS, slowly
from gelstereo_bench.experiments.batch import run_batch
from gelstereo_bench.experiments.store import Store

def progress(done, total):
    print(done, flush=True)

with Store(Path(sys.argv[1]), {{"seed": 1}}) as store:
    run_batch(slowly, TRIALS, workers=int(sys.argv[2]), store=store, progress=progress)
"""


@pytest.mark.parametrize(("workers", "stop"), [(1, signal.SIGKILL), (1, signal.SIGINT), (2, signal.SIGINT)])
def test_what_was_finished_when_stopped_is_kept(
    tmp_path: Path, expected: list[Record], workers: int, stop: signal.Signals
) -> None:
    if workers > 1 and importlib.util.find_spec("joblib") is None:
        pytest.skip("joblib is not installed")
    code = SLOW.format(tests=str(Path(__file__).parent))
    running = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path), str(workers)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert running.stdout is not None
    seen = 0
    for line in running.stdout:
        seen = int(line)
        if seen >= 3:
            running.send_signal(stop)
            break
    running.communicate(timeout=200)
    assert running.returncode != 0
    with Store(tmp_path, {"seed": 1}, resume=True) as store:
        assert seen <= len(store.records) < len(TRIALS)
        assert run_batch(draw, TRIALS, store=store) == expected


def test_a_trials_digest_is_its_own() -> None:
    digests = {Trial({"a": 1, "b": 2}, 1).digest, Trial({"b": 2, "a": 1}, 1).digest}
    assert len(digests) == 1
    others = [Trial({"a": 1, "b": 2}, 2), Trial({"a": 1, "b": 2.5}, 1), Trial({"a": 1}, 1), Trial({}, 1)]
    assert len(digests | {trial.digest for trial in others}) == 5
    assert json.loads(json.dumps(keyed_seed(1, "x"))) < 1 << 48
