//! One blurred, tilted disc on a sloping ground: its parameters and the sums of a step of the fit.

use super::edge::Edge;
use super::lanes::{Lanes, Sum, WIDTH, inverse_root};
use super::solve::Factor;
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, round_even, sqrt};
use alloc::vec::Vec;

/// Outline (p - c)ᵀ A (p - c) = 1 of an ellipse; coordinates relative to the window's origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outline {
    pub centre: DVec2,
    /// A's entries xx, xy, yy, 1/px².
    pub form: [f64; 3],
}

/// Grey levels: ground + slope · p + contrast · (share of the disc).
#[derive(Clone, Copy, Debug)]
pub(super) struct Levels {
    pub contrast: f64,
    pub ground: f64,
    pub slope: DVec2,
}

impl Outline {
    /// With the semi-axes of this matrix (their squares are its eigenvalues).
    pub fn new(centre: DVec2, spread_px2: &Symmetric<2>) -> Option<Self> {
        let [[xx, xy], [_, yy]] = *spread_px2;
        let determinant = xx * yy - xy * xy;
        (xx > 0.0 && determinant > 1e-6 * xx * xx)
            .then(|| Self { centre, form: [yy / determinant, -xy / determinant, xx / determinant] })
    }

    /// Radius of curvature at the ends of the longer axis: the shorter semi-axis squared over the longer one. `None` when
    /// it is no ellipse.
    pub fn sharpest_px(&self) -> Option<f64> {
        let [[xx, xy], [_, yy]] = self.spread_px2()?;
        let mean = 0.5 * (xx + yy);
        let apart = sqrt((mean * mean - (xx * yy - xy * xy)).max(0.0));
        Some((mean - apart) / sqrt(mean + apart))
    }

    /// The matrix whose eigenvalues are the squared semi-axes; `None` when it is no ellipse.
    pub fn spread_px2(&self) -> Option<Symmetric<2>> {
        let [xx, xy, yy] = self.form;
        let determinant = xx * yy - xy * xy;
        (xx > 0.0 && determinant > 0.0 && determinant.is_finite())
            .then(|| [[yy / determinant, -xy / determinant], [-xy / determinant, xx / determinant]])
    }
}

/// Some pixels of a window: where they are from its middle, their levels, and what the model says of them. Places without a
/// pixel are zero in all that is summed.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    x: Lanes,
    y: Lanes,
    /// 1 for a pixel.
    one: Lanes,
    level: Lanes,
    /// Share of the contrast, and its fall with the distance from the outline, 1/px.
    inside: Lanes,
    slope: Lanes,
    /// Distance from the outline, px, outside positive.
    distance: Lanes,
    weight: Lanes,
    /// How far the outline moves outwards here with each parameter: centre, then form.
    basis: [Lanes; 5],
    /// How the level changes with the slopes of the light: the place, but more where there is contrast, for that takes
    /// part in the light.
    lit: [Lanes; 2],
}

/// The outline's part of the normal equations (lower triangle), for a contrast of 1.
pub(super) type Matrix = Symmetric<5>;

/// Right side of the outline's step, and Σ residual².
#[derive(Clone, Copy, Debug)]
pub(super) struct Pull {
    pub right: [f64; 5],
    pub residual2: f64,
}

/// Pixels within a circle about a pixel, as far as the image goes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Extent {
    /// Squared radius, px².
    radius2: i64,
    /// First and last column and row of the image, from the middle, but none farther out than the radius.
    columns: (i64, i64),
    rows: (i64, i64),
}

impl Extent {
    fn reach(&self) -> i64 {
        sqrt(self.radius2 as f64) as i64
    }

    /// First column and number of columns of each row.
    fn spans(&self) -> impl Iterator<Item = (i64, i64, usize)> {
        let Self { radius2, columns, rows } = *self;
        (rows.0..=rows.1).map(move |y| {
            let half = sqrt((radius2 - y * y).max(0) as f64) as i64;
            let (first, last) = (columns.0.max(-half), columns.1.min(half));
            (y, first, (last + 1 - first).max(0) as usize)
        })
    }
}

