//! Alternative poses that explain a contact about as well as the best one.
//!
//! Two poses are one solution if they differ along free directions only. The free motions of a contact
//! surface are those of a lower pair (screw, cylinder, plane, ball; Reuleaux 1876), and so form a group.
//! The logarithm of a finite free motion therefore lies along the free directions at any angle, where a
//! chord leaves them. The determined part of the logarithm distinguishes two solutions. Removing the free
//! part aligns a pose with the best one, so that their likelihoods are comparable.
//!
//! A motion D from the best pose to another solution is a local symmetry of the part. D and its inverse
//! are applied to all solutions, which finds pitches of a thread that no start has reached. Known
//! symmetries of the whole part are also applied to every solution.

use super::candidate::{Candidate, End};
use super::halving::insertion_sort;
use super::normal_system::{Normal, Placement};
use super::objective::{HOPELESS, Objective, Stage};
use super::state::Search;
use crate::math::{DVec3, Pose, solve_definite};
use crate::register::observe::{dot, halves, stack};
use crate::register::symmetry::nearest_copy;
use crate::register::{Observability, copies, held};
use alloc::vec::Vec;
use core::f64::consts::TAU;

/// Largest log-likelihood deficit of an alternative: its likelihood is at least e^-4.6 = 1 % of the best
/// one's.
const MIN_LOG: f64 = 4.6;
/// Largest log-likelihood loss of a pose that is moved back to the guess along a free direction, from
/// where noise has moved it: two standard deviations.
const LESS_LIKELY: f64 = 2.0;
/// Distance over the patch from which poses that are not refined are distinct.
const NEAR_MM: f64 = 0.1;
/// Weight of rotations over translations in the least motion.
const TURNS_FIRST: f64 = 10.0;
/// Number of hopeless seeds in a row after which the less promising ones are not refined.
const MAX_IN_VAIN: usize = 5;
/// Largest number of refined poses, and of waiting seeds.
const MAX_POLISHED: usize = 24;
const MAX_SEEDS: usize = 48;

/// Outcome of a seed.
enum Refined {
    /// Much less likely than the best pose.
    Hopeless,
    /// Converged to a known solution.
    Known,
    New(End),
}

/// What a search for alternatives leaves beside them.
pub(super) struct Found {
    /// Candidate with the readings of the best solution, and how it ended.
    pub read: (Candidate, End),
    /// Whether alternatives may be missing.
    pub is_cut: bool,
}

/// State of a search for alternatives.
pub(super) struct Modes<'a, 'b> {
    search: &'b mut Search<'a>,
    objective: &'b mut dyn Objective,
    best: Candidate,
    /// Candidate with the readings of the best solution, and how it ended: that solution, or a rotated
    /// copy of it.
    read: (Candidate, End),
    seen: Observability,
    /// Whether promising seeds have not been refined.
    is_cut: bool,
}

impl<'a, 'b> Modes<'a, 'b> {
    /// For alternatives to `best`, which was read last and ended as `end` states.
    pub fn new(
        search: &'b mut Search<'a>,
        objective: &'b mut dyn Objective,
        best: &Candidate,
        end: End,
    ) -> Self {
        // Free directions do not depend on convergence.
        let found = objective.observe(search.problem, best, true);
        let seen = found.turned(&best.placement.pose, DVec3::ZERO);
        Self { search, objective, best: *best, read: (*best, end), seen, is_cut: false }
    }

    /// Moves the best pose back to the guess along the free directions, if it is about as likely there. A
    /// direction that noise nearly hides may not be free as far as that. Without budget the gel there is
    /// unknown, and the pose stays.
    pub fn hold(&mut self, best: &mut Candidate) {
        if self.seen.free_count() == 0 || self.search.has_spent() {
            return;
        }
        let pose =
            held::nearest(&self.seen, &self.best.placement.pose, &self.search.problem.prior.guess.pose);
        let mut one = Candidate { placement: Placement::new(pose), ..self.best };
        self.objective.read(self.search, &mut one);
        if one.cost <= self.best.cost + LESS_LIKELY {
            (*best, self.best, self.read.0) = (one, one, one);
        }
    }

