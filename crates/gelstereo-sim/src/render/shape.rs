//! What ink covers: ellipses and bars, cut by horizontal lines.

use super::Ellipse;
use gelstereo_core::math::{DVec2, ceil, floor, sqrt};

/// Horizontal lines per pixel row over which coverage is integrated; along a line it is exact.
const LINES_PER_ROW: u32 = 8;

/// A convex region of the image with sharp edges, pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub(crate) low: DVec2,
    pub(crate) high: DVec2,
    /// Of a circle about its middle that holds it.
    radius: f64,
    outline: Outline,
}

#[derive(Clone, Copy, Debug)]
enum Outline {
    /// A line at dy from the centre is cut from dy·slope -+ widest·sqrt(1 - dy²/yy).
    Ellipse {
        centre: DVec2,
        yy: f64,
        slope: f64,
        widest: f64,
    },
    Bar([DVec2; 4]),
}

impl Shape {
    /// `None` when it has no area or no place.
    pub(crate) fn ellipse(ellipse: &Ellipse) -> Option<Self> {
        let ([a, b], centre) = (ellipse.half_px, ellipse.centre_px);
        let (xy, yy) = (a.x * a.y + b.x * b.y, a.y * a.y + b.y * b.y);
        let reach = ellipse.reach_px();
        let (low, high) = (centre - reach, centre + reach);
        let outline = Outline::Ellipse { centre, yy, slope: xy / yy, widest: a.perp_dot(b).abs() / reach.y };
        (yy > 0.0 && low.is_finite() && high.is_finite()).then_some(Self {
            low,
            high,
            radius: ellipse.longest_px(),
            outline,
        })
    }

    /// Corners in order round the bar; `None` when one has no place.
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

    /// Whether any of it, widened so far, is in an image of that size.
    pub(crate) fn seen(&self, widened: f64, size: [usize; 2]) -> bool {
        let end = DVec2::new(size[0] as f64, size[1] as f64) - 0.5 + widened;
        self.high.cmpgt(DVec2::splat(-0.5 - widened)).all() && self.low.cmplt(end).all()
    }

    /// Whether both can have a point in common, as far as boxes and circles about them tell.
    pub(crate) fn may_overlap(&self, other: &Self) -> bool {
        let twice_apart = (self.low + self.high - other.low - other.high).length_squared();
        let reach = self.radius + other.radius;
        self.low.cmplt(other.high).all()
            && other.low.cmplt(self.high).all()
            && twice_apart < 4.0 * reach * reach
    }

    /// Moved by so much.
    pub(crate) fn moved(&self, by: DVec2) -> Self {
        let outline = match self.outline {
            Outline::Ellipse { centre, yy, slope, widest } => {
                Outline::Ellipse { centre: centre + by, yy, slope, widest }
            }
            Outline::Bar(corners) => Outline::Bar(corners.map(|corner| corner + by)),
        };
        Self { low: self.low + by, high: self.high + by, radius: self.radius, outline }
    }

    /// As counted in pixels so many times as narrow, from an origin so many pixels to the upper left.
    pub(crate) fn magnified(&self, times: usize, origin: [f64; 2]) -> Self {
        let by = times as f64;
        let move_ = |p: DVec2| (p + DVec2::from_array(origin)) * by + 0.5 * (by - 1.0);
        let outline = match self.outline {
            Outline::Ellipse { centre, yy, slope, widest } => {
                Outline::Ellipse { centre: move_(centre), yy: yy * by * by, slope, widest: widest * by }
            }
            Outline::Bar(corners) => Outline::Bar(corners.map(move_)),
        };
        Self { low: move_(self.low), high: move_(self.high), radius: self.radius * by, outline }
    }

    /// Where a horizontal line at `y` enters and leaves it; the second is not above the first where it does not.
    pub(crate) fn cut(&self, y: f64) -> (f64, f64) {
        match &self.outline {
            Outline::Ellipse { centre, yy, slope, widest } => {
                let dy = y - centre.y;
                let half = widest * sqrt((1.0 - dy * dy / yy).max(0.0));
                let middle = centre.x + dy * slope;
                (middle - half, middle + half)
            }
            Outline::Bar(corners) => {
                let edges = [(0, 1), (1, 2), (2, 3), (3, 0)].map(|(i, j)| (corners[i], corners[j]));
                let crossing = |&(p, q): &(DVec2, DVec2)| {
                    ((p.y <= y) != (q.y <= y)).then(|| p.x + (q.x - p.x) * ((y - p.y) / (q.y - p.y)))
                };
                let span = |(from, to): (f64, f64), x: f64| (from.min(x), to.max(x));
                edges.iter().filter_map(crossing).fold((f64::INFINITY, f64::NEG_INFINITY), span)
            }
        }
    }
}

/// Adds the share of every pixel that lies within any of the regions, times `share`.
pub(crate) fn cover(shapes: &[Shape], share: f64, canvas: &mut [f32], width: usize) {
    let height = canvas.len() / width;
    let low = shapes.iter().fold(f64::INFINITY, |low, shape| low.min(shape.low.y));
    let high = shapes.iter().fold(f64::NEG_INFINITY, |high, shape| high.max(shape.high.y));
    if !shapes.iter().any(|shape| shape.seen(0.0, [width, height])) {
        return;
    }
    let first = floor(low + 0.5).max(0.0) as usize;
    let last = (ceil(high - 0.5).max(0.0) as usize).min(height - 1);
    for y in first..=last {
        let (top, bottom) = (low.max(y as f64 - 0.5), high.min(y as f64 + 0.5));
        let step = (bottom - top).max(0.0) / f64::from(LINES_PER_ROW);
        let row = &mut canvas[y * width..][..width];
        for line in 0..LINES_PER_ROW {
            let at = top + (f64::from(line) + 0.5) * step;
            each_interval(shapes, at, |(from, to)| cover_line(row, from, to, share * step));
        }
    }
}

/// Whatever of a line lies in any of the regions, from left to right.
pub(crate) fn each_interval(shapes: &[Shape], y: f64, mut draw: impl FnMut((f64, f64))) {
    if let [shape] = shapes {
        return draw(shape.cut(y));
    }
    let mut reached = f64::NEG_INFINITY;
    loop {
        // The interval that begins left of all others among those that end beyond what is drawn.
        let beyond = shapes.iter().map(|shape| shape.cut(y)).filter(|&(from, to)| to > from.max(reached));
        let Some((from, to)) = beyond.reduce(|a, b| if b.0 < a.0 { b } else { a }) else { return };
        draw((from.max(reached), to));
        reached = to;
    }
}

/// Adds a line from `from` to `to` of the given thickness to a row.
fn cover_line(row: &mut [f32], from: f64, to: f64, thickness: f64) {
    // Measured from the left border of the first pixel.
    let (from, to) = ((from + 0.5).max(0.0), (to + 0.5).min(row.len() as f64));
    if to <= from {
        return;
    }
    let (first, last) = (from as usize, (to as usize).min(row.len() - 1));
    if first == last {
        row[first] += ((to - from) * thickness) as f32;
        return;
    }
    row[first] += ((first as f64 + 1.0 - from) * thickness) as f32;
    row[last] += ((to - last as f64) * thickness) as f32;
    let whole = thickness as f32;
    for pixel in &mut row[first + 1..last] {
        *pixel += whole;
    }
}
