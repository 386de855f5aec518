//! Orients triangles consistently and outward.

use super::weld::{Kind, NONE, Use, Welded};
use crate::math::sqrt;
use crate::stop::{NEVER, Stop, Stopped, ask};
use crate::surface::{TriangleMesh, area_vector};
use alloc::vec::Vec;

/// What was reoriented.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Turned {
    /// Triangles oriented against the majority of their connected shell.
    pub stray: usize,
    /// Whether the whole surface was inside out.
    pub inside_out: bool,
}

impl TriangleMesh {
    /// Reorients triangles that disagree with the larger area of their connected shell, then all of them
    /// if they bound a negative volume.
    ///
    /// Shells are connected across edges of exactly two triangles. A surface with holes has no inside, so
    /// only its majority decides.
    #[must_use]
    pub fn turned_outward(&self) -> (Self, Turned) {
        self.turned_outward_unless(NEVER).unwrap_or_default()
    }

    /// As [`Self::turned_outward`], unless it is stopped.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn turned_outward_unless(&self, stop: Stop<'_>) -> Result<(Self, Turned), Stopped> {
        let welded = Welded::new(self, stop)?;
        let mut turned = strays(&welded, stop)?;
        let stray = turned.iter().filter(|&&t| t).count();
        let mut mesh = self.turned(&turned);
        let report = Welded::new(&mesh, stop)?.report();
        if report.is_inside_out() {
            turned.iter_mut().for_each(|t| *t = !*t);
            mesh = self.turned(&turned);
        }
        Ok((mesh, Turned { stray, inside_out: report.is_inside_out() }))
    }

    fn turned(&self, which: &[bool]) -> Self {
        let turn = |(&[a, b, c], &turned): (&[u32; 3], &bool)| if turned { [a, c, b] } else { [a, b, c] };
        let triangles = self.triangles.iter().zip(which).map(turn).collect();
        Self { vertices_mm: self.vertices_mm.clone(), triangles }
    }
}

/// Flags triangles oriented against the majority of their shell.
fn strays(welded: &Welded, stop: Stop<'_>) -> Result<Vec<bool>, Stopped> {
    let mut turned = alloc::vec![false; welded.corners.len()];
    let mut seen = turned.clone();
    let mut shell = Vec::new();
    for first in 0..welded.corners.len() {
        ask(stop, first)?;
        if seen[first] || welded.kinds[first] == Kind::Left {
            continue;
        }
        seen[first] = true;
        shell.clear();
        shell.push(first);
        let mut next = 0;
        while let Some(&triangle) = shell.get(next) {
            next += 1;
            ask(stop, next)?;
            for &edge in welded.edges_of[triangle].iter().filter(|&&edge| edge != NONE) {
                let Some((other, same_way)) = neighbour(welded.uses(edge as usize), triangle) else {
                    continue;
                };
                if !seen[other] {
                    seen[other] = true;
                    turned[other] = turned[triangle] ^ same_way;
                    shell.push(other);
                }
            }
        }
        let area = |&t: &usize| sqrt(area_vector(&welded.places(t)).length_squared());
        let whole: f64 = shell.iter().map(area).sum();
        let against: f64 = shell.iter().filter(|&&t| turned[t]).map(area).sum();
        if against > 0.5 * whole {
            shell.iter().for_each(|&t| turned[t] = !turned[t]);
        }
    }
    Ok(turned)
}

/// The other triangle of a two-triangle edge, and whether both traverse it in the same direction (an error).
fn neighbour(uses: &[Use], triangle: usize) -> Option<(usize, bool)> {
    let [a, b] = uses else { return None };
    let other = if a.triangle as usize == triangle { b } else { a };
    Some((other.triangle as usize, a.forward == b.forward))
}
