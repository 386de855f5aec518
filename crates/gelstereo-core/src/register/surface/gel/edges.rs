//! Information about the pose from the edges of the part.
//!
//! The edge at which the gel leaves the part lies between a marker in contact and a neighbour that is not.
//! Moving that edge hardly changes either height until it passes one of the two markers, which then falls
//! or is lifted. Edges are therefore walls, i.e. one-sided bounds on the pose; a derivative would be
//! arbitrary, since it either includes the wall or does not. Markers along an edge that crosses their rows
//! give walls at different distances, which leave little room; along a row all walls are the same. The pose
//! then has a normal distribution truncated by the walls. Expectation propagation (Minka 2001; Cunningham,
//! Hennig and Lacoste-Julien 2011) matches its mean and covariance by adding a precision along each wall.
//!
//! A crease between two markers in contact is no wall: the heights change so little when it passes that
//! another pose can compensate.

use super::fit::GelFit;
use super::lattice::Node;
use super::prediction::{GelFitScratch, Sight, Wall};
use crate::math::linalg::{Symmetric, eigen};
use crate::math::{DVec3, abs, erfc, exp, sqrt};
use crate::register::observe::{Vector6, add_outer, dot, stack};
use crate::register::surface::candidate::Candidate;
use crate::register::surface::distances::{Distances, Foot, Last, Range};
use crate::register::surface::smooth_normals::CREASE_COS;
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Smallest detectable change of a height, in standard deviations.
const TELLS: f64 = 3.0;
/// Smallest inlier probability of a marker that forms a wall.
const GOOD: f64 = 0.5;
/// Smallest sine, across the press, between two faces that form an edge.
const MIN_SINE: f64 = 0.1;
/// Sweeps over the walls; more change the result little.
const SWEEPS: usize = 3;
/// Standard deviations beyond which a wall has no effect, and to which a mean outside the wall is clamped.
const FAR: f64 = 6.0;
const ALL: Range = Range { from_mm: f64::NEG_INFINITY, to_mm: f64::INFINITY };

/// Edge at which the face under a node ends, towards the node's neighbour.
struct Edge {
    /// Unit vector across the edge and the press, towards the neighbour; sensor frame.
    across: DVec3,
    /// Distances of the node and the neighbour from the edge.
    room_mm: [f64; 2],
    /// Slope at which the face beyond the edge falls away.
    slope: f64,
    /// Height of the neighbour over the extended face.
    over_mm: f64,
}

