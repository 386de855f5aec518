//! A blurred, tilted disc on sloping ground: its parameters and the sums of a fit step.

use super::edge::Edge;
use super::extent::Extent;
use super::lanes::{Lanes, Sum, WIDTH, inverse_root};
use crate::image::GrayView;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, Factor, round_even, sqrt};
use alloc::vec::Vec;
use core::f64::consts::{FRAC_1_SQRT_2, PI};

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
    /// Ellipse with the semi-axes of this matrix (their squares are its eigenvalues).
    pub fn new(centre: DVec2, spread_px2: &Symmetric<2>) -> Option<Self> {
        let [[xx, xy], [_, yy]] = *spread_px2;
        let determinant = xx * yy - xy * xy;
        (xx > 0.0 && determinant > 1e-6 * xx * xx)
            .then(|| Self { centre, form: [yy / determinant, -xy / determinant, xx / determinant] })
    }

    /// Radius of curvature at the ends of the longer axis: the shorter semi-axis squared over the longer
    /// one. `None` if it is not an ellipse.
    pub fn sharpest_px(&self) -> Option<f64> {
        let [[xx, xy], [_, yy]] = self.spread_px2()?;
        let mean = 0.5 * (xx + yy);
        let apart = sqrt((mean * mean - (xx * yy - xy * xy)).max(0.0));
        Some((mean - apart) / sqrt(mean + apart))
    }

    /// Matrix whose eigenvalues are the squared semi-axes; `None` if it is not an ellipse.
    pub fn spread_px2(&self) -> Option<Symmetric<2>> {
        let [xx, xy, yy] = self.form;
        let determinant = xx * yy - xy * xy;
        (xx > 0.0 && determinant > 0.0 && determinant.is_finite())
            .then(|| [[yy / determinant, -xy / determinant], [-xy / determinant, xx / determinant]])
    }
}

/// Some pixels of a window: positions relative to its middle, and model values. Unused lanes are zero in
/// all sums.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    x: Lanes,
    y: Lanes,
    /// 1 for a pixel.
    one: Lanes,
    /// Share of the contrast, and its decrease with distance from the outline over blur.
    inside: Lanes,
    density: Lanes,
    /// Distance from the outline, px, positive outside.
    distance: Lanes,
    weight: Lanes,
    /// Outward shift of the outline here per unit of each parameter: centre, then form.
    basis: [Lanes; 5],
    /// Derivatives of the level with respect to the light slopes: the position, scaled up within the
    /// marker, whose contrast follows the light.
    lit: [Lanes; 2],
}

/// Sensitivity to a cell's pixels of centre and form, each times the contrast, and of the contrast.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answers([Lanes; ANSWERS]);
pub(super) const ANSWERS: usize = 6;

impl Cell {
    /// Computes shares, slopes and weights at the cell's distances.
    #[inline]
    fn shade(&mut self, per_blur: f32, edge: &Edge, scratch: &mut Scratch, whole: bool) {
        let Scratch { place, off, .. } = scratch;
        Edge::find(&self.distance, per_blur, place, off);
        edge.look_up(place, off, [&mut self.inside, &mut self.density, &mut self.weight]);
        if !whole {
            for k in 0..WIDTH {
                self.inside[k] *= self.one[k];
                self.density[k] *= self.one[k];
                self.weight[k] *= self.one[k];
            }
        }
    }
}

/// The outline's part of the normal equations (lower triangle), for a contrast of 1.
pub(super) type Matrix = Symmetric<5>;

/// Right-hand side of the outline's step, and Σ residual².
#[derive(Clone, Copy, Debug)]
pub(super) struct Pull {
    pub right: [f64; 5],
    pub residual2: f64,
}

/// Pixels around a marker.
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    extent: Extent,
    /// For each row with pixels: its offset from the middle row, first column and number of columns.
    spans: Vec<(i64, i64, usize)>,
    /// Total number of pixels.
    pixels: usize,
    loaded: Vec<f32>,
    /// Row by row; the positions are shared by all markers of the same extent.
    cells: Vec<Cell>,
    /// Levels of the pixels, cell by cell.
    grey: Vec<Lanes>,
    /// Σ over pixels of products of 1, x, y with each other (lower triangle) and with the level.
    ground: Symmetric<3>,
    ground_right: [f64; 3],
    /// The pixel in the middle.
    pub origin: DVec2,
    scratch: Scratch,
}

