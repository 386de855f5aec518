//! The gel surface on a regular grid, by natural-neighbour interpolation.

use super::{MarkerMesh, MarkerMeshError};
use crate::math::{DVec2, DVec3, ceil};
use crate::stop::{NEVER, Stop, Stopped, ask};
use alloc::vec::Vec;
use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, FloatTriangulation, Point2, Triangulation};

/// Largest number of grid cells.
const MAX_CELLS: f64 = (1 << 22) as f64;

/// Natural-neighbour interpolation between markers, on a grid over their rest positions (Sibson 1981).
///
/// The weight of a marker at a cell is the area share that the cell would take from that marker's Voronoi
/// region if it were a marker too. Weights are computed once, on the rest lattice; a frame is then a
/// weighted sum. A cell is therefore a spot of the gel and moves sideways with the markers around it. The
/// surface is continuous, smooth except at the markers, passes through them, and is exact for planes.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseSurface {
    mesh: MarkerMesh,
    rows: usize,
    cols: usize,
    origin_mm: DVec2,
    step_mm: f64,
    /// End of each cell's weights; cells outside the markers' convex hull have none.
    ends: Vec<u32>,
    weights: Vec<(u32, f64)>,
    normals: Vec<DVec3>,
}

/// The surface at one moment, indexed by `row * cols + col`. Everything outside the markers' convex hull
/// is 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DenseFrame {
    /// Points of the surface, sensor frame.
    pub points_mm: Vec<DVec3>,
    /// Unit normals towards the camera: the markers' normals, interpolated in the same way.
    pub normals: Vec<DVec3>,
}

/// Why there is no dense surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DenseSurfaceError {
    /// The markers have no mesh, or a marker has no normal.
    Mesh(MarkerMeshError),
    /// The step is not a positive length, exceeds the markers' bounding box, or gives more than 4 194 304
    /// cells.
    Step {
        /// The step found.
        step_mm: f64,
        /// Cells that it gives (infinite when the step is not a positive length).
        cells: f64,
    },
    /// A coordinate of the cloud is NaN or infinite.
    NotFinite {
        /// Which marker.
        marker: usize,
    },
    /// The interpolated normals of a cell cancel: the surface is folded.
    NoNormal {
        /// Which cell.
        cell: usize,
    },
    /// The caller stopped the work ([`crate::stop`]).
    Stopped,
}

impl core::fmt::Display for DenseSurfaceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Mesh(error) => error.fmt(f),
            Self::Step { step_mm, cells } => write!(
                f,
                "a step of {step_mm} mm makes {cells} cells; valid is a length above 0, at most the longer \
                 side of the markers' box, that makes at most {MAX_CELLS}"
            ),
            Self::Stopped => Stopped.fmt(f),
            Self::NotFinite { marker } => {
                write!(f, "marker {marker} has a coordinate that is NaN or infinite")
            }
            Self::NoNormal { cell } => {
                write!(f, "the normals around cell {cell} cancel; the surface is folded there")
            }
        }
    }
}

impl core::error::Error for DenseSurfaceError {}

impl DenseSurface {
    /// Distance between cells.
    #[must_use]
    pub const fn step_mm(&self) -> f64 {
        self.step_mm
    }

    /// A grid of cells `step_mm` apart over the bounding box of the rest positions. The first cell is at
    /// the box's smallest corner.
    ///
    /// # Errors
    /// [`DenseSurfaceError::Step`], or [`DenseSurfaceError::Mesh`] for markers without a mesh.
    pub fn new(rest_mm: &[DVec2], step_mm: f64) -> Result<Self, DenseSurfaceError> {
        Self::new_unless(rest_mm, step_mm, NEVER)
    }

