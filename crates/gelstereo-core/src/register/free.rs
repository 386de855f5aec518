//! Readable names for the free directions of a contact.

use super::observe::{Observability, Vector6, add_outer, dot, halves, stack};
use super::symmetry::Symmetry;
use crate::math::linalg::{self, Symmetric};
use crate::math::{DVec3, sqrt};

/// A direction of motion that the contact does not determine, in the object's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FreeDirection {
    /// Rotation part of the twist about [`Self::centre_mm`]: of length 1 (rad), or zero for a pure
    /// translation.
    pub omega: DVec3,
    /// Translation part: mm per radian, or of length 1 for a pure translation.
    pub v: DVec3,
    /// Centre of rotation (object frame): the patch's centroid.
    pub centre_mm: DVec3,
    /// Whether it is a rotation about an axis of continuous symmetry of the part, which no contact
    /// determines.
    pub is_own: bool,
}

/// A free direction in readable form, in the object's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// Translation along a unit vector.
    Slide {
        /// Unit vector.
        along: DVec3,
    },
    /// Rotation about an axis through a point, with an advance along it (0 for a pure spin).
    Screw {
        /// Unit vector.
        about: DVec3,
        /// The axis's point nearest to the object's origin.
        through_mm: DVec3,
        /// Advance along the axis.
        pitch_mm_per_rad: f64,
    },
}

impl FreeDirection {
    const NONE: Self = Self { omega: DVec3::ZERO, v: DVec3::ZERO, centre_mm: DVec3::ZERO, is_own: false };

    /// Classifies it as a slide, spin or screw, with its axis.
    #[must_use]
    pub fn motion(&self) -> Motion {
        if self.omega == DVec3::ZERO {
            return Motion::Slide { along: self.v };
        }
        Motion::Screw {
            about: self.omega,
            through_mm: (self.centre_mm + self.omega.cross(self.v)).reject_from_normalized(self.omega),
            pitch_mm_per_rad: self.omega.dot(self.v),
        }
    }
}

impl core::fmt::Display for FreeDirection {
    /// For example `slide along z`, `spin about (0.71, 0.71, 0.00) through (0.0, 0.0, 4.0) mm` or `spin
    /// about z, the part's own axis`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.motion() {
            Motion::Slide { along } => {
                write!(f, "slide along ")?;
                write_axis(f, along)
            }
            Motion::Screw { about, through_mm: p, pitch_mm_per_rad: pitch } => {
                // A pitch that prints as zero counts as none.
                let screws = pitch.abs() >= 0.005;
                write!(f, "{} about ", if screws { "screw" } else { "spin" })?;
                write_axis(f, about)?;
                if self.is_own {
                    return write!(f, ", the part's own axis");
                }
                // Adding zero turns -0.0 into 0.0.
                let tenths = (p * 10.0).round() / 10.0 + DVec3::ZERO;
                write!(f, " through ({:.1}, {:.1}, {:.1}) mm", tenths.x, tenths.y, tenths.z)?;
                if screws { write!(f, ", {pitch:.2} mm/rad") } else { Ok(()) }
            }
        }
    }
}

/// `x`, `y` or `z` when the vector prints as that axis to two digits, otherwise its components.
fn write_axis(f: &mut core::fmt::Formatter<'_>, axis: DVec3) -> core::fmt::Result {
    let rounded = (axis * 100.0).round() / 100.0 + DVec3::ZERO;
    for (name, unit) in [("x", DVec3::X), ("y", DVec3::Y), ("z", DVec3::Z)] {
        if rounded.abs() == unit {
            return write!(f, "{name}");
        }
    }
    write!(f, "({:.2}, {:.2}, {:.2})", rounded.x, rounded.y, rounded.z)
}

/// Up to six free directions, without allocation. Dereferences to, and prints as, a slice.
#[derive(Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FreeDirections {
    directions: [FreeDirection; 6],
    count: usize,
}

impl FreeDirections {
    /// No free directions: all six are determined.
    pub const NONE: Self = Self { directions: [FreeDirection::NONE; 6], count: 0 };

    /// The free directions of a patch with position resolution `resolution_mm`, all in the object's frame.
    ///
    /// Any basis of the free space is valid. This one has pure translations first, then rotations, each
    /// as close as possible to the object's axes. A translation counts as pure if, over one patch radius,
    /// its rotation part moves the points by less than the resolution. A rotation counts as a pure spin
    /// if its advance per radian is less than that. Rotations about continuous `symmetries` come before
    /// other rotations.
    #[must_use]
    pub(super) fn new(seen: &Observability, resolution_mm: f64, symmetries: &[Symmetry]) -> Self {
        let mut space = Subspace::free(seen);
        let mut out = Self::NONE;
        let limit = (resolution_mm / seen.radius_mm).min(0.5);
        let slides = space.pure_translations(1.0 - limit * limit);
        for &v in slides.iter() {
            out.push(FreeDirection { v, centre_mm: seen.centre_mm, ..FreeDirection::NONE });
        }
        space.remove_translations(&slides);
        for symmetry in symmetries.iter().filter(|s| s.order.is_none()) {
            let v = symmetry.axis.cross(seen.centre_mm - symmetry.centre_mm);
            if space.take(symmetry.axis, slides.without(v), seen.radius_mm, 1.0 - limit * limit) {
                let own = FreeDirection { omega: symmetry.axis, v, centre_mm: seen.centre_mm, is_own: true };
                out.push(own);
            }
        }
        for (omega, v) in space.rotations(seen.radius_mm, seen.free_count() - out.count).iter().flatten() {
            let advance = omega.dot(*v);
            let v = if advance.abs() <= resolution_mm { *v - *omega * advance } else { *v };
            out.push(FreeDirection { omega: *omega, v, centre_mm: seen.centre_mm, is_own: false });
        }
        out
    }

