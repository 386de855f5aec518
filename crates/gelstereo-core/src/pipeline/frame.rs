//! Results of one stereo frame.

use crate::digest::Digest;
use crate::force::Wrench;
use crate::math::linalg::Symmetric;
use crate::math::{DVec2, DVec3};
use crate::params::Centre;
use crate::register::Contact;
use crate::slip::{Slip, Stick};
use crate::track::MarkerState;
use alloc::vec::Vec;

/// Source of the rows and columns of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum LabelSource {
    /// The rest frame's lattice.
    #[default]
    Rest,
    /// Foresight sort of this frame.
    Foresight,
    /// The tracks since the rest frame.
    Tracks,
    /// Tracks verified against the lattice and found certain.
    Lattice,
    /// None: no labels were certain, and all markers are held.
    Held,
}

/// Where a view's markers were searched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Searched {
    /// In the whole image.
    #[default]
    Whole,
    /// In windows around the predicted positions. With labels [`LabelSource::Held`], these were not
    /// sufficient, and the frame's limit left no time to search the whole image as well.
    Windows,
}

/// Evidence from one view of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ViewEvidence {
    /// Markers detected.
    pub detected: usize,
    /// Source of the labels; `Tracks` under `label.method = foresight` means that the sort failed.
    pub labels: LabelSource,
    /// Markers whose label from the sort differs from that of their track.
    pub relabelled: usize,
    /// Where markers were searched; `Whole` under `detect.search = windows` means that windows were not
    /// sufficient.
    pub searched: Searched,
    /// Centring rung of the markers.
    #[cfg_attr(feature = "serde", serde(default))]
    pub centre: Centre,
    /// Whether that is cheaper than the settings' own, because the frame had a limit.
    #[cfg_attr(feature = "serde", serde(default))]
    pub is_degraded: bool,
}

/// All results of one stereo frame. Marker `row * cols + col` has that index in every list.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Frame {
    /// Frames since the last reset, from 0 (the rest frame, even if it is a recorded one).
    pub index: u64,
    /// Markers from top to bottom, as found in the rest frame.
    pub rows: usize,
    /// Markers from left to right, as found in the rest frame.
    pub cols: usize,
    /// Positions in the left image, pixels.
    pub left_px: Vec<DVec2>,
    /// Positions in the right image, pixels.
    pub right_px: Vec<DVec2>,
    /// States; seen only if both views saw the marker and agree on its identity.
    pub state: Vec<MarkerState>,
    /// Positions in the sensor frame, millimetres; for a marker that is not seen, from its last good
    /// positions.
    pub points_mm: Vec<DVec3>,
    /// Covariances of the points, mm²; for a marker that is not seen, from when it last was.
    pub covariance_mm2: Vec<Symmetric<3>>,
    /// Height above the rest surface, towards the camera, millimetres.
    pub indentation_mm: Vec<f64>,
    /// Saliency by the method of `contact.saliency`: indented by more than the threshold (Eq. 4), or by
    /// pressure.
    pub salient: Vec<bool>,
    /// Salient and in the contact patch, which is the input of registration.
    pub patch: Vec<bool>,
    /// Tractions that the part exerts on the gel around each marker, kilopascals along the sensor's axes;
    /// empty without `force.method`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub traction_kpa: Vec<DVec3>,
    /// Their force and torque; `None` without contact, or without `force.method`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub wrench: Option<Wrench>,
    /// Whether the gel around each marker moves with the part; empty without `slip.method`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub stick: Vec<Stick>,
    /// Slip of the contact; `None` without contact, or without `slip.method`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub slip: Option<Slip>,
    /// Decay length used to detect the contact, over which the gel returns to rest beside it,
    /// millimetres: `contact.decay_mm`, or the value learned since.
    pub decay_mm: f64,
    /// Standard deviation of an error along the gel's normal that all points share, millimetres:
    /// `lattice.depth_sigma_mm`. `covariance_mm2` leaves it out, and the covariance of a pose includes it.
    #[cfg_attr(feature = "serde", serde(default))]
    pub offset_sigma_mm: f64,
    /// Mean motion of the seen markers of the left view since the reference, pixels.
    pub motion_px: f64,
    /// Markers seen in both views that correspond to no point in space (rows or disparity disagree), or
    /// to none on the gel's surface (labels of the views have slipped relative to each other, see
    /// [`StereoMismatch`](crate::contact::StereoMismatch)).
    pub mismatched: usize,
    /// Predicted work, in units of 1000 instructions of a baseline x86-64 processor.
    #[cfg_attr(feature = "serde", serde(default))]
    pub work: u64,
    /// The limit to which it was fitted.
    #[cfg_attr(feature = "serde", serde(default))]
    pub work_limit: Option<u64>,
    /// The left view's evidence.
    pub left: ViewEvidence,
    /// The right view's evidence.
    pub right: ViewEvidence,
}

