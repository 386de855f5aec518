"""Reports of experiments: one valid file that needs no network, whose figures are those of the records."""

from __future__ import annotations

import base64
import copy
import dataclasses
import hashlib
import os
import re
import signal
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from gelstereo import Params, parts
from gelstereo.cli import main
from gelstereo.view.html import Details, Figure, Grid, Heading, Paragraph, document
from gelstereo_bench.experiments import boards, objects
from gelstereo_bench.experiments.batch import Trial, run_batch
from gelstereo_bench.experiments.boards_report import boards_report
from gelstereo_bench.experiments.command import EXPERIMENTS, experiment_of
from gelstereo_bench.experiments.experiment import carry_out
from gelstereo_bench.experiments.objects_report import TABLE
from gelstereo_bench.frontier.boards import BASELINE
from gelstereo_bench.frontier.rungs import RUNGS
from gelstereo_bench.frontier.scenes import BOARDS_MM

VOID = {"meta", "img", "br", "hr", "link"}


class Page(HTMLParser):
    """A page's tables by their captions, its pictures and its text; every element must be closed where it
    belongs.
    """

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tables: dict[str, list[list[str]]] = {}
        self.pictures: list[str] = []
        self.text: dict[str, str] = {}
        self.ids: list[str] = []
        self._open: list[str] = []
        self._caption = ""
        self._rows: list[list[str]] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = dict(attrs)
        assert len(names) == len(attrs)
        for name, value in attrs:
            assert name not in ("href", "srcset", "action") and not name.startswith("on")
            if name == "src":
                assert tag == "img" and value is not None and value.startswith("data:image/")
                self.pictures.append(value)
        if tag == "table":
            self._rows, self._caption = [], ""
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open and self._open.pop() == tag
        if tag == "table":
            assert self._caption not in self.tables
            self.tables[self._caption] = self._rows

    def handle_data(self, data: str) -> None:
        inside = self._open[-1] if self._open else ""
        self.text[inside] = self.text.get(inside, "") + data + "\n"
        if inside == "caption":
            self._caption += data
        elif inside in ("td", "th"):
            self._rows[-1][-1] += data


def check_pictures(page: Page) -> None:
    """Every picture opens, and none refers to anything outside itself."""
    for source in page.pictures:
        kind, _, data = source.partition(";base64,")
        content = base64.b64decode(data, validate=True)
        if kind in ("data:image/png", "data:image/jpeg"):
            assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR).std() > 5.0
            continue
        drawing = ElementTree.fromstring(content)
        assert drawing.tag == "{http://www.w3.org/2000/svg}svg"
        for element in drawing.iter():
            for name, value in element.attrib.items():
                if name.endswith("href"):
                    assert value.startswith(("#", "data:")), (element.tag, value)
                assert "url(http" not in value


def test_text_is_escaped_and_every_block_is_there() -> None:
    harm = "<script>alert('&')</script>"
    dot = cv2.imencode(".png", np.random.default_rng(1).integers(0, 255, (8, 8), np.uint8))[1].tobytes()
    text = document(
        harm,
        [
            Heading(harm),
            Heading("part", 3),
            Paragraph(harm),
            Grid(harm, [harm, "b"], [["1", harm]], words=True),
            Figure(harm, dot, "png", width_px=80),
            Details(harm, harm),
        ],
    )
    page = Page(text)
    assert "<script" not in text and "<script" in page.text["p"]
    assert page.tables == {harm: [[harm, "b"], ["1", harm]]}
    assert base64.b64decode(page.pictures[0].partition("base64,")[2]) == dot
    assert harm in page.text["pre"] and harm in page.text["summary"] and harm in page.text["title"]
    check_pictures(page)
    assert not re.search(r"https?://", text)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_trials_of_an_experiment_are_apart_and_grow_with_repeats(name: str) -> None:
    experiment = experiment_of(name)
    assert experiment.name == name
    few, more = ([trial.digest for trial in experiment.trials(count, 1)] for count in (1, 2))
    assert set(few) < set(more) and len(set(more)) == len(more)
    assert not set(few) & {trial.digest for trial in experiment.trials(2, 2)}
    assert all(isinstance(text, str) and text for text in experiment.inputs().values())


# Boards


