//! Images of the printed dots.
//!
//! An image is the gel, which never changes and is worked out once ([`Base`]), and the ink on it, which every pixel sees
//! through the lens. For the ink there are two rungs, [`Images`](crate::scene::Images): [`Soft`] adds up line integrals in
//! closed form within every dot's window; [`Fine`], what it is tested against, draws on a canvas of fine pixels and
//! filters that. Without a lens that blurs both are the share of every pixel that ink covers.

mod dot;
mod fine;
mod finish;
mod lens;
mod overlap;
mod profile;
mod shape;
mod soft;

pub(crate) use dot::Dot;
pub use dot::Ellipse;
pub(crate) use lens::Lens;

use crate::effects::{Bridge, Codec, Defocus, Gain, Noise, Shots, SmearsOfView, Texture, UnevenLight};
use crate::scene::{Images, Scene};
use crate::simulator::{DotImage, Sight, Truth};
use alloc::vec::Vec;
use fine::Fine;
use finish::{Base, Finish};
use gelstereo_core::camera::Camera;
use gelstereo_core::math::DVec2;
use overlap::Overlaps;
use shape::{Shape, cover};
use soft::Soft;

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
    lens: Option<Lens>,
    pen: Pen,
    shots: Option<Shots>,
    noise: Option<Noise>,
    codec: Option<Codec>,
    ink: Ink,
    /// What every pixel sees of the ink; nothing between two images.
    canvas: Vec<f32>,
    /// A row of grey levels.
    levels: Vec<f32>,
}

/// How ink is drawn.
#[derive(Clone, Debug)]
enum Pen {
    Sharp,
    Soft(Soft),
    Fine(Fine),
}

#[derive(Clone, Debug)]
struct View {
    name: &'static str,
    width: usize,
    height: usize,
    base: Base,
    gain: Option<Gain>,
    smears: Option<SmearsOfView>,
}

/// Ink of one image: regions, those of the ellipses first. Where they overlap it counts once.
#[derive(Clone, Debug, Default)]
struct Ink {
    ellipses: Vec<Ellipse>,
    shapes: Vec<Shape>,
    overlaps: Overlaps,
    group: Vec<Shape>,
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
        let lens = effects.defocus.as_ref().map(Defocus::lens);
        let view = |index, name, camera: &Camera| {
            let (smears, size) = (effects.smears.as_ref(), [camera.width_px, camera.height_px]);
            let grain = effects.grain.as_ref().map(|grain| Texture::new(grain, scene.seed, name, camera));
            let gain = effects.uneven_light.as_ref().map(|light| Gain::new(light, camera));
            View {
                name,
                width: camera.width_px,
                height: camera.height_px,
                base: Base::new(gel_level, grain.as_ref(), gain.as_ref(), lens, size),
                gain,
                smears: smears.map(|s| SmearsOfView::new(s, scene, index, camera, [start_s, end_s])),
            }
        };
        let rows = scene.rig.left.height_px.max(scene.rig.right.height_px);
        let specks = effects.specks.as_ref().map_or(0, |specks| specks.count);
        let regions = printed.len() + bridges.len() + specks;
        Self {
            printed,
            bridges,
            gel_level,
            dot_level,
            views: [view(0, "left", &scene.rig.left), view(1, "right", &scene.rig.right)],
            light: effects.uneven_light.clone(),
            lens,
            pen: match (lens, scene.images) {
                (None, _) => Pen::Sharp,
                (Some(lens), Images::Fast) => Pen::Soft(Soft::new(lens, rows, regions)),
                (Some(lens), Images::Exact) => Pen::Fine(Fine::new(lens)),
            },
            shots: effects.shot_noise.as_ref().map(|noise| Shots::new(noise, scene.seed)),
            codec: effects.jpeg.as_ref().map(Codec::new),
            noise: effects.sensor_noise.as_ref().map(|noise| Noise::new(noise, scene.seed)),
            ink: Ink::with_room(regions),
            canvas: Vec::new(),
            levels: Vec::new(),
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
        self.gather(view, truth);
        let View { name, width, height, base, gain, smears } = &self.views[view];
        self.canvas.resize(width * height, 0.0);
        let mut gain = gain.as_ref();
        match &mut self.pen {
            Pen::Sharp => self.ink.sharp(&mut self.canvas, *width),
            Pen::Soft(soft) => self.ink.soft(soft, &mut self.canvas, *width),
            Pen::Fine(fine) => {
                let Ink { shapes, overlaps, .. } = &self.ink;
                fine.draw(shapes, overlaps, self.light.as_ref(), &mut self.canvas, *width);
                gain = None;
            }
        }
        let finish = Finish {
            base,
            contrast: self.dot_level - self.gel_level,
            gain,
            smears: smears.as_ref(),
            time_s: exposure.time_s,
            shots: self.shots.as_ref().map(|shots| (shots, shots.stream(name, exposure.frame))),
            noise: self.noise.as_ref().map(|noise| (noise, noise.stream(name, exposure.frame))),
        };
        finish.develop(&mut self.canvas, *width, &mut self.levels, image);
        if let Some(codec) = &self.codec {
            codec.pass(image, *width);
        }
    }

