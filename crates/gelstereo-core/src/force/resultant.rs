//! The wrench as a linear function of sums of marker motion.

use super::moved::MovedMarkers;
use super::wrench::Wrench;
use crate::contact::RestSurface;
use crate::math::linalg::Symmetric;
use crate::math::{DMat3, DVec3, so3, sqrt};
use crate::params::{ForceMethod, ForceParams};
use crate::track::MarkerState;

// Rms errors of simulated balls, plates and cylinders on two gels (`gelstereo_bench.reports.forces`).

/// Of a shear force, over the pressing force: 0.010 to 0.023.
const OF_PRESSING: f64 = 0.02;
/// Of the centre of pressure, over the contact's radius of gyration.
const OF_RADIUS: f64 = 0.2;

/// Newtons for each cubic millimetre of gel that is displaced, as known loads tell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stiffness {
    /// Of heights under the part, in addition to `around`.
    pub patch: f64,
    /// Of heights under and around the part.
    pub around: f64,
    /// Of motion along the gel.
    pub shear: f64,
    /// Relative standard deviation of the loads.
    pub sigma: f64,
}

/// Where the markers of a contact are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place<'a> {
    pub rest: &'a RestSurface,
    /// Into the layer, along rows, along columns.
    pub axes: &'a [DVec3; 3],
    /// Sides of the rectangle around a marker.
    pub sides_mm: [f64; 2],
    /// Markers under and around the contact.
    pub near: &'a [usize],
    pub is_cut: bool,
}

impl Stiffness {
    /// `None` for other methods.
    pub fn of(params: &ForceParams) -> Option<Self> {
        let is_asked = params.method == ForceMethod::Resultant;
        let (patch, around) = (params.patch_n_per_mm3?, params.around_n_per_mm3?);
        let shear = params.shear_n_per_mm3?;
        is_asked.then_some(Self { patch, around, shear, sigma: params.resultant_sigma })
    }

    /// The wrench of this motion; `None` unless a marker of the contact is seen. Each marker stands for the
    /// square or rectangle around it and acts like a spring. The covariances of the rest positions are added.
    pub fn wrench(
        &self,
        place: &Place<'_>,
        moved: &MovedMarkers<'_>,
        rest_covariance_mm2: &[Symmetric<3>],
    ) -> Option<Wrench> {
        let Place { rest, axes, sides_mm, near, is_cut } = *place;
        let is_seen = |n: &usize| moved.state[*n] == MarkerState::Seen;
        let seen = |in_patch: bool| near.iter().filter(move |&&n| moved.patch[n] == in_patch);
        // Those that are not seen move like the others.
        let shares = [true, false].map(|in_patch| {
            let found = seen(in_patch).filter(|n| is_seen(n)).count();
            if found > 0 { seen(in_patch).count() as f64 / found as f64 } else { 0.0 }
        });
        if shares[0] == 0.0 {
            return None;
        }
        let Pressure { centre_mm, radius_mm } = Pressure::of(place, moved);
        let area_mm2 = sides_mm[0] * sides_mm[1];
        let along = DMat3::from_cols(axes[0], axes[1], axes[2]);
        let spring = |of_axes: DVec3| along * DMat3::from_diagonal(of_axes) * along.transpose();
        let centre = so3::hat(centre_mm - rest.centre_mm());
        let mut parts = [[DVec3::ZERO; 2]; 2];
        let (mut covariance, mut markers) = ([[0.0; 6]; 6], 0);
        for &n in near.iter().filter(|n| is_seen(n)) {
            let in_patch = moved.patch[n];
            let share = area_mm2 * shares[usize::from(!in_patch)];
            let height = self.around + if in_patch { self.patch } else { 0.0 };
            let pressing = spring(DVec3::X * (height * share));
            let pulling = spring(DVec3::new(0.0, self.shear, self.shear) * share);
            let motion_mm = moved.points_mm[n] - rest.points_mm()[n];
            // Heights around the part are lifted by shear too, so that they tell nothing about where it
            // presses.
            let arm = so3::hat(rest.points_mm()[n] - rest.centre_mm());
            let rows = [pressing + pulling, centre * pressing + arm * pulling];
            parts[0][0] += pressing * motion_mm;
            parts[1][0] += pulling * motion_mm;
            parts[1][1] += arm * (pulling * motion_mm);
            add_noise(&mut covariance, &rows, &moved.covariance_mm2[n], &rest_covariance_mm2[n]);
            markers += 1;
        }
        parts[0][1] = centre * parts[0][0];
        self.widen(&mut covariance, place, &parts, &centre, radius_mm);
        let loads = [0, 1].map(|k| parts[0][k] + parts[1][k]);
        Some(Wrench {
            force_n: loads[0],
            torque_nmm: loads[1],
            about_mm: rest.centre_mm(),
            covariance,
            misfit: 1.0,
            cells: 0,
            markers,
            is_cut,
        })
    }

