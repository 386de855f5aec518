"""The topic `gelstereo frontier pipeline`: measures whole pipelines, and fills its page and pictures."""

from __future__ import annotations

from pathlib import Path

from gelstereo_bench.frontier.page import check_page, fill_page
from gelstereo_bench.frontier.pipeline.budget_report import budget_table, draw_budgets
from gelstereo_bench.frontier.pipeline.budgets import measure_budgets
from gelstereo_bench.frontier.pipeline.kept import Kept
from gelstereo_bench.frontier.pipeline.picture import draw_front
from gelstereo_bench.frontier.pipeline.sensors import sensing_methods
from gelstereo_bench.frontier.pipeline.simulated import simulated_cases
from gelstereo_bench.frontier.pipeline.study import Extent, measure
from gelstereo_bench.frontier.pipeline.tables import ORIGINS, PIPELINE_SECTIONS, front_tables, points_of
from gelstereo_bench.frontier.pipeline.traced import traced_cases
from gelstereo_bench.frontier.table import Table
from gelstereo_bench.reports.markdown import table
from gelstereo_bench.reports.provenance import processor

__all__ = ["FULL", "QUICK", "run_pipeline"]

#: Guesses off by 5 degrees and 1 mm differ little in success, so seeds count for more than starts.
FULL = Extent(every=1, seeds=8, traced_seeds=2, starts=2, budget_seeds=16, law_seeds=12)
QUICK = Extent(every=4, seeds=1, traced_seeds=1, starts=1, budget_seeds=1, law_seeds=1)


def run_pipeline(docs: Path, results: Path, extent: Extent) -> Path:
    """Measure what `results` does not hold, fill the page's tables, and draw its pictures.

    Parameters
    ----------
    docs
        Folder with accuracy-vs-time.md and the folder of pictures.
    results
        Folder of finished measurements. An interrupted run resumes from them.
    extent
        How much is measured.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    Error
        The page has no place for a table, the results are in use or damaged, or ``bench`` is not on Python's
        path.
    """
    page = docs / "accuracy-vs-time.md"
    check_page(page, PIPELINE_SECTIONS)
    cases = [*simulated_cases(), *traced_cases()[:: extent.every]]
    with Kept(results / "pipeline.jsonl") as kept:
        study = measure(kept, cases, sensing_methods(), extent)
        budgets = measure_budgets(kept, extent.budget_seeds, extent.law_seeds, extent.every)
    depth, poses = points_of(study)
    tables: list[Table] = [*front_tables(study, depth, poses), budget_table(budgets)]
    texts = {each.name: table(each.head, each.rows) for each in tables}
    fill_page(page, {"front-conditions": _conditions(extent, len(study.combinations)), **texts})
    draw_front(docs / "pictures" / "price-of-accuracy.png", depth, poses)
    draw_budgets(docs / "pictures" / "search-budget.png", budgets)
    return page


def _conditions(extent: Extent, combinations: int) -> str:
    simulated, traced = ORIGINS
    return (
        f"Images: {simulated}, {extent.seeds} seeds of every scene, each with another pose and noise; and "
        f"{traced} (`bench/outside`, the half for work), {extent.traced_seeds} noises of every sequence. "
        f"{extent.starts} guesses for every pose, off by 5 degrees and 1 mm. {combinations} combinations "
        f"with registration. Times: through the Python binding, one thread, {processor()}; methods take "
        "turns. Intervals: 95 %, bootstrap over seeds for errors, Wilson for success."
    )