    /// Leaves the best pose in `candidates`, followed by the alternatives from them and from `seeds`,
    /// likeliest first. The seeds are those of the second round, in order.
    pub fn find(mut self, candidates: &mut Vec<Candidate>, seeds: &mut Vec<Candidate>) -> Found {
        // Reserved once, so that more candidates in a later run do not allocate.
        candidates.reserve(MAX_SEEDS);
        seeds.reserve(MAX_SEEDS);
        self.gather(candidates, seeds);
        insertion_sort(seeds);
        candidates.truncate(1);
        self.turn(self.read, candidates);
        let (mut next, mut in_vain) = (0, 0);
        while next < seeds.len() && in_vain < MAX_IN_VAIN {
            if next == MAX_POLISHED || self.search.has_spent() {
                self.is_cut = true;
                break;
            }
            let mut seed = Candidate { rest: self.best.rest, slot: self.best.slot, ..seeds[next] };
            next += 1;
            match self.refine(&mut seed, candidates) {
                Refined::Hopeless => in_vain += 1,
                Refined::Known => in_vain = 0,
                Refined::New(ended) => {
                    in_vain = 0;
                    let is_new = self.accept(candidates, seed, (seed, ended));
                    self.turn((seed, ended), candidates);
                    if is_new {
                        self.repeat(candidates, seeds);
                        insertion_sort(&mut seeds[next..]);
                    }
                }
            }
        }
        let limit = candidates[0].cost + MIN_LOG;
        candidates.retain(|one| one.cost <= limit);
        Found { read: self.read, is_cut: self.is_cut }
    }

    /// Collects the seeds that are alternatives worth refining, and the runners-up among the candidates.
    /// Costs are relative to the best one.
    ///
    /// The second round is blurred by several times the noise, so it separates poses less: what it
    /// rejects is rejected for certain.
    fn gather(&self, candidates: &[Candidate], seeds: &mut Vec<Candidate>) {
        let first = seeds.first().map_or(f64::INFINITY, |seed| seed.cost);
        let guess = self.guess_cost(&self.best.placement);
        let mut count = 0;
        for k in 0..seeds.len() {
            let placement = self.carried(&seeds[k].placement);
            let cost = seeds[k].cost - first + self.guess_cost(&placement) - guess;
            let seed = Candidate { placement, cost, ..self.best };
            if cost <= MIN_LOG && self.is_new(&placement, &seeds[..count], &candidates[..1]) {
                seeds[count] = seed;
                count += 1;
            }
        }
        seeds.truncate(count);
        for one in candidates[1..].iter().rev() {
            let placement = self.carried(&one.placement);
            if self.is_new(&placement, &[], &candidates[..1]) {
                seeds.insert(0, Candidate { placement, cost: one.cost - self.best.cost, ..*one });
            }
        }
    }

    /// Accepts a solution after every rotation by which the part looks the same: only the guess changes
    /// its likelihood. Readings are not repeated there, since rounding may decide whether a marker meets
    /// a sharp edge.
    fn turn(&mut self, of: (Candidate, End), candidates: &mut Vec<Candidate>) {
        let one = of.0;
        let guess = self.guess_cost(&one.placement);
        let alike = self.search.problem.alike;
        for (axis, order) in alike.iter().filter_map(|axis| Some((axis, axis.order?))) {
            for k in 1..order {
                let turn = axis.turned(TAU * f64::from(k) / f64::from(order));
                let placement = moved(&one.placement.pose, &Placement::new(turn));
                let cost = one.cost + self.guess_cost(&placement) - guess;
                if cost > candidates[0].cost + MIN_LOG || self.is_one(&placement, &one.placement, 0.0) {
                    continue;
                }
                if candidates.len() == MAX_SEEDS {
                    self.is_cut = true;
                    return;
                }
                self.accept(candidates, Candidate { placement, cost, ..one }, of);
            }
        }
    }

    /// Prior cost of a pose.
    fn guess_cost(&self, placement: &Placement) -> f64 {
        let mut guess = Normal::ZERO;
        guess.add_prior(&self.search.problem.prior, placement, self.search.problem.samples.radius_mm, 1.0);
        guess.cost
    }

    fn near_mm(&self) -> f64 {
        self.search.problem.params.scaled(NEAR_MM)
    }

    fn is_new(&self, placement: &Placement, seeds: &[Candidate], candidates: &[Candidate]) -> bool {
        !seeds.iter().chain(candidates).any(|other| self.is_one(placement, &other.placement, self.near_mm()))
    }

    /// Motion about the centroid from `other` to that symmetric copy of `one` which is nearest to it.
    fn since(&self, one: &Placement, other: &Placement) -> Pose {
        let nearest = nearest_copy(self.search.problem.symmetries, &one.pose, &other.pose);
        let motion = nearest * other.pose.inverse();
        motion.normalized().unwrap_or(motion)
    }

    /// Whether two poses are one solution; always if they are no farther apart than `near_mm`.
    fn is_one(&self, one: &Placement, other: &Placement, near_mm: f64) -> bool {
        let motion = self.since(one, other).log();
        let (omega, v) = self.seen.determined(motion);
        let squared_mm2 = (omega * self.seen.radius_mm).length_squared() + v.length_squared();
        squared_mm2 <= near_mm * near_mm || self.seen.squared(motion) <= copies::APART * copies::APART
    }

    /// A pose, moved along the free directions to the least rotation, and then the least translation,
    /// from the best one.
    fn carried(&self, one: &Placement) -> Placement {
        let (omega, v) =
            smallest_turn(&self.seen, self.since(one, &self.best.placement).log(), self.near_mm());
        moved(&Pose::exp(omega, v), &self.best.placement)
    }