    /// Adds what the springs leave unexplained, of the force and torque that press and of those that pull.
    fn widen(
        &self,
        covariance: &mut Symmetric<6>,
        place: &Place<'_>,
        parts: &[[DVec3; 2]; 2],
        centre: &DMat3,
        radius_mm: f64,
    ) {
        let [pressing_n, pulling_n] = [parts[0][0].length(), parts[1][0].length()];
        let of_load = |[force, torque]: [DVec3; 2], share: f64| {
            let [[a, b, c], [d, e, f]] = [force, torque].map(|v| (v * share).to_array());
            [a, b, c, d, e, f]
        };
        let [into, right, down] = *place.axes;
        let aside = |axis: DVec3| of_load([axis, *centre * axis], OF_PRESSING * pressing_n);
        let off = |axis: DVec3, force_n: f64| of_load([DVec3::ZERO, axis], OF_RADIUS * radius_mm * force_n);
        let uncertain = [
            of_load(parts[0], self.sigma),
            of_load(parts[1], self.sigma),
            aside(right),
            aside(down),
            off(right, pressing_n),
            off(down, pressing_n),
            // Shear is as far from its centre as pressure, and twists.
            off(into, pulling_n),
        ];
        for (i, row) in covariance.iter_mut().enumerate() {
            for (k, entry) in row.iter_mut().enumerate() {
                *entry += uncertain.iter().map(|load| load[i] * load[k]).sum::<f64>();
            }
        }
    }
}

/// Where the part presses, by the heights of the patch.
struct Pressure {
    centre_mm: DVec3,
    /// Of gyration, with that of the square around a marker.
    radius_mm: f64,
}

impl Pressure {
    fn of(place: &Place<'_>, moved: &MovedMarkers<'_>) -> Self {
        let points = place.rest.points_mm();
        let sum = |of: &dyn Fn(usize) -> f64| {
            place.near.iter().map(|&n| height_mm(n, place, moved) * of(n)).sum::<f64>()
        };
        let total = sum(&|_| 1.0);
        let [width_mm, height_mm] = place.sides_mm;
        let of_square = (width_mm * width_mm + height_mm * height_mm) / 12.0;
        if total <= 0.0 {
            return Self { centre_mm: place.rest.centre_mm(), radius_mm: sqrt(of_square) };
        }
        let centre = [0, 1, 2].map(|k| sum(&|n| points[n][k]) / total);
        let centre_mm = DVec3::from_array(centre);
        let squared = sum(&|n| points[n].distance_squared(centre_mm)) / total;
        Self { centre_mm, radius_mm: sqrt(squared + of_square) }
    }
}

/// How far a marker of the patch is lifted, at least 0; 0 for others.
fn height_mm(n: usize, place: &Place<'_>, moved: &MovedMarkers<'_>) -> f64 {
    if !moved.patch[n] || moved.state[n] != MarkerState::Seen {
        return 0.0;
    }
    (moved.points_mm[n] - place.rest.points_mm()[n]).dot(place.axes[0]).max(0.0)
}

/// Adds J C Jᵀ of one marker, for the force and the torque.
fn add_noise(sum: &mut Symmetric<6>, rows: &[DMat3; 2], now: &Symmetric<3>, rest: &Symmetric<3>) {
    let both = DMat3::from_cols_array_2d(now) + DMat3::from_cols_array_2d(rest);
    for (i, left) in rows.iter().enumerate() {
        for (k, right) in rows.iter().enumerate() {
            let block = *left * both * right.transpose();
            for a in 0..3 {
                (0..3).for_each(|b| sum[3 * i + a][3 * k + b] += block.col(b)[a]);
            }
        }
    }
}

/// Spreads a force over the markers of the patch like their heights.
pub(super) fn spread(
    wrench: &Wrench,
    place: &Place<'_>,
    moved: &MovedMarkers<'_>,
    traction_kpa: &mut [DVec3],
) {
    let height = |n: usize| height_mm(n, place, moved);
    let sum: f64 = place.near.iter().map(|&n| height(n)).sum();
    if sum > 0.0 {
        let scale = 1.0 / (crate::layer::N_PER_KPA_MM2 * place.sides_mm[0] * place.sides_mm[1] * sum);
        place.near.iter().for_each(|&n| traction_kpa[n] = wrench.force_n * (scale * height(n)));
    }
}
