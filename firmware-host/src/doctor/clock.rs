//! Checks the clocks: the monotonic one for frame timestamps and the wall clock for names of recordings.

use super::roots::{Roots, text};
use crate::finding::Finding;
use std::time::SystemTime;

/// Both clocks.
pub(super) fn examine(roots: &Roots) -> Vec<Finding> {
    let built = std::env::current_exe().and_then(std::fs::metadata).and_then(|file| file.modified()).ok();
    vec![monotonic(roots), wall(roots, SystemTime::now(), built)]
}

/// Number of consecutive readings to compare.
const READINGS: usize = 1000;

#[cfg(unix)]
fn monotonic(roots: &Roots) -> Finding {
    use rustix::time::{ClockId, clock_getres, clock_gettime};
    const SUBJECT: &str = "clock";
    let now = || {
        let time = clock_gettime(ClockId::Monotonic);
        time.tv_sec * 1_000_000_000 + time.tv_nsec
    };
    let readings: Vec<i64> = (0..READINGS).map(|_| now()).collect();
    let resolution = clock_getres(ClockId::Monotonic);
    let resolution_ns = resolution.tv_sec * 1_000_000_000 + resolution.tv_nsec;
    let source = text(&roots.sys.join("devices/system/clocksource/clocksource0/current_clocksource"));
    let by = source.as_deref().map_or(String::new(), |source| format!(", by {source}"));
    if readings.windows(2).any(|pair| pair[1] < pair[0]) {
        return Finding::wrong(SUBJECT, format!("CLOCK_MONOTONIC goes back{by}"))
            .with_advice("frames cannot be stamped; boot with another clocksource");
    }
    let found = format!("CLOCK_MONOTONIC never goes back, resolution {resolution_ns} ns{by}");
    match source.as_deref() {
        // They are read over the bus or count timer interrupts: microseconds to milliseconds.
        Some("hpet" | "acpi_pm" | "jiffies" | "refined-jiffies") => Finding::warn(
            SUBJECT,
            found,
            "this clocksource is slow; check the BIOS and kernel log for the reason",
        ),
        _ => Finding::ok(SUBJECT, found),
    }
}

#[cfg(not(unix))]
fn monotonic(_roots: &Roots) -> Finding {
    Finding::ok("clock", "the system's own monotonic clock")
}

/// A wall clock earlier than this program's file is wrong. Files of the time services show which one
/// keeps it right.
fn wall(roots: &Roots, now: SystemTime, built: Option<SystemTime>) -> Finding {
    const SUBJECT: &str = "wall clock";
    let utc = humantime::format_rfc3339_seconds(now);
    if built.is_some_and(|built| now < built) {
        return Finding::warn(
            SUBJECT,
            format!("{utc} is earlier than this program's file"),
            "set it: `sudo timedatectl set-ntp true`; recordings of real cameras would carry wrong dates",
        );
    }
    match keeper(roots) {
        Some(keeper) => Finding::ok(SUBJECT, format!("{utc}, kept by {keeper}")),
        None => Finding::warn(
            SUBJECT,
            format!("{utc}, kept by no time service that is known here"),
            "run `sudo timedatectl set-ntp true` where recordings of several computers are compared",
        ),
    }
}

/// The service that synchronises the wall clock.
fn keeper(roots: &Roots) -> Option<&'static str> {
    let services = [
        ("systemd/timesync/synchronized", "systemd-timesyncd"),
        ("chrony/chronyd.pid", "chrony"),
        ("chronyd.pid", "chrony"),
        ("ntpd.pid", "ntpd"),
    ];
    services.into_iter().find(|(file, _)| roots.run.join(file).exists()).map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use std::time::UNIX_EPOCH;

    #[test]
    fn a_clock_earlier_than_the_program_is_a_warning() -> std::io::Result<()> {
        let folder = tempfile::tempdir()?;
        let roots =
            Roots { run: folder.path().to_owned(), sys: folder.path().to_owned(), ..Roots::default() };
        let (then, now) = (UNIX_EPOCH, SystemTime::now());
        assert!(wall(&roots, then, Some(now)).found.contains("1970-01-01T00:00:00Z is earlier"));
        assert_eq!(wall(&roots, now, Some(then)).level, Level::Warn);
        std::fs::create_dir_all(folder.path().join("systemd/timesync"))?;
        std::fs::write(folder.path().join("systemd/timesync/synchronized"), "")?;
        let found = wall(&roots, now, Some(then));
        assert!(found.level == Level::Ok && found.found.ends_with("kept by systemd-timesyncd"), "{found}");
        Ok(())
    }
}
