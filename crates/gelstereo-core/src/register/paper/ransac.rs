//! Random sample consensus (Fischler and Bolles 1981) over triplets with equal mutual distances.

use super::facet::{Facet, facet};
use super::filterreg::width_floor_mm;
use super::problem::{Problem, Scratch, check_reach, compose};
use crate::math::random::{Stream, keyed};
use crate::math::{DVec3, Pose, centroid};
use crate::register::error::RegisterError;
use crate::register::observe::{PatchFrame, Sighting, System};
use crate::register::rigid::rigid_fit;
use crate::stop::{Stopped, ask, ask_often};

/// The best of `ransac_hypotheses` poses near the guess, including the guess itself.
///
/// A hypothesis draws three points of the patch and, near their positions at the guess, three template
/// points with the same mutual distances to within the template's spacing. Its score is the sum over the
/// patch of the squared distance to the template, each limited to that of an outlier (MSAC, Torr and
/// Zisserman 2000).
pub(super) fn search(
    problem: &Problem<'_>,
    scratch: &mut Scratch,
    guess: &Pose,
) -> Result<Pose, RegisterError> {
    let params = problem.params;
    scratch.place(problem.points_mm, guess);
    check_reach(problem, &scratch.placed, params.advanced.search_radius_mm)?;
    let mut random = Stream::new(params.ransac_icp.seed, "ransac");
    let centre = centroid(&scratch.placed);
    let mut best = (Pose::IDENTITY, score(problem, &scratch.placed, &Pose::IDENTITY, f64::INFINITY));
    for _ in 0..params.ransac_icp.hypotheses {
        ask(problem.stop, 0)?;
        let Some(motion) = hypothesis(problem, &scratch.placed, &mut random) else { continue };
        if motion.transform_point(centre).distance(centre) > params.advanced.search_radius_mm {
            continue;
        }
        let cost = score(problem, &scratch.placed, &motion, best.1);
        if cost < best.1 {
            best = (motion, cost);
        }
    }
    let motion = without_free(problem, scratch, &best.0)?;
    Ok(compose(guess, &motion))
}

/// Removes the motion along directions that are free at its end: there the motion is random, and the
/// guess is better. Exact for a spin about an axis or a slide, whose twist is constant along the way.
fn without_free(problem: &Problem<'_>, scratch: &mut Scratch, motion: &Pose) -> Result<Pose, Stopped> {
    let Problem { params, template, .. } = *problem;
    let max_squared = params.advanced.max_distance_mm * params.advanced.max_distance_mm;
    scratch.clear_pairs();
    for (step, &point) in scratch.placed.iter().enumerate() {
        ask_often(problem.stop, step)?;
        let moved = motion.transform_point(point);
        if template.tree().nearest(moved).is_some_and(|(_, distance_squared)| distance_squared <= max_squared)
        {
            scratch.sources.push(moved);
        }
    }
    let frame = PatchFrame::new(&scratch.sources, template.spacing_mm());
    let mut system = System::new(frame.radius_mm, params.point_sigma_mm);
    for (step, &point) in scratch.sources.iter().enumerate() {
        ask_often(problem.stop, step)?;
        let Facet { normal, normal_variance } =
            facet(template, point, width_floor_mm(problem), params.point_sigma_mm);
        let lever = point - frame.centre_mm;
        system.add(&Sighting { lever, normal, residual: 0.0, weight: 1.0, normal_variance });
    }
    let about = Pose::from_translation_mm(frame.centre_mm);
    let twist = (about.inverse() * *motion * about).log();
    let (omega, v_mm) = system.observe(frame.centre_mm).determined(twist);
    Ok(about * Pose::exp(omega, v_mm) * about.inverse())
}

