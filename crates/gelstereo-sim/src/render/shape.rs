//! Regions covered by ink: ellipses and bars, cut by horizontal lines.

use super::Ellipse;
use gelstereo_core::math::{DVec2, sqrt};

/// A convex region of the image with sharp edges, pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub(crate) low: DVec2,
    pub(crate) high: DVec2,
    /// Radius of a circle about its middle that contains it.
    radius: f64,
    outline: Outline,
}

#[derive(Clone, Copy, Debug)]
enum Outline {
    /// A line at dy from the centre is cut at dy·slope -+ widest·sqrt(1 - dy² per_yy).
    Ellipse {
        centre: DVec2,
        per_yy: f64,
        slope: f64,
        widest: f64,
    },
    Bar([DVec2; 4]),
}

impl Shape {
    /// `None` for an ellipse without area or with a non-finite place.
    pub(crate) fn ellipse(ellipse: &Ellipse) -> Option<Self> {
        let ([a, b], centre) = (ellipse.half_px, ellipse.centre_px);
        let (xy, yy) = (a.x * a.y + b.x * b.y, a.y * a.y + b.y * b.y);
        let reach = ellipse.reach_px();
        let (low, high) = (centre - reach, centre + reach);
        let outline = Outline::Ellipse {
            centre,
            per_yy: 1.0 / yy,
            slope: xy / yy,
            widest: a.perp_dot(b).abs() / reach.y,
        };
        (yy > 0.0 && low.is_finite() && high.is_finite()).then_some(Self {
            low,
            high,
            radius: ellipse.longest_px(),
            outline,
        })
    }

    /// Corners in order around the bar; `None` if one is not finite.
    pub(crate) fn bar(corners: [DVec2; 4]) -> Option<Self> {
        let low = corners.iter().fold(DVec2::INFINITY, |low, &corner| low.min(corner));
        let high = corners.iter().fold(DVec2::NEG_INFINITY, |high, &corner| high.max(corner));
        let placed = corners.iter().all(|corner| corner.is_finite());
        placed.then_some(Self {
            low,
            high,
            radius: 0.5 * (high - low).length(),
            outline: Outline::Bar(corners),
        })
    }

    /// Whether any of it, widened by `widened`, is in an image of that size.
    pub(crate) fn seen(&self, widened: f64, size: [usize; 2]) -> bool {
        let end = DVec2::new(size[0] as f64, size[1] as f64) - 0.5 + widened;
        self.high.cmpgt(DVec2::splat(-0.5 - widened)).all() && self.low.cmplt(end).all()
    }

    /// Whether the two may overlap, by their bounding boxes and circles.
    pub(crate) fn may_overlap(&self, other: &Self) -> bool {
        let twice_apart = (self.low + self.high - other.low - other.high).length_squared();
        let reach = self.radius + other.radius;
        self.low.cmplt(other.high).all()
            && other.low.cmplt(self.high).all()
            && twice_apart < 4.0 * reach * reach
    }

    /// Moved by an offset.
    pub(crate) fn moved(&self, by: DVec2) -> Self {
        let outline = match self.outline {
            Outline::Ellipse { centre, per_yy, slope, widest } => {
                Outline::Ellipse { centre: centre + by, per_yy, slope, widest }
            }
            Outline::Bar(corners) => Outline::Bar(corners.map(|corner| corner + by)),
        };
        Self { low: self.low + by, high: self.high + by, radius: self.radius, outline }
    }

    /// Scaled to `times` pixels per pixel, with the origin moved by `origin` pixels to the upper left.
    pub(crate) fn magnified(&self, times: usize, origin: [f64; 2]) -> Self {
        let by = times as f64;
        let move_ = |p: DVec2| (p + DVec2::from_array(origin)) * by + 0.5 * (by - 1.0);
        let outline = match self.outline {
            Outline::Ellipse { centre, per_yy, slope, widest } => {
                let per_yy = per_yy / (by * by);
                Outline::Ellipse { centre: move_(centre), per_yy, slope, widest: widest * by }
            }
            Outline::Bar(corners) => Outline::Bar(corners.map(move_)),
        };
        Self { low: move_(self.low), high: move_(self.high), radius: self.radius * by, outline }
    }

    /// Entry and exit of a horizontal line at `y`, which must lie between the region's ends.
    pub(crate) fn cut(&self, y: f64) -> (f64, f64) {
        let [[from], [to]] = self.cuts([y]);
        (from, to)
    }

    /// Entries and exits of several lines.
    #[inline]
    pub(crate) fn cuts<const COUNT: usize>(&self, heights: [f64; COUNT]) -> [[f64; COUNT]; 2] {
        let mut ends = [[0.0; COUNT]; 2];
        let [from, to] = &mut ends;
        match &self.outline {
            // Separate loops, which vectorise except for the root.
            &Outline::Ellipse { centre, per_yy, slope, widest } => {
                for (half, y) in to.iter_mut().zip(heights) {
                    let dy = y - centre.y;
                    *half = (1.0 - dy * dy * per_yy).abs(); // 0 at its ends, up to rounding
                }
                to.iter_mut().for_each(|half| *half = sqrt(*half));
                for ((from, to), y) in from.iter_mut().zip(to).zip(heights) {
                    let (middle, half) = (centre.x + (y - centre.y) * slope, widest * *to);
                    (*from, *to) = (middle - half, middle + half);
                }
            }
            Outline::Bar(corners) => {
                for ((from, to), y) in from.iter_mut().zip(to).zip(heights) {
                    (*from, *to) = cut_bar(corners, y);
                }
            }
        }
        ends
    }
}

fn cut_bar(corners: &[DVec2; 4], y: f64) -> (f64, f64) {
    let edges = [(0, 1), (1, 2), (2, 3), (3, 0)].map(|(i, j)| (corners[i], corners[j]));
    let crossing = |&(p, q): &(DVec2, DVec2)| {
        ((p.y <= y) != (q.y <= y)).then(|| p.x + (q.x - p.x) * ((y - p.y) / (q.y - p.y)))
    };
    let span = |(from, to): (f64, f64), x: f64| (from.min(x), to.max(x));
    edges.iter().filter_map(crossing).map(|x| (x, x)).reduce(|ends, (x, _)| span(ends, x)).unwrap_or_default()
}

/// Calls `draw` for the intervals of a line within any of the regions, from left to right.
pub(crate) fn each_interval(shapes: &[Shape], y: f64, mut draw: impl FnMut((f64, f64))) {
    let mut reached = f64::NEG_INFINITY;
    loop {
        // The leftmost interval among those that end beyond the drawn part.
        let crossed = shapes.iter().filter(|shape| shape.low.y < y && y < shape.high.y);
        let beyond = crossed.map(|shape| shape.cut(y)).filter(|&(from, to)| to > from.max(reached));
        let Some((from, to)) = beyond.reduce(|a, b| if b.0 < a.0 { b } else { a }) else { return };
        draw((from.max(reached), to));
        reached = to;
    }
}
