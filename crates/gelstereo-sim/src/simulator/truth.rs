//! Ground truth of one moment.

use super::loads::Loads;
use super::{ContactState, Simulator};
use crate::render::{Dot, Ellipse};
use crate::scene::SceneError;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3, Pose};
use gelstereo_core::params::PrintLayout;
use gelstereo_core::rig::View;

/// Ground truth of one moment; marker `row * cols + col` has that index, printed or not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Marker centres, sensor frame, millimetres.
    pub points_mm: Vec<DVec3>,
    /// Unit normals of the surface at the markers, towards the cameras (sensor frame).
    pub normals: Vec<DVec3>,
    /// Height above the surface at rest, towards the camera; at most the gel's thickness.
    pub indentation_mm: Vec<f64>,
    /// Whether a part touches the gel at this marker.
    pub in_contact: Vec<bool>,
    /// Number of the part that touches it: 0 is the indenter, n the n-th of [`crate::Scene::others`].
    pub touched_by: Vec<Option<u8>>,
    /// Contact of each part, by its number; empty for markers placed by the caller.
    pub contacts: Vec<Option<ContactState>>,
    /// Loads that the parts exert on the gel; `None` without `effects.elastic_layer`.
    pub loads: Option<Loads>,
    /// Projections of the centres in the left image, inside it or not. With `ellipse_bias`, the centre
    /// of a dot's image is offset by up to f r² sin a cos a / Z² (tilt a): 0.016 px on the default rig.
    pub left_px: Vec<DVec2>,
    /// The same in the right image.
    pub right_px: Vec<DVec2>,
    /// Image of each dot in the left view.
    pub left_dots: Vec<DotImage>,
    /// The same in the right image.
    pub right_dots: Vec<DotImage>,
    /// Specks of the scene in the left image: they look like markers but are not.
    pub left_specks: Vec<Ellipse>,
    /// The same in the right image.
    pub right_specks: Vec<Ellipse>,
    /// Motion of the dots' left images during the exposure, markers first, then specks. Empty (no
    /// motion) without motion blur and for markers placed by the caller.
    pub left_motion_px: Vec<DVec2>,
    /// The same in the right image.
    pub right_motion_px: Vec<DVec2>,
}

impl Truth {
    /// Empties all lists that depend on the cameras.
    pub(super) fn forget_views(&mut self) {
        self.normals.clear();
        for list in
            [&mut self.left_px, &mut self.right_px, &mut self.left_motion_px, &mut self.right_motion_px]
        {
            list.clear();
        }
        for dots in [&mut self.left_dots, &mut self.right_dots] {
            dots.clear();
        }
        for specks in [&mut self.left_specks, &mut self.right_specks] {
            specks.clear();
        }
    }
}

/// Image of a marker's dot in one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DotImage {
    /// Its outline before the lens blur.
    pub outline: Ellipse,
    /// Difference between dot and gel at this place, in this light and before the lens blur, grey
    /// levels.
    pub contrast_levels: f64,
    /// Its visibility.
    pub sight: Sight,
}

/// Visibility of a marker in one image; if several apply, the last in this list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Sight {
    /// Fully visible.
    Whole = 0,
    /// Cut by the image's border.
    Cut = 1,
    /// Joined to another marker by ink.
    Merged = 2,
    /// Reached by a smear.
    Covered = 3,
    /// Outside the image, or behind the camera.
    Outside = 4,
    /// Not printed.
    NotPrinted = 5,
}

impl Sight {
    /// All values with their names.
    pub const ALL: [(&'static str, Self); 6] = [
        ("WHOLE", Self::Whole),
        ("CUT", Self::Cut),
        ("MERGED", Self::Merged),
        ("COVERED", Self::Covered),
        ("OUTSIDE", Self::Outside),
        ("NOT_PRINTED", Self::NotPrinted),
    ];
}

/// Pixel for a point behind a camera; only a contact that shears the gel out of sight leads there.
pub const OUT_OF_SIGHT_PX: DVec2 = DVec2::splat(-1e6);

const NO_OUTLINE: Ellipse = Ellipse { centre_px: OUT_OF_SIGHT_PX, half_px: [DVec2::ZERO; 2] };

impl Simulator {
    /// Writes the scratch to the ground truth.
    pub(super) fn write(&mut self, time_s: f64, out: &mut Truth) {
        self.write_field(out);
        self.write_views(time_s, out);
    }

    /// Writes the camera-independent ground truth, except for the normals.
    pub(super) fn write_field(&self, out: &mut Truth) {
        let Self { scratch, lattice, .. } = self;
        out.indentation_mm.clear();
        out.indentation_mm.extend(lattice.of_markers(&scratch.heights));
        out.in_contact.clear();
        out.in_contact.extend(lattice.of_markers(&scratch.stuck));
        out.touched_by.clear();
        let touched_by = |(touches, part): (bool, u8)| touches.then_some(part);
        let parts = lattice.of_markers(&scratch.obstacle.part);
        out.touched_by.extend(lattice.of_markers(&scratch.stuck).zip(parts).map(touched_by));
        out.contacts.clone_from(&scratch.contacts);
        let mut loads = out.loads.take().unwrap_or_default();
        out.loads = self.write_loads(&mut loads).then_some(loads);
        self.points(&mut out.points_mm);
    }

