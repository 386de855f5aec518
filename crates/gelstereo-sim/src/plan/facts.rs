//! Properties of a scene that are known before the simulation.

use crate::plan::Bound;
use crate::scene::{Gel, Keyframe, Scene};
use crate::shapes::{Shape, Solid};
use gelstereo_core::camera::Camera;
use gelstereo_core::math::{DVec2, DVec3, Pose, cos, sin, so3, sqrt};
use gelstereo_core::params::PrintLayout;
use gelstereo_core::rig::{Rig, View};

/// Inputs of the bounds. The scene excludes the effects that are forced off.
#[derive(Clone, Debug)]
pub(crate) struct Facts<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) touch: Touch,
    /// Largest sideways displacement of a marker by all effects together.
    pub(crate) sideways_mm: f64,
    /// Largest stretch of the gel between two neighbours by all effects, as a share.
    pub(crate) stretch: f64,
    pub(crate) optics: Optics,
}

/// The parts and the gel in the worst case along the trajectories: all parts at once, each as if it were
/// alone.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Touch {
    /// Depth of the part in the gel; at most the gel's thickness, and 0 without contact.
    pub(crate) depth_mm: f64,
    /// Steepest slope of the part's surface; infinite at a vertical wall.
    pub(crate) steepness: f64,
    /// Longest distance between two points of a part's section with the rest surface, summed over the
    /// parts.
    pub(crate) span_mm: f64,
    /// Upper bound of the sections' area.
    pub(crate) footprint_mm2: f64,
    /// Lever arm of the part's visible rotation about its origin: 0 for a ball.
    pub(crate) arm_mm: f64,
    /// The part's shear.
    pub(crate) shear_mm: f64,
    /// The part's twist.
    pub(crate) twist_rad: f64,
}

/// The cameras' properties in the worst case over the gel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Optics {
    /// Pixels per millimetre in the plane of the gel.
    pub(crate) lateral_px_per_mm: f64,
    /// Pixels per millimetre along the sensor's z.
    pub(crate) depth_px_per_mm: f64,
    /// Tangent of the angle between a camera's axis and a marker, without lens distortion.
    pub(crate) slope: f64,
    /// The longest focal length.
    pub(crate) f_px: f64,
    /// Displacement of a marker's image by the layers.
    pub(crate) refraction_px: f64,
    /// Sine of the angle between the gel's plane, or the layers, and an image plane.
    pub(crate) tilt: f64,
}

