//! What edges tell of the pose.
//!
//! A marker that touches and its neighbour that hangs have the edge between them at which the gel leaves the part. While the
//! pose moves that edge neither height changes by much, but when it passes one of the two: the marker falls, or is taken up.
//! So edges are walls, which leave the pose so much room, and a derivative, which sees a wall or not, would say anything.
//! Markers along an edge that runs across their rows are walls at as many places, and leave little; along a row all leave
//! the same. What is known within walls is that of a normal law which they cut, in the mean and the covariance: expectation
//! propagation (Minka 2001; Cunningham, Hennig and Lacoste-Julien 2011), which adds a precision along each.
//!
//! Where both markers touch, the heights change by so little when the crease passes that another pose may make up for it. No
//! such crease is a wall.

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

/// Standard deviations by which a height changes that tells.
const TELLS: f64 = 3.0;
/// A marker that is less likely a good one is no wall.
const GOOD: f64 = 0.5;
/// Faces that turn less than this, sine across the press, have no edge between them.
const MIN_SINE: f64 = 0.1;
/// Information that is none, per mm²: what is known no better is off by a metre.
pub(in crate::register::surface) const MIN_KNOWN: f64 = 1e-6;
/// Sweeps over the walls; more change little.
const SWEEPS: usize = 3;
/// Standard deviations beyond which a wall does not cut, and which the mean is within of it.
const FAR: f64 = 6.0;
const ALL: Range = Range { from_mm: f64::NEG_INFINITY, to_mm: f64::INFINITY };

/// The edge at which the face under a node ends, on the way to its neighbour.
struct Edge {
    /// Across it and the press, towards the neighbour.
    across: DVec3,
    /// How far the node and the neighbour are from it.
    room_mm: [f64; 2],
    /// How fast the face beyond it falls away.
    slope: f64,
    /// How far the neighbour is over the face, gone on with.
    over_mm: f64,
}

