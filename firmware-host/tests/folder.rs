//! Image pairs in folders, and the job on them.
#![allow(clippy::unwrap_used)]

use gelstereo_host::config::{Config, SourceConfig};
use gelstereo_host::report::{Outcome, Stage};
use gelstereo_host::run::{Setup, run_with};
use gelstereo_host::simulate::simulate;
use gelstereo_host::source::{FolderSource, FrameSource, Next, SourceError, StereoPair};
use image::{GrayImage, Luma};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

fn grey(path: &Path, width: u32, height: u32, level: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    GrayImage::from_pixel(width, height, Luma([level])).save(path).unwrap();
}

fn read_all(folder: &Path) -> Result<Vec<StereoPair>, SourceError> {
    let mut source = FolderSource::open(folder, 20.0)?;
    let (mut pairs, mut pair) = (Vec::new(), StereoPair::default());
    while source.next_pair(Duration::ZERO, &mut pair)? == Next::Pair {
        pairs.push(pair.clone());
    }
    Ok(pairs)
}

#[test]
fn pairs_come_in_order_whatever_their_format_and_layout() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for (name, level) in [("left_2.png", 30), ("right_2.pgm", 40), ("left_1.pgm", 10), ("right_1.png", 20)] {
        grey(&at(name), 8, 6, level);
    }
    std::fs::write(at("notes.txt"), "not an image").unwrap();
    let pairs = read_all(folder.path()).unwrap();
    let levels: Vec<_> = pairs.iter().map(|p| (p.left.pixels[0], p.right.pixels[0], p.time_ns)).collect();
    assert_eq!(levels, [(10, 20, 0), (30, 40, 50_000_000)]);
    assert_eq!((pairs[0].left.width, pairs[0].left.height, pairs[0].left.pixels.len()), (8, 6, 48));

    let folder = tempfile::tempdir().unwrap();
    for view in ["left", "right"] {
        grey(&folder.path().join(view).join("0007.png"), 8, 6, 50);
    }
    assert_eq!(read_all(folder.path()).unwrap().len(), 1);
}

/// As text, left_29 comes before left_3, and the motion between pairs is wrong.
#[test]
fn pairs_come_in_the_order_of_their_numbers_with_gaps_reported() {
    let folder = tempfile::tempdir().unwrap();
    for number in [3, 29, 4, 100] {
        grey(&folder.path().join(format!("left_{number}.png")), 8, 6, number);
        grey(&folder.path().join(format!("right_{number}.png")), 8, 6, number + 1);
    }
    let pairs = read_all(folder.path()).unwrap();
    let found: Vec<_> = pairs
        .iter()
        .map(|p| (p.left.pixels[0], p.right.pixels[0], p.capture.sequence, p.capture.dropped, p.time_ns))
        .collect();
    let at = |number: u64| (number - 3) * 50_000_000;
    assert_eq!(
        found,
        [(3, 4, 0, 0, 0), (4, 5, 1, 0, at(4)), (29, 30, 26, 24, at(29)), (100, 101, 97, 70, at(100))]
    );
    assert_eq!(FolderSource::open(folder.path(), 20.0).unwrap().dropped(), 94);
}

#[test]
fn leading_zeros_make_a_pair_where_only_one_image_has_the_number() {
    let folder = tempfile::tempdir().unwrap();
    let add = |name: &str| grey(&folder.path().join(name), 8, 6, 0);
    ["left_3.png", "right_03.png", "left_04.png", "right_0004.png"].into_iter().for_each(add);
    assert_eq!(read_all(folder.path()).unwrap().len(), 2);
    add("left_003.png");
    let message = read_all(folder.path()).unwrap_err().to_string();
    assert!(
        message.contains("left_003.png and ") && message.contains("left_3.png are images of"),
        "{message}"
    );
    add("right_003.png");
    let message = read_all(folder.path()).unwrap_err().to_string();
    assert!(message.contains("same view and number"), "left_3 may belong to either: {message}");
    add("right_3.png");
    let message = read_all(folder.path()).unwrap_err().to_string();
    assert!(message.contains("right_03.png has no partner"), "{message}");
}

