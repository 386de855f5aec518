//! Slip of the part along the gel, from the motion of the markers in contact.
//!
//! Markers under a part that does not slip move with it as a rigid body. Where friction does not hold the
//! gel, it lags behind: first at the border of the contact (Cattaneo 1938; Mindlin 1949), and at last
//! everywhere. [`SlipTracker`] fits the rigid motion since touch to the markers that stick, weighted by their
//! covariances. A marker slips if its distance from that motion, along the gel, is larger than noise
//! explains at the stated rate of false alarms.

mod error;
mod fit;
mod margin;
mod stick;
mod tracker;

pub use error::SlipError;
pub use fit::RigidMotion;
pub use margin::{LoadedContact, Margin, MarginSource};
pub use stick::{Slip, SlipStatus, Stick};
pub use tracker::SlipTracker;
