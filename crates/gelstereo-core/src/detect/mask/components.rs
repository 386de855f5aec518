//! Connected components of a mask: runs joined by union-find.

use super::bit_rows::{BitRow, bits};
use crate::image::GrayView;
use crate::math::DVec2;
use crate::math::linalg::Symmetric;
use alloc::vec::Vec;

/// Maximal run of set pixels in one row. Columns and rows of an image fit 16 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Row.
    pub y: u16,
    /// First column.
    pub start: u16,
    /// One past the last column.
    pub end: u16,
    /// Earlier run of the same component in raster order, or itself; after `finish`, the blob.
    parent: u32,
    /// Next run of the same component, or `NO_RUN`; before `finish`, a pixel count.
    next: u32,
}

impl Run {
    /// Run that belongs to no union-find tree.
    pub(in crate::detect) const fn alone(y: u16, start: u16, end: u16) -> Self {
        Self { y, start, end, parent: 0, next: NO_RUN }
    }
}

const NO_RUN: u32 = u32::MAX;

/// Blob index of a component that is not kept.
const NO_BLOB: u32 = u32::MAX;

/// 8-connected component with the sums that give its centroid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Blob {
    /// Pixels.
    pub area_px2: u32,
    /// Sum of the pixels' columns.
    pub sum_x: u64,
    /// Sum of the pixels' rows.
    pub sum_y: u64,
    /// First column.
    pub left: u16,
    /// First row.
    pub top: u16,
    /// Last column.
    pub right: u16,
    /// Last row.
    pub bottom: u16,
    first_run: u32,
}

/// Connected-component labelling with its scratch.
#[derive(Clone, Debug)]
pub struct Components {
    runs: Vec<Run>,
    blobs: Vec<Blob>,
    /// Components with fewer pixels are left out.
    min_px2: u32,
    /// Number of components of at least that area, and the limit on how many of them are listed.
    kept: usize,
    max_kept: usize,
    /// Rows pushed.
    rows: u16,
    /// First run of the last row pushed.
    above: usize,
    /// Components of the rows pushed.
    count: usize,
}

/// Limits on runs and components of an image of markers. Memory is reserved for these, not for every
/// second pixel. Images up to 128 x 128 cannot exceed them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Runs: one per 8 pixels; 65536 from half a megapixel on; one per 16 pixels from one megapixel on.
    /// Runs are longer in images of higher resolution.
    pub runs: usize,
    /// Components: one per 16 pixels.
    pub components: usize,
    /// Kept components: one per 32 pixels, at most 16384.
    pub kept: usize,
}

impl Limits {
    /// Limits of an image of this size.
    #[must_use]
    pub fn of(width: usize, height: usize) -> Self {
        let pixels = width * height;
        Self {
            runs: (height * width.div_ceil(2)).min((pixels / 8).clamp(8192, (pixels / 16).max(65536))),
            components: (height.div_ceil(2) * width.div_ceil(2)).min((pixels / 16).max(4096)),
            kept: (height.div_ceil(2) * width.div_ceil(2)).min((pixels / 32).clamp(4096, 16384)),
        }
    }
}

impl Default for Components {
    fn default() -> Self {
        Self::keeping(1)
    }
}

impl Components {
    /// Leaves out components of fewer than `min_px2` pixels, so that noise specks use no memory.
    #[must_use]
    pub const fn keeping(min_px2: u32) -> Self {
        Self {
            runs: Vec::new(),
            blobs: Vec::new(),
            min_px2,
            kept: 0,
            max_kept: 0,
            rows: 0,
            above: 0,
            count: 0,
        }
    }

    /// Components of a mask of 0 and 255, in raster order of their first pixels, without a limit on their
    /// number.
    pub fn run(&mut self, mask: GrayView<'_>) -> &[Blob] {
        self.start(mask.width(), mask.height());
        self.max_kept = usize::MAX;
        (0..mask.height()).for_each(|y| self.push(mask.row(y)));
        self.finish()
    }

    /// Starts a mask of this size. Scratch is reserved for [`Limits`] runs and components, and grows for
    /// more.
    pub(in crate::detect) fn start(&mut self, width: usize, height: usize) {
        let max = Limits::of(width, height);
        self.runs.clear();
        // The caller checks the limit at the end of each row.
        self.runs.reserve(max.runs + width.div_ceil(2));
        self.blobs.clear();
        self.blobs.reserve(max.kept);
        (self.kept, self.max_kept) = (0, max.kept);
        (self.rows, self.above, self.count) = (0, 0, 0);
    }

