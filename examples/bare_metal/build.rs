//! Chooses the board's memory, renders what the program senses, and computes here what it must find there.

extern crate alloc;

#[path = "src/pose.rs"]
mod pose;
#[path = "src/rig.rs"]
mod rig;
#[path = "src/sensing.rs"]
mod sensing;

use gelstereo_core::digest::Digest;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::Params;
use gelstereo_core::register::Template;
use gelstereo_core::surface::TriangleMesh;
use gelstereo_sim::effects::{Defocus, Effects, SensorNoise};
use gelstereo_sim::{ContactState, Gel, Scene, Shape, Simulator, Truth};
use pose::Locator;
use sensing::{FRAMES, Outcome, PAIRS, Sensing, pair_of, preset};
use std::path::Path;
use std::{env, fs};

/// How deep the part is pressed in each pair, mm.
const PRESSES_MM: [f64; PAIRS] = [0.0, 0.4, 0.7, 1.0];

/// Distance of the template's samples, mm.
const SPACING_MM: f64 = 0.5;

fn main() -> Outcome<()> {
    let out = env::var("OUT_DIR")?;
    let board = env::var("GELSTEREO_BOARD")?;
    let memory = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("boards").join(board);
    println!("cargo:rustc-link-search={}", memory.display());
    println!("cargo:rerun-if-changed={}", memory.display());
    println!("cargo:rerun-if-env-changed=GELSTEREO_BOARD");
    for source in ["build.rs", "src/pose.rs", "src/rig.rs", "src/sensing.rs"] {
        println!("cargo:rerun-if-changed={source}");
    }

    let mesh = wedge()?;
    let template = Template::from_mesh(&mesh, SPACING_MM, 1)?.to_bytes();
    let (pairs, pose) = press(&mesh)?;
    fs::write(format!("{out}/template.bin"), &template)?;
    for (i, pair) in pairs.iter().enumerate() {
        fs::write(format!("{out}/pair{i}.grey"), pair)?;
    }
    let (mut sensed, mut located) = (Vec::new(), Vec::new());
    for name in Params::PRESETS {
        let digests = expected(name, &pairs, &template, &pose)?;
        sensed.push(digests.0);
        located.push(digests.1);
    }
    let bytes: usize = pairs.iter().map(Vec::len).sum();
    let pairs: String = (0..PAIRS).map(|i| format!("include_bytes!(\"pair{i}.grey\"), ")).collect();
    let text = format!(
        "pub const PAIRS: [&[u8]; {PAIRS}] = [{pairs}];\n\
         pub const SENSED: [u64; {presets}] = {sensed:?};\n\
         pub const BYTES: usize = {bytes} + if cfg!(feature = \"pose\") {{ {template} }} else {{ 0 }};\n\
         #[cfg(feature = \"pose\")]\n\
         pub const TEMPLATE: &[u8] = include_bytes!(\"template.bin\");\n\
         #[cfg(feature = \"pose\")]\n\
         pub const T_SENSOR_PART: [[f64; 4]; 4] = {pose:?};\n\
         #[cfg(feature = \"pose\")]\n\
         pub const LOCATED: [u64; {presets}] = {located:?};\n",
        presets = sensed.len(),
        template = template.len(),
        pose = pose.to_rows(),
    );
    Ok(fs::write(format!("{out}/scene.rs"), text)?)
}

/// Digests of all frames and of the pose by a preset.
fn expected(name: &str, pairs: &[Vec<u8>], template: &[u8], pose: &Pose) -> Outcome<(u64, u64)> {
    let params = preset(name)?;
    let (mut sensing, mut digest) = (Sensing::new(&params)?, Digest::new());
    for frame in 0..FRAMES {
        sensing.sense(&pairs[pair_of(frame)])?;
        digest = digest.u64(sensing.frame.digest());
    }
    let found = Locator::new(&params, template)?.locate(&sensing.frame, &pose::guess(pose))?;
    Ok((digest.value(), found.digest()))
}

/// The images of a press, and where the part is in the last one.
fn press(mesh: &TriangleMesh) -> Outcome<(Vec<Vec<u8>>, Pose)> {
    let middle_mm = 0.5 * rig::BASELINE_MM;
    let scene = Scene {
        rig: rig::rig(),
        gel: Gel { rows: rig::MARKERS, cols: rig::MARKERS, centre_mm: [middle_mm, 0.0], ..Gel::default() },
        effects: Effects {
            defocus: Some(Defocus::default()),
            sensor_noise: Some(SensorNoise::default()),
            ..Effects::of_gel()
        },
        indenter: Some(Shape::Mesh { path: String::new(), units: "mm".into() }),
        ..Scene::default()
    };
    let mut simulator = Simulator::new(&scene, Some(mesh))?;
    let before_gel = Pose::from_translation_mm(DVec3::new(middle_mm, 0.0, 40.0));
    let lying = before_gel * Pose::exp(DVec3::new(0.1, -0.05, 0.3), DVec3::ZERO);
    let (mut pairs, mut truth, mut pose) = (Vec::new(), Truth::default(), lying);
    for (i, press_mm) in PRESSES_MM.into_iter().enumerate() {
        pose = simulator.pressed(lying, press_mm).ok_or("the part does not reach the gel")?;
        let contact = Some(ContactState::pressed(pose)).filter(|_| press_mm > 0.0);
        simulator.truth(contact.as_ref(), &mut truth);
        let (mut left, mut right) = (Vec::new(), Vec::new());
        simulator.render(&truth, i as u64, &mut left, &mut right);
        left.append(&mut right);
        pairs.push(left);
    }
    Ok((pairs, pose))
}

/// A blunt wedge whose two ends differ, so that no turn maps it onto itself.
fn wedge() -> Outcome<TriangleMesh> {
    // x changes fastest and z slowest, mm.
    let corners = [
        [-2.6, -1.6, -1.5],
        [2.4, -1.2, -1.5],
        [-1.8, 1.4, -1.5],
        [2.0, 2.2, -1.5],
        [-3.5, -2.5, 2.0],
        [3.5, -2.5, 2.0],
        [-2.5, 2.5, 2.0],
        [3.0, 3.0, 2.0],
    ];
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Ok(TriangleMesh::new(corners.map(DVec3::from_array).to_vec(), triangles)?)
}
