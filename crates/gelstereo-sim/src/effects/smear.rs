//! Patches that temporarily hide markers.

use crate::plan::{Bound, Effect, Facts};
use crate::render::Ellipse;
use crate::scene::{Gel, Scene, SceneError};
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::{DVec2, ceil, cos, floor, random::Stream, sin, sqrt};

/// Streaks of reflected light, and dirt: soft-edged bright or dark ellipses on the image that come and
/// go.
///
/// In a file: `[effects.smears] random = 4`, or patches one by one: `[[effects.smears.patches]]
/// centre_px = [320, 240]`. Limit: a patch is static in the image while it lasts, and its rim does not
/// depend on the scene.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Smears {
    /// Patches given one by one. Default: none.
    pub patches: Vec<Patch>,
    /// Number of random patches per view. Place, direction, brightness, size (half of `half_size_px` to all
    /// of it) and start are uniformly distributed over the image and the sequence. Default: `0`.
    pub random: usize,
    /// Largest half length and half width of random patches. Default: `[40, 8]` px.
    pub half_size_px: [f64; 2],
    /// Duration of a random patch. Default: `0.2` s.
    pub lasting_s: f64,
}

impl Default for Smears {
    fn default() -> Self {
        Self { patches: Vec::new(), random: 0, half_size_px: [40.0, 8.0], lasting_s: 0.2 }
    }
}

impl Effect for Smears {
    fn validate(&self, _gel: &Gel) -> Result<(), SceneError> {
        let check = SceneError::check;
        let random = self.random;
        check(random <= MOST, "effects.smears.random", random as f64, "0 to 1000 patches")?;
        check_size("effects.smears.half_size_px", self.half_size_px)?;
        let lasting = self.lasting_s;
        check(
            lasting > 0.0 && lasting <= 86_400.0,
            "effects.smears.lasting_s",
            lasting,
            "above 0 to 86400 s",
        )?;
        let listed = self.patches.len();
        check(listed <= MOST, "number of effects.smears.patches", listed as f64, "0 to 1000 patches")?;
        self.patches.iter().try_for_each(Patch::validate)
    }

    fn bound(&self, facts: &Facts<'_>) -> Bound {
        let [low, high] = facts.levels();
        let largest_change = |level: u8, opacity: f64| {
            opacity * (f64::from(level) - low).abs().max((f64::from(level) - high).abs())
        };
        let drawn = if self.random > 0 { largest_change(0, 1.0).max(largest_change(255, 1.0)) } else { 0.0 };
        // Overlapping patches each cover their share of what is still visible.
        let listed =
            self.patches.iter().map(|patch| largest_change(patch.level, patch.opacity)).fold(0.0, f64::max);
        Bound::of_levels(drawn.max(listed))
    }

    fn cost_ns(&self, facts: &Facts<'_>) -> f64 {
        // Both views; a random patch is in one of them.
        let area_px = |[a, b]: [f64; 2]| 4.0 * a * b;
        let listed: f64 = self.patches.iter().map(|patch| 2.0 * area_px(patch.half_size_px)).sum();
        let drawn = 2.0 * self.random as f64 * area_px(self.half_size_px);
        25.0 * (listed + drawn).min(facts.pixels())
    }
}

/// One patch.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Patch {
    /// Views in which it appears. Default: `both`.
    pub views: Views,
    /// Column and row of its centre. Default: `[320, 240]` px.
    pub centre_px: [f64; 2],
    /// Half length and half width; the patch is transparent beyond them. Default: `[40, 8]` px.
    pub half_size_px: [f64; 2],
    /// Direction of its length, from the image's x towards y, radians. Default: `0`.
    pub rotation_rad: f64,
    /// Fraction of the half size over which it fades from full opacity to nothing. Default: `0.5`.
    pub soft_share: f64,
    /// Grey level of the patch. Default: `255`.
    pub level: u8,
    /// Opacity. Default: `1`, opaque.
    pub opacity: f64,
    /// Start time. Default: `0` s.
    pub from_s: f64,
    /// End time, exclusive. Default: a day.
    pub until_s: f64,
}

impl Default for Patch {
    fn default() -> Self {
        Self {
            views: Views::Both,
            centre_px: [320.0, 240.0],
            half_size_px: [40.0, 8.0],
            rotation_rad: 0.0,
            soft_share: 0.5,
            level: 255,
            opacity: 1.0,
            from_s: 0.0,
            until_s: 86_400.0,
        }
    }
}

/// Which of the two images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Views {
    /// The left one.
    Left,
    /// The right one.
    Right,
    /// Both.
    #[default]
    Both,
}

/// Limits the run time; no real gel has more patches.
const MOST: usize = 1000;

fn check_size(name: &'static str, size: [f64; 2]) -> Result<(), SceneError> {
    size.into_iter()
        .try_for_each(|half| SceneError::check((0.5..=1e4).contains(&half), name, half, "0.5 to 10000 px"))
}

