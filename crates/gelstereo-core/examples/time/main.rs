//! Times stages on given input, call by call, without the cost of a binding; and counts the memory they need.
//!
//! ```text
//! time params.toml rig.toml left0.pgm right0.pgm left1.pgm right1.pgm ...
//! ```
//!
//! Runs all pairs once and writes `memory BYTES`: the most that the pipeline, its results and their scratch
//! held at one time, without the images. Then every line of standard input, `track 5` for example, is
//! answered by one line with so many times in nanoseconds. The pairs come in turn, there and back, for each
//! stage by itself, so that neighbours in time stay neighbours.
//!
//! - `track`: a stereo frame that follows another one
//! - `again`: the last stereo frame, that follows itself: the same work every time, so that what differs is
//!   the machine's
//! - `afresh`: a stereo frame without a predecessor
//! - `detect`: both views' markers, afresh
//! - `triangulate`: all points and their covariances
//!
//! What cannot be done is answered by `refused: ` and why.
#![allow(clippy::print_stdout, reason = "it is a program")]

mod counting;
#[path = "../support/pgm.rs"]
mod pgm;

use gelstereo_core::detect::{Detector, Markers};
use gelstereo_core::image::GrayView;
use gelstereo_core::params::Params;
use gelstereo_core::pipeline::{Frame, Pipeline};
use gelstereo_core::rig::Rig;
use gelstereo_core::triangulate::{Centres, StereoPoint, Triangulator};
use pgm::{Outcome, Pgm};
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, Write};
use std::time::Instant;

fn main() -> Outcome<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [params, rig, files @ ..] = words.as_slice() else {
        return Err("usage: time params.toml rig.toml left.pgm right.pgm ...".into());
    };
    let params: Params = toml::from_str(&fs::read_to_string(params)?)?;
    let rig: Rig = toml::from_str(&fs::read_to_string(rig)?)?;
    let images = files.iter().map(|path| Pgm::read(path)).collect::<Outcome<Vec<_>>>()?;
    let views = images.iter().map(Pgm::view).collect::<Outcome<Vec<_>>>()?;
    let pairs: Vec<[GrayView<'_>; 2]> = views.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect();
    if pairs.is_empty() {
        return Err("no images".into());
    }
    let before = counting::restart();
    let mut bench = Bench::new(&rig, &params)?;
    for &[left, right] in &pairs {
        bench.tracking.process(left, right, &mut bench.frame)?;
    }
    println!("memory {}", counting::peak() - before);
    for line in std::io::stdin().lock().lines() {
        println!("{}", bench.answer(&line?, &pairs).unwrap_or_else(|error| format!("refused: {error}")));
        std::io::stdout().flush()?;
    }
    Ok(())
}

struct Bench {
    tracking: Pipeline,
    /// Made when it is asked for: it is no part of what the pipeline holds.
    again: Option<Pipeline>,
    afresh: Pipeline,
    detector: Detector,
    triangulator: Triangulator,
    frame: Frame,
    markers: Markers,
    /// Pairs that each stage was given: with a count for all, frames would jump wherever another stage took
    /// its turn.
    turns: BTreeMap<String, usize>,
}

impl Bench {
    fn new(rig: &Rig, params: &Params) -> Outcome<Self> {
        Ok(Self {
            tracking: Pipeline::new(rig, params)?,
            again: None,
            afresh: Pipeline::new(rig, params)?,
            detector: Detector::new(&params.detect),
            triangulator: Triangulator::new(rig, &params.triangulate)?,
            frame: Frame::default(),
            markers: Markers::default(),
            turns: BTreeMap::new(),
        })
    }

    /// Times of one line's calls.
    fn answer(&mut self, line: &str, pairs: &[[GrayView<'_>; 2]]) -> Outcome<String> {
        let (what, count) = line.split_once(' ').ok_or("a line is a name and a count")?;
        let [last_left, last_right] = *pairs.last().ok_or("no images")?;
        let turn = self.turns.entry(what.to_owned()).or_default();
        let mut times = Vec::new();
        for _ in 0..count.trim().parse::<usize>()? {
            let period = 2 * pairs.len().max(2) - 2;
            let place = *turn % period;
            let [left, right] = pairs[place.min(period - place).min(pairs.len() - 1)];
            *turn += 1;
            let nanoseconds = match what {
                "track" => timed(|| self.tracking.process(left, right, &mut self.frame))?,
                "again" => {
                    let pipeline = self.again.get_or_insert_with(|| self.tracking.clone());
                    timed(|| pipeline.process(last_left, last_right, &mut self.frame))?
                }
                "afresh" => timed(|| {
                    self.afresh.reset();
                    self.afresh.process(left, right, &mut self.frame)
                })?,
                "detect" => timed(|| {
                    self.detector.run(left, &mut self.markers)?;
                    self.detector.run(right, &mut self.markers)
                })?,
                "triangulate" => triangulate(&mut self.triangulator, &self.frame)?,
                other => return Err(format!("there is no {other}").into()),
            };
            times.push(nanoseconds.to_string());
        }
        Ok(times.join(" "))
    }
}

/// On the markers of the last frame.
fn triangulate(triangulator: &mut Triangulator, frame: &Frame) -> Outcome<u128> {
    let covariance_px2 = vec![[[1e-3, 0.0], [0.0, 1e-3]]; frame.left_px.len()];
    let view = |positions_px| Centres { positions_px, covariance_px2: &covariance_px2 };
    let (left, right) = (view(&frame.left_px), view(&frame.right_px));
    if triangulator.map_error_mm().is_none() {
        triangulator.fit_map(&frame.points_mm);
    }
    let mut points: Vec<StereoPoint> = Vec::with_capacity(frame.left_px.len());
    timed(|| triangulator.run(left, right, &mut points))
}

fn timed<E: std::error::Error + 'static>(work: impl FnOnce() -> Result<(), E>) -> Outcome<u128> {
    let begin = Instant::now();
    work()?;
    Ok(begin.elapsed().as_nanos())
}
