//! Probability that the part fits into its hole, from its pose belief.
//!
//! The inserted end stays within the walls if no flank point moves along its own normal by more than half
//! of the clearance. A small motion (ω, v) of the part moves a point p with normal n by n·(ω x p + v).

use super::belief::Belief;
use crate::report::Forecast;
use gelstereo_core::math::linalg::{Symmetric, eigen};
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DVec3, Pose, sqrt};
use gelstereo_core::register::{Symmetry, Template};

/// Poses drawn per probability; the standard error at 0.99 is 0.0022.
const DRAWS: usize = 2048;
/// Sine of the largest lean of a flank point's normal towards the axis. Larger leans belong to the tip's
/// face or to a chamfer.
const MAX_LEAN: f64 = 0.5;
/// Largest number of points. Displacements are linear along the axis, so points near the tip and near the
/// rim suffice.
const MAX_POINTS: usize = 600;
/// Largest displacement, by a turn about the insertion axis, of a part that counts as round: twice the
/// facet error of a mesh.
const ROUND_MM: f64 = 0.01;

/// Inserted end of the part and its clearance, part frame.
pub(super) struct Flank {
    points: Vec<FlankPoint>,
    /// Unit direction of insertion.
    axis: DVec3,
    /// Two unit directions orthogonal to it.
    across: [DVec3; 2],
    tip_mm: DVec3,
    middle_mm: DVec3,
    half_clearance_mm: f64,
    /// Whether the part is round about the axis; its facets must not make spin count.
    is_round: bool,
    symmetries: Vec<Symmetry>,
}

#[derive(Clone, Copy)]
struct FlankPoint {
    position_mm: DVec3,
    normal: DVec3,
}

/// A motion (ω, v) of the part in its own frame.
#[derive(Clone, Copy)]
struct Motion {
    omega: DVec3,
    v_mm: DVec3,
}

impl Motion {
    const fn of(twist: [f64; 6]) -> Self {
        let [a, b, c, x, y, z] = twist;
        Self { omega: DVec3::new(a, b, c), v_mm: DVec3::new(x, y, z) }
    }

    fn at(&self, position_mm: DVec3) -> DVec3 {
        self.omega.cross(position_mm) + self.v_mm
    }
}

impl Flank {
    /// Flank of the last `depth_mm` of a part along the unit direction `axis`; its hole is wider by
    /// `clearance_mm`.
    pub(super) fn of(template: &Template, axis: DVec3, depth_mm: f64, clearance_mm: f64) -> Self {
        let across_x = axis.any_orthonormal_vector();
        let every = || template.points_mm().iter().zip(template.normals());
        let tip = every().map(|(p, _)| p.dot(axis)).fold(f64::NEG_INFINITY, f64::max);
        let band_mm = 4.0 * template.spacing_mm();
        let is_end = |along: f64| along > tip - band_mm || (along - (tip - depth_mm)).abs() < band_mm;
        let mut points: Vec<FlankPoint> = every()
            .filter(|(p, n)| is_end(p.dot(axis)) && n.dot(axis).abs() < MAX_LEAN)
            .map(|(&position_mm, &normal)| FlankPoint { position_mm, normal })
            .collect();
        let stride = points.len().div_ceil(MAX_POINTS).max(1);
        points = points.into_iter().step_by(stride).collect();
        let on_axis = |along: f64| axis * along;
        let symmetries = template.find_symmetries(ROUND_MM);
        let is_round = symmetries.iter().any(|symmetry| {
            let beside_mm = symmetry.centre_mm.cross(axis).length();
            symmetry.order.is_none() && symmetry.axis.cross(axis).length() < 1e-3 && beside_mm < ROUND_MM
        });
        Self {
            points,
            axis,
            across: [across_x, axis.cross(across_x)],
            tip_mm: on_axis(tip),
            middle_mm: on_axis(tip - 0.5 * depth_mm),
            half_clearance_mm: 0.5 * clearance_mm,
            is_round,
            symmetries,
        }
    }

    /// Centre of the tip, part frame.
    pub(super) const fn tip_mm(&self) -> DVec3 {
        self.tip_mm
    }

