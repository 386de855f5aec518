//! Laws of motions at 4 ulp: product, inverse and adjoint against arithmetic with twice the digits.
//!
//! An ulp of a quaternion is that of 1, and of a translation the rounding unit times the lengths of the
//! vectors that go into it: a vector that is turned is off by as much whichever way it points, by 3.6 at most
//! in three million random ones, which is up to 5.2 ulp of its largest entry. `tests/test_laws.py` holds
//! exponential, logarithm and Jacobians against mpmath. The reference rotates with the quaternion that it is
//! given, q v q*: that its length is an ulp off 1 is the quaternion's own error.

use gelstereo_core::math::{DQuat, DVec3, Pose};
use proptest::prelude::*;
use std::f64::consts::PI;

const MAX_ULP: f64 = 4.0;

/// A sum of two numbers that no rounding separates, some 106 bits (Dekker 1971, Knuth 1969).
#[derive(Clone, Copy)]
struct Twice(f64, f64);

impl Twice {
    const ZERO: Self = Self(0.0, 0.0);

    fn sum(a: f64, b: f64) -> Self {
        let s = a + b;
        let from_b = s - a;
        Self(s, (a - (s - from_b)) + (b - from_b))
    }

    fn plus(self, other: Self) -> Self {
        let s = Self::sum(self.0, other.0);
        Self::sum(s.0, s.1 + self.1 + other.1)
    }

    fn minus(self, other: Self) -> Self {
        self.plus(Self(-other.0, -other.1))
    }

    fn times(self, other: Self) -> Self {
        let p = self.0 * other.0;
        let rest = self.0.mul_add(other.0, -p);
        Self::sum(p, rest + (self.0 * other.1 + self.1 * other.0))
    }
}

type Quaternion = [Twice; 4];

fn twice<const N: usize>(values: [f64; N]) -> [Twice; N] {
    values.map(|x| Twice(x, 0.0))
}

/// Hamilton's product, (x, y, z, w).
fn product(a: Quaternion, b: Quaternion) -> Quaternion {
    let sum = |terms: [(usize, usize, bool); 4]| {
        terms.iter().fold(Twice::ZERO, |sum, &(i, j, adds)| {
            let term = a[i].times(b[j]);
            if adds { sum.plus(term) } else { sum.minus(term) }
        })
    };
    [
        sum([(3, 0, true), (0, 3, true), (1, 2, true), (2, 1, false)]),
        sum([(3, 1, true), (1, 3, true), (2, 0, true), (0, 2, false)]),
        sum([(3, 2, true), (2, 3, true), (0, 1, true), (1, 0, false)]),
        sum([(3, 3, true), (0, 0, false), (1, 1, false), (2, 2, false)]),
    ]
}

fn rotated(q: DQuat, v: DVec3) -> [Twice; 3] {
    let all = twice(q.to_array());
    let back = twice(q.conjugate().to_array());
    let [x, y, z] = twice(v.to_array());
    let turned = product(product(all, [x, y, z, Twice::ZERO]), back);
    [turned[0], turned[1], turned[2]]
}

fn ulp(x: f64) -> f64 {
    x.abs().next_up() - x.abs()
}

/// Length of the error in rounding units of a length.
fn ulps<const N: usize>(found: [f64; N], expected: [Twice; N], length: f64) -> f64 {
    let error = |(f, e): (&f64, &Twice)| Twice(*f, 0.0).minus(*e).0;
    found.iter().zip(&expected).map(error).map(|e| e * e).sum::<f64>().sqrt()
        / (f64::EPSILON * length).max(f64::MIN_POSITIVE)
}

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-limit..limit).prop_map(DVec3::from_array)
}

/// Turns from 1e-12 rad to more than half a turn, shifts up to a metre.
fn motion() -> impl Strategy<Value = Pose> {
    (vector(1.0), -12.0..0.5_f64, vector(1e3)).prop_map(|(axis, power, shift)| {
        let omega = axis * (10.0_f64.powf(power) / axis.length().max(1e-3));
        Pose::exp(omega, shift)
    })
}

fn largest(v: DVec3) -> f64 {
    v.abs().max_element()
}

/// Of R and R', t and t': twice 4 ulp, of operands as large.
fn apart(a: &Pose, b: &Pose, size_mm: f64) -> f64 {
    let turn = (a.rotation - b.rotation).length().min((a.rotation + b.rotation).length()) / ulp(1.0);
    let shift = largest(a.translation_mm - b.translation_mm) / ulp(size_mm);
    turn.max(shift)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn a_product_is_that_of_twice_the_digits(a in motion(), b in motion()) {
        let found = a * b;
        let expected = product(twice(a.rotation.to_array()), twice(b.rotation.to_array()));
        prop_assert!(ulps(found.rotation.to_array(), expected, 1.0) <= MAX_ULP);
        let shift = twice(a.translation_mm.to_array());
        let turned = rotated(a.rotation, b.translation_mm);
        let expected: [Twice; 3] = std::array::from_fn(|k| turned[k].plus(shift[k]));
        let length_mm = a.translation_mm.length() + b.translation_mm.length();
        prop_assert!(ulps(found.translation_mm.to_array(), expected, length_mm) <= MAX_ULP);
        // A point is moved as a translation is.
        prop_assert_eq!(a.transform_point(b.translation_mm), found.translation_mm);
    }

    #[test]
    fn an_inverse_is_that_of_twice_the_digits_and_undoes(a in motion(), p in vector(1e3)) {
        let back = a.inverse();
        let expected = rotated(a.rotation.conjugate(), -a.translation_mm);
        prop_assert!(ulps(back.translation_mm.to_array(), expected, a.translation_mm.length()) <= MAX_ULP);
        prop_assert_eq!(back.rotation, a.rotation.conjugate());
        // Two rotations of 4 ulp each, a sum, and a quaternion whose square is up to 4 ulp off 1.
        let size_mm = 2.0 * (p.length() + a.translation_mm.length());
        prop_assert!(apart(&(back * a), &Pose::IDENTITY, size_mm) <= 3.0 * MAX_ULP);
        prop_assert!(largest(back.transform_point(a.transform_point(p)) - p) <= 3.0 * MAX_ULP * ulp(size_mm));
    }

    #[test]
    fn products_may_be_put_in_any_brackets(a in motion(), b in motion(), c in motion()) {
        let size_mm = [a, b, c].iter().map(|m| m.translation_mm.length()).sum::<f64>();
        // Two products on each side.
        prop_assert!(apart(&((a * b) * c), &(a * (b * c)), size_mm) <= 4.0 * MAX_ULP);
    }

    /// T exp(ω, v) T⁻¹ = exp(R ω, R v + t × R ω): the adjoint, by which twists change their frame.
    #[test]
    fn a_twist_moves_with_the_adjoint(
        t in motion(), axis in vector(1.0), angle in 1e-9..PI, v in vector(1e3),
    ) {
        let omega = axis * (angle / axis.length().max(1e-3));
        prop_assume!(omega.length() <= PI);
        let here = t * Pose::exp(omega, v) * t.inverse();
        let turned = t.transform_vector(omega);
        let there = Pose::exp(turned, t.transform_vector(v) + t.translation_mm.cross(turned));
        // Left: an exponential, an inverse and two products; right: two rotations, a sum, an exponential, and
        // its turn's error of 4 ulp of π, by which V v moves by half as much.
        let size_mm = 2.0 * v.length() + (1.0 + PI) * t.translation_mm.length();
        prop_assert!(apart(&here, &there, size_mm) <= 9.0 * MAX_ULP, "{here:?} {there:?}");
    }
}