def test_boards_are_the_papers_and_all_methods_measure_them() -> None:
    trials = boards.trials(boards.EXPERIMENT.repeats, 1)
    heights = [trial.configuration["protrusion_mm"] for trial in trials]
    assert sorted(set(heights)) == list(BOARDS_MM) == pytest.approx(np.arange(0.4, 1.81, 0.2))
    assert all(heights.count(height) == 2 * 5 for height in BOARDS_MM)  # two sensors, five presses
    names = list(boards.methods())
    assert {f"preset {preset}" for preset in Params.presets()} < set(names)
    assert BASELINE in names
    for rung in RUNGS:
        if rung.stage in ("detect", "label", "points"):
            assert f"{rung.stage}: {rung.name}" in names


Records = tuple[list[Trial], list[dict[str, Any]]]


@pytest.fixture(scope="module")
def pressed() -> Records:
    """Three boards that are really pressed, by all methods."""
    cases = {("boards", 0.4), ("boards", 1.8), ("refraction", 1.8)}
    trials = [
        trial
        for trial in boards.trials(1, 1)
        if (trial.configuration["sensor"], trial.configuration["protrusion_mm"]) in cases
    ]
    return trials, [boards.run(trial.configuration, trial.seed) for trial in trials]


def only(record: dict[str, Any], *names: str) -> dict[str, Any]:
    """A record of some of the methods."""
    return {"methods": {name: record["methods"][name] for name in names}}


def test_a_board_is_measured_within_what_the_paper_reports(
    pressed: Records,
) -> None:
    trials, records = pressed
    for trial, record in zip(trials, records, strict=True):
        assert list(record["methods"]) == list(boards.methods())
        for name in ("preset fast", "preset balanced", "preset exact"):
            errors = np.array(record["methods"][name]["errors_um"])
            assert len(errors) > 50 and abs(errors.mean()) < 5.0 and errors.std() < 15.0
        for name, found in record["methods"].items():
            straight = boards.methods()[name][0].to_dict()["triangulate"]["method"] == "q"
            if trial.configuration["sensor"] == "refraction" and straight:
                # Light bends towards the axis: the gel's depth seems less by about its index.
                assert np.mean(found["errors_um"]) < -100.0
            else:
                assert abs(np.mean(found["errors_um"])) < 10.0


def test_tables_of_boards_are_their_records(pressed: Records, tmp_path: Path) -> None:
    trials, records = pressed
    report = boards_report(trials, records, boards.inputs())
    page = Page(document(report.title, report.findings))
    heights = [table for caption, table in page.tables.items() if "over markers and presses" in caption]
    assert len(heights) == 4
    for sensor, tables in (("boards", heights[:2]), ("refraction", heights[2:])):
        rows = {row[0]: row[1:] for table in tables for row in table[1:]}
        assert set(rows) == {*boards.methods(), "the paper's sensor"}
        for name in boards.methods():
            errors = [
                record["methods"][name]["errors_um"]
                for trial, record in zip(trials, records, strict=True)
                if trial.configuration["sensor"] == sensor
            ]
            assert rows[name][:-1] == [f"{np.mean(e):+.1f} ± {np.std(e):.1f}" for e in errors]
            assert rows[name][-1] == f"{max((np.mean(e) for e in errors), key=abs):+.1f}"
    assert "simulated" in report.conditions


def test_a_refused_method_is_told_of(pressed: Records) -> None:
    trials, records = pressed
    changed = [only(record, "preset paper", "preset fast", "points: rays") for record in records[:2]]
    for record in changed:
        record["methods"]["preset paper"] = {"refused": "too few <markers>"}
    page = Page(document("x", boards_report(trials[:2], changed, {}).findings))
    assert page.tables[next(caption for caption in page.tables if "refusals" in caption)][1:] == [
        ["preset paper", "too few <markers>"]
    ]
    row = next(t for c, t in page.tables.items() if "presets" in c)[1]
    assert row == ["preset paper", "none", "none", "none"]


# Objects


@pytest.fixture(scope="module")
def contacts() -> Records:
    """Two contacts of the connector, really pressed."""
    trials = [t for t in objects.trials(2, 1) if t.configuration["object"] == "3.5 mm connector"]
    return trials, [objects.run(trial.configuration, trial.seed) for trial in trials]


def test_objects_are_the_papers_in_its_order() -> None:
    made = [item.make for item in objects.OBJECTS]
    assert made == list(parts.CONTACTS.values())
    assert set(objects.methods()) == {*(f"preset {name}" for name in Params.presets()), objects.BEST}