    /// Forecast for a part with this belief, inserted by its likeliest pose. `sigma_rad` and `sigma_mm`
    /// are the prior standard deviations of its pose.
    pub(super) fn forecast(&self, belief: &Belief, sigma_rad: f64, sigma_mm: f64) -> Forecast {
        let back = belief.likeliest().pose.inverse();
        let mut chance = 0.0;
        let mut about_likeliest: Symmetric<6> = [[0.0; 6]; 6];
        for share in belief.shares() {
            let estimate = share.estimate;
            let information = estimate.in_frame(&estimate.pose.inverse()).information;
            let covariance = joined(&information, sigma_rad, sigma_mm);
            // A symmetric copy fits as well.
            let copy = Symmetry::nearest_copy(&self.symmetries, &(back * estimate.pose), &Pose::IDENTITY);
            let (omega, v_mm) = copy.log();
            let off = [omega.x, omega.y, omega.z, v_mm.x, v_mm.y, v_mm.z];
            chance += share.probability * self.chance(&off, &covariance);
            about_likeliest = core::array::from_fn(|i| {
                core::array::from_fn(|j| {
                    let moment = covariance[i][j] + off[i] * off[j];
                    about_likeliest[i][j] + share.probability * moment
                })
            });
        }
        Forecast {
            chance,
            weakest: self.weakest(&about_likeliest),
            lateral_sigma_mm: self.lateral_sigma_mm(&about_likeliest),
        }
    }

    /// Fraction of motions drawn around `off` with this covariance that fit; both (ω, v) in the part's frame.
    fn chance(&self, off: &[f64; 6], covariance: &Symmetric<6>) -> f64 {
        let parts = eigen(covariance);
        // Fixed seed, so that a forecast depends on the belief alone.
        let mut stream = Stream::new(0, "chance of insertion");
        let fits = (0..DRAWS)
            .filter(|_| {
                let mut twist = *off;
                for (value, vector) in parts.values.into_iter().zip(parts.vectors) {
                    let size = sqrt(value.max(0.0)) * stream.normal();
                    (0..6).for_each(|i| twist[i] += size * vector[i]);
                }
                self.room_mm(&Motion::of(twist)) >= 0.0
            })
            .count();
        fits as f64 / DRAWS as f64
    }

    /// Smallest distance between flank and walls after a motion; below 0 the part does not fit.
    fn room_mm(&self, motion: &Motion) -> f64 {
        let spin = if self.is_round { self.axis * motion.omega.dot(self.axis) } else { DVec3::ZERO };
        let motion = Motion { omega: motion.omega - spin, ..*motion };
        let farthest = self.points.iter().map(|p| p.normal.dot(motion.at(p.position_mm))).fold(0.0, f64::max);
        self.half_clearance_mm - farthest
    }

    /// Describes the motion that costs the most room when made by one standard deviation, about the
    /// middle of the hole.
    fn weakest(&self, covariance: &Symmetric<6>) -> String {
        let turns =
            [("lean about", self.across[0]), ("lean about", self.across[1]), ("spin about", self.axis)];
        let slides = self.across.map(|direction| ("slide along", direction));
        let mut worst = (f64::INFINITY, String::new());
        for (name, direction) in turns {
            let sigma = sqrt(quadratic(covariance, &[direction.x, direction.y, direction.z, 0.0, 0.0, 0.0]));
            let omega = direction * sigma.min(core::f64::consts::PI);
            let room = self.least_room_mm(&Motion { omega, v_mm: -omega.cross(self.middle_mm) });
            if room < worst.0 {
                let words = format!("{name} {}, known to {:.2} deg", words(direction), sigma.to_degrees());
                worst = (room, words);
            }
        }
        for (name, direction) in slides {
            let sigma = self.sigma_at(covariance, self.middle_mm, direction);
            let room = self.least_room_mm(&Motion { omega: DVec3::ZERO, v_mm: direction * sigma });
            if room < worst.0 {
                worst = (room, format!("{name} {}, known to {sigma:.3} mm", words(direction)));
            }
        }
        worst.1
    }

