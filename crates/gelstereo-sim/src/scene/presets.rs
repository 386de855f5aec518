//! Sensors by name.

use super::{Gel, Scene};
use alloc::vec::Vec;
use gelstereo_core::camera::{Camera, Layer, Layers};
use gelstereo_core::math::DVec3;
use gelstereo_core::rig::Rig;

/// Image width and height, focal length and baseline.
type Cameras = (usize, usize, f64, f64);

const VGA: Cameras = (640, 480, 560.0, 8.0);
const HD: Cameras = (1280, 720, 652.0, 6.5);
/// The optics of `VGA` with pixels half as wide.
const FINE: Cameras = (1280, 960, 1120.0, 8.0);

/// Markers along each side and their pitch: about the same 22 mm of gel.
type Print = (usize, f64);

const COARSE: Print = (25, 0.9);
const MIDDLE: Print = (45, 0.5);
const DENSE: Print = (71, 0.32);

const SENSORS: [(&str, Cameras, Print); 9] = [
    ("640x480-25", VGA, COARSE),
    ("640x480-45", VGA, MIDDLE),
    ("640x480-71", VGA, DENSE),
    ("1280x720-25", HD, COARSE),
    ("1280x720-45", HD, MIDDLE),
    ("1280x720-71", HD, DENSE),
    ("1280x960-25", FINE, COARSE),
    ("1280x960-45", FINE, MIDDLE),
    ("1280x960-71", FINE, DENSE),
];

const REFRACTION: &str = "640x480-25-refraction";

impl Scene {
    /// Names for [`Self::preset`]: image size and markers along each side. All have the surface at 28.7
    /// mm and a gel of about 22 mm, except the last one. It has 20 mm of air, 3 mm of acrylic and 5 mm
    /// of gel between cameras and markers, and a lattice of 15.6 mm that both cameras see.
    pub const PRESETS: [&'static str; 10] = {
        let mut names = [REFRACTION; 10];
        let mut i = 0;
        while i < SENSORS.len() {
            names[i] = SENSORS[i].0;
            i += 1;
        }
        names
    };

    /// A sensor by name, without effects or contact; `640x480-25` is the default scene.
    #[must_use]
    pub fn preset(name: &str) -> Option<Self> {
        if name == REFRACTION {
            return Some(Self::refraction());
        }
        let &(_, cameras, (markers, pitch_mm)) = SENSORS.iter().find(|sensor| sensor.0 == name)?;
        let rig = rig(cameras);
        let centre_mm = [0.5 * rig.baseline_mm(), 0.0];
        let default = Gel::default();
        let dot_radius_mm = if markers == default.rows { default.dot_radius_mm } else { 0.244 * pitch_mm };
        let gel = Gel {
            rows: markers,
            cols: markers,
            pitch_mm: pitch_mm.into(),
            dot_radius_mm,
            centre_mm,
            ..default
        };
        Some(Self { rig, gel, ..Self::default() })
    }

    fn refraction() -> Self {
        let acrylic = Layer { thickness_mm: 3.0, index: 1.49 };
        let plates = Vec::from([acrylic]);
        let layers = Layers { normal: DVec3::Z, gap_mm: 20.0, plates, gel_index: 1.41 };
        let rig = Rig { layers: Some(layers), ..rig((640, 480, 600.0, 10.0)) };
        let gel = Gel {
            pitch_mm: 0.65.into(),
            dot_radius_mm: 0.16,
            centre_mm: [5.0, 0.0],
            surface_mm: 28.0,
            ..Gel::default()
        };
        Self { rig, gel, ..Self::default() }
    }
}

/// Two parallel cameras with centred principal points.
fn rig((width_px, height_px, f_px, baseline_mm): Cameras) -> Rig {
    let middle = |side: usize| 0.5 * (side as f64 - 1.0);
    let camera = Camera {
        width_px,
        height_px,
        fx_px: f_px,
        fy_px: f_px,
        cx_px: middle(width_px),
        cy_px: middle(height_px),
        distortion: [0.0; 5],
    };
    Rig::parallel(camera, baseline_mm)
}
