//! Checks whether the processor runs at full speed when a frame comes.

use super::roots::{Roots, names, text};
use crate::finding::Finding;

/// Cores and frequency governor.
pub(super) fn examine(roots: &Roots) -> Finding {
    const SUBJECT: &str = "processor";
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let found = if cores == 1 { "1 core".to_owned() } else { format!("{cores} cores") };
    let cpus = roots.sys.join("devices/system/cpu");
    let is_cpu = |name: &String| name.strip_prefix("cpu").is_some_and(|n| n.parse::<u32>().is_ok());
    let governor = |name: String| text(&cpus.join(name).join("cpufreq/scaling_governor"));
    let mut governors: Vec<String> = names(&cpus).into_iter().filter(is_cpu).filter_map(governor).collect();
    governors.dedup();
    let driver = text(&cpus.join("cpu0/cpufreq/scaling_driver")).unwrap_or_default();
    // These two drivers set the frequency in hardware, also under the governor "powersave".
    let in_hardware = driver == "intel_pstate" || driver == "amd-pstate-epp";
    if governors.is_empty() {
        return Finding::ok(SUBJECT, format!("{found}; the system chooses no frequency"));
    }
    let found = format!("{found}; frequency governor {}", governors.join(", "));
    if governors.iter().any(|governor| governor == "powersave") && !in_hardware {
        let advice = "the slowest frequency is kept: run `sudo cpupower frequency-set -g performance`";
        return Finding::warn(SUBJECT, found, advice);
    }
    Finding::ok(SUBJECT, found)
}