    /// Sets the pixels of `row` whose column is covered by a component in any of these image rows. One
    /// mask pixel is `scale` columns and rows of the image.
    pub fn cover(&self, rows: core::ops::RangeInclusive<usize>, scale: usize, row: &mut BitRow) {
        let (start, end) = (*rows.start() / scale, *rows.end() / scale);
        let first = self.runs.partition_point(|run| (run.y as usize) < start);
        for run in self.runs[first..].iter().take_while(|run| run.y as usize <= end) {
            row.set(run.start as usize * scale..run.end as usize * scale);
        }
    }

    /// Components of the rows so far; later rows may join some.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Adds the next row, bytes of 0 or 255.
    pub(in crate::detect) fn push(&mut self, row: &[u8]) {
        let (above, first) = (self.above, self.runs.len());
        self.push_runs(row, self.rows);
        self.join(above..first, first..self.runs.len());
        (self.rows, self.above) = (self.rows + 1, first);
    }

    /// Completes the labelling and returns the kept components of the rows pushed.
    pub(in crate::detect) fn finish(&mut self) -> &[Blob] {
        for index in 0..self.runs.len() {
            let Run { start, end, parent, .. } = self.runs[index];
            // The parent is this run or an earlier one, whose root is already resolved.
            let root = self.runs[parent as usize].parent;
            self.runs[index].parent = root;
            self.runs[root as usize].next += u32::from(end - start);
        }
        for index in 0..self.runs.len() {
            // The blob of earlier runs is already resolved.
            let Run { parent, next: area_px2, .. } = self.runs[index];
            let blob = if parent as usize == index {
                self.open(area_px2)
            } else {
                self.runs[parent as usize].parent
            };
            self.runs[index].parent = blob;
            if let Some(blob) = self.blobs.get_mut(blob as usize) {
                blob.add(&self.runs[index]);
            }
        }
        // Linked in reverse order, so that a blob needs no pointer to its last run.
        for (index, run) in (0..self.runs.len() as u32).zip(&mut self.runs).rev() {
            if let Some(blob) = self.blobs.get_mut(run.parent as usize) {
                run.next = core::mem::replace(&mut blob.first_run, index);
            }
        }
        &self.blobs
    }

    /// Opens the blob of a component whose first run this is.
    fn open(&mut self, area_px2: u32) -> u32 {
        if area_px2 < self.min_px2 {
            return NO_BLOB;
        }
        self.kept += 1;
        if self.kept > self.max_kept {
            return NO_BLOB;
        }
        self.blobs.push(Blob::EMPTY);
        self.blobs.len() as u32 - 1
    }

    /// Components of the last mask that are large enough; those beyond [`Limits::kept`] are counted only.
    #[must_use]
    pub const fn kept(&self) -> usize {
        self.kept
    }

    /// All runs of the last mask, in raster order.
    #[must_use]
    pub fn all_runs(&self) -> &[Run] {
        &self.runs
    }

    /// Kept components of the last mask.
    #[must_use]
    pub fn blobs(&self) -> &[Blob] {
        &self.blobs
    }

    /// Runs of one of [`Self::blobs`], in raster order.
    pub fn runs(&self, blob: &Blob) -> impl Iterator<Item = &Run> + Clone {
        let at = |index: u32| self.runs.get(index as usize);
        core::iter::successors(at(blob.first_run), move |run| at(run.next))
    }

    /// Appends a row's runs, 64 pixels at a time since most of a mask is empty.
    fn push_runs(&mut self, row: &[u8], y: u16) {
        let (wholes, rest) = row.as_chunks::<64>();
        let mut last = [0; 64];
        last[..rest.len()].copy_from_slice(rest);
        // Column at which the open run starts.
        let mut open = None;
        for (x, pixels) in (0_u32..).step_by(64).zip(wholes.iter().chain((!rest.is_empty()).then_some(&last)))
        {
            if open.is_none() && pixels.iter().fold(0, |any, &pixel| any | pixel) == 0 {
                continue;
            }
            let (words, _) = pixels.as_chunks::<8>();
            let set =
                (0..).step_by(8).zip(words).fold(0, |set, (at, &word)| set | u64::from(bits(word)) << at);
            let mut edges = set ^ (set << 1 | u64::from(open.is_some()));
            while edges != 0 {
                let at = (x + edges.trailing_zeros()) as u16;
                edges &= edges - 1;
                open = match open {
                    None => Some(at),
                    Some(start) => {
                        self.close(y, start, at);
                        None
                    }
                };
            }
        }
        if let Some(start) = open {
            self.close(y, start, row.len() as u16);
        }
    }

    fn close(&mut self, y: u16, start: u16, end: u16) {
        let parent = self.runs.len() as u32;
        self.runs.push(Run { y, start, end, parent, next: 0 });
        self.count += 1;
    }

