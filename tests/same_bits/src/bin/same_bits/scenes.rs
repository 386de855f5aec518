//! The scene files that ship with the project, at a moment of contact.

use gelstereo_core::digest::Digest;
use gelstereo_core::math::DVec3;
use gelstereo_core::surface::TriangleMesh;
use gelstereo_sim::{Scene, Shape, Simulator, Truth};
use same_bits::{Digests, Outcome};
use std::path::{Path, PathBuf};

/// Where most scenes' parts touch, as a share of the frames.
const MOMENT: f64 = 0.6;

pub fn run(out: &mut Digests) -> Outcome<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let mut files = Vec::new();
    for entry in std::fs::read_dir(&folder)? {
        files.push(entry?.path());
    }
    files.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    for path in files {
        let scene: Scene = toml::from_str(&std::fs::read_to_string(&path)?)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        out.push((format!("scene/{name}"), digest(&scene, &folder)?));
    }
    Ok(())
}

/// Of truth and images.
fn digest(scene: &Scene, folder: &Path) -> Outcome<u64> {
    let mesh = match &scene.indenter {
        Some(Shape::Mesh { path, .. }) => Some(binary_stl(&folder.join(path))?),
        _ => None,
    };
    let mut simulator = Simulator::new(scene, mesh.as_ref())?;
    let arrived = (MOMENT * (simulator.delivered() as f64 - 1.0)) as usize;
    let frame = simulator.frame_of(arrived).ok_or("no frame arrives")?;
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    simulator.moment(simulator.contact(frame).as_ref(), frame as u64, &mut truth);
    simulator.render(&truth, frame as u64, &mut left, &mut right);
    let points = truth.points_mm.iter().flat_map(|point| point.to_array());
    Ok(Digest::new().f64s(points).bytes(&left).bytes(&right).value())
}

fn binary_stl(path: &PathBuf) -> Outcome<TriangleMesh> {
    let bytes = std::fs::read(path)?;
    let facets = bytes.get(84..).ok_or("no binary STL file")?.chunks_exact(50);
    let mut vertices = Vec::new();
    for number in facets.flat_map(|facet| facet[12..48].chunks_exact(12)) {
        let coordinate = |at: usize| f32::from_le_bytes([0, 1, 2, 3].map(|i| number[4 * at + i]));
        vertices.push(DVec3::from_array([0, 1, 2].map(|axis| f64::from(coordinate(axis)))));
    }
    let triangles = (0..vertices.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Ok(TriangleMesh::new(vertices, triangles)?)
}
