//! One blurred, tilted disc on a sloping ground: its parameters and the sums of a step of the fit.

use super::edge::Edge;
use super::lanes::{Lanes, WIDTH};
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

    /// The matrix whose eigenvalues are the squared semi-axes; `None` when it is no ellipse.
    pub fn spread_px2(&self) -> Option<Symmetric<2>> {
        let [xx, xy, yy] = self.form;
        let determinant = xx * yy - xy * xy;
        (xx > 0.0 && determinant > 0.0 && determinant.is_finite())
            .then(|| [[yy / determinant, -xy / determinant], [-xy / determinant, xx / determinant]])
    }
}

/// Places of four pixels of a window, from its middle. Lanes that hold no pixel are zero.
#[derive(Clone, Copy, Debug, Default)]
struct Places {
    x: Lanes,
    y: Lanes,
    /// 1 for a pixel.
    one: Lanes,
}

/// What the model says of them; zero in all that is summed where there is no pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Model {
    /// Share of the contrast, and its fall with the distance from the outline, 1/px.
    inside: Lanes,
    slope: Lanes,
    /// Distance from the outline, px, outside positive.
    distance: Lanes,
    weight: Lanes,
    /// How far the outline moves outwards here with each parameter: centre, then form.
    basis: [Lanes; 5],
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
    /// Pixels in all.
    pixels: usize,
    /// Row by row; each begins a new block. They serve every marker of the same extent.
    places: Vec<Places>,
    levels: Vec<Lanes>,
    model: Vec<Model>,
    /// Σ over pixels of products of 1, x, y with each other (lower triangle) and with the level.
    ground: Symmetric<3>,
    ground_right: [f64; 3],
    /// The pixel in the middle.
    pub origin: DVec2,
}

impl Window {
    /// Room for a window of so many pixels on a side.
    pub fn reserve(&mut self, side: usize) {
        let blocks = side * (side / WIDTH + 1);
        self.levels.clear();
        self.levels.reserve(blocks);
        self.model.reserve(blocks.saturating_sub(self.model.len()));
        self.places.reserve(blocks.saturating_sub(self.places.len()));
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
        self.levels.clear();
        for (dy, first, count) in extent.spans() {
            if count > 0 {
                let row = &image.row((y + dy) as usize)[(x + first) as usize..][..count];
                let (whole, rest) = row.as_chunks::<WIDTH>();
                self.levels.extend(whole.iter().map(|levels| Lanes(levels.map(f32::from))));
                if !rest.is_empty() {
                    let level = |k: usize| rest.get(k).map_or(0.0, |&level| f32::from(level));
                    self.levels.push(Lanes(core::array::from_fn(level)));
                }
            }
        }
        let mut right = [Lanes::default(); 3];
        for (p, &level) in self.places.iter().zip(&self.levels) {
            for (sum, term) in right.iter_mut().zip([p.one, p.x, p.y]) {
                *sum = *sum + term * level;
            }
        }
        self.ground_right = right.map(Lanes::sum);
        self.pixels
    }

