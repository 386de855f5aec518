"""Settings: one tree, declared in Rust, that Python reads, replaces and writes without a copy of
a default.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo import Error, Params, ParamsError, Scene, SceneError


@given(
    st.sampled_from(Params.presets()),
    st.floats(1e-6, 1e4),
    st.integers(2, 1000),
    st.sampled_from(["filterreg_point", "ransac_icp", "surface_close", "surface_search"]),
)
def test_text_and_values_keep_every_bit(preset: str, saliency_mm: float, rows: int, method: str) -> None:
    params = Params.preset(preset).replace(
        {"contact.saliency_mm": saliency_mm, "lattice": {"rows": rows}}, register={"method": method}
    )
    tree = params.to_dict()
    assert (tree["contact"]["saliency_mm"], tree["lattice"]["rows"], tree["register"]["method"]) == (
        saliency_mm,
        rows,
        method,
    )
    assert Params.from_toml(params.to_toml()) == params
    assert pickle.loads(pickle.dumps(params)) == params
    assert Params().replace(tree) == params


def test_an_empty_text_is_the_papers_configuration() -> None:
    assert Params.from_toml("") == Params() == Params.preset("paper")
    # Section V-B of the paper.
    tree = Params().to_dict()
    assert tree["detect"]["smooth_kernel_px"] == 3
    assert tree["detect"]["background_kernel_px"] == 51
    assert 255 - tree["detect"]["threshold_levels"] == 220
    # Rows and columns are counted.
    assert tree["lattice"] == {
        "layout": "square",
        "pitch_mm": 0.9,
        "max_missing_share": 0.01,
        "depth_mm": 0.0,
        "depth_sigma_mm": 0.0,
    }
    assert tree["track"]["gate_pitches"] == 0.5
    assert tree["label"]["tolerance_pitches"] == pytest.approx(1 / 3)
    paper = {"saliency": "depth", "saliency_mm": 0.35, "patch_share": 0.0}
    paper |= {"grasp_trigger_px": 10.0, "insertion_trigger_px": 5.0}
    assert paper.items() <= tree["contact"].items()
    rungs = [tree[s][r] for s, r in (("detect", "threshold"), ("track", "motion"), ("triangulate", "method"))]
    assert rungs == ["fixed", "still", "q"]


def test_replace_leaves_the_original_alone_and_none_restores_the_default() -> None:
    params = Params.preset("balanced")
    before = params.to_toml()
    changed = params.replace({"detect.threshold_levels": 20, "detect.centre": None})
    assert params.to_toml() == before
    assert changed.to_dict()["detect"]["threshold_levels"] == 20
    assert changed.to_dict()["detect"]["centre"] == Params().to_dict()["detect"]["centre"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"detect.treshold_levels": 20}, r"`treshold_levels = 20`: unknown field .*`threshold_levels`"),
        ({"detekt": {"centre": "grey"}}, r"unknown field `detekt`, expected one of .*`detect`"),
        ({"detect.centre": "gray"}, r"unknown variant `gray`, expected .*`grey`"),
        ({"detect.smooth_kernel_px": 4}, r"detect.smooth_kernel_px is 4; valid is odd"),
        ({"detect.smooth_kernel_px": "three"}, r"smooth_kernel_px = \"three\".*invalid type"),
        ({"contact.saliency_mm": float("nan")}, r"contact.saliency_mm is NaN"),
        ({"lattice.rows": -3}, r"rows = -3|-3"),
        (
            {"register.advanced.gel_scale": 0.0009},
            r"register.advanced.gel_scale is 0.0009; valid is from 0.001 to 1000",
        ),
        ({"register.advanced.gel_scale": 1001}, r"register.advanced.gel_scale is 1001"),
        (
            {"register.budget": 100},
            r"unknown field `budget`.*register.budget is now register.surface_search.budget",
        ),
        ({"register.method": "icp_plane"}, r"unknown variant `icp_plane`.*icp_plane is now surface_close"),
        ({"register.method": "filterreg_plane"}, r"filterreg_plane is now surface_search"),
        ({"register.method": "surface_track"}, r"surface_track is now surface_close"),
        ({"contact.saliency": "pressure_quick"}, r"pressure_quick is now pressure"),
        (
            {"contact.learn_decay": True, "contact.saliency": "depth"},
            r"contact.learn_decay = true requires contact.saliency = \"pressure\"",
        ),
        ({"detect": 3}, r"detect = 3"),
        ({"detect.centre": object()}, r"centre: the setting is of type object; valid is a number"),
        ({"lattice.rows": 2**70}, r"rows: 1180591620717411303424 does not fit into 64 bits"),
        ({3: 4}, r"a setting is named 3; valid is text"),
        ({"detect": {"centre": ["x" * 1000]}}, r"`centre = .{1,60}\.\.\.`"),
    ],
)
def test_settings_without_meaning_are_refused_by_name(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ParamsError, match=words):
        Params().replace(changes)


def test_dictionaries_without_an_end_are_refused() -> None:
    endless: dict[str, Any] = {}
    endless["detect"] = endless
    chain: list[Any] = []
    chain.append(chain)
    for changes in (endless, {"detect": {"centre": chain}}, {".".join(["a"] * 1000): 1}):
        with pytest.raises(ParamsError, match="more than 32 deep"):
            Params().replace(changes)
    with pytest.raises(ParamsError, match="line 1") as caught:
        Params.from_toml("a=" + "[" * 100_000)
    assert len(str(caught.value)) < 200


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "params.toml"
    Params.preset("balanced").save(path)
    assert Params.load(path) == Params.load(str(path)) == Params.preset("balanced")
    with pytest.raises(FileNotFoundError, match=r"absent\.toml"):
        Params.load(tmp_path / "absent.toml")
    with pytest.raises(ParamsError, match=r"name of a file: use load"):
        Params.from_toml("params.toml")
    with pytest.raises(ParamsError, match=r"line 3, `focus = 1`"):
        Params.from_toml("[detect]\n\nfocus = 1")
    with pytest.raises(ParamsError, match='no preset "best"; valid is "paper"'):
        Params.preset("best")


def test_every_error_is_an_error_of_gelstereo_and_a_value_error() -> None:
    import gelstereo

    names = [name for name in gelstereo.__all__ if name.endswith("Error") and name != "Error"]
    assert len(names) > 10
    for name in names:
        assert issubclass(getattr(gelstereo, name), Error), name
    assert issubclass(Error, ValueError)
    assert ParamsError.__module__ == "gelstereo"


def test_scenes_are_settings_too() -> None:
    scene = Scene().replace({"effects.grain": {}, "indenter": {"kind": "sphere", "radius_mm": 4}})
    assert scene.to_dict()["indenter"] == {"kind": "sphere", "radius_mm": 4.0}
    # Another kind shares no dimensions with the one before.
    other = scene.replace(indenter={"kind": "box", "size_mm": [1, 2, 3]}, effects={"grain": None})
    assert other.to_dict()["indenter"] == {"kind": "box", "size_mm": [1.0, 2.0, 3.0]}
    assert other.to_dict().get("effects", {}) == {}
    assert Scene.from_toml(scene.to_toml()).to_dict() == scene.to_dict()
    with pytest.raises(SceneError, match="unknown field `pitch`"):
        scene.replace({"gel.pitch": 1})
    with pytest.raises(SceneError, match=r"gel.pitch_mm is -1"):
        scene.replace({"gel.pitch_mm": -1.0})