/// Pixels about a marker.
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    extent: Extent,
    /// Of each row with pixels: its distance from the middle's, first column and number of columns.
    spans: Vec<(i64, i64, usize)>,
    /// Pixels in all.
    pixels: usize,
    /// Levels of the pixels.
    loaded: Vec<u8>,
    /// Row by row; the places serve every marker of the same extent.
    cells: Vec<Cell>,
    /// Σ over pixels of products of 1, x, y with each other (lower triangle) and with the level.
    ground: Symmetric<3>,
    ground_right: [f64; 3],
    /// The pixel in the middle.
    pub origin: DVec2,
}

impl Window {
    /// Room for a window of so many pixels on a side.
    pub fn reserve(&mut self, side: usize) {
        self.cells.reserve((side * side).div_ceil(WIDTH).saturating_sub(self.cells.len()));
        self.spans.reserve(side.saturating_sub(self.spans.len()));
        self.loaded.reserve((side * side).saturating_sub(self.loaded.len()));
    }

    /// The pixels of `image` within `radius_px` of that at `centre_px`; their number.
    pub fn load(&mut self, image: GrayView<'_>, centre_px: DVec2, radius_px: f64) -> usize {
        self.origin = DVec2::new(round_even(centre_px.x), round_even(centre_px.y));
        let (x, y) = (self.origin.x as i64, self.origin.y as i64);
        let mut extent = Extent { radius2: (radius_px * radius_px) as i64, ..Extent::default() };
        let reach = extent.reach();
        let within = |middle: i64, len: usize| ((-middle).max(-reach), (len as i64 - 1 - middle).min(reach));
        (extent.columns, extent.rows) = (within(x, image.width()), within(y, image.height()));
        if extent != self.extent {
            self.extent = extent;
            self.place();
        }
        self.loaded.clear();
        for &(dy, first, count) in &self.spans {
            let row = &image.row((y + dy) as usize)[(x + first) as usize..];
            self.loaded.extend_from_slice(&row[..count]);
        }
        for (cell, levels) in self.cells.iter_mut().zip(self.loaded.chunks(WIDTH)) {
            for (lane, &level) in cell.level.0.iter_mut().zip(levels) {
                *lane = f32::from(level);
            }
        }
        self.ground_right = self.sums(|cell| [&cell.one, &cell.x, &cell.y].map(|term| (term, &cell.level)));
        self.pixels
    }

    /// Places of the pixels of a new extent, and their sums.
    fn place(&mut self) {
        self.spans.clear();
        self.spans.extend(self.extent.spans().filter(|&(_, _, count)| count > 0));
        self.pixels = self.spans.iter().map(|&(_, _, count)| count).sum();
        self.cells.clear();
        self.cells.resize(self.pixels.div_ceil(WIDTH), Cell::default());
        let pixels =
            self.spans.iter().flat_map(|&(y, first, count)| (0..count).map(move |k| (first + k as i64, y)));
        for (n, (x, y)) in pixels.enumerate() {
            let (cell, lane) = (&mut self.cells[n / WIDTH], n % WIDTH);
            (cell.x[lane], cell.y[lane], cell.one[lane]) = (x as f32, y as f32, 1.0);
        }
        let [n, x, xx, y, yx, yy] =
            self.sums(|Cell { x, y, one, .. }| [(one, one), (one, x), (x, x), (one, y), (y, x), (y, y)]);
        self.ground = [[n, x, y], [x, xx, yx], [y, yx, yy]];
    }

    /// Sums over the pixels.
    #[inline]
    fn sums<const N: usize>(&self, terms: impl Fn(&Cell) -> [(&Lanes, &Lanes); N]) -> [f64; N] {
        let mut sums = [Sum::default(); N];
        for cell in &self.cells {
            for (sum, (a, b)) in sums.iter_mut().zip(terms(cell)) {
                sum.add(a, b);
            }
        }
        sums.each_ref().map(Sum::total)
    }

