//! The gel under the parts.

use super::parts::Highest;
use super::{Scratch, Simulator};
use crate::effects::Grip;
use crate::simulator::ContactState;
use alloc::vec::Vec;
use gelstereo_core::math::DVec2;

impl Simulator {
    /// Computes heights, sideways motion and the markers in contact into the scratch.
    pub(super) fn press(&mut self, contacts: &[Option<ContactState>]) {
        let grips = self.grips(self.drag.is_some(), contacts);
        // Sticking markers touched the part before the drag, so contact is evaluated at their carried
        // places.
        self.imprint(contacts, |part, rest, _| rest + carried_mm(&grips, part, rest));
        if (self.drag.is_some() || self.spread.is_some()) && contacts.iter().any(Option::is_some) {
            self.pull_and_push(&grips);
            // Markers that moved sideways meet the part at another point.
            self.imprint(contacts, |_, rest, motion| rest + motion);
        }
        self.scratch.grips = grips;
    }

    /// Moves the markers sideways by their heights and by the parts that they stick to.
    fn pull_and_push(&mut self, grips: &[Grip]) {
        let Self { drag, spread, scratch, lattice, rest, .. } = self;
        if let Some(drag) = drag {
            let part = &scratch.obstacle.part;
            let carried = |i: usize| carried_mm(grips, part[i].into(), rest[i]);
            drag.pull(carried, &scratch.stuck, &mut scratch.motion);
        }
        if let Some(spread) = spread {
            let [first, second] = &mut scratch.fields;
            spread.push(lattice, &scratch.heights, [first, second], &mut scratch.motion);
        }
    }

    /// Motion of each part in the plane, none at all unless the gel sticks. The buffer is the scratch's.
    pub(super) fn grips(&mut self, sticks: bool, contacts: &[Option<ContactState>]) -> Vec<Grip> {
        let mut grips = core::mem::take(&mut self.scratch.grips);
        grips.clear();
        for (part, contact) in contacts.iter().enumerate().filter(|_| sticks) {
            grips.push(contact.as_ref().map_or_else(Grip::default, |contact| self.grip(part, contact)));
        }
        grips
    }

    /// A part's motion in the plane, about the centre of the markers that it touches before it twists.
    fn grip(&mut self, part: usize, contact: &ContactState) -> Grip {
        let shear = DVec2::from_array(contact.shear_mm);
        if contact.twist_rad == 0.0 {
            return Grip::new(contact, DVec2::ZERO);
        }
        let Self { parts, rest, skin_mm, scratch, .. } = self;
        let Highest { own, places, .. } = &mut scratch.obstacle;
        places.clear();
        places.extend(rest.iter().map(|&rest| rest + shear));
        parts.heights(part, &contact.t_sensor_object, (places, skin_mm), own);
        let touched = rest.iter().zip(own).filter(|&(_, &mut height)| height > 0.0);
        let (sum, count) =
            touched.fold((DVec2::ZERO, 0.0), |(sum, count), (&rest, _)| (sum + rest, count + 1.0));
        Grip::new(contact, if count > 0.0 { sum / count } else { DVec2::ZERO })
    }

    /// Finds the parts over the markers: `place(part, rest, motion)` is where a marker meets a part.
    pub(super) fn touch(
        &mut self,
        contacts: &[Option<ContactState>],
        place: impl Fn(usize, DVec2, DVec2) -> DVec2,
    ) {
        let Self { parts, rest, skin_mm, scratch: Scratch { motion, obstacle, .. }, .. } = self;
        parts.highest(contacts, (skin_mm, |part, i| place(part, rest[i], motion[i])), obstacle);
    }

    /// Computes heights of the markers at their places, and which of them a part touches.
    fn imprint(&mut self, contacts: &[Option<ContactState>], place: impl Fn(usize, DVec2, DVec2) -> DVec2) {
        self.touch(contacts, place);
        let Self { scratch, shoulder, .. } = self;
        let obstacle = &scratch.obstacle.heights;
        match shoulder {
            Some(shoulder) if contacts.iter().any(Option::is_some) => {
                shoulder.settle(obstacle, &mut scratch.heights);
            }
            _ => {
                scratch.heights.clear();
                scratch.heights.extend(obstacle.iter().map(|&height| height.max(0.0)));
            }
        }
        scratch.stuck.clear();
        let touched = |(&height, &obstacle): (&f64, &f64)| obstacle > 0.0 && height <= obstacle;
        scratch.stuck.extend(scratch.heights.iter().zip(obstacle).map(touched));
    }
}

/// Motion of a point that a part carries along.
pub(super) fn carried_mm(grips: &[Grip], part: usize, rest: DVec2) -> DVec2 {
    grips.get(part).map_or(DVec2::ZERO, |grip| grip.motion_mm(rest))
}