    fn push(&mut self, direction: FreeDirection) {
        if let Some(place) = self.directions.get_mut(self.count) {
            *place = direction;
            self.count += 1;
        }
    }
}

impl core::ops::Deref for FreeDirections {
    type Target = [FreeDirection];

    fn deref(&self) -> &[FreeDirection] {
        &self.directions[..self.count]
    }
}

impl core::fmt::Debug for FreeDirections {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

/// A basis of at most three vectors.
struct Axes {
    axes: [DVec3; 3],
    count: usize,
}

impl Axes {
    fn iter(&self) -> core::slice::Iter<'_, DVec3> {
        self.axes[..self.count].iter()
    }

    /// The component of a vector orthogonal to all of them.
    fn without(&self, v: DVec3) -> DVec3 {
        self.iter().fold(v, |v, axis| v - *axis * v.dot(*axis))
    }
}

/// The free space as an orthogonal projection P in the scaled coordinates (ρ ω, v).
struct Subspace {
    projection: Symmetric<6>,
}

impl Subspace {
    fn free(seen: &Observability) -> Self {
        let mut space = Self { projection: [[0.0; 6]; 6] };
        for (u, _) in seen.directions.iter().zip(seen.values).filter(|(_, value)| *value == 0.0) {
            add_outer(&mut space.projection, u, 1.0);
        }
        space
    }

    /// A 3x3 block: (0, 0) rotations, (3, 3) translations.
    fn block(&self, row: usize, col: usize) -> Symmetric<3> {
        core::array::from_fn(|i| core::array::from_fn(|j| self.projection[row + i][col + j]))
    }

    /// Translations of which at least the share `min_share` lies in the space.
    fn pure_translations(&self, min_share: f64) -> Axes {
        let eigen = linalg::eigen(&self.block(3, 3));
        let count = eigen.values.iter().filter(|&&share| share >= min_share).count();
        along_axes(&eigen.vectors, count)
    }

    fn remove_translations(&mut self, slides: &Axes) {
        for v in slides.iter() {
            add_outer(&mut self.projection, &stack(DVec3::ZERO, *v), -1.0);
        }
    }

    /// Removes the twist (ω, v) from the space if at least the share `min_share` of it lies in there.
    fn take(&mut self, omega: DVec3, v: DVec3, radius_mm: f64, min_share: f64) -> bool {
        let z = stack(omega * radius_mm, v);
        let mut inside: Vector6 = core::array::from_fn(|row| dot(&self.projection[row], &z));
        let squared = dot(&inside, &inside);
        let is_inside = squared >= min_share * dot(&z, &z);
        if is_inside {
            inside.iter_mut().for_each(|x| *x /= sqrt(squared));
            add_outer(&mut self.projection, &inside, -1.0);
        }
        is_inside
    }

    /// For each of `count` rotation axes q in the space, its twist (q, v): u = P[.., ω] W⁺ q, W the
    /// rotation block.
    fn rotations(&self, radius_mm: f64, count: usize) -> [Option<(DVec3, DVec3)>; 3] {
        let eigen = linalg::eigen(&self.block(0, 0));
        let count = count.min(eigen.values.iter().filter(|&&share| share > 0.0).count());
        let axes = along_axes(&eigen.vectors, count);
        core::array::from_fn(|k| {
            let q = *axes.axes[..axes.count].get(k)?;
            let mut solved = DVec3::ZERO;
            for i in 3 - count..3 {
                let w = DVec3::from_array(eigen.vectors[i]);
                solved += w * (w.dot(q) / eigen.values[i]);
            }
            let u: Vector6 = core::array::from_fn(|row| {
                let p = &self.projection[row];
                DVec3::new(p[0], p[1], p[2]).dot(solved)
            });
            Some((q, halves(&u).1 * radius_mm))
        })
    }
}

/// An orthonormal basis of the span of the last `count` vectors. Each basis vector is the projection of
/// the coordinate axis with the largest remaining component.
fn along_axes(vectors: &[[f64; 3]; 3], count: usize) -> Axes {
    let mut span = [DVec3::ZERO; 3];
    for v in vectors.iter().skip(3 - count).map(|&v| DVec3::from_array(v)) {
        for (axis, column) in span.iter_mut().enumerate() {
            *column += v * v[axis];
        }
    }
    let mut axes = Axes { axes: [DVec3::ZERO; 3], count };
    for k in 0..count {
        let share = |axis: usize| span[axis][axis];
        // Equal shares, as for a ball, are not decided by rounding.
        let axis = (1..3).fold(0, |best, axis| if share(axis) > share(best) + 1e-9 { axis } else { best });
        let unit = span[axis] / sqrt(span[axis].length_squared());
        axes.axes[k] = unit;
        for (axis, column) in span.iter_mut().enumerate() {
            *column -= unit * unit[axis];
        }
    }
    axes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn debug_shows_the_directions_there_are() {
        let mut directions = FreeDirections::NONE;
        assert_eq!(alloc::format!("{directions:?}"), "[]");
        directions.push(FreeDirection { v: DVec3::X, ..FreeDirection::NONE });
        let shown = alloc::format!("{directions:?}");
        assert_eq!(shown.matches("FreeDirection {").count(), 1, "{shown}");
    }
}
