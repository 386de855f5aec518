//! Poses of every registration method, and of what follows a part from frame to frame.

use crate::part::{block, template, wedge};
use crate::sensing::{every, preset};
use crate::sensor::{Sensor, scene};
use crate::{Digests, Outcome};
use alloc::format;
use alloc::vec::Vec;
use gelstereo_core::contact::RestSurface;
use gelstereo_core::digest::Digest;
use gelstereo_core::force::MovedMarkers;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::motion::MotionTracker;
use gelstereo_core::params::{MotionParams, RegisterMethod, RegisterParams, SlipParams};
use gelstereo_core::pipeline::{Frame, Pipeline, Touch};
use gelstereo_core::register::{Localizer, Registrar};
use gelstereo_core::slip::RigidMotion;
use gelstereo_core::surface::TriangleMesh;

/// How far the part has turned in the frames that touch.
const TURNS_RAD: [f64; 3] = [0.0, 0.02, 0.04];

/// Starts of a search, a quarter of the default.
const STARTS: u32 = 32;

fn settings(method: RegisterMethod) -> RegisterParams {
    let mut params = RegisterParams { method, ..RegisterParams::default() };
    params.surface_search.starts = STARTS;
    params
}

/// The frames in which a part touches, and where it is.
fn touches(mesh: &TriangleMesh) -> Outcome<Vec<(Frame, Pose)>> {
    let scene = scene();
    let mut sensor = Sensor::new(&scene, mesh)?;
    let mut pipeline = Pipeline::new(&scene.rig, &preset("balanced")?)?;
    let mut frame = Frame::default();
    let (rest, _) = sensor.press(0.0, 0.0)?;
    rest.sense(&mut pipeline, &mut frame)?;
    let touching = TURNS_RAD.map(|turn_rad| {
        let (pair, pose) = sensor.press(0.9, turn_rad)?;
        pair.sense(&mut pipeline, &mut frame)?;
        Ok((frame.clone(), pose))
    });
    touching.into_iter().collect()
}

/// Beside a pose, as far as one knows beforehand.
fn beside(pose: &Pose) -> Pose {
    Pose::exp(DVec3::new(0.002, -0.003, 0.05), DVec3::new(0.2, -0.1, 0.1)) * *pose
}

pub fn methods(out: &mut Digests) -> Outcome<()> {
    use RegisterMethod as M;
    for (part, mesh) in [("wedge", wedge()?), ("block", block()?)] {
        let (template, touches, mut touch) = (template(&mesh)?, touches(&mesh)?, Touch::default());
        let (frame, pose) = touches.first().ok_or("nothing touches")?;
        for method in every!(M: FilterregPoint RansacIcp SurfaceClose SurfaceSearch) {
            let found = Registrar::new(&settings(method))
                .register(&touch.of(frame), &template, &beside(pose))
                .map_err(|error| format!("{part} by {method:?}: {error}"))?;
            out.push((format!("register/{part}/{method:?}"), found.digest()));
        }
        let mut turned = settings(M::SurfaceSearch);
        turned.surface_search.half_turn_budget = 120_000;
        let found = Registrar::new(&turned).register(&touch.of(frame), &template, &beside(pose))?;
        out.push((format!("register/{part}/half_turns"), found.digest()));
    }
    Ok(())
}

pub fn followed(out: &mut Digests) -> Outcome<()> {
    let mesh = wedge()?;
    let (template, touches, mut touch) = (template(&mesh)?, touches(&mesh)?, Touch::default());
    let (_, pose) = touches.first().ok_or("nothing touches")?;
    for method in [RegisterMethod::SurfaceClose, RegisterMethod::SurfaceSearch] {
        let mut localizer = Localizer::new(&settings(method), &beside(pose));
        let mut digest = Digest::new();
        for (frame, _) in &touches {
            let located = localizer.run(&touch.of(frame), &template)?;
            let misfit = located.misfit.map(|misfit| misfit.mean);
            digest = digest.u64(located.registration.digest()).u64(located.tracking as u64).f64s(misfit);
        }
        out.push((format!("follow/{method:?}"), digest.value()));
    }
    out.push(("follow/without_model".into(), without_model(&mesh)?.value()));
    Ok(())
}

/// A part that turns on the gel, without its template.
fn without_model(mesh: &TriangleMesh) -> Outcome<Digest> {
    let scene = scene();
    let mut sensor = Sensor::new(&scene, mesh)?;
    let mut pipeline = Pipeline::new(&scene.rig, &preset("balanced")?)?;
    let mut frame = Frame::default();
    sensor.press(0.0, 0.0)?.0.sense(&mut pipeline, &mut frame)?;
    let (rest, cols) = (RestSurface::new(&frame.points_mm)?, scene.gel.cols);
    let mut tracker = MotionTracker::new(&SlipParams::default(), &MotionParams::default(), &rest, cols)?;
    let mut digest = Digest::new();
    for turn_rad in TURNS_RAD {
        sensor.press(0.9, turn_rad)?.0.sense(&mut pipeline, &mut frame)?;
        let Frame { points_mm, covariance_mm2, state, patch, .. } = &frame;
        let moved = MovedMarkers { points_mm, covariance_mm2, state, patch };
        let motion = tracker.run(&moved)?.ok_or("nothing touches")?;
        let RigidMotion { pose, about_mm, covariance } = motion.since_touch;
        digest = digest
            .f64s(pose.to_rows().into_iter().flatten())
            .f64s(about_mm.to_array())
            .f64s(covariance.into_iter().flatten())
            .u64(u64::from(motion.determined));
    }
    Ok(digest)
}
