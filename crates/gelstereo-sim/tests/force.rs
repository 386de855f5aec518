//! Tractions and wrenches of simulated contacts.
#![allow(clippy::unwrap_used)]

use super::common::{press, simulator, with_effects};
use gelstereo_core::contact::RestSurface;
use gelstereo_core::force::{
    Compliance, ComplianceError, ComplianceGel, ForceError, ForceEstimator, MovedMarkers, Wrench,
};
use gelstereo_core::lattice::Topology;
use gelstereo_core::layer::{Influence, Layer};
use gelstereo_core::math::linalg::Symmetric;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{DMat3, DVec2, DVec3, so3};
use gelstereo_core::params::{ForceMethod, ForceParams, PrintLayout};
use gelstereo_core::track::MarkerState;
use gelstereo_sim::effects::{Effects, ElasticLayer};
use gelstereo_sim::{ContactState, Gel, Loads, Scene, Shape, Truth};
use proptest::prelude::*;

/// Standard deviations of the markers: across and along the line of sight.
const SIGMA_MM: [f64; 3] = [0.0015, 0.0015, 0.005];

/// Markers of a frame with their noise, and the true loads.
#[derive(Clone)]
struct Case {
    rest_mm: Vec<DVec3>,
    points_mm: Vec<DVec3>,
    covariance_mm2: Vec<Symmetric<3>>,
    state: Vec<MarkerState>,
    patch: Vec<bool>,
    cols: usize,
    layout: PrintLayout,
    params: ForceParams,
    loads: Loads,
}

fn diagonal(sigma_mm: [f64; 3]) -> Symmetric<3> {
    std::array::from_fn(|i| std::array::from_fn(|k| if i == k { sigma_mm[i] * sigma_mm[i] } else { 0.0 }))
}

impl Case {
    fn new(scene: &Scene, contact: &ContactState, noise: Option<u64>) -> Self {
        let (mut rest, mut truth) = (Truth::default(), Truth::default());
        let mut simulator = simulator(scene);
        simulator.field(None, 0, &mut rest);
        simulator.field(Some(contact), 1, &mut truth);
        let layer = scene.effects.elastic_layer.as_ref().unwrap();
        let params = ForceParams {
            method: ForceMethod::Ridge,
            thickness_mm: Some(scene.gel.thickness_mm),
            young_kpa: Some(layer.young_kpa),
            poisson_ratio: layer.poisson_ratio,
            ..ForceParams::default()
        };
        if let Some(seed) = noise {
            let mut random = Stream::new(seed, "markers");
            for point in &mut truth.points_mm {
                *point += DVec3::from_array(SIGMA_MM.map(|sigma| sigma * random.normal()));
            }
        }
        Self {
            cols: scene.gel.cols,
            layout: scene.gel.layout,
            covariance_mm2: vec![diagonal(SIGMA_MM); rest.points_mm.len()],
            state: vec![MarkerState::Seen; rest.points_mm.len()],
            rest_mm: rest.points_mm,
            points_mm: truth.points_mm,
            patch: truth.in_contact,
            loads: truth.loads.unwrap(),
            params,
        }
    }

    fn estimator(&self) -> ForceEstimator {
        let none = vec![diagonal([1e-6; 3]); self.rest_mm.len()];
        let rest = RestSurface::new(&self.rest_mm).unwrap();
        let topology = Topology::of(self.layout, self.cols, &self.rest_mm);
        ForceEstimator::on(&self.params, &rest, topology, &none, None).unwrap()
    }

