//! Window classifier: whether a small window around an expected position shows one marker, gel or
//! something else.
//!
//! Gel level, threshold and moments come from the window alone. Loops of fixed length over rows of
//! integers compile to vector code.

use super::lanes::{Weights, moments};
use super::pixels::{BAND, BITS, Corners, Gel, Lanes, Place, Room, Window, flip};
use super::size::MarkerSize;
use crate::image::GrayView;
use crate::math::DVec2;
use crate::params::Polarity;

/// If the centre is farther from the window's middle, the window is moved onto it and evaluated again.
const OFF_PX: f64 = 1.0;

/// Windows tried per position.
const TRIES: usize = 3;

/// Contrasts as shares of the usual one: below the first the window is gel, below the second it shows no
/// marker.
const SHARES_OF_USUAL: (f64, f64) = (0.3, 0.45);

/// Largest difference between corner levels as a share of the contrast; more is a shadow, a smear or
/// another marker.
const MAX_UNEVEN: f64 = 0.35;

/// Largest distance of a component's mean position from its marker's centre. Simulated: 0.4 px at noise
/// 2, 0.6 px at noise 18. For two markers that nearly touch, it is 2.5 px or more from their midpoint.
const MAX_OFF_PX: f64 = 1.0;

/// Largest second moment relative to a disc's, which is area / 2 pi for both axes together. Ellipses of
/// 1 : 2 have 1.25 times as much, two components more.
const MAX_SPREAD: f64 = 1.35;

/// Added second moment by blur, px².
const BLUR_PX2: f64 = 1.0;

/// Marker found in a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowMarker {
    /// Contrast-weighted centre, pixels.
    pub centre_px: DVec2,
    /// Pixels above half the contrast.
    pub area_px2: u32,
    /// Contrast range over which a pixel's weight grows, grey levels.
    pub band: u8,
}

/// Gel and contrast of a window around a marker; the gel is measured in the window's corners.
#[derive(Clone, Copy, Debug)]
pub(in crate::detect) struct Frame {
    /// Contrast range over which a pixel's weight grows, grey levels.
    pub band: f64,
    /// Grey level of the gel.
    pub gel_level: f64,
    /// Value of noise-free gel as a share of the band; negative.
    pub gel_share: f64,
    /// Side of the corner squares, and the distance between them, pixels.
    pub corner_px: f64,
    pub apart_px: f64,
}

/// Content of a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WindowClass {
    /// One whole marker surrounded by gel.
    Marker(WindowMarker),
    /// Gel.
    Empty,
    /// Something else.
    Unclear,
}

/// Moments of a window's weights.
struct Outline {
    centre_px: DVec2,
    area_px2: f64,
    /// Sum of the variances along both axes, px².
    spread_px2: f64,
    /// Whether something reaches the window's outermost pixels.
    touches: bool,
    band: u8,
}

impl Outline {
    fn marker(&self) -> WindowMarker {
        // Rounded; no area is close enough to a half for the sum's rounding to matter.
        let area_px2 = (self.area_px2 + 0.5) as u32;
        WindowMarker { centre_px: self.centre_px, area_px2, band: self.band }
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

/// Result of moving a window onto its content.
enum Settled {
    /// Centred on its content.
    At(Gel, Outline),
    /// Gel only.
    Nothing,
    /// Outside the image, or not centred after all tries.
    Lost,
}

/// Classifies single windows.
#[derive(Clone, Copy, Debug)]
pub struct WindowClassifier<const L: usize> {
    size: MarkerSize,
    /// 255 if markers are bright.
    flip: u8,
    /// Lanes of windows that do not reach the image's right border.
    lanes: Lanes<L>,
    corners: Corners,
}

impl<const L: usize> WindowClassifier<L> {
    /// Creates the classifier for markers of one size.
    #[must_use]
    pub fn new(size: MarkerSize, polarity: Polarity) -> Self {
        Self { size, flip: flip(polarity), lanes: Lanes::of(0, &size), corners: Corners::of(&size) }
    }

    #[inline(always)]
    fn window<'a>(
        &'a self,
        image: &GrayView<'_>,
        at_px: DVec2,
        room: &'a mut Room<L>,
    ) -> Option<Window<'a, L>> {
        let place = Place::around(at_px, self.size.side_px, (image.width(), image.height()))?;
        let Room { rows, lanes } = room;
        *lanes = (place.lane() > 0).then(|| Lanes::of(place.lane(), &self.size));
        let rows = &mut rows[..place.side];
        image.copy_lanes((place.begin, place.first.1), rows);
        if self.flip != 0 {
            rows.as_flattened_mut().iter_mut().for_each(|level| *level ^= self.flip);
        }
        Some(Window { place, lanes: lanes.as_ref().unwrap_or(&self.lanes), rows })
    }

