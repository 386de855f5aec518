//! The sensor: two cameras before a gel with printed markers. Calibration gives these figures for a real one.

use gelstereo_core::camera::Camera;
use gelstereo_core::rig::Rig;

const IS_VGA: bool = cfg!(feature = "vga");

/// Image width and height, pixels.
pub const SIZE_PX: [usize; 2] = if IS_VGA { [640, 480] } else { [320, 240] };

/// Markers along each side of the print.
pub const MARKERS: usize = if IS_VGA { 25 } else { 11 };

/// Distance of the cameras, mm.
pub const BASELINE_MM: f64 = if IS_VGA { 8.0 } else { 4.0 };

/// Focal length, pixels.
const FOCAL_PX: f64 = 560.0;

/// Two parallel cameras.
pub fn rig() -> Rig {
    let [width_px, height_px] = SIZE_PX;
    let middle_px = |side_px: usize| 0.5 * (side_px as f64 - 1.0);
    let camera = Camera {
        width_px,
        height_px,
        fx_px: FOCAL_PX,
        fy_px: FOCAL_PX,
        cx_px: middle_px(width_px),
        cy_px: middle_px(height_px),
        distortion: [0.0; 5],
    };
    Rig::parallel(camera, BASELINE_MM)
}
