"""The page of a run, read by Python's own HTML parser, against the run's summary and its recording."""

from __future__ import annotations

import base64
import json
import subprocess
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from test_recording_readers import host_binary

from gelstereo.view.steps import Steps

#: Elements without an end.
_VOID = {"meta", "br", "img", "link", "input"}


@dataclass
class Element:
    name: str
    attributes: dict[str, str]
    children: list[Element | str] = field(default_factory=list)

    def find_all(self, name: str) -> list[Element]:
        found = [self] if self.name == name else []
        for child in self.children:
            found += child.find_all(name) if isinstance(child, Element) else []
        return found

    def by_id(self, name: str) -> Element:
        (found,) = [element for element in self.all() if element.attributes.get("id") == name]
        return found

    def all(self) -> list[Element]:
        inner = [element for child in self.children if isinstance(child, Element) for element in child.all()]
        return [self, *inner]

    @property
    def text(self) -> str:
        return "".join(child if isinstance(child, str) else child.text for child in self.children)


class Tree(HTMLParser):
    """A page as a tree; elements must end in the order in which they began."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.root = Element("", {})
        self._open = [self.root]
        self.feed(page)
        self.close()
        assert self._open == [self.root], [element.name for element in self._open]

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {name: value or "" for name, value in attributes})
        self._open[-1].children.append(element)
        if tag not in _VOID:
            self._open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop().name == tag

    def handle_data(self, data: str) -> None:
        self._open[-1].children.append(data)


def run_host(folder: Path, *words: str, config: str = "", code: int = 0) -> dict[str, Any]:
    """The summary of a run in a folder."""
    (folder / "cell.toml").write_text(config)
    command = [host_binary(), "run", "--config", "cell.toml", "--json", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return dict(json.loads(done.stdout))


@dataclass(frozen=True)
class Run:
    summary: dict[str, Any]
    page: Element
    recording: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("run")
    summary = run_host(folder, "--record", "run.mcap")
    return Run(summary, Tree((folder / "run.html").read_text()).root, folder / "run.mcap")


def test_the_page_says_in_one_sentence_why_the_run_ended(run: Run) -> None:
    assert run.summary["page"] == {"path": "run.html", "fault": None}
    depth_mm = run.summary["outcome"]["depth_mm"]
    sentence = run.page.by_id("outcome").text
    assert sentence.startswith(f"Inserted: felt the bottom at a depth of {depth_mm:.2f} mm")
    assert sentence.endswith(" mm.") and ". " not in sentence


def test_every_stage_stands_in_the_table_with_its_figures(run: Run) -> None:
    rows = run.page.by_id("stages").find_all("tr")[1:]
    assert [row.find_all("th")[0].text for row in rows] == [s["stage"] for s in run.summary["stages"]]
    for row, stage in zip(rows, run.summary["stages"], strict=True):
        wall_s, source_s, frames, bad_frames, figures = (cell.text for cell in row.find_all("td"))
        assert float(wall_s) == pytest.approx(stage["wall_s"], abs=6e-4)
        assert float(source_s) == pytest.approx(stage["source_s"], abs=6e-4)
        assert (int(frames), int(bad_frames)) == (stage["frames"], stage["bad_frames"])
        for figure in stage["figures"]:
            value = figures.split(figure["name"].rsplit("_", 1)[0].replace("_", " "), 1)[1].split()[0]
            assert float(value) == pytest.approx(figure["value"], abs=6e-4)


def test_each_picture_is_the_last_left_image_of_its_stage(run: Run) -> None:
    pictures = [svg for svg in run.page.find_all("svg") if svg.find_all("image")]
    names = [svg.find_all("title")[0].text.partition(":")[0] for svg in pictures]
    assert names == [stage["stage"] for stage in run.summary["stages"]]
    steps = {step.stage: step for step in Steps(run.recording)}
    for name, svg in zip(names, pictures, strict=True):
        head, _, data = svg.find_all("image")[0].attributes["href"].partition(",")
        assert head == "data:image/png;base64"
        file = np.frombuffer(base64.b64decode(data), np.uint8)
        shown = cv2.imdecode(file, cv2.IMREAD_UNCHANGED)
        assert shown.shape == (480, 640)
        if name == "open":  # its frames are not recorded
            continue
        assert np.array_equal(shown, steps[name].image.pixels())
        rings = sum(
            path.attributes["d"].count("a") // 2
            for path in svg.find_all("path")
            if path.attributes["class"] != "motion"
        )
        assert rings == 625


def test_the_plot_reaches_both_triggers(run: Run) -> None:
    (plot,) = [svg for svg in run.page.find_all("svg") if svg.attributes.get("class") == "plot"]
    words = [text.text for text in plot.find_all("text")]
    assert {"grasp", "insertion", "end", *(s["stage"] for s in run.summary["stages"][1:])} <= set(words)
    (curve,) = [path for path in plot.find_all("path") if path.attributes["class"] == "curve"]
    frames = sum(stage["frames"] for stage in run.summary["stages"])
    assert curve.attributes["d"].count("M") + curve.attributes["d"].count("L") == frames


def test_the_page_needs_no_network_and_no_mouse(run: Run) -> None:
    html = run.page.find_all("html")[0]
    assert html.attributes["lang"] == "en" and run.page.find_all("title")[0].text
    assert not run.page.find_all("script") and not run.page.find_all("link")
    for element in run.page.all():
        for name in ("href", "src", "srcset", "action"):
            assert element.attributes.get(name, "data:").startswith("data:"), element.name
        assert not any(name.startswith("on") for name in element.attributes)
        if element.name == "svg":
            assert element.attributes["role"] == "img" and element.attributes["aria-label"]
        if element.name == "table":
            assert element.find_all("thead") and all(
                "scope" in th.attributes for th in element.find_all("th")
            )
    assert "url(" not in run.page.find_all("style")[0].text


def test_pose_and_truth_are_those_of_the_summary(run: Run) -> None:
    localized = run.summary["localized"]
    rows = run.page.by_id("pose").find_all("tr")[1:4]
    for axis, row in enumerate(rows):
        in_gripper, in_sensor, sigma, _ = (cell.text for cell in row.find_all("td"))
        assert float(in_gripper) == pytest.approx(localized["t_gripper_object"][axis][3], abs=6e-4)
        assert float(in_sensor) == pytest.approx(localized["t_sensor_object"][axis][3], abs=6e-4)
        assert float(sigma) == pytest.approx(localized["sigma"][axis], abs=6e-5)
    assert run.page.by_id("free").text == f"The contact leaves free: {'; '.join(localized['free'])}."
    assert "The outcome above is true." in run.page.text


def test_a_part_that_is_not_there_is_not_grasped_and_the_page_shows_how_far_it_came(tmp_path: Path) -> None:
    config = "[simulated]\nshape = { kind = 'cylinder', radius_mm = 0.5, length_mm = 40.0 }\n"
    summary = run_host(tmp_path, "--record", "run.mcap", config=config, code=1)
    assert summary["outcome"]["kind"] == "not_grasped"
    page = Tree((tmp_path / "run.html").read_text()).root
    assert page.by_id("outcome").text.startswith("Not grasped: the fingers rest at ")
    rows = page.by_id("stages").find_all("tr")[1:]
    assert [row.find_all("th")[0].text for row in rows] == ["open", "rest", "close"]


def test_a_hostile_name_stays_a_name(tmp_path: Path) -> None:
    name = "<img src=x onerror=alert(1)>&\"'<script>"
    run_host(tmp_path, "--record", f"{name}.mcap", config="[task]\ninsertion_speed_mm_s = 20.0\n")
    page = Tree((tmp_path / f"{name}.html").read_text()).root
    assert page.find_all("h1")[0].text == f"{name}.mcap: inserted"
    assert not page.find_all("script") and not page.find_all("img")


def test_a_page_that_cannot_be_written_is_said_and_the_job_is_done(tmp_path: Path) -> None:
    (tmp_path / "run.html").mkdir()
    command = [host_binary(), "run", "--record", "run.mcap"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "inserted" in done.stdout
    assert "the run has no page: run.html cannot be written" in done.stderr
