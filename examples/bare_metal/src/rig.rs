//! The sensor: two cameras before a gel with printed markers. Calibration gives these figures for a real one.

use gelstereo_core::camera::Camera;
use gelstereo_core::rig::Rig;

/// Cameras and print, in one of three sizes.
struct Sensor {
    size_px: [usize; 2],
    focal_px: f64,
    baseline_mm: f64,
    markers: usize,
}

const SENSOR: Sensor = if cfg!(feature = "vga") {
    Sensor { size_px: [640, 480], focal_px: 560.0, baseline_mm: 8.0, markers: 25 }
} else if cfg!(feature = "qqvga") {
    Sensor { size_px: [160, 120], focal_px: 280.0, baseline_mm: 4.0, markers: 11 }
} else {
    Sensor { size_px: [320, 240], focal_px: 560.0, baseline_mm: 4.0, markers: 11 }
};

/// Image width and height, pixels.
pub const SIZE_PX: [usize; 2] = SENSOR.size_px;

/// Markers along each side of the print.
pub const MARKERS: usize = SENSOR.markers;

/// Distance of the cameras, mm.
pub const BASELINE_MM: f64 = SENSOR.baseline_mm;

/// Two parallel cameras.
pub fn rig() -> Rig {
    let [width_px, height_px] = SIZE_PX;
    let middle_px = |side_px: usize| 0.5 * (side_px as f64 - 1.0);
    let camera = Camera {
        width_px,
        height_px,
        fx_px: SENSOR.focal_px,
        fy_px: SENSOR.focal_px,
        cx_px: middle_px(width_px),
        cy_px: middle_px(height_px),
        distortion: [0.0; 5],
    };
    Rig::parallel(camera, BASELINE_MM)
}