impl<'a> Facts<'a> {
    pub(crate) fn of(scene: &'a Scene, parts: &[Solid<'_>]) -> Self {
        let touch = Touch::of(scene, parts);
        let mut facts = Self { scene, touch, sideways_mm: 0.0, stretch: 0.0, optics: Optics::default() };
        facts.sideways_mm = scene.effects.listed().map(|(_, effect)| effect.sideways_mm(&facts)).sum();
        facts.stretch = scene.effects.listed().map(|(_, effect)| effect.stretch(&facts)).sum();
        facts.optics = Optics::of(&facts);
        facts
    }

    pub(crate) fn markers(&self) -> f64 {
        (self.scene.gel.rows * self.scene.gel.cols) as f64
    }

    /// Pixels of both images.
    pub(crate) fn pixels(&self) -> f64 {
        let Rig { left, right, .. } = &self.scene.rig;
        [left, right].map(|camera| (camera.width_px * camera.height_px) as f64).iter().sum()
    }

    /// Time to relax a field over the lattice: about 11 sweeps per pitch of decay length, plus the
    /// field's setup.
    pub(crate) fn relaxation_ns(&self, decay_thicknesses: f64) -> f64 {
        const PER_MARKER_NS: f64 = 20.0;
        const PER_SWEEP_NS: f64 = 3.1;
        if !(self.touch.depth_mm > 0.0) {
            return (PER_MARKER_NS + PER_SWEEP_NS) * self.markers();
        }
        let reach = decay_thicknesses * self.scene.gel.thickness_mm / self.scene.gel.least_pitch_mm();
        (PER_MARKER_NS + PER_SWEEP_NS * 11.0 * reach.max(1.0)) * self.markers()
    }

    /// Largest sideways motion of a marker under any change of contact: from the full motion in one
    /// direction to the full motion in the opposite one.
    pub(crate) fn when_contact_changes_mm(&self) -> f64 {
        let print_mm = self.scene.effects.misprint.as_ref().map_or(0.0, |misprint| misprint.shift_mm);
        2.0 * (self.sideways_mm - print_mm).max(0.0)
    }

    /// Width of the heights if all equalled the part's depth: the footprint, a pitch for the lattice's
    /// resolution, and the shoulder, which decays as exp(-d / l) beside a strip and faster beside
    /// anything smaller.
    pub(crate) fn pressed_mm(&self) -> f64 {
        let (gel, effects) = (&self.scene.gel, &self.scene.effects);
        let shoulder =
            effects.shoulder.as_ref().map_or(0.0, |shoulder| shoulder.decay_thicknesses * gel.thickness_mm);
        self.touch.span_mm + 2.0 * (shoulder + gel.pitch_mm.x_mm.max(gel.pitch_mm.y_mm))
    }

    /// Radius of the largest dot.
    pub(crate) fn dot_radius_mm(&self) -> f64 {
        let share = self.scene.effects.misprint.as_ref().map_or(0.0, |misprint| misprint.radius_share);
        self.scene.gel.dot_radius_mm * (1.0 + share)
    }

    /// Smallest distance of two neighbouring dots as printed.
    pub(crate) fn least_pitch_mm(&self) -> f64 {
        let shift = self.scene.effects.misprint.as_ref().map_or(0.0, |misprint| misprint.shift_mm);
        self.scene.gel.least_pitch_mm() - 2.0 * shift
    }

    /// Height change when a marker meets the part this far aside.
    pub(crate) fn height_mm(&self, sideways_mm: f64) -> f64 {
        if sideways_mm > 0.0 { self.touch.depth_mm.min(self.touch.steepness * sideways_mm) } else { 0.0 }
    }

    /// Bound for markers that move by up to this much sideways and along the sensor's z.
    pub(crate) fn moved(&self, sideways_mm: f64, depth_mm: f64) -> Bound {
        if !(sideways_mm > 0.0 || depth_mm > 0.0) {
            return Bound::NONE;
        }
        let Optics { lateral_px_per_mm, depth_px_per_mm, .. } = self.optics;
        let px = |share: f64| share * (lateral_px_per_mm * sideways_mm + depth_px_per_mm * depth_mm);
        // A dot's outline also stretches with its neighbours' motion. A point of it moves by the
        // centre's motion and sqrt(2) r times the motion's gradient, at most 2 / pitch of the motion.
        // In a hexagonal print it is 2 / pitch along rows, and at most 12^0.5 / pitch across them.
        let gradient = match self.scene.gel.layout {
            PrintLayout::Square => 2.0 * core::f64::consts::SQRT_2,
            PrintLayout::Hexagonal => 4.0,
        };
        let stretch = gradient * self.dot_radius_mm() / self.least_pitch_mm();
        Bound {
            px: px(1.0) + 2.0 * self.ellipse_px(),
            um: 1e3 * sqrt(sideways_mm * sideways_mm + depth_mm * depth_mm),
            levels: self.levels_of_outlines(px(1.0 + stretch)),
        }
    }

    /// Level change of pixels when dot outlines move by d. A convex curve crosses a pixel along 4 px at
    /// most, and the area within d of it is 4 d + π d² of the pixel.
    pub(crate) fn levels_of_outlines(&self, moved_px: f64) -> f64 {
        let share = moved_px * (4.0 + core::f64::consts::PI * moved_px);
        if moved_px > 0.0 { self.contrast_levels() * share.min(1.0) } else { 0.0 }
    }

    /// Largest factor of the light on one grey level.
    pub(crate) fn gain(&self) -> f64 {
        self.scene.effects.uneven_light.as_ref().map_or(1.0, |light| light.span().1.max(1.0))
    }

    /// Contrast between dot and gel in the brightest light.
    pub(crate) fn contrast_levels(&self) -> f64 {
        let gel = &self.scene.gel;
        f64::from(gel.bright_level - gel.dark_level) * self.gain()
    }

    /// Largest change by the grain, before the light.
    pub(crate) fn grain_levels(&self) -> f64 {
        self.scene.effects.grain.as_ref().map_or(0.0, crate::effects::Grain::most_levels)
    }

    /// Darkest and brightest level of the gel and its dots in any light, including grain.
    pub(crate) fn levels(&self) -> [f64; 2] {
        let (gel, effects) = (&self.scene.gel, &self.scene.effects);
        let [dark, bright] = [f64::from(gel.dark_level), f64::from(gel.bright_level)];
        let (min_gain, max_gain) = effects.uneven_light.as_ref().map_or((1.0, 1.0), |light| light.span());
        let (low, high) = (dark - self.grain_levels(), bright + self.grain_levels());
        [low * if low > 0.0 { min_gain.min(1.0) } else { max_gain.max(1.0) }, high * max_gain.max(1.0)]
    }

    /// Upper bound of the distance from a dot's projected centre to its image's centroid: see
    /// [`crate::effects::ellipse_bias_px`].
    pub(crate) fn ellipse_px(&self) -> f64 {
        crate::effects::ellipse_bias_px(self)
    }
}

