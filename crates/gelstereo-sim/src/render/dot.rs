//! A printed dot and its image.

use gelstereo_core::camera::Camera;
use gelstereo_core::math::{DVec2, DVec3, Pose, sqrt};
use gelstereo_core::rig::{Projection, RigView};

/// A printed dot: the disc |s| <= 1 under s -> centre + along s.x + across s.y, millimetres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dot {
    pub(crate) centre: DVec3,
    pub(crate) along: DVec3,
    pub(crate) across: DVec3,
}

/// Points centre + a cos t + b sin t, pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ellipse {
    /// Centre of the ellipse: the centroid of the dot's image.
    pub centre_px: DVec2,
    /// Two conjugate half diameters: images of the dot's radii along the lattice's row and column.
    pub half_px: [DVec2; 2],
}

impl Dot {
    /// Image of the dot, given in the sensor frame. `None` when a part of it is behind the camera.
    pub(crate) fn image(
        &self,
        view: &RigView<'_>,
        t_camera_sensor: &Pose,
        refracted: bool,
    ) -> Option<Ellipse> {
        if refracted || view.camera().distortion != [0.0; 5] {
            return self.traced(view);
        }
        let dot = Self {
            centre: t_camera_sensor.transform_point(self.centre),
            along: t_camera_sensor.transform_vector(self.along),
            across: t_camera_sensor.transform_vector(self.across),
        };
        dot.pinhole(view.camera())
    }

    /// Image without ellipse bias: the tangent of the projection at the dot's centre.
    pub(crate) fn unbiased(&self, view: &RigView<'_>) -> Option<Ellipse> {
        let Projection { pixel_px, jacobian: [columns, rows], .. } =
            view.project_with_jacobian(self.centre, 0.0).ok()?;
        let half = |axis: DVec3| DVec2::new(columns.dot(axis), rows.dot(axis));
        Some(Ellipse { centre_px: pixel_px, half_px: [half(self.along), half(self.across)] })
    }

    /// Exact image of a pinhole. A circle's image is an ellipse. Its centre is not the image of the
    /// circle's centre, but that of the pole of the vanishing line with respect to the circle: s =
    /// -(along.z, across.z) / centre.z.
    fn pinhole(&self, camera: &Camera) -> Option<Ellipse> {
        let pole = -DVec2::new(self.along.z, self.across.z) / self.centre.z;
        let at = |s: DVec2| camera.project(self.centre + self.along * s.x + self.across * s.y);
        let half = |axis: DVec2| Some((at(pole + axis)? - at(pole - axis)?) * 0.5);
        Some(Ellipse { centre_px: at(pole)?, half_px: [half(DVec2::X)?, half(DVec2::Y)?] })
    }

    /// Image through layers or a distorting lens. Six points of the outline give its Fourier series m +
    /// a cos t + b sin t + d cos 2t + e sin 2t. The second harmonic hardly bends the ellipse, but it
    /// moves the centroid of its region by ∮ p (δp × dp) / area, to first order in d and e.
    fn traced(&self, view: &RigView<'_>) -> Option<Ellipse> {
        const TURN: [(f64, f64); 6] = {
            let (c, s) = (0.5, 0.866_025_403_784_438_6); // 60 degrees
            [(1.0, 0.0), (c, s), (-c, s), (-1.0, 0.0), (-c, -s), (c, -s)]
        };
        let [mut m, mut a, mut b, mut d, mut e] = [DVec2::ZERO; 5];
        for (k, (c, s)) in TURN.into_iter().enumerate() {
            let p = view.project(self.centre + self.along * c + self.across * s).ok()?;
            let (c2, s2) = TURN[2 * k % 6];
            m += p / 6.0;
            a += p * (c / 3.0);
            b += p * (s / 3.0);
            d += p * (c2 / 3.0);
            e += p * (s2 / 3.0);
        }
        let shift = (a * (d.perp_dot(b) - e.perp_dot(a)) + b * (d.perp_dot(a) + e.perp_dot(b)))
            / (2.0 * a.perp_dot(b));
        let centre_px = if shift.is_finite() { m + shift } else { m };
        Some(Ellipse { centre_px, half_px: [a, b] })
    }
}

impl Ellipse {
    /// Radius of the circle of the same area.
    #[must_use]
    pub fn radius_px(&self) -> f64 {
        sqrt(self.half_px[0].perp_dot(self.half_px[1]).abs())
    }

    /// Half of its longest diameter.
    pub(crate) fn longest_px(&self) -> f64 {
        let [a, b] = self.half_px;
        let (xx, xy, yy) = (a.x * a.x + b.x * b.x, a.x * a.y + b.x * b.y, a.y * a.y + b.y * b.y);
        sqrt(0.5 * (xx + yy + sqrt((xx - yy) * (xx - yy) + 4.0 * xy * xy)))
    }

