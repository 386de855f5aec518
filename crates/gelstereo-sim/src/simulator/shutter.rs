//! Marker motion during the exposure.

use super::{OUT_OF_SIGHT_PX, Simulator, Truth};
use crate::simulator::ContactState;
use gelstereo_core::math::{DVec2, DVec3};
use gelstereo_core::rig::View;

impl Simulator {
    /// Stores the markers' positions at the opening and closing of the shutter in the scratch; nothing
    /// without an exposure.
    pub(super) fn expose(&mut self, contacts: &[Option<ContactState>], frame: u64) {
        let Some(exposure_s) = self.exposure_s else { return };
        let time_s = self.time_s(frame);
        for (end, half_s) in [-0.5 * exposure_s, 0.5 * exposure_s].into_iter().enumerate() {
            let at_s = time_s + half_s;
            let carried = |(part, contact): (usize, &Option<ContactState>)| {
                contact.as_ref().map(|contact| self.trajectory.carried(part, contact, [time_s, at_s]))
            };
            let mut moved = core::mem::take(&mut self.scratch.meanwhile);
            moved.clear();
            moved.extend(contacts.iter().enumerate().map(carried));
            self.stand(&moved, frame, at_s);
            self.scratch.meanwhile = moved;
            let mut points_mm = core::mem::take(&mut self.scratch.ends_mm[end]);
            self.points(&mut points_mm);
            self.scratch.ends_mm[end] = points_mm;
        }
    }

    /// Writes the motion of the images of markers and specks during the exposure.
    pub(super) fn write_motion(&self, out: &mut Truth) {
        let Self { scratch, rig, specks, gel, .. } = self;
        let [open, close] = &scratch.ends_mm;
        for (view, motion_px) in
            [(View::Left, &mut out.left_motion_px), (View::Right, &mut out.right_motion_px)]
        {
            motion_px.clear();
            if open.is_empty() {
                continue;
            }
            let view = rig.view(view);
            let pixel = |at: DVec3| view.project(at).unwrap_or(OUT_OF_SIGHT_PX);
            let way = |(from, to): (DVec3, DVec3)| {
                let ends = [from, to].map(pixel);
                // A point behind the camera at either end has no motion.
                if ends.contains(&OUT_OF_SIGHT_PX) { DVec2::ZERO } else { ends[1] - ends[0] }
            };
            motion_px.extend(open.iter().copied().zip(close.iter().copied()).map(way));
            let ends = |speck: &crate::effects::Speck| {
                let [from, to] = [open, close].map(|points_mm| speck.dot(points_mm, gel).centre);
                way((from, to))
            };
            motion_px.extend(specks.iter().map(ends));
        }
    }
}
