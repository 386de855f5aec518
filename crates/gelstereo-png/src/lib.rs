//! Fast encoder for grey PNG files.
//!
//! Camera noise leaves no repetitions in an image, so searching for them only costs time. The encoder
//! uses only the Huffman part of DEFLATE: one block with a code built for this image, over residuals of
//! the best row filter. Every PNG reader opens the result. `docs/recordings.md` compares it with other
//! codecs.

#![forbid(unsafe_code)]

const SIGNATURE: [u8; 8] = [0x89, b'P', b'N', b'G', 0x0d, 0x0a, 0x1a, 0x0a];
/// Longest code: four codes and the remainder of a byte fit in 64 bits.
const MAX_CODE_BITS: usize = 14;
/// Literals plus the end-of-block symbol.
const SYMBOLS: usize = 257;
const END_OF_BLOCK: usize = 256;
/// Row interval at which all filters are tried, to choose the image's filter.
const SAMPLED_ROWS: usize = 8;

/// PNG row filters that are tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Filter {
    Up = 2,
    Average = 3,
    Paeth = 4,
}

/// PNG encoder; its buffers are reused between images.
#[derive(Clone, Debug, Default)]
pub struct PngEncoder {
    residuals: Vec<u8>,
}

impl PngEncoder {
    /// Appends an image to `out` as a PNG file of 8-bit grey. `pixels` has rows of `width` bytes without
    /// padding; a last row that is not whole is left out.
    pub fn encode(&mut self, pixels: &[u8], width: usize, out: &mut Vec<u8>) {
        let height = pixels.len().checked_div(width).unwrap_or(0);
        out.extend_from_slice(&SIGNATURE);
        let mut header = Vec::with_capacity(13);
        header.extend_from_slice(&(width as u32).to_be_bytes());
        header.extend_from_slice(&(height as u32).to_be_bytes());
        // 8 bits, grey, DEFLATE, the five filter types, not interlaced.
        header.extend_from_slice(&[8, 0, 0, 0, 0]);
        chunk(out, b"IHDR", |out| out.extend_from_slice(&header));
        self.filter(pixels, width, height);
        chunk(out, b"IDAT", |out| {
            // zlib header: DEFLATE with a 32 kB window; the second byte makes the pair a multiple of 31.
            out.extend_from_slice(&[0x78, 0x01]);
            deflate(&self.residuals, out);
            out.extend_from_slice(&simd_adler32::adler32(&self.residuals.as_slice()).to_be_bytes());
        });
        chunk(out, b"IEND", |_| {});
    }

    /// Fills `residuals` with filter numbers and filtered rows.
    fn filter(&mut self, pixels: &[u8], width: usize, height: usize) {
        self.residuals.clear();
        self.residuals.resize((width + 1) * height, 0);
        if width == 0 {
            return;
        }
        let rows = |y: usize| {
            let above = y.checked_sub(1).map(|above| &pixels[above * width..][..width]);
            (above, &pixels[y * width..][..width])
        };
        let mut trial = vec![0; width];
        let cost = |filter| {
            let sampled = (0..height).skip(1).step_by(SAMPLED_ROWS);
            sampled.fold(0_u64, |cost, y| {
                let (above, row) = rows(y);
                residual(filter, above.unwrap_or(row), row, &mut trial);
                cost + trial.iter().map(|&r| u64::from((r as i8).unsigned_abs())).sum::<u64>()
            })
        };
        let filters = [Filter::Average, Filter::Paeth, Filter::Up];
        let filter = filters.into_iter().min_by_key({
            let mut cost = cost;
            move |&filter| cost(filter)
        });
        let filter = filter.unwrap_or(Filter::Average);
        let black = vec![0; width];
        for (y, out) in self.residuals.chunks_exact_mut(width + 1).enumerate() {
            let (above, row) = rows(y);
            out[0] = filter as u8;
            residual(filter, above.unwrap_or(&black), row, &mut out[1..]);
        }
    }
}

/// Filters one row. All slices have the same length.
fn residual(filter: Filter, above: &[u8], row: &[u8], out: &mut [u8]) {
    let Some(first) = row.first() else { return };
    let up = |(r, (&x, &b)): (&mut u8, (&u8, &u8))| *r = x.wrapping_sub(b);
    match filter {
        Filter::Up => out.iter_mut().zip(row.iter().zip(above)).for_each(up),
        Filter::Average => {
            out[0] = first.wrapping_sub(above[0] / 2);
            let inputs = row[1..].iter().zip(row).zip(&above[1..]);
            for (r, ((&x, &a), &b)) in out[1..].iter_mut().zip(inputs) {
                *r = x.wrapping_sub(((u16::from(a) + u16::from(b)) / 2) as u8);
            }
        }
        Filter::Paeth => {
            out[0] = first.wrapping_sub(above[0]);
            let inputs = row[1..].iter().zip(row).zip(above[1..].iter().zip(above));
            for (r, ((&x, &a), (&b, &c))) in out[1..].iter_mut().zip(inputs) {
                *r = x.wrapping_sub(paeth(a, b, c));
            }
        }
    }
}