    fn least_room_mm(&self, motion: &Motion) -> f64 {
        let back = Motion { omega: -motion.omega, v_mm: -motion.v_mm };
        self.room_mm(motion).min(self.room_mm(&back))
    }

    /// Standard deviation of a point's position along a direction.
    fn sigma_at(&self, covariance: &Symmetric<6>, point_mm: DVec3, direction: DVec3) -> f64 {
        // direction · (ω x p + v) = (p x direction) · ω + direction · v
        let turn = point_mm.cross(direction);
        sqrt(quadratic(covariance, &[turn.x, turn.y, turn.z, direction.x, direction.y, direction.z]))
    }

    fn lateral_sigma_mm(&self, covariance: &Symmetric<6>) -> f64 {
        // Maximum over directions every 10 degrees: the true maximum is at most 0.4 % larger.
        (0..18)
            .map(|k| {
                let angle = f64::from(k) * core::f64::consts::PI / 18.0;
                let direction = self.across[0] * gelstereo_core::math::cos(angle)
                    + self.across[1] * gelstereo_core::math::sin(angle);
                self.sigma_at(covariance, self.tip_mm, direction)
            })
            .fold(0.0, f64::max)
    }
}

/// Covariance of a motion in the part's frame: the information combined with the prior.
pub(super) fn joined(information: &Symmetric<6>, sigma_rad: f64, sigma_mm: f64) -> Symmetric<6> {
    let sigma = |i: usize| if i < 3 { sigma_rad } else { sigma_mm };
    // In units of the prior no eigenvalue is below 1.
    let scaled: Symmetric<6> = core::array::from_fn(|i| {
        core::array::from_fn(|j| sigma(i) * information[i][j] * sigma(j) + f64::from(u8::from(i == j)))
    });
    let parts = eigen(&scaled);
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            let inverse: f64 =
                (0..6).map(|k| parts.vectors[k][i] * parts.vectors[k][j] / parts.values[k].max(1.0)).sum();
            sigma(i) * inverse * sigma(j)
        })
    })
}

fn quadratic(matrix: &Symmetric<6>, vector: &[f64; 6]) -> f64 {
    let sum: f64 = (0..6)
        .flat_map(|i| (0..6).map(move |j| (i, j)))
        .map(|(i, j)| vector[i] * matrix[i][j] * vector[j])
        .sum();
    sum.max(0.0)
}

