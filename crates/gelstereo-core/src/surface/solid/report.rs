//! Validity of a mesh as the boundary of a body, and errors.

use crate::stop::Stopped;

/// Largest number of triangles.
pub const MAX_TRIANGLES: usize = 4_000_000;

/// Coordinates beyond this, a million kilometres, are treated as errors.
pub const REACH_MM: f64 = 1e12;

/// Validity of a mesh as the boundary of a body. None of these defects makes distances inexact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SolidReport {
    /// Triangles given.
    pub triangles: usize,
    /// Triangles whose area is below the rounding of their coordinates; distances ignore them.
    pub degenerate: usize,
    /// Triangles that repeat an earlier one with the same orientation; distances ignore them.
    pub duplicates: usize,
    /// Edges with a triangle on one side only: the rims of holes.
    pub boundary_edges: usize,
    /// Edges whose triangles have inconsistent orientation, so that one of two is inside out.
    pub clashing_edges: usize,
    /// Edges shared by more than two triangles: touching bodies, or an internal wall.
    pub crowded_edges: usize,
    /// Signed volume, mm³ (divergence theorem): negative when faces are inside out, meaningless with holes.
    pub volume_mm3: f64,
}

impl SolidReport {
    /// Whether the surface separates inside from outside: no holes and consistent orientation.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        self.boundary_edges == 0 && self.clashing_edges == 0
    }

    /// Whether a closed surface has its inside and outside swapped.
    #[must_use]
    pub fn is_inside_out(&self) -> bool {
        self.is_closed() && self.volume_mm3 < 0.0
    }
}

/// Why a mesh has no distance field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SolidError {
    /// No triangle has an area beyond the rounding of its coordinates.
    Empty,
    /// A vertex lies beyond 1e12 mm.
    TooFar {
        /// Which vertex.
        vertex: usize,
    },
    /// More than four million triangles.
    TooMany {
        /// Triangles found.
        found: usize,
    },
    /// The caller stopped the work ([`crate::stop`]).
    Stopped,
}

impl core::fmt::Display for SolidError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Empty => write!(
                f,
                "no triangle has an area beyond the rounding of its coordinates; move the part to the \
                 origin, or write it with more digits"
            ),
            Self::TooFar { vertex } => write!(
                f,
                "vertex {vertex} has a coordinate beyond {:e} mm; move the part to the origin",
                REACH_MM
            ),
            Self::TooMany { found } => {
                write!(f, "the mesh has {found} triangles; at most {} are held: simplify it", MAX_TRIANGLES)
            }
            Self::Stopped => Stopped.fmt(f),
        }
    }
}

impl core::error::Error for SolidError {}

impl From<Stopped> for SolidError {
    fn from(Stopped: Stopped) -> Self {
        Self::Stopped
    }
}
