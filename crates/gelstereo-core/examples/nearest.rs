//! Times of distances to a part, nanoseconds a query, and the grid's error: `nearest [ROUNDS [NAME]]`.
//!
//! The part is a bent torus of 5184 triangles. The queries are patches of 49 points, 0.9 mm apart, up to so
//! many millimetres off the surface. Times are the least of all rounds; what is timed runs inside
//! [`measured`], for callgrind's `--toggle-collect`.
#![allow(clippy::print_stdout, reason = "it is a program")]

use gelstereo_core::math::DVec3;
use gelstereo_core::math::random::Stream;
use gelstereo_core::register::Template;
use gelstereo_core::surface::{Facing, Field, Solid, TriangleMesh};
use std::error::Error;
use std::time::Instant;

fn torus(n: usize, m: usize) -> Result<TriangleMesh, Box<dyn Error>> {
    let turn = |k: usize, of: usize| k as f64 / of as f64 * core::f64::consts::TAU;
    let (mut places, mut triangles) = (Vec::new(), Vec::new());
    for i in 0..n {
        for j in 0..m {
            let (a, b) = (turn(i, n), turn(j, m));
            let radius = 12.0 + (4.0 + 0.6 * (5.0 * a).sin()) * b.cos();
            places.push(DVec3::new(radius * a.cos(), radius * a.sin(), 4.0 * b.sin()));
            let name = |i: usize, j: usize| ((i % n) * m + j % m) as u32;
            let [a, b, c, d] = [name(i, j), name(i + 1, j), name(i + 1, j + 1), name(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    Ok(TriangleMesh::new(places, triangles)?)
}

/// A query, the direction it is pressed from, and the triangle of the answer before.
struct Query {
    point: DVec3,
    facing: Facing,
    near: u32,
}

type Way<'a> = &'a dyn Fn(&Query) -> f64;

fn queries(mesh: &TriangleMesh, solid: &Solid, off_mm: f64) -> Vec<Query> {
    let mut random = Stream::new(1, "patches");
    let mut out = Vec::new();
    for _ in 0..200 {
        let at = mesh.vertices_mm()[(random.uniform() * mesh.vertices_mm().len() as f64) as usize];
        let normal = solid.closest(at).normal;
        let along = normal.any_orthonormal_vector();
        let across = normal.cross(along);
        for k in 0..49 {
            let shift = along * (f64::from(k % 7) - 3.0) + across * (f64::from(k / 7) - 3.0);
            let foot = solid.closest(at + shift * 0.9);
            let point = foot.point_mm + foot.normal * (off_mm * (2.0 * random.uniform() - 1.0));
            let facing = Facing { direction: normal, least_cosine: 0.0 };
            out.push(Query { point, facing, near: solid.closest(point + along * 0.05).triangle });
        }
    }
    out
}

/// What callgrind counts.
#[inline(never)]
fn measured<T>(work: impl FnOnce() -> T) -> T {
    work()
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let rounds: usize = words.first().map_or(Ok(40), |word| word.parse())?;
    let mesh = torus(72, 36)?;
    let start = Instant::now();
    let solid = Solid::new(&mesh)?;
    println!("{} triangles in {:?}", mesh.triangles().len(), start.elapsed());
    let start = Instant::now();
    let field = Field::new(&solid, Template::DEFAULT_CELL_MM, Template::DEFAULT_REACH_MM).ok_or("no grid")?;
    println!("grid of {} bytes in {:?}", field.bytes(), start.elapsed());
    let grid = |q: &Query| field.distance(q.point).map_or(0.0, |(distance, gradient)| distance + gradient.x);
    let cold = |q: &Query| solid.closest(q.point).distance_mm;
    let warm = |q: &Query| solid.closest_from(q.point, q.near).distance_mm;
    let facing = |q: &Query| {
        let found = solid.closest_facing(q.point, &q.facing, 5.0, Some(q.near));
        found.map_or(0.0, |found| found.distance_mm)
    };
    let ways: [(&str, Way<'_>); 4] = [("grid", &grid), ("cold", &cold), ("warm", &warm), ("facing", &facing)];
    for off_mm in [0.03, 0.3, 1.5] {
        let queries = queries(&mesh, &solid, off_mm);
        let error = |q: &Query| Some(field.distance(q.point)?.0 - solid.closest(q.point).distance_mm);
        let errors: Vec<f64> = queries.iter().filter_map(error).collect();
        let rms_mm = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let largest_mm = errors.iter().fold(0.0_f64, |most, e| most.max(e.abs()));
        println!("up to {off_mm} mm off: grid wrong by {rms_mm:.4} mm rms, {largest_mm:.4} mm at most");
        for (name, way) in ways.iter().filter(|(name, _)| words.get(1).is_none_or(|word| word == name)) {
            let mut least_ns = f64::INFINITY;
            for _ in 0..rounds {
                let start = Instant::now();
                let sum: f64 = measured(|| queries.iter().map(way).sum());
                least_ns = least_ns.min(start.elapsed().as_nanos() as f64 / queries.len() as f64);
                assert!(sum.is_finite());
            }
            println!("  {name}: {least_ns:.0} ns");
        }
    }
    Ok(())
}
