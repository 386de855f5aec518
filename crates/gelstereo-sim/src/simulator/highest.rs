//! The parts over the gel.

use super::{Part, Simulator};
use crate::simulator::ContactState;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3};

/// Which part is highest above the rest surface, for each of some places: where parts are united, the gel
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

impl Simulator {
    /// Finds the highest part at `count` places, which may depend on the part: `place(part, index)`.
    pub(super) fn highest(
        &mut self,
        contacts: &[Option<ContactState>],
        (count, place): (usize, impl Fn(usize, usize) -> DVec2),
        out: &mut Highest,
    ) {
        out.part.clear();
        out.part.resize(count, 0);
        out.heights.clear();
        out.at.clear();
        for (part, contact) in contacts.iter().enumerate() {
            let Some(contact) = contact else { continue };
            out.places.clear();
            out.places.extend((0..count).map(|i| place(part, i)));
            self.heights(part, contact, &out.places, &mut out.own);
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

    /// A part's height above the rest plane at these places; negative infinity without the part.
    pub(super) fn heights(
        &mut self,
        part: usize,
        contact: &ContactState,
        places: &[DVec2],
        out: &mut Vec<f64>,
    ) {
        let pose = contact.t_sensor_object;
        match &mut self.parts[part] {
            Part::Solid(shape) => {
                let to_object = pose.inverse();
                let direction = to_object.transform_vector(DVec3::Z);
                out.clear();
                out.extend(places.iter().map(|&place| {
                    // (Inlined: a call would pass the vectors through memory and stall.)
                    let place = place.extend(self.surface_mm);
                    let origin = to_object.rotation * place + to_object.translation_mm;
                    shape.entry_mm(origin, direction).map_or(f64::NEG_INFINITY, |s| -s)
                }));
            }
            Part::Mesh(mesh) => mesh.heights_mm(&pose, self.surface_mm, places, out),
        }
        // The support plate behind the gel limits all heights.
        out.iter_mut().for_each(|height| *height = height.min(self.lattice.thickness_mm));
    }
}
