//! Check of a found pose against the part turned end for end, upside down, or both.
//!
//! A guess on a wrong face of the part may lead to a pose that explains the contact about as well as noise
//! allows. Its residuals then do not reveal it, but another face explains the contact better. Two kinds of
//! half turns are most easily confused: those about the centre of the bounding box map that box to itself,
//! and those about the contact keep the grasped place.

use super::alternatives::{Alternative, Alternatives};
use super::copies::are_apart;
use super::error::RegisterError;
use super::registration::Registration;
use super::surface::{self, Rung, SurfaceScratch};
use super::symmetry::nearest_copy;
use super::verdict::Verdict;
use crate::math::{DVec3, Pose};
use core::f64::consts::PI;

/// The turned part must be this much likelier, as for [`Alternative`]: the found pose is then less than 1 %
/// as likely. Of 1033 correct poses and 20 wrong faces in the development half of the independent evaluation,
/// half turns about the box make 17 and 14 unsure; with 7 they are 11 and 13.
const MIN_LOG: f64 = 4.6;
/// A turned part is given up if its best start after screening costs this much more than the best one
/// without a turn. Of 173 likelier turned poses in the development half and the further parts, 15, 8, 5, 4
/// and 3 are lost with 0.5, 1, 2, 3 and 5; of 2941 less likely ones, 71, 69, 66, 64 and 60 % are given up.
const HOPELESS: f64 = 2.0;

/// Searches from every half turn of the found pose. A likelier one makes the verdict unsure, and becomes the
/// first alternative; one that is about as likely becomes an alternative too. If the likelier part is as
/// likely when it is turned back, the search had missed that pose. It is then taken, and unsure, since such a
/// search may have missed another one.
pub(super) fn check(
    input: &surface::Input<'_>,
    found: &mut Registration,
    scratch: &mut SurfaceScratch,
) -> Result<(), RegisterError> {
    let budget = input.params.surface_search.half_turn_budget;
    if budget == 0 || found.verdict != Verdict::Fits {
        return Ok(());
    }
    let mut params = input.params.clone();
    params.surface_search.budget = budget;
    let guess = found.t_sensor_object;
    let unturned = surface::Input { params: &params, guess: &guess, ..*input };
    let (screened, work) = surface::screen(&unturned, scratch)?;
    found.work += work;
    let max_cost = screened + HOPELESS;
    for turn in turns(input, found).into_iter().flatten() {
        let guess = found.t_sensor_object * turn;
        let turned = surface::Input { guess: &guess, ..unturned };
        let Some(other) = search(found, || surface::run_promising(&turned, max_cost, scratch))? else {
            continue;
        };
        if gain(&other, found) > MIN_LOG {
            let guess = other.t_sensor_object * turn;
            let back = surface::Input { guess: &guess, ..*input };
            let back = search(found, || {
                surface::run(&back, Rung::Search, scratch).map(|back| (back.work, Some(back)))
            })?;
            if let Some(back) = back.filter(|back| gain(back, &other) > -MIN_LOG) {
                let before = core::mem::replace(found, back);
                found.work = before.work;
                found.verdict = Verdict::Unsure;
                before.alternatives.iter().for_each(|one| list(input, found, one));
            }
        }
        let Registration { t_sensor_object, log_likelihood, .. } = other;
        let log_likelihood = log_likelihood.unwrap_or(f64::NEG_INFINITY);
        list(input, found, &Alternative { t_sensor_object, log_likelihood });
    }
    let best = found.alternatives.first().map(|one| one.log_likelihood);
    if best.zip(found.log_likelihood).is_some_and(|(other, found)| other > found + MIN_LOG) {
        found.verdict = Verdict::Unsure;
    }
    Ok(())
}

