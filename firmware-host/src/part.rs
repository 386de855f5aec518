//! The part: a shape with dimensions, or a mesh file.

use gelstereo_core::math::DVec3;
use gelstereo_core::register::{Template, TemplateError};
use gelstereo_core::surface::{MeshError, TriangleMesh};
use gelstereo_sim::Shape;
use serde::{Deserialize, Serialize};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// The part to be grasped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PartConfig {
    /// Distance of the template's points. Valid: 0.01 to 100 mm. Default: `0.25` mm. Raise it for large
    /// parts, of which a template holds no more points.
    pub spacing_mm: f64,
    /// Seed of the template's points. Valid: 0 to 9223372036854775807. Default: `1`. Change it to see how
    /// results depend on the points.
    pub seed: u64,
    /// The part's shape: a mesh file or dimensions. Its diagonal is 2 to 500 mm. Default: a peg, 8 mm in
    /// diameter and 40 mm long. Change it to your part.
    pub shape: Shape,
}

impl Default for PartConfig {
    fn default() -> Self {
        Self {
            spacing_mm: Template::DEFAULT_SPACING_MM,
            seed: 1,
            shape: Shape::Cylinder { radius_mm: 4.0, length_mm: 40.0 },
        }
    }
}

/// Reason why a part cannot be loaded.
#[derive(Debug)]
pub enum PartError {
    /// The mesh file cannot be read.
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        error: std::io::Error,
    },
    /// The unit is unknown.
    Units {
        /// Unit found.
        found: String,
    },
    /// The file extension is neither STL nor OBJ.
    Kind {
        /// Path of the file.
        path: PathBuf,
    },
    /// The content of the file does not match its extension.
    Decode {
        /// Path of the file.
        path: PathBuf,
        /// Reason.
        message: String,
    },
    /// The part is too small or too large to be held.
    Scale {
        /// Diagonal of its bounding box in the given unit.
        diagonal_mm: f64,
        /// The given unit.
        units: String,
        /// A unit that would give a plausible size.
        guess: Option<&'static str>,
    },
    /// A part with dimensions is too small or too large to be held.
    Size {
        /// Diagonal of its bounding box.
        diagonal_mm: f64,
    },
    /// The triangles do not form a valid surface.
    Mesh(MeshError),
    /// The surface does not yield a template.
    Template(TemplateError),
}

impl std::fmt::Display for PartError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, error } => write!(f, "cannot read the mesh {}: {error}", path.display()),
            Self::Units { found } => {
                write!(f, "part.shape.units is \"{found}\"; valid is \"mm\", \"cm\", \"m\" or \"in\"")
            }
            Self::Kind { path } => write!(f, "{} is not a mesh file; valid is .stl or .obj", path.display()),
            Self::Decode { path, message } => {
                write!(f, "{} is not an intact mesh: {message}", path.display())
            }
            Self::Scale { diagonal_mm, units, guess } => {
                write!(
                    f,
                    "with units = \"{units}\" the part is {diagonal_mm:.3} mm across; a part that is held \
                     between fingers has {MIN_DIAGONAL_MM} to {MAX_DIAGONAL_MM} mm"
                )?;
                match guess {
                    Some(guess) => write!(f, " (is the file in \"{guess}\"?)"),
                    None => Ok(()),
                }
            }
            Self::Size { diagonal_mm } => write!(
                f,
                "part.shape is {diagonal_mm:.3} mm across; a part that is held between fingers has \
                 {MIN_DIAGONAL_MM} to {MAX_DIAGONAL_MM} mm"
            ),
            Self::Mesh(error) => write!(f, "part: {error}"),
            Self::Template(error) => write!(f, "part: {error}"),
        }
    }
}

impl std::error::Error for PartError {}

/// Units of mesh files and their length in mm; the most common first, for the guess.
const UNITS: [(&str, f64); 4] = [("mm", 1.0), ("m", 1000.0), ("in", 25.4), ("cm", 10.0)];
const MIN_DIAGONAL_MM: f64 = 2.0;
const MAX_DIAGONAL_MM: f64 = 500.0;
/// Largest deviation of the facets of a round shape: a tenth of the sensor's resolution.
const FACET_TOLERANCE_MM: f64 = 0.003;

/// Surface of a part, and its file if it has one.
#[derive(Clone, Debug)]
pub struct Part {
    /// Triangles, part frame.
    pub mesh: TriangleMesh,
    /// Name and bytes of the mesh file, which is stored in a recording.
    pub file: Option<(String, Vec<u8>)>,
}