impl Touch {
    fn of(scene: &Scene, parts: &[Solid<'_>]) -> Self {
        let gel = &scene.gel;
        let [x_mm, y_mm] = gel.spacing_mm();
        let sides = [gel.cols as f64 * x_mm, gel.rows as f64 * y_mm];
        let trajectories = scene.parts().map(|(_, trajectory)| trajectory);
        let relief_mm = relief_mm(scene);
        let all = parts
            .iter()
            .zip(trajectories)
            .map(|(part, trajectory)| Self::of_part(gel, relief_mm, part, trajectory));
        let touch = all.fold(Self::default(), |a, b| Self {
            depth_mm: a.depth_mm.max(b.depth_mm),
            steepness: a.steepness.max(b.steepness),
            span_mm: a.span_mm + b.span_mm,
            footprint_mm2: a.footprint_mm2 + b.footprint_mm2,
            arm_mm: a.arm_mm.max(b.arm_mm),
            shear_mm: a.shear_mm.max(b.shear_mm),
            twist_rad: a.twist_rad.max(b.twist_rad),
        });
        Self {
            span_mm: touch.span_mm.min(DVec2::from_array(sides).length()),
            footprint_mm2: touch.footprint_mm2.min(sides[0] * sides[1]),
            ..touch
        }
    }

    fn of_part(gel: &Gel, relief_mm: [f64; 2], part: &Solid<'_>, trajectory: &[Keyframe]) -> Self {
        // Beyond the highest skin.
        let depth_mm = (part.depth_mm(gel, trajectory) + relief_mm[1]).clamp(0.0, gel.thickness_mm);
        let (span_mm, steepness) = part.footprint(depth_mm);
        let all = trajectory.iter().map(|k| k.contact);
        let shear = all.clone().map(|c| DVec2::from_array(c.shear_mm).length()).fold(0.0, f64::max);
        let twist = all.map(|c| c.twist_rad.abs()).fold(0.0, f64::max);
        Self {
            depth_mm,
            steepness,
            span_mm,
            // A disc has the largest area for a given span.
            footprint_mm2: 0.25 * core::f64::consts::PI * span_mm * span_mm,
            arm_mm: if part.is_ball() { 0.0 } else { part.radius_mm() },
            // Without a trajectory any contact is possible.
            shear_mm: if trajectory.is_empty() { f64::INFINITY } else { shear },
            twist_rad: if trajectory.is_empty() { f64::INFINITY } else { twist },
        }
    }

    /// Largest motion of a marker that sticks to the part: shear, and twist about a point within the
    /// footprint.
    pub(crate) fn grip_mm(&self) -> f64 {
        if self.depth_mm > 0.0 {
            let half = 0.5 * self.twist_rad.min(core::f64::consts::PI);
            self.shear_mm + 2.0 * sin(half) * self.span_mm
        } else {
            0.0
        }
    }
}

impl Solid<'_> {
    fn is_ball(&self) -> bool {
        matches!(self, Self::Shape(Shape::Sphere { .. }))
    }