    /// Collects the ink that is in the image; a truth of another lattice has none.
    fn gather(&mut self, view: usize, truth: &Truth) {
        let (dots, specks) = match view {
            0 => (&truth.left_dots, &truth.left_specks),
            _ => (&truth.right_dots, &truth.right_specks),
        };
        let size = [self.views[view].width, self.views[view].height];
        let reach = self.lens.map_or(0.0, Lens::reach_px);
        let Ink { ellipses, shapes, overlaps, .. } = &mut self.ink;
        ellipses.clear();
        shapes.clear();
        if dots.len() != self.printed.len() {
            return overlaps.find(shapes);
        }
        let lit = match (&self.pen, &self.light, self.lens) {
            (Pen::Soft(_), Some(light), Some(lens)) => Some((light, lens)),
            _ => None,
        };
        let displaced =
            |at: DVec2| lit.map_or(DVec2::ZERO, |(light, lens)| displacement(light, lens, at, size));
        let printed = dots.iter().zip(&self.printed).filter(|&(_, &printed)| printed);
        for outline in printed.map(|(dot, _)| &dot.outline).chain(specks) {
            let centre_px = outline.centre_px + displaced(outline.centre_px);
            let outline = Ellipse { centre_px, ..*outline };
            if let Some(shape) = Shape::ellipse(&outline).filter(|shape| shape.seen(reach, size)) {
                ellipses.push(outline);
                shapes.push(shape);
            }
        }
        let bars = self.bridges.iter().map(|bridge| bridge.corners(dots));
        let bars = bars.filter_map(|corners| Shape::bar(corners.map(|corner| corner + displaced(corner))));
        shapes.extend(bars.filter(|shape| shape.seen(reach, size)));
        overlaps.find(shapes);
    }
}

/// Light is weighed where the ink is, before the lens spreads it: with light L that grows evenly over a pixel's view, and
/// weights w of variance s² that are a Gaussian's, or nearly, ∫ w(u) L(x - u) c(x - u) du = L(x) b(x) + s² ∇L · ∇b(x) for
/// ink c and its blurred image b (Stein 1981), which is L(x) b(x + s² ∇L / L): the light of the pixel on ink that is that
/// much nearer to the dark.
fn displacement(light: &UnevenLight, lens: Lens, at: DVec2, size: [usize; 2]) -> DVec2 {
    let size = DVec2::new(size[0] as f64, size[1] as f64);
    // Light that doubles within a pixel is as good as none; a step by half a sigma is far more than it takes.
    let most = 0.5 * lens.sigma_px;
    -(light.growth(at, size) * lens.variance_px2()).clamp_length_max(most)
}

impl Ink {
    fn with_room(regions: usize) -> Self {
        let mut overlaps = Overlaps::default();
        overlaps.reserve(regions);
        Self {
            ellipses: Vec::with_capacity(regions),
            shapes: Vec::with_capacity(regions),
            overlaps,
            group: Vec::with_capacity(regions),
        }
    }

    fn sharp(&mut self, canvas: &mut [f32], width: usize) {
        for regions in self.overlaps.groups() {
            self.group.clear();
            self.group.extend(regions.iter().map(|&i| self.shapes[i]));
            cover(&self.group, canvas, width);
        }
    }

    fn soft(&mut self, soft: &mut Soft, canvas: &mut [f32], width: usize) {
        for regions in self.overlaps.groups() {
            if let &[i] = regions
                && let Some(ellipse) = self.ellipses.get(i)
            {
                soft.ellipse(ellipse, canvas, width);
                continue;
            }
            self.group.clear();
            self.group.extend(regions.iter().map(|&i| self.shapes[i]));
            soft.union(&self.group, canvas, width);
        }
    }
}