impl GelFit<'_> {
    /// Finds the walls at a state whose prediction is in the scratch: for each marker, the nearest edge
    /// that may pass it.
    pub fn find_walls(&self, state: &Candidate, scratch: &mut GelFitScratch) {
        let GelFitScratch { here, walls, .. } = scratch;
        let gel = self.gel();
        let stiffness = gel.stiffness(state.rest.log_decay);
        walls.clear();
        for (k, sight) in here.sights.iter().enumerate() {
            if sight.weight < GOOD {
                continue;
            }
            let sigma_mm = sqrt(sight.variance_mm2);
            let touched = |j: usize| here.sights[j].foot.as_ref().filter(|_| here.sights[j].touches);
            let lift_mm = here.heights_mm[k] - gel.free_mm(k, stiffness, &here.heights_mm);
            if self.may_bridge(state, here, k, lift_mm) {
                continue;
            }
            // Beyond an edge the gel falls gradually, by the change over the distance between the markers.
            let (mut nearest, mut kink_mm): (Option<Wall>, f64) = (None, 0.0);
            for j in gel.near(k).filter(|&j| here.sights[j].touches != sight.touches) {
                let (inner, outer) = if sight.touches { (k, j) } else { (j, k) };
                let nodes = [&gel.nodes[inner], &gel.nodes[outer]];
                let Some(foot) = touched(inner) else { continue };
                let Some(edge) = self.edge(state, nodes, foot, &here.sights[outer]) else { continue };
                let [falls_mm, rises_mm] = [
                    lift_mm.min(edge.slope * (edge.room_mm[0] + edge.room_mm[1])),
                    sight.residual_mm - edge.over_mm,
                ];
                let (changes_mm, room_mm, sign) = if sight.touches {
                    (falls_mm, edge.room_mm[0], -1.0)
                } else {
                    (rises_mm, edge.room_mm[1], 1.0)
                };
                if changes_mm < TELLS * sigma_mm {
                    continue;
                }
                kink_mm = kink_mm.max(sigma_mm * (edge.room_mm[0] + edge.room_mm[1]) / changes_mm);
                if nearest.is_some_and(|wall| wall.room_mm <= room_mm) {
                    continue;
                }
                let (sample, u) = (&gel.nodes[k].sample, sign * edge.across);
                nearest = Some(Wall {
                    row: stack(sample.p_mm.cross(u) / self.problem.samples.radius_mm, u),
                    room_mm,
                    sigma_mm: sqrt(sample.variance(u)),
                    precision: 0.0,
                    pull: 0.0,
                });
            }
            walls.extend(nearest.map(|wall| Wall {
                sigma_mm: sqrt(wall.sigma_mm * wall.sigma_mm + kink_mm * kink_mm),
                ..wall
            }));
        }
    }

    fn edge(&self, state: &Candidate, [node, next]: [&Node; 2], foot: &Foot, beyond: &Sight) -> Option<Edge> {
        let placement = &state.placement;
        let press = placement.object_direction(self.problem.press_direction);
        let cosine = foot.normal.dot(press);
        let way = placement.object_direction(next.sample.p_mm - node.sample.p_mm);
        let way = way - press * way.dot(press);
        let marker = placement.object_point(next.sample.p_mm);
        let under = placement.object_point(node.sample.p_mm) - press * foot.over_mm;
        // Point of the extended face under the neighbour.
        let at = under + way - press * (foot.normal.dot(way) / cosine);
        let (distance_mm, normal) = match &beyond.foot {
            Some(other) => ((at - marker + press * other.over_mm).dot(other.normal), other.normal),
            None => {
                let near = match &self.faces {
                    Some(faces) => faces.at(at, press, ALL, &mut Last::default()),
                    None => self.problem.field.near_at(at, press),
                };
                (near.distance_mm, near.normal)
            }
        };
        if normal.dot(foot.normal) >= CREASE_COS {
            return None;
        }
        let across = normal * cosine - foot.normal * normal.dot(press);
        let length = sqrt(across.length_squared());
        if length < MIN_SINE {
            return None;
        }
        let across = across * (if across.dot(way) < 0.0 { -1.0 } else { 1.0 } / length);
        // Rate at which the distance from the surface beyond grows along the face.
        let grows = (across - press * (foot.normal.dot(across) / cosine)).dot(normal);
        let (whole_mm, beyond_mm) = (across.dot(way), distance_mm / grows);
        (0.0..=whole_mm).contains(&beyond_mm).then(|| Edge {
            across: placement.sensor_direction(across),
            room_mm: [whole_mm - beyond_mm, beyond_mm],
            slope: abs(grows) / normal.dot(press).max(1e-3),
            over_mm: (marker - at).dot(press),
        })
    }
}

/// A normal distribution truncated by walls.
pub(in crate::register::surface) struct Bounded {
    /// Without the walls.
    information: Symmetric<6>,
    mean: Vector6,
    covariance: Symmetric<6>,
}

impl Bounded {
    /// Truncates the normal distribution with mean zero whose information is this plus the guess's along the
    /// axes. Without the guess a direction with a wall on one side only would have no limit.
    pub fn new(information: &Symmetric<6>, guess: &Vector6, walls: &mut [Wall]) -> Self {
        let mut sum = *information;
        (0..6).for_each(|i| sum[i][i] += guess[i]);
        let (known, mut covariance) = (eigen(&sum), [[0.0; 6]; 6]);
        // No eigenvalue of the sum is less, but for rounding.
        let min_known = guess.iter().copied().fold(f64::INFINITY, f64::min);
        for (value, u) in known.values.iter().zip(&known.vectors) {
            add_outer(&mut covariance, u, 1.0 / value.max(min_known));
        }
        let mut out = Self { information: *information, mean: [0.0; 6], covariance };
        walls.iter_mut().for_each(|wall| (wall.precision, wall.pull) = (0.0, 0.0));
        for _ in 0..SWEEPS {
            walls.iter_mut().for_each(|wall| out.cut(wall));
        }
        out
    }

    /// Updates the contribution of one wall.
    fn cut(&mut self, wall: &mut Wall) {
        let across: Vector6 = self.covariance.map(|row| dot(&row, &wall.row));
        let (variance, mean) = (dot(&across, &wall.row), dot(&self.mean, &wall.row));
        // Cavity distribution, without this wall.
        let others = 1.0 / variance - wall.precision;
        if !(others > 0.0) {
            return;
        }
        let middle_mm = (mean / variance - wall.pull) / others;
        let sigma_mm = sqrt(1.0 / others + wall.sigma_mm * wall.sigma_mm);
        let x = (wall.room_mm - middle_mm) / sigma_mm;
        let (precision, pull) = if x > FAR {
            (0.0, 0.0)
        } else {
            // Mean and variance of the truncated distribution.
            let x = x.max(-FAR);
            let inside = 0.5 * erfc(-x * FRAC_1_SQRT_2);
            let slope = exp(-0.5 * x * x) / (sqrt(TAU) * inside * sigma_mm);
            let curved = slope * (x / sigma_mm + slope);
            let left = (1.0 - curved / others).max(f64::EPSILON);
            (curved / left, (curved * middle_mm - slope) / left)
        };
        let (more, pulls) = (precision - wall.precision, pull - wall.pull);
        (wall.precision, wall.pull) = (precision, pull);
        let share = 1.0 / (1.0 + more * variance);
        (0..6).for_each(|i| self.mean[i] += across[i] * (pulls - more * mean) * share);
        add_outer(&mut self.covariance, &across, -more * share);
    }

