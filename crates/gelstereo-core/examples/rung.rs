//! Runs one stage on given input, for instruction counts under callgrind.
//!
//! ```text
//! rung detect   params.toml image.pgm image.pgm
//! rung workload params.toml image.pgm
//! rung frame    params.toml rig.toml left0.pgm right0.pgm left1.pgm right1.pgm ...
//! rung frames   params.toml rig.toml left0.pgm right0.pgm left1.pgm right1.pgm ...
//! rung afresh   params.toml rig.toml left0.pgm right0.pgm
//! rung register params.toml template.txt patch.txt guess.txt
//! rung localize params.toml part.txt contact.txt ...
//! ```
//!
//! All input but the last piece warms up; only the last runs inside [`measured`], which `--toggle-collect`
//! names. `frames` measures all frames but the first, there and back twice, one by one: `--dump-after` gives
//! each its own count. `afresh` measures a frame without a predecessor. Text files hold numbers separated
//! by white space: x y z nx ny nz per template point after one line with the spacing, x y z per patch point,
//! and the rows of the guess. `localize` measures every contact on a part's surface with all its markers: the
//! part is a count of vertices, their x y z, and the corners of the triangles; a contact the rows of the
//! guess, a count of salient points, x y z and xx yy zz xy xz yz of the covariance of each, and x y z of the
//! others. It prints the digest, microseconds, and rows of the pose for each.
#![allow(clippy::print_stdout, reason = "it is a program")]

#[path = "support/pgm.rs"]
mod pgm;

use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::image::GrayView;
use gelstereo_core::math::{DVec3, Pose};
use gelstereo_core::params::{FindAt, Params};
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::register::{Contact, Registrar, Template};
use gelstereo_core::rig::Rig;
use gelstereo_core::surface::TriangleMesh;
use pgm::{Outcome, Pgm};
use std::fs;
use std::time::Instant;

fn main() -> Outcome<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [stage, params, files @ ..] = words.as_slice() else {
        return Err(
            "usage: rung detect|workload|frame|frames|afresh|register|localize params.toml FILES".into()
        );
    };
    let params: Params = toml::from_str(&fs::read_to_string(params)?)?;
    let outcome = match stage.as_str() {
        "detect" => detect(&params, files)?,
        "workload" => workload(&params, files)?,
        "frame" => frame(&params, files)?,
        "frames" => frames(&params, files)?,
        "afresh" => afresh(&params, files)?,
        "register" => register(&params, files)?,
        "localize" => localize(&params, files)?,
        other => return Err(format!("no stage {other}").into()),
    };
    println!("{outcome}");
    Ok(())
}

/// What callgrind counts.
#[inline(never)]
fn measured<T>(work: impl FnOnce() -> T) -> T {
    work()
}

fn detect(params: &Params, files: &[String]) -> Outcome<String> {
    let images = files.iter().map(|path| Pgm::read(path)).collect::<Outcome<Vec<_>>>()?;
    let (last, warm_up) = images.split_last().ok_or("no image")?;
    let (mut detector, mut markers) = (Detector::new(&params.detect), Markers::default());
    for image in warm_up {
        detector.run(image.view()?, &mut markers)?;
    }
    let view = last.view()?;
    measured(|| detector.run(view, &mut markers))?;
    Ok(format!("{} markers", markers.centres_px.len()))
}

/// Area of the usual marker, and the detector's [`Workload`](gelstereo_core::detect::Workload).
fn workload(params: &Params, files: &[String]) -> Outcome<String> {
    let [file] = files else { return Err("give one image".into()) };
    let (mut detector, mut markers) = (Detector::new(&params.detect), Markers::default());
    detector.run(Pgm::read(file)?.view()?, &mut markers)?;
    markers.area_px2.sort_unstable();
    let usual_px2 = markers.area_px2.get(markers.area_px2.len() / 2).copied().unwrap_or(0);
    let found = detector.workload();
    Ok(format!(
        "usual_px2 {usual_px2}\nis_half_size {}\nclosed_px {}\nnoise_rows {}\nrows_beside_noise {}\n\
         fit_groups {}\nsums_pixels {}",
        u8::from(found.found_at == FindAt::HalfSize),
        found.closed_px,
        found.noise_rows,
        found.rows_beside_noise,
        found.fit_groups,
        u8::from(found.sums_pixels),
    ))
}

fn frame(params: &Params, files: &[String]) -> Outcome<String> {
    let (mut pipeline, images) = pipeline(params, files)?;
    let (pairs, mut out) = (pairs(&images)?, Frame::default());
    let (&[left, right], warm_up) = pairs.split_last().ok_or("no images")?;
    for &[left, right] in warm_up {
        pipeline.process(left, right, &mut out)?;
    }
    measured(|| pipeline.process(left, right, &mut out))?;
    Ok(format!("digest {:016x}", out.digest()))
}

fn frames(params: &Params, files: &[String]) -> Outcome<String> {
    let (mut pipeline, images) = pipeline(params, files)?;
    let (pairs, mut out) = (pairs(&images)?, Frame::default());
    let (&[left, right], later) = pairs.split_first().ok_or("no images")?;
    pipeline.process(left, right, &mut out)?;
    for &[left, right] in later.iter().chain(pairs.iter().rev().skip(1)).cycle().take(4 * later.len()) {
        measured(|| pipeline.process(left, right, &mut out))?;
    }
    Ok(format!("digest {:016x}", out.digest()))
}

