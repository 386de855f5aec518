//! What a small window around an expected position shows, at a glance: one marker, nothing, or something else.
//!
//! Light, threshold and moments come from the window alone, by loops of fixed length over rows of whole
//! numbers, which compile to vector code. What is not clearly one marker is left to those who look closer
//! ([`super::near`]).

mod eyes;
mod lanes;

use super::band::Frame;
use crate::image::GrayView;
use crate::math::DVec2;
pub(super) use eyes::Eyes;
use lanes::{Weights, darkest, moments, products, step_up, sum_columns, weigh};

/// Most rows and columns of a window.
pub const MOST_SIDE_PX: usize = 32;

/// Gel around a marker, beyond its outline, that takes part in its centre: its blurred edge.
const EDGE_PX: f64 = 2.5;

/// Room for a marker beside its expected position, beyond its edge, pixels to both sides together.
const SLACK_PX: f64 = 3.0;

/// Smaller markers, which stand closer together, have less of both: weights end where a fifth of the contrast is left
/// ([`BAND`]), within a pixel of the outline.
const SMALL_RADIUS_PX: f64 = 1.8;
const SMALL_EDGE_AND_SLACK_PX: (f64, f64) = (1.25, 2.0);

/// A centre farther from the window's middle is looked at again, from a window around it.
const OFF_PX: f64 = 1.0;

/// Windows tried for one position.
const TRIES: usize = 3;

/// Contrasts that count, as shares of that of the window's darkest pixel: noise of the gel lies below, grain
/// of the paint above.
const BAND: (f64, f64) = (0.2, 0.7);

/// Contrasts of less than this share of the usual one are no marker; and no marker has less than the second.
const SHARES_OF_USUAL: (f64, f64) = (0.3, 0.45);

/// Corners whose levels differ by more than this share of the contrast: a shadow, a smear, another marker.
const MOST_UNEVEN: f64 = 0.35;
/// A component's mean position is so near to its marker's centre: simulated, 0.4 px at noise 2, 0.6 px at noise 18; two markers that
/// nearly touch have theirs 2.5 px or more from their middle.
const MOST_OFF_PX: f64 = 1.0;

/// Shares of the usual area that a marker may have.
const SHARES_OF_AREA: (f64, f64) = (0.4, 2.0);

/// A disc's second moment about its centre is area / 2 pi in each axis together; ellipses of 1 : 2 have 1.25
/// times as much, two pieces more.
const MOST_SPREAD: f64 = 1.35;

/// What blur adds to it, px².
const BLUR_PX2: f64 = 1.0;

/// Fractional bits of levels.
const BITS: u32 = 3;

/// Markers of one size, and the windows around them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// Rows and columns of a window.
    pub side_px: usize,
    /// Usual marker's radius.
    pub radius_px: f64,
    /// Least and largest area of a marker.
    pub area_px2: (u32, u32),
}

impl Kind {
    /// For markers of a usual area; `None` where they are too large for a window.
    #[must_use]
    pub fn of(usual_area_px2: f64) -> Option<Self> {
        let radius_px = crate::math::sqrt(usual_area_px2.max(0.0) * core::f64::consts::FRAC_1_PI);
        let (edge_px, slack_px) = edge_and_slack_px(radius_px);
        let side_px = crate::math::floor(2.0 * (radius_px + edge_px) + slack_px);
        if !(usual_area_px2 > 0.0 && side_px <= MOST_SIDE_PX as f64) {
            return None;
        }
        let area = |share: f64| (share * usual_area_px2) as u32;
        let area_px2 = (area(SHARES_OF_AREA.0).max(1), area(SHARES_OF_AREA.1));
        Some(Self { side_px: side_px as usize, radius_px, area_px2 })
    }

    /// Whether a window about one marker ends before its neighbours' edges when they stand a pitch away.
    #[must_use]
    pub fn fits(&self, pitch_px: f64) -> bool {
        let (edge_px, _) = edge_and_slack_px(self.radius_px);
        self.side_px as f64 <= 2.0 * (pitch_px - self.radius_px) - edge_px
    }

