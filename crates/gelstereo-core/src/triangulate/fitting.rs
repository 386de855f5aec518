//! The fit of a [`Map`], in steps: a frame that executes one takes little longer than others.

use super::chebyshev::{Series, checks, extremes, nodes};
use super::polynomial::{CHECKS, Inputs, Map, Sample, Space, extent, inputs_px};
use super::tiles::{Four, Tiles, distance};
use crate::math::{DMat3, DVec3};
use crate::rig::RigView;
use alloc::vec::Vec;

/// Nodes along each input at which rays are traced.
const NODES: usize = 8;
/// Degrees of the polynomials through the nodes. Five suffices for values without lens distortion; a
/// strong one needs seven.
const DEGREE: usize = 7;
const SLOPE_DEGREE: usize = 4;
/// Numbers of tiles along column and row that are tried.
const SIDES: [usize; 4] = [1, 2, 4, 8];
/// Largest error at the checked points; twice this is guaranteed.
const TOLERANCE_MM: f64 = 5e-4;
/// Directions in which a surface's outermost points are taken.
const DIRECTIONS: usize = 26;
/// Most steps of Newton's method to a node.
const MAX_STEPS: usize = 20;

/// A fit in progress. All its memory is allocated at the start.
#[derive(Clone, Debug)]
pub(super) struct Fitting {
    next: Step,
    space: Space,
    start_mm: DVec3,
    at_nodes: Vec<Sample>,
    checked: Vec<Sample>,
    values: Series<4>,
    slopes: Series<12>,
    /// Error of the polynomials at the checked points.
    error_mm: f64,
    tiles: Tiles,
}

#[derive(Clone, Copy, Debug)]
enum Step {
    /// Rays to the nodes of the observed space.
    Nodes,
    /// Rays to the points where the map is checked.
    Checks,
    Polynomials,
    /// The entries of `SIDES` in turn.
    Tiles(usize),
}

/// Result of a step.
pub(super) enum Progress {
    More,
    /// `None` when no polynomials are accurate enough.
    Done(Option<Map>),
}