fn afresh(params: &Params, files: &[String]) -> Outcome<String> {
    let (mut pipeline, images) = pipeline(params, files)?;
    let (pairs, mut out) = (pairs(&images)?, Frame::default());
    let &[left, right] = pairs.first().ok_or("no images")?;
    pipeline.process(left, right, &mut out)?;
    measured(|| {
        pipeline.reset();
        pipeline.process(left, right, &mut out)
    })?;
    Ok(format!("digest {:016x}", out.digest()))
}

/// For the rig of the first file; the others are images.
fn pipeline(params: &Params, files: &[String]) -> Outcome<(Pipeline, Vec<Pgm>)> {
    let (rig, files) = files.split_first().ok_or("no rig")?;
    let rig: Rig = toml::from_str(&fs::read_to_string(rig)?)?;
    let images = files.iter().map(|path| Pgm::read(path)).collect::<Outcome<_>>()?;
    Ok((Pipeline::new(&rig, params)?, images))
}

fn pairs(images: &[Pgm]) -> Outcome<Vec<[GrayView<'_>; 2]>> {
    images.chunks_exact(2).map(|pair| Ok([pair[0].view()?, pair[1].view()?])).collect()
}

fn register(params: &Params, files: &[String]) -> Outcome<String> {
    let [template, patch, guess] = files else { return Err("give template, patch and guess".into()) };
    let (template, patch, guess) = (numbers(template)?, numbers(patch)?, numbers(guess)?);
    let (spacing_mm, rows) = template.split_first().ok_or("the template is empty")?;
    let points: Vec<DVec3> = rows.chunks_exact(6).map(|row| DVec3::new(row[0], row[1], row[2])).collect();
    let normals: Vec<DVec3> = rows.chunks_exact(6).map(|row| DVec3::new(row[3], row[4], row[5])).collect();
    let template = Template::new(&points, &normals, *spacing_mm)?;
    let patch: Vec<DVec3> = patch.chunks_exact(3).map(DVec3::from_slice).collect();
    let guess = pose(&guess)?;
    let mut registrar = Registrar::new(&params.register);
    registrar.run(&patch, &template, &guess)?;
    let found = measured(|| registrar.run(&patch, &template, &guess))?;
    Ok(format!("digest {:016x}", found.digest()))
}

fn localize(params: &Params, files: &[String]) -> Outcome<String> {
    let (part, contacts) = files.split_first().ok_or("no part")?;
    let template = Template::from_mesh(&mesh(&numbers(part)?)?, Template::DEFAULT_SPACING_MM, 1)?;
    let mut registrar = Registrar::new(&params.register);
    let mut lines = Vec::new();
    for path in contacts {
        let numbers = numbers(path)?;
        let (guess, rest) = numbers.split_at_checked(16).ok_or("no guess")?;
        let (&salient, rest) = rest.split_first().ok_or("no count of salient points")?;
        let (salient, others) =
            rest.split_at_checked(9 * salient as usize).ok_or("too few salient points")?;
        let points_mm: Vec<DVec3> = salient.chunks_exact(9).map(DVec3::from_slice).collect();
        let covariance_mm2: Vec<_> = salient
            .chunks_exact(9)
            .map(|row| {
                let [xx, yy, zz, xy, xz, yz] = std::array::from_fn(|k| row[3 + k]);
                [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
            })
            .collect();
        let unpressed_mm: Vec<DVec3> = others.chunks_exact(3).map(DVec3::from_slice).collect();
        let contact = Contact {
            covariance_mm2: Some(&covariance_mm2),
            unpressed_mm: &unpressed_mm,
            decay_mm: params.contact.decay_mm,
            ..Contact::new(&points_mm)
        };
        let guess = pose(guess)?;
        let start = Instant::now();
        let found = measured(|| registrar.register(&contact, &template, &guess));
        let us = start.elapsed().as_nanos() as f64 * 1e-3;
        lines.push(match found {
            Ok(found) => {
                let rows = found.t_sensor_object.to_rows();
                let rows: Vec<String> = rows.iter().flatten().map(|x| format!("{x:e}")).collect();
                format!("digest {:016x} {us:.1} us {}", found.digest(), rows.join(" "))
            }
            Err(error) => format!("refused {us:.1} us {error}"),
        });
    }
    Ok(lines.join("\n"))
}

/// Of a count of vertices, their coordinates, and the corners of triangles.
fn mesh(numbers: &[f64]) -> Outcome<TriangleMesh> {
    let (&count, rest) = numbers.split_first().ok_or("the part is empty")?;
    let (vertices, corners) = rest.split_at_checked(3 * count as usize).ok_or("too few vertices")?;
    let corners: Vec<u32> = corners.iter().map(|&k| k as u32).collect();
    let triangles = corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    Ok(TriangleMesh::new(vertices.chunks_exact(3).map(DVec3::from_slice).collect(), triangles)?)
}

/// Of its rows.
fn pose(rows: &[f64]) -> Outcome<Pose> {
    if rows.len() != 16 {
        return Err("a pose has 16 numbers".into());
    }
    Ok(Pose::from_rows(&std::array::from_fn(|i| std::array::from_fn(|j| rows[4 * i + j])))?)
}

fn numbers(path: &str) -> Outcome<Vec<f64>> {
    Ok(fs::read_to_string(path)?.split_whitespace().map(str::parse).collect::<Result<_, _>>()?)
}