/// A motion of the placed patch from one random triplet, if the template has a matching one.
fn hypothesis(problem: &Problem<'_>, placed: &[DVec3], random: &mut Stream) -> Option<Pose> {
    let [a, b, c] = core::array::from_fn(|_| placed[random.below(placed.len())]);
    let margin_mm = problem.template.spacing_mm();
    let (ab, bc, ca) = (a.distance(b), b.distance(c), c.distance(a));
    // A triplet narrower than the sampling does not constrain rotation.
    if ab.min(bc).min(ca) <= 2.0 * margin_mm {
        return None;
    }
    let points = problem.template.points_mm();
    let reach_mm = problem.params.advanced.search_radius_mm;
    let first = draw(problem, a, reach_mm, random, |_| true)?;
    let at = |q: DVec3, from: DVec3, distance: f64| (q.distance(from) - distance).abs() <= margin_mm;
    let second = draw(problem, b, reach_mm, random, |q| at(q, points[first], ab))?;
    let third =
        draw(problem, c, reach_mm, random, |q| at(q, points[first], ca) && at(q, points[second], bc))?;
    let targets = [points[first], points[second], points[third]];
    rigid_fit(&[a, b, c], &targets, &[]).ok().map(|fit| fit.t_target_source)
}

/// Draws a suitable template point within reach of `near`, uniformly: the one with the smallest random
/// key. The result is then independent of tree order, which changes with ties of the part's extents.
fn draw(
    problem: &Problem<'_>,
    near: DVec3,
    reach_mm: f64,
    random: &mut Stream,
    suits: impl Fn(DVec3) -> bool,
) -> Option<usize> {
    let key = random.next_u64();
    let mut lowest: Option<(u64, usize)> = None;
    problem.template.tree().within(near, reach_mm * reach_mm, &mut |k, _| {
        let drawn = (keyed(key, k), k);
        if suits(problem.template.points_mm()[k]) && lowest.is_none_or(|lowest| drawn < lowest) {
            lowest = Some(drawn);
        }
    });
    lowest.map(|(_, k)| k)
}

/// Sum of limited squared distances of the moved patch; stops early once it reaches `limit`.
fn score(problem: &Problem<'_>, placed: &[DVec3], motion: &Pose, limit: f64) -> f64 {
    let max_squared = problem.params.advanced.max_distance_mm * problem.params.advanced.max_distance_mm;
    let mut sum = 0.0;
    for &point in placed {
        let nearest = problem.template.tree().nearest(motion.transform_point(point));
        sum += nearest.map_or(max_squared, |(_, distance_squared)| distance_squared.min(max_squared));
        if sum >= limit {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{cos, sin};
    use crate::params::RegisterParams;
    use crate::register::template::Template;
    use crate::stop::NEVER;
    use alloc::vec::Vec;

    /// A long strip that is turned about one of its ends: its middle lies beyond the search radius, and is
    /// not searched for there, although the end is within.
    #[test]
    fn a_patch_is_not_moved_beyond_the_search_radius() {
        let at = |i: i32| DVec3::new(0.5 * f64::from(i % 40), 0.5 * f64::from(i / 40 - 2), 0.0);
        let wavy = |p: DVec3| p + DVec3::Z * (0.4 * sin(1.3 * p.x) + 0.3 * cos(2.1 * p.y));
        let points_mm: Vec<DVec3> = (0..200).map(|i| wavy(at(i))).collect();
        let normal = |p: DVec3| DVec3::new(0.52 * cos(1.3 * p.x), -0.63 * sin(2.1 * p.y), -1.0).normalize();
        let normals: Vec<DVec3> = points_mm.iter().map(|&p| normal(p)).collect();
        let template = Template::new(&points_mm, &normals, 0.5).unwrap();
        let mut params = RegisterParams::default();
        (params.ransac_icp.hypotheses, params.advanced.search_radius_mm) = (5000, 1.5);
        let problem = Problem { params: &params, points_mm: &points_mm, template: &template, stop: NEVER };
        let guess = Pose::exp(DVec3::Z * 0.25, DVec3::ZERO);
        let middle = centroid(&points_mm);
        let found = search(&problem, &mut Scratch::default(), &guess).unwrap();
        let moved_mm =
            found.inverse().transform_point(middle).distance(guess.inverse().transform_point(middle));
        assert!(moved_mm <= 1.5 + 1e-9, "{moved_mm} mm");
    }
}