/// PNG specification, 9.4: of left, above and upper left, the one nearest to left + above - upper left.
fn paeth(a: u8, b: u8, c: u8) -> u8 {
    let (to_a, to_b) = (b.abs_diff(c), a.abs_diff(c));
    let to_c = (i16::from(a) + i16::from(b) - 2 * i16::from(c)).unsigned_abs();
    if to_a <= to_b && u16::from(to_a) <= to_c {
        a
    } else if u16::from(to_b) <= to_c {
        b
    } else {
        c
    }
}

/// Writes a chunk of a PNG file: length, name, content, CRC-32 of name and content.
fn chunk(out: &mut Vec<u8>, name: &[u8; 4], content: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(name);
    content(out);
    let length = (out.len() - start - 8) as u32;
    out[start..start + 4].copy_from_slice(&length.to_be_bytes());
    out.extend_from_slice(&crc32fast::hash(&out[start + 4..]).to_be_bytes());
}

/// Appends one final block of literals with a dynamic Huffman code (RFC 1951, 3.2.7).
fn deflate(bytes: &[u8], out: &mut Vec<u8>) {
    let mut counts = histogram(bytes);
    counts[END_OF_BLOCK] = 1;
    let lengths = code_lengths(&counts);
    let codes = codes(&lengths);
    let mut bits = BitWriter { out, held: 0, count: 0 };
    // Final block, dynamic code; 257 literal codes, 1 distance code, 19 code-length codes.
    bits.put(0b101, 3);
    bits.put(0, 5);
    bits.put(0, 5);
    bits.put(15, 4);
    // The lengths 0 to 15 get 4-bit codes, and the repetitions 16 to 18 none: runs are too rare to pay off.
    const ORDER: [u8; 19] = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
    for symbol in ORDER {
        bits.put(if symbol < 16 { 4 } else { 0 }, 3);
    }
    // No distances are used: one code of zero bits.
    for length in lengths.iter().copied().chain([0]) {
        bits.put(u64::from(reversed(u32::from(length), 4)), 4);
    }
    bits.put_all(bytes, &codes);
    bits.put(u64::from(codes[END_OF_BLOCK].0), u32::from(codes[END_OF_BLOCK].1));
    bits.finish();
}

/// Counts each byte. Four tables, so that equal neighbours do not create a dependency.
fn histogram(bytes: &[u8]) -> [u32; SYMBOLS] {
    let mut tables = [[0_u32; 256]; 4];
    let quads = bytes.chunks_exact(4);
    for &byte in quads.remainder() {
        tables[0][usize::from(byte)] += 1;
    }
    for quad in quads {
        for (table, &byte) in tables.iter_mut().zip(quad) {
            table[usize::from(byte)] += 1;
        }
    }
    core::array::from_fn(|symbol| tables.iter().map(|table| table.get(symbol).copied().unwrap_or(0)).sum())
}

/// Lengths of a Huffman code of at most [`MAX_CODE_BITS`]; absent symbols have length 0.
fn code_lengths(counts: &[u32; SYMBOLS]) -> [u8; SYMBOLS] {
    let mut counts = *counts;
    loop {
        let lengths = huffman(&counts);
        if lengths.iter().all(|&length| usize::from(length) <= MAX_CODE_BITS) {
            return lengths;
        }
        // Flattens the counts until no code is too long.
        for count in counts.iter_mut().filter(|count| **count > 0) {
            *count = *count / 2 + 1;
        }
    }
}

/// Lengths of the optimal prefix code.
fn huffman(counts: &[u32; SYMBOLS]) -> [u8; SYMBOLS] {
    // Two queues: leaves in order of count, then inner nodes in order of creation.
    let mut leaves: Vec<(u64, usize)> =
        (0..SYMBOLS).filter(|&i| counts[i] > 0).map(|i| (u64::from(counts[i]), i)).collect();
    leaves.sort_unstable();
    let mut lengths = [0; SYMBOLS];
    if let [(_, only)] = leaves[..] {
        lengths[only] = 1;
        return lengths;
    }
    let total = leaves.len();
    let mut weights: Vec<u64> = leaves.iter().map(|&(count, _)| count).collect();
    let mut parents = vec![0; 2 * total];
    let (mut leaf, mut inner) = (0, total);
    for node in total..(2 * total).saturating_sub(1) {
        let mut weight = 0;
        for _ in 0..2 {
            let from_leaves = leaf < total && (inner >= node || weights[leaf] <= weights[inner]);
            let child = if from_leaves { &mut leaf } else { &mut inner };
            weight += weights[*child];
            parents[*child] = node;
            *child += 1;
        }
        weights.push(weight);
    }
    let root = (2 * total).saturating_sub(2);
    let mut depths = vec![0_u8; 2 * total];
    for node in (0..root).rev() {
        depths[node] = depths[parents[node]].saturating_add(1);
    }
    for (depth, &(_, symbol)) in depths.iter().zip(&leaves) {
        lengths[symbol] = *depth;
    }
    lengths
}

