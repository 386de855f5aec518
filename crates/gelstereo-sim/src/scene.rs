//! Scenes, as TOML and as values.

use crate::shapes::Shape;
use alloc::{string::String, vec::Vec};
use gelstereo_core::math::Pose;
use gelstereo_core::rig::Rig;

/// What there is, and which effects act.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Scene {
    /// Seed of all random streams.
    pub seed: u64,
    /// Default: `Scene::default_rig()`.
    pub rig: Rig,
    /// The gel and its lattice.
    pub gel: Gel,
    /// What presses, if anything.
    pub indenter: Option<Shape>,
    /// Poses over time, interpolated; empty means that nothing moves.
    pub trajectory: Vec<Keyframe>,
    /// Frames per second. Default: `30`.
    pub frame_rate_hz: f64,
    /// Effects that act; absent ones cost nothing.
    pub effects: Effects,
}

/// The gel and its lattice, seen from the left camera: a plane at z = `surface_mm`, facing the camera.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Gel {
    /// Default: `25`.
    pub rows: usize,
    /// Default: `25`.
    pub cols: usize,
    /// Default: `0.9` mm.
    pub pitch_mm: f64,
    /// Default: `0.22` mm.
    pub dot_radius_mm: f64,
    /// Depth of the undeformed surface. Default: `28.7` mm.
    pub surface_mm: f64,
    /// Default: `5` mm.
    pub thickness_mm: f64,
    /// Rotation of the lattice in its plane, radians. Default: `0`.
    pub rotation_rad: f64,
    /// (row, column) of markers that were not printed. Default: none.
    pub missing: Vec<[usize; 2]>,
    /// Bright dots on a dark gel. Default: `false`.
    pub bright_dots: bool,
}

/// The indenter at one time.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde())]
pub struct Keyframe {
    /// Time, seconds.
    pub time_s: f64,
    /// Contact at that time.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub contact: ContactState,
}

pub use crate::simulator::ContactState;

/// Effects; `None` is off.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Effects {
    // room owner: shoulder, shear, blur, sensor noise, uneven light, ...
}

/// A scene that makes no sense.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneError {
    /// What is wrong, what would be valid.
    pub message: String,
}

/// Identity pose, for defaults.
pub const IDENTITY: Pose = Pose::IDENTITY;
