"""What an image shows: layouts of points, drawn and simulated prints, and real gels."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from real_data import DATA, needs

import gelstereo as gs
from gelstereo._native import parse_toml
from gelstereo.cli.main import main
from gelstereo.inspection import layout_of
from gelstereo.inspection.picture import draw_inspection

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
KINDS = ("square", "rectangular", "hexagonal")


def lattice(kind: str, rows: int, cols: int) -> Array:
    """Dots of a print, row by row, a step apart."""
    row, col = (grid.astype(float).ravel() for grid in np.mgrid[0:rows, 0:cols])
    if kind == "rectangular":
        col = 1.5 * col
    if kind == "hexagonal":
        row, col = row * 3.0**0.5 / 2.0, col + 0.5 * (row % 2.0)
    return np.column_stack([col, row])


def scattered(count: int, seed: int) -> Array:
    """Dots at random, at least 0.7 of their mean distance apart, as random prints are made."""
    random, side = np.random.default_rng(seed), count**0.5
    dots: list[Array] = []
    while len(dots) < count:
        dot = random.uniform(0.0, side, 2)
        if not dots or np.linalg.norm(np.array(dots) - dot, axis=1).min() > 0.7:
            dots.append(dot)
    return np.array(dots)


def seen(
    points: Array, step_px: float, turn_rad: float, tilt: float, bend: float, noise_px: float, seed: int
) -> Array:
    """Points as a camera sees them: turned, in perspective, bent, with noise."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    points = (points - points.mean(axis=0)) @ np.array([[cos, sin], [-sin, cos]])
    reach = np.abs(points).max()
    points = points / (1.0 + tilt * points[:, 1] / reach)[:, None]
    points[:, 0] += bend * (points[:, 1] / reach) ** 2 * reach
    noise = np.random.default_rng(seed).normal(0.0, noise_px, points.shape)
    return np.asarray(points * step_px + 320.0 + noise)


@pytest.mark.parametrize("kind", KINDS)
@given(
    rows=st.integers(5, 20),
    cols=st.integers(5, 20),
    turn=st.floats(-0.6, 0.6),
    tilt=st.floats(-0.2, 0.2),
    bend=st.floats(-0.1, 0.1),
    seed=st.integers(0, 999),
)
@settings(max_examples=60, deadline=None)
def test_layouts(kind: str, rows: int, cols: int, turn: float, tilt: float, bend: float, seed: int) -> None:
    points = seen(lattice(kind, rows, cols), 22.0, turn, tilt, bend, 0.4, seed)
    found = layout_of(points)
    assert found.kind == kind
    assert (found.rows, found.cols) == (rows, cols)
    assert found.is_whole and found.on_lattice == 1.0 and found.filled == 1.0
    places = {tuple(place) for place in found.places.tolist()}
    assert len(places) == rows * cols


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 999), share=st.floats(0.0, 0.1), specks=st.integers(0, 8))
@settings(max_examples=30, deadline=None)
def test_missing_dots_and_specks(kind: str, seed: int, share: float, specks: int) -> None:
    random = np.random.default_rng(seed)
    points = seen(lattice(kind, 12, 14), 22.0, 0.1, 0.1, 0.0, 0.4, seed)
    points = points[random.uniform(size=len(points)) >= share]
    low, high = points.min(axis=0), points.max(axis=0)
    found = layout_of(np.concatenate([points, random.uniform(low, high, (specks, 2))]))
    assert found.kind == kind
    assert abs(found.rows - 12) <= 1 and abs(found.cols - 14) <= 1
    assert found.on_lattice > 0.85


@given(count=st.integers(30, 300), seed=st.integers(0, 9999))
@settings(max_examples=60, deadline=None)
def test_scattered_dots_are_irregular(count: int, seed: int) -> None:
    found = layout_of(20.0 * scattered(count, seed))
    assert found.kind == "irregular" and found.rows == found.cols == 0 and not found.is_whole
    assert (found.places == -1).all()


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), max_size=30))
@settings(max_examples=100, deadline=None)
def test_any_points_have_a_layout(points: list[tuple[float, float]]) -> None:
    found = layout_of(np.array(points).reshape(-1, 2))
    assert len(found.places) == len(points)


