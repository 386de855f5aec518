//! Upper bounds of the motion of the markers' images within a short time.

use crate::plan::{Effect, Facts};
use gelstereo_core::math::{DVec2, so3};

/// Maximum speeds of part and gel on their trajectories, per second.
#[derive(Clone, Copy, Debug, Default)]
struct Pace {
    /// A point of a part, in the plane of the gel and along the sensor's z, including rotation.
    part_mm: [f64; 2],
    /// Gel that sticks to the part: shear and twist.
    grip: f64,
    /// A point of the gel moving as a whole.
    gel_mm: f64,
}

impl Pace {
    fn of(facts: &Facts<'_>) -> Self {
        let mut pace = Self::default();
        let steps =
            facts.scene.parts().flat_map(|(_, keyframes)| keyframes.iter().zip(keyframes.iter().skip(1)));
        for (a, b) in steps {
            let per_s = 1.0 / (b.time_s - a.time_s);
            let (a, b) = (a.contact, b.contact);
            let away = b.t_sensor_object.translation_mm - a.t_sensor_object.translation_mm;
            let turn = so3::log(a.t_sensor_object.rotation.conjugate() * b.t_sensor_object.rotation).length();
            // Rotation does not move a ball.
            let turned = if turn > 0.0 { turn * facts.touch.arm_mm } else { 0.0 };
            let shear = DVec2::from_array(b.shear_mm) - DVec2::from_array(a.shear_mm);
            let grip = shear.length() + (b.twist_rad - a.twist_rad).abs() * facts.touch.span_mm;
            let paces = [away.truncate().length() + turned, away.z.abs() + turned].map(|mm| mm * per_s);
            pace.part_mm = [0, 1].map(|k| pace.part_mm[k].max(paces[k]));
            pace.grip = pace.grip.max(grip * per_s);
        }
        let gel = &facts.scene.gel;
        let radius_mm = gel.half_mm().length() + facts.sideways_mm;
        let moves = &facts.scene.gel_motion;
        for (a, b) in moves.iter().zip(moves.iter().skip(1)) {
            let shift = DVec2::from_array(b.shift_mm) - DVec2::from_array(a.shift_mm);
            let turn = (b.rotation_rad - a.rotation_rad).abs();
            pace.gel_mm = pace.gel_mm.max((shift.length() + turn * radius_mm) / (b.time_s - a.time_s));
        }
        pace
    }
}

impl Facts<'_> {
    /// Largest motion of a marker's image within a time.
    pub(crate) fn passed_px(&self, time_s: f64) -> f64 {
        let (sideways_mm, depth_mm) = self.passed_mm(time_s);
        let ways = [(self.optics.lateral_px_per_mm, sideways_mm), (self.optics.depth_px_per_mm, depth_mm)];
        ways.into_iter().filter(|&(_, mm)| mm > 0.0).map(|(px_per_mm, mm)| px_per_mm * mm).sum()
    }

    /// Expected motion of the image of a marker that follows part and gel; not a bound.
    pub(crate) fn followed_px(&self, time_s: f64) -> f64 {
        let pace = Pace::of(self);
        let touches = self.touch.depth_mm > 0.0;
        let (sideways_mm, down_mm) =
            if touches { (pace.gel_mm + pace.grip, pace.part_mm[1]) } else { (pace.gel_mm, 0.0) };
        let ways = [(self.optics.lateral_px_per_mm, sideways_mm), (self.optics.depth_px_per_mm, down_mm)];
        time_s
            * ways.into_iter().filter(|&(_, mm)| mm > 0.0).map(|(px_per_mm, mm)| px_per_mm * mm).sum::<f64>()
    }

    /// Largest motion of a marker sideways and along the sensor's z within a time.
    fn passed_mm(&self, time_s: f64) -> (f64, f64) {
        let pace = Pace::of(self);
        let gel_mm = time_s * pace.gel_mm;
        let [part_mm, down_mm] = pace.part_mm.map(|mm| time_s * mm);
        let meets_mm = part_mm + gel_mm + time_s * pace.grip;
        let still = meets_mm == 0.0 && down_mm == 0.0;
        if still || !(self.touch.depth_mm > 0.0) {
            return (gel_mm, 0.0);
        }
        let effects = &self.scene.effects;
        if effects.elastic_layer.is_some() {
            return (gel_mm + self.when_contact_changes_mm(), 2.0 * self.touch.depth_mm);
        }
        // A marker that comes into contact sticks at once.
        let stuck_mm =
            effects.drag.as_ref().map_or(0.0, |_| 2.0 * core::f64::consts::SQRT_2 * self.touch.grip_mm());
        // Heights follow the moved part, and a membrane over them changes by no more than they do.
        let rise_mm = |beside_mm: f64| {
            let steep = if beside_mm > 0.0 { self.touch.steepness * beside_mm } else { 0.0 };
            self.touch.depth_mm.min(down_mm + steep)
        };
        // Spreading is proportional to heights; rising and sinking heights contribute separately.
        let spread_mm = effects.spread.as_ref().map_or(0.0, |spread| {
            2.0 * spread.sideways_mm(self) * rise_mm(meets_mm + stuck_mm) / self.touch.depth_mm
        });
        let own_mm = stuck_mm + spread_mm;
        (gel_mm + own_mm, rise_mm(meets_mm + own_mm))
    }
}