    /// Places of the pixels of a new extent, and their sums.
    fn place(&mut self) {
        self.places.clear();
        self.pixels = 0;
        for (y, first, count) in self.extent.spans() {
            self.pixels += count;
            for from in (0..count).step_by(WIDTH) {
                let mut places = Places::default();
                for lane in 0..WIDTH.min(count - from) {
                    places.x.0[lane] = (first + (from + lane) as i64) as f32;
                    places.y.0[lane] = y as f32;
                    places.one.0[lane] = 1.0;
                }
                self.places.push(places);
            }
        }
        let mut sums = [Lanes::default(); 6];
        for Places { x, y, one } in &self.places {
            let terms = [*one, *x, *x * *x, *y, *y * *x, *y * *y];
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum = *sum + term;
            }
        }
        let [n, x, xx, y, yx, yy] = sums.map(Lanes::sum);
        self.ground = [[n, x, y], [x, xx, yx], [y, yx, yy]];
        self.model.clear();
        self.model.resize(self.places.len(), Model::default());
    }

    /// Draws the model's shares for an outline of this blur.
    pub fn draw(&mut self, outline: &Outline, blur_px: f64, edge: &Edge) {
        let [xx, xy, yy] = outline.form.map(|entry| Lanes::all(entry as f32));
        let (centre_x, centre_y) = (Lanes::all(outline.centre.x as f32), Lanes::all(outline.centre.y as f32));
        let per_blur = Lanes::all((1.0 / blur_px) as f32);
        let (half, tiny) = (Lanes::all(-0.5), Lanes::all(1e-12));
        for (p, model) in self.places.iter().zip(&mut self.model) {
            let (x, y) = (p.x - centre_x, p.y - centre_y);
            let (along, across) = (xx * x + xy * y, xy * x + yy * y);
            // Distance from the outline to first order (Sampson): (q² - 1) / |∇(q²)| with q = 1 on it, but growing as
            // q does.
            let q2 = x * along + y * across + tiny;
            let q = q2 * q2.inverse_root();
            let inverse = (along * along + across * across + tiny).inverse_root();
            let distance = q * (q - Lanes::all(1.0)) * inverse;
            let shares = edge.at(distance * per_blur);
            let (normal_x, normal_y) = (along * inverse, across * inverse);
            let (x_half, y_half) = (half * x * inverse, half * y * inverse);
            *model = Model {
                inside: shares.inside * p.one,
                slope: shares.density * per_blur,
                distance,
                weight: shares.weight * p.one,
                basis: [normal_x, normal_y, x_half * x, (x_half + x_half) * y, y_half * y],
            };
        }
    }

    /// Places, levels and model, block by block.
    fn seen(&self) -> impl Iterator<Item = ((&Places, &Lanes), &Model)> {
        self.places.iter().zip(&self.levels).zip(&self.model)
    }

    /// Least-squares levels, and the factor of their normal matrix (ground, slopes, contrast).
    pub fn levels(&self) -> Option<(Levels, Factor<4>)> {
        let mut sums = [Lanes::default(); 5];
        for ((p, &level), Model { inside, .. }) in self.seen() {
            for (sum, term) in sums.iter_mut().zip([*inside, p.one, p.x, p.y, level]) {
                *sum = *sum + *inside * term;
            }
        }
        let [square, one, x, y, right] = sums.map(Lanes::sum);
        let [ground, along, across] = self.ground;
        let factor = Factor::new(&[
            [ground[0], 0.0, 0.0, 0.0],
            [along[0], along[1], 0.0, 0.0],
            [across[0], across[1], across[2], 0.0],
            [one, x, y, square],
        ])?;
        let [level, level_x, level_y] = self.ground_right;
        let [ground, x, y, contrast] = factor.solve(&[level, level_x, level_y, right]);
        Some((Levels { contrast, ground, slope: DVec2::new(x, y) }, factor))
    }

    /// By how much the blur should grow, by least squares together with the levels.
    pub fn blur_step(&self, blur_px: f64) -> Option<f64> {
        let per_blur = Lanes::all((1.0 / blur_px) as f32);
        let mut matrix = [[Lanes::default(); 5]; 5];
        let mut right = [Lanes::default(); 5];
        for ((p, &level), model) in self.seen() {
            // ∂Φ(-d/σ)/∂σ = φ(d/σ) d / σ²
            let wider = model.slope * model.distance * per_blur * p.one;
            let terms = [p.one, p.x, p.y, model.inside, wider];
            for i in 0..5 {
                right[i] = right[i] + terms[i] * level;
                for j in 0..=i {
                    matrix[i][j] = matrix[i][j] + terms[i] * terms[j];
                }
            }
        }
        let (matrix, right) = (matrix.map(|row| row.map(Lanes::sum)), right.map(Lanes::sum));
        let [_, _, _, contrast, wider] = Factor::new(&matrix)?.solve(&right);
        let step_px = wider / contrast;
        step_px.is_finite().then_some(step_px)
    }

    /// The normal matrix of the outline's step, less what the levels take up when they follow it (variable projection).
    pub fn matrix(&self, levels: &Factor<4>) -> Matrix {
        let mut sums = [[Lanes::default(); 5]; 5];
        let mut with_weight = [[Lanes::default(); 4]; 5];
        let mut with_slope = [[Lanes::default(); 4]; 5];
        for (p, b) in self.places.iter().zip(&self.model) {
            let slope = b.slope * p.one;
            for i in 0..5 {
                let (weighted, sloped) = (b.weight * b.basis[i], slope * b.basis[i]);
                for j in 0..=i {
                    sums[i][j] = sums[i][j] + weighted * slope * b.basis[j];
                }
                let terms = [p.one, p.x, p.y, b.inside];
                for k in 0..4 {
                    with_weight[i][k] = with_weight[i][k] + weighted * terms[k];
                    with_slope[i][k] = with_slope[i][k] + sloped * terms[k];
                }
            }
        }
        let mut matrix = sums.map(|row| row.map(Lanes::sum));
        let with_weight = with_weight.map(|row| row.map(Lanes::sum));
        let followed = with_slope.map(|row| levels.solve(&row.map(Lanes::sum)));
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
        let rows = [row(0), row(1)].map(|row| row.map(|entry| Lanes::all((entry / contrast) as f32)));
        let pulled = |b: &Model| {
            rows.map(|row| {
                let along = row.iter().zip(&b.basis).fold(Lanes::default(), |sum, (&r, &b)| sum + r * b);
                along * b.weight
            })
        };
        let mut taken = [[Lanes::default(); 4]; 2];
        for (p, b) in self.places.iter().zip(&self.model) {
            for (sums, pull) in taken.iter_mut().zip(pulled(b)) {
                for (sum, term) in sums.iter_mut().zip([p.one, p.x, p.y, b.inside]) {
                    *sum = *sum + pull * term;
                }
            }
        }
        let taken = taken.map(|sums| levels.solve(&sums.map(Lanes::sum)));
        for (p, b) in self.places.iter().zip(&self.model) {
            let pulls = pulled(b);
            for lane in (0..WIDTH).filter(|&lane| p.one.0[lane] > 0.0) {
                let terms = [p.one, p.x, p.y, b.inside].map(|lanes| f64::from(lanes.0[lane]));
                let answer = |axis: usize| {
                    let level: f64 = taken[axis].iter().zip(terms).map(|(taken, term)| taken * term).sum();
                    f64::from(pulls[axis].0[lane]) - level
                };
                each([p.x.0[lane] as i32, p.y.0[lane] as i32], DVec2::new(answer(0), answer(1)));
            }
        }
    }

    /// The weighted residuals at these levels.
    pub fn pull(&self, levels: &Levels) -> Pull {
        let [ground, along, across, contrast] =
            [levels.ground, levels.slope.x, levels.slope.y, levels.contrast].map(|l| Lanes::all(l as f32));
        let (mut right, mut square) = ([Lanes::default(); 5], Lanes::default());
        for ((p, &level), model) in self.seen() {
            let expected = p.one * ground + along * p.x + across * p.y + contrast * model.inside;
            let residual = level - expected;
            square = square + residual * residual;
            let pull = model.weight * residual;
            for (sum, &basis) in right.iter_mut().zip(&model.basis) {
                *sum = *sum + pull * basis;
            }
        }
        Pull { right: right.map(Lanes::sum), residual2: square.sum() }
    }
}
