//! A small simulated sensor, and what presses on it: 11 x 11 markers in images of 304 x 216 pixels.

use crate::Outcome;
use crate::part;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::digest::Digest;
use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::rig::Rig;
use gelstereo_core::surface::TriangleMesh;
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{Defocus, Effects, SensorNoise};
use gelstereo_sim::{ContactState, Gel, Scene, Shape, Simulator, Truth};

/// Depth of every frame of a press; the first ones are at rest.
pub const PRESSES_MM: [f64; 5] = [0.0, 0.0, 0.4, 0.7, 1.0];

const WIDTH: usize = 304;
const HEIGHT: usize = 216;

/// The pixels of a stereo pair.
pub struct Pair {
    width: usize,
    height: usize,
    left: Vec<u8>,
    right: Vec<u8>,
}

impl Pair {
    /// Has a pipeline process it.
    pub fn sense(&self, pipeline: &mut Pipeline, frame: &mut Frame) -> Outcome<()> {
        let view = |pixels| GrayView::new(pixels, self.width, self.height, self.width);
        Ok(pipeline.process(view(&self.left)?, view(&self.right)?, frame)?)
    }

    pub fn digest(&self, digest: Digest) -> Digest {
        digest.bytes(&self.left).bytes(&self.right)
    }
}

pub fn scene() -> Scene {
    let camera = Camera {
        width_px: WIDTH,
        height_px: HEIGHT,
        fx_px: 560.0,
        fy_px: 560.0,
        cx_px: 0.5 * (WIDTH as f64 - 1.0),
        cy_px: 0.5 * (HEIGHT as f64 - 1.0),
        distortion: [0.0; 5],
    };
    Scene {
        rig: Rig::parallel(camera, 4.0),
        gel: Gel { rows: 11, cols: 11, centre_mm: [2.0, 0.0], ..Gel::default() },
        effects: Effects {
            defocus: Some(Defocus::default()),
            sensor_noise: Some(SensorNoise::default()),
            ..Effects::of_gel()
        },
        indenter: Some(Shape::Mesh { path: String::new(), units: "mm".into() }),
        ..Scene::default()
    }
}

/// A scene's simulator, with a mesh pressed into it.
pub struct Sensor {
    simulator: Simulator,
    truth: Truth,
    size: [usize; 2],
    frames: u64,
}

impl Sensor {
    pub fn new(scene: &Scene, mesh: &TriangleMesh) -> Outcome<Self> {
        let simulator = Simulator::new(scene, Some(mesh))?;
        let size = [scene.rig.left.width_px, scene.rig.left.height_px];
        Ok(Self { simulator, truth: Truth::default(), size, frames: 0 })
    }

    /// The part lies across the gel and is pressed so deep; 0 takes it away. Returns where it is.
    pub fn press(&mut self, press_mm: f64, turn_rad: f64) -> Outcome<(Pair, Pose)> {
        let over_gel = Pose::from_translation_mm(DVec3::new(2.0, 0.0, 40.0));
        let lying = over_gel * Pose::exp(DVec3::new(0.1, -0.05, 0.3 + turn_rad), DVec3::ZERO);
        let pose = self.simulator.pressed(lying, press_mm).ok_or("nothing presses")?;
        let contact = Some(ContactState::pressed(pose)).filter(|_| press_mm > 0.0);
        self.simulator.truth(contact.as_ref(), &mut self.truth);
        let (mut left, mut right) = (Vec::new(), Vec::new());
        self.simulator.render(&self.truth, self.frames, &mut left, &mut right);
        self.frames += 1;
        let [width, height] = self.size;
        Ok((Pair { width, height, left, right }, pose))
    }
}

/// The images of a press.
pub fn press(scene: &Scene) -> Outcome<Vec<Pair>> {
    let mut sensor = Sensor::new(scene, &part::wedge()?)?;
    PRESSES_MM.iter().map(|&press_mm| Ok(sensor.press(press_mm, 0.0)?.0)).collect()
}

/// The digests of every frame of some images.
pub fn sense(pairs: &[Pair], pipeline: &mut Pipeline, mut digest: Digest) -> Outcome<Digest> {
    let mut frame = Frame::default();
    for pair in pairs {
        pair.sense(pipeline, &mut frame)?;
        digest = digest.u64(frame.digest());
    }
    let seen = frame.state.iter().filter(|&&state| state == MarkerState::Seen).count();
    if 2 * seen < frame.state.len() || seen == 0 {
        return Err(format!("{seen} of {} markers are seen", frame.state.len()).into());
    }
    Ok(digest)
}

/// The same, afresh.
pub fn sense_afresh(scene: &Scene, pairs: &[Pair], params: &Params) -> Outcome<Digest> {
    sense(pairs, &mut Pipeline::new(&scene.rig, params)?, Digest::new())
}
