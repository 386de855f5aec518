//! Commands with every setting at the ends of its valid range.

use super::{documented, key, leaves, replace, table};
use gelstereo_host::check::check;
use gelstereo_host::config::Config;
use gelstereo_host::run::run;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use toml::Value;

/// `check` ends soon for every valid extreme, and leaves no files behind.
#[test]
#[ignore = "takes minutes: make test-long"]
fn check_of_any_valid_extreme_ends() {
    let folder = tempfile::tempdir().unwrap();
    for (path, number, config) in extremes(folder.path()) {
        let began = Instant::now();
        assert!(!check(&config).is_empty());
        println!("{path} = {number}: {:.1} s", began.elapsed().as_secs_f64());
        // Generous: it guards against an endless loop.
        assert!(began.elapsed() < Duration::from_secs(60), "{path} = {number} takes {:?}", began.elapsed());
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "check leaves files behind");
}

/// `run` stops on request for every valid extreme, and writes no more than its frames until then.
#[test]
#[ignore = "takes minutes: make test-long"]
fn run_with_any_valid_extreme_stops_and_writes_no_more_than_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    for (path, number, config) in extremes(folder.path()) {
        let stop = AtomicBool::new(false);
        let began = Instant::now();
        let mut frames = 0;
        let result = std::thread::scope(|scope| {
            let (sender, ended) = std::sync::mpsc::channel::<()>();
            scope.spawn({
                let stop = &stop;
                move || {
                    // In the course of a run, most of which take some seconds.
                    let _ = ended.recv_timeout(Duration::from_millis(300));
                    stop.store(true, Ordering::Relaxed);
                }
            });
            let result = run(&config, &stop, &mut |stage| frames += stage.frames);
            let _ = sender.send(());
            result
        });
        let took = began.elapsed();
        assert!(took < Duration::from_secs(90), "{path} = {number} ends after {took:?}: {:?}", result.err());
        println!("{path} = {number}: {:.1} s, {frames} frames", took.as_secs_f64());
        let written = std::fs::metadata(&config.recording.path).map_or(0, |file| file.len());
        // Two images of 640 x 480 per frame, and its results. Frames of the stage that was cut short are not
        // counted.
        let bound = 2_000_000 * (frames + 200 * took.as_secs().max(1));
        assert!(written <= bound, "{path} = {number} writes {written} bytes in {frames} frames, {took:?}");
        let _ = std::fs::remove_file(&config.recording.path);
    }
}

/// The default configuration with each number replaced by its smallest and largest valid value, where the
/// other settings permit that.
fn extremes(folder: &Path) -> Vec<(String, Value, Config)> {
    let documented = documented();
    let mut found = Vec::new();
    for (path, value) in leaves(&table(&Config::default())) {
        let range = documented[&key(&path)].iter().find_map(|s| s.valid);
        let Some(range) = range.filter(|_| value.is_float() || value.is_integer()) else { continue };
        for number in [range.low, range.high] {
            let mut changed = table(&Config::default());
            let number = if value.is_float() { Value::Float(number) } else { Value::Integer(number as i64) };
            replace(&mut changed, &path, number.clone());
            // A pose's numbers are valid together or not at all.
            let Ok(mut config) = Config::parse(&toml::to_string(&changed).unwrap(), "changed") else {
                continue;
            };
            config.recording.path = folder.join("run.mcap");
            if config.validate().is_ok() {
                found.push((path.clone(), number, config));
            }
        }
    }
    assert!(found.len() > 150, "{}", found.len());
    found
}