    /// Draws the model's shares for an outline of this blur.
    pub fn draw(&mut self, outline: &Outline, blur_px: f64, edge: &Edge) {
        let [xx, xy, yy] = outline.form.map(|entry| entry as f32);
        let (centre_x, centre_y) = (outline.centre.x as f32, outline.centre.y as f32);
        let per_blur = (1.0 / blur_px) as f32;
        const TINY: f32 = 1e-12;
        for cell in &mut self.cells {
            let mut z = Lanes::default();
            for k in 0..WIDTH {
                let (x, y) = (cell.x[k] - centre_x, cell.y[k] - centre_y);
                let (along, across) = (xx * x + xy * y, xy * x + yy * y);
                // Distance from the outline to first order (Sampson): (q² - 1) / |∇(q²)| with q = 1 on it, but growing as
                // q does.
                let q2 = x * along + y * across + TINY;
                let q = q2 * inverse_root(q2);
                let inverse = inverse_root(along * along + across * across + TINY);
                let distance = q * (q - 1.0) * inverse;
                z[k] = distance * per_blur;
                cell.distance[k] = distance;
                cell.basis[0][k] = along * inverse;
                cell.basis[1][k] = across * inverse;
                let (x_half, y_half) = (-0.5 * x * inverse, -0.5 * y * inverse);
                cell.basis[2][k] = x_half * x;
                cell.basis[3][k] = (x_half + x_half) * y;
                cell.basis[4][k] = y_half * y;
            }
            let shares = edge.at(&z);
            for k in 0..WIDTH {
                cell.inside[k] = shares.inside[k] * cell.one[k];
                cell.slope[k] = shares.density[k] * per_blur * cell.one[k];
                cell.weight[k] = shares.weight[k] * cell.one[k];
            }
        }
    }

    /// Contrast over the gel's level: light that falls off takes its share of the contrast with it, so that where the dot
    /// is a slope of light is 1 plus this as steep.
    fn light(&mut self, per_ground: f64) {
        let per_ground = per_ground as f32;
        for cell in &mut self.cells {
            for k in 0..WIDTH {
                let light = 1.0 + per_ground * cell.inside[k];
                cell.lit[0][k] = light * cell.x[k];
                cell.lit[1][k] = light * cell.y[k];
            }
        }
    }

    /// Least-squares levels, and the factor of their normal matrix (ground, slopes, contrast).
    pub fn levels(&mut self) -> Option<(Levels, Factor<4>)> {
        let [square, one, x, y, right] = self.sums(|Cell { x, y, one, level, inside, .. }| {
            [inside, one, x, y, level].map(|term| (inside, term))
        });
        let [ground, along, across] = self.ground;
        let factor = Factor::new(&[
            [ground[0], 0.0, 0.0, 0.0],
            [along[0], along[1], 0.0, 0.0],
            [across[0], across[1], across[2], 0.0],
            [one, x, y, square],
        ])?;
        let [level, level_x, level_y] = self.ground_right;
        let [ground, x, y, contrast] = factor.solve(&[level, level_x, level_y, right]);
        self.light(contrast / ground.max(1.0));
        Some((Levels { contrast, ground, slope: DVec2::new(x, y) }, factor))
    }

    /// By how much the blur should grow, by least squares together with the levels.
    pub fn blur_step(&self, blur_px: f64) -> Option<f64> {
        let per_blur = (1.0 / blur_px) as f32;
        let mut matrix = [[Sum::default(); 5]; 5];
        let mut right = [Sum::default(); 5];
        for cell in &self.cells {
            // ∂Φ(-d/σ)/∂σ = φ(d/σ) d / σ²
            let wider = Lanes(core::array::from_fn(|k| cell.slope[k] * cell.distance[k] * per_blur));
            let terms = [&cell.one, &cell.x, &cell.y, &cell.inside, &wider];
            for i in 0..5 {
                right[i].add(terms[i], &cell.level);
                for j in 0..=i {
                    matrix[i][j].add(terms[i], terms[j]);
                }
            }
        }
        let (matrix, right) =
            (matrix.map(|row| row.each_ref().map(Sum::total)), right.each_ref().map(Sum::total));
        let [_, _, _, contrast, wider] = Factor::new(&matrix)?.solve(&right);
        let step_px = wider / contrast;
        step_px.is_finite().then_some(step_px)
    }

