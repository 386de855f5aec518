//! Renders a scene to a folder of image pairs with ground truth.

use crate::part::{Part, PartError};
use gelstereo_core::rig::Rig;
use gelstereo_sim::{Plan, Scene, SceneError, Shape, Simulator, Truth};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Reason why a scene could not be rendered.
#[derive(Debug)]
pub enum SimulateError {
    /// The scene's file cannot be read.
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's error.
        error: std::io::Error,
    },
    /// The text is not a valid scene.
    Parse {
        /// Path of the file.
        path: PathBuf,
        /// The parse error, with the line.
        error: toml::de::Error,
    },
    /// The scene's values are invalid.
    Scene(SceneError),
    /// A part's mesh cannot be loaded.
    Part(PartError),
    /// A file cannot be written.
    Write {
        /// Path of the file.
        path: PathBuf,
        /// The reason.
        message: String,
    },
}

impl std::fmt::Display for SimulateError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, error } => write!(f, "cannot read {}: {error}", path.display()),
            Self::Parse { path, error } => write!(f, "{}: {}", path.display(), error.to_string().trim_end()),
            Self::Scene(error) => write!(f, "scene: {error}"),
            Self::Part(error) => error.fmt(f),
            Self::Write { path, message } => write!(f, "cannot write {}: {message}", path.display()),
        }
    }
}

impl std::error::Error for SimulateError {}

/// Result of rendering a scene.
#[derive(Clone, Debug)]
pub struct Simulated {
    /// Image pairs written.
    pub frames: usize,
    /// Effects that were computed, with reasons.
    pub plan: Plan,
}

/// Writes `left_00000.png`, `right_00000.png`, `truth_00000.csv` and so on, the scene with all its
/// defaults as `scene.toml`, and the rig as `rig.toml`. Frames that the scene drops are left out; the
/// others keep their numbers.
///
/// The truth has a row per marker, `row * cols + col`: x_mm, y_mm, z_mm (sensor frame), indentation_mm,
/// in_contact, left_x_px, left_y_px, right_x_px, right_y_px. A scene that requests positions gives no
/// images, and one that requests points gives no pixels either; neither is computed.
///
/// # Errors
/// [`SimulateError`].
pub fn simulate(
    scene_path: &Path,
    folder: &Path,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Simulated, SimulateError> {
    let text = std::fs::read_to_string(scene_path)
        .map_err(|error| SimulateError::Read { path: scene_path.to_owned(), error })?;
    let mut scene: Scene =
        toml::from_str(&text).map_err(|error| SimulateError::Parse { path: scene_path.to_owned(), error })?;
    let mut meshes = Vec::new();
    let others = scene.others.iter_mut().map(|other| &mut other.indenter);
    for shape in scene.indenter.iter_mut().chain(others) {
        if let Shape::Mesh { path, .. } = shape {
            let base = scene_path.parent().unwrap_or(Path::new(""));
            *path = base.join(&*path).to_string_lossy().into_owned();
            meshes.push(Part::load(shape).map_err(SimulateError::Part)?.mesh);
        }
    }
    let mut simulator = Simulator::new(&scene, &meshes).map_err(SimulateError::Scene)?;
    create_folder(folder)?;
    for (name, text) in
        [("scene.toml", toml::to_string(&scene)), ("rig.toml", toml::to_string(&simulator.plan().scene.rig))]
    {
        let path = folder.join(name);
        let text =
            text.map_err(|error| SimulateError::Write { path: path.clone(), message: error.to_string() })?;
        write(&path, text.as_bytes())?;
    }
    let plan = simulator.plan().clone();
    let (views, images) = plan.asked.map_or((true, true), |asked| (asked.views(), asked.images()));
    let (mut truth, mut pixels) = (Truth::default(), [Vec::new(), Vec::new()]);
    let frames = simulator.delivered();
    for arrived in 0..frames {
        let Some(frame) = simulator.frame_of(arrived).filter(|_| !stop.load(Ordering::Relaxed)) else {
            return Ok(Simulated { frames: arrived, plan });
        };
        let contact = simulator.contact(frame);
        if views {
            simulator.moment(contact.as_ref(), frame as u64, &mut truth);
        } else {
            simulator.field(contact.as_ref(), frame as u64, &mut truth);
        }
        if images {
            let [left, right] = &mut pixels;
            simulator.render(&truth, frame as u64, left, right);
            save(folder, frame, &pixels, &scene.rig)?;
        }
        write(&folder.join(format!("truth_{frame:05}.csv")), table(&truth).as_bytes())?;
        progress(arrived + 1, frames);
    }
    Ok(Simulated { frames, plan })
}

/// Writes both images of a frame.
fn save(folder: &Path, frame: usize, images: &[Vec<u8>; 2], rig: &Rig) -> Result<(), SimulateError> {
    let views = [("left", &rig.left), ("right", &rig.right)];
    for ((name, camera), pixels) in views.into_iter().zip(images) {
        let path = folder.join(format!("{name}_{frame:05}.png"));
        let (width, height) = (camera.width_px as u32, camera.height_px as u32);
        image::save_buffer(&path, pixels, width, height, image::ExtendedColorType::L8)
            .map_err(|error| SimulateError::Write { path, message: error.to_string() })?;
    }
    Ok(())
}

fn create_folder(folder: &Path) -> Result<(), SimulateError> {
    std::fs::create_dir_all(folder)
        .map_err(|error| SimulateError::Write { path: folder.to_owned(), message: error.to_string() })
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), SimulateError> {
    std::fs::write(path, bytes)
        .map_err(|error| SimulateError::Write { path: path.to_owned(), message: error.to_string() })
}

/// Table of the markers, with pixels where they were computed.
fn table(truth: &Truth) -> String {
    let seen = truth.left_px.len() == truth.points_mm.len();
    let mut text = String::from("x_mm,y_mm,z_mm,indentation_mm,in_contact");
    text += if seen { ",left_x_px,left_y_px,right_x_px,right_y_px\n" } else { "\n" };
    for (i, p) in truth.points_mm.iter().enumerate() {
        let touched = u8::from(truth.in_contact[i]);
        text += &format!("{},{},{},{},{touched}", p.x, p.y, p.z, truth.indentation_mm[i]);
        if seen {
            let (left, right) = (truth.left_px[i], truth.right_px[i]);
            text += &format!(",{},{},{},{}", left.x, left.y, right.x, right.y);
        }
        text.push('\n');
    }
    text
}