fn words(direction: DVec3) -> String {
    format!("({:.2} {:.2} {:.2})", direction.x, direction.y, direction.z)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use gelstereo_core::math::exp;
    use gelstereo_core::register::PoseEstimate;
    use gelstereo_sim::Shape;

    /// A peg 8 mm in diameter and 40 mm long, origin at its centre; 10 mm of it go into an 8.2 mm hole.
    fn peg() -> Flank {
        let shape = Shape::Cylinder { radius_mm: 4.0, length_mm: 40.0 };
        let template = Template::from_mesh(&shape.mesh(0.003).unwrap(), 0.4, 1).unwrap();
        Flank::of(&template, DVec3::NEG_Z, 10.0, 0.2)
    }

    /// Diagonal matrix of the squares of `sigma`, turns before shifts, part frame.
    fn diagonal(sigma: [f64; 6]) -> Symmetric<6> {
        core::array::from_fn(|i| core::array::from_fn(|j| if i == j { sigma[i] * sigma[i] } else { 0.0 }))
    }

    #[test]
    fn a_round_peg_that_shifts_evenly_has_the_chance_of_a_disc() {
        for sigma_mm in [0.02, 0.05, 0.1] {
            let chance = peg().chance(&[0.0; 6], &diagonal([0.0, 0.0, 0.0, sigma_mm, sigma_mm, 0.6]));
            let expected = 1.0 - exp(-0.5 * (0.1 / sigma_mm) * (0.1 / sigma_mm));
            // Four standard errors of the fraction, plus 1 % of the radius for the spacing of template
            // points.
            let slack = 4.0 * sqrt(expected * (1.0 - expected) / DRAWS as f64) + 0.01;
            assert!((chance - expected).abs() < slack, "{chance} against {expected}");
        }
    }

    #[test]
    fn spin_and_slide_along_the_axis_cost_a_round_peg_nothing() {
        assert!(peg().chance(&[0.0; 6], &diagonal([0.0, 0.0, 0.02, 0.0, 0.0, 5.0])) > 0.999);
        assert_eq!(peg().chance(&[0.0; 6], &diagonal([0.0; 6])), 1.0);
    }

    /// A pose known to 1e-3 mm and 1e-5 rad.
    fn exactly(pose: Pose) -> PoseEstimate {
        let sharp = diagonal([1e5, 1e5, 1e5, 1e3, 1e3, 1e3]);
        PoseEstimate { pose, information: sharp }
    }

    /// A thread pose one pitch off may be as likely. The chance is the total probability of the poses that
    /// fit when inserted by the likeliest one.
    #[test]
    fn the_chance_is_that_of_all_poses_by_their_odds() {
        let here = Pose::from_translation_mm(DVec3::new(3.0, -2.0, 50.0));
        let forecast = |shift_mm: DVec3, odds: f64| {
            let there = here * Pose::from_translation_mm(shift_mm);
            let belief = Belief::of_two(exactly(here), exactly(there), odds.ln());
            peg().forecast(&belief, 10.0, 100.0)
        };
        // The hole has 0.1 mm of room on each side.
        assert!((forecast(DVec3::X * 0.2, 0.25).chance - 0.8).abs() < 1e-9);
        assert!((forecast(DVec3::X * 0.2, 1.0).chance - 0.5).abs() < 1e-9);
        assert!((forecast(DVec3::X * 0.05, 1.0).chance - 1.0).abs() < 1e-9);
        assert!((forecast(DVec3::Z * 1.5, 1.0).chance - 1.0).abs() < 1e-9, "along the axis there is room");
        let aside = forecast(DVec3::X * 0.2, 1.0);
        assert!((aside.lateral_sigma_mm - 0.2 / sqrt(2.0)).abs() < 1e-3, "the search reaches the other pose");
        assert!(aside.weakest.starts_with("slide along"), "{}", aside.weakest);
    }

    #[test]
    fn a_pose_that_looks_the_same_costs_nothing() {
        let size_mm = [8.0, 8.0, 40.0];
        let template = Template::from_mesh(&Shape::Box { size_mm }.mesh(0.003).unwrap(), 0.4, 1).unwrap();
        let square = Flank::of(&template, DVec3::NEG_Z, 10.0, 0.2);
        let chance = |turn_rad: f64| {
            let turned = Pose::exp(DVec3::Z * turn_rad, DVec3::ZERO);
            let belief = Belief::of_two(exactly(Pose::IDENTITY), exactly(turned), 0.0);
            square.forecast(&belief, 10.0, 100.0).chance
        };
        assert!((chance(core::f64::consts::FRAC_PI_2) - 1.0).abs() < 1e-9, "a quarter turn of a square peg");
        assert!((chance(0.1) - 0.5).abs() < 1e-9, "turned by 0.1 rad a corner is off by 0.4 mm");
    }

    #[test]
    fn the_motion_that_costs_most_is_named_with_its_size() {
        let peg = peg();
        let along = |k: usize| words(peg.across[k]);
        let across = peg.across[1];
        let mut slides = diagonal([1e-6; 6]);
        for i in 0..3 {
            for j in 0..3 {
                slides[3 + i][3 + j] += 0.09 * across[i] * across[j];
            }
        }
        assert_eq!(peg.weakest(&slides), format!("slide along {}, known to 0.300 mm", along(1)));
        // A lean turns about the middle of the hole: it does not shift that point, and shifts the tip by
        // 5 mm times the angle.
        let pose = Pose::from_translation_mm(-peg.middle_mm);
        let information = diagonal([1e3, 1.0 / 0.03, 1e3, 1e3, 1e3, 1e3]);
        let forecast = peg.forecast(&Belief::alone(PoseEstimate { pose, information }), 10.0, 100.0);
        assert!(forecast.weakest.starts_with("lean about"), "{}", forecast.weakest);
        assert!((forecast.lateral_sigma_mm - 0.15).abs() < 0.01, "{}", forecast.lateral_sigma_mm);
    }
}