    /// Its extent from the centre along the image's rows and columns.
    #[must_use]
    pub fn reach_px(&self) -> DVec2 {
        let [a, b] = self.half_px;
        DVec2::new(sqrt(a.x * a.x + b.x * b.x), sqrt(a.y * a.y + b.y * b.y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use core::f64::consts::TAU;
    use gelstereo_core::math::{cos, sin, so3};
    use gelstereo_core::rig::{Rig, View};
    use proptest::prelude::*;

    /// Area and centroid of the polygon of 4000 points of a dot's outline.
    fn dense(dot: &Dot, view: &RigView<'_>) -> (f64, DVec2) {
        let at = |k: usize| {
            let t = TAU * k as f64 / 4000.0;
            view.project(dot.centre + dot.along * cos(t) + dot.across * sin(t)).unwrap_or(DVec2::NAN)
        };
        let origin = at(0);
        let (mut area, mut moment) = (0.0, DVec2::ZERO);
        for k in 0..4000 {
            let (p, q) = (at(k) - origin, at(k + 1) - origin);
            let twice = p.perp_dot(q);
            area += 0.5 * twice;
            moment += (p + q) * (twice / 6.0);
        }
        (area.abs(), origin + moment / area)
    }

    fn check(rig: &Rig, dot: &Dot, tolerance_px: f64) -> Result<(), TestCaseError> {
        for (view, t_camera_sensor) in [(View::Left, Pose::IDENTITY), (View::Right, rig.t_right_left)] {
            let view = rig.view(view);
            let found = dot.image(&view, &t_camera_sensor, rig.layers.is_some());
            let found = found.ok_or_else(|| TestCaseError::fail("not seen"))?;
            let (area, centroid) = dense(dot, &view);
            let off = (found.centre_px - centroid).length();
            prop_assert!(off < tolerance_px, "{off} px from {centroid}");
            // Relative to the area seen face on, because a dot seen edge-on has no area.
            let [a, b] = found.half_px.map(DVec2::length_squared);
            let off_px2 = found.radius_px() * found.radius_px() * core::f64::consts::PI - area;
            let share = off_px2 / (core::f64::consts::PI * a.max(b));
            prop_assert!(share.abs() < 2e-3, "{share} of the area");
        }
        Ok(())
    }

    /// A dot of the gel at z, stretched and tilted.
    fn dot(x: f64, y: f64, z: f64, radius_mm: f64, tilt: [f64; 2], stretch: [f64; 2]) -> Dot {
        let turn = so3::exp(DVec3::new(tilt[0], tilt[1], 0.4));
        Dot {
            centre: DVec3::new(x, y, z),
            along: turn * (DVec3::X * (radius_mm * stretch[0])),
            across: turn * (DVec3::Y * (radius_mm * stretch[1])),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// The whole gel of the second rig of the benchmarks, pressed up to 4 mm, tilted up to 50
        /// degrees. The error is third order in radius over distance: 5 px · (0.2 / 25)³ · a few.
        #[test]
        fn behind_layers_a_dot_has_its_regions_centroid(
            x in -3.0..13.0, y in -8.0..8.0, z in 24.0..28.5, a in -0.9..0.9, b in -0.9..0.9,
            along in 0.7..1.4, across in 0.7..1.4, slant in -0.05..0.05,
        ) {
            let refracting = Scene::preset("640x480-25-refraction");
            let mut rig = refracting.map(|scene| scene.rig).unwrap_or_else(Scene::default_rig);
            if let Some(layers) = &mut rig.layers {
                layers.normal = DVec3::new(slant, 0.3 * slant, 1.0).normalize();
            }
            check(&rig, &dot(x, y, z, 0.2, [a, b], [along, across]), 1e-5)?;
        }

        #[test]
        fn before_a_lens_that_distorts_too(
            x in -6.0..14.0, y in -10.0..10.0, a in -0.9..0.9, b in -0.9..0.9, k1 in -0.3..0.3,
            k2 in -0.1..0.1,
        ) {
            let mut rig = Scene::default_rig();
            rig.left.distortion = [k1, k2, 0.002, -0.001, 0.0];
            rig.right.distortion = [k1, 0.0, -0.002, 0.001, 0.01];
            // Third order again, 5 px · (0.22 / 28)³ · a few: largest for dots that are seen nearly
            // edge-on.
            check(&rig, &dot(x, y, 28.0, 0.22, [a, b], [1.1, 0.9]), 3e-5)?;
        }

        /// The closed form is exact; 4000 corners lose 4e-7 of the area.
        #[test]
        fn before_a_pinhole_the_pole_is_the_centroid(
            x in -6.0..14.0, y in -10.0..10.0, a in -0.9..0.9, b in -0.9..0.9,
        ) {
            check(&Scene::default_rig(), &dot(x, y, 28.0, 0.45, [a, b], [1.1, 0.9]), 1e-6)?;
        }

        /// Layers of air are equivalent to no layers.
        #[test]
        fn layers_of_air_change_nothing(x in -3.0..13.0, y in -8.0..8.0, a in -0.9..0.9, b in -0.9..0.9) {
            let mut rig = Scene::default_rig();
            let dot = dot(x, y, 28.0, 0.2, [a, b], [1.0, 1.2]);
            let plain = dot.image(&rig.view(View::Left), &Pose::IDENTITY, false).unwrap_or_default();
            rig.layers = Some(gelstereo_core::camera::Layers {
                normal: DVec3::Z,
                gap_mm: 20.0,
                plates: alloc::vec::Vec::new(),
                gel_index: 1.0,
            });
            let air = dot.image(&rig.view(View::Left), &Pose::IDENTITY, true).unwrap_or_default();
            prop_assert!((plain.centre_px - air.centre_px).length() < 1e-5);
            prop_assert!((plain.radius_px() - air.radius_px()).abs() < 2e-3);
        }
    }
}
