//! Times of the elastic layer, and how far its cheap approximations are from it.
//!
//! `cargo run --release -p gelstereo-sim --example layer`
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use gelstereo_core::math::{DVec2, DVec3, Pose, so3};
use gelstereo_sim::effects::{Drag, ElasticLayer, Shoulder, Spread};
use gelstereo_sim::layer::closed::{CattaneoMindlin, FlatPunch, HalfSpace, Hertz};
use gelstereo_sim::layer::{Grid, Layer, LayerContact, Part, Start};
use gelstereo_sim::{ContactState, Effects, Scene, Shape, Simulator, Truth};
use std::hint::black_box;
use std::time::Instant;

/// Least time of many repeats, microseconds.
fn least_us(repeats: usize, mut work: impl FnMut()) -> f64 {
    let time = |work: &mut dyn FnMut()| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64() * 1e6
    };
    (0..repeats).map(|_| time(&mut work)).fold(f64::INFINITY, f64::min)
}

fn main() {
    closed_forms();
    solves();
    frames();
    approximations();
}

fn places() -> Vec<DVec2> {
    (0..625).map(|i| DVec2::new((i % 25) as f64 - 12.01, (i / 25) as f64 - 12.02) * 0.9).collect()
}

fn closed_forms() {
    println!("closed forms, a field of 625 markers:");
    let (places, half_space) = (places(), HalfSpace { poisson_ratio: 0.48 });
    let hertz = Hertz { half_space, radius_mm: 4.0, depth_mm: 1.0 };
    let punch = FlatPunch { half_space, radius_mm: 3.0 };
    let pulled = CattaneoMindlin { hertz, friction: 0.5, shift_mm: 0.1 };
    let mut field = vec![DVec3::ZERO; 625];
    let mut show = |name: &str, at: &dyn Fn(DVec2) -> DVec3| {
        let us = least_us(2000, || {
            field.iter_mut().zip(&places).for_each(|(u, &place)| *u = at(place));
            black_box(&field);
        });
        println!("  {name:28} {us:7.1} us");
    };
    let radial = |place: DVec2, [into, out]: [f64; 2]| (place * (out / place.length())).extend(into);
    show("ball (Hertz)", &|place| radial(place, hertz.surface_mm(place.length())));
    show("flat punch (Boussinesq)", &|place| radial(place, punch.surface_per_mm(place.length())));
    show("twisted punch (Reissner)", &|place| {
        let r = place.length();
        (place.perp() * (0.1 * punch.twisted_mm(r) / r)).extend(0.0)
    });
    show("point force along x (Cerruti)", &|place| DVec3::from_array(half_space.cerruti_mm(place)));
    show("tractions of a pulled ball", &|place| DVec3::X * pulled.traction(place.length()));
}

/// A ball of 4 mm, at this depth and place, over a grid.
fn ball(grid: Grid, depth: f64, x: f64) -> Vec<f64> {
    let middle = |n: usize| 0.5 * (n as f64 - 1.0);
    (0..grid.rows * grid.cols)
        .map(|i| {
            let at = DVec2::new(
                (i % grid.cols) as f64 - middle(grid.cols),
                (i / grid.cols) as f64 - middle(grid.rows),
            );
            let r2 = (at * grid.cell_mm[0] - DVec2::new(x, 0.0)).length_squared();
            if r2 < 16.0 { depth - 4.0 + (16.0 - r2).sqrt() } else { f64::NEG_INFINITY }
        })
        .collect()
}

