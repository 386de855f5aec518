//! Images of the printed dots.

mod dot;

pub(crate) use dot::Dot;
pub use dot::Ellipse;

use crate::effects::{Blur, Bridge, Gain, Noise, SmearsOfView, Texture, UnevenLight};
use crate::scene::Scene;
use crate::simulator::{DotImage, Sight, Truth};
use alloc::vec::Vec;
use dot::cover_polygon;
use gelstereo_core::camera::Camera;
use gelstereo_core::math::DVec2;

/// Pixels of the canvas per pixel of a blurred image, along each axis. The lens blurs before pixels sample: a dot that is
/// sampled first and blurred then lies up to 0.01 px off, for what is finer than a pixel has become something coarse.
/// With half a pixel that is a fifth (a disc's spectrum falls with k^1.5, and the share of it that half a pixel lets pass
/// is half as large where it folds).
pub(crate) const FINE: usize = 2;

/// When an image is taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exposure {
    /// Keys the noise.
    pub(crate) frame: u64,
    pub(crate) time_s: f64,
}

/// Draws the dots of one moment, and what the camera does to them.
#[derive(Clone, Debug)]
pub(crate) struct Renderer {
    printed: Vec<bool>,
    bridges: Vec<Bridge>,
    gel_level: f32,
    dot_level: f32,
    views: [View; 2],
    light: Option<UnevenLight>,
    blur: Option<Blur>,
    noise: Option<Noise>,
    /// Coverage by dots, then grey levels.
    canvas: Vec<f32>,
}

#[derive(Clone, Debug)]
struct View {
    name: &'static str,
    width: usize,
    height: usize,
    grain: Option<Texture>,
    light: Option<Gain>,
    smears: Option<SmearsOfView>,
}

impl Renderer {
    /// `end_s` is the sequence's end, by which random smears have begun; `bridges` the ink between dots.
    pub(crate) fn new(scene: &Scene, [start_s, end_s]: [f64; 2], bridges: Vec<Bridge>) -> Self {
        let gel = &scene.gel;
        let mut printed = Vec::new();
        printed.resize(gel.rows * gel.cols, true);
        for [row, col] in &gel.missing {
            printed[row * gel.cols + col] = false;
        }
        let (dark, bright) = (f32::from(gel.dark_level), f32::from(gel.bright_level));
        let (gel_level, dot_level) = if gel.bright_dots { (dark, bright) } else { (bright, dark) };
        let effects = &scene.effects;
        let view = |index, name, camera: &Camera| {
            let smears = effects.smears.as_ref();
            View {
                name,
                width: camera.width_px,
                height: camera.height_px,
                grain: effects.grain.as_ref().map(|grain| Texture::new(grain, scene.seed, name, camera)),
                light: effects.uneven_light.as_ref().map(|light| Gain::new(light, camera)),
                smears: smears.map(|s| SmearsOfView::new(s, scene, index, camera, [start_s, end_s])),
            }
        };
        Self {
            printed,
            bridges,
            gel_level,
            dot_level,
            views: [view(0, "left", &scene.rig.left), view(1, "right", &scene.rig.right)],
            light: effects.uneven_light.clone(),
            blur: effects.defocus.as_ref().map(|defocus| Blur::new(&defocus.on_canvas())),
            noise: effects.sensor_noise.as_ref().map(|noise| Noise::new(noise, scene.seed)),
            canvas: Vec::new(),
        }
    }

    /// What there is to know about a marker's dot in one view (0 left, 1 right).
    pub(crate) fn describe(&self, view: usize, marker: usize, outline: Ellipse, time_s: f64) -> DotImage {
        let View { width, height, smears, .. } = &self.views[view];
        let size = DVec2::new(*width as f64, *height as f64);
        let gain = self.light.as_ref().map_or(1.0, |light| light.gain(outline.centre_px, size));
        let contrast_levels = f64::from((self.dot_level - self.gel_level).abs()) * gain;
        let (low, high) = (outline.centre_px - outline.reach_px(), outline.centre_px + outline.reach_px());
        let end = size - 0.5;
        let sight = if !self.printed[marker] {
            Sight::NotPrinted
        } else if high.cmple(DVec2::splat(-0.5)).any() || low.cmpge(end).any() {
            Sight::Outside
        } else if smears.as_ref().is_some_and(|smears| smears.reach(&outline, time_s)) {
            Sight::Covered
        } else if self.bridges.iter().any(|bridge| bridge.joins(marker)) {
            Sight::Merged
        } else if low.cmplt(DVec2::splat(-0.5)).any() || high.cmpgt(end).any() {
            Sight::Cut
        } else {
            Sight::Whole
        };
        DotImage { outline, contrast_levels, sight }
    }