    fn moved(&self) -> MovedMarkers<'_> {
        let Self { points_mm, covariance_mm2, state, patch, .. } = self;
        MovedMarkers { points_mm, covariance_mm2, state, patch }
    }

    fn run(&self) -> (Vec<DVec3>, Option<Wrench>) {
        let mut traction_kpa = Vec::new();
        let wrench = self.estimator().run(&self.moved(), &mut traction_kpa).unwrap();
        (traction_kpa, wrench)
    }

    /// The same, seen by a camera elsewhere.
    fn turned(&self, rotation: DMat3, shift_mm: DVec3) -> Self {
        let to = |point: &DVec3| rotation * *point + shift_mm;
        let turn = |c: &Symmetric<3>| {
            let turned = rotation * DMat3::from_cols_array_2d(c) * rotation.transpose();
            turned.to_cols_array_2d()
        };
        Self {
            rest_mm: self.rest_mm.iter().map(to).collect(),
            points_mm: self.points_mm.iter().map(to).collect(),
            covariance_mm2: self.covariance_mm2.iter().map(turn).collect(),
            ..self.clone()
        }
    }
}

/// A press with shear and twist of a ball or a lying cylinder, on a square or hexagonal print.
fn contacts() -> impl Strategy<Value = (Scene, ContactState)> {
    let shape = prop_oneof![
        (2.0..7.0_f64).prop_map(|radius_mm| Shape::Sphere { radius_mm }),
        (1.0..4.0_f64, 3.0..6.0_f64)
            .prop_map(|(radius_mm, length_mm)| Shape::Cylinder { radius_mm, length_mm }),
    ];
    let lateral = (-0.15..0.15_f64, -0.15..0.15_f64, -0.05..0.05_f64);
    let offset = (-2.5..2.5_f64, -2.5..2.5_f64);
    let gel = (2.5..5.0_f64, 0.44..0.5_f64, 0.2..1.0_f64, any::<[bool; 2]>());
    (shape, gel, 0.2..0.7_f64, lateral, offset, -3.0..3.0_f64).prop_map(
        |(
            shape,
            (thickness_mm, poisson_ratio, friction, [is_hexagonal, odd_rows_forward]),
            depth_mm,
            (x, y, twist_rad),
            (right, down),
            turn,
        )| {
            let layer = ElasticLayer { poisson_ratio, friction, cells_per_pitch: 3, ..Default::default() };
            let effects = Effects { elastic_layer: Some(layer), ..Effects::default() };
            let mut scene = with_effects(shape.clone(), effects);
            scene.gel.thickness_mm = thickness_mm;
            if is_hexagonal {
                let layout = PrintLayout::Hexagonal;
                scene.gel = Gel { rows: 28, cols: 24, layout, odd_rows_forward, ..scene.gel };
            }
            let upright =
                if matches!(shape, Shape::Sphere { .. }) { 0.0 } else { core::f64::consts::FRAC_PI_2 };
            let rotation = so3::log(so3::exp(DVec3::Z * turn) * so3::exp(DVec3::Y * upright));
            let contact = press(&scene, rotation, DVec2::new(right, down), depth_mm);
            (scene, ContactState { shear_mm: [x, y], twist_rad, ..contact })
        },
    )
}

