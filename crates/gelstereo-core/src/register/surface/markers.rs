//! Selection of the unpressed markers of a frame.

use crate::math::DVec3;
use crate::params::RegisterMethod;
use crate::register::RegisterError;
use alloc::vec::Vec;
use core::cmp::Ordering;

/// The markers that are not among the salient ones, for [`Contact::unpressed_mm`]. Positions are compared
/// bit for bit.
///
/// [`Contact::unpressed_mm`]: super::Contact::unpressed_mm
#[must_use]
pub fn unpressed(all_mm: &[DVec3], salient_mm: &[DVec3]) -> Vec<DVec3> {
    let mut salient = salient_mm.to_vec();
    salient.sort_unstable_by(order);
    // Most markers are outside the bounds. NaN does not affect them, and is never outside.
    let bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = salient.iter().fold(bounds, |(low, high), p| (p.min(low), p.max(high)));
    let is_beside = |p: &DVec3| p.cmplt(low).any() || p.cmpgt(high).any();
    let is_salient = |p: &DVec3| !is_beside(p) && salient.binary_search_by(|s| order(s, p)).is_ok();
    let mut unpressed = Vec::with_capacity(all_mm.len());
    unpressed.extend(all_mm.iter().filter(|p| !is_salient(p)));
    unpressed
}

/// As [`unpressed`], for one method: none if the method does not use them.
#[must_use]
pub fn unpressed_for(method: RegisterMethod, all_mm: &[DVec3], salient_mm: &[DVec3]) -> Vec<DVec3> {
    match method {
        RegisterMethod::SurfaceClose | RegisterMethod::SurfaceSearch => unpressed(all_mm, salient_mm),
        RegisterMethod::FilterregPoint | RegisterMethod::RansacIcp => Vec::new(),
    }
}

/// Refuses salient points that are not among all markers, bit for bit. [`unpressed`] would treat their
/// markers as both pressed and unpressed.
///
/// # Errors
/// [`RegisterError::NotAmong`].
pub fn check_among(all_mm: &[DVec3], salient_mm: &[DVec3]) -> Result<(), RegisterError> {
    // They usually come in the order of the markers.
    let mut rest = all_mm.iter();
    if salient_mm.iter().all(|s| rest.any(|p| order(p, s).is_eq())) {
        return Ok(());
    }
    let mut all = all_mm.to_vec();
    all.sort_unstable_by(order);
    let is_missing = |s: &DVec3| all.binary_search_by(|p| order(p, s)).is_err();
    let Some(index) = salient_mm.iter().position(is_missing) else { return Ok(()) };
    let missing = salient_mm.iter().filter(|s| is_missing(s)).count();
    Err(RegisterError::NotAmong { missing, points: salient_mm.len(), index, all: all_mm.len() })
}

fn order(a: &DVec3, b: &DVec3) -> Ordering {
    a.x.total_cmp(&b.x).then_with(|| a.y.total_cmp(&b.y)).then_with(|| a.z.total_cmp(&b.z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;

    #[test]
    fn unpressed_are_the_markers_at_no_salient_place_bit_for_bit() {
        let mut random = Stream::new(1, "unpressed");
        let mut place = || DVec3::new(random.uniform(), random.uniform(), random.uniform());
        let mut all: Vec<DVec3> = (0..200).map(|_| place() * 9.0).collect();
        all.extend([all[3], DVec3::new(0.0, 4.0, 4.0), DVec3::new(-0.0, 4.0, 4.0), DVec3::NAN]);
        all.push(DVec3::new(5.0, f64::NAN, 5.0));
        let mut salient: Vec<DVec3> = all.iter().copied().filter(|p| p.x > 3.0 && p.y < 7.0).collect();
        salient.extend([all[3], DVec3::new(-0.0, 4.0, 4.0), DVec3::NAN, DVec3::new(5.0, f64::NAN, 5.0)]);
        let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
        let slow = all.iter().filter(|p| salient.iter().all(|s| bits(s) != bits(p)));
        let found = unpressed(&all, &salient);
        assert!(found.iter().map(bits).eq(slow.map(bits)));
        assert!(found.len() > 50 && found.iter().all(|p| !p.is_nan()));
    }

    #[test]
    fn a_method_is_given_the_markers_that_it_looks_at() {
        use RegisterMethod::{FilterregPoint, RansacIcp, SurfaceClose, SurfaceSearch};
        let mut all: Vec<DVec3> = (0..20).map(|k| DVec3::new(f64::from(k), 1.0, 2.0)).collect();
        for lost in [1.0, f64::NAN, f64::INFINITY, -1e30] {
            all[12].y = lost;
            let methods = [FilterregPoint, RansacIcp, SurfaceClose, SurfaceSearch];
            let counts = methods.map(|method| unpressed_for(method, &all, &all[3..9]).len());
            assert_eq!(counts, [0, 0, 14, 14]);
        }
    }

    #[test]
    fn salient_points_that_are_no_markers_are_told_of() {
        let all: Vec<DVec3> = (0..20).map(|k| DVec3::new(f64::from(k), 1.0, 2.0)).collect();
        assert_eq!(check_among(&all, &all[3..9]), Ok(()));
        let mut salient = [all[7], all[2], all[7]];
        assert_eq!(check_among(&all, &salient), Ok(()));
        assert_eq!(check_among(&all, &[]), Ok(()));
        // As after conversion from single precision.
        salient[1].y += 1e-7;
        let told = |missing, index| Err(RegisterError::NotAmong { missing, points: 3, index, all: 20 });
        assert_eq!(check_among(&all, &salient), told(1, 1));
        salient[2].z = f64::NAN;
        assert_eq!(check_among(&all, &salient), told(2, 1));
        let none = RegisterError::NotAmong { missing: 3, points: 3, index: 0, all: 0 };
        assert_eq!(check_among(&[], &salient), Err(none));
    }
}
