//! Height of a triangle mesh at scattered points: triangles are rasterised over a grid of the points.

use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3, Pose, sqrt};
use gelstereo_core::surface::TriangleMesh;

/// Finds the mesh surface nearest to the camera at many points of the gel; keeps its buffers.
#[derive(Clone, Debug)]
pub(crate) struct MeshHeight {
    mesh: TriangleMesh,
    vertices: Vec<DVec3>,
    /// Points of cell c are `order[starts[c]..starts[c + 1]]`.
    starts: Vec<u32>,
    order: Vec<u32>,
    cells: Grid,
}

/// Cells over the points' bounding box, about as many as points, so that their number is constant.
#[derive(Clone, Copy, Debug, Default)]
struct Grid {
    low: DVec2,
    high: DVec2,
    side: usize,
}

impl Grid {
    fn over(points: &[DVec2]) -> Self {
        let (low, high) = points
            .iter()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        Self { low, high, side: sqrt(points.len() as f64) as usize + 1 }
    }

    /// Column and row of the cell; points outside belong to the cells at the border.
    fn at(&self, point: DVec2) -> (usize, usize) {
        let share = (point - self.low) / (self.high - self.low).max(DVec2::splat(f64::MIN_POSITIVE));
        // `as` clamps values below 0.
        let index = |x: f64| ((x * self.side as f64) as usize).min(self.side - 1);
        (index(share.x), index(share.y))
    }
}

impl MeshHeight {
    pub(crate) fn new(mesh: &TriangleMesh) -> Self {
        Self {
            mesh: mesh.clone(),
            vertices: Vec::new(),
            starts: Vec::new(),
            order: Vec::new(),
            cells: Grid::default(),
        }
    }

    /// Smallest z of the mesh over all of its vertices.
    pub(crate) fn nearest_z_mm(&self, t_sensor_object: &Pose) -> f64 {
        let vertices = self.mesh.vertices_mm().iter();
        vertices.fold(f64::INFINITY, |z, &v| z.min(t_sensor_object.transform_point(v).z))
    }

    /// Height of the mesh above the skin at every point; negative infinity without a triangle.
    pub(crate) fn heights_mm(
        &mut self,
        t_sensor_object: &Pose,
        (points, skin_mm): (&[DVec2], &[f64]),
        out: &mut Vec<f64>,
    ) {
        self.sort_points(points);
        self.vertices.clear();
        self.vertices.extend(self.mesh.vertices_mm().iter().map(|&v| t_sensor_object.transform_point(v)));
        out.clear();
        out.resize(points.len(), f64::NEG_INFINITY);
        for triangle in self.mesh.triangles() {
            let corners = triangle.map(|i| self.vertices[i as usize]);
            let flat = corners.map(DVec3::truncate);
            let low = flat[0].min(flat[1]).min(flat[2]);
            let high = flat[0].max(flat[1]).max(flat[2]);
            let cells = self.cells;
            let beside = high.cmplt(cells.low).any() || low.cmpgt(cells.high).any();
            if beside {
                continue;
            }
            let ((c0, r0), (c1, r1)) = (cells.at(low), cells.at(high));
            for row in r0..=r1 {
                let first = self.starts[row * cells.side + c0] as usize;
                let last = self.starts[row * cells.side + c1 + 1] as usize;
                for &i in &self.order[first..last] {
                    if let Some(z) = depth_at(&corners, points[i as usize]) {
                        let height = &mut out[i as usize];
                        *height = height.max(skin_mm[i as usize] - z);
                    }
                }
            }
        }
    }

    /// Counting sort of the points by cell, row by row.
    fn sort_points(&mut self, points: &[DVec2]) {
        self.cells = Grid::over(points);
        let cells = self.cells;
        let cell = |p: DVec2| {
            let (col, row) = cells.at(p);
            row * cells.side + col
        };
        self.starts.clear();
        self.starts.resize(cells.side * cells.side + 1, 0);
        for &p in points {
            self.starts[cell(p)] += 1;
        }
        let mut sum = 0;
        for start in &mut self.starts {
            sum += *start;
            *start = sum;
        }
        self.order.clear();
        self.order.resize(points.len(), 0);
        // Backwards, so that every count decreases to its cell's start.
        for (i, &p) in points.iter().enumerate().rev() {
            let end = &mut self.starts[cell(p)];
            *end -= 1;
            self.order[*end as usize] = i as u32;
        }
    }
}

/// Depth of a triangle at a point seen along z, or `None` beside it. Borders are included, so no point
/// falls between two triangles that share an edge. Triangles seen edge-on have no depth (their
/// neighbours do).
fn depth_at(corners: &[DVec3; 3], point: DVec2) -> Option<f64> {
    let [a, b, c] = corners.map(|v| v.truncate() - point);
    let (u, v, w) = (b.perp_dot(c), c.perp_dot(a), a.perp_dot(b));
    let area = u + v + w;
    let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
    (inside && area != 0.0).then(|| (u * corners[0].z + v * corners[1].z + w * corners[2].z) / area)
}
