//! How much more tangential load a contact bears before it slips as a whole.

use crate::force::Wrench;
use crate::math::{DVec3, hypot, sqrt};
use crate::params::SlipShape;

/// Half the width of a 95 % range, in standard deviations.
const NORMAL_95: f64 = 1.96;
/// Smallest pressing force, in its standard deviations: below it, a quotient by it means nothing.
const MIN_PRESSED: f64 = 2.0 * NORMAL_95;
/// Fewest markers with pressure from which the lever arm of friction against a twist is computed.
const MIN_MARKERS: usize = 3;

/// Relative standard deviation of the lever arm of friction, which the markers' pitch blurs. With 0 and 0.04,
/// the range holds the true margin in 84 and 96 % of the frames of simulated plates, dragged or twisted. The
/// figures of docs/slip.md are of the same frames.
const ARM_SHARE: f64 = 0.06;

/// What a margin follows from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[repr(u8)]
pub enum MarginSource {
    /// The stick ratio, by the law of the contact's shape. Friction and forces need not be known.
    Stick = 0,
    /// The wrench and the coefficient of friction.
    Limit = 1,
}

impl MarginSource {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 2] = [("STICK", Self::Stick), ("LIMIT", Self::Limit)];
}

/// Share of the friction limit that is not used: 1 without tangential load, and 0 where the part slides.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Margin {
    /// The share, or the middle of its range where it follows from the stick ratio.
    pub share: f64,
    /// Its range: of the stick range and of the law for thick and thin gels, or 95 % by the covariance of
    /// the wrench and the standard deviation of friction.
    pub range: [f64; 2],
    /// What it follows from.
    pub source: MarginSource,
}

/// A contact whose forces are known. The lists are in the order of the markers.
#[derive(Clone, Copy, Debug)]
pub struct LoadedContact<'a> {
    /// Force and torque that the part exerts on the gel.
    pub wrench: &'a Wrench,
    /// Tractions around the markers, kilopascals; zero outside the contact.
    pub traction_kpa: &'a [DVec3],
    /// Positions, sensor frame, millimetres.
    pub points_mm: &'a [DVec3],
    /// Unit normal of the gel, towards the camera.
    pub normal: DVec3,
    /// Coulomb's coefficient.
    pub friction: f64,
    /// Its standard deviation.
    pub friction_sigma: f64,
}

impl Margin {
    /// By the stick ratio s, a share of areas, of a part of this shape; `None` if the shape is not known.
    ///
    /// With one coefficient of friction, the shear of a partial slip is the difference of two normal
    /// contacts: 1 - Q/(mu P) = P(c)/P(a), where c and a are the sizes of the stick area and of the contact
    /// (Jaeger 1998; Ciavarella 1998). On a half-space P goes with a³ for a ball, which is the law of
    /// Cattaneo (1938) and Mindlin (1949), and with a² for a cylinder. On a thin layer of independent
    /// springs it goes with a⁴ and a³. The lower end is that of the thin layer, the upper end that of the
    /// half-space. The share is in the middle: the ratio itself does not see that the border of the contact
    /// slips.
    pub(super) fn of_stick(shape: SlipShape, [low, high]: [f64; 2]) -> Option<Self> {
        let thick = |s: f64| if shape == SlipShape::Ball { s * sqrt(s) } else { s * s };
        let thin = |s: f64| if shape == SlipShape::Ball { s * s } else { s * s * s };
        let range = [thin(low), thick(high)];
        let share = 0.5 * (range[0] + range[1]);
        (shape != SlipShape::Unknown).then_some(Self { share, range, source: MarginSource::Stick })
    }