/// Force and torque less the true ones, both about the middle of the contact.
fn error(wrench: &Wrench, case: &Case) -> ([f64; 6], Wrench) {
    let touched = || case.rest_mm.iter().zip(&case.patch).filter(|&(_, &touches)| touches);
    let middle: DVec3 = touched().map(|(&point, _)| point).sum::<DVec3>() / touched().count() as f64;
    let about = wrench.about(middle);
    let Loads { force_n, torque_nmm, about_mm, .. } = &case.loads;
    let torque = *torque_nmm + (*about_mm - middle).cross(*force_n);
    let [[a, b, c], [d, e, f]] = [about.force_n - *force_n, about.torque_nmm - torque].map(|v| v.to_array());
    ([a, b, c, d, e, f], about)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Every component of the wrench is within five of its standard deviations, which are small: below 6 % of
    /// the pressing force for contacts of at least nine markers, pressed to at most a seventh.
    #[test]
    fn a_wrench_is_that_of_the_layer((scene, contact) in contacts(), seed in any::<u64>()) {
        let case = Case::new(&scene, &contact, Some(seed));
        prop_assume!(case.patch.contains(&true));
        let wrench = case.run().1.unwrap();
        let (error, about) = error(&wrench, &case);
        for (i, error) in error.into_iter().enumerate() {
            let sigma = about.covariance[i][i].sqrt();
            prop_assert!(error.abs() < 5.0 * sigma, "{i}: {error} of {sigma}, {about:?}");
        }
        let deepest_mm = scene.gel.surface_mm
            - case.points_mm.iter().map(|point| point.z).fold(f64::INFINITY, f64::min);
        let is_usual = case.patch.iter().filter(|&&touches| touches).count() >= 9
            && deepest_mm < scene.gel.thickness_mm / 7.0;
        if is_usual {
            let sigma = about.covariance[2][2].sqrt();
            prop_assert!(sigma < 0.06 * case.loads.force_n.z.abs(), "{sigma} {:?}", case.loads.force_n);
        }
    }

    /// Forces do not depend on where the camera is.
    #[test]
    fn a_wrench_turns_with_the_camera(
        (scene, contact) in contacts(),
        omega in prop::array::uniform3(-0.4..0.4_f64),
        shift in prop::array::uniform3(-9.0..9.0_f64),
    ) {
        let case = Case::new(&scene, &contact, Some(3));
        prop_assume!(case.patch.contains(&true));
        let rotation = DMat3::from_quat(so3::exp(DVec3::from_array(omega)));
        let (own, turned) = (case.run(), case.turned(rotation, DVec3::from_array(shift)).run());
        let (own_wrench, turned_wrench) = (own.1.unwrap(), turned.1.unwrap());
        let scale = own_wrench.force_n.length();
        let off = rotation * own_wrench.force_n - turned_wrench.force_n;
        // The search for the variances of the prior ends at 5 %, and rounding may end it a round later.
        prop_assert!(off.length() < 1e-3 * scale, "{own_wrench:?} {turned_wrench:?}");
        let off = rotation * own_wrench.torque_nmm - turned_wrench.torque_nmm;
        prop_assert!(off.length() < 2e-3 * scale * 10.0, "{own_wrench:?} {turned_wrench:?}");
    }

    /// Bounded tractions never pull, nor drag beyond Coulomb's bound.
    #[test]
    fn bounded_tractions_are_within_their_bounds((scene, contact) in contacts(), friction in 0.0..1.0_f64) {
        let mut case = Case::new(&scene, &contact, Some(4));
        (case.params.method, case.params.friction) = (ForceMethod::Bounded, Some(friction));
        let (traction_kpa, _) = case.run();
        let normal = RestSurface::new(&case.rest_mm).unwrap().normal();
        for traction in traction_kpa {
            let pressure = traction.dot(normal);
            let shear = (traction - normal * pressure).length();
            prop_assert!(pressure >= -1e-9 && shear <= friction * pressure * (1.0 + 1e-9) + 1e-9);
        }
    }
}

fn ball() -> Case {
    let layer = ElasticLayer { cells_per_pitch: 3, ..Default::default() };
    let effects = Effects { elastic_layer: Some(layer), ..Effects::default() };
    let scene = with_effects(Shape::Sphere { radius_mm: 5.0 }, effects);
    let contact = press(&scene, DVec3::ZERO, DVec2::ZERO, 0.5);
    Case::new(&scene, &ContactState { shear_mm: [0.1, 0.05], ..contact }, None)
}

#[test]
fn forces_are_proportional_to_the_modulus() {
    let (soft, mut stiff) = (ball(), ball());
    stiff.params.young_kpa = Some(250.0);
    let (soft, stiff) = (soft.run().1.unwrap(), stiff.run().1.unwrap());
    assert!((stiff.force_n - 2.5 * soft.force_n).length() < 1e-12);
    assert!((stiff.covariance[2][2] - 6.25 * soft.covariance[2][2]).abs() < 1e-12);
}

