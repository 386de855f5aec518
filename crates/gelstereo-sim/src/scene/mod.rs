//! Scenes, as TOML and as values.

mod error;
mod presets;
mod relief;

pub use crate::simulator::ContactState;
pub use error::SceneError;
pub use relief::Relief;

use crate::effects::{Effects, Optics};
use crate::plan::{Asked, Switches};
use crate::shapes::Shape;
use alloc::vec::Vec;
use gelstereo_core::camera::Camera;
use gelstereo_core::math::{DQuat, DVec2, DVec3, Pose, so3, sqrt};
use gelstereo_core::params::{Pitch, PrintLayout};
use gelstereo_core::rig::Rig;

/// Everything in a simulation, and the active effects. A file states only the differences from
/// [`Scene::default`].
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Scene {
    /// Seed of all random streams. Default: `1`.
    pub seed: u64,
    /// Frames per second. Default: `30`.
    pub frame_rate_hz: f64,
    /// Drawing method. Default: `fast`.
    pub images: Images,
    /// Stereo cameras. Default: [`Scene::default_rig`].
    pub rig: Rig,
    /// The gel and its lattice.
    pub gel: Gel,
    /// Part that presses into the gel. Default: none.
    pub indenter: Option<Shape>,
    /// Active effects; absent ones cost nothing. Default: none.
    pub effects: Effects,
    /// Requested results with their tolerances. Without it, everything is computed exactly. Default: none.
    pub asked: Option<Asked>,
    /// Switches of the effects. Default: determined by `asked`.
    pub switches: Switches,
    /// Poses of the part over time, interpolated. If empty, nothing touches the gel. Default: empty.
    pub trajectory: Vec<Keyframe>,
    /// Further parts that press into the same gel, `[[others]]` in a file. Default: none.
    pub others: Vec<OtherPart>,
    /// Motion of the gel relative to the cameras, `[[gel_motion]]` in a file, interpolated. If empty, the gel
    /// does not move. Default: empty.
    pub gel_motion: Vec<GelKeyframe>,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            seed: 1,
            frame_rate_hz: 30.0,
            images: Images::default(),
            rig: Self::default_rig(),
            gel: Gel::default(),
            indenter: None,
            effects: Effects::default(),
            asked: None,
            switches: Switches::default(),
            trajectory: Vec::new(),
            others: Vec::new(),
            gel_motion: Vec::new(),
        }
    }
}

/// A further part, with a trajectory of its own.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct OtherPart {
    /// Its shape, as [`Scene::indenter`].
    pub indenter: Shape,
    /// Its poses over time, as [`Scene::trajectory`]. Default: empty.
    #[cfg_attr(feature = "serde", serde(default))]
    pub trajectory: Vec<Keyframe>,
}

/// Methods (rungs) of drawing blurred dots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum Images {
    /// Line integrals in closed form within every dot's window.
    #[default]
    Fast,
    /// A canvas of eight by eight fine pixels per pixel, filtered by the lens: the reference, some
    /// hundred times as slow.
    Exact,
}