    /// Joins the runs of one row with those of the row above that touch them (8-connectivity).
    fn join(&mut self, above: core::ops::Range<usize>, here: core::ops::Range<usize>) {
        let (mut i, mut j) = (above.start, here.start);
        while i < above.end && j < here.end {
            let (a, b) = (self.runs[i], self.runs[j]);
            if a.start <= b.end && b.start <= a.end {
                let (a, b) = (self.root(i as u32), self.root(j as u32));
                self.runs[a.max(b) as usize].parent = a.min(b);
                self.count -= usize::from(a != b);
            }
            if a.end < b.end {
                i += 1;
            } else {
                j += 1;
            }
        }
    }

    /// First run of a run's component, with path halving.
    fn root(&mut self, mut run: u32) -> u32 {
        loop {
            let parent = self.runs[run as usize].parent;
            if parent == run {
                return run;
            }
            let grandparent = self.runs[parent as usize].parent;
            self.runs[run as usize].parent = grandparent;
            run = grandparent;
        }
    }
}

impl Blob {
    /// Mean position of the pixels.
    #[must_use]
    pub fn mean_px(&self) -> DVec2 {
        let area = f64::from(self.area_px2);
        DVec2::new(self.sum_x as f64 / area, self.sum_y as f64 / area)
    }

    pub(in crate::detect) const EMPTY: Self = Self {
        area_px2: 0,
        sum_x: 0,
        sum_y: 0,
        left: u16::MAX,
        top: u16::MAX,
        right: 0,
        bottom: 0,
        first_run: NO_RUN,
    };

    /// Sums of the first and last column, and of the first and last row: twice the centre of the bounding
    /// box.
    pub(in crate::detect) fn ends(&self) -> (i64, i64) {
        (i64::from(self.left) + i64::from(self.right), i64::from(self.top) + i64::from(self.bottom))
    }

    /// Width and height of the bounding box, pixels.
    pub(in crate::detect) fn size(&self) -> (u32, u32) {
        (u32::from(self.right - self.left) + 1, u32::from(self.bottom - self.top) + 1)
    }

    /// Four times the covariance of the component's pixels, given its runs, px². For an ellipse, its
    /// eigenvalues are the squared semi-axes.
    #[must_use]
    pub fn spread_px2<'a>(&self, runs: impl Iterator<Item = &'a Run>) -> Symmetric<2> {
        let area = i64::from(self.area_px2);
        // Twice the coordinates about the centre of the bounding box, as in the intensity-weighted centroid.
        let (mid_x, mid_y) = self.ends();
        let (mut u, mut v, mut uu, mut uv, mut vv) = (0_i64, 0_i64, 0_i64, 0_i64, 0_i64);
        for run in runs {
            let len = i64::from(run.end - run.start);
            let middle = i64::from(run.start) + i64::from(run.end) - 1 - mid_x;
            let y = 2 * i64::from(run.y) - mid_y;
            u += middle * len;
            v += y * len;
            // Σ (middle + j)² over j = -(len - 1), -(len - 3), ..., len - 1
            uu += middle * middle * len + len * (len * len - 1) / 3;
            uv += middle * y * len;
            vv += y * y * len;
        }
        let per = 1.0 / (area * area) as f64;
        // A pixel's own variance is 1/12 px², here times 4.
        let entry = |ab: i64, a: i64, b: i64| (area * ab - a * b) as f64 * per;
        [[entry(uu, u, u) + 1.0 / 3.0, entry(uv, u, v)], [entry(uv, u, v), entry(vv, v, v) + 1.0 / 3.0]]
    }

    /// Whether it reaches the outermost pixels of an image of this size, across (x, y).
    #[must_use]
    pub const fn sides_reached(&self, size_px: (usize, usize)) -> (bool, bool) {
        (
            self.left == 0 || self.right as usize + 1 == size_px.0,
            self.top == 0 || self.bottom as usize + 1 == size_px.1,
        )
    }

    pub(in crate::detect) fn add(&mut self, run: &Run) {
        let (start, end, y, len) =
            (u64::from(run.start), u64::from(run.end), u64::from(run.y), u32::from(run.end - run.start));
        self.area_px2 += len;
        // start + (start + 1) + ... + (end - 1)
        self.sum_x += (start + end - 1) * u64::from(len) / 2;
        self.sum_y += y * u64::from(len);
        self.left = self.left.min(run.start);
        self.right = self.right.max(run.end - 1);
        self.top = self.top.min(run.y);
        self.bottom = self.bottom.max(run.y);
    }
}
