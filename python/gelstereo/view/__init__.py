"""A stereo frame and its results as one picture; drawn with OpenCV alone, so it works without a display."""

from gelstereo.view.moment import Moment
from gelstereo.view.picture import draw

__all__ = ["Moment", "draw"]