def test_an_object_is_sensed_and_found_where_it_is(contacts: Records) -> None:
    for trial, record in zip(*contacts, strict=True):
        found = record["methods"]
        assert list(found) == list(objects.methods())
        assert 0.5 < record["depth_mm"] < 1.5
        # A marker's depth is known to about 6 um (docs/accuracy-vs-time.md), with the paper's centres to 21.
        assert found["preset exact"]["height_um"] < 8.0 < found["preset paper"]["height_um"] < 30.0
        for result in found.values():
            assert objects._TOUCHING <= result["touching"] <= 625
            assert 0 < result["both"] <= min(result["touching"], result["salient"])
        assert found[objects.BEST]["within"]
        assert found[objects.BEST]["free"] >= 1  # it spins about its axis
        assert ("picture" in record) == (trial.configuration["press"] == 1)
    shown = contacts[1][0]
    truth, measured = np.array(shown["truth_mm"]), np.array(shown["found_mm"])
    rms_um = 1e3 * np.sqrt(np.mean((measured - truth) ** 2))
    assert rms_um == pytest.approx(shown["methods"][objects.BEST]["height_um"], abs=0.01)
    assert sum(shown["touching"]) == shown["methods"][objects.BEST]["touching"]
    assert truth.max() == pytest.approx(shown["depth_mm"], abs=1e-5)


def test_the_gallery_shows_every_object_and_its_table_is_the_records(contacts: Records) -> None:
    trials, records = contacts
    changed = copy.deepcopy(records)
    changed[1]["methods"]["preset paper"]["refused"] = "why"
    report = objects.EXPERIMENT.report(trials, changed)
    page = Page(document(report.title, report.findings))
    check_pictures(page)
    assert [source[:15] for source in page.pictures] == [
        "data:image/png;",
        "data:image/jpeg",
        "data:image/svg+",
    ]
    rows = {(row[0], row[1]): row[2:] for row in page.tables[TABLE][1:]}
    assert len(rows) == 2 * len(objects.methods())
    for method in objects.methods():
        results = [record["methods"][method] for record in records]
        row = rows["3.5 mm connector", method]
        assert rows["all", method] == row
        assert float(row[0]) == pytest.approx(
            np.sqrt(np.mean([r["height_um"] ** 2 for r in results])), abs=0.05
        )
        share = sum(r["both"] for r in results) / sum(r["salient"] for r in results)
        assert row[1] == f"{100 * share:.0f}"
        kept = results[:1] if method == "preset paper" else results
        assert row[3] == f"{sum(r['within'] for r in kept)} of 2" and row[6] == str(2 - len(kept))
        assert row[4] == f"{np.median([r['angle_deg'] for r in kept]):.2f}"
        assert row[5] == f"{np.median([r['shift_mm'] for r in kept]):.3f}"


def test_a_contact_that_was_refused_everywhere_has_no_figures(contacts: Records) -> None:
    trials, records = contacts
    changed = copy.deepcopy(records[1:])
    changed[0]["methods"] = {
        "preset fast": {
            **changed[0]["methods"]["preset fast"],
            "refused": "x",
            "salient": 0,
            "height_um": None,
        }
    }
    row = objects.EXPERIMENT.report(trials[1:], changed).summary[0].rows[0]
    assert row[2:4] == ["-", "-"] and row[5:] == ["0 of 1", "-", "-", "1"]


def test_a_method_that_senses_nothing_is_refused_alone(
    contacts: Records, monkeypatch: pytest.MonkeyPatch
) -> None:
    blind = Params.preset("fast").replace({"detect": {"threshold": "fixed", "threshold_levels": 255}})
    monkeypatch.setattr(objects, "methods", lambda: {"blind": blind, "preset fast": Params.preset("fast")})
    trial, record = contacts[0][1], contacts[1][1]
    found = objects.run(trial.configuration, trial.seed)["methods"]
    assert found["preset fast"] == record["methods"]["preset fast"]
    assert found["blind"].pop("refused")
    touching = found["preset fast"]["touching"]
    assert found["blind"] == {"height_um": None, "touching": touching, "salient": 0, "both": 0}


# The whole command


def test_processes_and_clusters_measure_boards_alike(pressed: Records) -> None:
    distributed = pytest.importorskip("distributed")
    trials = [Trial({**trial.configuration, "methods": ["preset fast"]}, trial.seed) for trial in pressed[0]]
    expected = [only(record, "preset fast") for record in pressed[1]]
    assert run_batch(boards.run, trials, workers=2) == expected
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=":0"
    ) as local:
        assert run_batch(boards.run, trials, scheduler_address=local.scheduler_address) == expected