    /// Marker positions from the scratch.
    pub(super) fn points(&self, out: &mut Vec<DVec3>) {
        let Self { scratch, rest, skin_mm, lattice, .. } = self;
        let moved = |marker: usize| {
            let node = lattice.node(marker);
            (rest[node] + scratch.motion[node]).extend(skin_mm[node] - scratch.heights[node])
        };
        out.clear();
        out.extend((0..lattice.markers()).map(moved));
    }

    /// [`Self::moment`] of markers at given positions, row by row, for example of a recording.
    /// Nothing is in contact because the contact is unknown.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] if there are more or fewer points than the gel has markers, or one is
    /// beyond 10 m.
    pub fn placed(&mut self, points_mm: &[DVec3], frame: u64, out: &mut Truth) -> Result<(), SceneError> {
        let (found, markers) = (points_mm.len(), self.lattice.markers());
        SceneError::check(found == markers, "number of points_mm", found as f64, "gel.rows * gel.cols")?;
        for x in points_mm.iter().flat_map(|point| point.to_array()) {
            SceneError::check(x.abs() <= 1e4, "points_mm", x, "-10000 to 10000 mm")?;
        }
        out.points_mm.clear();
        out.points_mm.extend_from_slice(points_mm);
        out.indentation_mm.clear();
        let above = |(point, skin_mm): (&DVec3, f64)| skin_mm - point.z;
        out.indentation_mm.extend(points_mm.iter().zip(self.lattice.of_markers(&self.skin_mm)).map(above));
        out.in_contact.clear();
        out.in_contact.resize(markers, false);
        out.touched_by.clear();
        out.touched_by.resize(markers, None);
        out.contacts.clear();
        out.loads = None;
        self.look(frame, out)
    }

    /// Writes both cameras' views of `out.points_mm`.
    pub(super) fn write_views(&mut self, time_s: f64, out: &mut Truth) {
        out.left_px.clear();
        out.right_px.clear();
        for &point in &out.points_mm {
            let (left, right) = self.rig.project(point).unwrap_or((OUT_OF_SIGHT_PX, OUT_OF_SIGHT_PX));
            out.left_px.push(left);
            out.right_px.push(right);
        }
        self.write_dots(time_s, out);
        self.write_motion(out);
    }

    fn write_dots(&mut self, time_s: f64, out: &mut Truth) {
        self.scratch.dots.clear();
        for marker in 0..out.points_mm.len() {
            let dot = self.dot(&out.points_mm, marker, time_s);
            self.scratch.dots.push(dot);
        }
        let Self { scratch, rig, renderer, specks, gel, .. } = &*self;
        out.normals.clear();
        let normal = |dot: &Dot| dot.across.cross(dot.along).normalize_or(DVec3::NEG_Z);
        out.normals.extend(scratch.dots.iter().map(normal));
        let views = [
            (View::Left, Pose::IDENTITY, &mut out.left_dots, &mut out.left_specks),
            (View::Right, rig.t_right_left, &mut out.right_dots, &mut out.right_specks),
        ];
        for (index, (view, t_camera_sensor, dots, blots)) in views.into_iter().enumerate() {
            let view = rig.view(view);
            let outline = |dot: &Dot| {
                let seen = match self.ellipse_bias {
                    true => dot.image(&view, &t_camera_sensor, rig.layers.is_some()),
                    false => dot.unbiased(&view),
                };
                seen.unwrap_or(NO_OUTLINE)
            };
            dots.clear();
            let described = |(marker, dot)| renderer.describe(index, marker, outline(dot), time_s);
            dots.extend(scratch.dots.iter().enumerate().map(described));
            blots.clear();
            blots.extend(specks.iter().map(|speck| outline(&speck.dot(&out.points_mm, gel))));
        }
    }

    /// A marker's dot, stretched and tilted with the surface between the neighbouring markers.
    fn dot(&self, points_mm: &[DVec3], marker: usize, time_s: f64) -> Dot {
        let Self { lattice, print, worn, gel, .. } = self;
        let pairs = lattice.marker_pairs(marker);
        let apart = pairs.map(|(before, after, _)| points_mm[after] - points_mm[before]);
        let centre = points_mm[marker];
        let radius_mm = gel.dot_radius_mm * print.as_ref().map_or(1.0, |print| print.radius(marker));
        let radius_mm = radius_mm * worn.as_ref().map_or(1.0, |worn| worn.radius(marker, time_s));
        let shift_mm = print.as_ref().and_then(|print| print.shift_mm());
        if shift_mm.is_none() && gel.layout == PrintLayout::Square {
            let neighbours = lattice.neighbours(marker);
            let [along, across] = [0, 1].map(|axis| {
                let stretch = apart[axis] / (neighbours[axis].2 * lattice.pitch_mm[axis]);
                stretch * radius_mm
            });
            return Dot { centre, along, across };
        }
        // With misprints, and at the border of a hexagonal print, neighbours are not exactly one or two
        // pitches apart along the axes. The surface gradient G solves G [a b] = apart, where a and b are the
        // printed differences.
        let [a, b] = pairs.map(|(before, after, printed_mm)| {
            printed_mm + shift_mm.map_or(DVec2::ZERO, |shift_mm| shift_mm[after] - shift_mm[before])
        });
        let scale = radius_mm / a.perp_dot(b);
        Dot {
            centre,
            along: (apart[0] * b.y - apart[1] * a.y) * scale,
            across: (apart[1] * a.x - apart[0] * b.x) * scale,
        }
    }
}