fn solves() {
    println!(
        "solves of a ball of 4 mm, 1 mm deep, within 0.1 um; warm: 30 um deeper and 30 um aside of the last \
        frame"
    );
    for (cells, friction) in [(2, 0.0), (4, 0.0), (2, 0.8)] {
        let (side, cell_mm) = (28 * cells + 1, 0.9 / cells as f64);
        let grid = Grid { rows: side, cols: side, cell_mm: [cell_mm; 2] };
        let layer = Layer { thickness_mm: 5.0, poisson_ratio: 0.48 };
        let set_up = Instant::now();
        let mut contact = LayerContact::new(layer, grid, friction).unwrap();
        let set_up = set_up.elapsed().as_secs_f64() * 1e3;
        let frames = [ball(grid, 1.0, 0.0), ball(grid, 1.03, 0.03)];
        let parts = [0, 1].map(|n| Part { heights_mm: &frames[n], carried_mm: None });
        let cold = contact.press(parts[0], 1e-4, Start::Afresh).unwrap();
        let cold_us = least_us(200, || {
            black_box(contact.press(parts[0], 1e-4, Start::Afresh).unwrap());
        });
        let warm = contact.press(parts[1], 1e-4, Start::Last).unwrap();
        let mut turn = 0;
        let warm_us = least_us(200, || {
            turn += 1;
            black_box(contact.press(parts[turn % 2], 1e-4, Start::Last).unwrap());
        });
        println!(
            "  {cells} cells a pitch, friction {friction}: cold {cold_us:6.0} us, {} products; warm \
             {warm_us:6.0} us, {} products; set up {set_up:.0} ms",
            cold.products, warm.products
        );
    }
}

fn scene(effects: Effects, indenter: Shape) -> Scene {
    Scene { effects, indenter: Some(indenter), ..Scene::default() }
}

fn layered(friction: f64) -> Effects {
    Effects {
        elastic_layer: Some(ElasticLayer { friction, ..ElasticLayer::default() }),
        ..Effects::default()
    }
}

/// The part lying across the view so deep, and carried along x.
fn pressed(simulator: &Simulator, depth_mm: f64, shear_mm: f64) -> ContactState {
    let pose =
        Pose { rotation: so3::exp(DVec3::ZERO), translation_mm: DVec3::new(4.0 + shear_mm, 0.0, 40.0) };
    let t_sensor_object = simulator.pressed(pose, depth_mm).unwrap();
    ContactState { t_sensor_object, shear_mm: [shear_mm, 0.0], twist_rad: 0.0 }
}

fn frames() {
    println!("marker positions of a frame of 625, ball of 4 mm 1 mm deep (all of a moment but the images):");
    let approximations = Effects::of_gel();
    for (name, effects) in [
        ("rigid imprint", Effects::default()),
        ("shoulder, spread, drag", approximations),
        ("layer, no friction", layered(0.0)),
        ("layer, friction 0.8", layered(0.8)),
    ] {
        let mut simulator = Simulator::new(&scene(effects, Shape::Sphere { radius_mm: 4.0 }), None).unwrap();
        let contact = pressed(&simulator, 1.0, 0.2);
        let mut truth = Truth::default();
        let us = least_us(50, || simulator.moment(Some(&contact), 0, &mut truth));
        println!("  {name:24} {us:7.0} us");
    }
}