/// The gel and its lattice, seen from the left camera: a plane at z = `surface_mm`, facing the camera, or
/// curved by its relief.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Gel {
    /// Markers from top to bottom. Valid: 2 to 1000 markers. Default: `25`. Change it to the print that is
    /// simulated.
    pub rows: usize,
    /// Markers from left to right. Valid: 2 to 1000 markers. Default: `25`. Change it to the print that is
    /// simulated.
    pub cols: usize,
    /// How the markers stand beside each other. Default: `square`. Change it, and `params.lattice.layout`
    /// with it, to simulate a print whose markers have six neighbours.
    pub layout: PrintLayout,
    /// Whether the odd rows of a hexagonal print, counted from 0, are shifted along the row by half a pitch,
    /// or back. Default: `true`. Change it where the first row of the print that is simulated starts farther
    /// right than the second one.
    pub odd_rows_forward: bool,
    /// Distance between neighbours, or `[x, y]` of a rectangular print: along a row, and along a column.
    /// Valid: 0.001 to 1000 mm. Default: `0.9` mm. Change it to the print that is simulated, and
    /// `params.lattice.pitch_mm` with it.
    pub pitch_mm: Pitch,
    /// Radius of the dots. Valid: 0.0001 to 500 mm, below half of the smaller `pitch_mm`. Default: `0.22`
    /// mm. Change it to the print that is simulated.
    pub dot_radius_mm: f64,
    /// The lattice's centre, sensor x and y. Valid: -10000 to 10000 mm. Default: `[4, 0]` mm, between the
    /// cameras of the default rig. Change it with the rig.
    pub centre_mm: [f64; 2],
    /// Depth of the undeformed surface, more than `thickness_mm`. Valid: 0.001 to 10000 mm. Default: `28.7`
    /// mm. Change it with the rig.
    pub surface_mm: f64,
    /// Thickness of the gel. Valid: 0.001 to 1000 mm. Default: `5` mm. Change it to the gel that is
    /// simulated.
    pub thickness_mm: f64,
    /// Rotation of the lattice in its plane from x towards y, radians. Valid: -7 to 7 rad. Default: `0`.
    /// Change it to simulate a rotated print.
    pub rotation_rad: f64,
    /// (row, column), from 0, of markers that were not printed. Valid: 0 to 999, within the lattice. Default:
    /// none. Set it to simulate a print with missing dots.
    pub missing: Vec<[usize; 2]>,
    /// Bright dots on a dark gel. Default: `false`. Set it together with `params.detect.polarity`.
    pub bright_dots: bool,
    /// Grey level of the darker of dot and gel, below `bright_level`. Valid: 0 to 254 grey levels. Default:
    /// `50`. Raise it for less contrast.
    pub dark_level: u8,
    /// Grey level of the brighter of the two. Valid: 1 to 255 grey levels. Default: `170`. Lower it for less
    /// contrast.
    pub bright_level: u8,
    /// Shape of a curved gel, `[gel.relief]` in a file. Default: none, a plane. Set it to simulate a dome, a
    /// cylinder or a map of heights.
    pub relief: Option<Relief>,
}

impl Default for Gel {
    fn default() -> Self {
        Self {
            rows: 25,
            cols: 25,
            layout: PrintLayout::Square,
            odd_rows_forward: true,
            pitch_mm: Pitch::square(0.9),
            dot_radius_mm: 0.22,
            centre_mm: [4.0, 0.0],
            surface_mm: 28.7,
            thickness_mm: 5.0,
            rotation_rad: 0.0,
            missing: Vec::new(),
            bright_dots: false,
            dark_level: 50,
            bright_level: 170,
            relief: None,
        }
    }
}

/// The gel at one time: the whole lattice shifted and rotated in its plane, as when the camera shakes or
/// the gel creeps. In a file: `{ time_s = 0.5, shift_mm = [1.2, 0], rotation_rad = 0.1 }`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct GelKeyframe {
    /// Time, seconds.
    pub time_s: f64,
    /// Shift from `gel.centre_mm`, sensor x and y. Default: none.
    #[cfg_attr(feature = "serde", serde(default))]
    pub shift_mm: [f64; 2],
    /// Rotation added to `gel.rotation_rad`, about the lattice's centre, from x towards y, radians. Default:
    /// `0`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub rotation_rad: f64,
}

/// The indenter at one time.
///
/// In a file the pose is `position_mm` (the object's origin in the sensor frame) and `rotation_rad`
/// (rotation vector, default zero) or `rotation_xyzw` (unit quaternion): `{ time_s = 0.5, position_mm =
/// [4, 0, 31], rotation_rad = [0, 1.5708, 0], shear_mm = [0.5, 0] }`. A rotation that its vector does
/// not reproduce bit for bit is written as a quaternion, so writing and reading preserves the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "KeyframeFields", into = "KeyframeFields")
)]
pub struct Keyframe {
    /// Time, seconds.
    pub time_s: f64,
    /// Contact at that time.
    pub contact: ContactState,
}

