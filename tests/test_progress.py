"""Progress of long jobs: by tqdm or by a bar of our own, and readable in a log file."""

from __future__ import annotations

import sys

import pytest

from gelstereo.progress import Progress, progress

Output = pytest.CaptureFixture[str]


@pytest.fixture
def without_tqdm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)


@pytest.fixture
def on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gelstereo.progress._shows_bars", lambda: True)


def test_items_are_the_same_with_and_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: Output, without_tqdm: None
) -> None:
    assert list(progress([1, 2, 3], "counting")) == [1, 2, 3]
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert list(progress([1, 2], "counting")) == [1, 2]
    assert capsys.readouterr().err.endswith(f"\rcounting [{'#' * 32}] 2/2\n")
    assert list(progress([], "counting")) == []
    assert capsys.readouterr().err == ""


def test_a_log_file_gets_a_line_for_each_tenth(capsys: Output) -> None:
    with Progress("adding") as shown:
        for done in range(101):
            shown(done, 100, f"item {done}")
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"adding {done}/100 item {done}" for done in range(0, 101, 10)]


def test_a_longer_name_is_covered_by_the_next(
    capsys: Output, without_tqdm: None, on_a_terminal: None
) -> None:
    with Progress("reading") as shown:
        shown(0, 2, "a long name")
        shown(1, 2, "short")
    before, after = capsys.readouterr().err.removeprefix("\r").split("\r")
    assert after.endswith("\n") and len(after) == len(before) + 1 and "name" not in after


def test_tqdm_draws_where_it_is_installed(capsys: Output, on_a_terminal: None) -> None:
    pytest.importorskip("tqdm")
    assert list(progress(range(3), "counting")) == [0, 1, 2]
    drawn = capsys.readouterr().err
    assert "counting: 100%" in drawn and "3/3" in drawn


def test_an_error_ends_the_line_of_the_bar(capsys: Output, without_tqdm: None, on_a_terminal: None) -> None:
    with pytest.raises(RuntimeError), Progress("failing") as shown:
        shown(0, 2)
        raise RuntimeError
    assert capsys.readouterr().err.endswith(" 0/2\n")