/// Data passed between the loops over one cell; kept to avoid clearing a new one.
#[derive(Clone, Debug, Default)]
struct Scratch {
    place: [u32; WIDTH],
    off: Lanes,
    residual: Lanes,
    pull: Lanes,
}

/// Groups of pixels in a window of this radius.
pub(super) fn groups_within(radius_px: f64) -> usize {
    Extent::whole(radius_px).spans().map(|(.., count)| count).sum::<usize>().div_ceil(WIDTH)
}

impl Window {
    /// Reserves memory for a window of `side` pixels across.
    pub fn reserve(&mut self, side: usize) {
        // A circle through the corners of its edge pixels covers at least the area of all pixels.
        let reach = 0.5 * side as f64 + FRAC_1_SQRT_2;
        let cells = ((PI * reach * reach) as usize).div_ceil(WIDTH);
        self.cells.reserve(cells.saturating_sub(self.cells.len()));
        self.spans.reserve(side.saturating_sub(self.spans.len()));
        self.loaded.reserve((cells * WIDTH).saturating_sub(self.loaded.len()));
        self.grey.reserve(cells.saturating_sub(self.grey.len()));
    }

    /// Loads the pixels of `image` within `radius_px` of the pixel at `centre_px`; returns their number.
    pub fn load(&mut self, image: GrayView<'_>, centre_px: DVec2, radius_px: f64) -> usize {
        self.origin = DVec2::new(round_even(centre_px.x), round_even(centre_px.y));
        let (x, y) = (self.origin.x as i64, self.origin.y as i64);
        let mut extent = Extent::whole(radius_px);
        let reach = extent.reach();
        let within = |middle: i64, len: usize| ((-middle).max(-reach), (len as i64 - 1 - middle).min(reach));
        (extent.columns, extent.rows) = (within(x, image.width()), within(y, image.height()));
        self.set(extent);
        self.loaded.clear();
        for &(dy, first, count) in &self.spans {
            let row = &image.row((y + dy) as usize)[(x + first) as usize..];
            self.loaded.extend(row[..count].iter().map(|&level| f32::from(level)));
        }
        self.loaded.resize(self.cells.len() * WIDTH, 0.0);
        self.grey.clear();
        self.grey.extend(self.loaded.as_chunks().0.iter().map(|&levels| Lanes(levels)));
        self.ground_right = self.level_sums(|cell| [&cell.one, &cell.x, &cell.y]);
        self.pixels
    }

    /// Sets up the same pixels without a marker in an unbounded image; returns their number.
    pub fn lay(&mut self, radius_px: f64) -> usize {
        self.set(Extent::whole(radius_px));
        self.pixels
    }

    /// Number of pixels.
    pub const fn pixels(&self) -> usize {
        self.pixels
    }

    /// Whether the window has all pixels within this radius and no others.
    pub fn is_whole(&self, radius_px: f64) -> bool {
        self.extent == Extent::whole(radius_px)
    }

    fn set(&mut self, extent: Extent) {
        if extent != self.extent {
            self.extent = extent;
            self.place();
        }
    }

    /// Computes the pixel positions of a new extent and their sums.
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

    /// Sums of the levels times these terms over the pixels.
    #[inline]
    fn level_sums<const N: usize>(&self, terms: impl Fn(&Cell) -> [&Lanes; N]) -> [f64; N] {
        let mut sums = [Sum::default(); N];
        for (cell, level) in self.cells.iter().zip(&self.grey) {
            sums.iter_mut().zip(terms(cell)).for_each(|(sum, term)| sum.add(term, level));
        }
        sums.each_ref().map(Sum::total)
    }