/// File format of a keyframe.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
struct KeyframeFields {
    time_s: f64,
    position_mm: [f64; 3],
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    rotation_rad: Option<[f64; 3]>,
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    rotation_xyzw: Option<[f64; 4]>,
    #[cfg_attr(feature = "serde", serde(default))]
    shear_mm: [f64; 2],
    #[cfg_attr(feature = "serde", serde(default))]
    twist_rad: f64,
}

impl TryFrom<KeyframeFields> for Keyframe {
    type Error = &'static str;

    fn try_from(fields: KeyframeFields) -> Result<Self, Self::Error> {
        let rotation = match (fields.rotation_rad, fields.rotation_xyzw) {
            (vector, None) => so3::exp(DVec3::from_array(vector.unwrap_or_default())),
            (None, Some(quaternion)) => DQuat::from_array(quaternion),
            _ => return Err("a keyframe has both rotation_rad and rotation_xyzw; valid is one of them"),
        };
        let t_sensor_object = Pose { rotation, translation_mm: DVec3::from_array(fields.position_mm) };
        let KeyframeFields { time_s, shear_mm, twist_rad, .. } = fields;
        Ok(Self { time_s, contact: ContactState { t_sensor_object, shear_mm, twist_rad } })
    }
}

impl From<Keyframe> for KeyframeFields {
    fn from(Keyframe { time_s, contact }: Keyframe) -> Self {
        let ContactState { t_sensor_object, shear_mm, twist_rad } = contact;
        let rotation = t_sensor_object.rotation;
        let vector = so3::log(rotation);
        let exact = so3::exp(vector) == rotation;
        Self {
            time_s,
            position_mm: t_sensor_object.translation_mm.to_array(),
            rotation_rad: exact.then_some(vector.to_array()),
            rotation_xyzw: (!exact).then_some(rotation.to_array()),
            shear_mm,
            twist_rad,
        }
    }
}

/// Each part's heights are evaluated at every marker or cell.
const MAX_OTHERS: usize = 63;

impl Scene {
    /// Two parallel 640x480 cameras of f = 560 px, 8 mm apart.
    #[must_use]
    pub fn default_rig() -> Rig {
        let camera = Camera {
            width_px: 640,
            height_px: 480,
            fx_px: 560.0,
            fy_px: 560.0,
            cx_px: 319.5,
            cy_px: 239.5,
            distortion: [0.0; 5],
        };
        Rig::parallel(camera, 8.0)
    }

    /// Checks that the scene can be simulated.
    ///
    /// # Errors
    /// The first [`SceneError`] found. [`SceneError::MeshNeeded`] is not among them: see
    /// [`Simulator::new`](crate::Simulator::new).
    pub fn validate(&self) -> Result<(), SceneError> {
        self.rig.validate().map_err(SceneError::Rig)?;
        for camera in [&self.rig.left, &self.rig.right] {
            for side in [camera.width_px, camera.height_px] {
                SceneError::check(side <= 8192, "rig image side", side as f64, "1 to 8192 px")?;
            }
        }
        self.gel.validate()?;
        if let Some(relief) = &self.gel.relief {
            relief.validate(self.reach_mm())?;
        }
        self.check_sight()?;
        self.parts().try_for_each(|(shape, _)| shape.validate())?;
        self.effects.validate(&self.gel)?;
        self.check_switches()?;
        self.check_trajectory()
    }

    /// The indenter and the others with their trajectories, in this order: the parts by their number.
    pub fn parts(&self) -> impl Iterator<Item = (&Shape, &[Keyframe])> {
        let first = self.indenter.iter().map(|shape| (shape, &*self.trajectory));
        first.chain(self.others.iter().map(|other| (&other.indenter, &*other.trajectory)))
    }

    fn check_switches(&self) -> Result<(), SceneError> {
        self.asked.as_ref().map_or(Ok(()), Asked::validate)?;
        let listed = |effect: &str| self.effects.listed().any(|(name, _)| name == effect);
        let own = |effect: &str| Optics::ALL.iter().any(|own| own.name() == effect && own.is_in(self));
        self.switches.validate(self.asked.is_some(), |effect| listed(effect) || own(effect))
    }