def test_a_report_is_one_file_that_says_what_it_rests_on(pressed: Records, tmp_path: Path) -> None:
    trials, records = pressed
    known = {
        trial.digest: only(record, "preset fast", BASELINE)
        for trial, record in zip(trials, records, strict=True)
    }
    experiment = dataclasses.replace(
        boards.EXPERIMENT,
        trials=lambda repeats, seed: trials,
        run=lambda configuration, seed: known[Trial(configuration, seed).digest],
    )
    manual = tmp_path / "page.md"
    manual.write_text("before\n<!-- begin boards -->\n<!-- end boards -->\nafter\n")
    done = carry_out(experiment, tmp_path / "a", repeats=1, page=manual)
    written = manual.read_text()
    assert written.startswith("before\n") and written.endswith("after\n")
    assert "Simulated; " in written and "; 3 trials, seed 1, " in written
    summary = boards_report(trials, [known[trial.digest] for trial in trials], {}).summary
    for row in (row for grid in summary for row in grid.rows):
        assert f"| {' | '.join(row)} |" in written
    text = done.report.read_text()
    page = Page(text)
    check_pictures(page)
    assert not re.search(r"https?://", text)
    build = {row[0]: row[1] for row in page.tables["Build and machine"][1:]}
    assert (build["seed"], build["trials"]) == ("1", "3") and len(build["build of gelstereo"]) == 64
    assert [row[0] for row in page.tables["Inputs by the SHA-256 of their TOML"][1:]] == list(boards.inputs())
    for trial in trials:
        assert f"{trial.seed}" in page.text["pre"] and trial.digest[:12] in page.text["pre"]
    # Stopped in the middle of its second trial and gone on with, it is the same file.
    kept = (tmp_path / "a" / "records.jsonl").read_bytes().splitlines(keepends=True)
    resumed = tmp_path / "b"
    resumed.mkdir()
    (resumed / "batch.json").write_bytes((tmp_path / "a" / "batch.json").read_bytes())
    (resumed / "records.jsonl").write_bytes(kept[0] + kept[1][:100])
    again = carry_out(experiment, resumed, repeats=1, resume=True)
    assert again.digest == done.digest and again.report.read_text() == text
    assert again.digest == hashlib.sha256(text.encode()).hexdigest()


def test_a_command_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    """`gelstereo experiment boards` itself: killed after its first trials, and again when it has been
    resumed.
    """
    words = [
        sys.executable,
        "-c",
        "import sys; from gelstereo.cli import main; sys.exit(main())",
        "experiment",
    ]
    words += ["boards", "--trials", "1", "--output", str(tmp_path / "run")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    running = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=environment)
    assert running.stderr is not None
    for line in running.stderr:
        if re.match(r"boards [1-9]", line):
            running.kill()
            break
    running.communicate()
    kept = (tmp_path / "run" / "records.jsonl").read_bytes().count(b"\n")
    assert kept >= 1
    running = subprocess.Popen([*words, "--resume"], stderr=subprocess.PIPE, text=True, env=environment)
    assert running.stderr is not None
    assert running.stderr.readline() == f"boards {kept}/16\n"
    running.send_signal(signal.SIGINT)
    _, said = running.communicate()
    assert running.returncode == 130
    assert f"{kept} of 16 trials are kept in {tmp_path / 'run'}; --resume goes on" in said


def test_errors_of_the_command_help(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delitem(sys.modules, "gelstereo_bench.experiments.boards")
    monkeypatch.delitem(sys.modules, "gelstereo_bench.experiments.boards_report")
    monkeypatch.delitem(sys.modules, "gelstereo_bench.experiments.figures")
    assert main(["experiment", "boards", "--output", str(tmp_path)]) == 2
    expected = "`gelstereo experiment boards` needs matplotlib, which is not installed: pip install './bench'"
    assert expected in capsys.readouterr().err
    monkeypatch.undo()
    (tmp_path / "records.jsonl").write_text("{}\n")
    for words, expected in (
        (["--seed", "-1"], "valid is 0 to"),
        ([], "--resume uses them, and another folder begins anew"),
        (["--resume"], "does not say of what batch"),
    ):
        assert main(["experiment", "boards", "--output", str(tmp_path), *words]) == 2
        assert expected in capsys.readouterr().err
    for words, expected in (
        (["boards", "--trials", "0"], "valid is an integer of 1 or more"),
        (["boards", "--workers", "2", "--scheduler", "tcp://h:1"], "not allowed with"),
        (["planks"], "boards"),
    ):
        with pytest.raises(SystemExit):
            main(["experiment", "--output", str(tmp_path), *words])
        assert expected in capsys.readouterr().err