    /// By the friction limit. `None` if the wrench is cut by the lattice's border, the part is not pressed by
    /// more than noise, the coefficient is 0, or fewer than three markers have pressure.
    ///
    /// Force Q along the gel and torque M about its normal share the limit as an ellipse (Howe and Cutkosky
    /// 1996): the used share is sqrt(Q² + (M/r)²) / (mu P). M is about the centre of pressure, and r is the
    /// mean distance from it by pressure, so that the torque of sliding is mu P r.
    #[must_use]
    pub fn of_limit(loads: &LoadedContact<'_>) -> Option<Self> {
        let (normal, friction) = (loads.normal, loads.friction);
        let (centre_mm, radius_mm) = pressed(loads)?;
        let wrench = loads.wrench.about(centre_mm);
        let pressing_n = wrench.force_n.dot(normal);
        let along_n = wrench.force_n - normal * pressing_n;
        let twist_n = wrench.torque_nmm.dot(normal) / radius_mm;
        let (total_n, limit_n) = (hypot(along_n.length(), twist_n), friction * pressing_n);
        let used = total_n / limit_n;
        // Derivatives of the used share by force and torque.
        let (along, twist) =
            if total_n > 0.0 { (along_n / total_n, twist_n / total_n) } else { (along_n, 0.0) };
        let by_force = along / limit_n - normal * (used / pressing_n);
        let by_torque = normal * (twist / (limit_n * radius_mm));
        let pressing_sigma_n = deviation(&wrench, normal, DVec3::ZERO);
        let of_arm = ARM_SHARE * twist * twist_n / limit_n;
        let of_friction = used * loads.friction_sigma / friction;
        let sigma = hypot(hypot(deviation(&wrench, by_force, by_torque), of_arm), of_friction);
        let is_known = !loads.wrench.is_cut && friction > 0.0 && pressing_n > MIN_PRESSED * pressing_sigma_n;
        let share = |used: f64| (1.0 - used).clamp(0.0, 1.0);
        (is_known && used.is_finite() && sigma.is_finite()).then(|| Self {
            share: share(used),
            range: [share(used + NORMAL_95 * sigma), share(used - NORMAL_95 * sigma)],
            source: MarginSource::Limit,
        })
    }
}

/// Centre of pressure and mean distance from it by pressure, millimetres; `None` with fewer than
/// [`MIN_MARKERS`].
fn pressed(loads: &LoadedContact<'_>) -> Option<(DVec3, f64)> {
    let pressures = loads.traction_kpa.iter().map(|traction_kpa| traction_kpa.dot(loads.normal));
    let pressures = pressures.zip(loads.points_mm).filter(|&(pressure, _)| pressure > 0.0);
    let (count, sum, moment) = pressures
        .clone()
        .fold((0, 0.0, DVec3::ZERO), |(count, sum, moment), (p, &at)| (count + 1, sum + p, moment + at * p));
    let centre_mm = moment / sum;
    let radius_mm = pressures.map(|(p, &at)| p * (at - centre_mm).length()).sum::<f64>() / sum;
    (count >= MIN_MARKERS && radius_mm > 0.0).then_some((centre_mm, radius_mm))
}