    /// One view (0 left, 1 right) of the dots that `truth` describes.
    pub(crate) fn draw(&mut self, view: usize, truth: &Truth, exposure: Exposure, image: &mut Vec<u8>) {
        let View { name, width, height, grain, light, smears } = &self.views[view];
        let fine = if self.blur.is_some() { FINE } else { 1 };
        let (columns, rows) = (fine * width, fine * height);
        self.canvas.clear();
        self.canvas.resize(columns * rows, 0.0);
        let (dots, specks) = match view {
            0 => (&truth.left_dots, &truth.left_specks),
            _ => (&truth.right_dots, &truth.right_specks),
        };
        if dots.len() == self.printed.len() {
            for (dot, _) in dots.iter().zip(&self.printed).filter(|&(_, &printed)| printed) {
                dot.outline.magnified(fine).cover(&mut self.canvas, columns, rows);
            }
            for bridge in &self.bridges {
                let corners = bridge.corners(dots).map(|corner| magnified(corner, fine));
                cover_polygon(&corners, &mut self.canvas, columns, rows);
            }
            for speck in specks {
                speck.magnified(fine).cover(&mut self.canvas, columns, rows);
            }
        }
        let contrast = self.dot_level - self.gel_level;
        for pixel in &mut self.canvas {
            *pixel = self.gel_level + contrast * pixel.min(1.0);
        }
        if let Some(grain) = grain {
            grain.apply(&mut self.canvas, *width, fine);
        }
        if let Some(light) = light {
            light.apply(&mut self.canvas, *width, fine);
        }
        if let Some(smears) = smears {
            smears.apply(exposure.time_s, &mut self.canvas, *width, fine);
        }
        if let Some(blur) = &mut self.blur {
            blur.apply(&mut self.canvas, columns);
            bin(&mut self.canvas, columns);
        }
        if let Some(noise) = &self.noise {
            noise.apply(name, exposure.frame, &mut self.canvas);
        }
        image.clear();
        // To the nearest level; `as` clamps to 0 and 255.
        image.extend(self.canvas.iter().map(|&level| (level + 0.5) as u8));
    }
}

/// Means of squares of [`FINE`] by [`FINE`] pixels, in place.
fn bin(canvas: &mut Vec<f32>, columns: usize) {
    let share = 1.0 / (FINE * FINE) as f32;
    let mut out = 0;
    for top in (0..canvas.len()).step_by(FINE * columns) {
        for left in (0..columns).step_by(FINE) {
            let row = |dy: usize| canvas[top + dy * columns + left..][..FINE].iter().sum::<f32>();
            canvas[out] = (0..FINE).map(row).sum::<f32>() * share;
            out += 1;
        }
    }
    canvas.truncate(out);
}

/// A place as counted in pixels so many times as narrow.
fn magnified(at: DVec2, times: usize) -> DVec2 {
    at * times as f64 + 0.5 * (times as f64 - 1.0)
}

/// Every row of a magnified canvas of a view so wide, with the values of the row of pixels that it lies in.
pub(crate) fn rows_of<'a>(
    canvas: &'a mut [f32],
    values: &'a [f32],
    width: usize,
    times: usize,
) -> impl Iterator<Item = (&'a mut [f32], &'a [f32])> {
    let row = move |y: usize| &values[y / times * width..][..width];
    canvas.chunks_exact_mut(times * width).enumerate().map(move |(y, pixels)| (pixels, row(y)))
}