    /// Whether windows are at most 16 pixels wide.
    pub(super) const fn is_small(&self) -> bool {
        self.side_px <= 16
    }

    pub(super) fn usual_area_px2(&self) -> f64 {
        core::f64::consts::PI * self.radius_px * self.radius_px
    }

    /// A square with this side holds no two markers' centres: they would overlap by half.
    pub(super) const fn cell_px(&self) -> f64 {
        self.radius_px.max(1.0)
    }

    /// Side of the squares in a window's corners where the gel's level is taken.
    const fn corner_px(&self) -> usize {
        if self.side_px < 15 { 2 } else { self.side_px / 5 }
    }
}

fn edge_and_slack_px(radius_px: f64) -> (f64, f64) {
    if radius_px < SMALL_RADIUS_PX { SMALL_EDGE_AND_SLACK_PX } else { (EDGE_PX, SLACK_PX) }
}

/// A marker in a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Centre weighted by contrast, pixels.
    pub centre_px: DVec2,
    /// Pixels darker than half way.
    pub area_px2: u32,
    /// Contrast over which a pixel's weight grows, grey levels.
    pub band: u8,
}

/// What a window shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Glance {
    /// One marker, whole, with gel all around.
    Marker(Spot),
    /// Gel.
    Nothing,
    /// Something else.
    Unclear,
}

/// Steepest gel, 1 / 256 level per pixel.
const MOST_SLOPE: i32 = 256;

/// The gel of a window as a plane, and its darkest pixel.
#[derive(Clone, Copy, Debug)]
struct Gel {
    /// In the middle, with [`BITS`].
    level: i32,
    /// Slopes along a row and down, 1 / 256 level per pixel.
    along: i32,
    down: i32,
    /// Of the corners, from the darkest to the brightest, with [`BITS`].
    uneven: i32,
    /// Contrast of the darkest pixel, with [`BITS`].
    depth: i32,
}

impl Gel {
    /// Contrast from which weights begin, with [`BITS`], and over which they grow, grey levels.
    fn band(&self) -> (i32, u8) {
        let share = |share: f64| (share * f64::from(self.depth)) as i32;
        (share(BAND.0), (share(BAND.1 - BAND.0) >> BITS).clamp(1, 255) as u8)
    }
}

/// Where a window lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place<const L: usize> {
    /// First column and row.
    first: (usize, usize),
    /// Column of the first lane; the window's own begin with it, or later where the image ends.
    begin: usize,
    side: usize,
}

impl<const L: usize> Place<L> {
    /// The window whose middle is nearest to a position, or nearest within the image.
    fn around(at_px: DVec2, side: usize, (width, height): (usize, usize)) -> Option<Self> {
        // From 32 bits: there is an instruction.
        let float = |size: usize| f64::from(size as u32);
        let inside = |at: f64, size: usize| at >= 0.0 && at <= float(size) - 1.0;
        if width < L || height < side || side > L || !inside(at_px.x, width) || !inside(at_px.y, height) {
            return None;
        }
        let half = 0.5 * (float(side) - 2.0);
        let first = |at: f64, size: usize| (at - half).clamp(0.0, float(size - side)) as u32 as usize;
        let first = (first(at_px.x, width), first(at_px.y, height));
        Some(Self { first, begin: first.0.min(width - L), side })
    }

    const fn lane(&self) -> usize {
        self.first.0 - self.begin
    }

    fn middle_px(&self) -> DVec2 {
        DVec2::new(self.first.0 as f64, self.first.1 as f64) + 0.5 * (self.side as f64 - 1.0)
    }
}

/// Which lanes belong to a window, and to its corners.
#[derive(Clone, Copy, Debug)]
struct Lanes<const L: usize> {
    /// All ones, or nothing.
    inside: [u8; L],
    /// One, or nothing.
    left: [i16; L],
    right: [i16; L],
}