impl Part {
    /// Loads a part from dimensions, or from the mesh file of the shape.
    ///
    /// # Errors
    /// [`PartError`].
    pub fn load(shape: &Shape) -> Result<Self, PartError> {
        match shape {
            Shape::Mesh { path, .. } => {
                let path = Path::new(path);
                let bytes =
                    std::fs::read(path).map_err(|error| PartError::Read { path: path.to_owned(), error })?;
                Self::from_bytes(shape, bytes)
            }
            _ => Self::from_bytes(shape, Vec::new()),
        }
    }

    /// As [`Self::load`], with the bytes of the mesh file.
    ///
    /// # Errors
    /// [`PartError`].
    pub fn from_bytes(shape: &Shape, bytes: Vec<u8>) -> Result<Self, PartError> {
        if let Shape::Mesh { path, units } = shape {
            let path = Path::new(path);
            let mesh = decode(path, &bytes, units)?;
            let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
            return Ok(Self { mesh, file: Some((name, bytes)) });
        }
        let mesh = shape.mesh(FACET_TOLERANCE_MM).ok_or(PartError::Mesh(MeshError::Empty))?;
        let diagonal_mm = diagonal_mm(&mesh);
        if !fits(diagonal_mm) {
            return Err(PartError::Size { diagonal_mm });
        }
        Ok(Self { mesh, file: None })
    }

    /// Points and normals for registration.
    ///
    /// # Errors
    /// [`PartError::Template`].
    pub fn template(&self, config: &PartConfig) -> Result<Template, PartError> {
        Template::from_mesh(&self.mesh, config.spacing_mm, config.seed).map_err(PartError::Template)
    }
}

fn decode(path: &Path, bytes: &[u8], units: &str) -> Result<TriangleMesh, PartError> {
    let Some(&(_, mm)) = UNITS.iter().find(|(name, _)| *name == units) else {
        return Err(PartError::Units { found: units.to_owned() });
    };
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    let (vertices, triangles) = match extension.as_deref() {
        Some("stl") => decode_stl(path, bytes)?,
        Some("obj") => decode_obj(path, bytes)?,
        _ => return Err(PartError::Kind { path: path.to_owned() }),
    };
    let mesh = TriangleMesh::new(vertices.into_iter().map(|v| v * mm).collect(), triangles)
        .map_err(PartError::Mesh)?;
    let diagonal_mm = diagonal_mm(&mesh);
    if !fits(diagonal_mm) {
        let guess = UNITS.iter().find(|(_, other)| fits(diagonal_mm / mm * other)).map(|(name, _)| *name);
        return Err(PartError::Scale { diagonal_mm, units: units.to_owned(), guess });
    }
    Ok(mesh)
}

fn diagonal_mm(mesh: &TriangleMesh) -> f64 {
    let (low, high) = mesh.bounds_mm();
    (high - low).length()
}

/// Whether a part of this size can be held between fingers.
fn fits(diagonal_mm: f64) -> bool {
    (MIN_DIAGONAL_MM..=MAX_DIAGONAL_MM).contains(&diagonal_mm)
}

type Triangles = (Vec<DVec3>, Vec<[u32; 3]>);

fn decode_stl(path: &Path, bytes: &[u8]) -> Result<Triangles, PartError> {
    let mesh = stl_io::read_stl(&mut Cursor::new(bytes))
        .map_err(|error| PartError::Decode { path: path.to_owned(), message: error.to_string() })?;
    let vertices = mesh.vertices.iter().map(|v| DVec3::from_array(v.0.map(f64::from))).collect();
    let triangles = mesh.faces.iter().map(|face| face.vertices.map(|index| index as u32)).collect();
    Ok((vertices, triangles))
}

fn decode_obj(path: &Path, bytes: &[u8]) -> Result<Triangles, PartError> {
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..Default::default() };
    // Materials are irrelevant for the surface.
    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, |_| Ok(Default::default()))
        .map_err(|error| PartError::Decode { path: path.to_owned(), message: error.to_string() })?;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for model in models {
        let first = vertices.len() as u32;
        let (points, _) = model.mesh.positions.as_chunks::<3>();
        vertices.extend(points.iter().map(|p| DVec3::from_array(p.map(f64::from))));
        let (corners, _) = model.mesh.indices.as_chunks::<3>();
        triangles.extend(corners.iter().map(|c| c.map(|index| first + index)));
    }
    Ok((vertices, triangles))
}