    /// Distance of the farthest point from the origin.
    fn radius_mm(&self) -> f64 {
        match self {
            Self::Shape(Shape::Sphere { radius_mm }) => *radius_mm,
            Self::Shape(_) => {
                let half = [DVec3::X, DVec3::Y, DVec3::Z]
                    .map(|axis| self.support_mm(axis).max(self.support_mm(-axis)));
                DVec3::from_array(half).length()
            }
            Self::Mesh(mesh) => mesh.vertices_mm().iter().map(|v| v.length()).fold(0.0, f64::max),
        }
    }

    /// Largest depth beyond the rest surface in any frame. Between two keyframes the depth is linear
    /// except for the rotation, which moves the nearest point by at most its radius times the angle to
    /// the nearer keyframe.
    fn depth_mm(&self, gel: &Gel, trajectory: &[Keyframe]) -> f64 {
        let depth = |pose: &Pose| {
            let towards_camera = pose.rotation.conjugate() * DVec3::NEG_Z;
            gel.surface_mm - pose.translation_mm.z + self.support_mm(towards_camera)
        };
        let poses = || trajectory.iter().map(|k| k.contact.t_sensor_object);
        let Some(first) = poses().next() else { return f64::INFINITY };
        let mut deepest = depth(&first);
        for (from, to) in poses().zip(poses().skip(1)) {
            let turn = so3::log(from.rotation.conjugate() * to.rotation).length();
            let between = if turn > 0.0 { 0.5 * turn * self.radius_mm() } else { 0.0 };
            deepest = deepest.max(depth(&from).max(depth(&to)) + between);
        }
        deepest
    }

    /// Longest chord of the section at this depth, and the steepness of the part in front of it.
    fn footprint(&self, depth_mm: f64) -> (f64, f64) {
        let radius_mm = self.radius_mm();
        let left = radius_mm - depth_mm;
        if self.is_ball() && left > 0.0 {
            let half = sqrt(radius_mm * radius_mm - left * left);
            return (2.0 * half, half / left);
        }
        (2.0 * radius_mm, f64::INFINITY)
    }
}

impl Optics {
    fn of(facts: &Facts<'_>) -> Self {
        let Rig { left, right, t_right_left, layers } = &facts.scene.rig;
        let plain = |camera: &Camera| Camera { distortion: [0.0; 5], ..camera.clone() };
        let through = Rig {
            left: plain(left),
            right: plain(right),
            t_right_left: *t_right_left,
            layers: layers.clone(),
        };
        let bare = Rig { layers: None, ..through.clone() };
        let axes = [DVec3::Z, t_right_left.rotation.conjugate() * DVec3::Z];
        let normals = [DVec3::Z, layers.as_ref().map_or(DVec3::Z, |layers| layers.normal)];
        let sine = |axis: DVec3| normals.map(|normal| axis.cross(normal).length());
        let tilt = axes.into_iter().flat_map(sine).fold(0.0, f64::max);
        let cameras = [left, right];
        let f_px = cameras.iter().fold(0.0_f64, |f, camera| f.max(camera.fx_px).max(camera.fy_px));
        let mut found = Self { f_px, tilt, ..Self::default() };
        for corner in facts.corners() {
            found.widen(&through, &bare, corner);
        }
        // Points farther out are invisible. The columns of the projection's Jacobian are f / z, and f /
        // z times the slope.
        found.slope =
            found.slope.min(cameras.iter().fold(0.0, |largest, camera| largest.max(widest_slope(camera))));
        found.depth_px_per_mm =
            found.depth_px_per_mm.min(found.lateral_px_per_mm * (found.slope + found.tilt));
        let stretch =
            cameras.iter().fold(1.0_f64, |largest, camera| largest.max(stretch(camera, found.slope)));
        found.lateral_px_per_mm *= stretch;
        found.depth_px_per_mm *= stretch;
        found.refraction_px *= stretch;
        found
    }