/// The modulus's uncertainty is one scale of all loads.
#[test]
fn an_uncertain_modulus_widens_all_loads_together() {
    let (known, mut unsure) = (ball(), ball());
    unsure.params.young_sigma_kpa = 10.0;
    let (known, unsure) = (known.run().1.unwrap(), unsure.run().1.unwrap());
    let loads: Vec<f64> = [known.force_n, known.torque_nmm].into_iter().flat_map(|v| v.to_array()).collect();
    for i in 0..6 {
        for k in 0..6 {
            let added = unsure.covariance[i][k] - known.covariance[i][k];
            assert!((added - 0.01 * loads[i] * loads[k]).abs() < 1e-12);
        }
    }
}

#[test]
fn without_contact_there_is_no_wrench() {
    let mut case = ball();
    case.patch.fill(false);
    let (traction_kpa, wrench) = case.run();
    assert_eq!(wrench, None);
    assert!(traction_kpa.len() == case.rest_mm.len() && traction_kpa.iter().all(|&q| q == DVec3::ZERO));
    let mut unseen = ball();
    unseen.state.fill(MarkerState::Held);
    assert_eq!(unseen.run().1, None);
}

/// A contact at the border says that forces beyond it are missing.
#[test]
fn a_contact_at_the_border_is_cut() {
    let mut case = ball();
    assert!(!case.run().1.unwrap().is_cut);
    case.patch[0] = true;
    assert!(case.run().1.unwrap().is_cut);
}

/// A third of the markers hidden by chance costs accuracy, and the covariance says so.
#[test]
fn row_16_hidden_markers_widen_the_wrench() {
    let (whole, mut part) = (ball(), ball());
    let mut random = Stream::new(5, "hidden");
    for state in &mut part.state {
        *state = if random.uniform() < 0.33 { MarkerState::Held } else { MarkerState::Seen };
    }
    let (seen, hidden) = (whole.run().1.unwrap(), part.run().1.unwrap());
    assert!(hidden.markers < seen.markers && hidden.covariance[2][2] > seen.covariance[2][2]);
    let (off, about) = error(&hidden, &part);
    assert!(off[2].abs() < 4.0 * about.covariance[2][2].sqrt(), "{} {about:?}", off[2]);
}

/// What cannot be used is named.
#[test]
fn bad_input_is_refused() {
    let mut case = ball();
    case.points_mm[7].x = f64::NAN;
    let mut estimator = case.estimator();
    let found = estimator.run(&case.moved(), &mut Vec::new());
    assert_eq!(found, Err(ForceError::NotFinite { index: 7 }));
    case.state[7] = MarkerState::Lost;
    assert!(estimator.run(&case.moved(), &mut Vec::new()).unwrap().is_some());
    let short = MovedMarkers { patch: &case.patch[1..], ..case.moved() };
    let lengths = ForceError::Lengths { rest: 625, found: 624 };
    assert_eq!(estimator.run(&short, &mut Vec::new()), Err(lengths));
    let rest = RestSurface::new(&case.rest_mm).unwrap();
    let refused = |params: &ForceParams, cols| {
        ForceEstimator::new(params, &rest, cols, &case.covariance_mm2).unwrap_err().to_string()
    };
    assert!(refused(&ForceParams::default(), 25).contains("force.method"));
    let missing = ForceParams { young_kpa: None, ..case.params.clone() };
    assert_eq!(refused(&missing, 25), "force.method = \"ridge\" requires force.young_kpa");
    assert!(refused(&case.params, 24).contains("no lattice"));
    let wide: Vec<DVec3> = case.rest_mm.iter().map(|p| DVec3::new(1.2 * p.x, p.y, p.z)).collect();
    let wide = RestSurface::new(&wide).unwrap();
    let found = ForceEstimator::new(&case.params, &wide, 25, &case.covariance_mm2);
    assert!(matches!(found, Err(ForceError::Pitch { .. })), "{found:?}");
}

