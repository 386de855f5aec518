"""Definition of an experiment: its trials, how to run one, and the report on their records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gelstereo import Error
from gelstereo_bench.experiments.batch import Progress, Run, Trial, run_batch
from gelstereo_bench.experiments.report import Report, fill_page, write_report
from gelstereo_bench.experiments.store import Record, Store
from gelstereo_bench.reports.provenance import build_digest, digest_of

__all__ = ["Experiment", "Outcome", "carry_out"]


@dataclass(frozen=True)
class Experiment:
    """One of the paper's experiments.

    Attributes
    ----------
    name
        Name on the command line.
    repeats
        Number of repeats per case in the paper.
    inputs
        Scenes and settings of all trials, as TOML, by name.
    trials
        Creates all trials from the number of repeats and the seed. Trials are independent, and those of fewer
        repeats are a subset of those of more.
    run
        Runs one trial.
    report
        Creates the report from the records, in the order of the trials.
    """

    name: str
    repeats: int
    inputs: Callable[[], Mapping[str, str]]
    trials: Callable[[int, int], Sequence[Trial]]
    run: Run
    report: Callable[[Sequence[Trial], Sequence[Record]], Report]


@dataclass(frozen=True)
class Outcome:
    """Result of running an experiment.

    Attributes
    ----------
    trials
        Number of trials.
    report
        The HTML file.
    digest
        SHA-256 of the report.
    """

    trials: int
    report: Path
    digest: str


def carry_out(
    experiment: Experiment,
    folder: Path,
    *,
    repeats: int | None = None,
    seed: int = 1,
    workers: int = 1,
    scheduler_address: str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    page: Path | None = None,
) -> Outcome:
    """Run an experiment and write its report to ``report.html`` in a folder, beside the trials' records.

    Parameters
    ----------
    experiment
        The experiment.
    folder
        Output folder; created if it does not exist.
    repeats
        Repeats per case. Default: as in the paper.
    seed
        Seed of the batch.
    workers, scheduler_address, progress
        As in :func:`gelstereo_bench.experiments.batch.run_batch`.
    resume
        Whether to use trials already stored in the folder.
    page
        A Markdown page; the section with the experiment's name is replaced by the summary.

    Raises
    ------
    Error
        A number is out of range, or an error of `Store` or `run_batch`.
    """
    repeats = experiment.repeats if repeats is None else repeats
    if repeats < 1:
        raise Error(f"{repeats} trials of every case show nothing; valid is 1 or more")
    if not 0 <= seed < 1 << 53:
        raise Error(f"the seed {seed} is out of range; valid is 0 to {(1 << 53) - 1}")
    trials = experiment.trials(repeats, seed)
    identity = {
        "experiment": experiment.name,
        "seed": seed,
        "build of gelstereo": build_digest(),
        **{f"input {name}": digest_of(text) for name, text in experiment.inputs().items()},
    }
    with Store(folder, identity, resume=resume) as store:
        records = run_batch(
            experiment.run,
            trials,
            workers=workers,
            scheduler_address=scheduler_address,
            store=store,
            progress=progress,
        )
        path, report = folder / "report.html", experiment.report(trials, records)
        digest = write_report(path, report, seed=seed, trials=trials)
        if page is not None:
            fill_page(page, experiment.name, report, seed=seed, trials=trials)
    return Outcome(len(trials), path, digest)
