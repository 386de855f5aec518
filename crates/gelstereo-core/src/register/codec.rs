//! Serialised templates, for files: little-endian, version 1.
//!
//! ```text
//! magic 8 | version u32 | flags u32 (1 surface, 2 grid, 4 squares of the points, made again) | spacing f64
//! points u64, then 3 f64 each | normals 3 f64 each
//! surface: places u64, 3 f64 each | triangles u64, 3 u32 each
//! grid: cell f64, reach f64 (it is made again)
//! symmetries u64, each axis 3 f64, centre 3 f64, order u32 (0 any turn)
//! digest u64 of all before
//! ```

use super::error::TemplateError;
use super::symmetry::Symmetry;
use super::template::Template;
use crate::digest::Digest;
use crate::math::DVec3;
use crate::stop::{NEVER, Stop, Stopped};
use crate::surface::{MeshError, Solid, TriangleMesh};
use alloc::vec::Vec;

const MAGIC: &[u8; 8] = b"geltempl";
const VERSION: u32 = 1;
const SURFACE: u32 = 1;
const GRID: u32 = 2;
const SURFELS: u32 = 4;

/// Why bytes are not a template.
#[derive(Clone, Debug, PartialEq)]
pub enum TemplateBytesError {
    /// They do not start with the magic bytes.
    NotATemplate,
    /// An unsupported version.
    Version {
        /// The version found.
        found: u32,
    },
    /// They are truncated or modified.
    Damaged {
        /// Where the damage was detected.
        byte: usize,
    },
    /// Undamaged, but the points are not a template.
    Template(TemplateError),
    /// Undamaged, but the triangles are not a surface.
    Mesh(MeshError),
}

impl core::fmt::Display for TemplateBytesError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotATemplate => {
                write!(f, "these are not the bytes of a template; make one from the part's mesh")
            }
            Self::Version { found } => {
                write!(
                    f,
                    "the template is of version {found}; valid is {VERSION}: make it again from the part's \
                    mesh"
                )
            }
            Self::Damaged { byte } => write!(
                f,
                "the template is damaged or cut off (seen at byte {byte}); make it again from the part's mesh"
            ),
            Self::Template(error) => error.fmt(f),
            Self::Mesh(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for TemplateBytesError {}

impl From<Stopped> for TemplateBytesError {
    fn from(stopped: Stopped) -> Self {
        Self::Template(stopped.into())
    }
}

impl Template {
    /// The whole template as bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        let (solid, field) = (self.solid(), self.field());
        let flags = if solid.is_some() { SURFACE } else { 0 }
            | if field.is_some() { GRID } else { 0 }
            | if self.has_surfels() { SURFELS } else { 0 };
        out.extend(VERSION.to_le_bytes());
        out.extend(flags.to_le_bytes());
        out.extend(self.spacing_mm().to_le_bytes());
        put_rows(&mut out, self.points_mm());
        self.normals().iter().for_each(|&n| put(&mut out, n));
        if let Some(solid) = solid {
            put_rows(&mut out, solid.vertices_mm());
            out.extend((solid.triangles().len() as u64).to_le_bytes());
            solid.triangles().iter().flatten().for_each(|i| out.extend(i.to_le_bytes()));
        }
        if let Some(field) = field {
            out.extend(field.cell_mm().to_le_bytes());
            out.extend(field.reach_mm().to_le_bytes());
        }
        out.extend((self.symmetries().len() as u64).to_le_bytes());
        for symmetry in self.symmetries() {
            put(&mut out, symmetry.axis);
            put(&mut out, symmetry.centre_mm);
            out.extend(symmetry.order.unwrap_or(0).to_le_bytes());
        }
        let digest = Digest::new().bytes(&out).value();
        out.extend(digest.to_le_bytes());
        out
    }

    /// The template written by [`Self::to_bytes`], with the same digest.
    ///
    /// # Errors
    /// [`TemplateBytesError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TemplateBytesError> {
        Self::from_bytes_unless(bytes, NEVER)
    }

    /// As [`Self::from_bytes`], unless it is stopped.
    ///
    /// # Errors
    /// [`TemplateBytesError`]; it contains [`TemplateError::Stopped`] if it was stopped.
    pub fn from_bytes_unless(bytes: &[u8], stop: Stop<'_>) -> Result<Self, TemplateBytesError> {
        if !bytes.starts_with(MAGIC) {
            return Err(TemplateBytesError::NotATemplate);
        }
        let mut read = Reader { bytes, at: MAGIC.len() };
        let version = read.u32()?;
        if version != VERSION {
            return Err(TemplateBytesError::Version { found: version });
        }
        let end = bytes.len().saturating_sub(8);
        let mut tail = Reader { bytes, at: end };
        if tail.u64()? != Digest::new().bytes(&bytes[..end]).value() {
            return Err(TemplateBytesError::Damaged { byte: end });
        }
        read.bytes = &bytes[..end];
        let flags = read.u32()?;
        // A grid requires a mesh surface; surfels replace one.
        if ![0, SURFACE, SURFACE | GRID, SURFELS].contains(&flags) {
            return Err(read.damaged());
        }
        let spacing_mm = read.f64()?;
        let points_mm = read.rows()?;
        let normals = (0..points_mm.len()).map(|_| read.vector()).collect::<Result<Vec<_>, _>>()?;
        let template = Self::with_unit_normals(points_mm, normals, spacing_mm, stop);
        let mut template = template.map_err(TemplateBytesError::Template)?;
        if flags & SURFACE != 0 {
            template = template.with_solid(read.solid(stop)?, stop)?;
        } else if flags & SURFELS != 0 {
            template = template.with_surfels_unless(stop)?;
        }
        if flags & GRID != 0 {
            let asked = (read.f64()?, read.f64()?);
            template = template.with_field_unless(asked.0, asked.1, stop)?;
            // Rebuilding gives the same numbers.
            if template.field().map(|field| (field.cell_mm(), field.reach_mm())) != Some(asked) {
                return Err(read.damaged());
            }
        }
        for _ in 0..read.count(52)? {
            template.symmetries.push(read.symmetry()?);
        }
        if read.at == end { Ok(template) } else { Err(read.damaged()) }
    }
}

