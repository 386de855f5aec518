//! Errors of a scene.

use crate::layer::LayerError;
use alloc::string::String;
use gelstereo_core::rig::RigError;

/// Why a scene cannot be simulated.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneError {
    /// Invalid camera rig.
    Rig(RigError),
    /// Invalid elastic layer.
    Layer(LayerError),
    /// A number is outside its range.
    Invalid {
        /// Its place in the file, for example `gel.pitch_mm`.
        name: &'static str,
        /// Value found.
        found: f64,
        /// Valid values.
        valid: &'static str,
    },
    /// A list names a marker that the lattice does not have.
    NoSuchMarker {
        /// Row named.
        row: usize,
        /// Column named.
        col: usize,
        /// Rows of the lattice.
        rows: usize,
        /// Columns of the lattice.
        cols: usize,
    },
    /// A corner of the gel lies behind a camera.
    BehindCamera {
        /// The corner marker's row.
        row: usize,
        /// Its column.
        col: usize,
    },
    /// A corner of the gel's surface lies in front of the medium that the rig's layers define as the
    /// gel.
    BeforeGel {
        /// The corner marker's row.
        row: usize,
        /// Its column.
        col: usize,
        /// Its distance behind the last interface.
        within_mm: f64,
    },
    /// The elastic layer is listed together with an approximation of it.
    TwoModels {
        /// The approximation.
        effect: &'static str,
    },
    /// An effect refines the elastic layer, which is not listed.
    NeedsLayer {
        /// The effect.
        effect: &'static str,
    },
    /// A contact with a history needs an elastic layer without relaxation.
    NeedsHistory,
    /// Keyframes without an indenter.
    NothingMoves {
        /// Keyframes found.
        keyframes: usize,
    },
    /// A keyframe is not later than the previous one, or not within a day.
    KeyframeTime {
        /// The list.
        list: &'static str,
        /// Index of the keyframe, from 0.
        keyframe: usize,
        /// Its time.
        time_s: f64,
        /// Time of the previous keyframe, or 0.
        after_s: f64,
    },
    /// A switch is on for an effect that the scene does not have.
    NothingToSwitchOn {
        /// The effect.
        effect: &'static str,
    },
    /// An effect is on auto, but the scene states no requirement.
    NothingAsked {
        /// The effect.
        effect: &'static str,
    },
    /// A part is a mesh file whose triangles were not passed.
    MeshNeeded {
        /// The file.
        path: String,
    },
    /// Triangles were passed for a part that is not a mesh file.
    MeshNotNeeded,
}

impl core::fmt::Display for SceneError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Rig(error) => write!(f, "rig: {error}"),
            Self::Layer(error) => write!(f, "effects.elastic_layer: {error}"),
            Self::Invalid { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::NoSuchMarker { row, col, rows, cols } => write!(
                f,
                "the scene names marker [{row}, {col}], but the lattice has {rows} rows and {cols} columns \
                 (counted from 0)"
            ),
            Self::BehindCamera { row, col } => write!(
                f,
                "marker [{row}, {col}] can come to lie behind a camera; move gel.surface_mm away or check \
                 rig.t_right_left"
            ),
            Self::BeforeGel { row, col, within_mm } => write!(
                f,
                "marker [{row}, {col}] is {within_mm} mm behind the last interface of rig.layers; valid is \
                 above 0: move gel.surface_mm away or make the layers thinner"
            ),
            Self::TwoModels { effect } => write!(
                f,
                "effects.{effect} approximates what effects.elastic_layer computes; remove one of them (the \
                 layer takes the place of shoulder, spread and drag)"
            ),
            Self::NeedsLayer { effect } => write!(
                f,
                "effects.{effect} refines effects.elastic_layer, which the scene does not list; add it or \
                remove effects.{effect}"
            ),
            Self::NeedsHistory => write!(
                f,
                "a part that moves on from its last pose needs effects.elastic_layer without \
                 effects.relaxation; add the layer, or press each pose by itself"
            ),
            Self::NothingMoves { keyframes } => write!(
                f,
                "the trajectory has {keyframes} keyframes but there is no indenter; add [indenter] or remove \
                them"
            ),
            Self::KeyframeTime { list, keyframe, time_s, after_s } => write!(
                f,
                "keyframe {keyframe} of {list} is at {time_s} s; valid is later than the one before \
                 ({after_s} s), at least 0 and at most 86400 s"
            ),
            Self::NothingToSwitchOn { effect } => write!(
                f,
                "switches.{effect} is \"on\" but the scene has no {effect}; list it under [effects] \
                 (refraction and lens_distortion: give the rig layers or a distortion)"
            ),
            Self::NothingAsked { effect } => write!(
                f,
                "switches.{effect} is \"auto\" but nothing is asked of the scene; add for example asked = \
                 {{ kind = \"positions\", tolerance_px = 0.01 }}, or switch it on or off"
            ),
            Self::MeshNeeded { path } => {
                write!(f, "a part is the mesh file {path:?}; read it and hand its triangles over, in mm")
            }
            Self::MeshNotNeeded => write!(
                f,
                "triangles were passed for a part that is not a mesh file; use kind = \"mesh\" or leave them \
                out"
            ),
        }
    }
}

impl core::error::Error for SceneError {}

impl SceneError {
    pub(crate) fn check(
        ok: bool,
        name: &'static str,
        found: f64,
        valid: &'static str,
    ) -> Result<(), SceneError> {
        if ok { Ok(()) } else { Err(Self::Invalid { name, found, valid }) }
    }
}