def test_border_lines_seen_in_part_are_told() -> None:
    points = lattice("square", 10, 12)
    points = points[(points[:, 1] < 9.0) | (points[:, 0] < 5.0)]
    found = layout_of(20.0 * points)
    assert (found.rows, found.cols) == (10, 12) and found.borders[1] == pytest.approx(5 / 12)
    assert found.borders[0] == 1.0 and not found.is_whole


def drawn(
    points: Array, size_px: tuple[int, int], radius_px: float, gel: int, dot: int, seed: int = 0
) -> Image:
    """A print: discs on a gel, with noise of two levels."""
    times = 4
    image = np.full((size_px[1] * times, size_px[0] * times), gel, np.uint8)
    for x, y in points:
        centre = (round((x + 0.5) * times), round((y + 0.5) * times))
        cv2.circle(image, centre, round(radius_px * times), (dot,), -1)
    small = cv2.resize(image, size_px, interpolation=cv2.INTER_AREA).astype(np.float64)
    return np.clip(
        np.round(small + np.random.default_rng(seed).normal(0.0, 2.0, small.shape)), 0, 255
    ).astype(np.uint8)


@pytest.mark.parametrize("kind", KINDS)
@given(
    contrast=st.integers(35, 90),
    bright=st.booleans(),
    radius=st.floats(3.0, 6.0),
    turn=st.floats(-0.2, 0.2),
    seed=st.integers(0, 99),
)
@settings(max_examples=12, deadline=None)
def test_drawn_prints(kind: str, contrast: int, bright: bool, radius: float, turn: float, seed: int) -> None:
    points = seen(lattice(kind, 9, 10), 26.0, turn, 0.08, 0.0, 0.2, seed)
    assume(points.min() > 15.0)
    image = drawn(points, (640, 640), radius, 130, 130 + contrast if bright else 130 - contrast, seed)
    found = gs.inspect(image)
    assert found.polarity == ("bright" if bright else "dark")
    assert (found.layout.kind, found.layout.rows, found.layout.cols) == (kind, 9, 10)
    assert found.dot_px == pytest.approx(2.0 * radius, abs=1.5)
    assert found.contrast == pytest.approx(contrast, rel=0.2)
    assert found.noise == pytest.approx(2.0, rel=0.2)
    assert found.settings_result == "labels 9 rows x 10 columns"
    assert found.settings.get("lattice.layout", "square") == (
        "hexagonal" if kind == "hexagonal" else "square"
    )


def test_a_coloured_print_names_its_channel() -> None:
    print_px = seen(lattice("square", 9, 10), 26.0, 0.0, 0.0, 0.0, 0.2, 0)
    grey = drawn(print_px, (640, 640), 5.0, 130, 50)
    gel = drawn(print_px[:0], (640, 640), 5.0, 130, 50, 1)
    found = gs.inspect(np.stack([grey, gel, gel], axis=-1))
    assert found.channel == "blue" and found.settings["detect.channel"] == "blue"
    assert found.layout.kind == "square" and found.params.to_dict()["detect"]["channel"] == "blue"


@pytest.mark.parametrize("scene", ["marker_field", "dim_bright_dots", "dense_lattice", "rubbed_off"])
def test_simulated_sensors(scene: str) -> None:
    sensor = gs.simulate(scene)
    gel = sensor.scene.to_dict()["gel"]
    found = gs.inspect(sensor[0].left)
    assert found.layout.kind == "square" and (found.layout.rows, found.layout.cols) == (
        gel["rows"],
        gel["cols"],
    )
    assert found.polarity == ("bright" if gel["bright_dots"] else "dark")
    assert found.settings_result.startswith(f"labels {gel['rows']} rows x {gel['cols']} columns")


def test_a_large_image_takes_less_than_a_second() -> None:
    points = seen(lattice("square", 30, 55), 21.0, 0.0, 0.0, 0.0, 0.2, 0)
    points += [320.0, 40.0]
    image = drawn(points, (1280, 720), 5.0, 160, 60)
    gs.inspect(image)
    times = []
    for _ in range(3):
        start = time.perf_counter()
        gs.inspect(np.repeat(image[..., None], 3, axis=2))
        times.append(time.perf_counter() - start)
    assert min(times) < 1.0


def test_dots_wider_than_the_presets_background_are_seen() -> None:
    points = seen(lattice("square", 6, 10), 100.0, 0.0, 0.0, 0.0, 0.2, 0) + [320.0, 40.0]
    found = gs.inspect(drawn(points, (1280, 720), 27.0, 160, 60))
    assert len(found.dots_px) == 60 and found.dot_px == pytest.approx(54.0, abs=1.5)
    least, most = found.settings["detect.dot_px"]
    assert 1.3 * least < found.dot_px < most / 1.3
    assert found.settings_result == "labels 6 rows x 10 columns"


