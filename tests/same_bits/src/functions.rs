//! One digest for each function of `gelstereo_core::math`, over fixed arguments of its domain.
//!
//! No result is NaN: its sign and payload are no result, and differ between processors.

use crate::{Digests, Outcome};
use alloc::format;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::linalg::eigen;
use gelstereo_core::math::random::Stream;
use gelstereo_core::math::{self, DVec3, Pose, so3};

/// Arguments for each function.
const COUNT: usize = 400;

type Function = fn(f64) -> f64;

/// Name, function, and the range of its arguments.
const OF_ONE: [(&str, Function, [f64; 2]); 26] = [
    ("abs", math::abs, [-1e3, 1e3]),
    ("acos", math::acos, [-1.0, 1.0]),
    ("asin", math::asin, [-1.0, 1.0]),
    ("asinh", math::asinh, [-1e3, 1e3]),
    ("atan", math::atan, [-30.0, 30.0]),
    ("bessel_j0", math::bessel_j0, [0.0, 60.0]),
    ("bessel_j1", math::bessel_j1, [0.0, 60.0]),
    ("cbrt", math::cbrt, [-1e6, 1e6]),
    ("ceil", math::ceil, [-1e3, 1e3]),
    ("cos", math::cos, [-100.0, 100.0]),
    ("cosh", math::cosh, [-20.0, 20.0]),
    ("erf", math::erf, [-6.0, 6.0]),
    ("erfc", math::erfc, [-6.0, 27.0]),
    ("exp", math::exp, [-740.0, 700.0]),
    ("expm1", math::expm1, [-40.0, 40.0]),
    ("floor", math::floor, [-1e3, 1e3]),
    ("ln", math::ln, [1e-300, 1e3]),
    ("log1p", math::log1p, [-0.999, 10.0]),
    ("round", math::round, [-1e3, 1e3]),
    ("round_even", math::round_even, [-1e3, 1e3]),
    ("sin", math::sin, [-100.0, 100.0]),
    // Needs more than three parts of pi/2.
    ("sin_of_large", math::sin, [1e15, 1e22]),
    ("sqrt", math::sqrt, [0.0, 1e6]),
    ("sqrt_of_subnormal", math::sqrt, [0.0, 1e-308]),
    ("tan", math::tan, [-100.0, 100.0]),
    ("tanh", math::tanh, [-20.0, 20.0]),
];

type OfTwo = fn(f64, f64) -> f64;

const OF_TWO: [(&str, OfTwo, [f64; 2], [f64; 2]); 3] = [
    ("atan2", math::atan2, [-10.0, 10.0], [-10.0, 10.0]),
    ("hypot", math::hypot, [-1e200, 1e200], [-1e200, 1e200]),
    ("pow", math::pow, [1e-3, 1e3], [-30.0, 30.0]),
];

pub fn run(out: &mut Digests) -> Outcome<()> {
    for (name, function, range) in OF_ONE {
        let mut random = Stream::new(1, name);
        let values = (0..COUNT).map(|_| function(within(range, &mut random)));
        add(out, name, Digest::new().f64s(values));
    }
    for (name, function, first, second) in OF_TWO {
        let mut random = Stream::new(1, name);
        let values = (0..COUNT).map(|_| function(within(first, &mut random), within(second, &mut random)));
        add(out, name, Digest::new().f64s(values));
    }
    rotations(out);
    matrices(out);
    Ok(())
}

fn add(out: &mut Digests, name: &str, digest: Digest) {
    out.push((format!("function/{name}"), digest.value()));
}

fn within([low, high]: [f64; 2], random: &mut Stream) -> f64 {
    low + (high - low) * random.uniform()
}

fn vector(random: &mut Stream) -> DVec3 {
    DVec3::from_array(core::array::from_fn(|_| within([-3.0, 3.0], random)))
}

fn rotations(out: &mut Digests) {
    let random = &mut Stream::new(1, "rotations");
    let (mut exp, mut log, mut pose) = (Digest::new(), Digest::new(), Pose::IDENTITY);
    let mut products = Digest::new();
    for _ in 0..COUNT {
        let rotation = so3::exp(vector(random));
        exp = exp.f64s(rotation.to_array());
        log = log.f64s(so3::log(rotation).to_array());
        pose = pose * Pose::exp(vector(random), vector(random));
        products = products.f64s(pose.rotation.to_array()).f64s(pose.inverse().translation_mm.to_array());
    }
    add(out, "so3_exp", exp);
    add(out, "so3_log", log);
    add(out, "pose_products", products);
}

fn matrices(out: &mut Digests) {
    let random = &mut Stream::new(1, "matrices");
    let mut digest = Digest::new();
    for _ in 0..COUNT / 20 {
        let mut matrix = [[0.0; 6]; 6];
        for row in 0..6 {
            for col in 0..=row {
                matrix[row][col] = random.normal();
                matrix[col][row] = matrix[row][col];
            }
        }
        let found = eigen(&matrix);
        digest = digest.f64s(found.values).f64s(found.vectors.into_iter().flatten());
    }
    add(out, "eigen", digest);
}