impl Frame {
    /// Digest of all results, bit for bit. Work and its limit are no results.
    #[must_use]
    pub fn digest(&self) -> u64 {
        let view = |digest: Digest, view: &ViewEvidence| {
            let searched = view.searched as u64 | u64::from(view.is_degraded) << 8;
            let sources = view.labels as u64 | searched << 32;
            digest.u64(view.detected as u64).u64(sources).u64(view.relabelled as u64)
        };
        let digest = Digest::new()
            .u64(self.index)
            .u64(self.rows as u64)
            .u64(self.cols as u64)
            .f64s(self.left_px.iter().chain(&self.right_px).flat_map(|p| p.to_array()))
            .f64s(self.points_mm.iter().flat_map(|p| p.to_array()))
            .f64s(self.covariance_mm2.iter().flatten().flatten().copied())
            .f64s(self.indentation_mm.iter().copied())
            .f64s([self.motion_px])
            .u64(self.mismatched as u64);
        let digest = self.state.iter().fold(digest, |d, &state| d.bytes(&[state as u8]));
        let flags = self.salient.iter().zip(&self.patch);
        let digest =
            flags.fold(digest, |d, (&salient, &patch)| d.bytes(&[u8::from(salient), u8::from(patch)]));
        let digest = view(view(digest, &self.left), &self.right);
        // Without forces and slip, the digest is that of the other results.
        let digest = match &self.wrench {
            Some(wrench) => digest
                .f64s(self.traction_kpa.iter().flat_map(|q| q.to_array()))
                .f64s(wrench.force_n.to_array().into_iter().chain(wrench.torque_nmm.to_array()))
                .f64s(wrench.covariance.iter().flatten().copied()),
            None => digest,
        };
        let Some(slip) = &self.slip else { return digest.value() };
        let digest = self.stick.iter().fold(digest, |d, &stick| d.bytes(&[stick as u8]));
        let poses = slip.motion.iter().flat_map(|motion| motion.pose.to_rows()).flatten();
        let margin = slip.margin.iter().flat_map(|m| [m.share, m.range[0], m.range[1]]);
        digest.bytes(&[slip.status as u8]).f64s(slip.stick_range).f64s(poses).f64s(margin).value()
    }

    /// Points of the contact patch in the order of the markers (sensor frame, millimetres); `out` is
    /// cleared first.
    pub fn patch_points_mm(&self, out: &mut Vec<DVec3>) {
        out.clear();
        out.extend(self.points_mm.iter().zip(&self.patch).filter(|&(_, &p)| p).map(|(&point, _)| point));
    }
}

/// Input of registration from a frame, in lists that are kept from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Touch {
    points_mm: Vec<DVec3>,
    covariance_mm2: Vec<Symmetric<3>>,
    unpressed_mm: Vec<DVec3>,
}

impl Touch {
    /// The contact of a frame: its patch and all other seen markers. No allocation once a frame as large
    /// has been processed.
    pub fn of(&mut self, frame: &Frame) -> Contact<'_> {
        frame.patch_points_mm(&mut self.points_mm);
        let all = frame.points_mm.iter().zip(&frame.covariance_mm2).zip(&frame.patch).zip(&frame.state);
        self.covariance_mm2.clear();
        self.unpressed_mm.clear();
        for (((&point_mm, &covariance_mm2), &in_patch), &state) in all {
            if in_patch {
                self.covariance_mm2.push(covariance_mm2);
            } else if state == MarkerState::Seen {
                self.unpressed_mm.push(point_mm);
            }
        }
        Contact {
            covariance_mm2: Some(&self.covariance_mm2),
            unpressed_mm: &self.unpressed_mm,
            decay_mm: frame.decay_mm,
            offset_sigma_mm: frame.offset_sigma_mm,
            ..Contact::new(&self.points_mm)
        }
    }
}