    /// Computes the model's shares for an outline with this blur.
    pub fn draw(&mut self, outline: &Outline, blur_px: f64, edge: &Edge) {
        let [xx, xy, yy] = outline.form.map(|entry| entry as f32);
        let (centre_x, centre_y) = (outline.centre.x as f32, outline.centre.y as f32);
        let per_blur = (1.0 / blur_px) as f32;
        const TINY: f32 = 1e-12;
        let whole = self.pixels / WIDTH;
        for (n, cell) in self.cells.iter_mut().enumerate() {
            for k in 0..WIDTH {
                let (x, y) = (cell.x[k] - centre_x, cell.y[k] - centre_y);
                let (along, across) = (xx * x + xy * y, xy * x + yy * y);
                // First-order distance from the outline (Sampson), (q² - 1) / |∇(q²)| with q = 1 on it,
                // made linear in q.
                let q2 = x * along + y * across + TINY;
                let q = q2 * inverse_root(q2);
                let inverse = inverse_root(along * along + across * across + TINY);
                cell.distance[k] = q * (q - 1.0) * inverse;
                cell.basis[0][k] = along * inverse;
                cell.basis[1][k] = across * inverse;
                let (x_half, y_half) = (-0.5 * x * inverse, -0.5 * y * inverse);
                cell.basis[2][k] = x_half * x;
                cell.basis[3][k] = (x_half + x_half) * y;
                cell.basis[4][k] = y_half * y;
            }
            cell.shade(per_blur, edge, &mut self.scratch, n < whole);
        }
    }

    /// Includes the light slope in the contrast; `per_ground` is the contrast over the gel's level. A
    /// light slope is 1 plus this value times as steep inside the dot.
    pub fn light(&mut self, per_ground: f64) {
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
        let factor = self.follow()?;
        let [right] = self.level_sums(|cell| [&cell.inside]);
        let (levels, _) = self.solve_levels(&factor, right);
        self.light(levels.contrast / levels.ground.max(1.0));
        Some((levels, factor))
    }

    /// Levels from Σ of the share times the level, and how much they explain of Σ level².
    fn solve_levels(&self, factor: &Factor<4>, inside: f64) -> (Levels, f64) {
        let [one, x, y] = self.ground_right;
        let right = [one, x, y, inside];
        let solved = factor.solve(&right);
        let explained = solved.iter().zip(&right).map(|(a, b)| a * b).sum();
        let [ground, x, y, contrast] = solved;
        (Levels { contrast, ground, slope: DVec2::new(x, y) }, explained)
    }

    /// As [`Self::levels`] for given shares, with Σ residual².
    pub fn levels_with(&self, shares: &[Lanes], factor: &Factor<4>) -> (Levels, f64) {
        let (mut inside, mut square) = (Sum::default(), Sum::default());
        for (share, level) in shares.iter().zip(&self.grey) {
            inside.add(share, level);
            square.add(level, level);
        }
        let (levels, explained) = self.solve_levels(factor, inside.total());
        (levels, square.total() - explained)
    }

    /// Only the factor of [`Self::levels`].
    pub fn follow(&self) -> Option<Factor<4>> {
        let [one, x, y, square] =
            self.sums(|Cell { x, y, one, inside, .. }| [one, x, y, inside].map(|term| (inside, term)));
        let [ground, along, across] = self.ground;
        Factor::new(&[
            [ground[0], 0.0, 0.0, 0.0],
            [along[0], along[1], 0.0, 0.0],
            [across[0], across[1], across[2], 0.0],
            [one, x, y, square],
        ])
    }

