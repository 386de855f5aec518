//! The scene files that ship with the project: each loads, plans, runs, and gives the bits that the manual
//! says.
#![allow(clippy::unwrap_used)]

use gelstereo_core::math::DVec3;
use gelstereo_core::surface::TriangleMesh;
use gelstereo_sim::{Plan, Scene, Shape, Simulator, Truth};
use std::path::{Path, PathBuf};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn scenes() -> Vec<(String, Scene)> {
    let files = std::fs::read_dir(repository().join("scenes")).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> =
        files.filter(|path| path.extension().is_some_and(|e| e == "toml")).collect();
    files.sort();
    let load = |path: &PathBuf| {
        let text = std::fs::read_to_string(path).unwrap();
        let scene = toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        (path.file_stem().unwrap().to_string_lossy().into_owned(), scene)
    };
    files.iter().map(load).collect()
}

/// A binary STL file, its triangles as they stand there.
fn mesh(scene: &Scene) -> Option<TriangleMesh> {
    let Some(Shape::Mesh { path, units }) = &scene.indenter else { return None };
    assert_eq!(units, "mm");
    let bytes = std::fs::read(repository().join("scenes").join(path)).unwrap();
    let number = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    let count = u32::from_le_bytes(bytes[80..84].try_into().unwrap());
    assert_eq!(bytes.len(), 84 + 50 * count as usize);
    let vertex = |i: usize| {
        let at = 84 + 50 * (i / 3) + 12 + 12 * (i % 3);
        DVec3::new(number(at), number(at + 4), number(at + 8))
    };
    let vertices = (0..3 * count as usize).map(vertex).collect();
    let triangles = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Some(TriangleMesh::new(vertices, triangles).unwrap())
}

/// CRC-32 as of PNG and zlib.
fn crc32(bytes: &[u8], before: u32) -> u32 {
    let table: Vec<u32> = (0..256_u32)
        .map(|i| (0..8).fold(i, |c, _| if c & 1 == 1 { 0xEDB8_8320 ^ (c >> 1) } else { c >> 1 }))
        .collect();
    !bytes.iter().fold(!before, |c, &byte| table[usize::from(c as u8 ^ byte)] ^ (c >> 8))
}

/// Of both images at 0.3, 0.6 and 0.95 of the frames that arrive, as gelstereo_bench.reports.scenes does.
fn digest(scene: &Scene) -> String {
    let mut simulator = Simulator::new(scene, mesh(scene).as_ref()).unwrap();
    let (mut truth, mut left, mut right) = (Truth::default(), Vec::new(), Vec::new());
    let mut value = 0;
    for share in [0.3, 0.6, 0.95] {
        let arrived = (share * (simulator.delivered() - 1) as f64) as usize;
        let frame = simulator.frame_of(arrived).unwrap();
        simulator.moment(simulator.contact(frame).as_ref(), frame as u64, &mut truth);
        simulator.render(&truth, frame as u64, &mut left, &mut right);
        value = crc32(&right, crc32(&left, value));
    }
    format!("{value:08x}")
}

#[test]
fn crc32_is_the_usual_one() {
    assert_eq!(crc32(b"123456789", 0), 0xCBF4_3926);
    assert_eq!(crc32(b"6789", crc32(b"12345", 0)), 0xCBF4_3926);
}

/// The manual's digests were computed by the Python package: file, seed and nothing else decide the bits.
#[test]
fn every_scene_gives_the_bits_of_the_manual() {
    let page = std::fs::read_to_string(repository().join("docs/scenes.md")).unwrap();
    let scenes = scenes();
    assert!(scenes.len() >= 10);
    let found: Vec<String> =
        scenes.iter().map(|(name, scene)| format!("{name}: {}", digest(scene))).collect();
    let pinned = |name: &str| {
        let row = page.lines().find(|line| line.starts_with(&format!("| [{name}]"))).unwrap_or_default();
        row.rsplit('`').nth(1).unwrap_or_default().to_owned()
    };
    let expected: Vec<String> = scenes.iter().map(|(name, _)| format!("{name}: {}", pinned(name))).collect();
    assert_eq!(found, expected, "python -m gelstereo_bench.reports.scenes writes the page");
}

#[test]
fn every_scene_has_a_plan_and_survives_being_written() {
    for (name, scene) in scenes() {
        let plan = Plan::of(&scene, mesh(&scene).as_ref()).unwrap();
        assert!(plan.entries.iter().any(|entry| entry.on), "{name}");
        assert!(plan.cost_ns().is_finite() && plan.left_out().is_finite(), "{name}");
        let again: Scene = toml::from_str(&toml::to_string(&scene).unwrap()).unwrap();
        assert_eq!(again, scene, "{name}");
        // Planning the planned scene changes nothing more.
        assert_eq!(
            Plan::of(&plan.scene, mesh(&scene).as_ref()).unwrap().scene.effects,
            plan.scene.effects,
            "{name}"
        );
    }
}
