"""Row 46: dim prints and uneven light, on discs that NumPy draws, beside plain OpenCV
(`bench/outside/discs.py`).
"""

from __future__ import annotations

import pytest

from outside.discs import CONDITIONS, Condition
from outside.judge_discs import judged

#: Half the contrast that is left of a print beside a tray, and light that falls to a quarter.
DIM = {
    **{
        name: CONDITIONS[name]
        for name in ("contrast 25", "contrast 25, tray", "uneven light", "uneven light, tray")
    },
    "contrast 45, tray": Condition(contrast_levels=45.0, tray=True),
    "contrast 25, half the light, tray": Condition(contrast_levels=25.0, far_light=0.5, tray=True),
}


@pytest.mark.parametrize("name", DIM)
def test_row_46_dim_prints_and_uneven_light_are_seen_as_plain_opencv_sees_them(name: str) -> None:
    scores = judged(DIM[name], 1, ("fast", "balanced", "exact"))
    plain = scores.pop("OpenCV")
    assert plain.found_share > 0.99, "OpenCV serves as the measure"
    for preset, score in scores.items():
        assert not score.failed, f"{preset}: {score.failed[0]}"
        assert score.found_share >= plain.found_share - 0.001, f"{preset} finds {score.found_share:.2%}"
        assert score.seen >= 0.995 * score.named, f"{preset} sees {score.seen} of {score.named}"
        assert score.wrong == 0, f"{preset} names {score.wrong} wrong"