    pub fn variance(&self, row: &Vector6) -> f64 {
        dot(row, &self.covariance.map(|one| dot(&one, row))).max(0.0)
    }

    /// Information matrix with the walls, (Σ + μ μᵀ)⁻¹: the pose is not moved to the mean μ, so μ counts
    /// as an error.
    pub fn information(&self, walls: &[Wall]) -> Symmetric<6> {
        let mut out = self.information;
        walls.iter().for_each(|wall| add_outer(&mut out, &wall.row, wall.precision));
        let pull = out.map(|row| dot(&row, &self.mean));
        let weight = -1.0 / (1.0 + dot(&pull, &self.mean));
        add_outer(&mut out, &pull, weight);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    /// A wall at `room_mm` along one axis or against it.
    fn wall(room_mm: f64, sign: f64) -> Wall {
        let row = [0.0, 0.0, 0.0, sign, 0.0, 0.0];
        Wall { row, room_mm, sigma_mm: 0.015, precision: 0.0, pull: 0.0 }
    }

    const KNOWN: f64 = 10.0;
    /// A guess that is known to a metre.
    const GUESS: Vector6 = [1e-6; 6];

    fn information() -> Symmetric<6> {
        core::array::from_fn(|i| core::array::from_fn(|k| if i == k { KNOWN } else { 0.0 }))
    }

    /// Mean square of the truncated normal distribution, by the midpoint rule.
    fn integral(walls: &[Wall]) -> f64 {
        let (mut all, mut squared) = (0.0, 0.0);
        for k in -20_000..20_000 {
            let z = 1e-4 * (f64::from(k) + 0.5);
            let inside = |w: &Wall| 0.5 * erfc((w.row[3] * z - w.room_mm) / w.sigma_mm * FRAC_1_SQRT_2);
            let density = exp(-0.5 * KNOWN * z * z) * walls.iter().map(inside).product::<f64>();
            all += density;
            squared += density * z * z;
        }
        squared / all
    }

    #[test]
    fn within_walls_a_normal_law_is_about_what_is_left_of_it() {
        let pitch_mm = 0.9;
        for count in [1, 2, 4, 8] {
            // An edge oblique to the marker rows: every marker has a different distance from it.
            let rooms = (0..count).map(|k| pitch_mm * (f64::from(k) + 0.3) / f64::from(count));
            let mut walls: Vec<Wall> =
                rooms.flat_map(|room_mm| [wall(room_mm, 1.0), wall(pitch_mm - room_mm, -1.0)]).collect();
            let told = Bounded::new(&information(), &GUESS, &mut walls).information(&walls);
            let ratio = 1.0 / (told[3][3] * integral(&walls));
            // The truncated distribution is uniform between the nearest two walls; the approximation is
            // up to a quarter wider.
            assert!((1.0..1.3).contains(&ratio), "{count}: {ratio}");
            assert!((told[0][0] - KNOWN).abs() < 1e-12 * KNOWN);
        }
    }

    #[test]
    fn a_row_of_markers_along_an_edge_tells_hardly_more_than_one() {
        let told = |count: usize| {
            let mut walls: Vec<Wall> = (0..count).flat_map(|_| [wall(0.5, 1.0), wall(0.4, -1.0)]).collect();
            Bounded::new(&information(), &GUESS, &mut walls).information(&walls)[3][3]
        };
        // Independent walls would give eight times the information.
        assert!(told(8) > told(1) && told(8) < 2.0 * told(1), "{} {}", told(8), told(1));
    }

    #[test]
    fn a_wall_far_away_changes_nothing() {
        let mut walls = [wall(3.0, 1.0), wall(3.0, -1.0)];
        assert_eq!(Bounded::new(&information(), &GUESS, &mut walls).information(&walls), information());
    }

    #[test]
    fn one_wall_right_beside_leaves_half() {
        // Half a normal distribution has the mean square of the whole.
        let mut walls = [wall(0.0, 1.0)];
        walls[0].sigma_mm = 1e-6;
        let bounded = Bounded::new(&information(), &GUESS, &mut walls);
        assert!((bounded.information(&walls)[3][3] - KNOWN).abs() < 1e-4 * KNOWN);
        let spread = bounded.variance(&walls[0].row) * KNOWN;
        assert!((spread - (1.0 - 2.0 / core::f64::consts::PI)).abs() < 1e-4, "{spread}");
    }
}