#[test]
fn faults_of_a_folder_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let message = || read_all(folder.path()).unwrap_err().to_string();
    assert!(message().contains("holds 0 images but none whose name says left or right"), "{}", message());
    grey(&at("left_1.png"), 8, 6, 0);
    grey(&at("right_1.png"), 8, 6, 0);
    grey(&at("left_2.png"), 8, 6, 0);
    assert!(message().contains("left_2.png has no partner: there is no right image"), "{}", message());
    grey(&at("right_2.png"), 9, 6, 0);
    assert!(message().contains("right_2.png is 9 x 6 pixels but the first image 8 x 6"), "{}", message());
    std::fs::write(at("right_2.png"), "no image").unwrap();
    assert!(message().contains("right_2.png cannot be read as a PNG, PGM or JPEG image"), "{}", message());
    grey(&at("LEFT_1.pgm"), 8, 6, 0);
    assert!(message().contains("are images of the same view and number"), "{}", message());
}

/// What nobody asks for is not written: the same markers without pixels, or without images.
#[test]
fn a_folder_has_what_the_scene_asks_for() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.toml");
    let made = |asked: &str| {
        let text = format!(
            "{asked}\nindenter = {{ kind = \"sphere\", radius_mm = 6 }}\n\
             trajectory = [{{ time_s = 0, position_mm = [4, 0, 33.5] }}]\n"
        );
        std::fs::write(&scene, text).unwrap();
        let out = tempfile::tempdir_in(folder.path()).unwrap();
        simulate(&scene, out.path(), &AtomicBool::new(false), &mut |_, _| {}).unwrap();
        let image = out.path().join("left_00000.png").exists();
        let text = std::fs::read_to_string(out.path().join("truth_00000.csv")).unwrap();
        let rows: Vec<Vec<String>> =
            text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
        (image, rows)
    };
    let (image, whole) = made("");
    assert!(image && whole[0].len() == 9);
    assert_eq!(made("asked = { kind = \"positions\", tolerance_px = 0 }"), (false, whole.clone()));
    let (image, points) = made("asked = { kind = \"points\", tolerance_um = 0 }");
    let cut: Vec<Vec<String>> = whole.iter().map(|row| row[..5].to_vec()).collect();
    assert!(!image && points == cut);
    assert!(points.iter().any(|row| row[4] == "1"), "the ball touches");
}

/// A scene made into a folder, and the job on that folder: it ends where the images do.
#[test]
fn the_job_runs_on_image_pairs_as_far_as_they_go() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.toml");
    std::fs::write(
        &scene,
        "indenter = { kind = \"sphere\", radius_mm = 6 }\n\
         trajectory = [{ time_s = 0, position_mm = [4, 0, 35] }, \
         { time_s = 0.2, position_mm = [4, 0, 34] }]\n\
         [effects.sensor_noise]\n",
    )
    .unwrap();
    let pairs = folder.path().join("pairs");
    let stop = AtomicBool::new(false);
    let simulated = simulate(&scene, &pairs, &stop, &mut |_, _| {}).unwrap();
    assert_eq!(simulated.frames, 7, "0 to 0.2 s at 30 Hz");
    let truth = std::fs::read_to_string(pairs.join("truth_00006.csv")).unwrap();
    assert_eq!(truth.lines().count(), 626);

    let config_path = folder.path().join("cell.toml");
    let text = "rig_file = \"pairs/rig.toml\"\n[source]\nkind = \"folder\"\npath = \"pairs\"\n\
                frame_rate_hz = 30\n[task]\nopening_speed_mm_s = 10000\n";
    std::fs::write(&config_path, text).unwrap();
    let config = Config::load(&config_path).unwrap();
    assert!(matches!(&config.source, SourceConfig::Folder { path, .. } if *path == pairs));
    let report = run_with(&config, Setup::new(&config).unwrap(), None, &stop, &mut |_| {}).unwrap();
    assert_eq!(report.outcome, Outcome::SourceEnded { stage: Stage::Close });
    assert!(report.truth.is_none(), "nobody knows the truth of real images");

    let black = tempfile::tempdir().unwrap();
    for view in ["left", "right"] {
        (0..4).for_each(|k| grey(&black.path().join(format!("{view}_{k}.png")), 640, 480, 0));
    }
    let source = SourceConfig::Folder { path: black.path().to_owned(), frame_rate_hz: 30.0 };
    let config = Config { source, ..config };
    let error = run_with(&config, Setup::new(&config).unwrap(), None, &stop, &mut |_| {}).unwrap_err();
    assert!(error.to_string().starts_with("rest: 3 bad frames in a row, at last: left view: "), "{error}");
}