/// Result of a search, whose work is added to that of `found`. `None` where the turned part is given up, out
/// of reach, or not comparable: likelihoods with and without the gel model are not.
fn search(
    found: &mut Registration,
    run: impl FnOnce() -> Result<(u64, Option<Registration>), RegisterError>,
) -> Result<Option<Registration>, RegisterError> {
    match run() {
        Ok((work, other)) => {
            found.work += work;
            Ok(other.filter(|other| other.gel_decay.is_some() == found.gel_decay.is_some()))
        }
        Err(RegisterError::OutOfReach { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Log-likelihood beyond that of another pose.
fn gain(of: &Registration, beyond: &Registration) -> f64 {
    of.log_likelihood.zip(beyond.log_likelihood).map_or(0.0, |(of, beyond)| of - beyond)
}

/// Half turns in the object's frame about the axes of the bounding box, through its centre and through the
/// contact's. The latter are left out where a search from the former starts there too.
fn turns(input: &surface::Input<'_>, found: &Registration) -> [Option<Pose>; 6] {
    let box_mm = centre_mm(input.template.points_mm());
    let contact_mm = found.t_sensor_object.inverse().transform_point(found.observability.centre_mm);
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| {
        let about_box = half_turn(axis, box_mm);
        let about_contact = half_turn(axis, contact_mm);
        let apart_mm = about_box.translation_mm.distance(about_contact.translation_mm);
        [Some(about_box), Some(about_contact).filter(|_| apart_mm > input.params.start_sigma_mm)]
    });
    [x[0], y[0], z[0], x[1], y[1], z[1]]
}

/// Lists a pose that is at least about as likely as the found one, and distinct from it. Of two equal ones,
/// the likelier one stays.
fn list(input: &surface::Input<'_>, found: &mut Registration, one: &Alternative) {
    let seen = found.observability;
    let is_same = |other: &Pose| {
        let nearest = nearest_copy(input.template.symmetries(), &one.t_sensor_object, other);
        !are_apart(&seen, &nearest, other)
    };
    let is_likely = found.log_likelihood.is_some_and(|log| one.log_likelihood > log - MIN_LOG);
    if !is_likely || is_same(&found.t_sensor_object) {
        return;
    }
    let mut all = Alternatives::none_of(found.alternatives.is_cut());
    let mut one = *one;
    for other in found.alternatives.iter() {
        if !is_same(&other.t_sensor_object) {
            all.push(*other);
        } else if other.log_likelihood > one.log_likelihood {
            one = *other;
        }
    }
    insert(&mut all, one);
    found.alternatives = all;
}

/// Rotation by π about an axis through a point, in the object's frame.
fn half_turn(axis: DVec3, centre_mm: DVec3) -> Pose {
    let turn = Pose::exp(axis * PI, DVec3::ZERO);
    Pose { translation_mm: centre_mm - turn.transform_vector(centre_mm), ..turn }
}

/// Centre of the bounding box.
fn centre_mm(points_mm: &[DVec3]) -> DVec3 {
    let (low, high) = points_mm
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
    0.5 * (low + high)
}

/// Inserts a pose by its likelihood; the least likely one is dropped if the list is full.
fn insert(alternatives: &mut Alternatives, one: Alternative) {
    let mut out = Alternatives::none_of(alternatives.is_cut());
    let at = alternatives.partition_point(|other| other.log_likelihood > one.log_likelihood);
    let (likelier, rest) = alternatives.split_at(at);
    likelier.iter().chain([&one]).chain(rest).for_each(|&each| out.push(each));
    *alternatives = out;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The box around the points is mapped to itself.
    #[test]
    fn a_half_turn_keeps_the_bounding_box() {
        let points_mm = [DVec3::new(1.0, 2.0, -3.0), DVec3::new(4.0, 2.5, 7.0), DVec3::new(2.0, 6.0, 0.0)];
        let centre = centre_mm(&points_mm);
        assert_eq!(centre, DVec3::new(2.5, 4.0, 2.0));
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let turned = points_mm.map(|p| half_turn(axis, centre).transform_point(p));
            assert!(centre_mm(&turned).distance(centre) < 1e-12);
            let [from, to] = [points_mm[0] - centre, turned[0] - centre];
            assert!(
                (to.dot(axis) - from.dot(axis)).abs() < 1e-12 && (to.length() - from.length()).abs() < 1e-12
            );
            assert!((to + from).cross(axis).length() < 1e-12);
        }
    }

    #[test]
    fn alternatives_stay_sorted_and_the_least_likely_is_dropped() {
        let of = |log_likelihood| Alternative { t_sensor_object: Pose::IDENTITY, log_likelihood };
        let mut all = Alternatives::none_of(false);
        for log in [3.0, 9.0, 1.0, 5.0] {
            insert(&mut all, of(log));
        }
        let logs =
            |all: &Alternatives| all.iter().map(|one| one.log_likelihood).collect::<alloc::vec::Vec<_>>();
        assert_eq!(logs(&all), [9.0, 5.0, 3.0, 1.0]);
        (0..4).for_each(|k| insert(&mut all, of(10.0 + f64::from(k))));
        assert!(!all.is_cut());
        insert(&mut all, of(2.0));
        assert!(all.is_cut() && logs(&all) == [13.0, 12.0, 11.0, 10.0, 9.0, 5.0, 3.0, 2.0]);
    }
}