fn approximations() {
    println!(
        "approximations against the layer without friction (um): heights rms and most off; rise; sideways \
        most; rms of"
    );
    println!("sideways at the best strength, and that strength and decay:");
    let shapes = [
        ("ball 4 mm", Shape::Sphere { radius_mm: 4.0 }),
        ("cylinder 3 mm", Shape::Cylinder { radius_mm: 3.0, length_mm: 8.0 }),
        ("box 5 x 4", Shape::Box { size_mm: [5.0, 4.0, 6.0] }),
    ];
    for (name, shape) in shapes {
        for depth in [0.5, 1.0] {
            let exact = motion(layered(0.0), &shape, depth, 0.0);
            let exact_um = exact.iter().map(|u| 1e3 * u.z).fold(f64::INFINITY, f64::min);
            let largest = exact.iter().map(|u| 1e3 * u.truncate().length()).fold(0.0, f64::max);
            let mut best = (f64::INFINITY, 0.0);
            for step in 1..=20 {
                let decay_thicknesses = 0.05 * f64::from(step);
                let effects =
                    Effects { shoulder: Some(Shoulder { decay_thicknesses }), ..Effects::default() };
                let off = rms(&motion(effects, &shape, depth, 0.0), &exact, |u| DVec3::Z * u.z);
                if off < best.0 {
                    best = (off, decay_thicknesses);
                }
            }
            let usual = motion(
                Effects { shoulder: Some(Shoulder::default()), ..Effects::default() },
                &shape,
                depth,
                0.0,
            );
            let off = rms(&usual, &exact, |u| DVec3::Z * u.z);
            println!(
                "  {name:14} {depth} mm: shoulder {off:5.1}, best {:5.1} at decay {:.2}; rise {exact_um:6.1}",
                best.0, best.1
            );
            let mut best = (f64::INFINITY, 0.0, 0.0);
            for (strength, decay) in
                (4..=20).flat_map(|s| (2..=12).map(move |d| (0.05 * f64::from(s), 0.25 * f64::from(d))))
            {
                let effects = Effects {
                    shoulder: Some(Shoulder::default()),
                    spread: Some(Spread { strength, decay_thicknesses: decay }),
                    ..Effects::default()
                };
                let off = rms(&motion(effects, &shape, depth, 0.0), &exact, |u| u.truncate().extend(0.0));
                if off < best.0 {
                    best = (off, strength, decay);
                }
            }
            let effects = Effects {
                shoulder: Some(Shoulder::default()),
                spread: Some(Spread::default()),
                ..Effects::default()
            };
            let off = rms(&motion(effects, &shape, depth, 0.0), &exact, |u| u.truncate().extend(0.0));
            println!(
                "    sideways at most {largest:5.1}; spread {off:5.1} off, best {:5.1} at strength {:.2} \
                decay {:.2}",
                best.0, best.1, best.2
            );
        }
        let pull = |effects: Effects| {
            let (moved, still) =
                (motion(effects.clone(), &shape, 1.0, 0.3), motion(effects, &shape, 1.0, 0.0));
            moved.iter().zip(still).map(|(a, b)| (*a - b).truncate().extend(0.0)).collect::<Vec<_>>()
        };
        let exact = pull(layered(1e3));
        let dragged = |decay_thicknesses: f64| {
            pull(Effects {
                shoulder: Some(Shoulder::default()),
                drag: Some(Drag { decay_thicknesses }),
                ..Effects::default()
            })
        };
        let best = (2..=20)
            .map(|step| 0.1 * f64::from(step))
            .map(|decay| (rms(&dragged(decay), &exact, |u| u), decay))
            .fold((f64::INFINITY, 0.0), |a, b| if b.0 < a.0 { b } else { a });
        let off = rms(&dragged(Drag::default().decay_thicknesses), &exact, |u| u);
        println!("  {name:14} pulled 0.3 mm: drag {off:5.1} off, best {:5.1} at decay {:.2}", best.0, best.1);
        let slipping = pull(layered(0.3));
        println!(
            "    with friction 0.3 it slips: {:5.1} um rms from sticking",
            rms(&slipping, &exact, |u| u)
        );
    }
}

/// How every marker moves.
fn motion(effects: Effects, shape: &Shape, depth_mm: f64, shear_mm: f64) -> Vec<DVec3> {
    let mut simulator = Simulator::new(&scene(effects, shape.clone()), None).unwrap();
    let (mut still, mut truth) = (Truth::default(), Truth::default());
    simulator.truth(None, &mut still);
    let contact = pressed(&simulator, depth_mm, shear_mm);
    simulator.truth(Some(&contact), &mut truth);
    // Towards the camera is up.
    truth
        .points_mm
        .iter()
        .zip(&still.points_mm)
        .map(|(a, b)| (*a - *b) * DVec3::new(1.0, 1.0, -1.0))
        .collect()
}

fn rms(a: &[DVec3], b: &[DVec3], of: impl Fn(DVec3) -> DVec3) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| of(*a - *b).length_squared()).sum();
    1e3 * (sum / a.len() as f64).sqrt()
}
