//! Checks of registered poses.

use gelstereo_core::register::Registration;

/// Whether pose, information and covariance are finite.
pub fn is_finite(found: &Registration) -> bool {
    let pose = &found.t_sensor_object;
    let mut numbers =
        found.information.iter().chain(&found.covariance()).flatten().copied().collect::<Vec<_>>();
    numbers.extend(pose.translation_mm.to_array());
    pose.rotation.is_finite() && numbers.iter().all(|x: &f64| x.is_finite())
}
