//! The one tree of settings. [`Params::default`] is the paper's, section V-B.
//!
//! A ladder's rungs are the variants of one enum here; each says what it costs and what it gives.
//! `docs/accuracy-vs-time.md` holds the measured figures.

mod contact;
mod detect;
mod force;
mod label;
mod lattice;
mod motion;
mod pitch;
mod presets;
mod register;
mod renamed;
mod roi;
mod slip;
mod track;
mod triangulate;

pub use contact::{ContactParams, Saliency};
pub use detect::{Background, Centre, Channel, DetectParams, FindAt, FitParams, Polarity, Search, Threshold};
pub use force::{ForceMethod, ForceParams};
pub use label::{LabelMethod, LabelParams};
pub use lattice::{LatticeParams, PrintLayout};
pub use motion::MotionParams;
pub use pitch::Pitch;
pub use register::{
    AdvancedRegisterParams, FilterregParams, GuessSigma, RansacIcpParams, RegisterMethod, RegisterParams,
    SurfaceSearchParams,
};
pub use renamed::{former, renamed_setting, replaced_method};
pub use roi::{Region, RoiParams};
pub use slip::{SlipMethod, SlipParams, SlipShape};
pub use track::{Motion, TrackParams};
pub use triangulate::{DiscBias, TriangulateMethod, TriangulateParams};

/// All settings of the pipeline and of registration.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct Params {
    /// The printed lattice.
    pub lattice: LatticeParams,
    /// Finding markers in one image.
    pub detect: DetectParams,
    /// Keeping their identity over frames.
    pub track: TrackParams,
    /// Row and column of every marker.
    pub label: LabelParams,
    /// From two views to millimetres.
    pub triangulate: TriangulateParams,
    /// Saliency and the stop triggers.
    pub contact: ContactParams,
    /// Force and torque of a contact.
    pub force: ForceParams,
    /// Slip of the part along the gel.
    pub slip: SlipParams,
    /// Motion of a part without a model.
    pub motion: MotionParams,
    /// Registration to the template.
    pub register: RegisterParams,
}

/// A setting that makes no sense.
#[derive(Clone, Debug, PartialEq)]
pub enum ParamsError {
    /// A number is out of range.
    Range {
        /// Where it stands, for example `detect.smooth_kernel_px`.
        name: &'static str,
        /// What was found.
        found: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A setting needs another one.
    Requires {
        /// The setting with its value, for example `contact.learn_decay = true`.
        setting: &'static str,
        /// What it needs.
        required: &'static str,
    },
}

impl core::fmt::Display for ParamsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Range { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::Requires { setting, required } => write!(f, "{setting} requires {required}"),
        }
    }
}

impl core::error::Error for ParamsError {}

impl Params {
    /// Checks every setting against its meaning.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        self.lattice.validate()?;
        self.detect.validate()?;
        self.track.validate()?;
        self.label.validate()?;
        self.triangulate.validate()?;
        self.contact.validate()?;
        self.force.validate()?;
        self.slip.validate()?;
        self.motion.validate()?;
        self.register.validate()?;
        self.check_layout()
    }

    /// Checks that the other stages work with the print's layout.
    fn check_layout(&self) -> Result<(), ParamsError> {
        let setting = "lattice.layout = \"hexagonal\"";
        let requires = |required| Err(ParamsError::Requires { setting, required });
        match self.lattice.layout {
            PrintLayout::Square => Ok(()),
            PrintLayout::Hexagonal if self.label.method != LabelMethod::Lattice => {
                requires("label.method = \"lattice\"")
            }
            PrintLayout::Hexagonal => Ok(()),
        }
    }
}

fn check(ok: bool, name: &'static str, found: f64, valid: &'static str) -> Result<(), ParamsError> {
    if ok { Ok(()) } else { Err(ParamsError::Range { name, found, valid }) }
}

/// A length of a sensor or part: from a nanometre, far below what is sensed, to ten metres.
fn length(name: &'static str, mm: f64) -> Result<(), ParamsError> {
    check((1e-6..=1e4).contains(&mm), name, mm, "0.000001 to 10000 mm")
}

/// A motion in the image: up to more than any image's width.
fn motion(name: &'static str, px: f64) -> Result<(), ParamsError> {
    check((1e-6..=1e4).contains(&px), name, px, "0.000001 to 10000 px")
}

/// A share of which something must be left.
fn share(name: &'static str, x: f64) -> Result<(), ParamsError> {
    check((0.0..=0.999).contains(&x), name, x, "0 to 0.999")
}
