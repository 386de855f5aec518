//! Determines which point of a part touches a face.
//!
//! The part's foremost point depends on its lean, which is uncertain. The mean of the foremost points
//! over poses drawn from the belief is the best linear description of the foremost distance. (Stein's
//! lemma: the mean gradient of a function of normal variables is its regression.) The remainder is noise.

use super::chance::joined;
use gelstereo_core::math::linalg::eigen;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, sqrt};
use gelstereo_core::register::PoseEstimate;

/// Number of poses drawn; the residual's standard deviation is then known to 3 %.
const DRAWS: u32 = 512;

/// The touching point and its residual uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TouchPoint {
    /// Part frame.
    pub(super) point_mm: DVec3,
    /// Mean distance of the foremost point ahead of this one.
    pub(super) ahead_mm: f64,
    /// Standard deviation of that distance.
    pub(super) residual_sigma_mm: f64,
    /// Standard deviation of the foremost point's position along the way.
    pub(super) place_sigma_mm: f64,
}

/// Touching point of a part with these candidate points (part frame, at least one), moved along the unit
/// direction `way` of the outer frame. `sigma_rad` and `sigma_mm` are the prior standard deviations of
/// its pose.
pub(super) fn touch_point(
    points_mm: &[DVec3],
    known: &PoseEstimate,
    way: DVec3,
    sigma_rad: f64,
    sigma_mm: f64,
) -> TouchPoint {
    let t_object_outer = known.pose.inverse();
    let way = t_object_outer.transform_vector(way);
    let parts = eigen(&joined(&known.in_frame(&t_object_outer).information, sigma_rad, sigma_mm));
    let mut stream = Stream::new(0, "touching point");
    let mut touches = Vec::new();
    for _ in 0..DRAWS {
        let mut twist = [0.0; 6];
        for (value, vector) in parts.values.into_iter().zip(parts.vectors) {
            let size = sqrt(value.max(0.0)) * stream.normal();
            (0..6).for_each(|i| twist[i] += size * vector[i]);
        }
        let omega = DVec3::new(twist[0], twist[1], twist[2]);
        let v_mm = DVec3::new(twist[3], twist[4], twist[5]);
        // way · (p + ω x p + v) = (way + way x ω) · p + way · v
        let turned = way + way.cross(omega);
        let foremost = points_mm.iter().max_by(|a, b| turned.dot(**a).total_cmp(&turned.dot(**b)));
        touches.push(Touch {
            point_mm: foremost.copied().unwrap_or_default(),
            turned,
            shift_mm: way.dot(v_mm),
        });
    }
    mean_of(&touches)
}

/// The foremost point of one drawn pose.
struct Touch {
    point_mm: DVec3,
    turned: DVec3,
    shift_mm: f64,
}

fn mean_of(touches: &[Touch]) -> TouchPoint {
    let count = touches.len() as f64;
    let point_mm = touches.iter().map(|touch| touch.point_mm).sum::<DVec3>() / count;
    let ahead = |touch: &Touch| touch.turned.dot(touch.point_mm - point_mm);
    let place = |touch: &Touch| touch.turned.dot(touch.point_mm) + touch.shift_mm;
    let mean = |of: &dyn Fn(&Touch) -> f64| touches.iter().map(of).sum::<f64>() / count;
    let spread = |of: &dyn Fn(&Touch) -> f64| {
        let middle = mean(of);
        sqrt(touches.iter().map(|touch| (of(touch) - middle).powi(2)).sum::<f64>() / count)
    };
    TouchPoint {
        point_mm,
        ahead_mm: mean(&ahead),
        residual_sigma_mm: spread(&ahead),
        place_sigma_mm: spread(&place),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gelstereo_core::math::Pose;
    use gelstereo_core::math::linalg::Symmetric;

    /// Upper and lower end of a flat side 15 mm from the part's centre.
    const ENDS: [DVec3; 2] = [DVec3::new(0.0, 15.0, -5.0), DVec3::new(0.0, 15.0, 5.0)];

    fn known(lean_sigma: f64, place_sigma_mm: f64) -> PoseEstimate {
        let sigma = [lean_sigma, 1e-6, 1e-6, 1e-6, place_sigma_mm, 1e-6];
        let information: Symmetric<6> = core::array::from_fn(|i| {
            core::array::from_fn(|j| if i == j { 1.0 / (sigma[i] * sigma[i]) } else { 0.0 })
        });
        PoseEstimate { pose: Pose::IDENTITY, information }
    }

    /// Maximum of ±5 mm times a lean: mean 5 σ √(2 / π), standard deviation 5 σ √(1 - 2 / π).
    #[test]
    fn a_side_that_may_lean_either_way_touches_in_its_middle_with_a_residual() {
        let lean = 0.01;
        let found = touch_point(&ENDS, &known(lean, 0.5), DVec3::Y, 10.0, 100.0);
        let expected = 5.0 * lean * sqrt(2.0 / core::f64::consts::PI);
        assert!((found.ahead_mm - expected).abs() < 0.1 * expected, "{found:?}");
        let expected = 5.0 * lean * sqrt(1.0 - 2.0 / core::f64::consts::PI);
        assert!((found.residual_sigma_mm - expected).abs() < 0.15 * expected, "{found:?}");
        assert!(found.point_mm.z.abs() < 1.0 && (found.place_sigma_mm - 0.5).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn a_side_whose_lean_is_known_touches_with_its_end() {
        let leaning = PoseEstimate { pose: Pose::exp(DVec3::X * -0.01, DVec3::ZERO), ..known(1e-4, 0.5) };
        let leaning = PoseEstimate { pose: leaning.pose, ..leaning.in_frame(&leaning.pose) };
        let found = touch_point(&ENDS, &leaning, DVec3::Y, 10.0, 100.0);
        assert!((found.point_mm - ENDS[1]).length() < 1e-9 && found.residual_sigma_mm < 1e-9, "{found:?}");
    }
}