    /// Extends the worst case to a point.
    fn widen(&mut self, through: &Rig, bare: &Rig, point_mm: DVec3) {
        for view in [View::Left, View::Right] {
            let views = [through.view(view), bare.view(view)];
            let seen = views.map(|view| view.project_with_jacobian(point_mm, 0.0).ok());
            let camera = views[1].camera();
            for projection in seen {
                let (slope, [columns, rows]) =
                    projection.map_or((f64::INFINITY, [DVec3::INFINITY; 2]), |seen| {
                        let from = seen.pixel_px - DVec2::new(camera.cx_px, camera.cy_px);
                        ((from / DVec2::new(camera.fx_px, camera.fy_px)).length(), seen.jacobian)
                    });
                let lateral = larger(columns.truncate(), rows.truncate());
                self.lateral_px_per_mm = self.lateral_px_per_mm.max(lateral);
                self.depth_px_per_mm =
                    self.depth_px_per_mm.max(sqrt(columns.z * columns.z + rows.z * rows.z));
                self.slope = self.slope.max(slope);
            }
            let apart = match seen {
                [Some(through), Some(bare)] => (through.pixel_px - bare.pixel_px).length(),
                _ => f64::INFINITY,
            };
            self.refraction_px = self.refraction_px.max(apart);
        }
    }
}

/// Lowest and highest place of the skin above the plane.
fn relief_mm(scene: &Scene) -> [f64; 2] {
    scene.gel.relief.as_ref().map_or([0.0; 2], |relief| relief.range_mm(scene.reach_mm()))
}

/// Slope of the farthest corner of an image, with and without lens distortion; infinite where the
/// distortion is not one-to-one.
fn widest_slope(camera: &Camera) -> f64 {
    let (right, bottom) = (camera.width_px as f64 - 0.5, camera.height_px as f64 - 0.5);
    let corners =
        [(-0.5, -0.5), (right, -0.5), (-0.5, bottom), (right, bottom)].map(|(x, y)| DVec2::new(x, y));
    corners.into_iter().fold(0.0_f64, |largest, at| {
        let plain = (at - DVec2::new(camera.cx_px, camera.cy_px)) / DVec2::new(camera.fx_px, camera.fy_px);
        largest.max(plain.length()).max(camera.undistort(at).map_or(f64::INFINITY, |p| p.length()))
    })
}

/// The larger singular value of a 2x2 matrix, given its rows.
fn larger(a: DVec2, b: DVec2) -> f64 {
    let (half, det) = (0.5 * (a.length_squared() + b.length_squared()), a.perp_dot(b));
    sqrt(half + sqrt((half * half - det * det).max(0.0)))
}

/// Upper bound of a lens's stretch of distances between points up to this slope: the largest singular
/// value of its Jacobian, term by term.
fn stretch(camera: &Camera, slope: f64) -> f64 {
    let [k1, k2, p1, p2, k3] = camera.distortion.map(f64::abs);
    let s2 = slope * slope;
    1.0 + s2 * (3.0 * k1 + s2 * (5.0 * k2 + s2 * 7.0 * k3)) + 6.0 * slope * (p1 + p2)
}

impl Facts<'_> {
    /// Corners of boxes that contain all markers with their dots at all times.
    fn corners(&self) -> impl Iterator<Item = DVec3> {
        let gel = &self.scene.gel;
        let half = gel.half_mm();
        let more = self.sideways_mm + 2.0 * self.dot_radius_mm();
        let moves = &self.scene.gel_motion;
        let turns = moves.iter().any(|k| k.rotation_rad != 0.0);
        // A rotating gel stays within the circle through its corners.
        let half = if turns { DVec2::splat(half.length()) } else { half } + more;
        let angle = if turns { 0.0 } else { gel.rotation_rad };
        let (along, across) = (DVec2::new(cos(angle), sin(angle)), DVec2::new(-sin(angle), cos(angle)));
        let centre = DVec2::from_array(gel.centre_mm);
        let shifts = moves.iter().map(|k| DVec2::from_array(k.shift_mm));
        let none = moves.is_empty().then_some(DVec2::ZERO);
        let [low, high] = relief_mm(self.scene);
        let depths = [gel.surface_mm + high, gel.surface_mm + low - self.touch.depth_mm];
        shifts.chain(none).flat_map(move |shift| {
            let signs = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
            signs.into_iter().flat_map(move |(a, b)| {
                let at = centre + shift + along * (a * half.x) + across * (b * half.y);
                depths.map(|z| at.extend(z))
            })
        })
    }
}