    /// Largest distance of a marker, or of a cell of the elastic layer, from the lattice's centre.
    pub(crate) fn reach_mm(&self) -> f64 {
        let border =
            self.effects.elastic_layer.as_ref().map_or(0, |layer| layer.border_pitches.min(64)) as f64;
        let print_mm = self.effects.misprint.as_ref().map_or(0.0, |misprint| misprint.shift_mm);
        let beside = DVec2::from_array(self.gel.spacing_mm()) * border + DVec2::splat(print_mm);
        (self.gel.half_mm() + beside).length()
    }

    /// Both cameras must see the whole depth of the gel, and its surface must lie behind the rig's layers.
    fn check_sight(&self) -> Result<(), SceneError> {
        let gel = &self.gel;
        let corners = [[0, 0], [0, gel.cols - 1], [gel.rows - 1, 0], [gel.rows - 1, gel.cols - 1]];
        for [row, col] in corners {
            let at = gel.marker_mm(row, col);
            let [low, high] = gel.relief.as_ref().map_or([0.0; 2], |relief| relief.range_mm(self.reach_mm()));
            for z in [gel.surface_mm + high, gel.surface_mm + low - gel.thickness_mm] {
                if self.rig.project(DVec3::new(at.x, at.y, z)).is_err() {
                    return Err(SceneError::BehindCamera { row, col });
                }
            }
            let Some(layers) = &self.rig.layers else { continue };
            let plates: f64 = layers.plates.iter().map(|plate| plate.thickness_mm).sum();
            let within_mm = layers.normal.dot(at.extend(gel.surface_mm + low)) - layers.gap_mm - plates;
            if !(within_mm > 0.0) {
                return Err(SceneError::BeforeGel { row, col, within_mm });
            }
        }
        Ok(())
    }

    fn check_trajectory(&self) -> Result<(), SceneError> {
        let rate = self.frame_rate_hz;
        SceneError::check(rate > 0.0 && rate <= 1e4, "frame_rate_hz", rate, "above 0, at most 10000 Hz")?;
        let found = self.others.len();
        if self.indenter.is_none() {
            if !self.trajectory.is_empty() {
                return Err(SceneError::NothingMoves { keyframes: self.trajectory.len() });
            }
            SceneError::check(found == 0, "number of others without an indenter", found as f64, "0")?;
        }
        SceneError::check(found <= MAX_OTHERS, "number of others", found as f64, "0 to 63")?;
        for (part, (_, keyframes)) in self.parts().enumerate() {
            keyframes.iter().try_for_each(|k| k.contact.validate())?;
            let list = if part == 0 { "trajectory" } else { "a trajectory of others" };
            check_times(list, keyframes.iter().map(|k| k.time_s))?;
        }
        for k in &self.gel_motion {
            for found in k.shift_mm {
                SceneError::check(found.abs() <= 1e4, "gel_motion.shift_mm", found, "-10000 to 10000 mm")?;
            }
            let turn = k.rotation_rad;
            SceneError::check(turn.abs() <= 1e3, "gel_motion.rotation_rad", turn, "-1000 to 1000 rad")?;
        }
        check_times("gel_motion", self.gel_motion.iter().map(|k| k.time_s))?;
        let (span, max_frames) = (crate::trajectory::Trajectory::new(self).frames(), 10_000_000);
        // The frames are listed one by one.
        let listed = self.effects.dropped_frames.is_none() || span <= max_frames;
        SceneError::check(listed, "frames of a scene with dropped_frames", span as f64, "at most 10 million")
    }
}

/// Checks that keyframe times increase.
fn check_times(list: &'static str, times_s: impl Iterator<Item = f64>) -> Result<(), SceneError> {
    let mut after_s = -1.0;
    for (keyframe, time_s) in times_s.enumerate() {
        // A day is more than any scene needs and bounds the number of frames.
        if !(time_s > after_s && (0.0..=86_400.0).contains(&time_s)) {
            return Err(SceneError::KeyframeTime { list, keyframe, time_s, after_s: after_s.max(0.0) });
        }
        after_s = time_s;
    }
    Ok(())
}