/// Standard deviation of a sum of the wrench's components with these weights.
fn deviation(wrench: &Wrench, of_force: DVec3, of_torque: DVec3) -> f64 {
    let weights = [of_force, of_torque].map(|weights| weights.to_array());
    let weight = |i: usize| weights[i / 3][i % 3];
    let variance = |i: usize| (0..6).map(|k| weight(i) * wrench.covariance[i][k] * weight(k)).sum::<f64>();
    sqrt((0..6).map(variance).sum::<f64>().max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::linalg::Symmetric;
    use proptest::prelude::*;

    fn of(force_n: DVec3, torque_nmm: f64, friction: f64, covariance: Symmetric<6>) -> Option<Margin> {
        with_sigma(force_n, torque_nmm, [friction, 0.0], covariance)
    }

    fn with_sigma(
        force_n: DVec3,
        torque_nmm: f64,
        [friction, friction_sigma]: [f64; 2],
        covariance: Symmetric<6>,
    ) -> Option<Margin> {
        let points_mm = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y].map(|arm| arm * 2.0 + DVec3::Z * 30.0);
        let (about_mm, torque_nmm) = (DVec3::Z * 30.0, DVec3::Z * -torque_nmm);
        let (misfit, cells, markers, is_cut) = (1.0, 4, 9, false);
        let wrench = Wrench { force_n, torque_nmm, about_mm, covariance, misfit, cells, markers, is_cut };
        let traction_kpa = &[DVec3::Z * -3.0; 4];
        let loads = LoadedContact {
            wrench: &wrench,
            traction_kpa,
            points_mm: &points_mm,
            normal: -DVec3::Z,
            friction,
            friction_sigma,
        };
        Margin::of_limit(&loads)
    }

    proptest! {
        /// Forces and torques of four equal feet at 2 mm from their middle.
        #[test]
        fn force_and_torque_share_the_limit(
            along in 0.0..1.0_f64, twist in 0.0..1.0_f64, angle in 0.0..6.3_f64,
            pressing_n in 0.1..20.0_f64, friction in 0.1..2.0_f64,
        ) {
            let limit_n = friction * pressing_n;
            let (x, y) = (crate::math::cos(angle), crate::math::sin(angle));
            let force_n = DVec3::new(x * along * limit_n, y * along * limit_n, -pressing_n);
            let exact = of(force_n, 2.0 * twist * limit_n, friction, [[0.0; 6]; 6]).unwrap();
            let expected = (1.0 - hypot(along, twist)).max(0.0);
            prop_assert!((exact.share - expected).abs() < 1e-9, "{} {expected}", exact.share);
            let mut covariance = [[0.0; 6]; 6];
            (0..6).for_each(|i| covariance[i][i] = 1e-4 * pressing_n * pressing_n);
            let noisy = of(force_n, 2.0 * twist * limit_n, friction, covariance).unwrap();
            prop_assert!(noisy.range[0] <= noisy.share && noisy.share <= noisy.range[1]);
            prop_assert!(noisy.range[0] <= exact.range[0] && exact.range[1] <= noisy.range[1]);
        }

        /// Without torque, an unknown friction alone makes a range of 1 - Q/(mu P) with the relative error of
        /// mu.
        #[test]
        fn an_uncertain_friction_widens_the_range(
            share in 0.1..0.6_f64, friction in 0.1..2.0_f64, relative in 0.01..0.3_f64,
        ) {
            let force_n = DVec3::new(share * friction * 4.0, 0.0, -4.0);
            let found = with_sigma(force_n, 0.0, [friction, relative * friction], [[0.0; 6]; 6]).unwrap();
            let half = 1.96 * relative * share;
            prop_assert!((found.share - (1.0 - share)).abs() < 1e-12);
            prop_assert!((found.range[0] - (1.0 - share - half)).abs() < 1e-12);
            prop_assert!((found.range[1] - (1.0 - share + half).min(1.0)).abs() < 1e-12);
        }

        /// Thicker gels leave more, and the range holds every law between.
        #[test]
        fn stick_laws_are_ordered(low in 0.0..1.0_f64, high in 0.0..1.0_f64) {
            let range = [low.min(high), low.max(high)];
            for (shape, exponents) in [(SlipShape::Ball, [1.5, 2.0]), (SlipShape::Cylinder, [2.0, 3.0])] {
                let margin = Margin::of_stick(shape, range).unwrap();
                let [thick, thin] = exponents;
                let expected = [crate::math::pow(range[0], thin), crate::math::pow(range[1], thick)];
                prop_assert!((0..2).all(|i| (margin.range[i] - expected[i]).abs() < 1e-12));
                prop_assert!(margin.range[0] <= margin.share && margin.share <= margin.range[1]);
            }
            prop_assert_eq!(Margin::of_stick(SlipShape::Unknown, range), None);
        }
    }

    #[test]
    fn a_part_that_pulls_or_hardly_presses_has_none() {
        let mut covariance = [[0.0; 6]; 6];
        covariance[2][2] = 1.0;
        assert!(of(DVec3::Z * -5.0, 0.0, 0.5, covariance).is_some());
        for pressing_n in [3.9, 0.0, -1.0] {
            assert_eq!(of(DVec3::Z * -pressing_n, 0.0, 0.5, covariance), None);
        }
        assert_eq!(of(DVec3::Z * -5.0, 0.0, 0.0, covariance), None);
        assert_eq!(of(DVec3::new(f64::NAN, 0.0, -5.0), 0.0, 0.5, covariance), None);
    }
}