    /// The normal matrix of the outline's step, less what the levels take up when they follow it (variable projection).
    pub fn matrix(&self, levels: &Factor<4>) -> Matrix {
        let mut sums = [[Sum::default(); 5]; 5];
        let mut with_weight = [[Sum::default(); 4]; 5];
        let mut with_slope = [[Sum::default(); 4]; 5];
        for cell in &self.cells {
            let times = |a: &Lanes, b: &Lanes| Lanes(core::array::from_fn(|k| a[k] * b[k]));
            let sloped = cell.basis.each_ref().map(|basis| times(&cell.slope, basis));
            let weighted = cell.basis.each_ref().map(|basis| times(&cell.weight, basis));
            let terms = [&cell.one, &cell.x, &cell.y, &cell.inside];
            let seen = [&cell.one, &cell.lit[0], &cell.lit[1], &cell.inside];
            for i in 0..5 {
                for j in 0..=i {
                    sums[i][j].add(&weighted[i], &sloped[j]);
                }
                for k in 0..4 {
                    with_weight[i][k].add(&weighted[i], seen[k]);
                    with_slope[i][k].add(&sloped[i], terms[k]);
                }
            }
        }
        let mut matrix = sums.map(|row| row.each_ref().map(Sum::total));
        let with_weight = with_weight.map(|row| row.each_ref().map(Sum::total));
        let with_slope = with_slope.map(|row| row.each_ref().map(Sum::total));
        let followed = with_slope.map(|row| levels.solve(&row));
        let dot = |a: &[f64; 4], b: &[f64; 4]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        for i in 0..5 {
            for j in 0..=i {
                let taken = dot(&with_weight[i], &followed[j]) + dot(&with_weight[j], &followed[i]);
                matrix[i][j] -= 0.5 * taken;
            }
        }
        matrix
    }

    /// How the centre answers to every pixel, px per grey level: the step of `matrix` at this contrast with the levels
    /// following. Places are whole pixels from the middle.
    pub fn influence(
        &self,
        matrix: &Factor<5>,
        levels: &Factor<4>,
        contrast: f64,
        mut each: impl FnMut([i32; 2], DVec2),
    ) {
        let row = |axis: usize| matrix.solve(&core::array::from_fn(|k| f64::from(u8::from(k == axis))));
        let rows = [row(0), row(1)].map(|row| row.map(|entry| (entry / contrast) as f32));
        let pulled = |cell: &Cell, row: &[f32; 5]| {
            Lanes(core::array::from_fn(|k| {
                let along: f32 = row.iter().zip(&cell.basis).map(|(r, basis)| r * basis[k]).sum();
                along * cell.weight[k]
            }))
        };
        let taken = rows.map(|row| {
            let mut sums = [Sum::default(); 4];
            for cell in &self.cells {
                let pull = pulled(cell, &row);
                let terms = [&cell.one, &cell.lit[0], &cell.lit[1], &cell.inside];
                sums.iter_mut().zip(terms).for_each(|(sum, term)| sum.add(&pull, term));
            }
            levels.solve(&sums.each_ref().map(Sum::total))
        });
        for cell in &self.cells {
            let pulls = rows.map(|row| pulled(cell, &row));
            for lane in (0..WIDTH).filter(|&lane| cell.one[lane] > 0.0) {
                let terms = [&cell.one, &cell.x, &cell.y, &cell.inside].map(|lanes| f64::from(lanes[lane]));
                let answer = |axis: usize| {
                    let level: f64 = taken[axis].iter().zip(terms).map(|(taken, term)| taken * term).sum();
                    f64::from(pulls[axis][lane]) - level
                };
                each([cell.x[lane] as i32, cell.y[lane] as i32], DVec2::new(answer(0), answer(1)));
            }
        }
    }

    /// The weighted residuals at these levels.
    pub fn pull(&self, levels: &Levels) -> Pull {
        let [ground, along, across, contrast] =
            [levels.ground, levels.slope.x, levels.slope.y, levels.contrast].map(|level| level as f32);
        let (mut right, mut square) = ([Sum::default(); 5], Sum::default());
        for cell in &self.cells {
            let (mut residual, mut pull) = (Lanes::default(), Lanes::default());
            for k in 0..WIDTH {
                let slopes = along * cell.lit[0][k] + across * cell.lit[1][k];
                let expected = ground * cell.one[k] + slopes + contrast * cell.inside[k];
                residual[k] = cell.level[k] - expected;
                pull[k] = cell.weight[k] * residual[k];
            }
            square.add(&residual, &residual);
            for i in 0..5 {
                right[i].add(&pull, &cell.basis[i]);
            }
        }
        Pull { right: right.each_ref().map(Sum::total), residual2: square.total() }
    }
}