impl Gel {
    /// Rest position of a marker, sensor x and y.
    #[must_use]
    pub fn marker_mm(&self, row: usize, col: usize) -> DVec2 {
        crate::lattice::Lattice::new(self).marker_mm(DVec2::from_array(self.centre_mm), row, col)
    }

    /// Distance of neighbours along a row, and of neighbouring rows.
    pub(crate) fn spacing_mm(&self) -> [f64; 2] {
        let [x_mm, y_mm] = self.pitch_mm.axes_mm();
        match self.layout {
            PrintLayout::Square => [x_mm, y_mm],
            PrintLayout::Hexagonal => [x_mm, 0.5 * sqrt(3.0) * x_mm],
        }
    }

    /// Distance of nearest neighbours.
    pub(crate) fn least_pitch_mm(&self) -> f64 {
        self.pitch_mm.x_mm.min(self.pitch_mm.y_mm)
    }

    /// Half the lattice's extent along a row and along a column.
    pub(crate) fn half_mm(&self) -> DVec2 {
        let [x_mm, y_mm] = self.spacing_mm();
        let shifted = if self.layout == PrintLayout::Hexagonal { 0.5 } else { 0.0 };
        let beside = |count: usize| (count - 1) as f64;
        DVec2::new((beside(self.cols) + shifted) * (0.5 * x_mm), beside(self.rows) * (0.5 * y_mm))
    }

    fn validate(&self) -> Result<(), SceneError> {
        let check = SceneError::check;
        for (name, side) in [("gel.rows", self.rows), ("gel.cols", self.cols)] {
            check((2..=1000).contains(&side), name, side as f64, "2 to 1000 markers")?;
        }
        let lengths = [
            ("gel.pitch_mm", self.pitch_mm.x_mm, 1e-3, "0.001 to 1000 mm"),
            ("gel.pitch_mm", self.pitch_mm.y_mm, 1e-3, "0.001 to 1000 mm"),
            ("gel.dot_radius_mm", self.dot_radius_mm, 1e-4, "0.0001 to 1000 mm"),
            ("gel.thickness_mm", self.thickness_mm, 1e-3, "0.001 to 1000 mm"),
        ];
        for (name, found, low, valid) in lengths {
            check(found >= low && found <= 1e3, name, found, valid)?;
        }
        let [x_mm, y_mm] = self.pitch_mm.axes_mm();
        let is_hexagonal = self.layout == PrintLayout::Hexagonal;
        let name = "second gel.pitch_mm of gel.layout = \"hexagonal\"";
        check(!is_hexagonal || x_mm == y_mm, name, y_mm, "one pitch, the distance of nearest markers")?;
        let (radius, surface) = (self.dot_radius_mm, self.surface_mm);
        check(
            2.0 * radius < self.least_pitch_mm(),
            "gel.dot_radius_mm",
            radius,
            "below half of gel.pitch_mm",
        )?;
        let apart = surface > self.thickness_mm && surface <= 1e4;
        check(apart, "gel.surface_mm", surface, "above gel.thickness_mm, at most 10000 mm")?;
        for found in self.centre_mm {
            check(found.abs() <= 1e4, "gel.centre_mm", found, "-10000 to 10000 mm")?;
        }
        let turn = self.rotation_rad;
        check(turn.abs() <= 7.0, "gel.rotation_rad", turn, "-7 to 7 rad")?;
        let (dark, bright) = (self.dark_level, self.bright_level);
        check(dark < bright, "gel.dark_level", f64::from(dark), "below gel.bright_level")?;
        let outside = |&&[row, col]: &&[usize; 2]| row >= self.rows || col >= self.cols;
        match self.missing.iter().find(outside) {
            Some(&[row, col]) => Err(SceneError::NoSuchMarker { row, col, rows: self.rows, cols: self.cols }),
            None => Ok(()),
        }
    }
}