    fn gel(&self, window: &Window<'_, L>) -> Gel {
        window.gel(&self.corners)
    }

    /// The marker size.
    #[must_use]
    pub const fn size(&self) -> &MarkerSize {
        &self.size
    }

    /// Usual contrast around positions, grey levels: the mean contrast weighted by its square, so that
    /// empty windows have negligible weight.
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

    /// Classifies the windows around positions in an image of this usual contrast.
    pub fn look_at_all(
        &self,
        image: GrayView<'_>,
        positions_px: &[DVec2],
        usual_contrast: f64,
        mut see: impl FnMut(usize, WindowClass),
    ) {
        let share_of_usual = |share: f64| (share * f64::from(1 << BITS) * usual_contrast) as i32;
        let [nothing, faint] = [SHARES_OF_USUAL.0, SHARES_OF_USUAL.1].map(share_of_usual);
        let (uneven, mut room) = (share_of_usual(MAX_UNEVEN), Room::new());
        for (position, &at_px) in positions_px.iter().enumerate() {
            let glance = match self.settle(&image, at_px, nothing, &mut room) {
                Settled::Nothing => WindowClass::Empty,
                Settled::At(gel, outline) if gel.depth >= faint && gel.uneven <= uneven => {
                    self.decide(&outline)
                }
                Settled::Lost | Settled::At(..) => WindowClass::Unclear,
            };
            see(position, glance);
        }
    }

    /// Marker around its component's mean position, if it lies entirely in a window there. `None` if its
    /// centre is over a pixel away: a window over two nearly touching markers settles between them.
    #[must_use]
    pub fn centre(&self, image: GrayView<'_>, at_px: DVec2) -> Option<WindowMarker> {
        self.outline_about(&image, at_px).map(|outline| outline.marker())
    }

    /// As [`Self::centre`], but only if it has the size and shape of one marker.
    #[must_use]
    pub fn single(&self, image: GrayView<'_>, at_px: DVec2) -> Option<WindowMarker> {
        match self.decide(&self.outline_about(&image, at_px)?) {
            WindowClass::Marker(marker) => Some(marker),
            WindowClass::Empty | WindowClass::Unclear => None,
        }
    }

    fn outline_about(&self, image: &GrayView<'_>, at_px: DVec2) -> Option<Outline> {
        match self.settle(image, at_px, 1, &mut Room::new()) {
            Settled::At(gel, outline)
                if !outline.touches
                    && f64::from(gel.uneven) < MAX_UNEVEN * f64::from(gel.depth)
                    && outline.centre_px.distance_squared(at_px) < MAX_OFF_PX * MAX_OFF_PX =>
            {
                Some(outline)
            }
            _ => None,
        }
    }

    /// Passes each pixel of the window around a marker's centre to `each`: its squared distance from the
    /// centre, and its contrast above the weights' lower limit as a share of the band. `None` outside the
    /// image or without contrast.
    pub(in crate::detect) fn shares(
        &self,
        image: GrayView<'_>,
        centre_px: DVec2,
        mut each: impl FnMut(f64, f64),
    ) -> Option<Frame> {
        let mut room = Room::new();
        let window = self.window(&image, centre_px, &mut room)?;
        let (place, gel) = (window.place, self.gel(&window));
        let (side, corner) = (place.side, self.size.corner_px());
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

    /// Moves the window until its content is centred.
    fn settle(&self, image: &GrayView<'_>, at_px: DVec2, min_depth: i32, room: &mut Room<L>) -> Settled {
        let mut middle_px = at_px;
        for _ in 0..TRIES {
            let Some(mut window) = self.window(image, middle_px, room) else { return Settled::Lost };
            let (place, gel) = (window.place, self.gel(&window));
            if gel.depth < min_depth {
                return Settled::Nothing;
            }
            let (low, band) = gel.band();
            let outline = window.weigh(&gel, low, band).outline(&place, band);
            if (outline.centre_px - place.middle_px()).abs().max_element() <= OFF_PX {
                return Settled::At(gel, outline);
            }
            middle_px = outline.centre_px;
        }
        Settled::Lost
    }

    fn decide(&self, outline: &Outline) -> WindowClass {
        let disc_px2 = outline.area_px2 * (0.5 * core::f64::consts::FRAC_1_PI);
        let WindowMarker { area_px2, .. } = outline.marker();
        let (min_px2, max_px2) = self.size.area_px2;
        if outline.touches || area_px2 > max_px2 || outline.spread_px2 > MAX_SPREAD * disc_px2 + BLUR_PX2 {
            WindowClass::Unclear
        } else if area_px2 < min_px2 {
            WindowClass::Empty
        } else {
            WindowClass::Marker(outline.marker())
        }
    }
}
