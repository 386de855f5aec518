//! What the rig itself does to the dots' images.

use crate::plan::{Bound, Facts, Switch};
use crate::scene::Scene;
use gelstereo_core::camera::Camera;

/// Effects that a scene has through its rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Optics {
    /// Layers before the markers (`rig.layers`); without it light goes straight.
    Refraction,
    /// Distortion of the lenses; without it they have none.
    LensDistortion,
    /// The image of a disc has its centroid beside the image of the disc's centre; without it both are one.
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

    /// Whether a scene has it.
    pub(crate) fn is_in(self, scene: &Scene) -> bool {
        match self {
            Self::Refraction => scene.rig.layers.is_some(),
            Self::LensDistortion => {
                [&scene.rig.left, &scene.rig.right].into_iter().any(|camera| camera.distortion != [0.0; 5])
            }
            Self::EllipseBias => true,
        }
    }

    /// Takes it out of a scene.
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

    /// As [`crate::plan::Effect::cost_ns`]. A dot's outline takes six projections instead of one with its derivatives when
    /// its own bias is on.
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

/// From the image of a dot's centre to its image's centroid, at most.
///
/// A pinhole's is f (v - slope v_z) / Z with v = -(a a_z + b b_z) / Z for a disc of radii a and b: it grows with their
/// tilt. To that comes what lenses and layers bend.
pub(crate) fn ellipse_bias_px(facts: &Facts<'_>) -> f64 {
    if facts.scene.switches.ellipse_bias == Some(Switch::Off) {
        return 0.0;
    }
    let optics = &facts.optics;
    let (widened, tilted) = (1.0 + facts.stretch, tilt(facts));
    let pinhole = core::f64::consts::SQRT_2 * widened * tilted + optics.slope * 2.0 * tilted * tilted;
    // Layers bend like k1 = Σ d (n² - 1) / (2 n³) / Z; (n² - 1) / n³ is at most 0.385.
    let layers = if facts.scene.rig.layers.is_some() { 0.385 * 0.5 * optics.slope } else { 0.0 };
    square_px(facts) * pinhole + bent_px(facts, layers) + lens_bias_px(facts)
}

/// What the lenses add to it. (The centroid of the image before the lens is distorted as any point is.)
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

/// What bends straight lines moves a disc's centroid by an eighth of the squared radius times its Laplacian (that of r² p
/// is 8 p); twice that is taken for discs that are tilted and stretched.
fn bent_px(facts: &Facts<'_>, bent: f64) -> f64 {
    let larger = 1.0 + facts.stretch + tilt(facts);
    2.0 * square_px(facts) * bent * larger * larger
}

/// f (r / Z)² of the largest dot.
fn square_px(facts: &Facts<'_>) -> f64 {
    let radius = facts.dot_radius_mm() * facts.optics.lateral_px_per_mm / facts.optics.f_px;
    facts.optics.f_px * radius * radius
}

/// Rise of the surface from one neighbour to the next, against an image plane. Neighbours a pitch apart differ in height
/// by no more than the part's steepness over their distance.
fn tilt(facts: &Facts<'_>) -> f64 {
    let (touch, pitch_mm, widened) = (&facts.touch, facts.least_pitch_mm(), 1.0 + facts.stretch);
    let rise_mm = touch.depth_mm.min(touch.steepness * widened * pitch_mm);
    rise_mm / pitch_mm + facts.optics.tilt * widened
}
