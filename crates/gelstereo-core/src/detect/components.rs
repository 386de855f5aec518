//! Connected components of a mask: runs joined by union-find.

use crate::math::linalg::Symmetric;
use alloc::vec::Vec;

/// A maximal stretch of set pixels in one row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Row.
    pub y: u32,
    /// First column.
    pub start: u32,
    /// One past the last column.
    pub end: u32,
    /// A run of the same component that stands earlier in raster order, or itself.
    parent: u32,
    /// The next run of the same component, or `NO_RUN`.
    next: u32,
}

const NO_RUN: u32 = u32::MAX;

/// An 8-connected component, with the sums from which its centroid follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Blob {
    /// Pixels.
    pub area_px2: u32,
    /// Sum of the pixels' columns.
    pub sum_x: u64,
    /// Sum of the pixels' rows.
    pub sum_y: u64,
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Last column.
    pub right: u32,
    /// Last row.
    pub bottom: u32,
    first_run: u32,
    last_run: u32,
}

/// Labelling and its scratch.
#[derive(Clone, Debug, Default)]
pub struct Components {
    runs: Vec<Run>,
    /// Blob of each run that is the first of its component.
    blob_of: Vec<u32>,
    blobs: Vec<Blob>,
}

impl Components {
    /// Components of `mask`, rows of `width` bytes that are 0 outside of components, in the raster order of their
    /// first pixels. Scratch is reserved for the worst mask of the size.
    pub fn run(&mut self, mask: &[u8], width: usize) -> &[Blob] {
        let rows = mask.chunks_exact(width.max(1));
        let (most_runs, most_blobs) =
            (rows.len() * width.div_ceil(2), rows.len().div_ceil(2) * width.div_ceil(2));
        self.runs.clear();
        self.runs.reserve(most_runs);
        let mut above = 0..0;
        for (y, row) in (0_u32..).zip(rows) {
            let first = self.runs.len();
            self.push_runs(row, y);
            self.join(above, first..self.runs.len());
            above = first..self.runs.len();
        }
        self.blob_of.clear();
        self.blob_of.resize(self.runs.len(), 0);
        self.blob_of.reserve(most_runs - self.runs.len());
        self.blobs.clear();
        self.blobs.reserve(most_blobs);
        for index in 0..self.runs.len() {
            let root = self.root(index as u32) as usize;
            if root == index {
                self.blob_of[index] = self.blobs.len() as u32;
                self.blobs.push(Blob::starting_at(index as u32));
            }
            let blob = &mut self.blobs[self.blob_of[root] as usize];
            blob.add(&self.runs[index]);
            if root != index {
                self.runs[blob.last_run as usize].next = index as u32;
                blob.last_run = index as u32;
            }
        }
        &self.blobs
    }

    /// The components of the last mask.
    #[must_use]
    pub fn blobs(&self) -> &[Blob] {
        &self.blobs
    }

    /// The runs of one of [`Self::blobs`], in raster order.
    pub fn runs(&self, blob: &Blob) -> impl Iterator<Item = &Run> + Clone {
        let at = |index: u32| self.runs.get(index as usize);
        core::iter::successors(at(blob.first_run), move |run| at(run.next))
    }

    fn push_runs(&mut self, row: &[u8], y: u32) {
        let mut x = 0;
        while let Some(start) = first_set(row, x) {
            let end = row[start..].iter().position(|&m| m == 0).map_or(row.len(), |len| start + len);
            let parent = self.runs.len() as u32;
            self.runs.push(Run { y, start: start as u32, end: end as u32, parent, next: NO_RUN });
            x = end;
        }
    }

    /// Joins runs of one row with those of the row above that touch them, also by a corner.
    fn join(&mut self, above: core::ops::Range<usize>, here: core::ops::Range<usize>) {
        let (mut i, mut j) = (above.start, here.start);
        while i < above.end && j < here.end {
            let (a, b) = (self.runs[i], self.runs[j]);
            if a.start <= b.end && b.start <= a.end {
                let (a, b) = (self.root(i as u32), self.root(j as u32));
                self.runs[a.max(b) as usize].parent = a.min(b);
            }
            if a.end < b.end {
                i += 1;
            } else {
                j += 1;
            }
        }
    }

    /// The first run of a run's component; paths are halved on the way.
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
    const fn starting_at(run: u32) -> Self {
        Self {
            area_px2: 0,
            sum_x: 0,
            sum_y: 0,
            left: u32::MAX,
            top: u32::MAX,
            right: 0,
            bottom: 0,
            first_run: run,
            last_run: run,
        }
    }

    /// Four times the covariance of the component's pixels, given its runs: for an ellipse the matrix whose eigenvalues
    /// are its squared semi-axes, px².
    #[must_use]
    pub fn spread_px2<'a>(&self, runs: impl Iterator<Item = &'a Run>) -> Symmetric<2> {
        let area = i64::from(self.area_px2);
        // Twice the coordinates about the middle of the bounding box, as in the grey centroid.
        let (mid_x, mid_y) = (i64::from(self.left + self.right), i64::from(self.top + self.bottom));
        let (mut u, mut v, mut uu, mut uv, mut vv) = (0_i64, 0_i64, 0_i64, 0_i64, 0_i64);
        for run in runs {
            let len = i64::from(run.end - run.start);
            let middle = i64::from(run.start + run.end) - 1 - mid_x;
            let y = 2 * i64::from(run.y) - mid_y;
            u += middle * len;
            v += y * len;
            // Σ (middle + j)² over j = -(len - 1), -(len - 3), ..., len - 1
            uu += middle * middle * len + len * (len * len - 1) / 3;
            uv += middle * y * len;
            vv += y * y * len;
        }
        let per = 1.0 / (area * area) as f64;
        // A pixel is itself 1/12 px² wide, 1/3 here.
        let entry = |ab: i64, a: i64, b: i64| (area * ab - a * b) as f64 * per;
        [[entry(uu, u, u) + 1.0 / 3.0, entry(uv, u, v)], [entry(uv, u, v), entry(vv, v, v) + 1.0 / 3.0]]
    }

    fn add(&mut self, run: &Run) {
        let (start, end, y, len) =
            (u64::from(run.start), u64::from(run.end), u64::from(run.y), run.end - run.start);
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

/// Column of the first non-zero byte from `x` on; most of a mask is empty, so it is read eight bytes at a time.
fn first_set(row: &[u8], x: usize) -> Option<usize> {
    let mut from = x;
    for word in row[x..].chunks_exact(8) {
        if word != [0; 8] {
            break;
        }
        from += 8;
    }
    row[from..].iter().position(|&m| m != 0).map(|offset| from + offset)
}
