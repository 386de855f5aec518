//! Prismatic parts that fit the simulated hole: cylinders and boxes, inserted along z.

use gelstereo_core::math::{DVec3, cos, sin};
use gelstereo_sim::Shape;

/// Generator lines that represent a round flank; their error is 0.0003 mm at a radius of 4 mm.
const LINES: u32 = 256;

/// Outline of a part across the insertion direction, about its origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Section {
    /// A disc.
    Round {
        /// Radius.
        radius_mm: f64,
    },
    /// A rectangle with its edges along the part's x and y.
    Rectangle {
        /// Half the edges.
        half_mm: [f64; 2],
    },
}

/// A prismatic part; its tip is at +`axis` in its own frame, whose origin is its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peg {
    /// Outline of the part.
    pub section: Section,
    /// Half its length.
    pub half_length_mm: f64,
    /// Unit direction towards the tip, along z.
    pub axis: DVec3,
}

impl Peg {
    /// Peg for a shape, with its tip towards `axis`; `None` for other shapes and directions.
    #[must_use]
    pub fn of(shape: &Shape, axis: DVec3) -> Option<Self> {
        let (section, length_mm) = match *shape {
            Shape::Cylinder { radius_mm, length_mm } => (Section::Round { radius_mm }, length_mm),
            Shape::Box { size_mm: [x, y, z] } => (Section::Rectangle { half_mm: [0.5 * x, 0.5 * y] }, z),
            _ => return None,
        };
        let along_z = axis.z.abs() > 1.0 - 1e-9;
        along_z.then_some(Self { section, half_length_mm: 0.5 * length_mm, axis })
    }

    /// Whether it is symmetric under any spin about its axis.
    #[must_use]
    pub const fn is_round(&self) -> bool {
        matches!(self.section, Section::Round { .. })
    }

    /// Half width of the section along a unit direction of the part's frame that is orthogonal to the axis.
    #[must_use]
    pub fn half_width_mm(&self, direction: DVec3) -> f64 {
        match self.section {
            Section::Round { radius_mm } => radius_mm,
            Section::Rectangle { half_mm: [x, y] } => x * direction.x.abs() + y * direction.y.abs(),
        }
    }

    /// Corners of the tip, part frame; a round tip is approximated by many.
    #[must_use]
    pub fn tip_corners_mm(&self) -> Vec<DVec3> {
        let tip_mm = self.axis * self.half_length_mm;
        match self.section {
            Section::Round { radius_mm } => (0..LINES)
                .map(|k| {
                    let angle = core::f64::consts::TAU * f64::from(k) / f64::from(LINES);
                    tip_mm + DVec3::new(cos(angle), sin(angle), 0.0) * radius_mm
                })
                .collect(),
            Section::Rectangle { half_mm: [x, y] } => {
                [[x, y], [-x, y], [-x, -y], [x, -y]].map(|[x, y]| tip_mm + DVec3::new(x, y, 0.0)).to_vec()
            }
        }
    }
}
