//! Images of the printed dots.
//!
//! An image consists of the gel, which is static and computed once ([`Base`]), and the ink on it, seen
//! through the lens. There are two rungs for the ink, [`Images`](crate::scene::Images). [`Soft`] sums
//! line integrals in closed form within every dot's window. [`Fine`], its reference, draws on a canvas
//! of fine pixels and filters that. Without a blurring lens, both are the share of every pixel that ink
//! covers.

mod cover;
mod dot;
mod fine;
mod finish;
mod lens;
mod overlap;
mod profile;
mod shape;
mod shutter;
mod soft;

pub(crate) use dot::Dot;
pub use dot::Ellipse;
pub(crate) use lens::Lens;
pub(crate) use shutter::Shutter;

use crate::effects::{Bridge, Codec, Defocus, Gain, Noise, Shots, SmearsOfView, Texture, UnevenLight};
use crate::scene::{Images, Scene};
use crate::simulator::{DotImage, Sight, Truth};
use alloc::sync::Arc;
use alloc::vec::Vec;
use cover::cover;
use fine::Fine;
use finish::{Base, Finish};
use gelstereo_core::camera::Camera;
use gelstereo_core::math::{DVec2, ceil};
use overlap::Overlaps;
use shape::Shape;
use shutter::longest_px;
use soft::Soft;

/// Frame and time of an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exposure {
    /// Seeds the noise.
    pub(crate) frame: u64,
    pub(crate) time_s: f64,
}

/// Draws the dots of one moment and applies the camera's effects.
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
    shutter: Option<Shutter>,
    shots: Option<Shots>,
    noise: Option<Noise>,
    codec: Option<Codec>,
    ink: Ink,
    /// Ink seen by every pixel; zero between two images.
    canvas: Vec<f32>,
    /// A row of grey levels.
    levels: Vec<f32>,
}

/// Method of drawing ink.
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
    grain: Option<Arc<Texture>>,
    base: Arc<Base>,
    gain: Option<Gain>,
    smears: Option<SmearsOfView>,
}

impl View {
    /// Whether it has this size and this very grain.
    fn shows(&self, size: [usize; 2], grain: Option<&Arc<Texture>>) -> bool {
        let same_grain = match (&self.grain, grain) {
            (None, None) => true,
            (Some(own), Some(other)) => Arc::ptr_eq(own, other),
            _ => false,
        };
        same_grain && [self.width, self.height] == size
    }
}

/// Ink of one image: regions, the ellipses first. Overlapping ink counts once.
#[derive(Clone, Debug, Default)]
struct Ink {
    ellipses: Vec<Ellipse>,
    shapes: Vec<Shape>,
    /// Motion of each region during the exposure; empty without motion.
    ways_px: Vec<DVec2>,
    overlaps: Overlaps,
    group: Vec<Shape>,
}