fn put(out: &mut Vec<u8>, v: DVec3) {
    v.to_array().iter().for_each(|x| out.extend(x.to_le_bytes()));
}

fn put_rows(out: &mut Vec<u8>, rows: &[DVec3]) {
    out.extend((rows.len() as u64).to_le_bytes());
    rows.iter().for_each(|&v| put(out, v));
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    const fn damaged(&self) -> TemplateBytesError {
        TemplateBytesError::Damaged { byte: self.at }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], TemplateBytesError> {
        let found = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<N>());
        let found = found.ok_or_else(|| self.damaged())?;
        self.at += N;
        Ok(*found)
    }

    fn u32(&mut self) -> Result<u32, TemplateBytesError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, TemplateBytesError> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, TemplateBytesError> {
        self.take().map(f64::from_le_bytes)
    }

    fn vector(&mut self) -> Result<DVec3, TemplateBytesError> {
        Ok(DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    /// Reads a count of items of `each` bytes; fails if the remaining bytes cannot hold them.
    fn count(&mut self, each: usize) -> Result<usize, TemplateBytesError> {
        let count = self.u64()?;
        let max_count = (self.bytes.len() - self.at) / each;
        if count <= max_count as u64 { Ok(count as usize) } else { Err(self.damaged()) }
    }

    fn rows(&mut self) -> Result<Vec<DVec3>, TemplateBytesError> {
        (0..self.count(24)?).map(|_| self.vector()).collect()
    }

    /// Reads a symmetry, bit for bit; rejects an invalid axis.
    fn symmetry(&mut self) -> Result<Symmetry, TemplateBytesError> {
        let (axis, centre_mm) = (self.vector()?, self.vector()?);
        let order = Some(self.u32()?).filter(|&n| n > 0);
        let is_unit = (axis.length_squared() - 1.0).abs() <= 1e-9;
        match Symmetry::new(axis, centre_mm, order).filter(|_| is_unit) {
            Some(sound) => Ok(Symmetry { axis, ..sound }),
            None => Err(self.damaged()),
        }
    }

    fn solid(&mut self, stop: Stop<'_>) -> Result<Solid, TemplateBytesError> {
        let places = self.rows()?;
        let triangle = |read: &mut Self| Ok::<_, TemplateBytesError>([read.u32()?, read.u32()?, read.u32()?]);
        let triangles = (0..self.count(12)?).map(|_| triangle(self)).collect::<Result<Vec<_>, _>>()?;
        let mesh = TriangleMesh::new(places, triangles).map_err(TemplateBytesError::Mesh)?;
        Solid::new_unless(&mesh, stop).map_err(|error| TemplateBytesError::Template(error.into()))
    }
}