impl Patch {
    fn validate(&self) -> Result<(), SceneError> {
        let check = SceneError::check;
        for c in self.centre_px {
            check(c.abs() <= 1e5, "effects.smears.patches.centre_px", c, "-100000 to 100000 px")?;
        }
        check_size("effects.smears.patches.half_size_px", self.half_size_px)?;
        let turn = self.rotation_rad;
        check(turn.abs() <= 7.0, "effects.smears.patches.rotation_rad", turn, "-7 to 7 rad")?;
        for (name, share) in [
            ("effects.smears.patches.soft_share", self.soft_share),
            ("effects.smears.patches.opacity", self.opacity),
        ] {
            check((0.0..=1.0).contains(&share), name, share, "0 to 1")?;
        }
        let (from, until) = (self.from_s, self.until_s);
        check((0.0..=86_400.0).contains(&from), "effects.smears.patches.from_s", from, "0 to 86400 s")?;
        check(until > from, "effects.smears.patches.until_s", until, "after from_s")
    }

    fn at_random(smears: &Smears, stream: &mut Stream, camera: &Camera, [start_s, end_s]: [f64; 2]) -> Self {
        let mut between = |low: f64, high: f64| low + (high - low) * stream.uniform();
        let centre_px =
            [between(-0.5, camera.width_px as f64 - 0.5), between(-0.5, camera.height_px as f64 - 0.5)];
        let half_size_px = smears.half_size_px.map(|half| between(0.5 * half, half));
        let rotation_rad = between(0.0, core::f64::consts::PI);
        let from_s = between(start_s, end_s);
        let level = if between(0.0, 1.0) < 0.5 { 0 } else { 255 };
        let until_s = from_s + smears.lasting_s;
        Self { centre_px, half_size_px, rotation_rad, level, from_s, until_s, ..Self::default() }
    }
}

/// The patches of one view.
#[derive(Clone, Debug)]
pub(crate) struct SmearsOfView(Vec<Ready>);

/// A patch with its precomputed direction.
#[derive(Clone, Debug)]
struct Ready {
    patch: Patch,
    centre: DVec2,
    axis: DVec2,
}

impl SmearsOfView {
    /// View 0 is the left one. Random patches begin within the sequence's `span_s`.
    pub(crate) fn new(
        smears: &Smears,
        scene: &Scene,
        view: usize,
        camera: &Camera,
        span_s: [f64; 2],
    ) -> Self {
        let mut stream = Stream::new(Digest::new().u64(scene.seed).u64(view as u64).value(), "smears");
        let other = [Views::Right, Views::Left][view];
        let listed = smears.patches.iter().filter(|patch| patch.views != other).cloned();
        let drawn = (0..smears.random).map(|_| Patch::at_random(smears, &mut stream, camera, span_s));
        let ready = |patch: Patch| Ready {
            centre: DVec2::from_array(patch.centre_px),
            axis: DVec2::new(cos(patch.rotation_rad), sin(patch.rotation_rad)),
            patch,
        };
        Self(listed.chain(drawn).map(ready).collect())
    }

    fn present(&self, time_s: f64) -> impl Iterator<Item = &Ready> {
        self.0.iter().filter(move |ready| (ready.patch.from_s..ready.patch.until_s).contains(&time_s))
    }

    /// Blends the patches present at that time over a row of the view, in their order.
    pub(crate) fn apply(&self, time_s: f64, y: usize, row: &mut [f32]) {
        for ready in self.present(time_s) {
            let reach = ready.reach_px();
            if (y as f64 - ready.centre.y).abs() > reach.y {
                continue;
            }
            let (low, high) = (ceil(ready.centre.x - reach.x), floor(ready.centre.x + reach.x) + 1.0);
            let (low, high) = (low.max(0.0) as usize, (high.max(0.0) as usize).min(row.len()));
            for x in low..high {
                let opacity = ready.opacity(DVec2::new(x as f64, y as f64)) as f32;
                row[x] += (f32::from(ready.patch.level) - row[x]) * opacity;
            }
        }
    }

    /// Whether a patch may touch the dot: the dot's centre lies in the box around a patch, widened by
    /// the dot's reach and its border pixels. (A widened ellipse would miss dots beside a thin patch.)
    pub(crate) fn reach(&self, outline: &Ellipse, time_s: f64) -> bool {
        let more = outline.reach_px().max_element() + 1.0;
        self.present(time_s).any(|ready| {
            let [a, b] = ready.patch.half_size_px;
            ready.offset(outline.centre_px).abs().cmplt(DVec2::new(a, b) + more).all()
        })
    }
}

impl Ready {
    /// Half the size of the patch's bounding box.
    fn reach_px(&self) -> DVec2 {
        let [a, b] = self.patch.half_size_px;
        let along = |c: f64, s: f64| sqrt(a * a * c * c + b * b * s * s);
        DVec2::new(along(self.axis.x, self.axis.y), along(self.axis.y, self.axis.x))
    }

    /// A pixel's offsets from the patch's centre along its length and its width, px.
    fn offset(&self, at: DVec2) -> DVec2 {
        let from = at - self.centre;
        DVec2::new(from.dot(self.axis), self.axis.perp_dot(from))
    }

    /// A cubic step from 1 to 0 over the soft part.
    fn opacity(&self, at: DVec2) -> f64 {
        let inside = 1.0 - (self.offset(at) / DVec2::from_array(self.patch.half_size_px)).length();
        let soft = self.patch.soft_share;
        if inside <= 0.0 {
            return 0.0;
        }
        let t = if inside < soft { inside / soft } else { 1.0 };
        self.patch.opacity * t * t * (3.0 - 2.0 * t)
    }
}