impl Renderer {
    /// `start_s` and `end_s` span the sequence, in which random smears begin; `bridges` is the ink
    /// between dots. What is the same for the scene of `before` is shared with it.
    pub(crate) fn new(
        scene: &Scene,
        [start_s, end_s]: [f64; 2],
        bridges: Vec<Bridge>,
        before: Option<&Self>,
    ) -> Self {
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
        // Whether the gel without ink and grain has the same levels.
        let same_levels = before.is_some_and(|before| {
            (before.gel_level, before.lens, &before.light) == (gel_level, lens, &effects.uneven_light)
        });
        let view = |index: usize, name, camera: &Camera| {
            let (smears, size) = (effects.smears.as_ref(), [camera.width_px, camera.height_px]);
            let last = before.map(|before| &before.views[index]);
            let grain = effects.grain.as_ref().map(|grain| {
                let last = last.and_then(|last| last.grain.as_ref());
                Texture::shared(grain, scene.seed, (name, camera), last)
            });
            let gain = effects.uneven_light.as_ref().map(|light| Gain::new(light, camera));
            let last = last.filter(|last| same_levels && last.shows(size, grain.as_ref()));
            let base = last.map(|last| last.base.clone());
            let new = || Arc::new(Base::new(gel_level, grain.as_deref(), gain.as_ref(), lens, size));
            View {
                name,
                width: camera.width_px,
                height: camera.height_px,
                base: base.unwrap_or_else(new),
                grain,
                gain,
                smears: smears.map(|s| SmearsOfView::new(s, scene, index, camera, [start_s, end_s])),
            }
        };
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
                (Some(lens), Images::Fast) => Pen::Soft(Soft::new(lens, regions)),
                (Some(lens), Images::Exact) => Pen::Fine(Fine::new(lens)),
            },
            shutter: effects.motion_blur.as_ref().map(|_| Shutter::new(lens.map(|lens| lens.sigma_px))),
            shots: effects
                .shot_noise
                .as_ref()
                .map(|noise| Shots::new(noise, scene.seed, before.and_then(|before| before.shots.as_ref()))),
            codec: effects.jpeg.as_ref().map(Codec::new),
            noise: effects
                .sensor_noise
                .as_ref()
                .map(|noise| Noise::new(noise, scene.seed, before.and_then(|before| before.noise.as_ref()))),
            ink: Ink::with_room(regions, effects.motion_blur.is_some()),
            canvas: Vec::new(),
            levels: Vec::new(),
        }
    }

    /// Describes a marker's dot in one view (0 left, 1 right).
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

    /// Draws one view (0 left, 1 right) of the dots in `truth`.
    pub(crate) fn draw(&mut self, view: usize, truth: &Truth, exposure: Exposure, image: &mut Vec<u8>) {
        self.gather(view, truth);
        let View { name, width, height, base, gain, smears, .. } = &self.views[view];
        self.canvas.resize(width * height, 0.0);
        let mut gain = gain.as_ref();
        match &mut self.pen {
            Pen::Sharp => self.ink.sharp(self.shutter.as_ref(), &mut self.canvas, *width),
            Pen::Soft(soft) => self.ink.soft(soft, self.shutter.as_ref(), &mut self.canvas, *width),
            Pen::Fine(fine) => {
                self.ink.fine(fine, self.light.as_ref(), &mut self.canvas, *width);
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

    /// Collects the visible ink; none if `truth` has a different lattice.
    fn gather(&mut self, view: usize, truth: &Truth) {
        let (dots, specks, motion_px) = match view {
            0 => (&truth.left_dots, &truth.left_specks, &truth.left_motion_px),
            _ => (&truth.right_dots, &truth.right_specks, &truth.right_motion_px),
        };
        let size = [self.views[view].width, self.views[view].height];
        let reach = self.lens.map_or(0.0, Lens::reach_px);
        let Ink { ellipses, shapes, ways_px, overlaps, .. } = &mut self.ink;
        ellipses.clear();
        shapes.clear();
        ways_px.clear();
        if dots.len() != self.printed.len() {
            return overlaps.find(shapes);
        }
        let lit = match (&self.pen, &self.light, self.lens) {
            (Pen::Soft(_), Some(light), Some(lens)) => Some((light, lens)),
            _ => None,
        };
        let displaced =
            |at: DVec2| lit.map_or(DVec2::ZERO, |(light, lens)| displacement(light, lens, at, size));
        let moves = self.shutter.is_some() && motion_px.len() == dots.len() + specks.len();
        let outlines = dots.iter().map(|dot| &dot.outline).chain(specks).enumerate();
        for (i, outline) in outlines.filter(|&(i, _)| self.printed.get(i) != Some(&false)) {
            let centre_px = outline.centre_px + displaced(outline.centre_px);
            let outline = Ellipse { centre_px, ..*outline };
            let way_px = if moves { motion_px[i] } else { DVec2::ZERO };
            let reach = reach + 0.5 * way_px.length();
            if let Some(shape) = Shape::ellipse(&outline).filter(|shape| shape.seen(reach, size)) {
                ellipses.push(outline);
                shapes.push(shape);
                ways_px.extend(moves.then_some(way_px));
            }
        }
        for bridge in &self.bridges {
            let way_px = if moves { bridge.way_px(motion_px) } else { DVec2::ZERO };
            let bar = Shape::bar(bridge.corners(dots).map(|corner| corner + displaced(corner)));
            if let Some(bar) = bar.filter(|bar| bar.seen(reach + 0.5 * way_px.length(), size)) {
                shapes.push(bar);
                ways_px.extend(moves.then_some(way_px));
            }
        }
        overlaps.find(shapes);
    }
}

/// Light acts on the ink before the lens blurs it. Let the light L be linear over a pixel's view, and
/// the weights w nearly Gaussian with variance s². For ink c and its blurred image b, ∫ w(u) L(x - u)
/// c(x - u) du = L(x) b(x) + s² ∇L · ∇b(x) (Stein 1981), which is L(x) b(x + s² ∇L / L). This is the
/// light at the pixel, on ink displaced by that much towards the dark.
fn displacement(light: &UnevenLight, lens: Lens, at: DVec2, size: [usize; 2]) -> DVec2 {
    let size = DVec2::new(size[0] as f64, size[1] as f64);
    // Light that doubles within a pixel is practically zero. Half a sigma exceeds any relevant
    // displacement.
    let max_px = 0.5 * lens.sigma_px;
    -(light.growth(at, size) * lens.variance_px2()).clamp_length_max(max_px)
}

impl Ink {
    fn with_room(regions: usize, moving: bool) -> Self {
        let mut overlaps = Overlaps::default();
        overlaps.reserve(regions);
        Self {
            ellipses: Vec::with_capacity(regions),
            ways_px: Vec::with_capacity(if moving { regions } else { 0 }),
            shapes: Vec::with_capacity(regions),
            overlaps,
            group: Vec::with_capacity(regions),
        }
    }

    /// A region's motion during the exposure.
    fn way_px(ways_px: &[DVec2], region: usize) -> DVec2 {
        ways_px.get(region).copied().unwrap_or_default()
    }

    fn sharp(&mut self, shutter: Option<&Shutter>, canvas: &mut [f32], width: usize) {
        let Self { shapes, ways_px, overlaps, group, .. } = self;
        for regions in overlaps.groups() {
            each_place(shutter, ways_px, regions, |place, share| {
                group.clear();
                group.extend(regions.iter().map(|&i| shapes[i].moved(Self::way_px(ways_px, i) * place)));
                cover(group, share, canvas, width);
            });
        }
    }

    fn soft(&mut self, soft: &mut Soft, shutter: Option<&Shutter>, canvas: &mut [f32], width: usize) {
        let Self { ellipses, shapes, ways_px, overlaps, group } = self;
        for regions in overlaps.groups() {
            each_place(shutter, ways_px, regions, |place, share| {
                let moved = |i: usize| Self::way_px(ways_px, i) * place;
                if let &[i] = regions
                    && let Some(ellipse) = ellipses.get(i)
                {
                    let centre_px = ellipse.centre_px + moved(i);
                    return soft.ellipse(&Ellipse { centre_px, ..*ellipse }, share, canvas, width);
                }
                group.clear();
                group.extend(regions.iter().map(|&i| shapes[i].moved(moved(i))));
                soft.union(group, share, canvas, width);
            });
        }
    }

    /// Averages several moments of the exposure.
    fn fine(&mut self, fine: &mut Fine, light: Option<&UnevenLight>, canvas: &mut [f32], width: usize) {
        let Self { shapes, ways_px, overlaps, group, .. } = self;
        let moments = 1 + ceil(longest_px(ways_px.iter().copied()) * FINE_MOMENTS_PER_PX) as usize;
        for k in 0..moments {
            let place = (k as f64 + 0.5) / moments as f64 - 0.5;
            group.clear();
            group.extend((0..shapes.len()).map(|i| shapes[i].moved(Self::way_px(ways_px, i) * place)));
            fine.draw((group, overlaps), light, 1.0 / moments as f32, canvas, width);
        }
    }
}

/// Moments of an exposure on the fine canvas, per pixel of the longest path. A mean over steps of h is
/// off by h² / 24 of a second derivative, 1e-4 for a lens of 0.8 px.
const FINE_MOMENTS_PER_PX: f64 = 12.0;

/// Calls `draw` for every sample of regions that move together: its position as a share of their paths
/// from the middle, and its weight.
fn each_place(
    shutter: Option<&Shutter>,
    ways_px: &[DVec2],
    regions: &[usize],
    mut draw: impl FnMut(f64, f64),
) {
    match shutter {
        Some(shutter) => {
            shutter.each(longest_px(regions.iter().map(|&i| Ink::way_px(ways_px, i))), draw);
        }
        None => draw(0.0, 1.0),
    }
}