/// Canonical codes (RFC 1951, 3.2.2), first bit lowest, with their lengths.
fn codes(lengths: &[u8; SYMBOLS]) -> [(u16, u8); SYMBOLS] {
    let mut next = [0_u32; MAX_CODE_BITS + 1];
    let mut code = 0;
    for bits in 1..=MAX_CODE_BITS {
        next[bits] = code;
        let used = lengths.iter().filter(|&&length| usize::from(length) == bits).count() as u32;
        code = (code + used) << 1;
    }
    lengths.map(|length| {
        let code = next[usize::from(length)];
        next[usize::from(length)] += u32::from(length > 0);
        (reversed(code, u32::from(length)) as u16, length)
    })
}

fn reversed(code: u32, bits: u32) -> u32 {
    if bits == 0 { 0 } else { code.reverse_bits() >> (32 - bits) }
}

/// Writes bits, lowest first.
struct BitWriter<'a> {
    out: &'a mut Vec<u8>,
    held: u64,
    /// Bits in `held`; fewer than 8 between calls.
    count: u32,
}

impl BitWriter<'_> {
    /// Appends up to 56 bits.
    fn put(&mut self, bits: u64, count: u32) {
        self.held |= bits << self.count;
        self.count += count;
        while self.count >= 8 {
            self.out.push(self.held as u8);
            self.held >>= 8;
            self.count -= 8;
        }
    }

    /// Appends the codes of all bytes.
    fn put_all(&mut self, bytes: &[u8], codes: &[(u16, u8); SYMBOLS]) {
        let start = self.out.len();
        self.out.resize(start + bytes.len() * MAX_CODE_BITS / 8 + 16, 0);
        let mut at = start;
        let quads = bytes.chunks_exact(4);
        let rest = quads.remainder();
        for quad in quads {
            for &byte in quad {
                let (code, length) = codes[usize::from(byte)];
                self.held |= u64::from(code) << self.count;
                self.count += u32::from(length);
            }
            // Writes eight bytes, and keeps those that are full.
            if let Some(place) = self.out.get_mut(at..at + 8) {
                place.copy_from_slice(&self.held.to_le_bytes());
            }
            let full = self.count & !7;
            at += (full / 8) as usize;
            self.held = self.held.checked_shr(full).unwrap_or(0);
            self.count &= 7;
        }
        self.out.truncate(at);
        for &byte in rest {
            let (code, length) = codes[usize::from(byte)];
            self.put(u64::from(code), u32::from(length));
        }
    }

    fn finish(&mut self) {
        if self.count > 0 {
            self.out.push(self.held as u8);
            (self.held, self.count) = (0, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Pixels and width.
    fn decoded(file: &[u8]) -> (Vec<u8>, usize) {
        let image = image::load_from_memory_with_format(file, image::ImageFormat::Png).unwrap().into_luma8();
        let width = image.width() as usize;
        (image.into_raw(), width)
    }

    /// Symbols that occur once beside very frequent ones have the longest codes. Fibonacci counts give a
    /// code as deep as the number of symbols.
    #[test]
    fn codes_stay_below_their_limit_and_use_all_of_it() {
        let mut counts = [0; SYMBOLS];
        let (mut a, mut b) = (1, 1);
        for count in &mut counts[..40] {
            (*count, a, b) = (a, b, a + b);
        }
        assert!(huffman(&counts).iter().any(|&length| usize::from(length) > MAX_CODE_BITS));
        let lengths = code_lengths(&counts);
        let filled: f64 = lengths.iter().filter(|&&l| l > 0).map(|&l| 0.5_f64.powi(i32::from(l))).sum();
        assert_eq!(filled, 1.0, "{lengths:?}");
    }

    proptest! {
        /// An independent decoder restores every image: flat, noisy, steep, narrow.
        #[test]
        fn every_image_comes_back(
            width in 1_usize..40,
            height in 1_usize..30,
            spread in 0_u32..256,
            seed in any::<u64>(),
        ) {
            let mut state = seed;
            let pixels = (0..width * height).map(|i| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                ((i / 3) as u32 + (state >> 33) as u32 % (spread + 1)) as u8
            });
            let pixels: Vec<u8> = pixels.collect();
            let mut file = Vec::new();
            PngEncoder::default().encode(&pixels, width, &mut file);
            prop_assert_eq!(decoded(&file), (pixels, width));
        }
    }
}