    /// Blur increment by least squares together with the levels.
    pub fn blur_step(&self, blur_px: f64) -> Option<f64> {
        let per_blur = (1.0 / blur_px) as f32;
        let mut matrix = [[Sum::default(); 5]; 5];
        let mut right = [Sum::default(); 5];
        for (cell, level) in self.cells.iter().zip(&self.grey) {
            // ∂Φ(-d/σ)/∂σ = φ(d/σ) d / σ²
            let wider =
                Lanes(core::array::from_fn(|k| per_blur * per_blur * cell.density[k] * cell.distance[k]));
            let terms = [&cell.one, &cell.x, &cell.y, &cell.inside, &wider];
            for i in 0..5 {
                right[i].add(terms[i], level);
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

    /// Normal matrix of the outline's step with the levels eliminated (variable projection).
    pub fn matrix(&self, levels: &Factor<4>, blur_px: f64) -> Matrix {
        self.matrix_by(|cell| &cell.weight, levels, blur_px)
    }

    /// How much a step explains of Σ residual², as a quadratic form, for a contrast of 1.
    pub fn explained(&self, levels: &Factor<4>, blur_px: f64) -> Matrix {
        let matrix = self.matrix_by(|cell| &cell.density, levels, blur_px);
        matrix.map(|row| row.map(|entry| entry / blur_px))
    }

    fn matrix_by(&self, weight: impl Fn(&Cell) -> &Lanes, levels: &Factor<4>, blur_px: f64) -> Matrix {
        let mut sums = [[Sum::default(); 5]; 5];
        let mut with_weight = [[Sum::default(); 4]; 5];
        let mut with_slope = [[Sum::default(); 4]; 5];
        for cell in &self.cells {
            let times = |a: &Lanes, b: &Lanes| Lanes(core::array::from_fn(|k| a[k] * b[k]));
            let sloped = cell.basis.each_ref().map(|basis| times(&cell.density, basis));
            let weighted = cell.basis.each_ref().map(|basis| times(weight(cell), basis));
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
        let per_blur = 1.0 / blur_px;
        let mut matrix = sums.map(|row| row.each_ref().map(|sum| per_blur * sum.total()));
        let with_weight = with_weight.map(|row| row.each_ref().map(Sum::total));
        let with_slope = with_slope.map(|row| row.each_ref().map(|sum| per_blur * sum.total()));
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

    /// Sensitivity to every pixel of the parameters times the contrast, and of the contrast: the step of
    /// `matrix` with the levels eliminated. Appended to `out` cell by cell.
    pub fn answers(&self, matrix: &Factor<5>, levels: &Factor<4>, out: &mut Vec<Answers>) {
        let unit = |len: usize, axis: usize| move |k: usize| f64::from(u8::from(k == axis && k < len));
        let rows: [[f32; 5]; 5] = core::array::from_fn(|axis| {
            matrix.solve(&core::array::from_fn(unit(5, axis))).map(|entry| entry as f32)
        });
        let contrast = levels.solve(&core::array::from_fn(unit(4, 3)));
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
            let level = |of: &[f64; 4], k: usize| {
                let [ground, x, y, inside] = of.map(|entry| entry as f32);
                ground * cell.one[k] + x * cell.x[k] + y * cell.y[k] + inside * cell.inside[k]
            };
            let mut answers = [Lanes::default(); ANSWERS];
            for axis in 0..5 {
                let pull = pulled(cell, &rows[axis]);
                answers[axis] = Lanes(core::array::from_fn(|k| pull[k] - level(&taken[axis], k)));
            }
            answers[5] = Lanes(core::array::from_fn(|k| level(&contrast, k)));
            out.push(Answers(answers));
        }
    }

    /// Appends the shares cell by cell.
    pub fn shares(&self, out: &mut Vec<Lanes>) {
        out.extend(self.cells.iter().map(|cell| cell.inside));
    }

    /// Applies the sensitivities to the levels.
    pub fn sum_answers(&self, answers: &[Answers]) -> [f64; ANSWERS] {
        let mut sums = [Sum::default(); ANSWERS];
        for (level, Answers(answers)) in self.grey.iter().zip(answers) {
            sums.iter_mut().zip(answers).for_each(|(sum, answer)| sum.add(answer, level));
        }
        sums.each_ref().map(Sum::total)
    }

    /// Calls `each` with each pixel's position and the centre's sensitivity, px per grey level at a
    /// contrast of 1.
    pub fn each_answer(&self, answers: &[Answers], mut each: impl FnMut([i32; 2], DVec2)) {
        for (cell, Answers([x, y, ..])) in self.cells.iter().zip(answers) {
            for lane in (0..WIDTH).filter(|&lane| cell.one[lane] > 0.0) {
                let place = [cell.x[lane] as i32, cell.y[lane] as i32];
                each(place, DVec2::new(f64::from(x[lane]), f64::from(y[lane])));
            }
        }
    }

    /// Weighted residuals at these levels.
    pub fn pull(&mut self, levels: &Levels) -> Pull {
        let [ground, along, across, contrast] =
            [levels.ground, levels.slope.x, levels.slope.y, levels.contrast].map(|level| level as f32);
        let (mut right, mut square) = ([Sum::default(); 5], Sum::default());
        let Self { cells, grey, scratch: Scratch { residual, pull, .. }, .. } = self;
        for (cell, level) in cells.iter().zip(&*grey) {
            for k in 0..WIDTH {
                let slopes = along * cell.lit[0][k] + across * cell.lit[1][k];
                let expected = ground * cell.one[k] + slopes + contrast * cell.inside[k];
                residual[k] = level[k] - expected;
                pull[k] = cell.weight[k] * residual[k];
            }
            square.add(residual, residual);
            for i in 0..5 {
                right[i].add(pull, &cell.basis[i]);
            }
        }
        Pull { right: right.each_ref().map(Sum::total), residual2: square.total() }
    }
}
