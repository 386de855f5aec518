//! A printed dot and its image.

use gelstereo_core::camera::Camera;
use gelstereo_core::math::{DVec2, DVec3, Pose, ceil, floor, sqrt};
use gelstereo_core::rig::RigView;

/// Horizontal lines per pixel row over which a region's coverage is integrated; along a line it is exact.
const LINES_PER_ROW: u32 = 8;

/// A printed dot: the disc |s| <= 1 under s -> centre + along s.x + across s.y, millimetres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dot {
    pub(crate) centre: DVec3,
    pub(crate) along: DVec3,
    pub(crate) across: DVec3,
}

/// Points centre + a cos t + b sin t, pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ellipse {
    /// Its centre, which is the centroid of the dot's image.
    pub centre_px: DVec2,
    /// Two conjugate half diameters: images of the dot's radii along the lattice's row and column.
    pub half_px: [DVec2; 2],
}

impl Dot {
    /// Its image; the dot is in the sensor frame. `None` when a part of it is behind the camera.
    pub(crate) fn image(
        &self,
        view: &RigView<'_>,
        t_camera_sensor: &Pose,
        refracted: bool,
    ) -> Option<Ellipse> {
        if refracted || view.camera().distortion != [0.0; 5] {
            return self.traced(view);
        }
        let dot = Self {
            centre: t_camera_sensor.transform_point(self.centre),
            along: t_camera_sensor.transform_vector(self.along),
            across: t_camera_sensor.transform_vector(self.across),
        };
        dot.pinhole(view.camera())
    }

    /// Before a pinhole. A circle's image is an ellipse whose centre is not the image of the circle's centre but
    /// of the pole, with respect to the circle, of the line that vanishes: s = -(along.z, across.z) / centre.z.
    fn pinhole(&self, camera: &Camera) -> Option<Ellipse> {
        let pole = -DVec2::new(self.along.z, self.across.z) / self.centre.z;
        let at = |s: DVec2| camera.project(self.centre + self.along * s.x + self.across * s.y);
        let half = |axis: DVec2| Some((at(pole + axis)? - at(pole - axis)?) * 0.5);
        Some(Ellipse { centre_px: at(pole)?, half_px: [half(DVec2::X)?, half(DVec2::Y)?] })
    }

    /// Behind layers or a lens that distorts: six points of the outline give it as a Fourier series
    /// m + a cos t + b sin t + d cos 2t + e sin 2t. The second harmonic bends the ellipse by nothing that matters
    /// but moves the centroid of its region: by ∮ p (δp × dp) / area, to first order in d and e.
    fn traced(&self, view: &RigView<'_>) -> Option<Ellipse> {
        const TURN: [(f64, f64); 6] = {
            let (c, s) = (0.5, 0.866_025_403_784_438_6); // 60 degrees
            [(1.0, 0.0), (c, s), (-c, s), (-1.0, 0.0), (-c, -s), (c, -s)]
        };
        let [mut m, mut a, mut b, mut d, mut e] = [DVec2::ZERO; 5];
        for (k, (c, s)) in TURN.into_iter().enumerate() {
            let p = view.project(self.centre + self.along * c + self.across * s).ok()?;
            let (c2, s2) = TURN[2 * k % 6];
            m += p / 6.0;
            a += p * (c / 3.0);
            b += p * (s / 3.0);
            d += p * (c2 / 3.0);
            e += p * (s2 / 3.0);
        }
        let shift = (a * (d.perp_dot(b) - e.perp_dot(a)) + b * (d.perp_dot(a) + e.perp_dot(b)))
            / (2.0 * a.perp_dot(b));
        let centre_px = if shift.is_finite() { m + shift } else { m };
        Some(Ellipse { centre_px, half_px: [a, b] })
    }
}

impl Ellipse {
    /// Radius of the circle of the same area.
    #[must_use]
    pub fn radius_px(&self) -> f64 {
        sqrt(self.half_px[0].perp_dot(self.half_px[1]).abs())
    }

    /// How far it reaches from its centre along the image's rows and columns.
    #[must_use]
    pub fn reach_px(&self) -> DVec2 {
        let [a, b] = self.half_px;
        DVec2::new(sqrt(a.x * a.x + b.x * b.x), sqrt(a.y * a.y + b.y * b.y))
    }

    /// Adds the share of every pixel that lies within.
    pub(crate) fn cover(&self, canvas: &mut [f32], width: usize, height: usize) {
        // Second moments: a horizontal line at dy from the centre is cut from dy·xy/yy -+ sqrt(det/yy (1 -
        // dy²/yy)).
        let [a, b] = self.half_px;
        let xx = a.x * a.x + b.x * b.x;
        let xy = a.x * a.y + b.x * b.y;
        let yy = a.y * a.y + b.y * b.y;
        let area = a.perp_dot(b);
        let reach = DVec2::new(sqrt(xx), sqrt(yy));
        let (low, high) = (self.centre_px - reach, self.centre_px + reach);
        let end = DVec2::new(width as f64, height as f64) - 0.5;
        if !(yy > 0.0 && low.is_finite() && high.is_finite())
            || high.cmple(DVec2::splat(-0.5)).any()
            || low.cmpge(end).any()
        {
            return;
        }
        let (slope, widest) = (xy / yy, area.abs() / reach.y);
        let first = floor(low.y + 0.5).max(0.0) as usize;
        let last = (ceil(high.y - 0.5).max(0.0) as usize).min(height - 1);
        for y in first..=last {
            let top = low.y.max(y as f64 - 0.5);
            let bottom = high.y.min(y as f64 + 0.5);
            let step = (bottom - top).max(0.0) / f64::from(LINES_PER_ROW);
            let row = &mut canvas[y * width..][..width];
            for line in 0..LINES_PER_ROW {
                let dy = top + (f64::from(line) + 0.5) * step - self.centre_px.y;
                let half = widest * sqrt((1.0 - dy * dy / yy).max(0.0));
                let middle = self.centre_px.x + dy * slope;
                cover_line(row, middle - half, middle + half, step);
            }
        }
    }
}

/// Adds the share of every pixel that lies within a convex polygon.
pub(crate) fn cover_polygon(corners: &[DVec2; 4], canvas: &mut [f32], width: usize, height: usize) {
    let edges = [(0, 1), (1, 2), (2, 3), (3, 0)].map(|(i, j)| (corners[i], corners[j]));
    let (low, high) = corners
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p.y), high.max(p.y)));
    if !(corners.iter().all(|p| p.is_finite()) && high > -0.5 && low < height as f64 - 0.5) {
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
            let cut = |&(p, q): &(DVec2, DVec2)| {
                ((p.y <= at) != (q.y <= at)).then(|| p.x + (q.x - p.x) * ((at - p.y) / (q.y - p.y)))
            };
            let (from, to) = edges
                .iter()
                .filter_map(cut)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(from, to): (f64, f64), x| {
                    (from.min(x), to.max(x))
                });
            cover_line(row, from, to, step);
        }
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