impl<const L: usize> Lanes<L> {
    /// Of windows that begin with this lane.
    fn of(lane: usize, kind: &Kind) -> Self {
        let within = |first: usize, end: usize| -> [u8; L] {
            let (rise, fall) = (step_up::<L>(lane + first), step_up::<L>(lane + end));
            core::array::from_fn(|x| rise[x] & !fall[x])
        };
        let (side, corner) = (kind.side_px, kind.corner_px());
        let ones = |first: usize| within(first, first + corner).map(|on| i16::from(on & 1));
        Self { inside: within(0, side), left: ones(0), right: ones(side - corner) }
    }
}

/// A window's pixels, dark markers on a bright gel.
struct Window<'a, const L: usize> {
    place: Place<L>,
    lanes: &'a Lanes<L>,
    rows: &'a mut [[u8; L]],
}

/// Where a window's pixels are kept.
struct Room<const L: usize> {
    rows: [[u8; L]; L],
    /// Unless they are the usual ones.
    lanes: Option<Lanes<L>>,
}

impl<const L: usize> Room<L> {
    const fn new() -> Self {
        Self { rows: [[0; L]; L], lanes: None }
    }
}

impl<const L: usize> Window<'_, L> {
    /// The gel by the window's corners, squares of `corner` pixels.
    fn gel(&self, corner: usize) -> Gel {
        let far = self.place.side - corner;
        let darkest = darkest(self.rows, &self.lanes.inside);
        let sums = |first: usize| {
            let columns = sum_columns(&self.rows[first..first + corner]);
            (products(&columns, &self.lanes.left), products(&columns, &self.lanes.right))
        };
        let ((a, b), (c, d)) = (sums(0), sums(far));
        let area = (corner * corner) as i32;
        let per_px =
            |difference: i32| ((difference << 8) / (2 * area * far as i32)).clamp(-MOST_SLOPE, MOST_SLOPE);
        let level = ((a + b + c + d) << BITS) / (4 * area);
        let uneven = ((a.max(b).max(c).max(d) - a.min(b).min(c).min(d)) << BITS) / area;
        let depth = (level - (i32::from(darkest) << BITS)).max(0);
        Gel { level, along: per_px(b + d - a - c), down: per_px(c + d - a - b), uneven, depth }
    }

    /// Weights of the window's pixels: how much darker than the gel, less `low`, at most `band`.
    fn weigh(&mut self, gel: &Gel, (low, band): (i32, u8)) -> Weights<L> {
        let (lane, side) = (self.place.lane() as i32, self.place.side as i32);
        // Of the brightest row; the others are less by a whole number of levels. All these numbers fit 16 bits.
        let brightest = (gel.level - low + ((side * gel.down.abs()) >> (9 - BITS))) as i16;
        let (along, before) = (gel.along as i16, (gel.along * (2 * lane + side - 1)) as i16);
        let limit: [u8; L] = core::array::from_fn(|x| {
            let along = (2 * x as i16 * along - before) >> (9 - BITS);
            ((brightest + along) >> BITS).clamp(0, 255) as u8 & self.lanes.inside[x]
        });
        let added = side * gel.down.abs() + (side - 1) * gel.down;
        weigh(self.rows, &limit, (added, 2 * gel.down), band);
        Weights::of(self.rows)
    }
}

/// What the weights of a window add up to.
struct Outline {
    centre_px: DVec2,
    area_px2: f64,
    /// Sum of the variances along both axes, px².
    spread_px2: f64,
    /// Something reaches the window's outermost pixels.
    touches: bool,
    band: u8,
}

impl Outline {
    fn spot(&self) -> Spot {
        let area_px2 = crate::math::round(self.area_px2) as u32;
        Spot { centre_px: self.centre_px, area_px2, band: self.band }
    }
}

impl<const L: usize> Weights<L> {
    fn outline(&self, place: &Place<L>, band: u8) -> Outline {
        let sum: i32 = self.columns.iter().map(|&weight| i32::from(weight)).sum();
        let per = 1.0 / f64::from(sum.max(1));
        let (x, variance_x) = moments(&self.columns, per);
        let (y, variance_y) = moments(&self.rows, per);
        let (lane, last) = (place.lane(), place.side - 1);
        let rim = [self.columns[lane], self.columns[lane + last], self.rows[0], self.rows[last]];
        Outline {
            centre_px: DVec2::new(place.begin as f64 + x, place.first.1 as f64 + y),
            area_px2: f64::from(sum) / f64::from(band),
            spread_px2: variance_x + variance_y,
            touches: rim.into_iter().any(|sum| sum > i16::from(band)),
            band,
        }
    }
}

