//! Effects of the rig on the dots' images.

use crate::plan::{Bound, Facts, Switch};
use crate::scene::Scene;
use gelstereo_core::camera::Camera;

/// Effects that a scene has through its rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Optics {
    /// Refraction in the layers before the markers (`rig.layers`); off means straight rays.
    Refraction,
    /// Distortion of the lenses; off means none.
    LensDistortion,
    /// Offset between the centroid of a disc's image and the image of the disc's centre; off means none.
    EllipseBias,
}

impl Optics {
    pub(crate) const ALL: [Self; 3] = [Self::Refraction, Self::LensDistortion, Self::EllipseBias];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Refraction => "refraction",
            Self::LensDistortion => "lens_distortion",
            Self::EllipseBias => "ellipse_bias",
        }
    }

    /// Whether a scene has this effect.
    pub(crate) fn is_in(self, scene: &Scene) -> bool {
        match self {
            Self::Refraction => scene.rig.layers.is_some(),
            Self::LensDistortion => {
                [&scene.rig.left, &scene.rig.right].into_iter().any(|camera| camera.distortion != [0.0; 5])
            }
            Self::EllipseBias => true,
        }
    }

    /// Removes this effect from a scene.
    pub(crate) fn remove(self, scene: &mut Scene) {
        match self {
            Self::Refraction => scene.rig.layers = None,
            Self::LensDistortion => {
                scene.rig.left.distortion = [0.0; 5];
                scene.rig.right.distortion = [0.0; 5];
            }
            Self::EllipseBias => scene.switches.ellipse_bias = Some(Switch::Off),
        }
    }

    pub(crate) fn bound(self, facts: &Facts<'_>) -> Bound {
        let px = match self {
            Self::Refraction => facts.optics.refraction_px + 2.0 * ellipse_bias_px(facts),
            Self::LensDistortion => distortion_px(facts) + lens_bias_px(facts),
            Self::EllipseBias => ellipse_bias_px(facts),
        };
        Bound { px, um: 0.0, levels: facts.levels_of_outlines(px) }
    }

    /// As [`crate::plan::Effect::cost_ns`]. A dot's outline takes six projections with its ellipse bias,
    /// or one with derivatives without it.
    pub(crate) fn cost_ns(self, facts: &Facts<'_>) -> f64 {
        let outlines = if facts.scene.switches.ellipse_bias == Some(Switch::Off) { 0.0 } else { 1.0 };
        let per_marker = match self {
            Self::Refraction => 1400.0 + 3500.0 * outlines,
            Self::LensDistortion => 20.0 + 100.0 * outlines,
            Self::EllipseBias => 280.0,
        };
        per_marker * facts.markers()
    }
}

/// r |k1 r² + k2 r⁴ + k3 r⁶| and at most 3 r² of each tangential term, at the largest slope.
fn distortion_px(facts: &Facts<'_>) -> f64 {
    let s = facts.optics.slope;
    let s2 = s * s;
    let moved = |camera: &Camera| {
        let [k1, k2, p1, p2, k3] = camera.distortion.map(f64::abs);
        s2 * (s * (k1 + s2 * (k2 + s2 * k3)) + 3.0 * (p1 + p2))
    };
    let cameras = &facts.scene.rig;
    facts.optics.f_px * moved(&cameras.left).max(moved(&cameras.right))
}

/// Upper bound of the distance from the image of a dot's centre to its image's centroid.
///
/// For a pinhole it is f (v - slope v_z) / Z with v = -(a a_z + b b_z) / Z for a disc of half axes a and
/// b: it grows with their tilt. The distortion by lenses and layers is added.
pub(crate) fn ellipse_bias_px(facts: &Facts<'_>) -> f64 {
    if facts.scene.switches.ellipse_bias == Some(Switch::Off) {
        return 0.0;
    }
    let optics = &facts.optics;
    let (widened, tilted) = (1.0 + facts.stretch, tilt(facts));
    let pinhole = core::f64::consts::SQRT_2 * widened * tilted + optics.slope * 2.0 * tilted * tilted;
    // Layers distort like k1 = Σ d (n² - 1) / (2 n³) / Z; (n² - 1) / n³ is at most 0.385.
    let layers = if facts.scene.rig.layers.is_some() { 0.385 * 0.5 * optics.slope } else { 0.0 };
    square_px(facts) * pinhole + bent_px(facts, layers) + lens_bias_px(facts)
}

/// Contribution of the lenses. (The centroid of the image before the lens is distorted like any point.)
fn lens_bias_px(facts: &Facts<'_>) -> f64 {
    if facts.scene.switches.ellipse_bias == Some(Switch::Off) {
        return 0.0;
    }
    let s = facts.optics.slope;
    let bent = |camera: &Camera| {
        let [k1, k2, p1, p2, k3] = camera.distortion.map(f64::abs);
        s * (k1 + s * s * (3.0 * k2 + s * s * 6.0 * k3)) + p1 + p2
    };
    let rig = &facts.scene.rig;
    bent_px(facts, bent(&rig.left).max(bent(&rig.right)))
}

/// Distortion moves a disc's centroid by an eighth of the squared radius times the distortion's
/// Laplacian (8 p for r² p). Twice that is used for tilted and stretched discs.
fn bent_px(facts: &Facts<'_>, bent: f64) -> f64 {
    let larger = 1.0 + facts.stretch + tilt(facts);
    2.0 * square_px(facts) * bent * larger * larger
}

/// f (r / Z)² of the largest dot.
fn square_px(facts: &Facts<'_>) -> f64 {
    let radius = facts.dot_radius_mm() * facts.optics.lateral_px_per_mm / facts.optics.f_px;
    facts.optics.f_px * radius * radius
}

/// Slope of the surface between neighbours, relative to an image plane. Neighbours a pitch apart differ
/// in height by at most the part's steepness times their distance.
fn tilt(facts: &Facts<'_>) -> f64 {
    let (touch, pitch_mm, widened) = (&facts.touch, facts.least_pitch_mm(), 1.0 + facts.stretch);
    let rise_mm = touch.depth_mm.min(touch.steepness * widened * pitch_mm);
    let scene = facts.scene;
    let relief = scene.gel.relief.as_ref().map_or(0.0, |relief| relief.steepest(scene.reach_mm()));
    rise_mm / pitch_mm + relief * widened + facts.optics.tilt * widened
}
