//! tmp
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]
#[path = "../tests/problems/mod.rs"]
mod problems;
use gelstereo_core::math::DVec3;
use gelstereo_core::math::random::Stream;
use gelstereo_core::params::*;
use gelstereo_core::register::*;
use problems::*;
use std::time::Instant;
fn main() {
    let seeds: usize = std::env::var("N").map_or(20, |v| v.parse().unwrap());
    let verbose = std::env::var("V").is_ok();
    let only: Option<usize> = std::env::var("PART").ok().map(|v| v.parse().unwrap());
    let method = match std::env::var("METHOD").as_deref() {
        Ok("plane") => RegisterMethod::FilterregPlane,
        Ok("icp") => RegisterMethod::IcpPlane,
        Ok("track") => RegisterMethod::SurfaceTrack,
        Ok("close") => RegisterMethod::SurfaceClose,
        _ => RegisterMethod::SurfaceSearch,
    };
    let full = std::env::var("FULL").is_ok();
    let classes = [
        ("5/1", 5.0, 1.0, Sensing::GOOD),
        ("10/2", 10.0, 2.0, Sensing::GOOD),
        ("noisy", 10.0, 2.0, Sensing::NOISY),
        ("30/5", 30.0, 5.0, Sensing::GOOD),
    ];
    let mut totals = [(0, 0, 0.0, 0.0); 4];
    for (k, part) in parts::parts().iter().enumerate() {
        if only.is_some_and(|o| o != k) {
            continue;
        }
        let template = Template::from_mesh(&part.mesh, 0.3, 1).unwrap();
        print!("{:14}", part.name);
        for (c, (name, deg, mm, sensing)) in classes.iter().enumerate() {
            if std::env::var("CLASS").is_ok_and(|w| !w.split(',').any(|x| x == c.to_string())) {
                continue;
            }
            let params = RegisterParams {
                method,
                outlier_share: if sensing.outliers > 0.0 { 0.1 } else { 0.02 },
                ..Default::default()
            };
            let mut registrar = Registrar::new(&params);
            let mut random = Stream::new(3, part.name);
            let (mut ok, mut squared, mut observable) = (0, 0.0, 0.0);
            let mut times = vec![];
            let mut ratios = vec![];
            for seed in 0..seeds {
                let mut p = Problem::press(part, *sensing, &mut random);
                if std::env::var("NOSHOULDER").is_ok() {
                    let keep: Vec<bool> = p.normals.iter().map(Option::is_some).collect();
                    let mut i = keep.iter();
                    p.points_mm.retain(|_| *i.next().unwrap());
                    let mut i = keep.iter();
                    p.covariance_mm2.retain(|_| *i.next().unwrap());
                    p.normals.retain(Option::is_some);
                }
                if std::env::var("NOUNPRESSED").is_ok() {
                    p.unpressed_mm.clear();
                }
                let (a, b) = if full { (1.0, 1.0) } else { (random.uniform(), random.uniform()) };
                let guess = if std::env::var("TRUTH").is_ok() {
                    p.t_sensor_object
                } else {
                    p.guess(deg * a * 3.14159265 / 180.0, mm * b, &mut random)
                };
                let contact = Contact {
                    points_mm: &p.points_mm,
                    covariance_mm2: Some(&p.covariance_mm2),
                    unpressed_mm: &p.unpressed_mm,
                    press_direction: DVec3::NEG_Z,
                };
                let start = Instant::now();
                let found = registrar.register(&contact, &template, &guess);
                times.push(start.elapsed().as_secs_f64() * 1e3);
                let Ok(found) = found else { continue };
                let score = p.score(&found.t_sensor_object);
                if std::env::var("DIR").is_ok() && c == 0 {
                    let e = gelstereo_core::math::linalg::eigen(&p.bound());
                    let err = p.error(&found.t_sensor_object);
                    let z: Vec<String> = e
                        .values
                        .iter()
                        .zip(&e.vectors)
                        .map(|(v, u)| {
                            format!(
                                "{:6.2}({:.3})",
                                u.iter().zip(err).map(|(a, b)| a * b).sum::<f64>() * v.max(0.0).sqrt(),
                                1.0 / v.max(1e-9).sqrt()
                            )
                        })
                        .collect();
                    println!("{}", z.join(" "));
                }
                if verbose && score.squared > 4.0 * score.observable as f64 {
                    println!(
                        "  {name} seed {seed} ratio {:.1}",
                        (score.squared / score.observable as f64).sqrt()
                    );
                }
                let good = score.is_success();
                ok += usize::from(good);
                if good {
                    squared += score.squared;
                    observable += score.observable as f64;
                    ratios.push((score.squared / score.observable as f64).sqrt());
                }
                if verbose && !good {
                    let truth = Registrar::new(&RegisterParams {
                        method: RegisterMethod::SurfaceClose,
                        ..params.clone()
                    })
                    .register(&contact, &template, &p.t_sensor_object)
                    .unwrap();
                    print!(
                        "   likelihood {:?} truth {:?} {}",
                        found.log_likelihood,
                        truth.log_likelihood,
                        p.score(&truth.t_sensor_object).is_success()
                    );
                    println!(
                        "\n  {name} seed {seed}: {:.2} deg {:.3} mm, {} points, observable {}, free {:?}",
                        score.angle_rad.to_degrees(),
                        score.shift_mm,
                        p.points_mm.len(),
                        score.observable,
                        p.error(&found.t_sensor_object)
                    );
                }
            }
            times.sort_by(f64::total_cmp);
            ratios.sort_by(f64::total_cmp);
            let t = &mut totals[c];
            t.0 += ok;
            t.1 += seeds;
            t.2 += squared;
            t.3 += observable;
            print!(
                " | {name} {:5.1} % x{:.2} (med {:.2}) {:.1} ms ({:.1})",
                100.0 * ok as f64 / seeds as f64,
                (squared / observable).sqrt(),
                ratios.get(ratios.len() / 2).unwrap_or(&0.0),
                times[seeds / 2],
                times[seeds * 99 / 100]
            );
        }
        println!();
    }
    for (t, c) in totals.iter().zip(classes) {
        println!("{} {:.1} % x{:.3}", c.0, 100.0 * t.0 as f64 / t.1 as f64, (t.2 / t.3).sqrt());
    }
}