/// Where a window came to rest.
enum Settled {
    /// Around what it shows.
    At(Gel, Outline),
    /// On gel.
    Nothing,
    /// Nowhere.
    Lost,
}

/// Looks at single windows.
#[derive(Clone, Copy, Debug)]
pub struct Eye<const L: usize> {
    kind: Kind,
    /// 255 where markers are bright.
    flip: u8,
    /// Of windows that do not reach the image's right border.
    lanes: Lanes<L>,
}

impl<const L: usize> Eye<L> {
    /// For markers of one kind.
    #[must_use]
    pub fn new(kind: Kind, flip: u8) -> Self {
        Self { kind, flip, lanes: Lanes::of(0, &kind) }
    }

    fn window<'a>(
        &'a self,
        image: &GrayView<'_>,
        at_px: DVec2,
        room: &'a mut Room<L>,
    ) -> Option<Window<'a, L>> {
        let place = Place::around(at_px, self.kind.side_px, (image.width(), image.height()))?;
        let Room { rows, lanes } = room;
        *lanes = (place.lane() > 0).then(|| Lanes::of(place.lane(), &self.kind));
        let rows = &mut rows[..place.side];
        image.copy_lanes((place.begin, place.first.1), rows);
        if self.flip != 0 {
            rows.as_flattened_mut().iter_mut().for_each(|level| *level ^= self.flip);
        }
        Some(Window { place, lanes: lanes.as_ref().unwrap_or(&self.lanes), rows })
    }

    fn gel(&self, window: &Window<'_, L>) -> Gel {
        window.gel(self.kind.corner_px())
    }

    /// The kind of marker.
    #[must_use]
    pub const fn kind(&self) -> &Kind {
        &self.kind
    }

    /// The usual contrast around positions, grey levels: their mean, each weighted by its square, so that
    /// empty places carry none.
    pub fn usual_contrast<'p>(
        &self,
        image: GrayView<'_>,
        positions_px: impl Iterator<Item = &'p DVec2>,
    ) -> f64 {
        let (mut squares, mut cubes) = (0_u64, 0_u64);
        let mut room = Room::new();
        for &at_px in positions_px {
            let Some(window) = self.window(&image, at_px, &mut room) else { continue };
            let depth = self.gel(&window).depth as u64;
            squares += depth * depth;
            cubes += depth * depth * depth;
        }
        cubes as f64 / (squares.max(1) << BITS) as f64
    }

    /// What is seen around a position in an image of this usual contrast.
    #[must_use]
    pub fn look(&self, image: GrayView<'_>, at_px: DVec2, usual_contrast: f64) -> Glance {
        let share_of_usual = |share: f64| (share * f64::from(1 << BITS) * usual_contrast) as i32;
        let least = share_of_usual(SHARES_OF_USUAL.0);
        match self.settle(&image, at_px, least) {
            Settled::Nothing => Glance::Nothing,
            Settled::Lost => Glance::Unclear,
            Settled::At(gel, outline) => {
                let faint = gel.depth < share_of_usual(SHARES_OF_USUAL.1);
                let uneven = gel.uneven > share_of_usual(MOST_UNEVEN);
                if faint || uneven { Glance::Unclear } else { self.decide(&outline) }
            }
        }
    }

    /// The marker about its component's mean position, if it lies whole in a window around it.
    /// None farther than a pixel away: a window upon two markers that nearly touch settles in their middle.
    #[must_use]
    pub fn centre(&self, image: GrayView<'_>, at_px: DVec2) -> Option<Spot> {
        self.outline_about(&image, at_px).map(|outline| outline.spot())
    }

    /// As [`Self::centre`], of the size and shape of one marker.
    #[must_use]
    pub fn single(&self, image: GrayView<'_>, at_px: DVec2) -> Option<Spot> {
        match self.decide(&self.outline_about(&image, at_px)?) {
            Glance::Marker(spot) => Some(spot),
            Glance::Nothing | Glance::Unclear => None,
        }
    }

    fn outline_about(&self, image: &GrayView<'_>, at_px: DVec2) -> Option<Outline> {
        match self.settle(image, at_px, 1) {
            Settled::At(gel, outline)
                if !outline.touches
                    && f64::from(gel.uneven) < MOST_UNEVEN * f64::from(gel.depth)
                    && outline.centre_px.distance_squared(at_px) < MOST_OFF_PX * MOST_OFF_PX =>
            {
                Some(outline)
            }
            _ => None,
        }
    }

    /// The pixels of the window around a marker's centre: of each, its squared distance from that, and how much darker it is than
    /// where weights begin, as a share of the band over which they grow. `None` outside the image, and without contrast.
    pub(super) fn shares(
        &self,
        image: GrayView<'_>,
        centre_px: DVec2,
        mut each: impl FnMut(f64, f64),
    ) -> Option<Frame> {
        let mut room = Room::new();
        let window = self.window(&image, centre_px, &mut room)?;
        let (place, gel) = (window.place, self.gel(&window));
        let (side, corner) = (place.side, self.kind.corner_px());
        let (unit, depth) = (f64::from(1 << BITS), f64::from(gel.depth));
        let (low, band) = (BAND.0 * depth / unit, (BAND.1 - BAND.0) * depth / unit);
        if !(band >= 1.0) {
            return None;
        }
        let gel_level = f64::from(gel.level) / unit;
        let (along, down) = (f64::from(gel.along) / 256.0, f64::from(gel.down) / 256.0);
        let (middle, per_band) = (0.5 * (side as f64 - 1.0), 1.0 / band);
        let off = DVec2::new(place.first.0 as f64, place.first.1 as f64) - centre_px;
        for (y, row) in window.rows.iter().enumerate() {
            let (y, y_off) = (y as f64, y as f64 + off.y);
            let begins = gel_level - low + down * (y - middle) - along * middle;
            for (x, &level) in row[place.lane()..][..side].iter().enumerate() {
                let (x, x_off) = (x as f64, x as f64 + off.x);
                each(x_off * x_off + y_off * y_off, (begins + along * x - f64::from(level)) * per_band);
            }
        }
        let (corner_px, apart_px) = (corner as f64, (side - corner) as f64);
        Some(Frame { band, gel_level, gel_share: -low * per_band, corner_px, apart_px })
    }

    /// Moves the window until what it shows lies in its middle.
    fn settle(&self, image: &GrayView<'_>, at_px: DVec2, least_depth: i32) -> Settled {
        let (mut middle_px, mut room) = (at_px, Room::new());
        for _ in 0..TRIES {
            let Some(mut window) = self.window(image, middle_px, &mut room) else { return Settled::Lost };
            let (place, gel) = (window.place, self.gel(&window));
            if gel.depth < least_depth {
                return Settled::Nothing;
            }
            let (low, band) = gel.band();
            let outline = window.weigh(&gel, (low, band)).outline(&place, band);
            if (outline.centre_px - place.middle_px()).abs().max_element() <= OFF_PX {
                return Settled::At(gel, outline);
            }
            middle_px = outline.centre_px;
        }
        Settled::Lost
    }

    fn decide(&self, outline: &Outline) -> Glance {
        let disc_px2 = outline.area_px2 * (0.5 * core::f64::consts::FRAC_1_PI);
        let Spot { area_px2, .. } = outline.spot();
        let (least_px2, most_px2) = self.kind.area_px2;
        if outline.touches || area_px2 > most_px2 || outline.spread_px2 > MOST_SPREAD * disc_px2 + BLUR_PX2 {
            Glance::Unclear
        } else if area_px2 < least_px2 {
            Glance::Nothing
        } else {
            Glance::Marker(outline.spot())
        }
    }
}