    /// As [`Self::new`], unless it is stopped.
    ///
    /// # Errors
    /// As [`Self::new`], and [`DenseSurfaceError::Stopped`].
    pub fn new_unless(rest_mm: &[DVec2], step_mm: f64, stop: Stop<'_>) -> Result<Self, DenseSurfaceError> {
        let mesh = MarkerMesh::new(rest_mm).map_err(DenseSurfaceError::Mesh)?;
        let (low, high) = rest_mm.iter().fold((rest_mm[0], rest_mm[0]), |(l, h), &p| (l.min(p), h.max(p)));
        // Keeps the last cell of a side that is a whole number of steps up to round-off.
        let side = |length: f64| ceil(length / step_mm - 1e-9) + 1.0;
        let size = high - low;
        let (across, down) = (side(size.x), side(size.y));
        if !(step_mm > 0.0 && step_mm <= size.max_element() && across * down <= MAX_CELLS) {
            let cells = if step_mm > 0.0 { across * down } else { f64::INFINITY };
            return Err(DenseSurfaceError::Step { step_mm, cells });
        }
        let (rows, cols) = (down as usize, across as usize);
        let mut surface = Self {
            mesh,
            rows,
            cols,
            origin_mm: low,
            step_mm,
            ends: Vec::with_capacity(rows * cols),
            weights: Vec::new(),
            normals: Vec::new(),
        };
        surface.weigh(rest_mm, stop)?;
        Ok(surface)
    }

    /// Number of rows, top to bottom.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns, left to right.
    #[must_use]
    pub const fn cols(&self) -> usize {
        self.cols
    }

    /// Position of a cell on the gel at rest.
    #[must_use]
    pub fn rest_mm(&self, row: usize, col: usize) -> DVec2 {
        self.origin_mm + DVec2::new(col as f64, row as f64) * self.step_mm
    }

    /// Whether a cell lies within the markers' convex hull; only there is the surface known.
    #[must_use]
    pub fn is_known(&self, cell: usize) -> bool {
        !self.weights_of(cell).is_empty()
    }

    /// The markers around a cell with their weights, which add up to 1.
    #[must_use]
    pub fn weights_of(&self, cell: usize) -> &[(u32, f64)] {
        let start = cell.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.weights[start as usize..self.ends[cell] as usize]
    }

    /// The surface through these points, one per marker. Does not allocate once `out` has held a frame.
    ///
    /// # Errors
    /// [`DenseSurfaceError`] for a cloud that does not match the markers or has no normals; `out` is then
    /// empty.
    pub fn run(&mut self, points_mm: &[DVec3], out: &mut DenseFrame) -> Result<(), DenseSurfaceError> {
        out.points_mm.clear();
        out.normals.clear();
        if let Some(marker) = points_mm.iter().position(|p| !p.is_finite()) {
            return Err(DenseSurfaceError::NotFinite { marker });
        }
        let mut normals = core::mem::take(&mut self.normals);
        let made = self.mesh.normals(points_mm, &mut normals).map_err(DenseSurfaceError::Mesh);
        let made = made.and_then(|()| self.fill(points_mm, &normals, out));
        self.normals = normals;
        if made.is_err() {
            out.points_mm.clear();
            out.normals.clear();
        }
        made
    }

    /// Interpolates the markers' values; 0 at unknown cells. Does not allocate once `out` has held a frame.
    ///
    /// # Errors
    /// [`DenseSurfaceError::Mesh`] when the numbers of values and markers differ,
    /// [`DenseSurfaceError::NotFinite`]; `out` is then empty.
    pub fn sample(&self, values: &[f64], out: &mut Vec<f64>) -> Result<(), DenseSurfaceError> {
        out.clear();
        let (points, markers) = (values.len(), self.mesh.markers());
        if points != markers {
            return Err(DenseSurfaceError::Mesh(MarkerMeshError::LengthMismatch { points, markers }));
        }
        if let Some(marker) = values.iter().position(|v| !v.is_finite()) {
            return Err(DenseSurfaceError::NotFinite { marker });
        }
        let value = |cell| self.weights_of(cell).iter().map(|&(i, w)| values[i as usize] * w).sum::<f64>();
        out.extend((0..self.ends.len()).map(value));
        Ok(())
    }

