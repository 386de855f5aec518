//! The exceptions of gelstereo, and the conversion of stage errors to them.
//!
//! Every exception derives from `gelstereo.Error`, which is a `ValueError`: an input (a file, an image,
//! an array, a setting) cannot be used. The message states what was found and what would be valid.

use gelstereo_core as core;
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::{PyKeyboardInterrupt, PyUserWarning, PyValueError};

create_exception!(
    gelstereo,
    Error,
    PyValueError,
    "Base of all errors of gelstereo: something handed over cannot be used.\n\n\
     The text says what was found, what would be valid and what to do."
);

macro_rules! exceptions {
    ($($name:ident: $doc:literal),+ $(,)?) => { $(create_exception!(gelstereo, $name, Error, $doc);)+ };
}

exceptions! {
    ParamsError: "A setting's name, value or file is not valid.",
    RigError: "Calibration data are not a valid stereo rig.",
    ShapeError: "An array has the wrong shape or type.",
    ImageError: "An array is not an 8-bit grey image of the right size.",
    DetectError: "An image shows no measurable markers.",
    LabelError: "Rows and columns could not be assigned to markers.",
    TriangulateError: "A pair of pixels cannot be triangulated.",
    ContactError: "A point cloud is not a rest surface, or does not match it.",
    MeshError: "Triangles or markers are not a surface, or their units are implausible.",
    TemplateError: "Points are not a valid template.",
    RegisterError: "A contact patch cannot be registered.",
    PoseError: "A matrix is not a rotation or not a rigid motion.",
    FrameError: "The gripper cannot have this opening width.",
    SceneError: "A scene is not valid.",
    GripperError: "A gripper cannot execute a command, reports a fault, or does not answer.",
    CameraError: "A camera is absent, does not support a request, or does not answer.",
    LayerError: "A layer of gel or a contact with it is not valid.",
    HidError: "A HID device is absent, refuses a command or does not answer.",
}

create_exception!(
    gelstereo,
    PitchWarning,
    PyUserWarning,
    "The print's pitch at rest differs from lattice.pitch_mm: the rig or a setting is wrong, and lengths \
    with it."
);

/// Conversion of a stage's error to its Python exception.
pub trait ToPython {
    fn to_python(&self) -> PyErr;
}

macro_rules! stage_errors {
    ($($rust:ty => $python:ident),+ $(,)?) => {
        $(impl ToPython for $rust {
            fn to_python(&self) -> PyErr {
                $python::new_err(self.to_string())
            }
        })+
    };
}

impl ToPython for core::pipeline::MarkerTrackerError {
    fn to_python(&self) -> PyErr {
        match self {
            Self::Size { .. } => ImageError::new_err(self.to_string()),
            Self::Detect(_) | Self::TooFew(_) => DetectError::new_err(self.to_string()),
        }
    }
}

stage_errors! {
    core::params::ParamsError => ParamsError,
    core::rig::RigError => RigError,
    core::camera::CameraError => RigError,
    core::image::ImageError => ImageError,
    core::detect::DetectError => DetectError,
    core::lattice::LabelError => LabelError,
    core::triangulate::TriangulateError => TriangulateError,
    core::contact::ContactError => ContactError,
    core::pipeline::RestRecordError => ContactError,
    core::surface::MeshError => MeshError,
    core::surface::DenseSurfaceError => MeshError,
    core::surface::SolidError => MeshError,
    core::stop::Stopped => PyKeyboardInterrupt,
    core::register::FusionError => RegisterError,
    core::register::RigidFitError => RegisterError,
    core::math::se3::PoseError => PoseError,
    core::math::so3::RotationError => PoseError,
    core::frames::WidthError => FrameError,
    core::frames::MountError => FrameError,
    gelstereo_host::gripper::GripperError => GripperError,
    gelstereo_sim::SceneError => SceneError,
    gelstereo_host::camera::CaptureError => CameraError,
    gelstereo_host::codec::tara::TaraError => HidError,
    gelstereo_host::codec::blink1::Blink1Error => HidError,
}

// A stop is requested only by a signal, whose own exception is raised instead.
impl ToPython for core::register::TemplateError {
    fn to_python(&self) -> PyErr {
        match self {
            Self::Stopped => core::stop::Stopped.to_python(),
            error => TemplateError::new_err(error.to_string()),
        }
    }
}

impl ToPython for core::register::TemplateBytesError {
    fn to_python(&self) -> PyErr {
        match self {
            Self::Template(error) => error.to_python(),
            error => TemplateError::new_err(error.to_string()),
        }
    }
}

impl ToPython for gelstereo_sim::layer::LayerError {
    fn to_python(&self) -> PyErr {
        match self {
            Self::Stopped => core::stop::Stopped.to_python(),
            error => LayerError::new_err(error.to_string()),
        }
    }
}

impl ToPython for core::register::RegisterError {
    fn to_python(&self) -> PyErr {
        match self {
            Self::Stopped => core::stop::Stopped.to_python(),
            Self::Params(error) => error.to_python(),
            error => RegisterError::new_err(error.to_string()),
        }
    }
}

impl ToPython for core::force::ForceError {
    fn to_python(&self) -> PyErr {
        match self {
            Self::Params(error) => error.to_python(),
            error => ContactError::new_err(error.to_string()),
        }
    }
}

impl ToPython for core::force::ComplianceError {
    fn to_python(&self) -> PyErr {
        ContactError::new_err(self.to_string())
    }
}

impl ToPython for core::slip::SlipError {
    fn to_python(&self) -> PyErr {
        match self {
            Self::Params(error) => error.to_python(),
            error => ContactError::new_err(error.to_string()),
        }
    }
}

impl ToPython for core::pipeline::PipelineError {
    /// The exception of the stage that failed, with the pipeline's text, which names the view.
    fn to_python(&self) -> PyErr {
        use core::pipeline::PipelineError as E;
        let text = self.to_string();
        match self {
            E::Params(_) | E::Pitch { .. } => ParamsError::new_err(text),
            E::Size { .. } => ImageError::new_err(text),
            E::Detect { .. } => DetectError::new_err(text),
            E::Label { .. } | E::Lattices { .. } | E::Views { .. } => LabelError::new_err(text),
            E::Triangulate(core::triangulate::TriangulateError::Rig(_)) => RigError::new_err(text),
            E::Triangulate(_) | E::Epipolar { .. } => TriangulateError::new_err(text),
            E::Force(error) => error.to_python(),
            E::Slip(error) => error.to_python(),
            E::Contact(_) | E::Record(_) => ContactError::new_err(text),
        }
    }
}

/// For `map_err`: converts any stage's error to its Python exception.
pub fn raise<E: ToPython>(error: E) -> PyErr {
    error.to_python()
}