    /// Each stage begins aligned with the best pose along the free directions: steps drift along them
    /// where facets hold a pose unlike the best one.
    fn refine(&mut self, seed: &mut Candidate, candidates: &[Candidate]) -> Refined {
        for stage in [Stage::Field, Stage::First] {
            self.run(seed, stage);
            if stage == Stage::First && seed.cost > self.best.cost + HOPELESS {
                return Refined::Hopeless;
            }
            if !self.is_new(&seed.placement, &[], candidates) {
                return Refined::Known;
            }
        }
        Refined::New(self.run(seed, Stage::Last))
    }

    fn run(&mut self, seed: &mut Candidate, stage: Stage) -> End {
        seed.placement = self.carried(&seed.placement);
        self.objective.refine(self.search, seed, stage)
    }

    /// Adds a solution with readings at `read`, unless it is known; then the likelier one stays. Returns
    /// whether it is new.
    fn accept(&mut self, candidates: &mut Vec<Candidate>, one: Candidate, read: (Candidate, End)) -> bool {
        if one.cost > candidates[0].cost + MIN_LOG {
            return false;
        }
        if one.cost < candidates[0].cost {
            self.read = read;
        }
        let is_same = |other: &Candidate| self.is_one(&one.placement, &other.placement, 0.0);
        let count = candidates.len();
        match candidates.iter().position(is_same) {
            Some(k) if one.cost < candidates[k].cost => candidates[k] = one,
            Some(_) => {}
            None => candidates.push(one),
        }
        let is_new = candidates.len() > count;
        insertion_sort(candidates);
        is_new
    }

    /// Adds the seeds that a new solution suggests.
    fn repeat(&mut self, candidates: &[Candidate], seeds: &mut Vec<Candidate>) {
        let likely = candidates[0].cost - self.best.cost + MIN_LOG;
        for one in candidates {
            let motion = self.since(&self.best.placement, &one.placement);
            for motion in [motion, motion.inverse()] {
                for other in candidates {
                    let placement = self.carried(&moved(&motion, &other.placement));
                    // As likely as the other one, except for the guess.
                    let by_guess = self.guess_cost(&placement) - self.guess_cost(&other.placement);
                    let cost = other.cost - self.best.cost + by_guess;
                    if cost > likely || !self.is_new(&placement, seeds, candidates) {
                        continue;
                    }
                    if seeds.len() == MAX_SEEDS {
                        self.is_cut = true;
                        return;
                    }
                    seeds.push(Candidate { placement, cost, ..self.best });
                }
            }
        }
    }
}

/// A motion (ω, v) about the centroid with the least rotation, and then the least translation, after
/// removing its part along free directions that commute with it.
fn smallest_turn(seen: &Observability, (omega, v): (DVec3, DVec3), near_mm: f64) -> (DVec3, DVec3) {
    let weighed = |u: &[f64; 6]| -> [f64; 6] {
        core::array::from_fn(|i| if i < 3 { TURNS_FIRST * u[i] } else { u[i] })
    };
    let z = stack(omega * seen.radius_mm, v);
    // Subtracting u from the logarithm is a motion along u only where the two commute: the rest of their
    // bracket, t [ξ, u] / 2, must be small. A peg turned onto its next side does not slide along with the
    // first one.
    let commutes = |u: &[f64; 6]| {
        let (a, b) = halves(u);
        let (a, t) = (a / seen.radius_mm, dot(u, &z));
        let (turn, shift) = (omega.cross(a) * seen.radius_mm, omega.cross(b) + v.cross(a));
        0.25 * t * t * (turn.length_squared() + shift.length_squared()) <= near_mm * near_mm
    };
    let is_free =
        core::array::from_fn::<bool, 6, _>(|k| seen.values[k] == 0.0 && commutes(&seen.directions[k]));
    let free = |k: usize| is_free[k];
    let along = seen.directions.map(|u| weighed(&u));
    // Normal equations of the shares along the free directions; other shares are 0.
    let h = core::array::from_fn(|i| {
        core::array::from_fn(|k| match (free(i) && free(k), i == k) {
            (true, _) => dot(&along[i], &along[k]),
            (false, is_one) => f64::from(u8::from(is_one)),
        })
    });
    let g = core::array::from_fn(|i| if free(i) { dot(&along[i], &weighed(&z)) } else { 0.0 });
    let shares = solve_definite(&h, &g).unwrap_or([0.0; 6]);
    let left =
        core::array::from_fn(|i| z[i] - (0..6).map(|k| shares[k] * seen.directions[k][i]).sum::<f64>());
    let (omega, v) = halves(&left);
    (omega / seen.radius_mm, v)
}

/// A pose after a motion about the centroid.
fn moved(motion: &Pose, placement: &Placement) -> Placement {
    let pose = *motion * placement.pose;
    Placement::new(pose.normalized().unwrap_or(pose))
}
