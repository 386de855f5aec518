//! Names that settings had before, for errors that say the present one.

/// Settings by their former names, and what they are called now.
const SETTINGS: [(&str, &str); 13] = [
    ("register.sigma_start_mm", "register.filterreg.max_sigma_mm"),
    ("register.sigma_floor_mm", "register.filterreg.min_sigma_mm"),
    ("register.ransac_hypotheses", "register.ransac_icp.hypotheses"),
    ("register.seed", "register.ransac_icp.seed"),
    ("register.starts", "register.surface_search.starts"),
    ("register.budget", "register.surface_search.budget"),
    ("register.gel_scale", "register.advanced.gel_scale"),
    ("register.surface_sigma_mm", "register.advanced.surface_sigma_mm"),
    ("register.outlier_share", "register.advanced.outlier_share"),
    ("register.max_distance_mm", "register.advanced.max_distance_mm"),
    ("register.search_radius_mm", "register.advanced.search_radius_mm"),
    ("register.max_iterations", "register.advanced.max_iterations"),
    ("register.step_tolerance", "register.advanced.step_tolerance"),
];

/// Methods that were renamed, or dropped for one that is better, by setting.
const METHODS: [(&str, &str, &str); 8] = [
    ("contact.saliency", "pressure_quick", "pressure"),
    ("detect.background", "box", "blocks"),
    ("detect.centre", "band", "soft_threshold"),
    ("detect.centre", "matched", "fit"),
    ("label.method", "temporal", "lattice"),
    ("register.method", "filterreg_plane", "surface_search"),
    ("register.method", "icp_plane", "surface_close"),
    ("register.method", "surface_track", "surface_close"),
];

/// The present name of a setting that was renamed, for example of `register.budget`.
#[must_use]
pub fn renamed_setting(path: &str) -> Option<&'static str> {
    SETTINGS.iter().find(|(former, _)| *former == path).map(|(_, present)| *present)
}

/// The present name of a method, or the one that replaces it.
#[must_use]
pub fn replaced_method(path: &str, method: &str) -> Option<&'static str> {
    METHODS
        .iter()
        .find(|(setting, former, _)| *setting == path && *former == method)
        .map(|(.., present)| *present)
}

/// The former name of a setting or method that a parser does not know, by its last part, and what to write
/// now.
#[must_use]
pub fn former(name: &str) -> Option<(&'static str, &'static str)> {
    let last = |path: &&str| path.rsplit('.').next() == Some(name);
    let settings = SETTINGS.iter().map(|&(former, present)| (former, present));
    let methods = METHODS.iter().map(|&(_, former, present)| (former, present));
    settings.chain(methods).find(|(former, _)| last(former))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Only whole former names are recognised, not their ends.
    #[test]
    fn a_former_name_is_the_whole_last_part() {
        let names = || {
            let settings = SETTINGS.iter().map(|(former, _)| former.rsplit('.').next().unwrap_or(former));
            settings.chain(METHODS.iter().map(|(_, former, _)| *former))
        };
        for name in names() {
            assert!(former(name).is_some(), "{name}");
            for start in 1..name.len() {
                let end = &name[start..];
                assert!(names().any(|name| name == end) || former(end).is_none(), "{end}");
            }
        }
        assert_eq!(former("register.seed"), None, "the parser names the last part alone");
    }
}
