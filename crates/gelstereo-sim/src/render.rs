//! Images of the printed dots.

use crate::effects::{Blur, Gain, Noise, Texture};
use crate::lattice::Lattice;
use crate::scene::Scene;
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::math::{DVec2, DVec3, Pose, ceil, floor, sqrt};

/// Horizontal lines per pixel row over which a dot's coverage is integrated; along a line it is exact.
const LINES_PER_ROW: u32 = 8;

/// Draws the dots of one moment, and what the camera does to them.
#[derive(Clone, Debug)]
pub(crate) struct Renderer {
    lattice: Lattice,
    printed: Vec<bool>,
    dot_radius_mm: f64,
    gel_level: f32,
    dot_level: f32,
    views: [View; 2],
    blur: Option<Blur>,
    noise: Option<Noise>,
    /// Coverage by dots, then grey levels.
    canvas: Vec<f32>,
}

#[derive(Clone, Debug)]
struct View {
    name: &'static str,
    camera: Camera,
    t_camera_sensor: Pose,
    grain: Option<Texture>,
    light: Option<Gain>,
}

impl Renderer {
    pub(crate) fn new(scene: &Scene) -> Self {
        let gel = &scene.gel;
        let mut printed = Vec::new();
        printed.resize(gel.rows * gel.cols, true);
        for [row, col] in &gel.missing {
            printed[row * gel.cols + col] = false;
        }
        let (dark, bright) = (f32::from(gel.dark_level), f32::from(gel.bright_level));
        let (gel_level, dot_level) = if gel.bright_dots { (dark, bright) } else { (bright, dark) };
        let effects = &scene.effects;
        let view = |name, camera: &Camera, t_camera_sensor| View {
            name,
            camera: camera.clone(),
            t_camera_sensor,
            grain: effects.grain.as_ref().map(|grain| Texture::new(grain, scene.seed, name, camera)),
            light: effects.uneven_light.as_ref().map(|light| Gain::new(light, camera)),
        };
        Self {
            lattice: Lattice::new(gel),
            printed,
            dot_radius_mm: gel.dot_radius_mm,
            gel_level,
            dot_level,
            views: [
                view("left", &scene.rig.left, Pose::IDENTITY),
                view("right", &scene.rig.right, scene.rig.t_right_left),
            ],
            blur: effects.defocus.as_ref().map(Blur::new),
            noise: effects.sensor_noise.as_ref().map(|noise| Noise::new(noise, scene.seed)),
            canvas: Vec::new(),
        }
    }

    /// One view (0 left, 1 right) of the markers at `points_mm` (sensor frame).
    pub(crate) fn draw(&mut self, view: usize, points_mm: &[DVec3], frame: u64, image: &mut Vec<u8>) {
        let View { name, camera, t_camera_sensor, grain, light } = &self.views[view];
        let (width, height) = (camera.width_px, camera.height_px);
        self.canvas.clear();
        self.canvas.resize(width * height, 0.0);
        let markers = if points_mm.len() == self.printed.len() { points_mm.len() } else { 0 };
        for i in (0..markers).filter(|&i| self.printed[i]) {
            let dot = Dot::new(&self.lattice, points_mm, i, self.dot_radius_mm, t_camera_sensor);
            if let Some(ellipse) = dot.project(camera) {
                ellipse.cover(&mut self.canvas, width, height);
            }
        }
        let contrast = self.dot_level - self.gel_level;
        for pixel in &mut self.canvas {
            *pixel = self.gel_level + contrast * pixel.min(1.0);
        }
        if let Some(grain) = grain {
            grain.apply(&mut self.canvas);
        }
        if let Some(light) = light {
            light.apply(&mut self.canvas);
        }
        if let Some(blur) = &mut self.blur {
            blur.apply(&mut self.canvas, width);
        }
        if let Some(noise) = &self.noise {
            noise.apply(name, frame, &mut self.canvas);
        }
        image.clear();
        // To the nearest level; `as` clamps to 0 and 255.
        image.extend(self.canvas.iter().map(|&level| (level + 0.5) as u8));
    }
}

/// A printed dot: the image of the disc |s| <= 1 under s -> centre + along s.x + across s.y (camera frame).
struct Dot {
    centre: DVec3,
    along: DVec3,
    across: DVec3,
}

impl Dot {
    /// The dot stretches and tilts with the surface between the neighbouring markers.
    fn new(
        lattice: &Lattice,
        points_mm: &[DVec3],
        index: usize,
        radius_mm: f64,
        t_camera_sensor: &Pose,
    ) -> Self {
        let [along, across] = lattice.neighbours(index).map(|(before, after, pitches)| {
            let stretch = (points_mm[after] - points_mm[before]) / (pitches * lattice.pitch_mm);
            t_camera_sensor.transform_vector(stretch * radius_mm)
        });
        Self { centre: t_camera_sensor.transform_point(points_mm[index]), along, across }
    }

    /// Its outline. A circle's image is an ellipse whose centre is not the image of the circle's centre but of
    /// the pole, with respect to the circle, of the line that vanishes: s = -(along.z, across.z) / centre.z.
    fn project(&self, camera: &Camera) -> Option<Ellipse> {
        let pole = -DVec2::new(self.along.z, self.across.z) / self.centre.z;
        let at = |s: DVec2| camera.project(self.centre + self.along * s.x + self.across * s.y);
        let half = |axis: DVec2| Some((at(pole + axis)? - at(pole - axis)?) * 0.5);
        Some(Ellipse { centre: at(pole)?, a: half(DVec2::X)?, b: half(DVec2::Y)? })
    }
}

/// Points centre + a cos t + b sin t, pixels.
struct Ellipse {
    centre: DVec2,
    a: DVec2,
    b: DVec2,
}

impl Ellipse {
    /// Adds the share of every pixel that lies within.
    fn cover(&self, canvas: &mut [f32], width: usize, height: usize) {
        // Second moments: a horizontal line at dy from the centre is cut from dy·xy/yy -+ sqrt(det/yy (1 -
        // dy²/yy)).
        let xx = self.a.x * self.a.x + self.b.x * self.b.x;
        let xy = self.a.x * self.a.y + self.b.x * self.b.y;
        let yy = self.a.y * self.a.y + self.b.y * self.b.y;
        let area = self.a.perp_dot(self.b);
        let reach = DVec2::new(sqrt(xx), sqrt(yy));
        let (low, high) = (self.centre - reach, self.centre + reach);
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
                let dy = top + (f64::from(line) + 0.5) * step - self.centre.y;
                let half = widest * sqrt((1.0 - dy * dy / yy).max(0.0));
                let middle = self.centre.x + dy * slope;
                cover_line(row, middle - half, middle + half, step);
            }
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