    fn fill(
        &self,
        points_mm: &[DVec3],
        normals: &[DVec3],
        out: &mut DenseFrame,
    ) -> Result<(), DenseSurfaceError> {
        for cell in 0..self.ends.len() {
            let weights = self.weights_of(cell);
            let Some(&(first, _)) = weights.first() else {
                out.points_mm.push(DVec3::ZERO);
                out.normals.push(DVec3::ZERO);
                continue;
            };
            // Relative to one of the markers, so that a distant origin does not cost precision.
            let origin = points_mm[first as usize];
            let (mut point, mut normal) = (DVec3::ZERO, DVec3::ZERO);
            for &(marker, weight) in weights {
                point += (points_mm[marker as usize] - origin) * weight;
                normal += normals[marker as usize] * weight;
            }
            out.points_mm.push(origin + point);
            out.normals.push(normal.try_normalize().ok_or(DenseSurfaceError::NoNormal { cell })?);
        }
        Ok(())
    }

    /// Computes the weights of all cells. Rejects markers that coincide or are collinear up to round-off
    /// of a step.
    fn weigh(&mut self, rest_mm: &[DVec2], stop: Stop<'_>) -> Result<(), DenseSurfaceError> {
        // In steps from the first cell, so that distant or tiny coordinates keep their precision.
        let place = |p: DVec2| (p - self.origin_mm) / self.step_mm;
        let mut delaunay = DelaunayTriangulation::<Point2<f64>>::new();
        for (marker, &p) in rest_mm.iter().enumerate() {
            let p = place(p);
            // Snaps a marker very close to an axis onto it.
            let tiny = |x: f64| if x.abs() < 1e-40 { 0.0 } else { x };
            match delaunay.insert(Point2::new(tiny(p.x), tiny(p.y))) {
                Ok(vertex) if vertex.index() == marker => {}
                Ok(vertex) => {
                    let (first, second) = (vertex.index(), marker);
                    return Err(DenseSurfaceError::Mesh(MarkerMeshError::Duplicate { first, second }));
                }
                Err(_) => return Err(DenseSurfaceError::Mesh(MarkerMeshError::NotFinite { marker })),
            }
        }
        if delaunay.num_inner_faces() == 0 {
            let markers = rest_mm.len();
            return Err(DenseSurfaceError::Mesh(MarkerMeshError::Collinear { markers }));
        }
        let (natural, flat) = (delaunay.natural_neighbor(), delaunay.barycentric());
        let mut found = Vec::new();
        for row in 0..self.rows {
            for col in 0..self.cols {
                ask(stop, col).map_err(|Stopped| DenseSurfaceError::Stopped)?;
                let cell = DVec2::new(col as f64, row as f64);
                natural.get_weights(Point2::new(cell.x, cell.y), &mut found);
                // Within round-off of the hull, Voronoi regions are unbounded or empty. Sibson's weights
                // tend to barycentric ones there, so those are used. Weights of unbounded regions may
                // still add up to 1; then they do not reproduce the position.
                let sound = |found: &[(FixedVertexHandle, f64)]| {
                    let (mut sum, mut off, mut reach) = (0.0, DVec2::ZERO, 0.0);
                    for &(vertex, weight) in found {
                        let away = place(rest_mm[vertex.index()]) - cell;
                        (sum, off, reach) = (sum + weight, off + away * weight, away.length().max(reach));
                    }
                    (sum - 1.0).abs() < 1e-9
                        && off.length() <= 1e-9 * reach
                        && found.iter().all(|&(_, w)| (-1e-9..=1.0 + 1e-9).contains(&w))
                };
                if !found.is_empty() && !sound(&found) {
                    flat.get_weights(Point2::new(cell.x, cell.y), &mut found);
                }
                self.weights.extend(found.iter().map(|&(v, w)| (v.index() as u32, w)));
                self.ends.push(self.weights.len() as u32);
            }
        }
        Ok(())
    }
}
