//! Whether the gel moves with the part.

use super::fit::RigidMotion;
use super::margin::Margin;

/// Whether the gel around a marker moves with the part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[repr(u8)]
pub enum Stick {
    /// The part does not press here, or is not known to.
    #[default]
    Free = 0,
    /// It moves with the part.
    Stuck = 1,
    /// It slips along the part.
    Slips = 2,
    /// In contact, but not known: it has just touched, it is not seen, its covariance is not positive
    /// definite, or too few markers stick.
    Unknown = 3,
}

impl Stick {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 4] =
        [("FREE", Self::Free), ("STUCK", Self::Stuck), ("SLIPS", Self::Slips), ("UNKNOWN", Self::Unknown)];
}

/// Slip of a contact as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[repr(u8)]
pub enum SlipStatus {
    /// Fewer than three markers have been in contact for two frames.
    #[default]
    Unknown = 0,
    /// No more markers slip than free ones beside an edge may explain: a fortieth.
    Stuck = 1,
    /// More markers slip; the part is still held. Those beside the patch count as a third of one.
    Incipient = 2,
    /// Too few markers stick to hold the part. It lasts until the part leaves the gel: whether a sliding part
    /// comes to rest is not seen by markers that slip.
    Gross = 3,
}

impl SlipStatus {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 4] = [
        ("UNKNOWN", Self::Unknown),
        ("STUCK", Self::Stuck),
        ("INCIPIENT", Self::Incipient),
        ("GROSS", Self::Gross),
    ];
}

/// Slip of a contact in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Slip {
    /// The contact as a whole.
    pub status: SlipStatus,
    /// Markers that stick over those known to stick or slip; `None` while none is known.
    pub stick_ratio: Option<f64>,
    /// Range of the ratio of areas: unknown markers stick or slip, up to one pitch around the contact may
    /// slip unseen, and markers beside the patch that slip may be free gel.
    pub stick_range: [f64; 2],
    /// Motion of the part since it touched the gel, or since three markers stick again; `None` if fewer do.
    pub motion: Option<RigidMotion>,
    /// Share of the friction limit that is not used: by the wrench with `force.friction`, or else by the
    /// stick ratio with `slip.shape`. `None` without these, and by the stick ratio for `Unknown` and `Gross`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub margin: Option<Margin>,
}