@pytest.mark.parametrize("level", [0, 128, 255])
@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3), (3, 3)])
def test_plain_images_show_nothing(level: int, shape: tuple[int, ...]) -> None:
    found = gs.inspect(np.full(shape, level, np.uint8))
    assert len(found.dots_px) == 0 and "none" in str(found) and not found.settings
    assert "refuses it" in found.preset_result


@given(seed=st.integers(0, 9999), smooth=st.integers(0, 4))
@settings(max_examples=20, deadline=None)
def test_noise_is_no_print(seed: int, smooth: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (120, 160)).astype(np.float64)
    if smooth:
        image = cv2.GaussianBlur(image, (0, 0), smooth)
    found = gs.inspect(np.clip(image, 0, 255).astype(np.uint8))
    assert found.layout.kind == "irregular"
    assert str(found) and draw_inspection(image.astype(np.uint8), found).shape == (120, 160, 3)


def test_other_arrays_are_refused() -> None:
    with pytest.raises(gs.ImageError, match="float32"):
        gs.inspect(np.zeros((9, 9), np.float32))
    with pytest.raises(gs.ImageError):
        gs.inspect(np.zeros(9, np.uint8))


@needs("9dtact_calib")
@pytest.mark.parametrize("name", ["s1_sample.png", "s2_sample.png"])
def test_a_real_board(name: str) -> None:
    found = gs.inspect(cv2.imread(str(DATA / "9dtact_calib" / name)))
    assert (found.layout.kind, found.layout.rows, found.layout.cols) == ("square", 7, 9)
    assert found.settings_result.startswith("labels 7 rows x 9 columns")


@needs("khsu_markers")
def test_a_real_gel_that_is_wider_than_the_view() -> None:
    found = gs.inspect(cv2.imread(str(DATA / "khsu_markers" / "pic00.jpg")))
    assert found.channel == "blue" and found.polarity == "dark" and found.layout.kind == "square"
    # Counted in the image: seven rows have all of their dots between the blurred borders.
    assert found.layout.rows == 7 and not found.layout.is_whole and "lattice.rows" not in found.settings
    # No setting may lose what the preset labels by itself.
    assert "labels 7 rows x 11 columns" in found.preset_result
    assert "labels 7 rows x 11 columns" in found.settings_result


@needs("khsu_markers")
@pytest.mark.parametrize("scale", [1.5, 2.0])
def test_a_real_gel_in_a_larger_image(scale: float) -> None:
    image = cv2.imread(str(DATA / "khsu_markers" / "pic00.jpg"))
    found = gs.inspect(cv2.resize(image, None, fx=scale, fy=scale))
    assert (found.layout.kind, found.layout.rows, found.layout.cols) == ("square", 7, 11)
    assert 75 <= len(found.dots_px) <= 80 and "labels" in found.settings_result


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = [tmp_path / "one.png", tmp_path / "other.png"]
    points = seen(lattice("square", 9, 10), 26.0, 0.0, 0.0, 0.0, 0.2, 0)
    for name in names:
        cv2.imwrite(str(name), drawn(points, (640, 640), 5.0, 80, 190))
    toml = tmp_path / "cell.toml"
    assert (
        main(["inspect", str(names[0]), "--output", str(tmp_path / "seen.png"), "--settings", str(toml)]) == 0
    )
    out = capsys.readouterr().out
    assert "90 bright ones" in out and "square" in out and "labels 9 rows x 10 columns" in out
    assert cv2.imread(str(tmp_path / "seen.png")).shape == (640, 640, 3)
    written = parse_toml(toml.read_text())
    assert written["preset"] == "balanced" and written["params"]["detect"]["polarity"] == "bright"
    assert written["params"]["lattice"] == {"rows": 9, "cols": 10}
    assert main(["inspect", *map(str, names), "--output", str(tmp_path / "all")]) == 0
    assert (tmp_path / "all" / "one.png").is_file() and (tmp_path / "all" / "other.png").is_file()
    assert main(["inspect", str(tmp_path / "absent.png")]) == 2
    assert "absent.png" in capsys.readouterr().err