impl Fitting {
    /// The first step: the range of inputs, from the points of a rest surface. `None` when they are not
    /// visible.
    pub fn begin(views: &[RigView<'_>; 2], rest_mm: &[DVec3], reach_mm: f64) -> Option<Self> {
        let seen = reached(views, rest_mm, reach_mm)?;
        let inputs = Inputs::fit(views, &seen)?;
        let (low, high) = extent(seen.iter().map(|&at| inputs.of(at)));
        let (centre, half) = ((low + high) * 0.5, (high - low) * 0.5);
        if !(centre.is_finite() && half.min_element() > 0.0) {
            return None;
        }
        Some(Self {
            next: Step::Nodes,
            space: Space { inputs, centre, scale: half.recip() },
            start_mm: crate::math::centroid(rest_mm),
            at_nodes: Vec::with_capacity(NODES * NODES * NODES),
            checked: Vec::with_capacity(CHECKS * CHECKS * CHECKS),
            values: Series::zero(),
            slopes: Series::zero(),
            error_mm: 0.0,
            tiles: Tiles::with_room(SIDES[SIDES.len() - 1]),
        })
    }

    /// Executes the next step; no allocation.
    pub fn step(&mut self, views: &[RigView<'_>; 2]) -> Progress {
        let Self { next, space, start_mm, at_nodes, checked, tiles, .. } = self;
        match *next {
            Step::Nodes => {
                *next = Step::Checks;
                let grid = nodes::<NODES>().map(|at| space.undo(at));
                if sample(views, *start_mm, &space.inputs, grid, at_nodes) {
                    return Progress::More;
                }
            }
            Step::Checks => {
                *next = Step::Polynomials;
                let grid = checks::<CHECKS>().map(|at| space.undo(at));
                if sample(views, *start_mm, &space.inputs, grid, checked) {
                    return Progress::More;
                }
            }
            Step::Polynomials => {
                *next = Step::Tiles(0);
                self.fit_polynomials();
                return Progress::More;
            }
            Step::Tiles(tried) => {
                *next = Step::Tiles(tried + 1);
                let tolerance_mm = TOLERANCE_MM - self.error_mm;
                let Some(&side) = SIDES.get(tried) else { return Progress::Done(None) };
                let fitted_mm = tiles.fit(side, &self.values, &self.slopes, tolerance_mm);
                let map = fitted_mm.and_then(|mm| Map::of(space, tiles, self.error_mm + mm, checked));
                return map.map_or(Progress::More, |map| Progress::Done(Some(map)));
            }
        }
        Progress::Done(None)
    }

    fn fit_polynomials(&mut self) {
        let nodes = self.at_nodes.iter();
        self.values = Series::fit::<NODES, _>(DEGREE, nodes.clone().map(|sample| &sample.value));
        self.slopes = Series::fit::<NODES, _>(SLOPE_DEGREE, nodes.map(|sample| &sample.slope));
        let (mut exact, mut error_mm) = (self.checked.iter(), 0.0_f64);
        self.values.on_grid(&[extremes::<CHECKS>(); 3], |value: Four| {
            if let Some(sample) = exact.next() {
                error_mm = error_mm.max(distance(&value, &sample.value));
            }
        });
        self.error_mm = error_mm;
    }
}

/// (Column, mean row, disparity) of points within reach of the rest surface: sideways, towards the
/// cameras, and a quarter of it away from them. The outermost points of a surface suffice: outside the
/// map, points are computed exactly.
fn reached(views: &[RigView<'_>; 2], rest_mm: &[DVec3], reach_mm: f64) -> Option<Vec<DVec3>> {
    let mut all = Vec::with_capacity(8 * DIRECTIONS);
    for rest in directions().filter_map(|direction| outermost(rest_mm, direction)) {
        for along in [-1.0, 0.25] {
            for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
                let point_mm = rest + DVec3::new(x, y, along) * reach_mm;
                let [l, r] = [views[0].project(point_mm).ok()?, views[1].project(point_mm).ok()?];
                all.push(inputs_px(l, r));
            }
        }
    }
    Some(all)
}

/// Directions to the corners of a cube and the midpoints of its edges and sides.
fn directions() -> impl Iterator<Item = DVec3> {
    let axis = |n: usize| [0.0, 1.0, -1.0][n % 3];
    (1..=DIRECTIONS).map(move |n| DVec3::new(axis(n), axis(n / 3), axis(n / 9)))
}

fn outermost(points: &[DVec3], direction: DVec3) -> Option<DVec3> {
    let first = *points.first()?;
    let farther = |(most, best), &at: &DVec3| {
        let along = at.dot(direction);
        if along > most { (along, at) } else { (most, best) }
    };
    Some(points.iter().fold((first.dot(direction), first), farther).1)
}

/// Column, mean row and disparity at a point, and the row difference, with their derivatives by the
/// point.
struct Seen {
    at: DVec3,
    jacobian: DMat3,
    rows_px: f64,
    rows_gradient: DVec3,
}

fn see(views: &[RigView<'_>; 2], point_mm: DVec3) -> Option<Seen> {
    let left = views[0].project_with_jacobian(point_mm, 0.0).ok()?;
    let right = views[1].project_with_jacobian(point_mm, 0.0).ok()?;
    let (l, r) = (left.pixel_px, right.pixel_px);
    let ([u, v], [u_right, v_right]) = (left.jacobian, right.jacobian);
    Some(Seen {
        at: inputs_px(l, r),
        jacobian: DMat3::from_cols(u, (v + v_right) * 0.5, u - u_right).transpose(),
        rows_px: l.y - r.y,
        rows_gradient: v - v_right,
    })
}

/// Adds exact values at these inputs, by Newton's method on [`see`], each started from the one before;
/// returns whether all exist.
fn sample(
    views: &[RigView<'_>; 2],
    start: DVec3,
    inputs: &Inputs,
    grid: impl Iterator<Item = DVec3>,
    out: &mut Vec<Sample>,
) -> bool {
    let mut point = start;
    for input in grid {
        let Some(sample) = sample_at(views, &mut point, inputs, input) else { return false };
        out.push(sample);
    }
    true
}

fn sample_at(views: &[RigView<'_>; 2], point: &mut DVec3, inputs: &Inputs, input: DVec3) -> Option<Sample> {
    let target = inputs.undo(input);
    for _ in 0..MAX_STEPS {
        let seen = see(views, *point)?;
        let inverse = seen.jacobian.inverse();
        let step = inverse * (target - seen.at);
        *point += step;
        // Newton's steps shrink quadratically: the next would be below 1e-12 mm.
        if step.length() <= 1e-7 {
            let rows = inverse.transpose() * seen.rows_gradient;
            let column = |c: DVec3, row: f64| [c.x, c.y, c.z, row];
            let by = [
                column(inverse.x_axis, rows.x),
                column(inverse.y_axis, rows.y),
                column(inverse.z_axis, rows.z),
            ];
            let slope = inputs.by_inputs(input.z, by);
            return Some(Sample { value: [point.x, point.y, point.z, seen.rows_px], slope });
        }
    }
    None
}