impl GelFit<'_> {
    /// The walls at a state whose prediction is in the scratch: of each marker that an edge may pass the nearest.
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
            let mut nearest: Option<Wall> = None;
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
                if changes_mm < TELLS * sigma_mm || nearest.is_some_and(|wall| wall.room_mm <= room_mm) {
                    continue;
                }
                let (sample, u) = (&gel.nodes[k].sample, sign * edge.across);
                let kink_mm = sigma_mm / edge.slope;
                nearest = Some(Wall {
                    row: stack(sample.p_mm.cross(u) / self.samples.radius_mm, u),
                    room_mm,
                    sigma_mm: sqrt(kink_mm * kink_mm + sample.variance(u)),
                    precision: 0.0,
                    pull: 0.0,
                });
            }
            walls.extend(nearest);
        }
    }

    fn edge(&self, state: &Candidate, [node, next]: [&Node; 2], foot: &Foot, beyond: &Sight) -> Option<Edge> {
        let placement = &state.placement;
        let press = placement.object_direction(self.press_direction);
        let cosine = foot.normal.dot(press);
        let way = placement.object_direction(next.sample.p_mm - node.sample.p_mm);
        let way = way - press * way.dot(press);
        let marker = placement.object_point(next.sample.p_mm);
        let under = placement.object_point(node.sample.p_mm) - press * foot.over_mm;
        // On the face, gone on with, under the neighbour.
        let at = under + way - press * (foot.normal.dot(way) / cosine);
        let (distance_mm, normal) = match &beyond.foot {
            Some(other) => ((at - marker + press * other.over_mm).dot(other.normal), other.normal),
            None => {
                let near = match &self.faces {
                    Some(faces) => faces.at(at, press, ALL, &mut Last::default()),
                    None => self.field.near_at(at, press),
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
        // How fast the distance to what is beyond grows along the face.
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

/// A normal law within walls.
pub(in crate::register::surface) struct Bounded {
    /// Before the walls.
    information: Symmetric<6>,
    mean: Vector6,
    covariance: Symmetric<6>,
}

impl Bounded {
    /// Of so much information about a mean of zero, and of at least so much along every direction.
    pub fn new(information: &Symmetric<6>, least: f64, walls: &mut [Wall]) -> Self {
        let (known, mut covariance) = (eigen(information), [[0.0; 6]; 6]);
        for (value, u) in known.values.iter().zip(&known.vectors) {
            add_outer(&mut covariance, u, 1.0 / value.max(least));
        }
        let mut out = Self { information: *information, mean: [0.0; 6], covariance };
        walls.iter_mut().for_each(|wall| (wall.precision, wall.pull) = (0.0, 0.0));
        for _ in 0..SWEEPS {
            walls.iter_mut().for_each(|wall| out.cut(wall));
        }
        out
    }

    /// What one wall adds is found anew.
    fn cut(&mut self, wall: &mut Wall) {
        let across: Vector6 = self.covariance.map(|row| dot(&row, &wall.row));
        let (variance, mean) = (dot(&across, &wall.row), dot(&self.mean, &wall.row));
        // Without it.
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
            // The mean and the variance of what is left of it.
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

    /// With what the walls add. The pose is not moved to the mean, and as far off as that, too: the inverse of the covariance
    /// and μ μᵀ.
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

    /// At `room_mm` along one axis and against it.
    fn wall(room_mm: f64, sign: f64) -> Wall {
        let row = [0.0, 0.0, 0.0, sign, 0.0, 0.0];
        Wall { row, room_mm, sigma_mm: 0.015, precision: 0.0, pull: 0.0 }
    }

    const KNOWN: f64 = 10.0;

    fn information() -> Symmetric<6> {
        core::array::from_fn(|i| core::array::from_fn(|k| if i == k { KNOWN } else { 0.0 }))
    }

    /// Mean square of what is left of the normal law, by midpoints.
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
            // Along an edge that is turned to the rows of markers, with the pose at a place that no two of them share.
            let rooms = (0..count).map(|k| pitch_mm * (f64::from(k) + 0.3) / f64::from(count));
            let mut walls: Vec<Wall> =
                rooms.flat_map(|room_mm| [wall(room_mm, 1.0), wall(pitch_mm - room_mm, -1.0)]).collect();
            let told = Bounded::new(&information(), MIN_KNOWN, &mut walls).information(&walls);
            let ratio = 1.0 / (told[3][3] * integral(&walls));
            // What is left is even between the nearest two, and what is told of it is up to a quarter wider than that.
            assert!((1.0..1.3).contains(&ratio), "{count}: {ratio}");
            assert!((told[0][0] - KNOWN).abs() < 1e-12 * KNOWN);
        }
    }

    #[test]
    fn a_row_of_markers_along_an_edge_tells_hardly_more_than_one() {
        let told = |count: usize| {
            let mut walls: Vec<Wall> = (0..count).flat_map(|_| [wall(0.5, 1.0), wall(0.4, -1.0)]).collect();
            Bounded::new(&information(), MIN_KNOWN, &mut walls).information(&walls)[3][3]
        };
        // Independent ones would tell eight times as much.
        assert!(told(8) > told(1) && told(8) < 2.0 * told(1), "{} {}", told(8), told(1));
    }

    #[test]
    fn a_wall_far_away_changes_nothing() {
        let mut walls = [wall(3.0, 1.0), wall(3.0, -1.0)];
        assert_eq!(Bounded::new(&information(), MIN_KNOWN, &mut walls).information(&walls), information());
    }

    #[test]
    fn one_wall_right_beside_leaves_half() {
        // Of half a normal law the mean square is that of the whole.
        let mut walls = [wall(0.0, 1.0)];
        walls[0].sigma_mm = 1e-6;
        let bounded = Bounded::new(&information(), MIN_KNOWN, &mut walls);
        assert!((bounded.information(&walls)[3][3] - KNOWN).abs() < 1e-4 * KNOWN);
        let spread = bounded.variance(&walls[0].row) * KNOWN;
        assert!((spread - (1.0 - 2.0 / core::f64::consts::PI)).abs() < 1e-4, "{spread}");
    }
}
