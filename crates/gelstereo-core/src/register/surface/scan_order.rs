//! Canonical order of the markers, by position and not by input order.
//!
//! Sums run over markers, and a first pass selects some of them. Sorting by position, band by band across
//! the press, makes the result independent of the input order, to the bit.

use super::contact::Contact;
use crate::math::linalg::Symmetric;
use crate::math::{DVec3, floor};
use alloc::vec::Vec;

/// Buffers of an ordered contact.
#[derive(Clone, Debug, Default)]
pub(super) struct Raster {
    keys: Vec<Key>,
    points_mm: Vec<DVec3>,
    covariance_mm2: Vec<Symmetric<3>>,
    unpressed_mm: Vec<DVec3>,
}

/// Position of a marker: its band, an integer that increases along the band, and its index.
type Key = (u32, u64, u32);

impl Raster {
    /// The same contact with its markers in canonical order. Any width of a band gives one; with the pitch,
    /// each row of markers has its own band.
    pub fn ordered<'a>(&'a mut self, contact: &Contact<'a>, pitch_mm: f64) -> Contact<'a> {
        let Self { keys, points_mm, covariance_mm2, unpressed_mm } = self;
        let press = contact.press_direction;
        let (along, _) = press.any_orthonormal_pair();
        let across = along.cross(press);
        let low_mm = contact
            .points_mm
            .iter()
            .chain(contact.unpressed_mm)
            .fold(f64::INFINITY, |low, p| low.min(p.dot(across)));
        let frame = Frame { along, across, press, low_mm, band_mm: pitch_mm };
        unpressed_mm.clear();
        unpressed_mm.extend(order(keys, contact.unpressed_mm, frame).map(|k| contact.unpressed_mm[k]));
        points_mm.clear();
        covariance_mm2.clear();
        for k in order(keys, contact.points_mm, frame) {
            points_mm.push(contact.points_mm[k]);
            covariance_mm2.extend(contact.covariance_mm2.map(|all| all[k]));
        }
        Contact {
            points_mm,
            covariance_mm2: contact.covariance_mm2.map(|_| covariance_mm2.as_slice()),
            unpressed_mm,
            ..*contact
        }
    }
}

/// Axes of the plane across the press, and the start of the first band.
#[derive(Clone, Copy)]
struct Frame {
    along: DVec3,
    across: DVec3,
    press: DVec3,
    low_mm: f64,
    band_mm: f64,
}

/// Indices of the points in canonical order.
fn order<'a>(
    keys: &'a mut Vec<Key>,
    points_mm: &[DVec3],
    frame: Frame,
) -> impl Iterator<Item = usize> + use<'a> {
    keys.clear();
    keys.extend(points_mm.iter().zip(0..).map(|(p, k)| {
        let band = floor((p.dot(frame.across) - frame.low_mm) / frame.band_mm + 0.5) as u32;
        (band, ascending(p.dot(frame.along)), k)
    }));
    // Then across the band, and along the press; at the same position, by input order.
    let rest = |k: u32| [frame.across, frame.press].map(|axis| ascending(points_mm[k as usize].dot(axis)));
    keys.sort_unstable_by(|a, b| {
        (a.0, a.1).cmp(&(b.0, b.1)).then_with(|| rest(a.2).cmp(&rest(b.2))).then(a.2.cmp(&b.2))
    });
    keys.iter().map(|(_, _, k)| *k as usize)
}

/// Integer in the total order of real numbers.
fn ascending(x: f64) -> u64 {
    let bits = x.to_bits();
    if bits >> 63 == 0 { bits | 1 << 63 } else { !bits }
}
