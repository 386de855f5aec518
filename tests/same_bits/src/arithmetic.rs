//! One digest for each kind of operation that compilers and processors may do in more than one way.

use crate::{Digests, Outcome};
use alloc::format;
use alloc::vec::Vec;
use core::hint::black_box;
use gelstereo_core::digest::Digest;
use gelstereo_core::math::median;
use gelstereo_core::math::random::{Stream, keyed};

/// Numbers for each operation: no multiple of a vector's lanes.
const COUNT: usize = 1003;

pub fn run(out: &mut Digests) -> Outcome<()> {
    let mut add = |name: &str, digest: Digest| out.push((format!("arithmetic/{name}"), digest.value()));
    let [a, b, c] = ["a", "b", "c"].map(normals);
    let pairs = || a.iter().copied().zip(b.iter().copied());
    add("byte_order", Digest::new().u64(0x0102_0304_0506_0708).bytes(&[9]).f64s([1.5, -0.0]));
    add("add", Digest::new().f64s(pairs().map(|(a, b)| a + b)));
    add("divide", Digest::new().f64s(pairs().map(|(a, b)| a / b)));
    // A compiler that fuses these rounds once in place of twice.
    add("multiply_then_add", Digest::new().f64s(pairs().zip(&c).map(|((a, b), c)| a * b + c)));
    // One that takes partial sums adds in another order.
    add("sum", Digest::new().f64s([a.iter().sum(), pairs().map(|(a, b)| a * b).sum()]));
    add("subnormal", Digest::new().f64s(a.iter().map(|a| a * black_box(1e-308) * black_box(0.01))));
    add(
        "largest",
        Digest::new().f64s([a.iter().copied().fold(-9.0, f64::max), a.iter().fold(9.0, |l, a| a.min(l))]),
    );
    singles(&a, &b, &mut add);
    conversions(&a, &mut add);
    integers(&mut add);
    orders(&a, &mut add);
    streams(&mut add);
    Ok(())
}

fn normals(name: &str) -> Vec<f64> {
    let mut random = Stream::new(1, name);
    (0..COUNT).map(|_| random.normal()).collect()
}

fn singles(a: &[f64], b: &[f64], add: &mut impl FnMut(&str, Digest)) {
    let pairs = a.iter().zip(b).map(|(&a, &b)| (a as f32, b as f32));
    let values = pairs.map(|(a, b)| (a * b + 0.25) / (b - 1e-3));
    add("single_precision", values.fold(Digest::new(), |digest, x| digest.u64(u64::from(x.to_bits()))));
}

fn conversions(a: &[f64], add: &mut impl FnMut(&str, Digest)) {
    let scaled = || a.iter().map(|a| a * 300.0);
    add("float_to_byte", scaled().fold(Digest::new(), |digest, x| digest.bytes(&[x as u8])));
    add("float_to_integer", scaled().fold(Digest::new(), |digest, x| digest.u64(x as i64 as u64)));
    let of_wide = (0..COUNT).map(|i| keyed(1, i));
    add("integer_to_float", Digest::new().f64s(of_wide.flat_map(|bits| [bits as f64, (bits as i32).into()])));
}

fn integers(add: &mut impl FnMut(&str, Digest)) {
    let words: Vec<u64> = (0..COUNT).map(|i| keyed(2, i)).collect();
    let bytes: Vec<u8> = words.iter().map(|word| *word as u8).collect();
    let sum: u32 = bytes.iter().map(|&x| u32::from(x)).sum();
    let squares: i32 = bytes.iter().map(|&x| (i32::from(x) - 128) * (i32::from(x) - 128)).sum();
    add("byte_sums", Digest::new().u64(sum.into()).u64(squares as u64));
    let high = words.iter().map(|&word| ((u128::from(word) * 0x1234_5678_9ABC_DEF1) >> 64) as u64);
    add("wide_multiply", high.fold(Digest::new(), Digest::u64));
    let divided = words.iter().map(|&word| word / ((word >> 40) | 1) + word % 1009);
    add("wide_divide", divided.fold(Digest::new(), Digest::u64));
    let bits = words.iter().map(|word| u64::from(word.leading_zeros() + word.count_ones()));
    add("bit_counts", bits.fold(Digest::new(), Digest::u64));
}

/// Sorting that keeps the order of equal keys, sorting that need not, and selection; what is left free is not
/// compared.
fn orders(a: &[f64], add: &mut impl FnMut(&str, Digest)) {
    let key = |x: &f64| (x * 4.0) as i32;
    let mut sorted = a.to_vec();
    sorted.sort_by_key(key);
    add("sort", Digest::new().f64s(sorted.iter().copied()));
    sorted.copy_from_slice(a);
    sorted.sort_unstable_by(f64::total_cmp);
    add("sort_unstable", Digest::new().f64s(sorted.iter().copied()));
    sorted.copy_from_slice(a);
    add("median", Digest::new().f64s(median(&mut sorted)));
}

fn streams(add: &mut impl FnMut(&str, Digest)) {
    let mut random = Stream::new(7, "streams");
    let mut digest = Digest::new();
    for n in 1..COUNT {
        digest = digest.u64(random.next_u64()).u64(random.below(n) as u64).f64s([random.uniform()]);
    }
    add("random", digest);
    let (mut random, mut digest) = (Stream::new(7, "normal"), Digest::new());
    for _ in 0..COUNT {
        digest = digest.f64s([random.normal()]);
    }
    add("random_normal", digest);
}
