"""Batches on a dask cluster: real schedulers and workers on this machine.

A file of its own: the cluster's threads draw from `random`, which property tests take for strategies that do
so.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from trials import TRIALS, draw, refuses, slowly

from gelstereo_bench.experiments import batch
from gelstereo_bench.experiments.batch import BatchError, run_batch
from gelstereo_bench.experiments.store import Record, Store


@pytest.fixture(scope="module")
def expected() -> list[Record]:
    """What the trials give when each is run by itself."""
    return [draw(trial.configuration, trial.seed) for trial in TRIALS]


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """A real scheduler with two workers of a thread each."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=":0"
        ) as local,
    ):
        yield local.scheduler_address


def test_a_cluster_changes_nothing(cluster: str, expected: list[Record]) -> None:
    assert run_batch(draw, TRIALS, scheduler_address=cluster) == expected


def test_a_cluster_tells_of_a_trial_that_fails(cluster: str) -> None:
    with pytest.raises(BatchError, match=f"case.*a.*seed {TRIALS[0].seed}.*no a today"):
        run_batch(refuses, TRIALS[:1], scheduler_address=cluster)


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(batch, "_CLUSTER_TIMEOUT_S", 0.3)
    with pytest.raises(BatchError, match=r"no dask scheduler answers at tcp://127\.0\.0\.1:9"):
        run_batch(draw, TRIALS, scheduler_address="tcp://127.0.0.1:9")


@pytest.mark.parametrize("address", ["x", "tcp://10.0.0.2", "10.0.0.2:port", "tcp://:8786", ""])
def test_what_is_no_address_is_refused_at_once(address: str) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(BatchError, match=r"is no scheduler's address; valid is .*tcp://10\.0\.0\.2:8786"):
        run_batch(draw, TRIALS, scheduler_address=address)


def test_a_scheduler_without_workers_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(batch, "_CLUSTER_TIMEOUT_S", 0.3)
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp://", dashboard_address=":0"
        ) as local,
        pytest.raises(BatchError, match="has no workers; start some: dask worker"),
    ):
        run_batch(draw, TRIALS, scheduler_address=local.scheduler_address)


def test_a_cluster_that_goes_away_is_told_of_and_what_it_did_is_kept(
    tmp_path: Path, expected: list[Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(batch, "_CLUSTER_TIMEOUT_S", 2.0)
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=":0"
        ) as local,
        Store(tmp_path, {}) as store,
        pytest.raises(BatchError, match=r"the cluster at .* gave trials up"),
    ):
        run_batch(
            slowly,
            TRIALS,
            scheduler_address=local.scheduler_address,
            store=store,
            progress=lambda done, total: local.close() if done == 2 else None,
        )
    with Store(tmp_path, {}, resume=True) as store:
        assert len(store.records) >= 2
        assert run_batch(draw, TRIALS, store=store) == expected
