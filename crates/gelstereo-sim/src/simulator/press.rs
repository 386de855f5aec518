//! The gel under a part.

use super::{Part, Simulator};
use crate::effects::Grip;
use crate::simulator::ContactState;
use alloc::vec::Vec;
use gelstereo_core::math::{DVec2, DVec3};

impl Simulator {
    /// Computes heights, sideways motion and the markers in contact into the scratch.
    pub(super) fn press(&mut self, contact: &ContactState) {
        if self.drag.is_none() && self.spread.is_none() {
            self.place(|_| DVec2::ZERO);
            return self.imprint(contact);
        }
        // Sticking markers touched the part before the drag, so contact is evaluated at their carried
        // places.
        let grip = self.drag.is_some().then(|| self.grip(contact));
        self.place(|rest| grip.map_or(DVec2::ZERO, |grip| grip.motion_mm(rest)));
        self.imprint(contact);
        let Self { drag, spread, scratch, lattice, rest, .. } = self;
        if let (Some(drag), Some(grip)) = (drag, grip) {
            drag.pull(&grip, (rest, &scratch.stuck), &mut scratch.motion);
        }
        if let Some(spread) = spread {
            let [first, second] = &mut scratch.fields;
            spread.push(lattice, &scratch.heights, [first, second], &mut scratch.motion);
        }
        // Markers that moved sideways meet the part at another point.
        self.scratch.places.clear();
        self.scratch.places.extend(self.rest.iter().zip(&self.scratch.motion).map(|(&rest, &u)| rest + u));
        self.imprint(contact);
    }

    /// Places the markers at their rest positions plus `motion`.
    fn place(&mut self, motion: impl Fn(DVec2) -> DVec2) {
        self.scratch.places.clear();
        self.scratch.places.extend(self.rest.iter().map(|&rest| rest + motion(rest)));
    }

    /// The part's motion in the plane, about the centre of the markers that it touches before it twists.
    pub(super) fn grip(&mut self, contact: &ContactState) -> Grip {
        let shear = DVec2::from_array(contact.shear_mm);
        if contact.twist_rad == 0.0 {
            return Grip::new(contact, DVec2::ZERO);
        }
        self.place(|_| shear);
        self.touch(contact);
        let touched = self.rest.iter().zip(&self.scratch.obstacle).filter(|&(_, &height)| height > 0.0);
        let (sum, count) =
            touched.fold((DVec2::ZERO, 0.0), |(sum, count), (&rest, _)| (sum + rest, count + 1.0));
        Grip::new(contact, if count > 0.0 { sum / count } else { DVec2::ZERO })
    }

    /// The part's height above the rest plane at every place in the scratch; negative infinity without
    /// the part.
    pub(super) fn touch(&mut self, contact: &ContactState) {
        let (places, mut obstacle) =
            (core::mem::take(&mut self.scratch.places), core::mem::take(&mut self.scratch.obstacle));
        self.heights(contact, &places, &mut obstacle);
        (self.scratch.places, self.scratch.obstacle) = (places, obstacle);
    }

    /// The part's height above the rest plane at these places; negative infinity without the part.
    pub(super) fn heights(&mut self, contact: &ContactState, places: &[DVec2], out: &mut Vec<f64>) {
        let pose = contact.t_sensor_object;
        match &mut self.part {
            Some(Part::Solid(shape)) => {
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
            Some(Part::Mesh(mesh)) => mesh.heights_mm(&pose, self.surface_mm, places, out),
            None => {}
        }
        // The support plate behind the gel limits all heights.
        out.iter_mut().for_each(|height| *height = height.min(self.lattice.thickness_mm));
    }

    /// Computes heights of the markers at their places, and which of them the part touches.
    fn imprint(&mut self, contact: &ContactState) {
        self.touch(contact);
        let Self { scratch, shoulder, .. } = self;
        match shoulder {
            Some(shoulder) => {
                shoulder.settle(&scratch.obstacle, &mut scratch.heights);
            }
            None => {
                scratch.heights.clear();
                scratch.heights.extend(scratch.obstacle.iter().map(|&height| height.max(0.0)));
            }
        }
        scratch.stuck.clear();
        let touched = |(&height, &obstacle): (&f64, &f64)| obstacle > 0.0 && height <= obstacle;
        scratch.stuck.extend(scratch.heights.iter().zip(&scratch.obstacle).map(touched));
    }
}