/// The layer's influence as a matrix.
fn matrix(case: &Case, pitch_mm: f64) -> Compliance {
    let layer =
        Layer { thickness_mm: case.params.thickness_mm.unwrap(), poisson_ratio: case.params.poisson_ratio };
    let (rows, cols) = (case.rest_mm.len() / case.cols, case.cols);
    let influence = Influence::new(&layer, [pitch_mm; 2], rows.max(cols));
    let gel = ComplianceGel { rows, cols, pitch_mm, layer, rim_mm: [4.0; 2] };
    let mut values = Vec::with_capacity(gel.entries());
    for (row, col) in (0..rows.div_ceil(2)).flat_map(|row| (0..cols.div_ceil(2)).map(move |col| (row, col))) {
        for (cell_row, cell_col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let effect = influence.effect(col as isize - cell_col as isize, row as isize - cell_row as isize);
            values.extend(effect.iter().flatten().map(|&mm| mm as f32));
        }
    }
    Compliance::new(gel, values).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2, ..ProptestConfig::default() })]

    /// A matrix of the layer's influence gives the layer's wrench and tractions, to the precision of its
    /// entries.
    #[test]
    fn a_matrix_of_the_layer_gives_the_same_wrench((scene, contact) in contacts(), seed in any::<u64>()) {
        let gel = Gel { rows: 25, cols: 25, layout: PrintLayout::Square, ..scene.gel };
        let scene = Scene { gel, ..scene };
        let case = Case::new(&scene, &contact, Some(seed));
        let (expected_kpa, expected) = case.run();
        let none = vec![diagonal([1e-6; 3]); case.rest_mm.len()];
        let rest = RestSurface::new(&case.rest_mm).unwrap();
        let made = matrix(&case, case.estimator().pitch_mm());
        let estimator = |params: &ForceParams, made| {
            ForceEstimator::with_compliance(params, &rest, case.cols, &none, Some(made))
        };
        let mut traction_kpa = Vec::new();
        let found = estimator(&case.params, made.clone()).unwrap().run(&case.moved(), &mut traction_kpa);
        let (found, expected) = (found.unwrap().unwrap(), expected.unwrap());
        let size = expected.force_n.length();
        prop_assert!((found.force_n - expected.force_n).length() < 1e-3 * size);
        prop_assert!((found.torque_nmm - expected.torque_nmm).length() < 5e-3 * size);
        let largest_kpa = expected_kpa.iter().map(|t| t.length()).fold(0.0, f64::max);
        for (found, expected) in traction_kpa.iter().zip(&expected_kpa) {
            prop_assert!((*found - *expected).length() < 0.02 * largest_kpa);
        }
        // Of another gel, and for a method without one.
        let thinner = ForceParams { thickness_mm: Some(2.0), ..case.params.clone() };
        let refused = estimator(&thinner, made.clone()).unwrap_err();
        let of_thickness = ForceError::Compliance(ComplianceError::Differs {
            name: "force.thickness_mm", found: 2.0, expected: scene.gel.thickness_mm,
        });
        prop_assert_eq!(refused, of_thickness);
        let stiffness = Some(1.0);
        let resultant = ForceParams {
            method: ForceMethod::Resultant, patch_n_per_mm3: stiffness, around_n_per_mm3: stiffness,
            shear_n_per_mm3: stiffness, ..case.params.clone()
        };
        prop_assert!(matches!(estimator(&resultant, made).unwrap_err(), ForceError::Params(_)));
    }
}

#[test]
fn a_matrix_is_of_a_square_print() {
    let case = ball();
    let matrix = matrix(&case, case.estimator().pitch_mm());
    let gel = Gel { rows: 10, cols: 9, layout: PrintLayout::Hexagonal, ..Gel::default() };
    let at = |i: usize| gel.marker_mm(i / 9, i % 9).extend(gel.surface_mm);
    let rest_mm: Vec<DVec3> = (0..90).map(at).collect();
    let topology = Topology::of(gel.layout, 9, &rest_mm);
    let (rest, none) = (RestSurface::new(&rest_mm).unwrap(), vec![diagonal([1e-6; 3]); 90]);
    let refused = ForceEstimator::on(&case.params, &rest, topology, &none, Some(matrix)).unwrap_err();
    assert!(refused.to_string().contains("lattice.layout = \"square\""), "{refused}");
}
