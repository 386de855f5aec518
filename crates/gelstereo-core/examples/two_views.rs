//! Two grey images to points: the sensing pipeline in Rust, without files and without a camera.
//!
//! `cargo run --release -p gelstereo-core --example two_views`
//!
//! The images are drawn here: dark dots on a gel, at rest and with a ball in it. Replace `draw` by your two
//! cameras, and `rig` by their calibration.
#![allow(clippy::print_stdout, reason = "it is a program")]

use gelstereo_core::camera::Camera;
use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::rig::Rig;
use std::error::Error;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// The gel: 21 by 21 markers, 0.9 mm apart, 28 mm before the cameras.
const SIDE: usize = 21;
const PITCH_MM: f64 = 0.9;
const REST_MM: f64 = 28.0;

/// Two equal cameras, 8 mm apart.
fn rig() -> Rig {
    let (width_px, height_px) = (WIDTH, HEIGHT);
    let camera = Camera {
        width_px,
        height_px,
        fx_px: 560.0,
        fy_px: 560.0,
        cx_px: 319.5,
        cy_px: 239.5,
        distortion: [0.0; 5],
    };
    Rig::parallel(camera, 8.0)
}

/// Both images of the gel with a ball of 6 mm radius pressed `depth_mm` into it.
fn draw(rig: &Rig, depth_mm: f64) -> Result<[Vec<u8>; 2], Box<dyn Error>> {
    let mut images = [vec![170; WIDTH * HEIGHT], vec![170; WIDTH * HEIGHT]];
    let middle = (SIDE / 2) as f64;
    for index in 0..SIDE * SIDE {
        let x = (index % SIDE) as f64 - middle;
        let y = (index / SIDE) as f64 - middle;
        let (x_mm, y_mm) = (4.0 + PITCH_MM * x, PITCH_MM * y);
        let away_mm2 = (x_mm - 4.0).powi(2) + y_mm.powi(2);
        let lift_mm = (depth_mm - away_mm2 / 12.0).max(0.0);
        let (left_px, right_px) = rig.project(DVec3::new(x_mm, y_mm, REST_MM - lift_mm))?;
        draw_dot(&mut images[0], left_px);
        draw_dot(&mut images[1], right_px);
    }
    Ok(images)
}

/// A dot of 4.4 px radius with a soft rim.
fn draw_dot(image: &mut [u8], centre_px: DVec2) {
    let (x, y) = (centre_px.x.round() as usize, centre_px.y.round() as usize);
    for row in y.saturating_sub(7)..(y + 8).min(HEIGHT) {
        for col in x.saturating_sub(7)..(x + 8).min(WIDTH) {
            let away_px = DVec2::new(col as f64, row as f64).distance(centre_px);
            let ink = 1.0 / (1.0 + (2.5 * (away_px - 4.4)).exp());
            image[row * WIDTH + col] = (170.0 - 110.0 * ink).round() as u8;
        }
    }
}

/// Senses both moments; the second frame.
fn sense() -> Result<Frame, Box<dyn Error>> {
    let rig = rig();
    let mut params = Params::preset("balanced").ok_or("there is no such preset")?;
    params.lattice.pitch_mm = PITCH_MM.into();
    let mut pipeline = Pipeline::new(&rig, &params)?;
    // The lists of a frame are reused, so that nothing is allocated after the first one.
    let mut frame = Frame::default();
    // The first frame is the rest frame: nothing touches the gel in it.
    for depth_mm in [0.0, 1.0] {
        let [left, right] = draw(&rig, depth_mm)?;
        let left = GrayView::new(&left, WIDTH, HEIGHT, WIDTH)?;
        let right = GrayView::new(&right, WIDTH, HEIGHT, WIDTH)?;
        pipeline.process(left, right, &mut frame)?;
    }
    Ok(frame)
}

fn main() -> Result<(), Box<dyn Error>> {
    let frame = sense()?;
    println!("{} rows x {} columns of markers", frame.rows, frame.cols);
    println!("row col      x       y       z  indentation, mm");
    for (index, point) in frame.points_mm.iter().enumerate().filter(|&(index, _)| frame.patch[index]) {
        let (row, col) = (index / frame.cols, index % frame.cols);
        let [x, y, z] = point.to_array();
        println!("{row:3} {col:3} {x:7.3} {y:7.3} {z:7.3} {:7.3}", frame.indentation_mm[index]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    /// The deepest marker is that below the ball's middle, 1 mm deep.
    #[test]
    fn the_ball_is_where_it_was_drawn() {
        let frame = super::sense().unwrap();
        assert_eq!((frame.rows, frame.cols), (super::SIDE, super::SIDE));
        let middle = super::SIDE * super::SIDE / 2;
        assert!((frame.indentation_mm[middle] - 1.0).abs() < 0.03);
        assert!(frame.patch[middle] && !frame.patch[0]);
    }
}
