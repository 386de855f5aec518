//! Branch-free exponential of non-positive numbers, without tables or divisions, so that loops vectorise.

use core::f64::consts::LOG2_E;

/// Slightly above the exponent at which the result becomes subnormal: e^-708.4 = 2^-1022.
const LEAST: f64 = -708.0;
/// ln 2 rounded to 32 bits, whose multiples up to 2^21 are exact, and the remainder.
const LN_2_HIGH: f64 = 0.6931471803691238;
const LN_2_LOW: f64 = 1.9082149292705877e-10;
/// 1.5 · 2^52: adding it rounds to an integer, held in the lowest bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// 1/k! from k = 2. The first omitted term, (ln 2 / 2)^14 / 14! = 4e-18, is a thirtieth of an ulp.
const INVERSE_FACTORIALS: [f64; 12] = [
    0.5,
    0.16666666666666666,
    0.041666666666666664,
    0.008333333333333333,
    0.001388888888888889,
    0.0001984126984126984,
    2.48015873015873e-05,
    2.7557319223985893e-06,
    2.755731922398589e-07,
    2.505210838544172e-08,
    2.08767569878681e-09,
    1.6059043836821613e-10,
];

/// e^x for x <= 0; 0 below -708, where e^x is less than 2^-1021. Undefined for x > 0 and NaN.
///
/// With x = k ln 2 + r, |r| <= ln 2 / 2, it is 2^k (1 + r + r² q(r)). The roundings of r, r² q and r + r² q
/// are at most a quarter ulp each where the result is smallest, and the final sum adds half: within 1.5 ulp.
#[inline]
pub(crate) fn exp_nonpositive(x: f64) -> f64 {
    let rounded = x * LOG2_E + ROUND;
    let k = rounded - ROUND;
    let r = (x - k * LN_2_HIGH) - k * LN_2_LOW;
    let mantissa = 1.0 + (r + r * r * quotient(r));
    let scaled = f64::from_bits(mantissa.to_bits().wrapping_add(rounded.to_bits() << 52));
    if x >= LEAST { scaled } else { 0.0 }
}

/// (e^r - 1 - r) / r² = Σ r^k / (k + 2)!, in pairs (Estrin), which shortens the dependency chain.
#[inline]
fn quotient(r: f64) -> f64 {
    let c = &INVERSE_FACTORIALS;
    let (r2, pair) = (r * r, |k: usize| c[k] + c[k + 1] * r);
    let r4 = r2 * r2;
    (pair(0) + pair(2) * r2) + ((pair(4) + pair(6) * r2) + (pair(8) + pair(10) * r2) * r4) * r4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::random::Stream;

    /// Distance in units of the last place.
    fn ulps(a: f64, b: f64) -> u64 {
        a.to_bits().abs_diff(b.to_bits())
    }

    #[test]
    fn agrees_with_mpmath_to_a_last_place() {
        // mpmath with 200 bits, rounded once.
        for (x, expected) in [
            (0.0, 1.0),
            (-1e-300, 1.0),
            (-1e-17, 1.0),
            (-0.1, 0.9048374180359595),
            // On both sides of a change of k.
            (-0.3465, 0.7071588192872713),
            (-0.3466, 0.7070881069410189),
            (-1.0, 0.36787944117144233),
            (-5.5, 0.004086771438464067),
            (-45.0, 2.8625185805493937e-20),
            (-123.456, 2.4195825412645934e-54),
            (-700.0, 9.85967654375977e-305),
            (-708.0, 3.307553003638408e-308),
        ] {
            assert!(ulps(exp_nonpositive(x), expected) <= 1, "{x}: {:e}", exp_nonpositive(x));
        }
        assert_eq!(exp_nonpositive(-0.0), 1.0);
        for x in [-708.1, -1e4, -1e300, f64::NEG_INFINITY] {
            assert_eq!(exp_nonpositive(x), 0.0);
        }
    }

    #[test]
    fn agrees_with_libm_and_never_exceeds_one() {
        let mut random = Stream::new(1, "exp");
        let mut most = 0;
        for scale in [1e-12, 1e-3, 0.4, 1.0, 30.0, 708.0] {
            for _ in 0..100_000 {
                let x = -scale * random.uniform();
                let found = exp_nonpositive(x);
                // libm is itself within 1 ulp.
                most = most.max(ulps(found, libm::exp(x)));
                assert!(found <= 1.0, "{x}");
            }
        }
        assert!(most <= 2, "{most}");
    }
}
