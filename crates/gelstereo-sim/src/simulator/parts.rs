//! The parts over the gel.

use crate::shapes::{MeshHeight, Shape, Solid};
use crate::simulator::ContactState;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3, Pose};

/// Which part is highest above the skin at rest, for each of some nodes: where parts are united, the gel
/// meets this one.
#[derive(Clone, Debug, Default)]
pub(super) struct Highest {
    /// Its height; negative infinity where there is no part.
    pub(super) heights: Vec<f64>,
    /// Its number.
    pub(super) part: Vec<u8>,
    /// Where its height was evaluated, sensor x and y.
    pub(super) at: Vec<DVec2>,
    /// Heights and places of one part.
    pub(super) own: Vec<f64>,
    pub(super) places: Vec<DVec2>,
}

impl Highest {
    pub(super) fn with_capacity(count: usize) -> Self {
        let [heights, own] = [(); 2].map(|()| Vec::with_capacity(count));
        let [at, places] = [(); 2].map(|()| Vec::with_capacity(count));
        Self { heights, part: Vec::with_capacity(count), at, own, places }
    }

    /// Adds the heights of one more part.
    fn unite(&mut self, part: u8) {
        let Self { heights, part: parts, at, own, places } = self;
        for (i, (&own, &place)) in own.iter().zip(&*places).enumerate() {
            if own > heights[i] {
                (heights[i], parts[i], at[i]) = (own, part, place);
            }
        }
    }
}

/// The parts of a scene.
#[derive(Clone, Debug)]
pub(super) struct Parts {
    list: Vec<Part>,
    thickness_mm: f64,
}

/// A part, which keeps the buffers of its heights.
#[derive(Clone, Debug)]
enum Part {
    Solid(Shape),
    Mesh(MeshHeight),
}

impl Parts {
    pub(super) fn new(solids: Vec<Solid<'_>>, thickness_mm: f64) -> Self {
        let part = |solid| match solid {
            Solid::Shape(shape) => Part::Solid(Shape::clone(shape)),
            Solid::Mesh(mesh) => Part::Mesh(MeshHeight::new(mesh)),
        };
        Self { list: solids.into_iter().map(part).collect(), thickness_mm }
    }

    pub(super) fn len(&self) -> usize {
        self.list.len()
    }

    /// Smallest z of a part; `None` if there is no such part.
    pub(super) fn nearest_z_mm(&self, part: usize, t_sensor_object: &Pose) -> Option<f64> {
        match self.list.get(part)? {
            Part::Solid(shape) => {
                let towards_camera = t_sensor_object.rotation.conjugate() * DVec3::NEG_Z;
                Some(t_sensor_object.translation_mm.z - shape.support_mm(towards_camera)?)
            }
            Part::Mesh(mesh) => Some(mesh.nearest_z_mm(t_sensor_object)),
        }
    }

    /// Finds the highest part above each node of a skin, at a place that may depend on the part: `place(part,
    /// node)`.
    pub(super) fn highest(
        &mut self,
        contacts: &[Option<ContactState>],
        (skin_mm, place): (&[f64], impl Fn(usize, usize) -> DVec2),
        out: &mut Highest,
    ) {
        let count = skin_mm.len();
        out.part.clear();
        out.part.resize(count, 0);
        out.heights.clear();
        out.at.clear();
        for (part, contact) in contacts.iter().enumerate() {
            let Some(contact) = contact else { continue };
            out.places.clear();
            out.places.extend((0..count).map(|i| place(part, i)));
            self.heights(part, &contact.t_sensor_object, (&out.places, skin_mm), &mut out.own);
            // The support plate behind the gel limits all heights.
            out.own.iter_mut().for_each(|height| *height = height.min(self.thickness_mm));
            if out.heights.is_empty() {
                core::mem::swap(&mut out.heights, &mut out.own);
                core::mem::swap(&mut out.at, &mut out.places);
                out.part.fill(part as u8);
            } else {
                out.unite(part as u8);
            }
        }
        if out.heights.is_empty() {
            out.heights.resize(count, f64::NEG_INFINITY);
            out.at.extend((0..count).map(|i| place(0, i)));
        }
    }

    /// A part's heights above the skin at rest, each at its place; negative infinity without the part.
    pub(super) fn heights(
        &mut self,
        part: usize,
        t_sensor_object: &Pose,
        (places, skin_mm): (&[DVec2], &[f64]),
        out: &mut Vec<f64>,
    ) {
        match &mut self.list[part] {
            Part::Solid(shape) => {
                let to_object = t_sensor_object.inverse();
                let direction = to_object.transform_vector(DVec3::Z);
                out.clear();
                out.extend(places.iter().zip(skin_mm).map(|(&place, &skin_mm)| {
                    // (Inlined: a call would pass the vectors through memory and stall.)
                    let place = place.extend(skin_mm);
                    let origin = to_object.rotation * place + to_object.translation_mm;
                    shape.entry_mm(origin, direction).map_or(f64::NEG_INFINITY, |s| -s)
                }));
            }
            Part::Mesh(mesh) => mesh.heights_mm(t_sensor_object, (places, skin_mm), out),
        }
    }
}
