//! Lossless codecs for recorded images, compared in size and time on one core.
//!
//! `cargo run --release --manifest-path bench/image-codecs/Cargo.toml -- [folder with real images]` prints
//! the table of `docs/recordings.md`. Simulated pairs have 640 x 480 pixels. Real images are read as grey and
//! given to the codecs as they are; images that were JPEG before show less noise than a camera's raw ones.

use gelstereo_core::math::{DVec3, Pose};
use gelstereo_png::PngEncoder;
use gelstereo_host::source::Gray;
use gelstereo_sim::effects::{Defocus, SensorNoise};
use gelstereo_sim::{ContactState, Effects, Keyframe, Scene, Shape, Simulator, Truth};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Pixels of a pair of 640 x 480, and pairs per second, that rates are stated for.
const PAIR_PIXELS: f64 = 2.0 * 640.0 * 480.0;
const PAIRS_PER_SECOND: f64 = 30.0;
/// Each image is encoded so often; the fastest counts.
const REPEATS: usize = 9;

type Encode = Box<dyn FnMut(&Gray) -> Vec<u8>>;

fn png_crate(compression: png::DeflateCompression, filter: png::Filter) -> Encode {
    Box::new(move |image| {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, image.width as u32, image.height as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_deflate_compression(compression);
        encoder.set_filter(filter);
        encoder.write_header().unwrap().write_image_data(&image.pixels).unwrap();
        out
    })
}

/// Residuals of the predictor of JPEG-LS, the median of left, above and their plane.
fn predicted(image: &Gray) -> Vec<u8> {
    let Gray { width, height, ref pixels } = *image;
    let black = vec![0; width];
    let mut out = Vec::with_capacity(pixels.len());
    for y in 0..height {
        let row = &pixels[y * width..][..width];
        let above = y.checked_sub(1).map_or(&black[..], |above| &pixels[above * width..][..width]);
        out.push(row[0].wrapping_sub(above[0]));
        out.extend((1..width).map(|x| {
            let (a, b, c) = (row[x - 1], above[x], above[x - 1]);
            let guess = (i16::from(a) + i16::from(b) - i16::from(c)).clamp(a.min(b).into(), a.max(b).into());
            row[x].wrapping_sub(guess as u8)
        }));
    }
    out
}

fn codecs() -> Vec<(&'static str, Encode)> {
    use png::{
        DeflateCompression::{FdeflateUltraFast, Level},
        Filter,
    };
    let mut own = PngEncoder::default();
    vec![
        (
            "PNG, this project's encoder",
            Box::new(move |image: &Gray| {
                let mut out = Vec::new();
                own.encode(&image.pixels, image.width, &mut out);
                out
            }),
        ),
        ("PNG, crate png, fdeflate, up", png_crate(FdeflateUltraFast, Filter::Up)),
        ("PNG, crate png, fdeflate, average", png_crate(FdeflateUltraFast, Filter::Avg)),
        ("PNG, crate png, fdeflate, adaptive", png_crate(FdeflateUltraFast, Filter::Adaptive)),
        ("PNG, crate png, level 1, average", png_crate(Level(1), Filter::Avg)),
        ("PNG, crate png, level 6, adaptive", png_crate(Level(6), Filter::Adaptive)),
        (
            "QOI, grey as RGB",
            Box::new(|image: &Gray| {
                let rgb: Vec<u8> = image.pixels.iter().flat_map(|&level| [level; 3]).collect();
                qoi::encode_to_vec(rgb, image.width as u32, image.height as u32).unwrap()
            }),
        ),
        (
            "WebP lossless, crate image-webp",
            Box::new(|image: &Gray| {
                let mut out = Vec::new();
                image_webp::WebPEncoder::new(&mut out)
                    .encode(&image.pixels, image.width as u32, image.height as u32, image_webp::ColorType::L8)
                    .unwrap();
                out
            }),
        ),
        (
            "zstd 1 of median residual",
            Box::new(|image: &Gray| zstd::bulk::compress(&predicted(image), 1).unwrap()),
        ),
        (
            "zstd 3 of median residual",
            Box::new(|image: &Gray| zstd::bulk::compress(&predicted(image), 3).unwrap()),
        ),
        ("zstd 1 of the pixels", Box::new(|image: &Gray| zstd::bulk::compress(&image.pixels, 1).unwrap())),
        (
            "JPEG-LS, CharLS",
            Box::new(|image: &Gray| {
                let info = charls::FrameInfo {
                    width: image.width as u32,
                    height: image.height as u32,
                    bits_per_sample: 8,
                    component_count: 1,
                };
                charls::CharLS::default().encode(info, 0, &image.pixels).unwrap()
            }),
        ),
    ]
}

