"""An exported dataset under LeRobot's own loader. Run by tests/test_lerobot.py, where LeRobot and torch are.

EXPORTED is the dataset; TRUTH an .npz with what must be in it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets.compute_stats import get_feature_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset

EXPORTED = Path(os.environ["EXPORTED"])
DISPLACEMENT = "observation.tactile.displacement"
STATE = "observation.tactile.marker_state"
IMAGE = "observation.images.left"


@pytest.fixture(scope="module")
def truth() -> dict[str, np.ndarray]:
    with np.load(os.environ["TRUTH"]) as arrays:
        return dict(arrays)


@pytest.fixture(scope="module")
def dataset() -> LeRobotDataset:
    return LeRobotDataset("local/exported", root=EXPORTED)


def test_every_frame_is_what_was_recorded(dataset: LeRobotDataset, truth: dict[str, np.ndarray]) -> None:
    steps = len(truth["displacement_mm"])
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (2, 2 * steps, 30)
    for index in range(0, 2 * steps, 3):
        item, step = dataset[index], index % steps
        np.testing.assert_allclose(item[DISPLACEMENT].numpy(), truth["displacement_mm"][step], atol=2e-5)
        assert np.array_equal(item[STATE].numpy(), truth["state"][step])
        image = np.rint(item[IMAGE].numpy() * 255.0).astype(np.uint8)
        assert all(np.array_equal(colour, truth["left"][step]) for colour in image)
        assert (item["episode_index"], item["frame_index"], item["index"]) == (index // steps, step, index)
        assert item["timestamp"].item() == pytest.approx(step / 30.0)
        assert item["task"] == "grasp the peg"


def test_frames_before_and_after_are_found_by_time(truth: dict[str, np.ndarray]) -> None:
    near = LeRobotDataset(
        "local/exported", root=EXPORTED, delta_timestamps={DISPLACEMENT: [-1 / 30, 0.0, 1 / 30]}
    )
    item = near[5]
    assert item[DISPLACEMENT].shape == (3, *truth["displacement_mm"].shape[1:])
    np.testing.assert_allclose(item[DISPLACEMENT].numpy(), truth["displacement_mm"][4:7], atol=2e-5)
    assert near[0][f"{DISPLACEMENT}_is_pad"].tolist() == [True, False, False]


def test_one_episode_alone_and_batches(truth: dict[str, np.ndarray]) -> None:
    second = LeRobotDataset("local/exported", root=EXPORTED, episodes=[1])
    batch = next(iter(torch.utils.data.DataLoader(second, batch_size=4)))
    assert batch[DISPLACEMENT].shape == (4, *truth["displacement_mm"].shape[1:])
    assert batch["episode_index"].tolist() == [1, 1, 1, 1]


def test_statistics_are_those_lerobot_computes(dataset: LeRobotDataset, truth: dict[str, np.ndarray]) -> None:
    both = np.concatenate([truth["displacement_mm"]] * 2)
    expected = get_feature_stats(both.astype(np.float64), axis=0, keepdims=False)
    found = dataset.meta.stats[DISPLACEMENT]
    assert set(found) == set(expected)
    for name in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(found[name], expected[name], atol=1e-4, err_msg=name)
    assert dataset.meta.stats[IMAGE]["mean"].shape == (3, 1, 1)
    assert dataset.meta.stats[IMAGE]["mean"].mean() == pytest.approx(truth["left"].mean() / 255.0, abs=0.01)


def test_lerobot_writes_the_same_format(
    dataset: LeRobotDataset, truth: dict[str, np.ndarray], tmp_path: Path
) -> None:
    wanted = {
        name: dict(feature) for name, feature in dataset.features.items() if name.startswith("observation")
    }
    own = LeRobotDataset.create("local/own", 30, wanted, root=tmp_path / "own", use_videos=False)
    for step in range(6):
        left = np.repeat(truth["left"][step][:, :, None], 3, axis=2)
        frame = {DISPLACEMENT: truth["displacement_mm"][step].astype(np.float32), STATE: truth["state"][step]}
        own.add_frame({**frame, IMAGE: left, "task": "grasp the peg"})
    own.save_episode()
    own.finalize()
    again = LeRobotDataset("local/own", root=tmp_path / "own")
    assert again.hf_dataset.features == dataset.hf_dataset.features
    ours, theirs = (
        json.loads((root / "meta/info.json").read_text()) for root in (EXPORTED, tmp_path / "own")
    )
    assert set(ours) == set(theirs)
    same = ("codebase_version", "fps", "data_path", "chunks_size", "data_files_size_in_mb", "video_path")
    assert {key: ours[key] for key in same} == {key: theirs[key] for key in same}
    for name in ours["features"]:
        for key in ("dtype", "shape"):
            assert ours["features"][name][key] == theirs["features"][name][key]
    columns = set(again.meta.episodes.column_names)
    assert columns <= set(dataset.meta.episodes.column_names) | {"videos"}
    for key, value in again[3].items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == dataset[3][key].dtype and value.shape == dataset[3][key].shape, key