/// A pressed gel as the host's simulated camera shows it, with so much noise.
fn simulated(sigma_levels: f64) -> Vec<Gray> {
    let noise = (sigma_levels > 0.0).then_some(SensorNoise { sigma_levels });
    let scene = Scene {
        indenter: Some(Shape::Sphere { radius_mm: 4.0 }),
        trajectory: vec![Keyframe {
            time_s: 0.0,
            contact: ContactState {
                t_sensor_object: Pose::from_translation_mm(DVec3::new(4.0, 0.0, 31.5)),
                shear_mm: [0.0; 2],
                twist_rad: 0.0,
            },
        }],
        effects: Effects { defocus: Some(Defocus::default()), sensor_noise: noise, ..Effects::of_gel() },
        ..Scene::default()
    };
    let mut simulator = Simulator::new(&scene, None).unwrap();
    let contact = simulator.contact(0);
    let mut truth = Truth::default();
    simulator.moment(contact.as_ref(), 0, &mut truth);
    let (mut left, mut right) = (Vec::new(), Vec::new());
    simulator.render(&truth, 0, &mut left, &mut right);
    [left, right].map(|pixels| Gray { width: 640, height: 480, pixels }).into()
}

fn files(folder: &Path, out: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files(&path, out);
        } else if path.extension().is_some_and(|e| e == "png" || e == "jpg") {
            out.push(path);
        }
    }
}

fn real(folder: &Path, extension: &str) -> Vec<Gray> {
    let mut paths = Vec::new();
    files(folder, &mut paths);
    let wanted = paths.iter().filter(|path| path.extension().is_some_and(|e| e == extension));
    wanted
        .map(|path| {
            let image = image::open(path).unwrap().into_luma8();
            Gray { width: image.width() as usize, height: image.height() as usize, pixels: image.into_raw() }
        })
        .collect()
}

fn measure(name: &str, images: &[Gray], bound: Option<f64>) {
    let pixels: usize = images.iter().map(|image| image.pixels.len()).sum();
    println!("\n{name}: {} images, {pixels} pixels", images.len());
    if let Some(bits) = bound {
        println!("  no code can be below {bits:.2} bits a pixel, {:.2} MB/s", rate(bits));
    }
    println!(
        "| codec | bits a pixel | MB/s at 640 x 480 x 30 pairs | ms a pair of 640 x 480 |\n\
         |---|---:|---:|---:|"
    );
    for (codec, mut encode) in codecs() {
        let (mut bytes, mut seconds) = (0, 0.0);
        for image in images {
            let mut best = f64::INFINITY;
            let mut length = 0;
            for _ in 0..REPEATS {
                let begun = Instant::now();
                length = std::hint::black_box(encode(image)).len();
                best = best.min(begun.elapsed().as_secs_f64());
            }
            bytes += length;
            seconds += best;
        }
        let bits = 8.0 * bytes as f64 / pixels as f64;
        let milliseconds = 1e3 * seconds / pixels as f64 * PAIR_PIXELS;
        println!("| {codec} | {bits:.2} | {:.2} | {milliseconds:.2} |", rate(bits));
    }
}

fn rate(bits: f64) -> f64 {
    bits / 8.0 * PAIR_PIXELS * PAIRS_PER_SECOND * 1e-6
}

/// Entropy of a normal distribution that is rounded to whole levels.
fn normal_bits(sigma: f64) -> f64 {
    let weights: Vec<f64> = (-60..=60).map(|k| (-0.5 * (f64::from(k) / sigma).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    weights.iter().map(|w| w / total).filter(|p| *p > 0.0).map(|p| -p * p.log2()).sum()
}

fn main() {
    for sigma in [0.0, 0.5, 1.0, 1.5, 2.0, 4.0] {
        let bound = (sigma > 0.0).then(|| normal_bits(sigma));
        measure(&format!("simulated, noise of {sigma} levels"), &simulated(sigma), bound);
    }
    if let Some(folder) = std::env::args().nth(1) {
        let folder = Path::new(&folder);
        measure("real gel images (9DTact, PNG)", &real(folder, "png"), None);
        measure("real images that were JPEG (chessboards, markers)", &real(folder, "jpg"), None);
    }
}
